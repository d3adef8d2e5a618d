//! The launch files: what `ros2 launch` would only reject when it is run.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use quick_xml::{
    Reader,
    events::{BytesStart, Event},
};
use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};

const NODES: [&str; 4] = ["marker_tracker", "imu_driver", "climber_driver", "pose_fusion"];

/// Tags of launch_xml that the files use, with the attributes that Jazzy's launch accepts for them
/// (any tag has `if` and `unless`); another attribute is an error there.
const TAGS: [(&str, &[&str]); 9] = [
    ("launch", &[]),
    ("arg", &["name", "default", "value", "description"]),
    ("group", &[]),
    ("push-ros-namespace", &["namespace"]),
    ("set_remap", &["from", "to"]),
    ("node", &["pkg", "exec", "name", "output", "args", "respawn", "respawn_delay"]),
    ("param", &["name", "value", "from"]),
    ("executable", &["cmd", "name", "output", "respawn", "respawn_delay"]),
    ("include", &["file"]),
];

type Element = (String, Vec<(String, String)>);

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../launch_config/launch")
}

fn element(start: &BytesStart<'_>) -> Element {
    let attributes = start.attributes().map(|attribute| {
        let attribute = attribute.unwrap();
        (attribute.key.as_ref().to_owned(), attribute.value.to_string())
    });
    (start.name().as_ref().to_owned(), attributes.collect())
}

/// The elements of a file in order; each with its parents' `include` file, if it is inside one.
fn elements(path: &Path) -> Vec<(Element, Option<String>)> {
    let text = fs::read_to_string(path).unwrap();
    let mut reader = Reader::from_str(&text);
    let (mut all, mut included) = (vec![], None);
    loop {
        match reader.read_event().unwrap_or_else(|e| panic!("{}: {e}", path.display())) {
            Event::Start(start) => {
                let element = element(&start);
                let file = attribute(&element, "file").map(str::to_owned);
                all.push((element, included.clone()));
                included = file.or(included);
            }
            Event::Empty(start) => all.push((element(&start), included.clone())),
            Event::End(end) if end.name().as_ref() == "include" => included = None,
            Event::Eof => return all,
            _ => {}
        }
    }
}

fn attribute<'a>(element: &'a Element, name: &str) -> Option<&'a str> {
    element.1.iter().find(|(n, _)| n == name).map(|(_, value)| value.as_str())
}

/// Arguments that a file declares.
fn declared(path: &Path) -> BTreeSet<String> {
    let all =
        elements(path).into_iter().filter(|((tag, _), within)| tag == "arg" && within.is_none());
    all.map(|(element, _)| attribute(&element, "name").unwrap().to_owned()).collect()
}

/// Names in `$(var …)`.
fn variables(text: &str) -> impl Iterator<Item = &str> {
    text.split("$(var ").skip(1).map(|rest| rest.split(')').next().unwrap())
}

#[test]
fn launch_files_use_known_tags_and_declared_arguments() {
    let mut files = 0;
    for entry in fs::read_dir(folder()).unwrap() {
        let path = entry.unwrap().path();
        let arguments = declared(&path);
        files += 1;
        for (element, included) in elements(&path) {
            let (tag, attributes) = &element;
            let known = TAGS.iter().find(|(name, _)| name == tag);
            let (_, known) = known.unwrap_or_else(|| panic!("{}: <{tag}>", path.display()));
            for (name, value) in attributes {
                let fits = known.contains(&name.as_str()) || name == "if" || name == "unless";
                assert!(fits, "{}: <{tag} {name}=…>", path.display());
                for variable in variables(value) {
                    let declared = arguments.contains(variable);
                    assert!(declared, "{}: $(var {variable})", path.display());
                }
            }
            if let (Some(file), "arg") = (&included, tag.as_str()) {
                let name = attribute(&element, "name").unwrap();
                let file = folder().join(file.rsplit('/').next().unwrap());
                assert!(declared(&file).contains(name), "{}: {name}", file.display());
            }
            if tag == "node" {
                assert!(NODES.contains(&attribute(&element, "exec").unwrap()), "{element:?}");
                assert_eq!(attribute(&element, "exec"), attribute(&element, "pkg"));
            }
            // Substitutions in them are read as text by Jazzy.
            if let Some(value) = attribute(&element, "respawn") {
                assert!(["true", "false"].contains(&value), "{element:?}");
            }
        }
    }
    assert!(files >= 4, "{files}");
}

/// A `param` after the rig file would override the block of a node in it, also by a default.
#[test]
fn arguments_override_the_rig_file_only_where_they_are_given() {
    for (name, arguments) in [
        ("climber.launch.xml", &["source", "image_transport"] as &[&str]),
        ("platform.launch.xml", &["port", "model"]),
        ("rig.launch.xml", &["source", "image_transport", "port", "model"]),
        ("replay.launch.xml", &["model"]),
    ] {
        let all = elements(&folder().join(name));
        for argument in arguments {
            let declared = |(e, inside): &&(Element, Option<String>)| {
                e.0 == "arg" && inside.is_none() && attribute(e, "name") == Some(argument)
            };
            let (element, _) = all.iter().find(declared).unwrap();
            assert_eq!(attribute(element, "default"), Some(""), "{name}: {argument}");
            // It includes the files with the nodes.
            if name == "rig.launch.xml" {
                continue;
            }
            let passed = format!("--{argument}=$(var {argument})");
            let nodes = all.iter().filter(|(e, _)| e.0 == "node");
            let passes = |(e, _): &&(Element, _)| {
                attribute(e, "args").is_some_and(|args| args.contains(&passed))
            };
            assert_eq!(nodes.filter(passes).count(), 1, "{name}: {passed}");
            for (element, _) in &all {
                let named = attribute(element, "name") == Some(argument);
                assert!(!(named && element.0 == "param"), "{name}: {element:?}");
            }
        }
    }
}

#[test]
fn another_driver_can_take_the_place_of_imu_driver() {
    for name in ["platform.launch.xml", "rig.launch.xml"] {
        let all = elements(&folder().join(name));
        let is_imu = |e: &Element| e.0 == "arg" && attribute(e, "name") == Some("imu");
        let (argument, _) = all.iter().find(|(e, within)| is_imu(e) && within.is_none()).unwrap();
        assert_eq!(attribute(argument, "default"), Some("true"), "{name}");
        for (element, _) in &all {
            let driver = element.0 == "node" && attribute(element, "exec") == Some("imu_driver");
            let condition = attribute(element, "if") == Some("$(var imu)");
            assert_eq!(condition, driver, "{name}: {element:?}");
        }
    }
    let rig = elements(&folder().join("rig.launch.xml"));
    let passed = |(e, within): &(Element, Option<String>)| {
        within.as_ref().is_some_and(|file| file.ends_with("platform.launch.xml"))
            && attribute(e, "name") == Some("imu")
            && attribute(e, "value") == Some("$(var imu)")
    };
    assert!(rig.iter().any(passed));
}

#[test]
fn the_nodes_of_a_rig_respawn_and_the_launch_can_record() {
    for name in ["climber.launch.xml", "platform.launch.xml"] {
        for (element, _) in elements(&folder().join(name)) {
            if element.0 == "node" {
                assert_eq!(attribute(&element, "respawn"), Some("true"), "{name}: {element:?}");
                assert!(attribute(&element, "respawn_delay").is_some(), "{name}: {element:?}");
            }
        }
    }
    for name in ["climber.launch.xml", "platform.launch.xml", "rig.launch.xml"] {
        let path = folder().join(name);
        assert!(declared(&path).is_superset(&["record".into(), "record_to".into()].into()));
        let recorders: Vec<Element> = elements(&path)
            .into_iter()
            .filter(|((tag, _), _)| tag == "executable")
            .map(|(element, _)| element)
            .collect();
        assert_eq!(recorders.len(), 1, "{name}");
        let command = attribute(&recorders[0], "cmd").unwrap();
        assert!(command.contains(" record --into $(var record_to) "), "{command}");
        assert_eq!(attribute(&recorders[0], "if"), Some("$(var record)"));
    }
}
