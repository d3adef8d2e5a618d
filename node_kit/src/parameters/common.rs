//! Parameters of every node.

use super::{Descriptor, ParameterSet};
use rig_model::rig::rig_keys;

ros_parameters::parameters! {
    /// Parameters that every node has besides the keys of the rig file.
    pub(crate) struct CommonParameters {
        /// Take the time from /clock instead of the system.
        use_sim_time: bool = false, live;
        /// Start active; false waits for the lifecycle services.
        autostart: bool = true;
        /// Offer ~/get_type_description.
        start_type_description_service: bool = true;
    }
}

/// Parameters of every node: `use_sim_time`, `autostart`, `start_type_description_service` and the
/// keys of the rig file.
pub fn common_descriptors() -> Vec<Descriptor> {
    let mut all = CommonParameters::descriptors();
    all.extend(rig_keys());
    all
}
