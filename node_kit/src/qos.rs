//! Quality of service: three presets, each of which can be overridden by parameters, topic by topic.
//!
//! `qos_overrides.<topic>.publisher.reliability`, `.durability`, `.depth` (and `.subscription.…`), with the absolute
//! topic, as rclcpp has them. A fourth, `.max_samples`, bounds what a reliable publisher keeps for readers that do not
//! answer.

use crate::parameters::{Descriptor, ParameterKind, ParameterValue};

/// Who asks: the names of the parameters differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Endpoint {
    /// A publisher.
    Publisher,
    /// A subscription.
    Subscription,
}

impl Endpoint {
    const fn name(self) -> &'static str {
        match self {
            Self::Publisher => "publisher",
            Self::Subscription => "subscription",
        }
    }
}

/// What a topic is for; that decides how it is sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum QosPreset {
    /// Images and camera info: best effort, the last 4. A subscription takes reliable publishers too.
    Image,
    /// Inertial samples and other fast streams whose next value is worth more than a repeated old one: best effort, the
    /// last 100 (0.25 s of them).
    Sensor,
    /// Poses, transforms, diagnostics: reliable, the last 10 (a subscription queues 100).
    State,
    /// What is measured on one computer and used on another, such as markers: offered reliably for who must have all of it, taken best
    /// effort, because waiting for one that was lost holds the later ones up, and they tell more than it does.
    ///
    /// RustDDS 0.15 keeps samples for a best-effort reader as if it might still acknowledge them, so fewer are kept here than of a
    /// [`State`](Self::State): a rate of 80 Hz outlives the lease of a reader that was killed.
    Measurement,
    /// What late joiners must get, such as `/tf_static`: reliable, transient local, the last one of each publisher.
    Latched,
}

/// The quality of service of one publisher or subscription.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Qos {
    /// Sent again until it is acknowledged.
    pub reliable: bool,
    /// Kept for late joiners.
    pub transient_local: bool,
    /// Messages kept, at least one; for a subscription, how many wait in the node's inbox.
    pub depth: usize,
    /// Most samples that a reliable publisher keeps for readers that do not acknowledge. When it is full a publication
    /// fails (and is counted); it never blocks. A reader that was killed is only noticed when its lease is over
    /// (10 s for Cyclone DDS, 20 s for Fast DDS, 50 s for RustDDS), and until then it holds all samples back.
    pub max_samples: usize,
}

impl QosPreset {
    /// Its values.
    pub const fn qos(self, endpoint: Endpoint) -> Qos {
        match (self, endpoint) {
            (Self::Image, _) => Qos { reliable: false, transient_local: false, depth: 4, max_samples: 4 },
            (Self::Sensor, _) => {
                Qos { reliable: false, transient_local: false, depth: 100, max_samples: 100 }
            }
            (Self::State, Endpoint::Publisher) => {
                Qos { reliable: true, transient_local: false, depth: 10, max_samples: 8192 }
            }
            (Self::Measurement, Endpoint::Publisher) => {
                Qos { max_samples: 4096, ..Self::State.qos(Endpoint::Publisher) }
            }
            (Self::Measurement, Endpoint::Subscription) => Self::Sensor.qos(Endpoint::Subscription),
            (Self::State, Endpoint::Subscription) => {
                Qos { reliable: true, transient_local: false, depth: 100, max_samples: 100 }
            }
            (Self::Latched, Endpoint::Publisher) => {
                Qos { reliable: true, transient_local: true, depth: 1, max_samples: 1 }
            }
            (Self::Latched, Endpoint::Subscription) => {
                Qos { reliable: true, transient_local: true, depth: 100, max_samples: 100 }
            }
        }
    }
}

impl Qos {
    /// The parameters that override this for the topic of this absolute name, with the values here as defaults.
    pub fn descriptors(&self, topic: &str, endpoint: Endpoint) -> Vec<Descriptor> {
        let end = endpoint.name();
        let name = |policy: &str| format!("qos_overrides.{topic}.{end}.{policy}");
        let text = |s: &str| Some(ParameterValue::String(s.to_owned()));
        let number = |n: usize| Some(ParameterValue::Integer(i64::try_from(n).unwrap_or(i64::MAX)));
        let mut all = vec![
            Descriptor::new(
                name("reliability"),
                ParameterKind::String,
                text(if self.reliable { "reliable" } else { "best_effort" }),
                format!("Reliability of the {end} of {topic}."),
            )
            .one_of(&["reliable", "best_effort"]),
            Descriptor::new(
                name("durability"),
                ParameterKind::String,
                text(if self.transient_local { "transient_local" } else { "volatile" }),
                format!("Durability of the {end} of {topic}."),
            )
            .one_of(&["volatile", "transient_local"]),
            Descriptor::new(
                name("depth"),
                ParameterKind::Integer,
                number(self.depth),
                format!("Messages that the {end} of {topic} keeps."),
            )
            .range(1..=100_000),
        ];
        if endpoint == Endpoint::Publisher {
            all.push(
                Descriptor::new(
                    name("max_samples"),
                    ParameterKind::Integer,
                    number(self.max_samples),
                    format!("Most samples of {topic} kept for readers that do not acknowledge."),
                )
                .range(1..=1_000_000),
            );
        }
        all
    }

    /// With one override; `name` is that of a descriptor from [`Qos::descriptors`].
    #[must_use]
    pub fn with(mut self, name: &str, value: &ParameterValue) -> Self {
        let count = |value: &ParameterValue| match value {
            ParameterValue::Integer(n) => usize::try_from(*n).ok().filter(|n| *n > 0),
            _ => None,
        };
        match (name.rsplit('.').next(), value) {
            (Some("reliability"), ParameterValue::String(s)) => self.reliable = s == "reliable",
            (Some("durability"), ParameterValue::String(s)) => self.transient_local = s == "transient_local",
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

    #[test]
    fn every_policy_can_be_overridden_by_the_parameter_that_describes_it() {
        let base = QosPreset::State.qos(Endpoint::Publisher);
        let descriptors = base.descriptors("/volant/odometry", Endpoint::Publisher);
        assert_eq!(descriptors[0].name, "qos_overrides./volant/odometry.publisher.reliability");
        let unchanged = descriptors
            .iter()
            .fold(base, |qos, d| d.default.as_ref().map_or(qos, |value| qos.with(&d.name, value)));
        assert_eq!(unchanged, base);
        let changed = base
            .with("qos_overrides./x.publisher.reliability", &ParameterValue::String("best_effort".into()))
            .with("qos_overrides./x.publisher.durability", &ParameterValue::String("transient_local".into()))
            .with("qos_overrides./x.publisher.depth", &ParameterValue::Integer(20_000));
        assert_eq!(
            changed,
            Qos { reliable: false, transient_local: true, depth: 20_000, max_samples: 20_000 }
        );
    }
}
