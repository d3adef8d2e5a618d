//! What the images teach beside the state: how noisy the pixels are, and when the estimate itself is wrong.

use super::{
    ASKING, NOTHING, Pixels, REFUSED_PRICE, SETTLING, Tight,
    markers::{Report, Sighting, Verdict},
    start::{self, ClimberStart},
    state::{ACCELEROMETER, CAMERA_CLOCK, CLIMBER, CLIMBER_RATE, GYROSCOPE},
    tie::Tie,
};
use crate::output::{MarkerOutcome, MarkerUpdateRecord, Output, Warning};
use nalgebra::{Matrix2, Vector2, Vector3};
use rig_model::{MarkerColor, Stamp};
use std::collections::VecDeque;

impl Tight {
    pub(super) fn refuse(
        &mut self,
        stamp: Stamp,
        pixels: &Pixels,
        outcome: MarkerOutcome,
        out: &mut VecDeque<Output>,
    ) {
        self.evidence.pass(stamp);
        for color in MarkerColor::ALL {
            let outcome = if pixels[color.index()].is_some() { outcome } else { MarkerOutcome::NotDetected };
            out.push_back(Output::MarkerUpdate(MarkerUpdateRecord {
                stamp,
                color,
                innovation: Vector2::repeat(f64::NAN),
                covariance: Matrix2::repeat(f64::NAN),
                nis: f64::NAN,
                outcome,
            }));
        }
    }

    pub(super) fn record(&mut self, stamp: Stamp, report: &Report, out: &mut VecDeque<Output>) {
        for color in MarkerColor::ALL {
            let marker = &report.markers[color.index()];
            let outcome = match marker.verdict {
                Verdict::Absent => MarkerOutcome::NotDetected,
                Verdict::Used if self.frozen => MarkerOutcome::Frozen,
                Verdict::Used => MarkerOutcome::Used,
                Verdict::Gated => MarkerOutcome::Gated,
                Verdict::Inconsistent => MarkerOutcome::Inconsistent,
                Verdict::NotPredictable => MarkerOutcome::NotPredictable,
            };
            match outcome {
                MarkerOutcome::Used => self.status.used_markers += 1,
                MarkerOutcome::Gated | MarkerOutcome::Inconsistent => self.status.rejected_markers += 1,
                _ => {}
            }
            out.push_back(Output::MarkerUpdate(MarkerUpdateRecord {
                stamp,
                color,
                innovation: marker.innovation,
                covariance: marker.covariance,
                nis: marker.nis,
                outcome,
            }));
        }
    }

    /// Learns from what became of an image: pixel noise, lock-out. True where the filter was started anew.
    pub(super) fn learn(
        &mut self,
        image: Stamp,
        pixels: &Pixels,
        report: &Report,
        out: &mut VecDeque<Output>,
    ) -> bool {
        let seen = pixels.iter().flatten().count() as u32;
        self.weighed += 1;
        let refused = f64::from(seen.saturating_sub(report.used));
        let at = self.state().map_or(image, |state| image.plus_seconds(state.camera_clock));
        let shaken = self.jolts.shaken(at);
        if self.weighed <= SETTLING {
            self.evidence.pass(image);
        } else {
            self.evidence.take(image, at, report.surprise + REFUSED_PRICE * refused, shaken);
        }
        self.driven += u64::from(self.driving);
        if self.driven <= ASKING {
            self.history.each_node(|node| node.state.tie.forget());
        } else {
            self.recentre();
        }
        if report.used > 0 && !self.frozen {
            self.last_used = Some(image);
            let ratio = (report.nis / (2.0 * f64::from(report.used))).clamp(0.0, 6.0);
            self.pixel_ratio += (ratio - self.pixel_ratio) / 40.0;
            // Images that fit worse than they claim make the next ones count less, and slowly back.
            if self.pixel_ratio > 1.4 {
                self.pixel_scale = (self.pixel_scale * 1.02).min(100.0);
            } else if self.pixel_ratio < 1.05 {
                self.pixel_scale = (self.pixel_scale * 0.99).max(1.0);
            }
        }
        if report.used >= 3 && !self.frozen && !shaken && self.weighed > self.ask_after {
            self.compare_rope();
        }
        if seen < 2 || report.used * 2 > seen || self.frozen {
            if seen >= 1 && report.used > 0 {
                self.contradictions = 0;
                self.contradicted_since = None;
            }
            return false;
        }
        // A climber that is jolted contradicts, and the estimate is not to blame.
        self.contradictions += u32::from(!shaken);
        let since = *self.contradicted_since.get_or_insert(image);
        if self.contradictions < self.config.lock_out_images {
            return false;
        }
        self.recover(image, since, pixels, out)
    }

    /// The markers have contradicted the estimate for several images: where they agree with each other, they are right.
    pub(super) fn recover(
        &mut self,
        image: Stamp,
        since: Stamp,
        pixels: &Pixels,
        out: &mut VecDeque<Output>,
    ) -> bool {
        let Some(geometry) = self.geometry.clone() else { return false };
        let Some(old) = self.state().cloned() else { return false };
        let Some((_, _, rest)) = self.readings.back().copied() else { return false };
        let at = image.plus_seconds(old.camera_clock);
        let sighting = Sighting { pixels: *pixels, clock: old.camera_clock, felt: NOTHING, rest };
        let sigma = |i: usize| old.covariance[(i, i)].max(0.0).sqrt();
        let climber = ClimberStart {
            values: old.climber,
            rates: old.climber_rate,
            sigma: Vector3::from_fn(|i, _| sigma(CLIMBER + i)),
            rate_sigma: Vector3::from_fn(|i, _| sigma(CLIMBER_RATE + i)),
        };
        let up = self.up_at(at);
        let found = start::hypotheses(&geometry, &self.config, &sighting, up.as_ref(), &climber);
        let Some(best) = found.into_iter().next() else { return false };
        let mut state = best.state;
        state.accelerometer_bias = old.accelerometer_bias;
        state.gyroscope_bias = old.gyroscope_bias;
        state.climber_acceleration = old.climber_acceleration;
        state.tie =
            Tie { information: old.tie.information, pull: old.tie.pull, ..self.rigid_tie(&state, image) };
        state.camera_clock = old.camera_clock;
        state.set_variance_of(CAMERA_CLOCK, sigma(CAMERA_CLOCK).powi(2));
        for first in [ACCELEROMETER, GYROSCOPE] {
            // What was learnt while it was wrong is worth half.
            let sigmas = Vector3::from_fn(|i, _| (2.0 * sigma(first + i)).max(1e-4));
            state.set_variance(first, &sigmas);
        }
        self.begin(at, state, out);
        self.contradictions = 0;
        self.contradicted_since = None;
        self.status.recoveries += 1;
        self.evidence.sum += 100.0;
        out.push_back(Output::Warning(Warning::LockOutRecovered { since, stamp: image }));
        true
    }
}
