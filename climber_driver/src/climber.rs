//! The core: readings in, samples and rejections out.

use crate::{
    config::{Axis, ClimberConfig},
    warning::Warning,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rig_model::{ClimberSample, JointReading, Stamp, wrap_angle};
use std::{
    collections::{BTreeMap, VecDeque},
    f64::consts::{SQRT_2, TAU},
};

/// Output of the core.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Pose of the climber.
    Sample(ClimberSample),
    /// Warning for the operator.
    Warning(Warning),
}

/// Number of readings by outcome.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Readings that became samples.
    pub accepted: u64,
    /// Messages of other publishers, without any of the configured joints.
    pub foreign: u64,
    /// Rejected readings by [`Warning::kind`].
    pub rejected: BTreeMap<&'static str, u64>,
}

#[derive(Clone, Copy, Debug)]
struct Accepted {
    stamp: Stamp,
    axes: [f64; 3],
}

/// Readings after a jump.
#[derive(Clone, Copy, Debug)]
struct Candidate {
    last: Accepted,
    /// Number of the latest ones that are consistent with each other.
    consistent: u32,
    /// Time from the last accepted reading to the jump, s; infinite if only the stamps are wrong.
    after: f64,
}

/// Converts encoder readings into the pose of the climber and rejects implausible ones.
#[derive(Debug, Default)]
pub struct Climber {
    config: ClimberConfig,
    last: Option<Accepted>,
    last_received: Option<Stamp>,
    last_accepted_at: Option<Stamp>,
    candidate: Option<Candidate>,
    /// Usual time between two accepted readings, s.
    interval: Option<f64>,
    counts: Counts,
    outputs: VecDeque<Output>,
}

/// Step back of the receiver's clock that resets the state, s; smaller ones are NTP corrections.
const CLOCK_STEP: f64 = 1.0;
/// Messages without a configured joint before a warning: another publisher on the topic may be the
/// first.
const FOREIGN_PATIENCE: u64 = 10;
/// Kind of the rejection of messages without a configured joint.
const OTHER_JOINTS: &str = "other joints";
/// Largest number of joint names in a warning: a message may have hundreds.
const MOST_NAMES: usize = 8;
/// Longest gap after a jump, usual intervals: after a longer one the climber may have moved as far.
const LONGEST_GAP: f64 = 5.0;
/// It is no shorter than this, s: readings may come in bursts.
const LEAST_GAP: f64 = 0.25;

impl Climber {
    /// Creates the core in its initial state.
    ///
    /// # Errors
    /// As [`ClimberConfig::validate`].
    pub fn new(config: ClimberConfig) -> Result<Self, String> {
        config.validate()?;
        Ok(Self { config, ..Self::default() })
    }

    /// Replaces the configuration and keeps the state, except for positions in another calibration.
    ///
    /// # Errors
    /// As [`ClimberConfig::validate`]; the previous configuration remains in force.
    pub fn set_config(&mut self, config: ClimberConfig) -> Result<(), String> {
        config.validate()?;
        if config.joints != self.config.joints {
            // The last position with another zero or scale is no reference for a jump.
            self.last = None;
            self.candidate = None;
        }
        self.config = config;
        Ok(())
    }

    /// Processes one reading that was received at `received` (the receiver's clock). Joints that
    /// are not configured are ignored.
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
            Ok(None) => {
                self.counts.foreign += 1;
                let Counts { accepted, foreign, rejected } = &self.counts;
                // Why readings of the climber are rejected is more specific.
                let others_only = rejected.keys().all(|kind| *kind == OTHER_JOINTS);
                if *accepted == 0 && others_only && *foreign >= FOREIGN_PATIENCE {
                    self.reject(self.other_joints(reading));
                }
            }
            Ok(Some(accepted)) => {
                self.counts.accepted += 1;
                if let Some(last) = self.last {
                    let interval = accepted.stamp.seconds_since(last.stamp);
                    let usual = self.interval.unwrap_or(interval);
                    // A gap counts as two intervals.
                    self.interval = Some(usual + 0.1 * (interval.min(2.0 * usual) - usual));
                }
                self.last = Some(accepted);
                self.last_accepted_at = Some(received);
                self.candidate = None;
                self.outputs.push_back(Output::Sample(self.sample(&accepted)));
            }
            Err(rejection) => self.reject(rejection),
        }
    }

    fn reject(&mut self, rejection: Warning) {
        *self.counts.rejected.entry(rejection.kind()).or_default() += 1;
        self.outputs.push_back(Output::Warning(rejection));
    }

    /// Returns the next output.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Number of readings by outcome since the start.
    pub fn counts(&self) -> &Counts {
        &self.counts
    }

    /// Time since the last accepted reading, s, if it exceeds `silence_timeout`.
    ///
    /// Infinite if no reading was accepted yet.
    pub fn silent_for(&self, now: Stamp) -> Option<f64> {
        let silence = self.last_accepted_at.map_or(f64::INFINITY, |last| now.seconds_since(last));
        (silence > self.config.silence_timeout).then_some(silence)
    }

    /// The joints of a message beside the configured ones.
    fn other_joints(&self, reading: &JointReading) -> Warning {
        let found = if reading.names.is_empty() {
            "no joint names".to_owned()
        } else {
            format!("the joints {}", listed(reading.names.iter()))
        };
        let names = self.config.joints.iter().map(|joint| &joint.name);
        let names: Vec<&String> = names.filter(|name| !name.is_empty()).collect();
        let configured = listed(names.into_iter());
        let text = format!(
            "the messages have {found}, but none of {configured}; set the parameters \
             joints.rail_x, joints.rail_y and joints.turn to the names in the messages"
        );
        Warning::Rejected { kind: OTHER_JOINTS, text }
    }

    /// Checks a reading; `Ok(None)` if it contains none of the configured joints.
    fn examine(
        &mut self,
        reading: &JointReading,
        received: Stamp,
    ) -> Result<Option<Accepted>, Warning> {
        let wrong = |kind, text| Err(Warning::Rejected { kind, text });
        let (names, positions) = (reading.names.len(), reading.positions.len());
        let Some(readings) = self.joint_indices(reading)? else { return Ok(None) };
        if names != positions {
            let text = format!(
                "{names} names but {positions} positions; the publisher must fill both alike"
            );
            return wrong("length mismatch", text);
        }
        let mut axes = [0.0; 3];
        for ((axis, joint), index) in axes.iter_mut().zip(&self.config.joints).zip(readings) {
            // An axis that the climber does not have.
            let Some(index) = index else { continue };
            let value = reading.positions[index];
            *axis = joint.scale * (value - joint.zero);
            if !axis.is_finite() {
                let text = format!("`{}` is {value}; check the encoder", joint.name);
                return wrong("not finite", text);
            }
        }
        if reading.stamp.is_unset() {
            let text = "the stamp is zero; its publisher must set header.stamp";
            return wrong("no stamp", text.to_owned());
        }
        let age = received.seconds_since(reading.stamp);
        let ClimberConfig { max_age, max_ahead, .. } = self.config;
        if age > max_age {
            let text = format!(
                "{age:.3} s old on arrival, more than max_age = {max_age} s; check network and \
                 clocks"
            );
            return wrong("stale", text);
        }
        if -age > max_ahead {
            let text = format!(
                "stamped {:.3} s after its receipt, more than max_ahead = {max_ahead} s; check \
                 the two clocks",
                -age
            );
            return wrong("from the future", text);
        }
        let now = Accepted { stamp: reading.stamp, axes };
        let Some(last) = self.last else { return Ok(Some(now)) };
        if reading.stamp <= last.stamp {
            let text = format!(
                "stamp {} is not after the last accepted one, {}; send each reading once and in \
                 order",
                reading.stamp, last.stamp
            );
            return wrong("not newer", text);
        }
        self.check_jump(&last, now).map(Some)
    }

    /// Indices of the configured joints in the message, `None` for an axis without one; `None` if
    /// it contains none of them.
    fn joint_indices(&self, reading: &JointReading) -> Result<Option<[Option<usize>; 3]>, Warning> {
        let mut indices = [None; 3];
        for (slot, joint) in indices.iter_mut().zip(&self.config.joints) {
            let same = |(_, name): &(usize, &String)| **name == joint.name && !name.is_empty();
            let mut found = reading.names.iter().enumerate().filter(same).map(|(i, _)| i);
            *slot = found.next();
            if found.next().is_some() {
                let text = "occurs twice in one message; name each joint once";
                let text = format!("the joint `{}` {text}", joint.name);
                return Err(Warning::Rejected { kind: "duplicate joint", text });
            }
        }
        if indices.iter().all(Option::is_none) {
            return Ok(None);
        }
        let mut axes = Axis::ALL.into_iter().zip(&self.config.joints).zip(indices);
        match axes.find(|((_, joint), index)| index.is_none() && !joint.name.is_empty()) {
            None => Ok(Some(indices)),
            Some(((axis, joint), _)) => {
                let text = format!(
                    "the joint `{}` ({axis}) is missing; publish all joints in one message, or set \
                     the parameter joints.{axis} to its name, or to \"\" where the climber has none",
                    joint.name
                );
                Err(Warning::Rejected { kind: "missing joint", text })
            }
        }
    }

    /// Describes the first axis that moved faster than its speed limit, if the change took
    /// `seconds`.
    ///
    /// Each reading has a standard deviation of `uncertainty`; the limit allows for three standard
    /// deviations of their difference.
    fn jump(&self, before: &Accepted, after: &Accepted, seconds: f64) -> Option<String> {
        Axis::ALL.into_iter().zip(&self.config.joints).enumerate().find_map(|(i, (axis, joint))| {
            let jump = change(axis, before.axes[i], after.axes[i]);
            let limit = joint.max_speed;
            let allowed = limit * seconds + 3.0 * SQRT_2 * joint.uncertainty;
            (jump.abs() > allowed).then(|| {
                let (unit, name) = (axis.unit(), axis.limit_name());
                format!(
                    "{axis} jumped by {jump:.4} {unit} in {seconds:.3} s, faster than \
                     `max_speed.{name}` = {limit} {unit}/s"
                )
            })
        })
    }

    /// Accepts a reading without a jump. After a jump, accepts one that is back where the climber
    /// can be, or the last of `jump_patience` readings that are consistent with each other.
    ///
    /// This rejects single spikes and recovers from an encoder that was re-zeroed. The distance
    /// that the climber can have moved is that at the time of the jump: with the time since, it
    /// would soon cover the jump itself. It grows with time where only a stamp is wrong (the motion
    /// is possible within the usual interval) and behind a gap.
    fn check_jump(&mut self, last: &Accepted, now: Accepted) -> Result<Accepted, Warning> {
        let rejected = |jump: String, after: f64| {
            let remedy = match after.is_finite() {
                true => "check the encoder, or raise the limit",
                false => "check the stamps: readings usually are further apart",
            };
            Err(Warning::Rejected { kind: "jump", text: format!("{jump}; {remedy}") })
        };
        let elapsed = now.stamp.seconds_since(last.stamp);
        let usual = self.interval.unwrap_or(0.0);
        let candidate = self.candidate.filter(|candidate| {
            let gap = now.stamp.seconds_since(candidate.last.stamp);
            gap <= (LONGEST_GAP * self.interval.unwrap_or(candidate.after)).max(LEAST_GAP)
        });
        let Some(candidate) = candidate else {
            let Some(jump) = self.jump(last, &now, elapsed) else { return Ok(now) };
            let after = match self.jump(last, &now, elapsed.max(usual)) {
                Some(_) => elapsed.max(usual),
                None => f64::INFINITY,
            };
            self.candidate = Some(Candidate { last: now, consistent: 1, after });
            return rejected(jump, after);
        };
        let Some(jump) = self.jump(last, &now, candidate.after.min(elapsed)) else {
            return Ok(now);
        };
        let step = now.stamp.seconds_since(candidate.last.stamp);
        if step <= 0.0 {
            return rejected(jump, candidate.after);
        }
        let (consistent, after) = if self.jump(&candidate.last, &now, step.max(usual)).is_none() {
            (candidate.consistent + 1, candidate.after)
        } else if self.jump(last, &now, (candidate.after + step).min(elapsed)).is_none() {
            // Away from the candidate, and back but for the motion since that.
            return Ok(now);
        } else {
            (1, candidate.after.min(elapsed.max(usual)))
        };
        if consistent < self.config.jump_patience {
            self.candidate = Some(Candidate { last: now, consistent, after });
            return rejected(jump, after);
        }
        let change = Axis::ALL.map(|axis| {
            let i = axis as usize;
            change(axis, last.axes[i], now.axes[i])
        });
        self.outputs
            .push_back(Output::Warning(Warning::Relocated { change, rejected: consistent - 1 }));
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

/// Names in backquotes, [`MOST_NAMES`] at most.
fn listed<'a>(names: impl ExactSizeIterator<Item = &'a String>) -> String {
    let more = names.len().saturating_sub(MOST_NAMES);
    let mut list = names.take(MOST_NAMES).map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
    if more > 0 {
        list.push_str(&format!(" and {more} more"));
    }
    list
}

/// Change of an axis from one reading to a later one, m (rad).
///
/// An encoder of the turn may wrap, by one turn at a time; a larger change is an outlier.
fn change(axis: Axis, before: f64, after: f64) -> f64 {
    let change = after - before;
    match axis {
        Axis::Turn if change.abs() <= 1.5 * TAU => wrap_angle(change),
        _ => change,
    }
}

#[cfg(test)]
mod tests;
