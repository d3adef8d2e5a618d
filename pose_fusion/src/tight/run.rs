//! The history is run: from state to state, event by event, up to the newest inertial sample.

use super::{
    GAP, JERKY, SETTING_OFF, Tight, climber, gap,
    history::{Event, Node},
    markers::{self, Gates},
    odometry::{self, Along},
    pendulum,
    propagate::{Felt, Process, propagate},
    state::{CLIMBER_RATE, GYROSCOPE, State, VELOCITY},
};
use crate::output::{Output, Warning};
use nalgebra::Vector3;
use rig_model::Stamp;
use std::collections::VecDeque;

/// A jolt began at most so many readings before the one that tells it.
const JOLTED: usize = 2;

impl Tight {
    /// Runs every event that is not run yet and not later than the newest inertial sample.
    pub(super) fn run(&mut self, out: &mut VecDeque<Output>) {
        let Some((newest, _)) = self.newest_imu else { return };
        let process = self.process();
        let mut anchor = self.anchor_before(self.history.run().max(1));
        let gates = Gates {
            marker: self.config.marker_gate,
            joint: self.config.joint_gate,
            gravity: self.config.gravity,
        };
        let rope = self.rope().zip(self.readings.back().map(|(_, _, rest)| *rest));
        let period = self.inertial_noise.period().max(1e-4);
        let mut place = self.history.run().max(1);
        while place < self.history.len() {
            if self.history.get(place).is_none_or(|n| n.stamp > newest) {
                break;
            }
            let interpolated = self.interpolated(place);
            let silent = self.silence(place, anchor);
            let (frozen, climber_clock) = (self.frozen, self.climber_clock);
            let rest_sigma = self.config.rest_velocity;
            let rate_density = process.rate;
            let rope = rope.filter(|_| silent.is_none());
            let (Some(geometry), Some((from, to))) = (&self.geometry, self.history.step(place)) else {
                break;
            };
            if let Some(felt) = interpolated {
                to.felt = felt;
            }
            let dt = to.stamp.seconds_since(from.stamp);
            to.state.clone_from(&from.state);
            to.process = match silent {
                Some(seconds) => gap::process(&process, seconds),
                None => process,
            };
            to.process.jerk += self.jolts.density(to.stamp);
            propagate(&mut to.state, &from.felt, &to.felt, dt, &to.process);
            if matches!(to.event, Event::Imu { .. } | Event::Set) {
                anchor = Some(to.stamp);
            }
            let (mut fresh_report, mut innovation) = (None, None);
            let felt = to.felt;
            match &mut to.event {
                Event::Set => {}
                Event::Imu { still } => {
                    if let (Some(rate), true) = (still, rest_sigma > 0.0) {
                        at_rest(&mut to.state, rate, rest_sigma, rate_density);
                    }
                    if let Some((rope, rest)) = rope
                        && pendulum::asked(from.state.unseen, to.state.unseen)
                    {
                        rope.update(&mut to.state, &felt, &rest, process.force / period, gates.gravity);
                    }
                }
                Event::Climber(reading) => {
                    reading.felt = felt;
                    innovation = Some(climber::update(&mut to.state, reading, climber_clock, gates.gravity));
                }
                Event::Markers { sighting, image, fresh } => {
                    sighting.felt = felt;
                    let report = markers::update(&mut to.state, geometry, sighting, &gates, frozen);
                    if *fresh {
                        *fresh = false;
                        fresh_report = Some((*image, sighting.pixels, report));
                    }
                }
            }
            let sound = to.state.is_sound();
            let stamp = to.stamp;
            if let Some(innovation) = innovation {
                if let Some((since, at)) = self.history.reading_before(place, JOLTED)
                    && self.jolts.note(at, stamp, &innovation)
                {
                    self.evidence.take_back(at);
                    self.contradictions = 0;
                    self.contradicted_since = None;
                    place = since + 1;
                    self.history.set_run(place);
                    anchor = self.anchor_before(place);
                    continue;
                }
                let more = if innovation.nis.max() > JERKY { 1.6 } else { 0.98 };
                let least = if self.driving { 1.0 } else { SETTING_OFF };
                self.jerk_scale = (self.jerk_scale * more).clamp(least, 1000.0);
            }
            self.history.set_run(place + 1);
            if !sound {
                out.push_back(Output::Warning(Warning::Diverged { stamp }));
                self.status.divergences += 1;
                self.reset();
                return;
            }
            if let Some((image, pixels, report)) = fresh_report {
                self.record(image, &report, out);
                if self.learn(image, &pixels, &report, out) {
                    return;
                }
            }
            place += 1;
        }
    }

    /// The last instant at or before which the motion was felt: an inertial sample, or where the state was set.
    fn anchor_before(&self, place: usize) -> Option<Stamp> {
        let felt = |n: &&Node| matches!(n.event, Event::Imu { .. } | Event::Set);
        (0..place).rev().filter_map(|p| self.history.get(p)).find(felt).map(|n| n.stamp)
    }

    /// How long the inertial unit was silent around the step that ends at `place`, where that is a gap.
    fn silence(&self, place: usize, anchor: Option<Stamp>) -> Option<f64> {
        let next = self.history.next_imu(place)?;
        Some(next.stamp.seconds_since(anchor?)).filter(|seconds| *seconds > GAP)
    }

    /// What the unit felt at an event between two inertial samples.
    pub(super) fn interpolated(&self, place: usize) -> Option<Felt> {
        let node = self.history.get(place)?;
        if matches!(node.event, Event::Imu { .. }) {
            return None;
        }
        let before = self.history.get(place.checked_sub(1)?)?;
        let Some(next) = self.history.next_imu(place) else { return Some(before.felt) };
        let span = next.stamp.seconds_since(before.stamp);
        let share = if span > 0.0 { node.stamp.seconds_since(before.stamp) / span } else { 0.0 };
        Some(before.felt.between(&next.felt, share.clamp(0.0, 1.0)))
    }

    pub(super) fn densities(&self) -> (f64, f64) {
        let imu = &self.rig.imu;
        self.inertial_noise.densities(
            imu.accelerometer_noise_density.powi(2),
            imu.gyroscope_noise_density.powi(2),
            self.config.inertial_noise_limit,
        )
    }

    pub(super) fn process(&self) -> Process {
        let (force, rate) = self.densities();
        let c = &self.config;
        Process {
            gravity: c.gravity,
            force,
            rate,
            accelerometer_bias: c.accelerometer_bias_walk.powi(2),
            gyroscope_bias: c.gyroscope_bias_walk.powi(2),
            jerk: Vector3::new(c.climber_jerk, c.climber_jerk, c.climber_turn_jerk) * self.jerk_scale,
            clock: if c.camera_clock > 0.0 { c.clock_walk.powi(2) } else { 0.0 },
        }
    }

    /// The estimate at the newest inertial sample.
    pub(super) fn say(&mut self, out: &mut VecDeque<Output>) {
        let (Some(geometry), Some((newest, _))) = (&self.geometry, self.newest_imu) else { return };
        if !self.started {
            return;
        }
        let Some(node) = self.history.run().checked_sub(1).and_then(|p| self.history.get(p)) else { return };
        if node.stamp != newest {
            return;
        }
        let rate_variance = self.densities().1 / self.inertial_noise.period().max(1e-4);
        let (mean, variance) = self.belief().moments();
        let along = Along {
            rate_variance,
            gravity: self.config.gravity,
            climber_clock: (mean - self.climber_clock, variance),
            systematic: self.config.pixel_systematic,
        };
        out.push_back(Output::Odometry(odometry::odometry(
            newest,
            &node.state,
            &node.felt,
            geometry,
            &along,
        )));
        self.status.odometry += 1;
    }

    /// Says once when the estimate is lost, and when it is back.
    pub(super) fn watch(&mut self, out: &mut VecDeque<Output>) {
        let Some(sigma) = self.state().map(|s| self.position_sigma(s)) else { return };
        let lost = sigma > self.config.lost_position;
        if let (true, false, Some(since)) = (lost, self.lost, self.last_used) {
            out.push_back(Output::Warning(Warning::VisionLost { since, position_sigma_m: sigma }));
        }
        self.lost = lost;
    }
}

/// The platform stands still: velocity and rate of turn are zero, where the filter does not know better.
fn at_rest(state: &mut State, mean_rate: &Vector3<f64>, sigma: f64, rate_density: f64) {
    let v = state.velocity;
    let p = |i: usize| state.covariance[(i, i)];
    let agrees = (0..3).all(|i| {
        v[i].abs() < 3.0 * (p(VELOCITY + i) + sigma * sigma).sqrt()
            && state.climber_rate[i].abs() < 3.0 * p(CLIMBER_RATE + i).sqrt() + 0.002
            && (mean_rate[i] - state.gyroscope_bias[i]).abs()
                < 3.0 * (p(GYROSCOPE + i) + 2.0 * rate_density).sqrt() + 1e-3
    });
    if !agrees {
        return;
    }
    for i in 0..3 {
        let residual = -state.velocity[i];
        markers::scalar_update(state, &[(VELOCITY + i, 1.0)], residual, sigma * sigma);
        let residual = mean_rate[i] - state.gyroscope_bias[i];
        // Half a second's mean: density / 0.5 s, and a tenth of a degree per second that nobody would see.
        markers::scalar_update(state, &[(GYROSCOPE + i, 1.0)], residual, 2.0 * rate_density + 3e-6);
    }
}
