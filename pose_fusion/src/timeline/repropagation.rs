//! Processing of the time line: from state to state, event by event, up to its end.

use super::{
    dropout::{self, GAP, HELD, INTERPOLATED},
    history::{Entry, Event, History},
};
use crate::{
    adaptation::{disturbances::Disturbances, imu_noise::Densities},
    config::TightConfig,
    ekf::propagation::{ImuReading, ProcessNoise, propagate},
    measurements::{
        Innovation,
        encoders::{self, CONTRADICTION},
        geometry::{ClimberRest, Geometry},
        markers::{self, Image, ImageInnovation},
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
    pub rope: Option<(Rope, ClimberRest)>,
    /// Share of the motion's changes between images that is noise.
    pub noise_of_changes: Densities,
    /// Mean time between IMU samples, s.
    pub imu_period: f64,
    /// Markers are compared and not used.
    pub frozen: bool,
}

/// What a step processed.
#[derive(Clone, Debug)]
#[expect(
    clippy::large_enum_variant,
    reason = "it lives on the stack for one step, and steps allocate nothing"
)]
pub enum Step {
    /// IMU sample, or a state that was set.
    Inertial,
    /// Image.
    Image {
        /// Stamp of the image, camera time.
        stamp: Stamp,
        /// Markers.
        image: Image,
        /// Records.
        record: ImageInnovation,
        /// Processed for the first time.
        fresh: bool,
        /// Half the width of the mean that its motion is, s.
        smoothing: f64,
    },
    /// Encoder reading.
    Encoders {
        /// Innovation before the update.
        innovation: Innovation<3>,
        /// It was not used.
        excluded: bool,
        /// Processed for the first time.
        fresh: bool,
    },
}

/// Processes the next event up to `end`. Returns its place and what it was; `None` where nothing is
/// left.
///
/// An encoder reading that contradicts the state is not applied: the caller decides and rewinds, or
/// excludes it.
pub fn step(history: &mut History, context: &Context<'_>, end: Stamp) -> Option<(usize, Step)> {
    let place = history.processed().max(1);
    if history.get(place).is_none_or(|n| n.stamp > end) {
        return None;
    }
    let drive = Drive::of(history, place);
    let is_image = matches!(history.get(place)?.event, Event::Image { .. });
    let smoothed = if is_image { history.motion(place) } else { None };
    let smoothing = smoothed.map_or(0.0, |(_, half_width)| half_width);
    let (from, to) = history.step(place)?;
    let gravity = context.config.gravity;
    let dt = to.stamp.seconds_since(from.stamp);
    to.state.clone_from(&from.state);
    let mut noise = context.noise;
    (noise.force, noise.rate) = (drive.noise.force, drive.noise.rate);
    let is_imu = matches!(to.event, Event::Imu { .. });
    let start = match drive.source {
        Source::Uniform => {
            let uniform = ImuReading::of_uniform_motion(&from.state, gravity);
            if !is_imu {
                to.reading = uniform;
            }
            noise = dropout::blind(&noise);
            to.motion = to.reading.into();
            (uniform, uniform)
        }
        Source::Held { reading, seconds } => {
            if !is_imu {
                to.reading = reading;
            }
            noise = dropout::extrapolated(&noise, seconds);
            to.motion = to.reading.into();
            (reading, reading)
        }
        Source::Interpolated { share, next, gap } => {
            if !is_imu {
                to.reading = from.reading.lerp(&next, share);
            }
            if let Some(seconds) = gap {
                noise = dropout::interpolated(&noise, seconds);
            }
            to.motion = smoothed.map_or(to.reading.into(), |(motion, _)| motion);
            let Densities { force, rate } = context.noise_of_changes;
            noise.change = to.motion.change_since(&from.motion, [force, rate]);
            (from.reading, to.reading)
        }
    };
    context.disturbances.add_to(&mut noise, to.stamp);
    to.noise = noise;
    propagate(&mut to.state, &start.0, &start.1, dt, gravity, &noise);
    let unseen = from.unseen;
    to.unseen = unseen + dt;
    let blind = !matches!(drive.source, Source::Interpolated { gap: None, .. });
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
        Event::Image { image, stamp, fresh } => {
            let (gate, geometry, apply) = (config.markers.gate, context.geometry, !context.frozen);
            let record = markers::update(state, geometry, image, reading, gate, gravity, apply);
            if apply && record.used > 0 {
                *still_unseen = 0.0;
            }
            Step::Image {
                stamp: *stamp,
                image: *image,
                record,
                fresh: std::mem::take(fresh),
                smoothing,
            }
        }
        Event::Encoders { reading: encoder, excluded, fresh } => {
            let offset = config.clock.climber_offset;
            let innovation = encoders::innovation(state, encoder, offset);
            if !*excluded && innovation.nis <= CONTRADICTION {
                encoders::update(state, encoder, reading, offset, gravity);
            }
            Step::Encoders { innovation, excluded: *excluded, fresh: std::mem::take(fresh) }
        }
    }
}

/// Where the readings of a step come from, and the IMU's noise in it.
struct Drive {
    source: Source,
    noise: Densities,
}

enum Source {
    /// No IMU sample within reach: uniform motion.
    Uniform,
    /// The reading of the first sample after a long gap, this many seconds later.
    Held { reading: ImuReading, seconds: f64 },
    /// Interpolated towards the next IMU sample, across a gap of this length where it is one.
    Interpolated { share: f64, next: ImuReading, gap: Option<f64> },
}

impl Drive {
    fn of(history: &History, place: usize) -> Self {
        let uniform = Self { source: Source::Uniform, noise: Default::default() };
        let (Some(last), Some(entry)) = (history.last_imu(place), history.get(place)) else {
            return uniform;
        };
        let Some(next) = history.next_imu(place) else { return uniform };
        let Event::Imu { noise, .. } = next.event else { return uniform };
        let Some(before) = place.checked_sub(1).and_then(|p| history.get(p)) else {
            return uniform;
        };
        let gap = next.stamp.seconds_since(last.stamp);
        if gap > INTERPOLATED {
            let seconds = next.stamp.seconds_since(before.stamp);
            let held = Source::Held { reading: next.reading, seconds };
            return Self { source: if seconds < HELD { held } else { Source::Uniform }, noise };
        }
        let span = next.stamp.seconds_since(before.stamp);
        let share = if span > 0.0 { entry.stamp.seconds_since(before.stamp) / span } else { 0.0 };
        let source = Source::Interpolated {
            share: share.clamp(0.0, 1.0),
            next: next.reading,
            gap: (gap > GAP).then_some(gap),
        };
        Self { source, noise }
    }
}
