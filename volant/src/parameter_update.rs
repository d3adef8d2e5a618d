//! Changes parameters in rig and parameter files: in place, with the former file kept as `.bak`, or
//! to a new file. Every other key and comment stays.

use anyhow::{Context, Result, bail};
use node_kit::files;
use rig_model::Rig;
use ros_parameters::{ParameterFile, ParameterValue, edit};
use std::{
    fs::{self, File},
    io::{ErrorKind, Write},
    path::{Path, PathBuf},
};

/// Every node: where the rig's keys are.
pub const RIG: &str = "/**";

/// The fusion node, in any namespace.
pub const FUSION: &str = "/**/pose_fusion";
/// How well the places of the markers are known, each axis, m (1 sigma).
pub const MARKER_SIGMA: &str = "calibration.marker_sigma";
/// How well the size of their layout is known, relative (1 sigma).
pub const LAYOUT_SIGMA: &str = "calibration.layout_sigma";
/// How well the orientation of the camera is known, each axis, rad (1 sigma).
pub const MOUNTING_SIGMA: &str = "calibration.mounting_sigma";
/// How well the focal length is known, relative (1 sigma).
pub const FOCAL_LENGTH_SIGMA: &str = "calibration.focal_length_sigma";
/// How well the scale of the rails' encoders is known, relative (1 sigma).
pub const ENCODER_SCALE_SIGMA: &str = "calibration.encoder_scale_sigma";

/// The nodes that read a rig file.
const NODES: [&str; 4] = ["marker_tracker", "imu_driver", "climber_driver", "pose_fusion"];

/// Share by which a standard deviation may differ from one that is the same.
const NEARLY: f64 = 0.1;
/// Backups beside a file: `.bak`, `.bak1` …
const BACKUPS: usize = 1000;

/// A parameter of a node, and its new value.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// Node, such as `/climber_driver`; [`RIG`] for the rig's keys.
    pub node: String,
    /// Flat name.
    pub name: String,
    /// Value.
    pub value: ParameterValue,
}

impl Setting {
    /// Setting of a key of the rig file.
    pub fn rig(name: impl Into<String>, value: ParameterValue) -> Self {
        Self { node: RIG.to_owned(), name: name.into(), value }
    }
}

/// Returns the setting of a standard deviation of the fusion node, where the rig file has one: that
/// of the survey or of a former calibration. Without one the node's default holds. Nothing changes
/// where it is that already, nearly; `kept`: or smaller.
///
/// # Errors
/// A file that is not readable.
pub fn sigma(
    rig: &Path,
    namespace: &str,
    name: &str,
    value: f64,
    kept: bool,
) -> Result<Option<Setting>> {
    let found = of_fusion(rig, namespace, name)?;
    let Some((node, old)) = found.filter(|(_, old)| !(kept && *old < value)) else {
        return Ok(None);
    };
    let changes = (value / old - 1.0).abs() > NEARLY;
    Ok(changes.then(|| Setting { node, name: name.to_owned(), value: number(value, 2) }))
}

/// Returns the full name of a namespace's fusion node, and a number that a rig file has for it.
///
/// # Errors
/// A file that is not readable.
pub fn of_fusion(rig: &Path, namespace: &str, name: &str) -> Result<Option<(String, f64)>> {
    let shown = || format!("{}: not readable", rig.display());
    let file = ParameterFile::parse(&files::read_text(rig).with_context(shown)?)?;
    let node = full_name(namespace, "pose_fusion");
    let number = file.for_node(&node).get(name).and_then(ParameterValue::as_f64);
    Ok(number.map(|number| (node, number)))
}

/// Fully qualified name of a node.
pub fn full_name(namespace: &str, node: &str) -> String {
    format!("/{}/{node}", namespace.trim_matches('/')).replace("//", "/")
}

/// Returns a node for which the file has another value than that of a setting for all nodes, or for
/// a node in any namespace: in a block of its own, which overrides. `namespace`: see [`update`].
fn overriding(file: &ParameterFile, setting: &Setting, namespace: Option<&str>) -> Option<String> {
    let (of, node) = setting.node.rsplit_once('/')?;
    if !setting.node.starts_with(RIG) {
        return None;
    }
    let known = file.selectors().filter_map(|selector| Some(selector.rsplit_once('/')?.0));
    let namespaces = match namespace {
        Some(namespace) => vec![namespace],
        None => known.filter(|name| !name.contains('*')).chain([""]).collect(),
    };
    let nodes = NODES.iter().filter(|name| of.is_empty() || **name == node);
    let mut names = nodes.flat_map(|node| namespaces.iter().map(|n| full_name(n, node)));
    names.find(|name| {
        let own = file.for_node(name);
        own.get(&setting.name).is_some_and(|value| !equal(value, &setting.value))
    })
}

/// Result of an update.
#[derive(Clone, Debug, PartialEq)]
pub struct Update {
    /// The former file; `None` where no file was replaced.
    pub backup: Option<PathBuf>,
    /// Names of the parameters that changed.
    pub changed: Vec<String>,
}

/// Sets parameters in the text of `file`, or writes `out` instead, which may replace an existing
/// file with `overwrite`. Values that are equal already keep their notation; where nothing changes,
/// nothing is written in place. The nodes of `namespace` shall have the new values; `None`: of all
/// namespaces that the file names.
///
/// # Errors
/// An unreadable file; a value in a form that is not editable in place; a rig file that would
/// become invalid; a block of a node that overrides a new value for all; see
/// [`files::check_output`] for `out`.
pub fn update(
    file: &Path,
    out: Option<&Path>,
    overwrite: bool,
    settings: &[Setting],
    namespace: Option<&str>,
) -> Result<Update> {
    let shown = || file.display().to_string();
    let text = files::read_text(file).with_context(|| format!("{}: not readable", shown()))?;
    if let Some(out) = out {
        files::check_output(out, overwrite, &[file])?;
    }
    let (mut edited, mut changed) = (text.clone(), vec![]);
    for Setting { node, name, value } in settings {
        let present = ParameterFile::parse(&edited).ok().map(|f| f.for_node(node));
        if present.and_then(|p| p.get(name).cloned()).is_some_and(|old| equal(&old, value)) {
            continue;
        }
        edited = edit::set(&edited, node, name, value).with_context(shown)?;
        changed.push(name.clone());
    }
    let after = ParameterFile::parse(&edited).unwrap_or_default();
    for setting in settings {
        if let Some(node) = overriding(&after, setting, namespace) {
            bail!(
                "{}: has another `{}` for {node}, which overrides the new one: remove it there; \
                 nothing is changed",
                shown(),
                setting.name
            );
        }
    }
    if Rig::from_yaml(&text).is_ok() {
        Rig::from_yaml(&edited).with_context(|| {
            format!("{}: left as it is, for the new values are not usable", shown())
        })?;
    }
    let backup = match out {
        Some(out) => {
            files::write(out, edited.as_bytes(), overwrite)?;
            None
        }
        None if changed.is_empty() => None,
        None => Some(replace(file, edited.as_bytes())?),
    };
    Ok(Update { backup, changed })
}

/// Replaces a file and keeps the former one as `NAME.bak`, or `.bak1` … where that exists; returns
/// its name.
///
/// # Errors
/// The folder is not writable, or the disk is full; the file is unchanged then.
pub fn replace(file: &Path, bytes: &[u8]) -> Result<PathBuf> {
    let former = fs::read(file).with_context(|| format!("{}: not readable", file.display()))?;
    let backup = backup(file, &former)
        .with_context(|| format!("{}: no copy of it can be kept; left as it is", file.display()))?;
    files::write(file, bytes, true)?;
    Ok(backup)
}

fn backup(file: &Path, former: &[u8]) -> std::io::Result<PathBuf> {
    for number in 0..BACKUPS {
        let mut name = file.as_os_str().to_owned();
        name.push(".bak");
        if number > 0 {
            name.push(number.to_string());
        }
        let path = PathBuf::from(name);
        match File::create_new(&path) {
            Ok(mut copy) => {
                let written = copy.write_all(former).and_then(|()| {
                    copy.set_permissions(fs::metadata(file)?.permissions())?;
                    copy.sync_all()
                });
                // No part of a copy stays, such as on a full disk.
                return written.map(|()| path.clone()).inspect_err(|_| drop(fs::remove_file(path)));
            }
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
            Err(error) => return Err(error),
        }
    }
    Err(std::io::Error::other(format!("there are {BACKUPS} copies already; remove some")))
}

/// Whether two values are equal to seven digits: files hold quaternions with eight.
fn equal(a: &ParameterValue, b: &ParameterValue) -> bool {
    let numbers = |v: &ParameterValue| v.as_f64().map(|x| vec![x]).or_else(|| v.as_f64_array());
    match (numbers(a), numbers(b)) {
        (Some(a), Some(b)) => {
            let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 2e-8 * a.abs().max(b.abs());
            a.len() == b.len() && a.iter().zip(&b).all(near)
        }
        _ => a == b,
    }
}

/// A list of numbers, to nine decimals.
pub fn list(values: &[f64]) -> ParameterValue {
    ParameterValue::DoubleArray(values.iter().map(|v| (v * 1e9).round() / 1e9 + 0.0).collect())
}

/// A number to this many significant digits.
pub fn number(value: f64, digits: usize) -> ParameterValue {
    let text = format!("{value:.*e}", digits.saturating_sub(1));
    ParameterValue::Double(text.parse().unwrap_or(value))
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "# mine\n/**:\n  ros__parameters:\n    a: [1.0, 2]  # one, two\n    b: 3\n";

    #[test]
    fn a_file_is_updated_in_place_and_every_former_one_is_kept() {
        let folder = tempfile::TempDir::new().unwrap();
        let file = folder.path().join("rig.yaml");
        fs::write(&file, TEXT).unwrap();
        let set = |value: f64| {
            let settings =
                [Setting::rig("a", list(&[1.0, value])), Setting::rig("b", number(3.0, 4))];
            update(&file, None, false, &settings, None).unwrap()
        };
        let update = set(2.0);
        assert_eq!((update.backup, update.changed), (None, vec![]));
        assert_eq!(fs::read_to_string(&file).unwrap(), TEXT);
        for (value, backup) in [(5.0, "rig.yaml.bak"), (6.0, "rig.yaml.bak1")] {
            let before = fs::read(&file).unwrap();
            let update = set(value);
            let path = folder.path().join(backup);
            assert_eq!(update.backup.as_ref(), Some(&path));
            assert_eq!(update.changed, ["a"]);
            assert_eq!(fs::read(path).unwrap(), before);
            let expected = TEXT.replace("[1.0, 2]", &format!("[1.0, {value:.1}]"));
            assert_eq!(fs::read_to_string(&file).unwrap(), expected);
        }
    }

    #[test]
    fn a_new_file_replaces_nothing_and_an_invalid_rig_is_not_written() {
        let folder = tempfile::TempDir::new().unwrap();
        let (file, out) = (folder.path().join("rig.yaml"), folder.path().join("new.yaml"));
        let rig = include_str!("../../launch_config/config/rig.yaml");
        fs::write(&file, rig).unwrap();
        let size = [Setting::rig("markers.size", number(0.08, 4))];
        let to_out = |overwrite| update(&file, Some(&out), overwrite, &size, None);
        assert_eq!(to_out(false).unwrap().backup, None);
        let written = fs::read_to_string(&out).unwrap();
        assert_eq!(written, rig.replace("size: 0.076  ", "size: 0.08  "));
        let error = to_out(false).unwrap_err().to_string();
        assert!(error.contains("--overwrite"), "{error}");
        to_out(true).unwrap();
        assert!(update(&file, Some(&file), true, &size, None).is_err(), "an input");
        let bad = [Setting::rig("markers.size", number(-1.0, 4))];
        let error = format!("{:#}", update(&file, None, false, &bad, None).unwrap_err());
        assert!(error.contains("left as it is") && error.contains("markers.size"), "{error}");
        assert_eq!(fs::read_to_string(&file).unwrap(), rig);
        assert_eq!(number(0.000_871_234, 3), ParameterValue::Double(0.000871));
    }

    #[test]
    fn a_sigma_is_replaced_where_the_file_has_one_and_a_better_one_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.yaml");
        let found = |text: &str, value: f64, kept: bool| {
            fs::write(&file, text).unwrap();
            let setting = sigma(&file, "/rig1/", MARKER_SIGMA, value, kept).unwrap();
            setting.map(|s| (s.node, s.value.as_f64().unwrap()))
        };
        let with =
            |node: &str| format!("{TEXT}{node}:\n  ros__parameters:\n    {MARKER_SIGMA}: 0.0005\n");
        assert_eq!(found(TEXT, 5e-5, false), None);
        let of = |value| Some(("/rig1/pose_fusion".to_owned(), value));
        for node in [FUSION, "/rig1/pose_fusion"] {
            assert_eq!(found(&with(node), 5.04e-5, false), of(5e-5));
            assert_eq!(found(&with(node), 5.04e-5, true), of(5e-5));
            assert_eq!(found(&with(node), 2e-3, false), of(2e-3));
            assert_eq!(found(&with(node), 2e-3, true), None, "the file's is better");
            assert_eq!(found(&with(node), 5.2e-4, false), None, "nearly the same");
        }
        assert_eq!(found(&with("/rig2/pose_fusion"), 5e-5, false), None);
        assert_eq!(found(&with("/pose_fusion"), 5e-5, false), None, "rig1's node does not read it");
    }

    #[test]
    fn the_value_that_the_nodes_read_changes_or_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.yaml");
        let of = |node: &str| format!("{node}: {{ros__parameters: {{a: 1.0}}}}\n");
        let update = |blocks: &[&str], node: &str, namespace: Option<&str>| {
            let text: String = blocks.iter().map(|block| of(block)).collect();
            fs::write(&file, &text).unwrap();
            let setting = Setting { node: node.into(), name: "a".into(), value: number(2.0, 1) };
            let updated = update(&file, None, false, &[setting], namespace);
            let after = fs::read_to_string(&file).unwrap();
            match updated {
                Ok(_) => Ok(ParameterFile::parse(&after).unwrap()),
                Err(error) => {
                    assert_eq!(after, text);
                    Err(format!("{error:#}"))
                }
            }
        };
        let both = [FUSION, "/rig1/pose_fusion"];
        for (blocks, node, namespace, named) in [
            (&["/**", FUSION][..], RIG, Some(""), "/pose_fusion"),
            (&["/**", "/imu_driver"], RIG, None, "/imu_driver"),
            (&["/**", "/rig1/**"], RIG, Some("rig1"), "/rig1/marker_tracker"),
            (&["/**", "/rig1/**"], RIG, None, "/rig1/marker_tracker"),
            (&both, FUSION, None, "/rig1/pose_fusion"),
            (&[FUSION, "/rig1/**"], FUSION, None, "/rig1/pose_fusion"),
        ] {
            let error = update(blocks, node, namespace).unwrap_err();
            assert!(error.contains(&format!("another `a` for {named},")), "{error}");
        }
        for (blocks, node, namespace, read) in [
            (&["/**", "/rig1/**"][..], RIG, Some(""), "/pose_fusion"),
            (&["/**", "/rig2/pose_fusion"], RIG, Some("rig1"), "/rig1/pose_fusion"),
            (&both, "/rig1/pose_fusion", Some("rig1"), "/rig1/pose_fusion"),
            (&[FUSION, "/rig1/**"], "/rig1/pose_fusion", Some("rig1"), "/rig1/pose_fusion"),
            (&[FUSION, "/pose_fusion"], "/rig1/pose_fusion", Some("rig1"), "/rig1/pose_fusion"),
        ] {
            let after = update(blocks, node, namespace).unwrap();
            assert_eq!(after.for_node(read)["a"], number(2.0, 1), "{blocks:?}");
        }
    }
}
