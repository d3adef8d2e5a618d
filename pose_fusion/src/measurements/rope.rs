//! Rope measurement: a platform that hangs on one rope is pulled along it. Off unless the rope's
//! length is configured. Equations: `docs/src/equations.md`, "Rope".

use super::geometry::{ClimberHeightTilt, Geometry};
use crate::{
    config::PendulumConfig,
    ekf::{
        consider::ByParameter,
        propagation::ImuReading,
        state::{ACCELEROMETER_BIAS, ATTITUDE, CLIMBER, POSITION, State},
        update,
    },
};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// The rope is used this long after the last marker, s.
const UNSEEN: f64 = 0.25;
/// Time between two updates, s.
const PERIOD: f64 = 0.1;
/// Smallest specific force of a taut rope, as a share of gravity.
const TAUT: f64 = 0.3;
/// 0.999 quantile of χ² with three degrees of freedom.
const GATE: f64 = 16.27;
/// Correlation time of a wrong length, s.
const LENGTH_LASTS: f64 = 10.0;
/// Correlation time of a winch or a rope that stretches, s.
const STRETCH_LASTS: f64 = 1.0;
/// Smallest uncertainty of the identified length, m: systematic errors of the images.
const FLOOR: f64 = 0.5e-3;
/// Memory of the identification, images (10 s), and images that count as one independent sample.
const MEMORY: f64 = 300.0;
const CORRELATED: f64 = 15.0;

/// Entries of the error that the rope measures.
const SEEN: [usize; 12] = {
    let (p, a, b, c) = (POSITION, ATTITUDE, ACCELEROMETER_BIAS, CLIMBER);
    [p, p + 1, p + 2, a, a + 1, a + 2, b, b + 1, b + 2, c, c + 1, c + 2]
};
type Jacobian = SMatrix<f64, 3, 12>;

/// Rope as it is assumed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rope {
    /// Its length, m.
    pub length: f64,
    /// Variance of it, constant over an outage, m².
    pub length_variance: f64,
    /// Variance by which it stretches, m².
    pub stretch_variance: f64,
    /// Variance of what pushes the platform across the rope, each axis, (m/s²)².
    pub side_variance: f64,
    /// Upper end in the climber's frame, m.
    pub climber_attachment: Vector3<f64>,
    /// Lower end from the IMU, its axes, m.
    pub platform_attachment: Vector3<f64>,
}

/// Geometry and pull of the rope in a state.
#[derive(Clone, Copy, Debug)]
struct Pull {
    /// From the lower end to the upper, world, m.
    span: Vector3<f64>,
    /// Specific force, world, m/s².
    force: Vector3<f64>,
    /// Lower end from the IMU, upper end from the climber's axis, world axes, m.
    arms: [Vector3<f64>; 2],
}

impl Rope {
    fn pull(&self, state: &State, reading: &ImuReading, rest: &ClimberHeightTilt) -> Pull {
        let world_from_climber = rest.join(&state.climber);
        let lower = state.attitude * self.platform_attachment;
        let upper = world_from_climber.rotation * self.climber_attachment;
        Pull {
            span: world_from_climber.translation.vector + upper - state.position - lower,
            force: state.attitude * state.motion(reading).specific_force,
            arms: [lower, upper],
        }
    }

    /// Returns the residual of a taut rope and its Jacobian.
    fn linearize(
        &self,
        state: &State,
        reading: &ImuReading,
        rest: &ClimberHeightTilt,
    ) -> (Vector3<f64>, Jacobian) {
        let Pull { span, force, arms: [lower, upper] } = self.pull(state, reading, rest);
        let strength = force.norm();
        let along = force / strength;
        let across = Matrix3::identity() - along * along.transpose();
        let by_bias =
            across * state.attitude.to_rotation_matrix().matrix() * (self.length / strength);
        let mut h = Jacobian::zeros();
        h.fixed_columns_mut::<3>(0).copy_from(&-Matrix3::identity());
        h.fixed_columns_mut::<3>(3)
            .copy_from(&(lower.cross_matrix() + along.cross_matrix() * self.length));
        h.fixed_columns_mut::<3>(6).copy_from(&by_bias);
        h.fixed_columns_mut::<2>(9).copy_from(&Matrix3::identity().fixed_columns::<2>(0));
        h.fixed_columns_mut::<1>(11).copy_from(&Vector3::z().cross(&upper));
        (along * self.length - span, h)
    }

    /// Corrects `state` by the rope and returns whether it did: a slack or contradicting rope is
    /// not used. `force_variance` is the accelerometer's white noise per sample, (m/s²)².
    pub fn update(
        &self,
        state: &mut State,
        reading: &ImuReading,
        rest: &ClimberHeightTilt,
        force_variance: f64,
        gravity: f64,
    ) -> bool {
        let force = self.pull(state, reading, rest).force;
        let strength = force.norm();
        if !(strength.is_finite() && strength > TAUT * gravity) {
            return false;
        }
        // Along the rope and twice across it.
        let along = force / strength;
        let aside =
            along.cross(&if along.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }).normalize();
        let axes = [along, aside, along.cross(&aside)];
        let lasting = (self.length / gravity).sqrt();
        let arm = self.length / strength;
        let across = arm * arm * (self.side_variance * 2.0 * lasting / PERIOD + force_variance);
        let length = (self.length_variance * LENGTH_LASTS + self.stretch_variance * STRETCH_LASTS)
            * 2.0
            / PERIOD;
        let variances = [length, across, across];
        let rows = |state: &State| {
            let (residual, h) = self.linearize(state, reading, rest);
            axes.map(|axis| (axis.dot(&residual), h.transpose() * axis))
        };
        let before = rows(state);
        let spread = Matrix3::from_fn(|i, j| {
            let noise = if i == j { variances[i] } else { 0.0 };
            let mut sum = 0.0;
            for (a, &k) in SEEN.iter().enumerate() {
                for (b, &l) in SEEN.iter().enumerate() {
                    sum += before[i].1[a] * state.covariance[(k, l)] * before[j].1[b];
                }
            }
            sum + noise
        });
        let residual = Vector3::from_fn(|i, _| before[i].0);
        let agrees = spread.cholesky().is_some_and(|c| residual.dot(&c.solve(&residual)) < GATE);
        if !agrees {
            return false;
        }
        let (offset, none) = (state.time_offset, ByParameter::zeros());
        for (axis, variance) in variances.into_iter().enumerate() {
            let (residual, row) = rows(state)[axis];
            let h: [(usize, f64); 12] = std::array::from_fn(|k| (SEEN[k], row[k]));
            update::scalar(state, &h, residual, variance, &none);
        }
        state.shift_time(reading, state.time_offset - offset, gravity);
        true
    }
}

/// Identification of the rope from images.
#[derive(Clone, Debug, Default)]
pub struct RopeIdentification {
    count: f64,
    /// Length beyond the configured one, m: mean and variance.
    more: f64,
    scatter: f64,
    /// Mean square of the force across it, each axis, (m/s²)².
    side: f64,
}

impl RopeIdentification {
    /// Compares the configured rope with a state just corrected. `gravity` in m/s².
    pub fn compare(
        &mut self,
        config: &PendulumConfig,
        geometry: &Geometry,
        state: &State,
        reading: &ImuReading,
        rest: &ClimberHeightTilt,
        gravity: f64,
    ) {
        let Some(rope) = self.rope(config, geometry) else { return };
        let Pull { span, force, .. } = rope.pull(state, reading, rest);
        let (length, strength) = (span.norm(), force.norm());
        if strength > TAUT * gravity && length > 0.0 {
            let across = force - span * (force.dot(&span) / (length * length));
            self.add(length - config.rope_length, across.norm_squared() / 2.0);
        }
    }

    fn add(&mut self, more: f64, side: f64) {
        self.count += 1.0;
        let weight = self.count.min(MEMORY).recip();
        let before = more - self.more;
        self.more += before * weight;
        self.scatter += (before * (more - self.more) - self.scatter) * weight;
        self.side += (side - self.side) * weight;
    }

    /// Returns the rope, configured or as far as known better identified; `None` without one.
    pub fn rope(&self, config: &PendulumConfig, geometry: &Geometry) -> Option<Rope> {
        if config.rope_length <= 0.0 {
            return None;
        }
        let configured = config.rope_sigma.powi(2);
        let samples = self.count.min(MEMORY) / CORRELATED;
        // One sample has no scatter.
        let found =
            if samples >= 2.0 { self.scatter / samples + FLOOR * FLOOR } else { f64::INFINITY };
        let share = configured / (configured + found);
        Some(Rope {
            length: config.rope_length + self.more * share,
            length_variance: if found.is_finite() {
                configured * found / (configured + found)
            } else {
                configured
            },
            stretch_variance: self.scatter,
            side_variance: self.side.max(config.side_force.powi(2)),
            climber_attachment: config.climber_attachment.into(),
            platform_attachment: geometry.imu_from_volant
                * nalgebra::Point3::from(config.platform_attachment)
                - nalgebra::Point3::origin(),
        })
    }
}

/// Whether the rope is due in a step between these times without a marker, s.
pub fn is_due(from: f64, to: f64) -> bool {
    to > UNSEEN && (to / PERIOD).floor() > (from / PERIOD).floor()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ekf::state::{N, TIME_OFFSET};
    use nalgebra::UnitQuaternion;

    fn example() -> (Rope, State, ImuReading, ClimberHeightTilt) {
        let rope = Rope {
            length: 1.2,
            length_variance: 1e-5,
            stretch_variance: 1e-5,
            side_variance: 0.01,
            climber_attachment: Vector3::new(0.05, -0.02, -0.2),
            platform_attachment: Vector3::new(0.02, 0.03, 0.1),
        };
        let mut state = State::zero();
        state.attitude = UnitQuaternion::from_euler_angles(0.2, -0.1, 0.7);
        state.accelerometer_bias = Vector3::new(0.05, -0.04, 0.03);
        state.climber = Vector3::new(0.3, -0.2, 0.4);
        let rest = ClimberHeightTilt { height: 2.8, tilt: UnitQuaternion::identity() };
        let towards = Vector3::new(-0.2, 0.1, 1.0).normalize();
        let upper = rest.join(&state.climber) * nalgebra::Point3::from(rope.climber_attachment);
        state.position =
            upper.coords - towards * rope.length - state.attitude * rope.platform_attachment;
        let reading = ImuReading {
            specific_force: state.attitude.inverse() * (towards * 10.1) + state.accelerometer_bias,
            angular_velocity: Vector3::zeros(),
        };
        (rope, state, reading, rest)
    }

    #[test]
    fn the_jacobian_is_the_numerical_one() {
        let (rope, state, reading, rest) = example();
        let (residual, jacobian) = rope.linearize(&state, &reading, &rest);
        assert!(residual.norm() < 1e-12, "{residual}");
        let h = 1e-6;
        for (k, &index) in SEEN.iter().enumerate() {
            let at = |by: f64| rope.linearize(&state.moved(index, by), &reading, &rest).0;
            let numeric = -(at(h) - at(-h)) / (2.0 * h);
            let error = numeric - jacobian.column(k);
            assert!(error.amax() < 1e-6, "{index}: {error}");
        }
        for index in (0..N).filter(|i| !SEEN.contains(i) && *i != TIME_OFFSET) {
            let moved = state.moved(index, 1e-3);
            assert!(rope.linearize(&moved, &reading, &rest).0.norm() < 1e-12, "{index}");
        }
    }

    #[test]
    fn it_corrects_drift_and_rejects_a_slack_or_contradicting_rope() {
        let (rope, truth, reading, rest) = example();
        let mut state = truth.clone();
        state.position += Vector3::new(0.05, -0.04, 0.06);
        state.set_sigmas(POSITION, &Vector3::repeat(0.06));
        let mut drifted = state.clone();
        for _ in 0..20 {
            assert!(rope.update(&mut drifted, &reading, &rest, 4e-4, 9.81));
        }
        let error = drifted.position - truth.position;
        assert!(error.norm() < 0.02, "{error}");
        assert!(drifted.sigma(POSITION) < 0.707 * state.sigma(POSITION));
        let slack = ImuReading { specific_force: reading.specific_force * 0.2, ..reading };
        let mut same = state.clone();
        assert!(!rope.update(&mut same, &slack, &rest, 4e-4, 9.81) && same == state);
        let far = Rope { length: 3.2, ..rope };
        assert!(!far.update(&mut same, &reading, &rest, 4e-4, 9.81) && same == state);
    }

    #[test]
    fn the_identified_length_replaces_the_configured_one() {
        let (_, geometry, _) = crate::measurements::markers::tests::example();
        let config =
            PendulumConfig { rope_length: 1.25, rope_sigma: 0.01, ..PendulumConfig::default() };
        let mut identification = RopeIdentification::default();
        assert!(identification.rope(&PendulumConfig::default(), &geometry).is_none());
        let at_first = identification.rope(&config, &geometry).unwrap();
        assert!((at_first.length, at_first.length_variance) == (1.25, 1e-4), "{at_first:?}");
        for k in 0..200 {
            identification.add(-0.025 + 0.002 * f64::from(k).sin(), 0.3);
        }
        let rope = identification.rope(&config, &geometry).unwrap();
        assert!((rope.length - 1.225).abs() < 1e-3 && rope.length_variance < 2e-6, "{rope:?}");
        assert!(
            (rope.stretch_variance - 2e-6).abs() < 3e-7 && (rope.side_variance - 0.3).abs() < 1e-9
        );
    }

    #[test]
    fn it_is_due_ten_times_a_second_and_only_without_markers() {
        let due = (0..1000).filter(|k| is_due(f64::from(*k) * 0.00999, f64::from(k + 1) * 0.00999));
        assert_eq!(due.count(), 97);
        assert!(!is_due(0.09, 0.24) && is_due(0.29, 0.301));
    }
}
