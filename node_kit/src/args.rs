//! The part of a command line that ROS 2 owns: everything between `--ros-args` and `--` (or the end).
//!
//! `ros2 launch` appends it to every node that it starts, sometimes twice.

use crate::{
    level::Level,
    names::{NameError, NodeName, Remap},
};
use rig_model::parameters::{ParameterFile, ParameterFileError, ParameterMap, ParameterValue, parse_value};
use std::{collections::BTreeSet, path::PathBuf};
use thiserror::Error;

/// Why a command line cannot be used. All of them are the caller's mistake: exit status 2, but for a parameter file
/// that cannot be read ([`ArgumentError::is_usage`]).
#[derive(Debug, Error)]
pub enum ArgumentError {
    /// An option without its value.
    #[error("`{option}` needs {expected} after it")]
    MissingValue {
        /// The option.
        option: String,
        /// What belongs after it.
        expected: &'static str,
    },
    /// A rule, assignment or level that cannot be read.
    #[error("`{option} {text}` is not understood; expected {expected}")]
    Malformed {
        /// The option.
        option: String,
        /// The text after it.
        text: String,
        /// What belongs after it.
        expected: &'static str,
    },
    /// An option that ROS 2 does not have.
    #[error("`{option}` is not an option of --ros-args")]
    UnknownOption {
        /// The option.
        option: String,
    },
    /// An argument outside of `--ros-args` that the program does not have.
    #[error("`{argument}` is not known{hint}")]
    UnknownArgument {
        /// The argument.
        argument: String,
        /// ` (did you mean …?)` or nothing.
        hint: String,
    },
    /// A parameter file that cannot be opened.
    #[error("the parameter file {path}: {source}")]
    Unreadable {
        /// The path as given.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A parameter file that is none.
    #[error("the parameter file {path}: {source}")]
    ParameterFile {
        /// The path as given.
        path: PathBuf,
        /// What is wrong with it.
        source: ParameterFileError,
    },
    /// A value after `-p` that no parameter can hold.
    #[error("`-p {text}`: {source}")]
    ParameterValue {
        /// The text after `-p`.
        text: String,
        /// What is wrong with it.
        source: ParameterFileError,
    },
    /// A node name or namespace that cannot be.
    #[error(transparent)]
    Name(#[from] NameError),
}

impl ArgumentError {
    /// Is the command line itself wrong (exit status 2), rather than a file that it names (1)?
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Unreadable { .. } | Self::ParameterFile { .. })
    }
}

/// One source of parameter values, in the order of the command line: later ones override earlier ones.
#[derive(Clone, Debug, PartialEq)]
enum ParameterSource {
    File { path: PathBuf, file: ParameterFile },
    Value { node: Option<String>, name: String, value: ParameterValue },
}

/// What `--ros-args` said.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RosArguments {
    remaps: Vec<Remap>,
    sources: Vec<ParameterSource>,
    levels: Vec<(Option<String>, Level)>,
    rosout: Option<bool>,
    of_others: BTreeSet<String>,
    enclave: Option<String>,
}

/// A parameter's value and where it came from.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// The value.
    pub value: ParameterValue,
    /// `-p` or the file's name, for messages.
    pub origin: String,
}

impl RosArguments {
    /// Splits a command line (without the program's name) into ROS 2's part and the rest.
    ///
    /// # Errors
    /// See [`ArgumentError`]. Parameter files are read here.
    pub fn parse(
        arguments: impl IntoIterator<Item = String>,
    ) -> Result<(RosArguments, Vec<String>), ArgumentError> {
        let mut ros = RosArguments::default();
        let mut rest = Vec::new();
        let mut inside = false;
        let mut arguments = arguments.into_iter();
        while let Some(argument) = arguments.next() {
            if !inside {
                if argument == "--ros-args" {
                    inside = true;
                } else {
                    rest.push(argument);
                }
                continue;
            }
            let mut value = |expected| {
                arguments
                    .next()
                    .ok_or_else(|| ArgumentError::MissingValue { option: argument.clone(), expected })
            };
            match argument.as_str() {
                "--" => inside = false,
                "--ros-args" => {}
                "-r" | "--remap" => ros.add_remap(&argument, &value(REMAP)?)?,
                "-p" | "--param" => ros.add_value(&argument, &value(ASSIGNMENT)?)?,
                "--params-file" => ros.add_file(value("the path of a parameter file")?.into())?,
                "--log-level" => ros.add_level(&argument, &value(LEVEL)?)?,
                "--enable-rosout-logs" => ros.rosout = Some(true),
                "--disable-rosout-logs" => ros.rosout = Some(false),
                // rcl has them; there is nothing here that they could change.
                "--enable-stdout-logs"
                | "--disable-stdout-logs"
                | "--enable-external-lib-logs"
                | "--disable-external-lib-logs" => {}
                "-e" | "--enclave" => ros.enclave = Some(value("the name of an enclave")?),
                "--log-config-file" | "--log-file-name" => {
                    value("a value")?;
                }
                _ => return Err(ArgumentError::UnknownOption { option: argument }),
            }
        }
        Ok((ros, rest))
    }

    /// The enclave that the process is in, where it was named.
    pub fn enclave(&self) -> Option<&str> {
        self.enclave.as_deref()
    }

    fn add_remap(&mut self, option: &str, text: &str) -> Result<(), ArgumentError> {
        let malformed =
            || ArgumentError::Malformed { option: option.to_owned(), text: text.to_owned(), expected: REMAP };
        let (from, to) = text.split_once(":=").ok_or_else(malformed)?;
        if from.is_empty() || to.is_empty() {
            return Err(malformed());
        }
        let (node, from) = split_node(from);
        self.remaps.push(Remap { node, from: from.to_owned(), to: to.to_owned() });
        Ok(())
    }

    fn add_value(&mut self, option: &str, text: &str) -> Result<(), ArgumentError> {
        let malformed = || ArgumentError::Malformed {
            option: option.to_owned(),
            text: text.to_owned(),
            expected: ASSIGNMENT,
        };
        let (name, value) = text.split_once(":=").ok_or_else(malformed)?;
        let (node, name) = split_node(name);
        if name.is_empty() {
            return Err(malformed());
        }
        let value = parse_value(name, value)
            .map_err(|source| ArgumentError::ParameterValue { text: text.to_owned(), source })?;
        self.sources.push(ParameterSource::Value { node, name: name.to_owned(), value });
        Ok(())
    }

    /// Adds a parameter file, as `--params-file` does.
    ///
    /// # Errors
    /// The file cannot be read or is no parameter file.
    pub fn add_file(&mut self, path: PathBuf) -> Result<(), ArgumentError> {
        let text = crate::files::read_text(&path)
            .map_err(|source| ArgumentError::Unreadable { path: path.clone(), source })?;
        let file = ParameterFile::parse(&text)
            .map_err(|source| ArgumentError::ParameterFile { path: path.clone(), source })?;
        self.sources.push(ParameterSource::File { path, file });
        Ok(())
    }

    /// Sets a parameter for every node, as `-p` does.
    pub fn set(&mut self, name: &str, value: ParameterValue) {
        self.sources.push(ParameterSource::Value { node: None, name: name.to_owned(), value });
    }

    /// Names the parameters of other nodes of this process, so that one that is given for all nodes is no typing mistake to
    /// those that do not have it.
    pub fn allow_of_others(&mut self, names: impl IntoIterator<Item = String>) {
        self.of_others.extend(names);
    }

    /// Is this a parameter of another node of this process?
    pub fn is_of_others(&self, name: &str) -> bool {
        self.of_others.contains(name)
    }

    /// Adds a remap for every node, as `-r` does; `__ns` and `__node` are names too.
    pub fn remap(&mut self, from: &str, to: &str) {
        self.remaps.push(Remap { node: None, from: from.to_owned(), to: to.to_owned() });
    }

    fn add_level(&mut self, option: &str, text: &str) -> Result<(), ArgumentError> {
        let (logger, level) = match text.split_once(":=") {
            Some((logger, level)) => (Some(logger.to_owned()), level),
            None => (None, text),
        };
        let level = level.parse().map_err(|()| ArgumentError::Malformed {
            option: option.to_owned(),
            text: text.to_owned(),
            expected: LEVEL,
        })?;
        self.levels.push((logger, level));
        Ok(())
    }

    /// The node's name: `__node` and `__ns` over the default name in `/`.
    ///
    /// # Errors
    /// A name that cannot be.
    pub fn node_name(&self, default: &str) -> Result<NodeName, NameError> {
        let find = |key: &str| {
            self.remaps
                .iter()
                .find(|r| r.from == key && r.node.as_deref().is_none_or(|n| n == default))
                .map(|r| r.to.as_str())
        };
        NodeName::new(
            find("__ns").unwrap_or("/"),
            find("__node").or_else(|| find("__name")).unwrap_or(default),
        )
    }

    /// The rules for topics and services.
    pub fn remaps(&self) -> Vec<Remap> {
        self.remaps.iter().filter(|r| !r.from.starts_with("__")).cloned().collect()
    }

    /// The least severe level that is said; [`Level::Info`] by default.
    pub fn level(&self, node: &NodeName) -> Level {
        let logger = node.fully_qualified().trim_start_matches('/').replace('/', ".");
        self.levels
            .iter()
            .rev()
            .find(|(name, _)| name.as_deref().is_none_or(|n| n == logger || n == node.base()))
            .map_or(Level::Info, |(_, level)| *level)
    }

    /// Are lines of the log published on `/rosout`?
    pub fn rosout(&self) -> bool {
        self.rosout.unwrap_or(true)
    }

    /// The values given for this node, later sources over earlier ones. Each comes with its origin.
    pub fn overrides(&self, node: &NodeName) -> std::collections::BTreeMap<String, Override> {
        let mut all = std::collections::BTreeMap::new();
        for source in &self.sources {
            match source {
                ParameterSource::File { path, file } => {
                    let origin = path.display().to_string();
                    all.extend(
                        file.for_node(&node.fully_qualified())
                            .into_iter()
                            .map(|(name, value)| (name, Override { value, origin: origin.clone() })),
                    );
                }
                ParameterSource::Value { node: only, name, value } => {
                    if only.as_deref().is_none_or(|n| n == node.base()) {
                        all.insert(name.clone(), Override { value: value.clone(), origin: "-p".to_owned() });
                    }
                }
            }
        }
        all
    }

    /// [`RosArguments::overrides`] without the origins.
    pub fn values(&self, node: &NodeName) -> ParameterMap {
        self.overrides(node).into_iter().map(|(name, o)| (name, o.value)).collect()
    }
}

const REMAP: &str = "`from:=to` (or `__node:=name`, `__ns:=/namespace`)";
const ASSIGNMENT: &str = "`name:=value`";
const LEVEL: &str = "debug, info, warn, error or fatal (or `logger:=level`)";

/// `node:rest`; the `:` of `rostopic://` is none of a node.
fn split_node(text: &str) -> (Option<String>, &str) {
    match text.split_once(':') {
        Some((node, rest)) if !rest.starts_with("//") => (Some(node.to_owned()), rest),
        _ => (None, text),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::names::resolve;

    fn words(text: &str) -> Vec<String> {
        text.split_whitespace().map(str::to_owned).collect()
    }

    #[test]
    fn what_launch_passes_is_understood() {
        let folder = std::env::temp_dir().join(format!("volant_args_{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (a, b) = (folder.join("a.yaml"), folder.join("b.yaml"));
        std::fs::write(
            &a,
            "/**: {ros__parameters: {sub: {x: 1}, y: 2, z: 3}}\nother: {ros__parameters: {y: 9}}",
        )
        .unwrap();
        std::fs::write(&b, "/robot1/est: {ros__parameters: {y: 5}}").unwrap();
        let line = format!(
            "--custom x --ros-args --log-level debug --ros-args -r __node:=est -r __ns:=/robot1 --params-file {} \
             --params-file {} -r /imu:=/sensors/imu -r pose:=~/pose -p z:=4.5 -p other:y:=7 -- tail",
            a.display(),
            b.display()
        );
        let (ros, rest) = RosArguments::parse(words(&line)).unwrap();
        assert_eq!(rest, words("--custom x tail"));
        let node = ros.node_name("pose_fusion").unwrap();
        assert_eq!(node.fully_qualified(), "/robot1/est");
        assert_eq!(ros.level(&node), Level::Debug);
        let values = ros.values(&node);
        assert_eq!(values["sub.x"], ParameterValue::Integer(1));
        assert_eq!(values["y"], ParameterValue::Integer(5));
        assert_eq!(values["z"], ParameterValue::Double(4.5));
        assert_eq!(ros.overrides(&node)["y"].origin, b.display().to_string());
        assert_eq!(resolve(&node, &ros.remaps(), "pose").unwrap(), "/robot1/est/pose");
        assert_eq!(resolve(&node, &ros.remaps(), "/imu").unwrap(), "/sensors/imu");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn each_mistake_is_named() {
        for (line, needle, usage) in [
            ("--ros-args -r", "-r", true),
            ("--ros-args -r a", "from:=to", true),
            ("--ros-args -p a", "name:=value", true),
            ("--ros-args -p a:={b:1", "-p a", true),
            ("--ros-args --log-level loud", "loud", true),
            ("--ros-args --bogus", "--bogus", true),
            ("--ros-args --params-file /no/such.yaml", "/no/such.yaml", false),
        ] {
            let error = RosArguments::parse(words(line)).unwrap_err();
            assert!(error.to_string().contains(needle), "{line}: {error}");
            assert_eq!(error.is_usage(), usage, "{line}");
        }
    }

    #[test]
    fn node_prefixes_limit_rules_to_one_node_of_a_process() {
        let (ros, _) = RosArguments::parse(words("--ros-args -r a:__node:=first -r b:__ns:=/two")).unwrap();
        assert_eq!(ros.node_name("a").unwrap().fully_qualified(), "/first");
        assert_eq!(ros.node_name("b").unwrap().fully_qualified(), "/two/b");
    }
}
