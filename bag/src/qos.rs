//! The quality of service that publishers offered, as rosbag2 keeps it.

use std::fmt::Write;

/// Whether every sample must arrive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reliability {
    /// Repeated until it is acknowledged.
    Reliable,
    /// Sent once.
    BestEffort,
}

/// Whether late-joining subscribers get the last samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Durability {
    /// No.
    Volatile,
    /// Yes: latched.
    TransientLocal,
}

/// The part of ROS 2's QoS that matters in a bag.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct QosProfile {
    /// Depth of the history (keep last), samples.
    pub depth: u32,
    /// See [`Reliability`].
    pub reliability: Reliability,
    /// See [`Durability`].
    pub durability: Durability,
}

impl QosProfile {
    /// Reliable, volatile, keep last 10.
    pub const RELIABLE: Self =
        Self { depth: 10, reliability: Reliability::Reliable, durability: Durability::Volatile };
    /// Best effort, volatile, keep last 10: images and IMU samples.
    pub const SENSOR: Self =
        Self { depth: 10, reliability: Reliability::BestEffort, durability: Durability::Volatile };
    /// Reliable and latched: `/tf_static`.
    pub const LATCHED: Self = Self {
        depth: 1,
        reliability: Reliability::Reliable,
        durability: Durability::TransientLocal,
    };

    /// Formats the profile as rosbag2 does: a YAML list of one.
    pub fn to_yaml(&self) -> String {
        let reliability = match self.reliability {
            Reliability::Reliable => "reliable",
            Reliability::BestEffort => "best_effort",
        };
        let durability = match self.durability {
            Durability::Volatile => "volatile",
            Durability::TransientLocal => "transient_local",
        };
        let mut yaml = format!(
            "- history: keep_last\n  depth: {}\n  reliability: {reliability}\n  durability: \
             {durability}\n",
            self.depth
        );
        // "For ever", as rmw writes it.
        let forever = "    sec: 9223372036\n    nsec: 854775807\n";
        for key in ["deadline", "lifespan"] {
            let _ = write!(yaml, "  {key}:\n{forever}");
        }
        let _ = write!(yaml, "  liveliness: automatic\n  liveliness_lease_duration:\n{forever}");
        yaml.push_str("  avoid_ros_namespace_conventions: false");
        yaml
    }

    /// Parses the first profile of rosbag2's YAML list, with enums as words or numbers; missing
    /// entries are those of [`QosProfile::RELIABLE`].
    pub fn from_yaml(yaml: &str) -> Self {
        let mut profile = Self::RELIABLE;
        for line in yaml.lines() {
            match line.trim().trim_start_matches("- ").split_once(": ") {
                Some(("reliability", "2" | "best_effort")) => {
                    profile.reliability = Reliability::BestEffort
                }
                Some(("durability", "1" | "transient_local")) => {
                    profile.durability = Durability::TransientLocal;
                }
                Some(("depth", depth)) => profile.depth = depth.parse().unwrap_or(0).clamp(1, 1000),
                // After the first profile.
                Some(("avoid_ros_namespace_conventions", _)) => break,
                _ => {}
            }
        }
        profile
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn profiles_survive_formatting() {
        for profile in [QosProfile::RELIABLE, QosProfile::SENSOR, QosProfile::LATCHED] {
            assert_eq!(QosProfile::from_yaml(&profile.to_yaml()), profile);
        }
    }

    #[test]
    fn numeric_enums_of_humble_are_read() {
        let yaml = "- history: 3\n  depth: 0\n  reliability: 2\n  durability: 1\n";
        let expected = QosProfile {
            depth: 1,
            reliability: Reliability::BestEffort,
            durability: Durability::TransientLocal,
        };
        assert_eq!(QosProfile::from_yaml(yaml), expected);
    }
}
