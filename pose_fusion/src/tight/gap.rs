//! While no inertial sample comes the motion is not felt, and the uncertainty grows as any usual motion would have it.
//!
//! Across a gap of `T` seconds what is felt is interpolated between its two ends. A motion of angular frequency ω and
//! amplitude A is then missed by at most `A ω² T²/8` (the interpolation's remainder), and by A where the gap is longer than
//! that reaches. The miss is nearly constant over [`CORRELATION`] at most, so that it acts as white noise of the density
//! `miss² · min(T, CORRELATION)` on velocity and attitude.

use super::propagate::Process;

/// A swinging platform's specific force away from its mean, m/s² (1 sigma): 35° at 1 Hz below 0.25 m of rope.
pub const FORCE: f64 = 3.0;
/// Its rate of turn, rad/s (1 sigma).
pub const RATE: f64 = 2.0;
/// 1 Hz, rad/s.
const FREQUENCY: f64 = std::f64::consts::TAU;
/// How long what was missed keeps its sign, s.
pub const CORRELATION: f64 = 0.3;

/// The process within a gap of so many seconds.
pub fn process(usual: &Process, seconds: f64) -> Process {
    let missed = (FREQUENCY * FREQUENCY * seconds * seconds / 8.0).min(1.0);
    let span = seconds.min(CORRELATION);
    Process {
        force: usual.force + (missed * FORCE).powi(2) * span,
        rate: usual.rate + (missed * RATE).powi(2) * span,
        ..*usual
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn a_swing_that_was_not_felt_is_covered() {
        let usual = Process {
            gravity: 9.81,
            force: 4e-6,
            rate: 7.6e-7,
            accelerometer_bias: 0.0,
            gyroscope_bias: 0.0,
            jerk: Vector3::zeros(),
            clock: 0.0,
        };
        // A swing of 5 m/s² at 1 Hz, interpolated linearly over the gap: the velocity that is missed.
        for gap in [0.06, 0.1, 0.2, 0.4, 0.8] {
            let sigma = (process(&usual, gap).force * gap).sqrt();
            let (mut worst, mut square) = (0.0f64, 0.0);
            for k in 0..100 {
                let phase = f64::from(k) * 0.0628;
                let a = |t: f64| 5.0 * (FREQUENCY * t + phase).sin();
                let v = |t: f64| -5.0 / FREQUENCY * (FREQUENCY * t + phase).cos();
                let missed = v(gap) - v(0.0) - (a(0.0) + a(gap)) / 2.0 * gap;
                worst = worst.max(missed.abs());
                square += missed * missed / 100.0;
            }
            assert!(worst < 3.5 * sigma && square.sqrt() > 0.1 * sigma, "{gap}: {worst} of {sigma}");
        }
        assert_eq!(process(&usual, 2.0).force, usual.force + 9.0 * CORRELATION);
    }
}
