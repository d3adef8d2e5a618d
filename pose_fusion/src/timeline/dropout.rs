//! Process noise where IMU samples are missing. Equations: `docs/src/equations.md`, "Late
//! measurements".

use crate::ekf::propagation::ProcessNoise;

/// A longer interval between IMU samples is a gap, s.
pub const GAP: f64 = 0.05;
/// A longer gap is not interpolated, s.
pub const BRIDGED: f64 = 0.4;
/// The first reading after a longer gap is also used for this time before its stamp, s.
pub const HELD: f64 = 0.15;
/// Specific force of a swing beside its mean, m/s² (1 sigma): 35° at 1 Hz, 0.25 m of rope.
const FORCE: f64 = 3.0;
/// Its angular velocity, rad/s (1 sigma).
const RATE: f64 = 2.0;
/// Density of the climber's jerk, m²/s⁵ and rad²/s⁵: 0.25 m within 0.9 s without encoders
/// (1 sigma).
const JERK: [f64; 3] = [2.5, 2.5, 0.5];
/// 1 Hz, rad/s.
const FREQUENCY: f64 = std::f64::consts::TAU;
/// How long the missed part keeps its sign, s.
const CORRELATION: f64 = 0.3;

/// Returns the process noise of a motion of which the share `missed` is not measured for `seconds`.
fn missed(usual: &ProcessNoise, missed: f64, seconds: f64) -> ProcessNoise {
    let (missed, span) = (missed.min(1.0), seconds.min(CORRELATION));
    usual.plus((missed * FORCE).powi(2) * span, (missed * RATE).powi(2) * span)
}

/// Returns the process noise within a gap of `seconds` that is interpolated.
pub fn interpolated(usual: &ProcessNoise, seconds: f64) -> ProcessNoise {
    missed(usual, FREQUENCY * FREQUENCY * seconds * seconds / 8.0, seconds)
}

/// Returns the process noise of a motion that goes on for `seconds` with the last reading: a motion
/// of angular frequency ω and amplitude A is missed by `A ω T/2` in the mean.
pub fn extrapolated(usual: &ProcessNoise, seconds: f64) -> ProcessNoise {
    missed(usual, FREQUENCY * seconds / 2.0, seconds)
}

/// Returns the process noise of uniform motion without any IMU sample. Images alone cannot
/// distinguish the climber's acceleration from the platform's, and the climber may start or stop.
pub fn blind(usual: &ProcessNoise) -> ProcessNoise {
    let missed = missed(usual, 1.0, CORRELATION);
    ProcessNoise { jerk: usual.jerk.sup(&JERK.into()), ..missed }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_noise_of_a_long_gap_is_that_of_a_motion_missed_altogether() {
        let usual = ProcessNoise { force: 4e-6, rate: 7.6e-7, ..ProcessNoise::default() };
        assert_eq!(interpolated(&usual, 2.0).force, blind(&usual).force);
        // Without IMU and encoders a climber of 0.5 m/s may stop within a second.
        let second = (blind(&usual).jerk.x / 20.0).sqrt();
        assert!((0.3..0.5).contains(&second), "{second}");
        let lively = ProcessNoise { jerk: nalgebra::Vector3::repeat(50.0), ..usual };
        assert_eq!(blind(&lively).jerk, lively.jerk);
    }
}
