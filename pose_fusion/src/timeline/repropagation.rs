//! Processing of the time line: from state to state, event by event, up to its end.

use super::{
    dropout::{self, BRIDGED, GAP, HELD},
    history::{Entry, Event, History},
};
use crate::{
    adaptation::{disturbances::Disturbances, imu_noise::Densities},
    config::TightConfig,
    ekf::propagation::{ImuReading, ProcessNoise, propagate},
    measurements::{
        Innovation,
        encoders::{self, CONTRADICTION},
        geometry::{ClimberHeightTilt, Geometry},
        markers::{self, ImageInnovation},
        rope::{self, Rope},
        zero_velocity,
    },
};
use rig_model::Stamp;

/// What a step needs beside the history.
pub struct Context<'a> {
    /// Configuration.
    pub config: &'a TightConfig,
    /// Geometry of the rig.
    pub geometry: &'a Geometry,
    /// Process noise apart from the IMU's.
    pub noise: ProcessNoise,
    /// Disturbances.
    pub disturbances: &'a Disturbances,
    /// Rope with the climber's height and tilt, where it is known.
    pub rope: Option<(Rope, ClimberHeightTilt)>,
    /// Share of the motion's changes between images that is noise.
    pub noise_of_changes: Densities,
    /// Mean time between IMU samples, s.
    pub imu_period: f64,
}

/// What became of the event that a step processed.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "it lives on the stack for one step, and steps allocate nothing"
)]
pub enum Step {
    /// IMU sample, or a state that was set.
    Inertial,
    /// Image: its records, and half the width of the mean that its motion is, s.
    Image(ImageInnovation, f64),
    /// Encoder reading: its innovation before the update.
    Encoders(Innovation<3>),
}

/// Processes the next event up to `end`. Returns its place and what became of it; `None` where
/// nothing is left.
///
/// An encoder reading that contradicts the state is not applied: the caller decides and rewinds, or
/// excludes it.
pub fn step(history: &mut History, context: &Context<'_>, end: Stamp) -> Option<(usize, Step)> {
    let place = history.processed().max(1);
    if history.get(place).is_none_or(|n| n.stamp > end) {
        return None;
    }
    let (source, imu_noise) =
        source(history, place).unwrap_or((ReadingSource::Uniform, Densities::default()));
    let is_image = matches!(history.get(place)?.event, Event::Image { .. });
    let smoothed = if is_image { history.motion(place) } else { None };
    let (from, to) = history.step(place)?;
    let gravity = context.config.gravity;
    let dt = to.stamp.seconds_since(from.stamp);
    to.state.clone_from(&from.state);
    let mut noise = context.noise;
    (noise.force, noise.rate) = (imu_noise.force, imu_noise.rate);
    let reading = match source {
        ReadingSource::Uniform => {
            noise = dropout::blind(&noise);
            ImuReading::of_uniform_motion(&from.state, gravity)
        }
        ReadingSource::Held { reading, seconds } => {
            noise = dropout::extrapolated(&noise, seconds);
            reading
        }
        ReadingSource::Interpolated { share, next, gap } => {
            if let Some(seconds) = gap {
                noise = dropout::interpolated(&noise, seconds);
            }
            from.reading.lerp(&next, share)
        }
    };
    if !matches!(to.event, Event::Imu { .. }) {
        to.reading = reading;
    }
    to.motion = to.reading.into();
    let (start, end) = if let ReadingSource::Interpolated { .. } = source {
        to.motion = smoothed.map_or(to.motion, |(motion, _)| motion);
        let Densities { force, rate } = context.noise_of_changes;
        noise.change = to.motion.change_since(&from.motion, [force, rate]);
        (from.reading, to.reading)
    } else {
        (reading, reading)
    };
    context.disturbances.add_to(&mut noise, to.stamp);
    to.noise = noise;
    propagate(&mut to.state, &start, &end, dt, gravity, &noise);
    let unseen = from.unseen;
    to.unseen = unseen + dt;
    let blind = !matches!(source, ReadingSource::Interpolated { gap: None, .. });
    let smoothing = smoothed.map_or(0.0, |(_, half_width)| half_width);
    let step = apply(to, unseen, blind, smoothing, context);
    history.set_processed(place + 1);
    Some((place, step))
}

/// Applies the event of an entry whose state has been propagated to it.
fn apply(
    entry: &mut Entry,
    unseen: f64,
    blind: bool,
    smoothing: f64,
    context: &Context<'_>,
) -> Step {
    let (config, gravity) = (context.config, context.config.gravity);
    let Entry { event, state, reading, noise, unseen: still_unseen, .. } = entry;
    match event {
        Event::Set => Step::Inertial,
        Event::Imu { at_rest, .. } => {
            if let (Some(rate), true) = (at_rest, config.zero_velocity_sigma > 0.0) {
                let variance = noise.rate / crate::adaptation::stationary::WINDOW;
                zero_velocity::update(state, rate, config.zero_velocity_sigma, variance);
            }
            if let (Some((rope, rest)), false) = (&context.rope, blind)
                && rope::is_due(unseen, *still_unseen)
            {
                rope.update(state, reading, rest, noise.force / context.imu_period, gravity);
            }
            Step::Inertial
        }
        Event::Image { image, apply, .. } => {
            let (gate, geometry, apply) = (config.markers.gate, context.geometry, *apply);
            let record = markers::update(state, geometry, image, reading, gate, gravity, apply);
            if apply && record.used > 0 {
                *still_unseen = 0.0;
            }
            Step::Image(record, smoothing)
        }
        Event::Encoders { reading: encoder, excluded, .. } => {
            let offset = config.clock.climber_offset;
            let innovation = encoders::innovation(state, encoder, offset);
            if !*excluded && innovation.nis <= CONTRADICTION {
                encoders::update(state, encoder, reading, offset, gravity);
            }
            Step::Encoders(innovation)
        }
    }
}

/// Where the readings of a step come from.
enum ReadingSource {
    /// No IMU sample within reach: uniform motion.
    Uniform,
    /// The reading of the first sample after a long gap, this many seconds later.
    Held { reading: ImuReading, seconds: f64 },
    /// Interpolated towards the next IMU sample, across a gap of this length where it is one.
    Interpolated { share: f64, next: ImuReading, gap: Option<f64> },
}

/// Returns where the readings of the step to a place come from, and the IMU's noise in it; `None`
/// without an IMU sample behind the place.
fn source(history: &History, place: usize) -> Option<(ReadingSource, Densities)> {
    let (last, next) = (history.last_imu(place)?, history.next_imu(place)?);
    let Event::Imu { noise, .. } = next.event else { return None };
    let (before, entry) = (history.get(place.checked_sub(1)?)?, history.get(place)?);
    let gap = next.stamp.seconds_since(last.stamp);
    let span = next.stamp.seconds_since(before.stamp);
    let source = if gap <= BRIDGED {
        let share = if span > 0.0 { entry.stamp.seconds_since(before.stamp) / span } else { 0.0 };
        ReadingSource::Interpolated {
            share: share.clamp(0.0, 1.0),
            next: next.reading,
            gap: (gap > GAP).then_some(gap),
        }
    } else if span < HELD {
        ReadingSource::Held { reading: next.reading, seconds: span }
    } else {
        ReadingSource::Uniform
    };
    Some((source, noise))
}
