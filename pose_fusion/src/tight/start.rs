//! How the filter starts: from one image, what the inertial unit knows of "up", and the encoders.
//!
//! A swinging platform's accelerometer points along the rope, so it is no witness for the tilt; the unit's own roll
//! and pitch are one, with their covariance, and enter the cost in which the pose is sought. Where the unit gives no attitude
//! the accelerometer serves with the tilt that a swing can hide. Every minimum is a hypothesis.

use super::{
    geometry::{ClimberRest, Geometry},
    markers::{Gates, Report, Sighting, scalar_update, update},
    state::{
        ACCELEROMETER, ATTITUDE, CAMERA_CLOCK, CLIMBER, CLIMBER_ACCELERATION, CLIMBER_RATE, GYROSCOPE,
        POSITION, State, VELOCITY,
    },
};
use crate::config::TightConfig;
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::{PerColor, planar_pose, planar_pose::TiltPrior};

/// What is known of "up" when the filter starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Up {
    /// The world's up in imu axes, unit vector.
    pub in_imu: Vector3<f64>,
    /// Its uncertainty about each horizontal axis, rad.
    pub sigma: f64,
}

/// Tilt that a swing hides from the accelerometer, rad (1 sigma).
pub const SWING_TILT: f64 = 0.15;

/// No climber is faster than so much (x, y: m/s, turn: rad/s; 1 sigma) …
pub const CLIMBER_SPEED_SIGMA: [f64; 3] = [0.5, 0.5, 0.4];
/// … or accelerated by more than that (m/s², rad/s²; 1 sigma).
pub const CLIMBER_ACCELERATION_SIGMA: [f64; 3] = [0.5, 0.5, 0.3];

/// What the encoders say when the filter starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClimberStart {
    /// x, y, turn at the image.
    pub values: Vector3<f64>,
    /// Their rates.
    pub rates: Vector3<f64>,
    /// Uncertainty of the values.
    pub sigma: Vector3<f64>,
    /// Uncertainty of the rates.
    pub rate_sigma: Vector3<f64>,
}

/// A start: the state after the image, what became of its markers, and how unlikely it is (minus twice the log).
#[derive(Clone, Debug)]
pub struct Hypothesis {
    /// The state.
    pub state: State,
    /// The image's report.
    pub report: Report,
    /// Cost of the pose: pixels and tilt.
    pub cost: f64,
}

/// Every start that the image allows, likeliest first; empty where it allows none.
pub fn hypotheses(
    geometry: &Geometry,
    config: &TightConfig,
    sighting: &Sighting,
    up: Option<&Up>,
    climber: &ClimberStart,
) -> Vec<Hypothesis> {
    let rest: &ClimberRest = &sighting.rest;
    let world_from_camera = rest.join(&climber.values) * geometry.climber_from_camera;
    let tilt = up.map(|up| TiltPrior {
        up_in_volant: geometry.volant_from_imu.rotation * up.in_imu,
        up_in_camera: world_from_camera.rotation.inverse() * Vector3::z(),
        sigma: up.sigma,
    });
    let pixels = PerColor(sighting.pixels);
    let found = planar_pose::candidates(&geometry.markers, &geometry.camera, &pixels, tilt.as_ref());
    let mut starts = Vec::with_capacity(found.len());
    for candidate in &found {
        // An image whose markers do not fit together is no start: 2n − 6 (+ 2 for the tilt) degrees of freedom.
        if candidate.cost > 40.0 {
            continue;
        }
        let world_from_imu = world_from_camera * candidate.camera_from_volant * geometry.volant_from_imu;
        let mut state = State::zero();
        state.position = world_from_imu.translation.vector;
        state.attitude = world_from_imu.rotation;
        state.camera_clock = sighting.clock;
        // A prior so wide that the image decides, centred on its own solution so that nothing bends.
        state.set_variance(POSITION, &Vector3::repeat(2.0));
        state.set_variance(VELOCITY, &Vector3::repeat(config.initial_velocity));
        state.set_variance(ATTITUDE, &Vector3::repeat(1.0));
        unknown(&mut state, config, climber);
        if let Some(up) = up {
            // up = R u: its x and y in the world are zero; ∂(R u)/∂δθ = −[R u]×.
            let v = state.attitude * up.in_imu;
            let variance = up.sigma * up.sigma;
            scalar_update(&mut state, &[(ATTITUDE + 1, v.z), (ATTITUDE + 2, -v.y)], -v.x, variance);
            let v = state.attitude * up.in_imu;
            scalar_update(&mut state, &[(ATTITUDE, -v.z), (ATTITUDE + 2, v.x)], -v.y, variance);
            // The mean stays where the cost has its minimum: the image comes next and knows the same.
            state.attitude = world_from_imu.rotation;
            state.position = world_from_imu.translation.vector;
        }
        let open = Gates { marker: f64::INFINITY, joint: f64::INFINITY, gravity: config.gravity };
        let report = update(&mut state, geometry, sighting, &open, false);
        // Prior and image together have their minimum at the candidate; the update above centred the prior there.
        state.attitude = world_from_imu.rotation;
        state.position = world_from_imu.translation.vector;
        starts.push(Hypothesis { state, report, cost: candidate.cost });
    }
    starts
}

/// The climber as its encoders have it, biases and clock as unknown as the configuration says.
pub fn unknown(state: &mut State, config: &TightConfig, climber: &ClimberStart) {
    state.climber = climber.values;
    state.climber_rate = climber.rates;
    state.set_variance(ACCELEROMETER, &Vector3::repeat(config.accelerometer_bias));
    state.set_variance(GYROSCOPE, &Vector3::repeat(config.gyroscope_bias));
    state.set_variance(CLIMBER, &climber.sigma);
    state.set_variance(CLIMBER_RATE, &climber.rate_sigma);
    state.set_variance(CLIMBER_ACCELERATION, &CLIMBER_ACCELERATION_SIGMA.into());
    state.set_variance_of(CAMERA_CLOCK, config.camera_clock * config.camera_clock);
}

/// The world's up from an attitude of the unit.
pub fn up_of(enu_from_imu: &UnitQuaternion<f64>) -> Vector3<f64> {
    enu_from_imu.inverse() * Vector3::z()
}
