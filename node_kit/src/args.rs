//! ROS 2's part of a command line: everything between `--ros-args` and `--` (or the end).
//!
//! `ros2 launch` appends it to every node that it starts, sometimes twice.

use crate::{
    level::Level,
    names::{NameError, NodeName, Remap},
    parameters::{ParameterError, ParameterSet, ParameterStore, common_descriptors},
};
use rig_model::rig::edit_distance;
use ros_parameters::{ParameterFile, ParameterValue, parse_value};
use std::{
    collections::{BTreeMap, BTreeSet},
    path::PathBuf,
};

mod error;

pub use error::ArgumentError;

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
    /// Values of the program's own options.
    own: Vec<ParameterSource>,
    levels: Vec<(Option<String>, Level)>,
    outputs: LogOutputs,
    of_others: BTreeSet<String>,
    enclave: Option<String>,
}

/// Where the log goes.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct LogOutputs {
    /// `--disable-rosout-logs`: not to `/rosout`.
    pub no_rosout: bool,
    /// `--disable-stdout-logs`: not to the console.
    pub no_console: bool,
    /// `--disable-external-lib-logs`: not to a file.
    pub no_file: bool,
    /// `--log-file-name`: beginning of the file's name.
    pub file_name: Option<String>,
}

/// A parameter's value and its origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Override {
    /// The value.
    pub value: ParameterValue,
    /// `-p` or the file's name, for messages.
    pub origin: String,
    /// Given for all nodes where others share the file or the process: it may be another node's
    /// parameter.
    pub shared: bool,
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
                arguments.next().ok_or_else(|| ArgumentError::no_value(&argument, expected))
            };
            match argument.as_str() {
                "--" => inside = false,
                "--ros-args" => {}
                "-r" | "--remap" => ros.add_remap(&argument, &value(REMAP)?)?,
                "-p" | "--param" => ros.add_value(&argument, &value(ASSIGNMENT)?)?,
                "--params-file" => ros.add_file(value("the path of a parameter file")?.into())?,
                "--log-level" => ros.add_level(&argument, &value(LEVEL)?)?,
                "--enable-rosout-logs" => ros.outputs.no_rosout = false,
                "--disable-rosout-logs" => ros.outputs.no_rosout = true,
                "--enable-stdout-logs" => ros.outputs.no_console = false,
                "--disable-stdout-logs" => ros.outputs.no_console = true,
                "--enable-external-lib-logs" => ros.outputs.no_file = false,
                "--disable-external-lib-logs" => ros.outputs.no_file = true,
                "--log-file-name" => {
                    ros.outputs.file_name = Some(value("a file name's beginning")?)
                }
                "-e" | "--enclave" => ros.enclave = Some(value("the name of an enclave")?),
                // A configuration of spdlog, which writes rcl's log file.
                "--log-config-file" => {
                    value("a value")?;
                }
                _ => {
                    let unknown = format!("`{argument}` is not an option of --ros-args");
                    return Err(ArgumentError::usage(unknown));
                }
            }
        }
        Ok((ros, rest))
    }

    /// The security enclave (`--enclave`), if given.
    pub fn enclave(&self) -> Option<&str> {
        self.enclave.as_deref()
    }

    /// Where the log goes.
    #[cfg(feature = "dds")]
    pub(crate) fn log_outputs(&self) -> &LogOutputs {
        &self.outputs
    }

    fn add_remap(&mut self, option: &str, text: &str) -> Result<(), ArgumentError> {
        let (from, to) = text
            .split_once(":=")
            .filter(|(from, to)| !from.is_empty() && !to.is_empty())
            .ok_or_else(|| ArgumentError::malformed(option, text, REMAP))?;
        let (node, from) = split_node(option, text, from)?;
        self.remaps.push(Remap { node, from: from.to_owned(), to: to.to_owned() });
        Ok(())
    }

    fn add_value(&mut self, option: &str, text: &str) -> Result<(), ArgumentError> {
        let malformed = || ArgumentError::malformed(option, text, ASSIGNMENT);
        let (name, value) = text.split_once(":=").ok_or_else(malformed)?;
        let (node, name) = split_node(option, text, name)?;
        if name.is_empty() {
            return Err(malformed());
        }
        let value = parse_value(name, value)
            .map_err(|error| ArgumentError::usage(format!("`-p {text}`: {error}")))?;
        self.sources.push(ParameterSource::Value { node, name: name.to_owned(), value });
        Ok(())
    }

    /// Adds a parameter file, as `--params-file` does.
    ///
    /// # Errors
    /// The file is not readable, or not a parameter file.
    pub fn add_file(&mut self, path: PathBuf) -> Result<(), ArgumentError> {
        let text =
            crate::files::read_text(&path).map_err(|error| ArgumentError::file(&path, error))?;
        let file =
            ParameterFile::parse(&text).map_err(|error| ArgumentError::file(&path, error))?;
        self.sources.push(ParameterSource::File { path, file });
        Ok(())
    }

    /// Sets a parameter for every node, as `-p` does.
    pub fn set(&mut self, name: &str, value: ParameterValue) {
        self.sources.push(ParameterSource::Value { node: None, name: name.to_owned(), value });
    }

    /// Adds what a program's own options give (`--rig FILE`, `--port VALUE`) below `--ros-args`.
    ///
    /// Its files are below the files there. Its values override every file, because a launch file
    /// passes the rig file in `--ros-args`; a value is not used where a `-p` for the node gives
    /// another one.
    #[must_use]
    pub fn over(mut self, own: Self) -> Self {
        let is_file = |source: &ParameterSource| matches!(source, ParameterSource::File { .. });
        let (files, values): (Vec<_>, Vec<_>) = own.sources.into_iter().partition(is_file);
        let above = std::mem::replace(&mut self.sources, files);
        self.sources.extend(above);
        let above = std::mem::replace(&mut self.own, own.own);
        self.own.extend(values.into_iter().chain(above));
        self
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
        let level = level.parse().map_err(|()| ArgumentError::malformed(option, text, LEVEL))?;
        self.levels.push((logger, level));
        Ok(())
    }

    /// The node's name: `__node` and `__ns`, else `default` in `/`.
    ///
    /// # Errors
    /// [`NameError`] for an invalid name.
    pub fn node_name(&self, default: &str) -> Result<NodeName, NameError> {
        let find = |key: &str, node: &str| {
            self.remaps
                .iter()
                .find(|r| r.from == key && r.node.as_deref().is_none_or(|n| n == node))
                .map(|r| r.to.as_str())
        };
        let name = find("__node", default).or_else(|| find("__name", default)).unwrap_or(default);
        // As in rcl, the namespace's rule is for the name after its own remap.
        NodeName::new(find("__ns", name).unwrap_or("/"), name)
    }

    /// The remaps of topics and services.
    pub fn remaps(&self) -> Vec<Remap> {
        self.remaps.iter().filter(|r| !r.from.starts_with("__")).cloned().collect()
    }

    /// The lowest level that is logged: that of the node's logger, else that of all;
    /// [`Level::Info`] by default.
    pub fn level(&self, node: &NodeName) -> Level {
        let logger = node.fully_qualified().trim_start_matches('/').replace('/', ".");
        let is_own = |name: &str| name == logger || name == node.base();
        let mut latest = self.levels.iter().rev();
        latest
            .clone()
            .find(|(name, _)| name.as_deref().is_some_and(is_own))
            .or_else(|| latest.find(|(name, _)| name.is_none()))
            .map_or(Level::Info, |(_, level)| *level)
    }

    /// Checks the node selectors of parameter files, of `-p` and of `-r` for mistyped forms of
    /// `kind`, the name of a node's program. Other names are those of other nodes: longer ones
    /// (`pose_fusion_2`), and those with a digit. Returns those in files that other programs share:
    /// `ins_driver` may be another node beside `imu_driver`.
    ///
    /// # Errors
    /// The first mistyped name.
    pub fn check_node_names(
        &self,
        node: &NodeName,
        kind: &str,
    ) -> Result<Vec<ArgumentError>, ArgumentError> {
        // Two letters exchanged are two edits; short names differ by as much from each other.
        let limit = (kind.len() / 4).min(2);
        let mistyped = |selector: &&str| {
            let name = selector.rsplit('/').next().unwrap_or_default();
            name != node.base()
                && !name.starts_with(kind)
                && !name.contains(|c: char| c.is_ascii_digit() || c == '*')
                && edit_distance(&name.to_ascii_lowercase(), kind) <= limit
        };
        let mut doubtful = vec![];
        for source in &self.sources {
            let ParameterSource::File { path, file } = source else { continue };
            for selector in file.selectors().filter(mistyped) {
                let unknown = ArgumentError::file(
                    path,
                    format!(
                        "the block `{selector}` matches no node (did you mean `{kind}`?); \
                         correct its spelling"
                    ),
                );
                if Self::is_own(file, node) {
                    return Err(unknown);
                }
                doubtful.push(unknown);
            }
        }
        let of_values = self.sources.iter().filter_map(|source| match source {
            ParameterSource::Value { node, .. } => node.as_deref(),
            ParameterSource::File { .. } => None,
        });
        let of_remaps = self.remaps.iter().filter_map(|remap| remap.node.as_deref());
        match of_values.chain(of_remaps).find(mistyped) {
            Some(selector) => Err(ArgumentError::usage(format!(
                "`{selector}:` matches no node (did you mean `{kind}:`?); correct its spelling"
            ))),
            None => Ok(doubtful),
        }
    }

    /// Whether a file belongs to this project, as a rig file does: what it does not know is a
    /// mistake.
    fn is_own(file: &ParameterFile, node: &NodeName) -> bool {
        file.for_node(&node.fully_qualified()).contains_key(RIG_KEY)
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
        overrides.retain(|name, given| {
            let of_another = given.shared && self.of_others.contains(name);
            !of_another || descriptors.iter().any(|d| d.name == *name)
        });
        ParameterStore::new(descriptors, overrides)
    }

    /// The values given for this node with their origins; later sources override earlier ones.
    pub(crate) fn overrides(&self, node: &NodeName) -> BTreeMap<String, Override> {
        let is_for = |only: &Option<String>| only.as_deref().is_none_or(|n| n == node.base());
        let is_replaced = |own: &ParameterSource| {
            let ParameterSource::Value { name: own, .. } = own else { return false };
            self.sources.iter().any(|source| match source {
                ParameterSource::Value { node: only, name, .. } => name == own && is_for(only),
                ParameterSource::File { .. } => false,
            })
        };
        let own = self.own.iter().filter(|own| !is_replaced(own));
        let mut all = BTreeMap::new();
        for source in self.sources.iter().chain(own) {
            match source {
                ParameterSource::File { path, file } => {
                    let own = Self::is_own(file, node);
                    let (origin, node) = (path.display().to_string(), node.fully_qualified());
                    all.extend(file.for_node(&node).into_iter().map(|(name, value)| {
                        let shared = (!own || self.of_others.contains(&name))
                            && file.is_for_all(&node, &name);
                        (name, Override { value, origin: origin.clone(), shared })
                    }));
                }
                ParameterSource::Value { node: only, name, value } => {
                    if is_for(only) {
                        all.insert(
                            name.clone(),
                            Override {
                                value: value.clone(),
                                origin: "-p".to_owned(),
                                shared: only.is_none() && self.of_others.contains(name),
                            },
                        );
                    }
                }
            }
        }
        all
    }
}

/// Key that every rig file has.
const RIG_KEY: &str = "markers.size";
const REMAP: &str = "`from:=to` (or `__node:=name`, `__ns:=/namespace`)";
const ASSIGNMENT: &str = "`name:=value`";
const LEVEL: &str = "debug, info, warn, error or fatal (or `logger:=level`)";

const NODE: &str = "a node's name without a namespace or wildcard before the `:`";

/// Splits `node:rest` in the `text` of an option; the `:` of `rostopic://` separates no node.
fn split_node<'a>(
    option: &str,
    text: &str,
    rule: &'a str,
) -> Result<(Option<String>, &'a str), ArgumentError> {
    match rule.split_once(':') {
        Some((node, rest)) if !rest.starts_with("//") => {
            NodeName::new("/", node).map_err(|_| ArgumentError::malformed(option, text, NODE))?;
            Ok((Some(node.to_owned()), rest))
        }
        _ => Ok((None, rule)),
    }
}

#[cfg(test)]
mod tests;
