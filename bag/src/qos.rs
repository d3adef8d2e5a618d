//! The quality of service that publishers offered, as rosbag2 keeps it.

use node_kit::qos::Qos;

/// Formats a profile as rosbag2 does: a YAML list of one.
pub fn qos_to_yaml(qos: &Qos) -> String {
    let reliability = if qos.reliable { "reliable" } else { "best_effort" };
    let durability = if qos.transient_local { "transient_local" } else { "volatile" };
    // "For ever", as rmw writes it.
    let forever = "    sec: 9223372036\n    nsec: 854775807\n";
    format!(
        "- history: keep_last\n  depth: {}\n  reliability: {reliability}\n  durability: \
         {durability}\n  deadline:\n{forever}  lifespan:\n{forever}  liveliness: automatic\n  \
         liveliness_lease_duration:\n{forever}  avoid_ros_namespace_conventions: false",
        qos.depth
    )
}

/// Parses the first profile of rosbag2's YAML list, with enums as words or numbers; missing entries
/// are those of [`Qos::RELIABLE`].
pub fn qos_from_yaml(yaml: &str) -> Qos {
    let mut qos = Qos::RELIABLE;
    for line in yaml.lines() {
        match line.trim().trim_start_matches("- ").split_once(": ") {
            Some(("reliability", "2" | "best_effort")) => qos.reliable = false,
            Some(("durability", "1" | "transient_local")) => qos.transient_local = true,
            Some(("depth", depth)) => qos.depth = depth.parse().unwrap_or(0).clamp(1, 1000),
            // After the first profile.
            Some(("avoid_ros_namespace_conventions", _)) => break,
            _ => {}
        }
    }
    Qos { max_samples: qos.depth, ..qos }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_survive_formatting() {
        for qos in [Qos::RELIABLE, Qos::SENSOR, Qos::LATCHED] {
            assert_eq!(qos_from_yaml(&qos_to_yaml(&qos)), qos);
        }
    }

    #[test]
    fn numeric_enums_of_humble_are_read() {
        let yaml = "- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n";
        let expected = Qos { reliable: false, ..Qos::LATCHED };
        assert_eq!(qos_from_yaml(yaml), expected);
    }
}
