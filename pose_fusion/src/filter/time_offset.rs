//! Camera time offset of the filter: searched by alignment ([`crate::initialization::time_offset`])
//! until it is known.

use super::{Filter, starting::OFFSET_SIGMA};
use crate::{
    adaptation::layout_misfit::LayoutMisfit,
    ekf::{propagation::ImuReading, state::TIME_OFFSET},
    health::encoder_trust::Cause,
    initialization::{
        from_image,
        time_offset::{FINAL, TimeOffset, TimeOffsetSearch, WINDOW},
    },
    input::imu::given,
    measurements::{marker_prediction::linearize, markers::Pixels},
    output::Warning,
    timeline::history::{Entry, Event},
};
use nalgebra::{Matrix6, Point3};
use rig_model::{Stamp, planar_pose::PlanarPose};

/// A filter whose time offset is no further off than this corrects it by itself, s.
const OFFSET_LINEAR: f64 = 0.008;
/// Smallest change of latency that restarts the filter, s; errors of the rig file look smaller.
const CHANGED: f64 = 0.02;
/// A filter agrees with an alignment within this many sigma of both.
const AGREES: f64 = 3.0;
/// Sigmas of filter and alignment from which the filter restarts before the alignment is final.
const GROSS: f64 = 4.0;
/// A filter that knows its time offset to this, s, and agrees with an alignment, needs no other.
const KNOWN: f64 = 0.003;
/// A filter that has stayed near one offset for this time knows it, s.
const SETTLED: f64 = 2.5;
/// Uncertainty added to the offset where images contradict, s, for a change without a restart.
const REOPENED: f64 = 0.005;
/// Tilt by which aligned image poses may miss "up", rad: a swing within the unknown offset.
const TILT: f64 = 0.1;
/// An image further from its nearest encoder reading than this is not aligned, s.
pub(super) const CLIMBER_NEAR: f64 = 0.05;

impl Filter {
    /// Aligns image poses with the IMU until the camera time offset is known, then initializes it.
    pub(super) fn search_time_offset(&mut self, stamp: Stamp, pixels: &Pixels) {
        let Some(geometry) = &self.setup.geometry else { return };
        let Some(mut search) = self.search.take() else { return };
        // What is searched is the rest beside the configured offset.
        let middle = self.setup.camera_offset;
        let wrong = self.trust.cause().is_some_and(|cause| cause != Cause::Contradiction);
        if wrong || self.climber.may_be_stuck() {
            // Image poses are as wrong as the encoders that they are computed with. A contradiction
            // may as well come from the time offset.
            search.clear();
        } else if let Some((pose, covariance)) = self.image_pose(stamp, pixels) {
            search.add_pose(stamp.plus_seconds(middle), &pose, &covariance);
        }
        let c = &self.setup.config;
        let noise = self.imu.densities(&self.setup.rig.imu);
        let offset = self.time_offset();
        if (offset - self.start.settled.1).abs() > OFFSET_LINEAR {
            self.start.settled = (stamp, offset);
        }
        if self.time_offset_sigma().is_none_or(|sigma| sigma >= KNOWN) {
            self.start.unknown = stamp;
        }
        let found = search.find(
            offset - middle,
            &geometry.volant_from_imu,
            c.gravity,
            &c.imu,
            &noise,
            &given(&self.setup.rig.imu),
        );
        let found = found.map(|rest| TimeOffset { offset: middle + rest.offset, ..rest });
        if let Some(found) = found {
            let away = (self.time_offset() - found.offset).abs();
            let agrees = away < found.sigma;
            self.start.offset_doubt =
                Some(if agrees { found.sigma } else { found.sigma.hypot(away) });
        }
        match found {
            Some(found) if found.sigma < FINAL || self.confirms(stamp, &found) => {
                self.initialize_time_offset(stamp, found);
            }
            // It shows that the filter is far off: the filter restarts, the search goes on.
            Some(found) if self.contradicts(&found) => {
                self.initialize_time_offset(stamp, found);
                self.start.offset_doubt = Some(found.sigma);
                self.search = Some(search);
            }
            None if self.has_settled(stamp, &search) => {
                self.start.offset_doubt = None;
                self.reopen_time_offset(REOPENED * REOPENED);
            }
            _ => self.search = Some(search),
        }
        self.start.searches_again &= self.search.is_some();
    }

    /// Searches the time offset again, because images contradict the prediction: the camera's
    /// latency may have changed. Until an alignment says otherwise the estimate counts; where the
    /// image's markers agree with each other (`agrees`), it may follow a small change.
    pub(super) fn search_again(&mut self, agrees: bool) {
        if self.setup.config.clock.camera_sigma == 0.0 {
            return;
        }
        let reopened = if agrees { REOPENED * REOPENED } else { 0.0 };
        if self.search.is_none() {
            self.search = super::search(&self.setup.config);
            self.start.offset_doubt = Some(0.0);
            self.start.searches_again = true;
            self.reopen_time_offset(reopened);
        }
    }

    /// Adds to the variance of the estimated time offset, s².
    fn reopen_time_offset(&mut self, variance: f64) {
        for place in 0..self.history.len() {
            if let Some(entry) = self.history.get_mut(place) {
                entry.state.forget_time_offset_error();
                entry.state.covariance[(TIME_OFFSET, TIME_OFFSET)] += variance;
            }
        }
    }

    /// Whether the filter knows its offset although no alignment does: motion has determined it,
    /// and for a while it has stayed near one offset, which no alignment refutes.
    fn has_settled(&self, stamp: Stamp, search: &TimeOffsetSearch) -> bool {
        !self.start.searches_again
            && stamp.seconds_since(self.start.settled.0.max(self.start.unknown)) > SETTLED
            && search.agrees_for() > SETTLED
    }

    /// Whether an alignment since the initialization agrees with a filter that knows its offset.
    fn confirms(&self, stamp: Stamp, found: &TimeOffset) -> bool {
        let independent =
            self.monitor.initialized_at.is_some_and(|i| stamp.seconds_since(i) > WINDOW);
        let known = self.time_offset_sigma().filter(|sigma| *sigma < KNOWN);
        let away = (self.time_offset() - found.offset).abs();
        independent && known.is_some_and(|sigma| away < 2.0 * sigma.hypot(found.sigma))
    }

    /// Whether an alignment shows that the filter is further off than it can correct.
    fn contradicts(&self, found: &TimeOffset) -> bool {
        let sigma = found.sigma.hypot(self.time_offset_sigma().unwrap_or(0.0));
        let least = if self.start.searches_again { CHANGED } else { OFFSET_LINEAR };
        (self.time_offset() - found.offset).abs() > least.max(GROSS * sigma)
    }

    /// Pose of the platform in the world from one image and the IMU's direction of "up".
    fn image_pose(
        &self,
        stamp: Stamp,
        pixels: &Pixels,
    ) -> Option<(nalgebra::Isometry3<f64>, Matrix6<f64>)> {
        let geometry = self.setup.geometry.as_ref()?;
        let climber = self.climber_at(stamp).filter(|climber| climber.distance <= CLIMBER_NEAR)?;
        let world_from_climber = climber.rest.join(&climber.values);
        let world_from_camera = world_from_climber * geometry.climber_from_camera;
        let at = stamp.plus_seconds(self.time_offset());
        let up = (self.imu.verticals.at(at))
            .or_else(|| self.up_of_estimate(at))
            .or_else(|| self.imu.force_up_at(at, &self.history));
        // "Up" may be of another instant: it chooses between the poses and moves none.
        let attachment = self.setup.config.pendulum.climber_attachment;
        let attachment = world_from_climber * Point3::from(attachment);
        let calibration =
            self.state().map_or_else(|| self.calibration(), |state| state.calibration);
        let pixels = self.at_one_time(stamp, pixels);
        let found = from_image::candidates(geometry, &calibration, &pixels, None);
        let tilted = |pose: &PlanarPose| {
            let Some(up) = up else { return pose.pixel_cost };
            let world_from_volant = world_from_camera * pose.camera_from_volant;
            let measured = world_from_volant * (geometry.volant_from_imu * up.in_imu);
            let expected = up.in_world(&(attachment.coords - world_from_volant.translation.vector));
            pose.pixel_cost + (measured.angle(&expected) / TILT).powi(2)
        };
        let best = found
            .iter()
            .min_by(|a, b| tilted(a).total_cmp(&tilted(b)))
            .filter(|b| b.pixel_cost < from_image::LARGEST_COST)?;
        let turn = world_from_camera.rotation.to_rotation_matrix();
        let mut to_world = Matrix6::zeros();
        to_world.fixed_view_mut::<3, 3>(0, 0).copy_from(turn.matrix());
        to_world.fixed_view_mut::<3, 3>(3, 3).copy_from(turn.matrix());
        let mut covariance = to_world * best.covariance * to_world.transpose();
        let noise = climber.noise + climber.growth;
        for axis in 0..2 {
            covariance[(axis, axis)] += noise[axis] * noise[axis];
        }
        covariance[(5, 5)] += noise.z * noise.z;
        Some((world_from_camera * best.camera_from_volant, covariance))
    }

    /// Returns markers where they are in the middle of a rolling shutter's exposure.
    fn at_one_time(&self, stamp: Stamp, pixels: &Pixels) -> Pixels {
        let mut moved = *pixels;
        let is_image =
            |entry: &&Entry| matches!(entry.event, Event::Image { stamp: s, .. } if s == stamp);
        if let (Some(geometry), Some(entry)) =
            (&self.setup.geometry, self.history.iter().rev().find(is_image))
            && let (Event::Image { image, .. }, true) = (&entry.event, geometry.readout != 0.0)
        {
            let velocity = linearize(&entry.state, geometry, image, &entry.reading).velocity;
            for (i, pixel) in moved.iter_mut().enumerate() {
                if let Some((pixel, _)) = pixel {
                    *pixel -= velocity.fixed_rows::<2>(2 * i) * geometry.delay_of_row(pixel.y);
                }
            }
        }
        moved
    }

    /// Restarts at the oldest image with the time offset, unless the filter has found the same.
    fn initialize_time_offset(&mut self, stamp: Stamp, found: TimeOffset) {
        let first = self.start.time_offset.replace(found).is_none();
        let away = (self.time_offset() - found.offset).abs();
        let sigma = (OFFSET_SIGMA[1] * found.sigma).hypot(self.time_offset_sigma().unwrap_or(0.0));
        // A filter that came here from far off has errors that its covariance does not contain;
        // they are gone after a while. One that knew its offset restarts only where that is
        // refuted.
        let near = (self.start.initial_offset - found.offset).abs().max(away) < OFFSET_LINEAR;
        let settled = stamp.seconds_since(self.start.settled.0) > WINDOW
            && self.time_offset_sigma().is_some_and(|own| own < KNOWN);
        let agrees = if self.start.searches_again {
            !self.contradicts(&found)
        } else {
            (near || settled) && away < AGREES * sigma
        };
        if first || !agrees {
            self.publisher.warn(Warning::TimeOffset { offset_s: found.offset });
        }
        if agrees || !self.is_started() {
            return;
        }
        // Biases and constants of the IMU that were estimated with an unknown offset are discarded.
        let kept = self.state().filter(|_| self.start.searches_again).map(|state| {
            let mut kept = state.clone();
            kept.time_offset = found.offset;
            kept.set_sigma(TIME_OFFSET, sigma.max(OFFSET_SIGMA[0]));
            kept
        });
        let oldest = self.history.iter().find(|entry| entry.is_imu());
        let oldest = oldest.map_or(Stamp::default(), |entry| entry.stamp);
        let first = self.history.iter().find_map(|entry| match &entry.event {
            Event::Image { image, stamp, .. }
                if image.detected() >= 3 && stamp.plus_seconds(found.offset) >= oldest =>
            {
                Some((*stamp, image.pixels(), self.up_of_estimate(entry.stamp)))
            }
            _ => None,
        });
        self.archive_until(first.as_ref().map(|(stamp, ..)| stamp.plus_seconds(found.offset)));
        let events: Vec<(Stamp, Event, ImuReading)> =
            self.history.iter().map(|e| (e.stamp, e.event.clone(), e.reading)).collect();
        self.history.clear();
        for (at, mut event, reading) in events {
            let moved = match &mut event {
                Event::Set => continue,
                Event::Imu { .. } => 0.0,
                Event::Image { image, .. } => {
                    let before = std::mem::replace(&mut image.time_offset, found.offset);
                    found.offset - before
                }
                Event::Encoders { reading, .. } => {
                    let offset = found.offset + self.setup.config.clock.climber_offset;
                    offset - std::mem::replace(&mut reading.time_offset, offset)
                }
            };
            self.history.insert(at.plus_seconds(moved), event, reading);
        }
        if kept.is_none() {
            self.images.layout = LayoutMisfit::default();
        }
        self.start.kept = kept.map(Box::new);
        if let Some((stamp, pixels, up)) = first {
            self.try_start(stamp, &pixels, up);
        }
    }
}
