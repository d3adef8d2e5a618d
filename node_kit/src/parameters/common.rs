//! Parameters of every node.

use super::{Descriptor, ParameterKind};
use rig_model::rig::rig_keys;
use ros_parameters::ParameterValue;

/// Name of rcl's parameter that switches `~/get_type_description` on.
pub(crate) const START_TYPE_DESCRIPTION_SERVICE: &str = "start_type_description_service";

/// Parameters of every node: `use_sim_time`, `autostart`, `start_type_description_service` and the
/// keys of the rig file.
pub fn common_descriptors() -> Vec<Descriptor> {
    let mut all = vec![
        Descriptor::new(
            "use_sim_time",
            ParameterKind::Bool,
            Some(ParameterValue::Bool(false)),
            "Take the time from /clock instead of the system.",
        )
        .live(),
        Descriptor::new(
            "autostart",
            ParameterKind::Bool,
            Some(ParameterValue::Bool(true)),
            "Start active; false waits for the lifecycle services.",
        ),
        Descriptor::new(
            START_TYPE_DESCRIPTION_SERVICE,
            ParameterKind::Bool,
            Some(ParameterValue::Bool(true)),
            "Offer ~/get_type_description.",
        ),
    ];
    all.extend(rig_keys().into_iter().map(|key| {
        let kind = match &key.default {
            Some(value) => ParameterKind::of(value),
            None if key.name == "markers.size" => ParameterKind::Double,
            None => ParameterKind::DoubleArray,
        };
        Descriptor::new(key.name, kind, key.default, format!("Rig file: {}.", key.description))
    }));
    all
}
