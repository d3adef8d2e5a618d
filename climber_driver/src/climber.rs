//! The core: readings in, samples and refusals out.

use crate::{
    config::{Axis, ClimberConfig, ConfigError},
    refusal::Refusal,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rig_model::{ClimberSample, Stamp};
use std::collections::{BTreeMap, VecDeque};

/// The joints as read at one instant (`sensor_msgs/JointState`, of which velocity and effort are not looked at).
#[derive(Clone, Debug, PartialEq)]
pub struct JointReading {
    /// When the encoders were read.
    pub stamp: Stamp,
    /// Joint names; joints that are not ours are passed over.
    pub names: Vec<String>,
    /// Readings, in the order of the names.
    pub positions: Vec<f64>,
}

/// What the core says.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Where the climber is.
    Sample(ClimberSample),
    /// Something to be told to a person.
    Warning(Warning),
}

/// Something to be told to a person.
#[derive(Clone, Debug, PartialEq)]
pub enum Warning {
    /// A reading was refused.
    Refused(Refusal),
    /// A jump was refused at first, but the readings stayed at the new place: they are believed again.
    Relocated {
        /// Change against the last reading before the jump, m, m, rad.
        change: [f64; 3],
        /// How many readings had been refused.
        refused: u32,
    },
    /// The clock of the receiver went back (a replay was started anew): what was known is forgotten.
    TimeWentBack {
        /// By so much, s.
        seconds: f64,
    },
}

/// How many readings met which end.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Became samples.
    pub accepted: u64,
    /// Held none of our joints: another publisher's.
    pub foreign: u64,
    /// Refused, by [`Refusal::kind`].
    pub refused: BTreeMap<&'static str, u64>,
}

#[derive(Clone, Copy, Debug)]
struct Accepted {
    stamp: Stamp,
    axes: [f64; 3],
}

/// A place that readings jumped to and may stay at.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    last: Accepted,
    agreeing: u32,
}

/// From encoder readings to where the climber is.
#[derive(Debug)]
pub struct Climber {
    config: ClimberConfig,
    last: Option<Accepted>,
    last_received: Option<Stamp>,
    last_accepted_at: Option<Stamp>,
    candidate: Option<Candidate>,
    counts: Counts,
    outputs: VecDeque<Output>,
}

/// The receiver's clock may step back by so much, s (a correction by NTP), before all is forgotten.
const CLOCK_STEP: f64 = 1.0;

impl Climber {
    /// A climber of which nothing is known yet.
    ///
    /// # Errors
    /// A configuration that cannot be.
    pub fn new(config: ClimberConfig) -> Result<Self, ConfigError> {
        config.validate()?;
        Ok(Self {
            config,
            last: None,
            last_received: None,
            last_accepted_at: None,
            candidate: None,
            counts: Counts::default(),
            outputs: VecDeque::new(),
        })
    }

    /// Other values for the running core; what is known stays.
    ///
    /// # Errors
    /// A configuration that cannot be; the old one stays in force.
    pub fn set_config(&mut self, config: ClimberConfig) -> Result<(), ConfigError> {
        config.validate()?;
        self.config = config;
        Ok(())
    }

    /// Takes one reading, received at `received` (the receiver's clock).
    pub fn handle(&mut self, reading: &JointReading, received: Stamp) {
        if let Some(previous) = self.last_received {
            let back = previous.seconds_since(received);
            if back > CLOCK_STEP {
                self.last = None;
                self.candidate = None;
                self.last_accepted_at = None;
                self.outputs.push_back(Output::Warning(Warning::TimeWentBack { seconds: back }));
            }
        }
        self.last_received = Some(received);
        match self.examine(reading, received) {
            Ok(None) => self.counts.foreign += 1,
            Ok(Some(accepted)) => {
                self.counts.accepted += 1;
                self.last = Some(accepted);
                self.last_accepted_at = Some(received);
                self.candidate = None;
                self.outputs.push_back(Output::Sample(self.sample(&accepted)));
            }
            Err(refusal) => {
                *self.counts.refused.entry(refusal.kind()).or_default() += 1;
                self.outputs.push_back(Output::Warning(Warning::Refused(refusal)));
            }
        }
    }

    /// The next thing to publish or to say.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// How many readings met which end so far.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Seconds since a reading was last accepted, where that is longer than the time-out; `None` while readings flow.
    /// Infinite where there never was one.
    pub fn silent_for(&self, now: Stamp) -> Option<f64> {
        let silence = self.last_accepted_at.map_or(f64::INFINITY, |last| now.seconds_since(last));
        (silence > self.config.silence_timeout).then_some(silence)
    }

    /// `Ok(None)`: not about our joints.
    fn examine(&mut self, reading: &JointReading, received: Stamp) -> Result<Option<Accepted>, Refusal> {
        let (names, positions) = (reading.names.len(), reading.positions.len());
        let Some(readings) = self.our_joints(reading)? else { return Ok(None) };
        if names != positions {
            return Err(Refusal::LengthMismatch { names, positions });
        }
        let mut axes = [0.0; 3];
        for ((axis, joint), &index) in axes.iter_mut().zip(&self.config.joints).zip(&readings) {
            let value = reading.positions[index];
            *axis = joint.scale * (value - joint.zero);
            if !axis.is_finite() {
                return Err(Refusal::NotFinite { joint: joint.name.clone(), value });
            }
        }
        let age = received.seconds_since(reading.stamp);
        if age > self.config.max_age {
            return Err(Refusal::Stale { age, limit: self.config.max_age });
        }
        if -age > self.config.max_ahead {
            return Err(Refusal::FromTheFuture { ahead: -age, limit: self.config.max_ahead });
        }
        let now = Accepted { stamp: reading.stamp, axes };
        let Some(last) = self.last else { return Ok(Some(now)) };
        if reading.stamp <= last.stamp {
            return Err(Refusal::NotNewer { stamp: reading.stamp, last: last.stamp });
        }
        match self.jump(&last, &now) {
            None => Ok(Some(now)),
            Some(refusal) => self.weigh_candidate(&last, now, refusal).map(Some),
        }
    }

    /// Where our joints stand in the message; `None` if none of them does.
    fn our_joints(&self, reading: &JointReading) -> Result<Option<[usize; 3]>, Refusal> {
        let mut indices = [None; 3];
        for (slot, joint) in indices.iter_mut().zip(&self.config.joints) {
            let mut places =
                reading.names.iter().enumerate().filter(|(_, n)| **n == joint.name).map(|(i, _)| i);
            *slot = places.next();
            if places.next().is_some() {
                return Err(Refusal::DuplicateJoint { joint: joint.name.clone() });
            }
        }
        match indices {
            [None, None, None] => Ok(None),
            [Some(x), Some(y), Some(turn)] => Ok(Some([x, y, turn])),
            _ => {
                let missing = indices.iter().position(Option::is_none).unwrap_or(0);
                Err(Refusal::MissingJoint {
                    joint: self.config.joints[missing].name.clone(),
                    axis: Axis::ALL[missing],
                })
            }
        }
    }

    /// The axis that moved faster than it can, if one did. Both readings may be off by their uncertainty, so three
    /// standard deviations of the difference are allowed on top of the way that the speed limit gives.
    fn jump(&self, before: &Accepted, after: &Accepted) -> Option<Refusal> {
        let seconds = after.stamp.seconds_since(before.stamp);
        Axis::ALL.into_iter().zip(&self.config.joints).enumerate().find_map(|(i, (axis, joint))| {
            let jump = after.axes[i] - before.axes[i];
            let allowed = joint.max_speed * seconds + 3.0 * std::f64::consts::SQRT_2 * joint.uncertainty;
            (jump.abs() > allowed).then_some(Refusal::Jump { axis, jump, seconds, limit: joint.max_speed })
        })
    }

    /// A single spike must not pass, yet an encoder that was re-zeroed must not be refused for ever: readings that
    /// agree with each other for long enough are believed.
    fn weigh_candidate(
        &mut self,
        last: &Accepted,
        now: Accepted,
        refusal: Refusal,
    ) -> Result<Accepted, Refusal> {
        let agreeing = match self.candidate {
            Some(c) if now.stamp <= c.last.stamp => return Err(refusal),
            Some(c) if self.jump(&c.last, &now).is_none() => c.agreeing + 1,
            _ => 1,
        };
        if agreeing < self.config.jump_patience {
            self.candidate = Some(Candidate { last: now, agreeing });
            return Err(refusal);
        }
        let change = std::array::from_fn(|i| now.axes[i] - last.axes[i]);
        self.outputs.push_back(Output::Warning(Warning::Relocated { change, refused: agreeing - 1 }));
        Ok(now)
    }

    fn sample(&self, accepted: &Accepted) -> ClimberSample {
        let [x, y, turn] = accepted.axes;
        ClimberSample {
            stamp: accepted.stamp,
            world_from_climber: Isometry3::from_parts(
                Translation3::new(x, y, self.config.height),
                UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn),
            ),
        }
    }
}

#[cfg(test)]
mod tests;
