//! ROS 2's part of a command line: everything between `--ros-args` and `--` (or the end).
//!
//! `ros2 launch` appends it to every node that it starts, sometimes twice.

use crate::{
    level::Level,
    names::{NameError, NodeName, Remap},
    parameters::{ParameterError, ParameterSet, ParameterStore, common_descriptors},
};
use rig_model::rig::edit_distance;
use ros_parameters::{
    ParameterFile, ParameterFileError, ParameterMap, ParameterValue, parse_value,
};
use std::{collections::BTreeSet, path::PathBuf};
use thiserror::Error;

/// An invalid command line (exit status 2), or an unusable parameter file (exit status 1; see
/// [`ArgumentError::is_usage`]).
#[derive(Debug, Error)]
pub enum ArgumentError {
    /// An option without a value.
    #[error("`{option}` needs {expected} after it")]
    MissingValue {
        /// The option.
        option: String,
        /// The expected value.
        expected: &'static str,
    },
    /// A malformed rule, assignment or level.
    #[error("`{option} {text}` is not understood; expected {expected}")]
    Malformed {
        /// The option.
        option: String,
        /// The text after it.
        text: String,
        /// The expected value.
        expected: &'static str,
    },
    /// An option that ROS 2 does not have.
    #[error("`{option}` is not an option of --ros-args")]
    UnknownOption {
        /// The option.
        option: String,
    },
    /// An unknown argument outside of `--ros-args`.
    #[error("`{argument}` is not known{hint}")]
    UnknownArgument {
        /// The argument.
        argument: String,
        /// ` (did you mean …?)` or nothing.
        hint: String,
    },
    /// A parameter file that cannot be read.
    #[error("the parameter file {path}: {source}")]
    Unreadable {
        /// The path as given.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A malformed parameter file.
    #[error("the parameter file {path}: {source}")]
    ParameterFile {
        /// The path as given.
        path: PathBuf,
        /// What is wrong with it.
        source: ParameterFileError,
    },
    /// A block of a parameter file whose node's name is a typing mistake.
    #[error(
        "the parameter file {path}: the block `{selector}` matches no node (did you mean \
         `{name}`?); correct its spelling"
    )]
    UnknownNode {
        /// The path as given.
        path: PathBuf,
        /// The node selector.
        selector: String,
        /// The node's name.
        name: String,
    },
    /// A malformed value after `-p`.
    #[error("`-p {text}`: {source}")]
    ParameterValue {
        /// The text after `-p`.
        text: String,
        /// What is wrong with it.
        source: ParameterFileError,
    },
    /// An invalid node name or namespace.
    #[error(transparent)]
    Name(#[from] NameError),
}

impl ArgumentError {
    /// Returns whether the command line itself is wrong (exit status 2) rather than a file that it
    /// names (1).
    pub fn is_usage(&self) -> bool {
        !matches!(
            self,
            Self::Unreadable { .. } | Self::ParameterFile { .. } | Self::UnknownNode { .. }
        )
    }
}

/// One source of parameter values, in the order of the command line: later ones override earlier
/// ones.
#[derive(Clone, Debug, PartialEq)]
enum ParameterSource {
    File { path: PathBuf, file: ParameterFile },
    Value { node: Option<String>, name: String, value: ParameterValue },
}

/// Parsed `--ros-args`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RosArguments {
    remaps: Vec<Remap>,
    sources: Vec<ParameterSource>,
    levels: Vec<(Option<String>, Level)>,
    rosout: Option<bool>,
    of_others: BTreeSet<String>,
    enclave: Option<String>,
}

/// A parameter's value and its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// The value.
    pub value: ParameterValue,
    /// `-p` or the file's name, for messages.
    pub origin: String,
}

impl RosArguments {
    /// Splits a command line (without the program's name) into ROS 2's part and the rest, and reads
    /// the parameter files.
    ///
    /// # Errors
    /// See [`ArgumentError`].
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
                arguments.next().ok_or_else(|| ArgumentError::MissingValue {
                    option: argument.clone(),
                    expected,
                })
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
                // Options of rcl without a counterpart here.
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

    /// The security enclave (`--enclave`), if given.
    pub fn enclave(&self) -> Option<&str> {
        self.enclave.as_deref()
    }

    fn add_remap(&mut self, option: &str, text: &str) -> Result<(), ArgumentError> {
        let malformed = || ArgumentError::Malformed {
            option: option.to_owned(),
            text: text.to_owned(),
            expected: REMAP,
        };
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
    /// [`ArgumentError::Unreadable`] or [`ArgumentError::ParameterFile`].
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

    /// Names the parameters of other nodes of this process: given for all nodes, they are no typing
    /// mistakes for a node that does not declare them.
    pub fn allow_of_others(&mut self, names: impl IntoIterator<Item = String>) {
        self.of_others.extend(names);
    }

    /// Adds a remap for every node, as `-r` does; `from` may be `__ns` or `__node`.
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

    /// The node's name: `__node` and `__ns`, else `default` in `/`.
    ///
    /// # Errors
    /// [`NameError`] for an invalid name.
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

    /// The remaps of topics and services.
    pub fn remaps(&self) -> Vec<Remap> {
        self.remaps.iter().filter(|r| !r.from.starts_with("__")).cloned().collect()
    }

    /// The lowest level that is logged; [`Level::Info`] by default.
    pub fn level(&self, node: &NodeName) -> Level {
        let logger = node.fully_qualified().trim_start_matches('/').replace('/', ".");
        self.levels
            .iter()
            .rev()
            .find(|(name, _)| name.as_deref().is_none_or(|n| n == logger || n == node.base()))
            .map_or(Level::Info, |(_, level)| *level)
    }

    /// Returns whether the log is published on `/rosout`.
    pub fn rosout(&self) -> bool {
        self.rosout.unwrap_or(true)
    }

    /// Checks the node selectors of all parameter files for mistyped forms of `kind`, the name of a
    /// node's program. Other names are those of other nodes: longer ones (`pose_fusion_2`), and those
    /// with a digit.
    ///
    /// # Errors
    /// [`ArgumentError::UnknownNode`]
    pub fn check_node_names(&self, node: &NodeName, kind: &str) -> Result<(), ArgumentError> {
        // Two letters exchanged are two edits; short names differ by as much from each other.
        let limit = (kind.len() / 4).min(2);
        for source in &self.sources {
            let ParameterSource::File { path, file } = source else { continue };
            let mistyped = |selector: &&str| {
                let name = selector.rsplit('/').next().unwrap_or_default();
                name != node.base()
                    && !name.starts_with(kind)
                    && !name.contains(|c: char| c.is_ascii_digit() || c == '*')
                    && edit_distance(&name.to_ascii_lowercase(), kind) <= limit
            };
            if let Some(selector) = file.selectors().find(mistyped) {
                return Err(ArgumentError::UnknownNode {
                    path: path.clone(),
                    selector: selector.to_owned(),
                    name: kind.to_owned(),
                });
            }
        }
        Ok(())
    }

    /// Declares a node's parameters, those of every node among them, with the values given for it.
    ///
    /// # Errors
    /// [`ParameterError`] of the first unknown or invalid value.
    pub fn declare<P: ParameterSet>(
        &self,
        node: &NodeName,
    ) -> Result<ParameterStore, ParameterError> {
        let mut descriptors = P::descriptors();
        descriptors.extend(common_descriptors());
        let mut overrides = self.overrides(node);
        overrides.retain(|name, _| {
            !self.of_others.contains(name) || descriptors.iter().any(|d| d.name == *name)
        });
        ParameterStore::new(descriptors, overrides)
    }

    /// The values given for this node with their origins; later sources override earlier ones.
    pub fn overrides(&self, node: &NodeName) -> std::collections::BTreeMap<String, Override> {
        let mut all = std::collections::BTreeMap::new();
        for source in &self.sources {
            match source {
                ParameterSource::File { path, file } => {
                    let origin = path.display().to_string();
                    all.extend(
                        file.for_node(&node.fully_qualified()).into_iter().map(|(name, value)| {
                            (name, Override { value, origin: origin.clone() })
                        }),
                    );
                }
                ParameterSource::Value { node: only, name, value } => {
                    if only.as_deref().is_none_or(|n| n == node.base()) {
                        all.insert(
                            name.clone(),
                            Override { value: value.clone(), origin: "-p".to_owned() },
                        );
                    }
                }
            }
        }
        all
    }

    /// The values given for this node, without their origins.
    pub fn values(&self, node: &NodeName) -> ParameterMap {
        self.overrides(node).into_iter().map(|(name, o)| (name, o.value)).collect()
    }
}

const REMAP: &str = "`from:=to` (or `__node:=name`, `__ns:=/namespace`)";
const ASSIGNMENT: &str = "`name:=value`";
const LEVEL: &str = "debug, info, warn, error or fatal (or `logger:=level`)";

/// Splits `node:rest`; the `:` of `rostopic://` separates no node.
fn split_node(text: &str) -> (Option<String>, &str) {
    match text.split_once(':') {
        Some((node, rest)) if !rest.starts_with("//") => (Some(node.to_owned()), rest),
        _ => (None, text),
    }
}

#[cfg(test)]
mod tests;
