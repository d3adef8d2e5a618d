//! Edits of parameter files change one value and nothing else.

use proptest::prelude::*;
use ros_parameters::{
    ParameterFile, ParameterValue as P,
    edit::{set, set_entry},
    parse_value,
};

const RIG: &str = "# measured on Monday
/**:
  ros__parameters:
    camera: {position: [0.0, 0.0, -0.10], orientation: [0.7, 0.7, 0, 0]}   # points down
    imu:
      position: # from the drawing
        - 0.1
        - 0.2  # to the screw
        - 0.3
      note: \"a: b # no comment\"
    markers:
      size: 0.076   # side

    # end of the rig
climber_driver:
  ros__parameters: {joints: {rail_x: bridge}, height: 2.8}
pose_fusion:
    ros__parameters:
";

#[test]
fn a_value_is_replaced_in_the_style_of_the_file() {
    let at = |node: &str, name: &str, value: &str| {
        set(RIG, node, name, &parse_value(name, value).unwrap()).unwrap()
    };
    for (node, name, value, from, to) in [
        ("/**", "camera.position", "[1.0, -2.5, 1e-9]", "[0.0, 0.0, -0.10]", "[1.0, -2.5, 1e-9]"),
        (
            "/**",
            "imu.position",
            "[1.0, 2.0, 3.5]",
            "- 0.1\n        - 0.2  # to the screw\n        - 0.3",
            "- 1.0\n        - 2.0  # to the screw\n        - 3.5",
        ),
        ("/**", "markers.size", "0.1", "0.076   # side", "0.1   # side"),
        ("/climber_driver", "height", "3.0", "height: 2.8", "height: 3.0"),
        ("/climber_driver", "joints.rail_y", "trolley", "bridge}", "bridge, rail_y: trolley}"),
        ("/climber_driver", "zero.turn", "0.5", "2.8}", "2.8, zero: {turn: 0.5}}"),
        (
            "/**",
            "markers.colors.red",
            "[1.0, 2.0, 3.0]",
            "# side\n",
            "# side\n      colors:\n        red: [1.0, 2.0, 3.0]\n",
        ),
        ("/pose_fusion", "model", "tight", "parameters:\n", "parameters:\n      model: tight\n"),
    ] {
        // The last block only is empty: its line is the last of that text.
        let (before, after) = RIG.rsplit_once(from).unwrap();
        assert_eq!(at(node, name, value), format!("{before}{to}{after}"), "{name}");
    }
    assert_eq!(
        at("/imu_driver", "port", "/dev/ttyUSB0"),
        format!("{RIG}/imu_driver:\n  ros__parameters:\n    port: \"/dev/ttyUSB0\"\n"),
    );
    // A node in any namespace: a block of its own, where none applies.
    let any = |text: &str, port: &str| {
        set(text, "/**/imu_driver", "port", &P::String(port.into())).unwrap()
    };
    let added = any(RIG, "/dev/a");
    let block = |node: &str, port: &str| {
        format!("{RIG}{node}:\n  ros__parameters:\n    port: \"/dev/{port}\"\n")
    };
    assert_eq!(added, block("/**/imu_driver", "a"));
    assert_eq!(any(&added, "/dev/b"), block("/**/imu_driver", "b"));
    assert_eq!(any(&block("/imu_driver", "a"), "/dev/b"), block("/imu_driver", "b"));
    let windows = RIG.replace('\n', "\r\n");
    let red = P::DoubleArray(vec![1.0, 2.0, 3.0]);
    let edited = set(&windows, "/**", "markers.colors.red", &red).unwrap();
    assert_eq!(edited.matches('\n').count(), edited.matches("\r\n").count());
    for empty in ["", "# a rig\n", "---\n"] {
        let edited = set(empty, "/**", "markers.size", &P::Double(0.1)).unwrap();
        let lines = "/**:\n  ros__parameters:\n    markers:\n      size: 0.1\n";
        assert_eq!(edited, format!("{empty}{lines}"));
    }
    assert_eq!(
        set("a: {ros__parameters: {}}", "/a", "b.c", &P::Bool(true)).unwrap(),
        "a: {ros__parameters: {b: {c: true}}}"
    );
}

#[test]
fn what_cannot_be_edited_alone_is_refused_with_the_line_to_enter() {
    let error =
        set("/**: {ros__parameters: {a: &x [1.0], b: *x}}", "/**", "a", &P::DoubleArray(vec![2.0]))
            .unwrap_err()
            .to_string();
    assert!(error.contains("`a: [2.0]` by hand"), "{error}");
    let error = set("/**: {ros__parameters: {a: 1}}", "/**", "a.b", &P::Bool(true));
    assert!(error.unwrap_err().to_string().contains("`a.b`"));
    assert!(set("- 1\n", "/**", "a", &P::Bool(true)).is_err());
}

#[test]
fn an_entry_of_another_yaml_file_is_set() {
    let camera = "# ceiling\nimage_width: 640 # px\ncamera_matrix:\n  rows: 3\n  data: [1, 2, 3]\n";
    let list = P::DoubleArray(vec![1.5, 2.0]);
    let edited = set_entry(camera, &["camera_matrix", "data"], &list).unwrap();
    assert_eq!(edited, camera.replace("[1, 2, 3]", "[1.5, 2.0]"));
    let edited = set_entry(camera, &["image_width"], &P::Integer(800)).unwrap();
    assert_eq!(edited, camera.replace("640", "800"));
    let edited = set_entry(camera, &["d", "data"], &list).unwrap();
    assert_eq!(edited, format!("{camera}d:\n  data: [1.5, 2.0]\n"));
    assert!(set_entry(camera, &["image_width", "data"], &list).is_err());
}

/// A random tree of parameters, written in random style.
#[derive(Clone, Debug)]
enum Tree {
    Value(P),
    Map(Vec<(String, Tree)>),
}

fn value() -> impl Strategy<Value = P> {
    prop_oneof![
        any::<bool>().prop_map(P::Bool),
        any::<i64>().prop_map(P::Integer),
        prop_oneof![-1e3..1e3, any::<f64>()].prop_map(P::Double),
        "[ -~äß]{0,12}".prop_map(P::String),
        prop::collection::vec(-10.0..10.0, 1..5).prop_map(P::DoubleArray),
        prop::collection::vec("[a-z:#' ]{0,6}", 1..4).prop_map(P::StringArray),
    ]
}

fn tree() -> impl Strategy<Value = Tree> {
    let key = "[a-e]";
    value().prop_map(Tree::Value).prop_recursive(3, 20, 5, move |inner| {
        prop::collection::btree_map(key, inner, 1..5)
            .prop_map(|m| Tree::Map(m.into_iter().collect()))
    })
}

/// Writes a tree; `style` yields the choices.
fn written(tree: &Tree, depth: usize, style: &mut impl FnMut(u32) -> u32, out: &mut String) {
    let indent = |n: usize| "  ".repeat(n);
    match tree {
        Tree::Value(P::DoubleArray(a)) if style(3) == 0 => {
            for x in a {
                *out +=
                    &format!("\n{}- {x:?}{}", indent(depth), ["", "  # note"][style(2) as usize]);
            }
        }
        Tree::Value(value @ P::Double(_)) => *out += &format!(" {}", value.to_yaml()),
        Tree::Value(P::String(s)) if style(2) == 0 => {
            *out += &format!(" '{}'", s.replace('\'', "''"))
        }
        Tree::Value(value) => *out += &format!(" {value}"),
        Tree::Map(_) if style(3) == 0 => *out += &flow(tree),
        Tree::Map(entries) => {
            for (key, below) in entries {
                *out += ["", "", "\n\n# a line: of text"][style(3) as usize];
                *out += &format!("\n{}{key}:", indent(depth));
                written(below, depth + 1, style, out);
                *out += ["", "   # comment"][style(2) as usize];
            }
        }
    }
}

fn flow(tree: &Tree) -> String {
    let mut text = String::new();
    match tree {
        Tree::Value(_) => written(tree, 0, &mut |n| n - 1, &mut text),
        Tree::Map(entries) => {
            let entries: Vec<_> = entries.iter().map(|(k, t)| format!("{k}:{}", flow(t))).collect();
            text = format!(" {{{}}}", entries.join(", "));
        }
    }
    text
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, ..ProptestConfig::default() })]
    #[test]
    fn an_edit_changes_its_key_and_keeps_every_other_line(
        trees in prop::collection::btree_map(prop_oneof![Just("/**"), Just("n"), Just("/m/n")], tree(), 1..4),
        name in "[a-e](\\.[a-e]){0,2}",
        new in value(),
        seed in any::<u64>(),
        crlf in any::<bool>(),
    ) {
        let mut state = seed | 1;
        let mut style = move |n: u32| {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as u32 % n
        };
        let mut text = String::from("# head");
        for (selector, tree) in &trees {
            let Tree::Map(_) = tree else { return Ok(()) };
            text += &format!("\n{selector}:\n  ros__parameters:");
            written(tree, 2, &mut style, &mut text);
        }
        text.push('\n');
        if crlf { text = text.replace('\n', "\r\n"); }
        let before = ParameterFile::parse(&text).unwrap();
        let node = *trees.keys().next().unwrap();
        let map = before.for_node(node);
        let prefix = |a: &str, b: &str| a.starts_with(&format!("{b}."));
        let clash = map.keys().any(|k| prefix(k, &name) || prefix(&name, k));
        let edited = set(&text, node, &name, &new);
        if clash {
            prop_assert!(edited.is_err());
            return Ok(());
        }
        // A block list whose length changes is refused.
        let Ok(edited) = edited else {
            let kept = |v: &P| v.as_f64_array().map(|a| a.len());
            prop_assert!(map.get(&name).and_then(kept).is_some(), "{text}\n{name} {new:?} {:?}", edited);
            return Ok(());
        };
        let mut expected = map;
        expected.insert(name, new);
        prop_assert_eq!(format!("{expected:?}"), format!("{:?}", ParameterFile::parse(&edited).unwrap().for_node(node)), "{}", edited);
        let (old, lines): (Vec<&str>, Vec<&str>) = (text.split_inclusive('\n').collect(), edited.split_inclusive('\n').collect());
        let head = old.iter().zip(&lines).take_while(|(a, b)| a == b).count();
        let tail = old[head..].iter().rev().zip(lines[head..].iter().rev()).take_while(|(a, b)| a == b).count();
        let changed = old.len() - head - tail;
        prop_assert!(changed <= 5, "{text}\n---\n{edited}");
        if changed > 1 {
            // Items of a block list; its comments stay.
            for (a, b) in old[head..head + changed].iter().zip(&lines[head..head + changed]) {
                let note = |line: &str| line.trim_end().ends_with("  # note");
                prop_assert!(a.contains("- ") && note(a) == note(b), "{text}\n---\n{edited}");
            }
        }
    }
}
