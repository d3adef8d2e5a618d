//! The platform hangs on a rope: what that tells while no marker is seen. An option, off unless the rope's length is given.
//!
//! A body that hangs on one rope is pulled along it: what its accelerometer feels (`F = R (f − b_a)`, gravity and acceleration in one) points at the
//! rope's upper end. With `ρ` the vector from the platform's attachment to the climber's and `L` the rope's length,
//! `ρ − L F/|F| = n`: along the rope `n` is what the length is not known by or stretches, across it `L/|F|` times what else pushes the platform
//! (thrusters, air, an attachment beside the centre of mass). Its derivative, with `u = F/|F|`, `a` the platform's attachment on the unit's axes and `c` the
//! climber's attachment from its axis of turn, world axes:
//! `−δp + ([R a]× + L [u]×) δθ + L/|F| (1 − u uᵀ) R δb_a + δc_xy + (e_z × c) δturn`.
//! (A spherical pendulum's equation of motion, e.g. Landau and Lifshitz, Mechanics, section 14, solved for its deflection; [u]× turns the tilt's
//! error into one of place.) An accelerometer alone takes a tilt error `ε` for an acceleration `g ε`, and is off by `g ε t²/2`;
//! with the rope the same error is one of place, `L ε`, and what the samples integrate to disagrees: both are found.
//!
//! **Counted once.** What pushes lasts for about `√(L/g)`, and a wrong length for the whole outage: with a correlation time `τ` and an update
//! every `T` seconds a variance `σ²` is taken as `2 τ σ²/T`, the white noise of the same density at low frequencies (Bryson and Ho 1975, section 11.4).
//!
//! **Found, not believed.** While markers are seen nothing is corrected by the rope; it is compared. The length that fits, how far that scatters and how far the platform
//! is pushed aside replace what was configured, as far as they are known better. A rope that is slack (hardly any force) or contradicts by more than its gate is not used.

use super::{
    Tight,
    geometry::{ClimberRest, Geometry},
    markers::scalar_update,
    propagate::{Felt, retime},
    state::{ACCELEROMETER, ATTITUDE, CLIMBER, POSITION, State},
};
use crate::config::PendulumConfig;
use nalgebra::{Matrix3, SMatrix, Vector3};

/// So long after the last marker the rope counts, s.
const UNSEEN: f64 = 0.25;
/// Then it does as often, s.
const EVERY: f64 = 0.1;
/// A specific force below this share of gravity is no taut rope's.
const TAUT: f64 = 0.3;
/// 0.999 quantile of χ² with three degrees of freedom.
const GATE: f64 = 16.27;
/// A wrong length lasts, s.
const LASTS: f64 = 10.0;
/// A winch or a rope that stretches moves within, s.
const STRETCHES: f64 = 1.0;
/// What is found of the length is not known better, m: the images' own systematic errors.
const FLOOR: f64 = 0.5e-3;
/// So many images (ten seconds) are remembered; half a second of them counts as one.
const REMEMBERED: f64 = 300.0;
const ALIKE: f64 = 15.0;

/// The entries of the error that the rope sees.
const SEEN: [usize; 12] = [
    POSITION,
    POSITION + 1,
    POSITION + 2,
    ATTITUDE,
    ATTITUDE + 1,
    ATTITUDE + 2,
    ACCELEROMETER,
    ACCELEROMETER + 1,
    ACCELEROMETER + 2,
    CLIMBER,
    CLIMBER + 1,
    CLIMBER + 2,
];
type Jacobian = SMatrix<f64, 3, 12>;

/// The rope as it is assumed.
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
    /// Lower end from the inertial unit, its axes, m.
    pub platform_attachment: Vector3<f64>,
}

/// What a state says of the rope.
#[derive(Clone, Copy, Debug)]
struct Pull {
    /// From the lower end to the upper, world, m.
    span: Vector3<f64>,
    /// Specific force, world, m/s².
    force: Vector3<f64>,
    /// Lower end from the unit, upper end from the climber's axis, world axes, m.
    arms: [Vector3<f64>; 2],
}

impl Rope {
    fn pull(&self, state: &State, felt: &Felt, rest: &ClimberRest) -> Pull {
        let world_from_climber = rest.join(&state.climber);
        let lower = state.attitude * self.platform_attachment;
        let upper = world_from_climber.rotation * self.climber_attachment;
        Pull {
            span: world_from_climber.translation.vector + upper - state.position - lower,
            force: state.attitude * (felt.force - state.accelerometer_bias),
            arms: [lower, upper],
        }
    }

    /// What is missing from a taut rope, and by what of the error.
    fn linearise(&self, state: &State, felt: &Felt, rest: &ClimberRest) -> (Vector3<f64>, Jacobian) {
        let Pull { span, force, arms: [lower, upper] } = self.pull(state, felt, rest);
        let strength = force.norm();
        let along = force / strength;
        let across = Matrix3::identity() - along * along.transpose();
        let by_bias = across * state.attitude.to_rotation_matrix().matrix() * (self.length / strength);
        let mut h = Jacobian::zeros();
        h.fixed_columns_mut::<3>(0).copy_from(&-Matrix3::identity());
        h.fixed_columns_mut::<3>(3).copy_from(&(lower.cross_matrix() + along.cross_matrix() * self.length));
        h.fixed_columns_mut::<3>(6).copy_from(&by_bias);
        h.fixed_columns_mut::<2>(9).copy_from(&Matrix3::identity().fixed_columns::<2>(0));
        h.fixed_columns_mut::<1>(11).copy_from(&Vector3::z().cross(&upper));
        (along * self.length - span, h)
    }

    /// Corrects `state` by the rope, where it is taut and agrees. `force_variance` is the accelerometer's white noise per sample. True where it did.
    pub fn update(
        &self,
        state: &mut State,
        felt: &Felt,
        rest: &ClimberRest,
        force_variance: f64,
        gravity: f64,
    ) -> bool {
        let force = self.pull(state, felt, rest).force;
        let strength = force.norm();
        if !(strength.is_finite() && strength > TAUT * gravity) {
            return false;
        }
        // Along the rope and twice across it.
        let along = force / strength;
        let aside = along.cross(&if along.x.abs() < 0.7 { Vector3::x() } else { Vector3::y() }).normalize();
        let axes = [along, aside, along.cross(&aside)];
        let lasting = (self.length / gravity).sqrt();
        let arm = self.length / strength;
        let across = arm * arm * (self.side_variance * 2.0 * lasting / EVERY + force_variance);
        let length = (self.length_variance * LASTS + self.stretch_variance * STRETCHES) * 2.0 / EVERY;
        let variances = [length, across, across];
        let rows = |state: &State| {
            let (residual, h) = self.linearise(state, felt, rest);
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
        let clock = state.camera_clock;
        for (axis, variance) in variances.into_iter().enumerate() {
            let (residual, row) = rows(state)[axis];
            let h: [(usize, f64); 12] = std::array::from_fn(|k| (SEEN[k], row[k]));
            scalar_update(state, &h, residual, variance);
        }
        let moved = state.camera_clock - clock;
        retime(state, felt, moved, gravity);
        true
    }
}

/// What the images tell of the rope.
#[derive(Clone, Debug, Default)]
pub struct Comparison {
    count: f64,
    /// Its length beyond the configured one: mean and variance.
    more: f64,
    scatter: f64,
    /// What pushes across it, squared, each axis, (m/s²)².
    side: f64,
}

impl Comparison {
    fn take(&mut self, more: f64, side: f64) {
        self.count += 1.0;
        let weight = self.count.min(REMEMBERED).recip();
        let before = more - self.more;
        self.more += before * weight;
        self.scatter += (before * (more - self.more) - self.scatter) * weight;
        self.side += (side - self.side) * weight;
    }

    /// The rope: what is configured, and as far as it is known better, what was found. `None` where it has none.
    pub fn rope(&self, config: &PendulumConfig, geometry: &Geometry) -> Option<Rope> {
        if config.rope_length <= 0.0 {
            return None;
        }
        let told = config.rope_sigma.powi(2);
        let looks = self.count.min(REMEMBERED) / ALIKE;
        // One look at it tells nothing of its scatter.
        let found = if looks >= 2.0 { self.scatter / looks + FLOOR * FLOOR } else { f64::INFINITY };
        let share = told / (told + found);
        Some(Rope {
            length: config.rope_length + self.more * share,
            length_variance: if found.is_finite() { told * found / (told + found) } else { told },
            stretch_variance: self.scatter,
            side_variance: self.side.max(config.side_force.powi(2)),
            climber_attachment: config.climber_attachment,
            platform_attachment: geometry.imu_from_volant
                * nalgebra::Point3::from(config.platform_attachment)
                - nalgebra::Point3::origin(),
        })
    }
}

impl Tight {
    /// The rope as it is assumed now.
    pub fn rope(&self) -> Option<Rope> {
        self.comparison.rope(&self.config.pendulum, self.geometry.as_ref()?)
    }

    /// Compares the rope with a state that an image has just corrected.
    pub(super) fn compare_rope(&mut self) {
        let (Some(rope), Some((_, _, rest))) = (self.rope(), self.readings.back()) else { return };
        let node = self.history.run().checked_sub(1).and_then(|p| self.history.get(p));
        let Some(node) = node else { return };
        let Pull { span, force, .. } = rope.pull(&node.state, &node.felt, rest);
        let (length, strength) = (span.norm(), force.norm());
        if !(strength > TAUT * self.config.gravity && length > 0.0) {
            return;
        }
        let across = force - span * (force.dot(&span) / (length * length));
        self.comparison.take(length - self.config.pendulum.rope_length, across.norm_squared() / 2.0);
    }
}

/// Whether the rope is asked in a step at whose ends no marker was seen for `from` and `to` seconds.
pub fn asked(from: f64, to: f64) -> bool {
    to > UNSEEN && (to / EVERY).floor() > (from / EVERY).floor()
}

#[cfg(test)]
mod tests {
    use super::{
        super::state::{CAMERA_CLOCK, Error, N},
        *,
    };
    use nalgebra::UnitQuaternion;

    fn example() -> (Rope, State, Felt, ClimberRest) {
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
        let rest = ClimberRest { height: 2.8, tilt: UnitQuaternion::identity() };
        let towards = Vector3::new(-0.2, 0.1, 1.0).normalize();
        let upper = rest.join(&state.climber) * nalgebra::Point3::from(rope.climber_attachment);
        state.position = upper.coords - towards * rope.length - state.attitude * rope.platform_attachment;
        let felt = Felt {
            force: state.attitude.inverse() * (towards * 10.1) + state.accelerometer_bias,
            rate: Vector3::zeros(),
        };
        (rope, state, felt, rest)
    }

    #[test]
    fn the_jacobian_is_the_numerical_one() {
        let (rope, state, felt, rest) = example();
        let (residual, jacobian) = rope.linearise(&state, &felt, &rest);
        assert!(residual.norm() < 1e-12, "{residual}");
        let h = 1e-6;
        for (k, &index) in SEEN.iter().enumerate() {
            let at = |sign: f64| {
                let mut moved = state.clone();
                let mut e = Error::zeros();
                e[index] = sign * h;
                moved.add(&e);
                rope.linearise(&moved, &felt, &rest).0
            };
            let numeric = -(at(1.0) - at(-1.0)) / (2.0 * h);
            assert!(
                (numeric - jacobian.column(k)).amax() < 1e-6,
                "{index}: {numeric} {}",
                jacobian.column(k)
            );
        }
        for index in (0..N).filter(|i| !SEEN.contains(i) && *i != CAMERA_CLOCK) {
            let mut moved = state.clone();
            let mut e = Error::zeros();
            e[index] = 1e-3;
            moved.add(&e);
            assert!(rope.linearise(&moved, &felt, &rest).0.norm() < 1e-12, "{index}");
        }
    }

    #[test]
    fn it_pulls_back_what_drifted_and_leaves_a_slack_rope_and_a_contradiction_alone() {
        let (rope, truth, felt, rest) = example();
        let mut state = truth.clone();
        state.position += Vector3::new(0.05, -0.04, 0.06);
        state.set_variance(POSITION, &Vector3::repeat(0.06));
        let mut drifted = state.clone();
        for _ in 0..20 {
            assert!(rope.update(&mut drifted, &felt, &rest, 4e-4, 9.81));
        }
        assert!((drifted.position - truth.position).norm() < 0.02, "{}", drifted.position - truth.position);
        assert!(drifted.covariance[(POSITION, POSITION)] < 0.5 * state.covariance[(POSITION, POSITION)]);
        let slack = Felt { force: felt.force * 0.2, ..felt };
        let mut same = state.clone();
        assert!(!rope.update(&mut same, &slack, &rest, 4e-4, 9.81) && same == state);
        let far = Rope { length: 3.2, ..rope };
        assert!(!far.update(&mut same, &felt, &rest, 4e-4, 9.81) && same == state);
    }

    #[test]
    fn the_length_that_fits_replaces_the_configured_one() {
        let rig = rig_model::Rig::from_yaml(include_str!("../../../test/src/rig/rig.yaml")).unwrap();
        let camera = rig_model::CameraModel::new(
            640,
            480,
            [590.0, 590.0, 319.5, 239.5],
            rig_model::Distortion::PlumbBob([0.0; 5]),
        );
        let geometry = Geometry::new(&rig, camera.unwrap());
        let config = PendulumConfig { rope_length: 1.25, rope_sigma: 0.01, ..PendulumConfig::default() };
        let mut comparison = Comparison::default();
        assert!(comparison.rope(&PendulumConfig::default(), &geometry).is_none());
        let at_first = comparison.rope(&config, &geometry).unwrap();
        assert!((at_first.length, at_first.length_variance) == (1.25, 1e-4), "{at_first:?}");
        for k in 0..200 {
            comparison.take(-0.025 + 0.002 * f64::from(k).sin(), 0.3);
        }
        let rope = comparison.rope(&config, &geometry).unwrap();
        assert!((rope.length - 1.225).abs() < 1e-3 && rope.length_variance < 2e-6, "{rope:?}");
        assert!((rope.stretch_variance - 2e-6).abs() < 3e-7 && (rope.side_variance - 0.3).abs() < 1e-9);
    }

    #[test]
    fn it_is_asked_ten_times_a_second_and_only_without_markers() {
        let asked = (0..1000).filter(|k| super::asked(f64::from(*k) * 0.00999, f64::from(k + 1) * 0.00999));
        assert_eq!(asked.count(), 97);
        assert!(!super::asked(0.09, 0.24) && super::asked(0.29, 0.301));
    }
}
