//! Angles within ±π.

use std::f64::consts::TAU;

/// Returns the equivalent angle within ±π, rad.
pub fn wrap_angle(angle: f64) -> f64 {
    angle - (angle / TAU).round() * TAU
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn wrapped_angles_are_within_half_a_turn() {
        for turns in [-3.0, -1.0, 0.0, 1.0, 20.0] {
            for angle in [-3.1, -0.5, 0.0, 2.0, 3.1] {
                assert!((wrap_angle(angle + turns * TAU) - angle).abs() < 1e-12);
            }
        }
        assert!(wrap_angle(3.5 * PI).abs() <= PI);
    }
}
