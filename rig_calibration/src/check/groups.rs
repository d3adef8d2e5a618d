//! Groups of parameters: what can be wrong, how well it is usually known, and how large an error
//! matters.

use super::select::PER_PARAMETER;
use crate::parameters::{
    CAMERA_CLOCK, CAMERA_PLACE, CAMERA_TURN, CARRIAGE, CLIMBER_CLOCK, DISTORTION, FOCAL,
    FORCE_SCALE, IMU_PLACE, IMU_TURN, LAYOUT_SCALE, MARKERS, PRINCIPAL, RAILS, RATE_SCALE, READOUT,
    TURN_SCALE,
};
use rig_model::Distortion;

/// What can be wrong as a whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Cause {
    CameraTilt,
    CameraYaw,
    CameraPlace,
    ImuTurn,
    ImuPlace,
    Marker(usize),
    Focal,
    Principal,
    Distortion,
    LayoutScale,
    RailX,
    RailY,
    TurnScale,
    GyroScale,
    AccelerometerScale,
    ClimberClock,
    ImuClock,
    Readout,
    Carriage,
}

/// One cause, with its parameters.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Group {
    pub cause: Cause,
    /// First parameter, and their number.
    pub first: usize,
    pub count: usize,
    /// Standard deviation of what a careful survey leaves: the prior unless the cause is suspected.
    pub tight: f64,
    /// Standard deviation of the prior when it is.
    pub wide: f64,
    /// Errors that are suspect and wrong.
    pub sizes: [f64; 2],
    /// Unit, and factor from SI to it.
    pub unit: (&'static str, f64),
}

const DEG: f64 = std::f64::consts::PI / 180.0;
const ANGLE: (&str, f64) = ("deg", 1.0 / DEG);
const LENGTH: (&str, f64) = ("mm", 1e3);
const SHARE: (&str, f64) = ("%", 100.0);
const TIME: (&str, f64) = ("ms", 1e3);
const PIXEL: (&str, f64) = ("px", 1.0);
const ANGLE_BY_ACCELERATION: (&str, f64) = ("deg s²/m", 1.0 / DEG);

const fn group(
    cause: Cause,
    first: usize,
    count: usize,
    [tight, wide]: [f64; 2],
    sizes: [f64; 2],
    unit: (&'static str, f64),
) -> Group {
    Group { cause, first, count, tight, wide, sizes, unit }
}

const fn marker(i: usize) -> Group {
    group(Cause::Marker(i), MARKERS.start + 3 * i, 3, [5e-4, 0.3], [5e-3, 0.010], LENGTH)
}

/// All groups. The sizes are those that cost the pose more than its usual accuracy of some
/// millimeters (`test/ROBUSTNESS.md`).
pub(crate) const GROUPS: [Group; 22] = [
    group(Cause::CameraTilt, CAMERA_TURN.start, 2, [0.1 * DEG, 0.5], [0.5 * DEG, 1.0 * DEG], ANGLE),
    group(
        Cause::CameraYaw,
        CAMERA_TURN.start + 2,
        1,
        [0.3 * DEG, 0.5],
        [2.0 * DEG, 4.0 * DEG],
        ANGLE,
    ),
    group(Cause::CameraPlace, CAMERA_PLACE.start, 2, [5e-3, 0.3], [0.03, 0.06], LENGTH),
    group(Cause::ImuTurn, IMU_TURN.start, 3, [0.3 * DEG, 0.5], [1.5 * DEG, 3.0 * DEG], ANGLE),
    group(Cause::ImuPlace, IMU_PLACE.start, 3, [5e-3, 10.0], [0.03, 0.06], LENGTH),
    marker(0),
    marker(1),
    marker(2),
    marker(3),
    group(Cause::Focal, FOCAL, 1, [1e-3, 0.7], [5e-3, 0.02], SHARE),
    group(Cause::Principal, PRINCIPAL.start, 2, [1.0, 50.0], [6.0, 15.0], PIXEL),
    group(Cause::Distortion, DISTORTION.start, 4, [2e-3, 0.5], [0.05, 0.1], ("", 1.0)),
    group(Cause::LayoutScale, LAYOUT_SCALE, 1, [1e-3, 0.7], [4e-3, 0.008], SHARE),
    group(Cause::RailX, RAILS.start, 1, [1e-3, 3.0], [4e-3, 0.008], SHARE),
    group(Cause::RailY, RAILS.start + 3, 1, [1e-3, 3.0], [4e-3, 0.008], SHARE),
    group(Cause::TurnScale, TURN_SCALE, 1, [3e-3, 3.0], [0.012, 0.025], SHARE),
    group(Cause::GyroScale, RATE_SCALE.start, 3, [2e-3, 0.5], [8e-3, 0.015], SHARE),
    group(Cause::AccelerometerScale, FORCE_SCALE.start, 3, [3e-3, 0.5], [0.015, 0.03], SHARE),
    group(Cause::ClimberClock, CLIMBER_CLOCK, 1, [2e-3, 0.3], [8e-3, 0.02], TIME),
    group(Cause::ImuClock, CAMERA_CLOCK, 1, [0.03, 0.1], [0.03, 0.1], TIME),
    group(Cause::Readout, READOUT, 1, [5e-4, 0.1], [3e-3, 6e-3], TIME),
    group(
        Cause::Carriage,
        CARRIAGE.start,
        2,
        [0.005 * DEG, 0.5],
        [0.1 * DEG, 0.15 * DEG],
        ANGLE_BY_ACCELERATION,
    ),
];

impl Group {
    /// Indexes of its parameters.
    pub fn indexes(&self) -> std::ops::Range<usize> {
        self.first..self.first + self.count
    }

    /// Factor on priors and sizes of a parameter: tangential coefficients act more than radial
    /// ones, which are all that a fisheye lens has.
    pub fn scale(&self, i: usize, lens: &Distortion) -> f64 {
        let tangential = self.cause == Cause::Distortion && i >= self.first + 2;
        if tangential && !matches!(lens, Distortion::Equidistant(_)) { 0.03 } else { 1.0 }
    }

    /// Cost that it must explain to count, in units of the noise. χ² of one degree of freedom
    /// exceeds 8 + 5 with a probability of 3e-4. Encoders count in steps, which are no white noise,
    /// and a wrong camera position resembles the drift of an IMU: they must explain more. The tilt
    /// of a carriage that swings to and fro resembles several of the others together.
    pub fn least(&self) -> f64 {
        match self.cause {
            Cause::CameraPlace | Cause::RailX | Cause::RailY => 40.0,
            Cause::Carriage => 200.0,
            _ => 8.0,
        }
    }

    /// Number of standard deviations from which it is found; a value is unobservable where a wrong
    /// one would not be.
    pub fn detectable(&self) -> f64 {
        (self.least() + PER_PARAMETER * self.count as f64).sqrt()
    }

    /// Whether it is free in any case: the filter estimates it itself.
    pub fn always_free(&self) -> bool {
        self.cause == Cause::ImuClock
    }
}
