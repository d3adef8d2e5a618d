//! How the cores of a replay are set: as the nodes are, given the same files.

use marker_tracker::TrackerConfig;
use pose_fusion::FusionConfig;
use rig_model::Rig;
#[cfg(feature = "nodes")]
pub use with_nodes::read;

/// What the rig file and parameter files say.
pub struct Settings {
    pub rig: Rig,
    pub tracker: TrackerConfig,
    pub fusion: FusionConfig,
}

impl Settings {
    /// Without a parameter file.
    pub fn of(rig: Rig) -> Self {
        let tracker = TrackerConfig { start_colors: rig.colors, ..TrackerConfig::default() };
        Self { rig, tracker, fusion: FusionConfig::default() }
    }
}

#[cfg(feature = "nodes")]
mod with_nodes {
    use super::{Rig, Settings};
    use crate::up;
    use anyhow::Context;
    use marker_tracker::node::MarkerTrackerNode;
    use node_kit::{
        NodeName, ParameterSet, RosArguments,
        node::NodeShell,
        parameters::{ParameterMap, ParameterStore, common_descriptors},
    };
    use pose_fusion::node::FusionNode;
    use std::path::{Path, PathBuf};

    /// Of the rig file and the parameter files, later ones over earlier ones, for the nodes of a namespace.
    pub fn read(path: &Path, rig: Rig, files: &[PathBuf], namespace: &str) -> anyhow::Result<Settings> {
        if files.is_empty() {
            return Ok(Settings::of(rig));
        }
        let mut ros = RosArguments::default();
        for file in std::iter::once(path).chain(files.iter().map(PathBuf::as_path)) {
            ros.add_file(file.to_owned())?;
        }
        ros.allow_of_others(up::parameters());
        let (tracker, _) = parameters::<MarkerTrackerNode>(&ros, namespace)?;
        let (fusion, values) = parameters::<FusionNode>(&ros, namespace)?;
        let rig = Rig::from_parameters(&values).context("the rig file and --params-file together")?;
        let fusion = fusion.config().map_err(anyhow::Error::msg)?;
        Ok(Settings { tracker: tracker.config(&rig), rig, fusion })
    }

    fn parameters<S: NodeShell>(
        ros: &RosArguments,
        namespace: &str,
    ) -> anyhow::Result<(S::Parameters, ParameterMap)> {
        let name = NodeName::new(&format!("/{}", namespace.trim_matches('/')), S::NAME)?;
        let mut descriptors = S::Parameters::descriptors();
        descriptors.extend(common_descriptors());
        let mut overrides = ros.overrides(&name);
        overrides.retain(|name, _| !ros.is_of_others(name) || descriptors.iter().any(|d| d.name == *name));
        let told = || format!("--params-file, the parameters of {}", S::NAME);
        let store = ParameterStore::new(descriptors, overrides).with_context(told)?;
        let set = S::Parameters::from_map(store.values()).with_context(told)?;
        Ok((set, store.values().clone()))
    }
}
