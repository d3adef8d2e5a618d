//! Quality of service: presets, and parameters that override them topic by topic.
//!
//! The parameters are rclcpp's: `qos_overrides.<topic>.publisher.reliability`, `.durability`,
//! `.depth` (and `.subscription.…`), with the absolute topic. A fourth one, `.max_samples`, bounds
//! what a reliable publisher keeps for readers that do not acknowledge.

use crate::parameters::{Descriptor, ParameterKind, ParameterValue};

/// Kind of endpoint; the names of the parameters differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Endpoint {
    /// A publisher.
    Publisher,
    /// A subscription.
    Subscription,
}

impl Endpoint {
    pub(crate) const fn name(self) -> &'static str {
        match self {
            Self::Publisher => "publisher",
            Self::Subscription => "subscription",
        }
    }
}

/// Purpose of a topic, which determines its QoS.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum QosPreset {
    /// Images: best effort, the last 4. A subscription matches reliable publishers too.
    Image,
    /// Camera info, sent with the images: as [`Image`](Self::Image).
    CameraInfo,
    /// IMU samples and other fast streams in which a new value is worth more than a repeated
    /// one: best effort, the last 100 (0.25 s at 400 Hz).
    Sensor,
    /// Poses, transforms, diagnostics: reliable, the last 10 (a subscription queues 100).
    State,
    /// Measurements of one computer used on another, such as markers: published reliably for
    /// recorders, subscribed best effort, because waiting for a lost one delays newer ones, which
    /// are worth more.
    ///
    /// RustDDS 0.15.1 keeps samples for a best-effort reader as for one that acknowledges, so fewer
    /// are kept than of a [`State`](Self::State).
    Measurement,
    /// State for late joiners, such as `/tf_static`: reliable, transient local, the last message of
    /// each publisher.
    Latched,
}

/// The quality of service of one publisher or subscription.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Qos {
    /// Messages are repeated until they are acknowledged.
    pub reliable: bool,
    /// Messages are kept for late joiners.
    pub transient_local: bool,
    /// Messages kept, at least one; for a subscription, how many wait in the node's inbox.
    pub depth: usize,
    /// Samples that a reliable publisher keeps for readers that do not acknowledge. When they are
    /// full, publishing fails, is counted and never blocks: no reader in another process gets any
    /// more. A reader that was killed holds all samples back until its lease is over (10 s for
    /// Cyclone DDS, 20 s for Fast DDS, 50 s for RustDDS): a topic of more than 100 Hz needs more
    /// than the presets have.
    pub max_samples: usize,
}

impl QosPreset {
    /// The QoS of this preset.
    pub const fn qos(self, endpoint: Endpoint) -> Qos {
        match (self, endpoint) {
            (Self::Image | Self::CameraInfo, _) => Qos { depth: 4, max_samples: 4, ..Qos::SENSOR },
            (Self::Sensor, _) | (Self::Measurement, Endpoint::Subscription) => {
                Qos { depth: 100, max_samples: 100, ..Qos::SENSOR }
            }
            (Self::State, Endpoint::Publisher) => Qos { max_samples: 8192, ..Qos::RELIABLE },
            // A minute at 100 Hz.
            (Self::Measurement, Endpoint::Publisher) => Qos { max_samples: 6000, ..Qos::RELIABLE },
            (Self::State, Endpoint::Subscription) => {
                Qos { depth: 100, max_samples: 100, ..Qos::RELIABLE }
            }
            (Self::Latched, Endpoint::Publisher) => Qos::LATCHED,
            (Self::Latched, Endpoint::Subscription) => {
                Qos { depth: 100, max_samples: 100, ..Qos::LATCHED }
            }
        }
    }
}

impl Qos {
    /// Reliable, volatile, keep last 10.
    pub const RELIABLE: Self =
        Self { reliable: true, transient_local: false, depth: 10, max_samples: 10 };
    /// Best effort, volatile, keep last 10: images and IMU samples.
    pub const SENSOR: Self = Self { reliable: false, ..Self::RELIABLE };
    /// Reliable and latched: `/tf_static`.
    pub const LATCHED: Self =
        Self { reliable: true, transient_local: true, depth: 1, max_samples: 1 };

    /// Descriptors of the parameters that override this QoS for a topic (absolute name); the
    /// defaults are the values of `self`.
    pub fn descriptors(&self, topic: &str, endpoint: Endpoint) -> Vec<Descriptor> {
        let end = endpoint.name();
        let declare = |policy: &str, default: ParameterValue, description: String| {
            let name = format!("qos_overrides.{topic}.{end}.{policy}");
            Descriptor::new(name, ParameterKind::of(&default), Some(default), description)
        };
        let text = |s: &str| ParameterValue::String(s.to_owned());
        let number = |n: usize| ParameterValue::Integer(i64::try_from(n).unwrap_or(i64::MAX));
        let reliability = text(if self.reliable { "reliable" } else { "best_effort" });
        let durability = text(if self.transient_local { "transient_local" } else { "volatile" });
        let keeps = format!("Messages that the {end} of {topic} keeps.");
        let mut all = vec![
            declare("reliability", reliability, format!("Reliability of the {end} of {topic}."))
                .one_of(&["reliable", "best_effort"]),
            declare("durability", durability, format!("Durability of the {end} of {topic}."))
                .one_of(&["volatile", "transient_local"]),
            declare("depth", number(self.depth), keeps).range(1..=100_000),
        ];
        if endpoint == Endpoint::Publisher {
            let most = format!("Most samples of {topic} kept for readers that do not acknowledge.");
            all.push(declare("max_samples", number(self.max_samples), most).range(1..=1_000_000));
        }
        all
    }

    /// Applies one override; `name` is the name of a descriptor of [`Qos::descriptors`].
    #[must_use]
    pub fn with(mut self, name: &str, value: &ParameterValue) -> Self {
        let count = |value: &ParameterValue| match value {
            ParameterValue::Integer(n) => usize::try_from(*n).ok().filter(|n| *n > 0),
            _ => None,
        };
        match (name.rsplit('.').next(), value) {
            (Some("reliability"), ParameterValue::String(s)) => self.reliable = s == "reliable",
            (Some("durability"), ParameterValue::String(s)) => {
                self.transient_local = s == "transient_local"
            }
            (Some("depth"), _) => self.depth = count(value).unwrap_or(self.depth),
            (Some("max_samples"), _) => self.max_samples = count(value).unwrap_or(self.max_samples),
            _ => {}
        }
        self.max_samples = self.max_samples.max(self.depth);
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A killed reader of RustDDS is dropped up to 2 s after its lease of 50 s.
    #[test]
    fn a_killed_reader_silences_no_topic_of_100_hz() {
        for preset in [QosPreset::State, QosPreset::Measurement] {
            assert!(preset.qos(Endpoint::Publisher).max_samples > 52 * 100, "{preset:?}");
        }
    }

    #[test]
    fn every_policy_is_overridden_by_its_parameter() {
        let base = QosPreset::State.qos(Endpoint::Publisher);
        let descriptors = base.descriptors("/volant/odometry", Endpoint::Publisher);
        assert_eq!(descriptors[0].name, "qos_overrides./volant/odometry.publisher.reliability");
        let unchanged = descriptors
            .iter()
            .fold(base, |qos, d| d.default.as_ref().map_or(qos, |value| qos.with(&d.name, value)));
        assert_eq!(unchanged, base);
        let text = |text: &str| ParameterValue::String(text.to_owned());
        let changed = base
            .with("qos_overrides./x.publisher.reliability", &text("best_effort"))
            .with("qos_overrides./x.publisher.durability", &text("transient_local"))
            .with("qos_overrides./x.publisher.depth", &ParameterValue::Integer(20_000));
        assert_eq!(
            changed,
            Qos { reliable: false, transient_local: true, depth: 20_000, max_samples: 20_000 }
        );
    }
}
