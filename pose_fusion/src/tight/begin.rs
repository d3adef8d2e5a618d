//! How the estimate begins: from the first image that serves, and anew after an outage, with what was learnt before.

use super::{
    AHEAD, NOTHING, Pixels, Tight, climber,
    geometry::{ClimberRest, Geometry},
    history::Event,
    markers::Sighting,
    rigid,
    start::{self, CLIMBER_ACCELERATION_SIGMA, CLIMBER_SPEED_SIGMA, ClimberStart, Up},
    state::{ACCELEROMETER, CAMERA_CLOCK, CLIMBER_RATE, GYROSCOPE, State},
    tie::{self, Tie},
};
use crate::output::{MarkerOutcome, Output, Warning};
use nalgebra::Vector3;
use rig_model::Stamp;
use std::collections::VecDeque;

/// The encoders' noise is another one from this factor of the variance on.
const REWEIGHED: f64 = 1.5;

impl Tight {
    /// The camera's clock as it is known best.
    pub(super) fn clock_guess(&self) -> f64 {
        let known = self.state().or(self.kept.as_deref());
        known.map_or(self.config.camera_clock_offset, |s| s.camera_clock)
    }

    /// What is known of the climber's clock at the start from an image: nothing, and all moves rigidly with the climber.
    pub(super) fn rigid_tie(&self, state: &State, image: Stamp) -> Tie {
        match tie::speed(&self.readings, image, &self.reading_noise.variance()) {
            Some(speed) => Tie { by_offset: rigid(state, &speed), known: true, ..Tie::none() },
            None => Tie::none(),
        }
    }

    /// Drops the pose and what led to it, and keeps what was learnt of clocks, biases and noise: the next image starts it.
    pub(super) fn restart(&mut self) {
        if let Some(state) = self.state().cloned() {
            self.kept = Some(Box::new(state));
        }
        self.archive_all();
        self.history.clear();
        self.started = false;
        self.newest_imu = None;
        self.jump = None;
        self.awaited = None;
        self.stillness.clear();
        self.contradictions = 0;
        self.contradicted_since = None;
    }

    /// Clocks and biases of before an outage; the biases are worth half.
    pub(super) fn remember(&mut self, state: &mut State) {
        let Some(kept) = self.kept.take() else { return };
        state.accelerometer_bias = kept.accelerometer_bias;
        state.gyroscope_bias = kept.gyroscope_bias;
        state.camera_clock = kept.camera_clock;
        state.tie = Tie { information: kept.tie.information, pull: kept.tie.pull, ..state.tie.clone() };
        state.set_variance_of(CAMERA_CLOCK, kept.covariance[(CAMERA_CLOCK, CAMERA_CLOCK)]);
        for first in [ACCELEROMETER, GYROSCOPE] {
            let sigmas = Vector3::from_fn(|i, _| {
                (2.0 * kept.covariance[(first + i, first + i)].max(0.0).sqrt()).max(1e-4)
            });
            state.set_variance(first, &sigmas);
        }
    }

    /// What is known of "up" at an instant: the unit's own attitude, else its accelerometer.
    pub(super) fn up_at(&self, stamp: Stamp) -> Option<Up> {
        let nearest = self
            .attitudes
            .iter()
            .min_by_key(|(s, _)| (s.as_nanos() - stamp.as_nanos()).unsigned_abs())
            .filter(|(s, _)| s.seconds_since(stamp).abs() < 0.1);
        if let Some((_, up)) = nearest {
            return Some(*up);
        }
        let mut sum = Vector3::zeros();
        for place in 0..self.history.len() {
            if let Some(node) = self.history.get(place)
                && matches!(node.event, Event::Imu { .. })
                && node.stamp.seconds_since(stamp).abs() < 0.3
            {
                sum += node.felt.force;
            }
        }
        sum.try_normalize(1e-3).map(|in_imu| Up { in_imu, sigma: start::SWING_TILT })
    }

    /// Starts from an image, or keeps it until the inertial samples have come to its time.
    pub(super) fn start_or_wait(
        &mut self,
        geometry: &Geometry,
        image: Stamp,
        pixels: Pixels,
        out: &mut VecDeque<Output>,
    ) {
        self.evidence.pass(image);
        let at = image.plus_seconds(self.clock_guess());
        if self.newest_imu.is_some_and(|(newest, _)| at <= newest) {
            self.try_start(geometry, image, &pixels, out);
            return;
        }
        // The first one is kept: were it replaced by each that follows, none would ever be reached.
        let stale = self.awaited.is_none_or(|(kept, _)| image.seconds_since(kept).abs() > AHEAD);
        if stale && pixels.iter().flatten().count() >= 3 {
            self.awaited = Some((image, pixels));
        } else {
            self.refuse(image, &pixels, MarkerOutcome::NotInitialised, out);
        }
    }

    pub(super) fn try_start(
        &mut self,
        geometry: &Geometry,
        stamp: Stamp,
        pixels: &Pixels,
        out: &mut VecDeque<Output>,
    ) {
        let seen = pixels.iter().flatten().count();
        let clock = self.clock_guess();
        let image = stamp;
        let stamp = image.plus_seconds(clock);
        let up = self.up_at(stamp);
        let felt_before = (0..self.history.len())
            .filter_map(|p| self.history.get(p))
            .any(|n| matches!(n.event, Event::Imu { .. }) && n.stamp <= stamp);
        // What the encoders' clock says at the image's instant.
        let climber = self.climber_at(image.plus_seconds(-self.climber_clock));
        let (Some((climber, rest)), true, true, false) = (climber, seen >= 3, felt_before, self.frozen)
        else {
            self.refuse(image, pixels, MarkerOutcome::NotInitialised, out);
            return;
        };
        let sighting = Sighting { pixels: *pixels, clock, felt: NOTHING, rest };
        let found = start::hypotheses(geometry, &self.config, &sighting, up.as_ref(), &climber);
        let Some(best) = found.into_iter().next() else {
            self.refuse(image, pixels, MarkerOutcome::Inconsistent, out);
            return;
        };
        self.record(image, &best.report, out);
        self.last_used = Some(image);
        out.push_back(Output::Warning(Warning::Initialised { stamp: image }));
        self.started = true;
        let mut state = best.state;
        state.tie = self.rigid_tie(&state, image);
        self.remember(&mut state);
        self.begin(stamp, state, out);
    }

    /// Puts a state at an instant and runs what is behind it.
    pub(super) fn begin(&mut self, stamp: Stamp, state: State, out: &mut VecDeque<Output>) {
        let place = self.history.place_of(stamp);
        let felt =
            match (place.checked_sub(1).and_then(|p| self.history.get(p)), self.history.next_imu(place)) {
                (Some(before), Some(next)) if matches!(before.event, Event::Imu { .. }) => {
                    let span = next.stamp.seconds_since(before.stamp);
                    let share = if span > 0.0 { stamp.seconds_since(before.stamp) / span } else { 0.0 };
                    before.felt.between(&next.felt, share.clamp(0.0, 1.0))
                }
                (_, Some(next)) => next.felt,
                (_, None) => match self.newest_imu {
                    Some((_, felt)) => felt,
                    None => return,
                },
            };
        for _ in 0..place {
            self.archive_first();
            self.history.drop_first();
        }
        let place = self.history.insert(stamp, Event::Set, felt);
        if let Some(node) = self.history.get_mut(place) {
            node.state = state;
        }
        self.history.set_run(1);
        self.run(out);
    }

    /// The first readings tell how noisy the encoders are, and were believed before that: where the noise is found to be another than was
    /// assumed, they and the start are weighed anew, and all since is run again.
    pub(super) fn weigh_readings_anew(&mut self, variance: &Vector3<f64>) {
        let factor = variance.component_div(&self.reading_variance);
        if factor.iter().all(|f| (1.0 / REWEIGHED..REWEIGHED).contains(f)) {
            return;
        }
        let before = std::mem::replace(&mut self.reading_variance, *variance);
        let more = (variance - before).map(|more| more.max(0.0));
        for place in 0..self.history.len() {
            let Some(node) = self.history.get_mut(place) else { continue };
            match &mut node.event {
                Event::Climber(reading) => reading.variance = variance.component_mul(&reading.share),
                // All that the image showed moves with the climber.
                Event::Set if place == 0 => {
                    for axis in (0..3).filter(|axis| more[*axis] > 0.0) {
                        let moved = rigid(&node.state, &Vector3::ith(axis, 1.0));
                        node.state.covariance.ger(more[axis], &moved, &moved, 1.0);
                        let rate = CLIMBER_RATE + axis;
                        node.state.covariance[(rate, rate)] += CLIMBER_SPEED_SIGMA[axis].powi(2);
                    }
                }
                Event::Set | Event::Imu { .. } | Event::Markers { .. } => {}
            }
        }
        // Before the start nothing was run.
        self.history.set_run(self.history.run().min(1));
    }

    /// The climber at an instant from the readings around it.
    pub(super) fn climber_at(&self, stamp: Stamp) -> Option<(ClimberStart, ClimberRest)> {
        let (newest, _, _) = self.readings.back()?;
        if newest.seconds_since(stamp).abs() > 1.0 {
            return None;
        }
        let recent = || self.readings.iter().filter(|(s, _, _)| s.seconds_since(stamp).abs() < 0.25);
        let nearest =
            self.readings.iter().min_by_key(|(s, _, _)| (s.as_nanos() - stamp.as_nanos()).unsigned_abs())?;
        // An encoder that only rounds is off by its step at most.
        let step = self.reading_noise.variance().map(|v| (12.0 * v).sqrt());
        let any = Vector3::from(CLIMBER_SPEED_SIGMA);
        let (mut rates, mut rate_sigma) = (Vector3::zeros(), any);
        if let (Some(first), Some(last)) = (recent().next(), recent().next_back()) {
            let span = last.0.seconds_since(first.0);
            if span > 0.03 {
                rates = last.1 - first.1;
                rates.z = climber::wrapped(rates.z);
                rates /= span;
                rate_sigma = (step / span + Vector3::from(CLIMBER_ACCELERATION_SIGMA) * span).inf(&any);
            }
        }
        let age = stamp.seconds_since(nearest.0);
        let values = nearest.1 + rates * age;
        let sigma = step + rate_sigma * age.abs();
        Some((ClimberStart { values, rates, sigma, rate_sigma }, nearest.2))
    }
}
