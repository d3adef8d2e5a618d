//! Parameters of every node.

use super::descriptor::{Descriptor, ParameterKind};
use rig_model::rig::rig_keys;
use ros_parameters::ParameterValue;

/// Parameters of every node: `use_sim_time`, `autostart` and the keys of the rig file.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_common_parameters_accept_their_defaults() {
        for descriptor in common_descriptors() {
            if let Some(default) = &descriptor.default {
                assert_eq!(descriptor.accept(default).as_ref(), Ok(default), "{}", descriptor.name);
            }
        }
    }
}
