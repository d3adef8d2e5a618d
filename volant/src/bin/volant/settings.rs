//! Configuration of a replay's cores: that of the nodes with the same files.

use crate::{terminal, up};
use anyhow::Context;
use climber_driver::node::{ClimberNode, ClimberParameters};
use imu_driver::node::ImuNode;
use marker_tracker::node::MarkerTrackerNode;
use node_kit::{
    NodeName, ParameterSet, RosArguments,
    node::NodeShell,
    parameters::{ParameterError, ParameterMap, ParameterStore},
};
use pose_fusion::node::FusionNode;
use rig_model::{Rig, rig::did_you_mean, topics};
use std::path::{Path, PathBuf};
use volant::{
    command_line::namespace,
    replay::{Cores, Remap, TopicNames},
};

/// Where the rig's topics are in a bag.
#[derive(clap::Args, Default)]
pub struct BagTopics {
    /// Namespace of the rig's topics in the bag
    #[arg(long, default_value = "", value_parser = namespace)]
    pub namespace: String,
    /// Remap a topic, FROM:=TO; repeatable
    #[arg(long, value_name = "FROM:=TO", value_parser = remap)]
    pub remap: Vec<Remap>,
}

/// Parses a remap of one of the rig's topics.
fn remap(text: &str) -> Result<Remap, String> {
    let remap: Remap = text.parse()?;
    let from = remap.from().trim_start_matches('/');
    let is_ours =
        |topic: &&str| from.strip_suffix(*topic).is_some_and(|n| n.is_empty() || n.ends_with('/'));
    if topics::ALL.iter().any(is_ours) {
        return Ok(remap);
    }
    let hint = did_you_mean(from, topics::ALL.iter().copied());
    Err(format!("`{from}` is no topic of a rig{hint}; write the rig's name first"))
}

impl BagTopics {
    /// Returns the names.
    pub fn names(&self) -> TopicNames {
        TopicNames::new(&self.namespace, &self.remap)
    }
}

/// The files of a rig's nodes, for the nodes of one namespace.
struct Files<'a> {
    ros: RosArguments,
    paths: Vec<&'a Path>,
    namespace: String,
}

/// Reads the configuration of a namespace's nodes; later files override earlier ones.
///
/// # Errors
/// What a live node rejects, in its words: an unreadable file, an unknown or invalid parameter;
/// and a block for a mistyped node's name. Of `imu_driver` too, whose output is in the bag. An
/// unknown parameter for all nodes, in a file that other nodes share, is a warning as of a live
/// node.
pub fn read(path: &Path, more: &[PathBuf], topics: &BagTopics) -> anyhow::Result<Cores> {
    let files = Files::read(path, more, &topics.namespace)?;
    let (tracker, _) = files.of::<MarkerTrackerNode>()?;
    let (fusion, values) = files.of::<FusionNode>()?;
    let climber = ClimberParameters::from_map(files.store::<ClimberNode>()?.values());
    files.of::<ImuNode>()?;
    // The same for each node: of the others' parameters none is reported.
    let ignored: Vec<String> = files.store::<FusionNode>()?.ignored().collect();
    // Where a key is missing, one of those may be its misspelling.
    let rig = Rig::from_parameters(&values).with_context(|| files.names());
    let rig = terminal::with_losses(rig, &ignored)?;
    let climber = match climber {
        Err(error) if !matches!(error, ParameterError::Missing { .. }) => {
            return Err(error).with_context(|| files.context::<ClimberNode>());
        }
        // A replay may do without it.
        climber => climber.map(|c| c.config()).map_err(|e| files.in_the_rig_file(e).to_string()),
    };
    let (tracker, names) = (tracker.config(&rig), topics.names());
    Ok(Cores { rig, tracker, climber, fusion: fusion.core, names })
}

/// Rejects what a live node rejects in a rig file, except for missing keys.
///
/// # Errors
/// As [`read`].
pub fn check_given(path: &Path) -> anyhow::Result<()> {
    let files = Files::read(path, &[], "")?;
    files.store::<MarkerTrackerNode>()?;
    files.store::<FusionNode>()?;
    files.store::<ClimberNode>()?;
    files.store::<ImuNode>().map(drop)
}

impl<'a> Files<'a> {
    fn read(path: &'a Path, more: &'a [PathBuf], namespace: &str) -> anyhow::Result<Self> {
        let mut ros = RosArguments::default();
        ros.add_file(path.to_owned()).context("not a usable rig file")?;
        more.iter().try_for_each(|file| ros.add_file(file.clone()))?;
        ros.allow_of_others(up::parameters());
        let paths = std::iter::once(path).chain(more.iter().map(PathBuf::as_path)).collect();
        Ok(Self { ros, paths, namespace: format!("/{}", namespace.trim_matches('/')) })
    }

    fn of<S: NodeShell>(&self) -> anyhow::Result<(S::Parameters, ParameterMap)> {
        let store = self.store::<S>()?;
        let set = S::Parameters::from_map(store.values()).map_err(|e| self.in_the_rig_file(e));
        Ok((set.with_context(|| self.context::<S>())?, store.values().clone()))
    }

    fn store<S: NodeShell>(&self) -> anyhow::Result<ParameterStore> {
        let name = NodeName::new(&self.namespace, S::NAME)?;
        if let Some(mistyped) = self.ros.check_node_names(&name, S::NAME)?.into_iter().next() {
            return Err(mistyped.into());
        }
        self.ros.declare::<S::Parameters>(&name).with_context(|| self.context::<S>())
    }

    /// The remedy for a missing parameter without the options of a live node, which the commands
    /// over a bag lack.
    fn in_the_rig_file(&self, error: ParameterError) -> ParameterError {
        match error {
            ParameterError::Missing { name, description } => {
                let path = self.paths[0].display();
                ParameterError::Invalid(format!(
                    "the parameter `{name}` must be given. {description} Set it in {path}"
                ))
            }
            error => error,
        }
    }

    fn context<S: NodeShell>(&self) -> String {
        format!("{}: {}", self.names(), S::NAME)
    }

    fn names(&self) -> String {
        let names: Vec<_> = self.paths.iter().map(|p| p.display().to_string()).collect();
        names.join(", ")
    }
}
