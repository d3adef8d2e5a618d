//! How the filter is set: every number that is not on the rig file, with its unit.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Which estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Model {
    /// The error-state filter on the markers' pixels.
    #[default]
    Tight,
    /// The published loosely coupled extended Kalman filter.
    Paper,
}

/// Everything that can be set.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FusionConfig {
    /// Which estimator.
    pub model: Model,
    /// What the error-state filter assumes.
    pub tight: TightConfig,
    /// What the published filter assumes.
    pub paper: PaperConfig,
}

/// What the error-state filter assumes. Standard deviations are 1 sigma.
#[derive(Clone, Debug, PartialEq)]
pub struct TightConfig {
    /// Gravity, m/s².
    pub gravity: f64,
    /// How far back the history reaches, s; later data are refused.
    pub history: f64,
    /// Uncertainty of the accelerometer's bias at the start, m/s².
    pub accelerometer_bias: f64,
    /// Its random walk, m/s²/√s.
    pub accelerometer_bias_walk: f64,
    /// Uncertainty of the gyroscope's bias at the start, rad/s.
    pub gyroscope_bias: f64,
    /// Its random walk, rad/s/√s.
    pub gyroscope_bias_walk: f64,
    /// Velocity at the start, each axis, m/s.
    pub initial_velocity: f64,
    /// Roll and pitch that the unit's own attitude is trusted to at the start, at best, rad.
    pub attitude_floor: f64,
    /// The model's own pixel error (what neither the observation's covariance nor the lens tells), px.
    pub pixel_floor: f64,
    /// What a marker's centroid is off by in all images alike, each axis, px (1 sigma). It widens what is said, not what is done.
    pub pixel_systematic: f64,
    /// Smallest pixel sigma that is believed of an observation, px.
    pub pixel_minimum: f64,
    /// Largest normalised innovation squared of one marker (2 degrees of freedom) that is used.
    pub marker_gate: f64,
    /// Largest joint cost per image, in units of its degrees of freedom's 0.9999 quantile.
    pub joint_gate: f64,
    /// Images in a row that contradict the estimate and agree in themselves until it is dropped for them.
    pub lock_out_images: u32,
    /// Step of the encoders in x and y, m.
    pub climber_quantum: f64,
    /// Step of the encoder of the turn, rad.
    pub climber_turn_quantum: f64,
    /// Power density of the climber's jerk, m²/s⁵.
    pub climber_jerk: f64,
    /// Power density of the jerk of its turn, rad²/s⁵.
    pub climber_turn_jerk: f64,
    /// Uncertainty of the camera's clock against the inertial unit's at the start, s; 0 switches the estimation off.
    pub camera_clock: f64,
    /// The camera clock's offset at the start, s: an image stamped t was taken at t plus this on the inertial unit's clock.
    pub camera_clock_offset: f64,
    /// Uncertainty of the climber's clock against the camera's where they are not one, s; 0: they are one.
    pub climber_clock: f64,
    /// Probability, before the first datum, that the climber's and the camera's stamps come from one clock.
    pub climber_clock_tied: f64,
    /// How the clock offsets wander, s/√s.
    pub clock_walk: f64,
    /// Largest factor by which the inertial noise may be found above the rig file's.
    pub inertial_noise_limit: f64,
    /// Velocity of a platform at rest (the zero-motion update's sigma), m/s; 0 switches it off.
    pub rest_velocity: f64,
    /// Position uncertainty above which the estimate is called lost, m.
    pub lost_position: f64,
    /// The rope that the platform hangs on.
    pub pendulum: PendulumConfig,
}

/// What is known of the rope; it counts while no marker is seen.
#[derive(Clone, Debug, PartialEq)]
pub struct PendulumConfig {
    /// From the climber's attachment to the platform's, m; 0: nothing is assumed.
    pub rope_length: f64,
    /// Uncertainty of it, m, until the images have told it.
    pub rope_sigma: f64,
    /// What pushes the platform across the rope at least, each axis, m/s² (1 sigma).
    pub side_force: f64,
    /// Upper end in the climber's frame, m.
    pub climber_attachment: Vector3<f64>,
    /// Lower end in the volant frame, m.
    pub platform_attachment: Vector3<f64>,
}

impl Default for PendulumConfig {
    fn default() -> Self {
        Self {
            rope_length: 0.0,
            rope_sigma: 0.02,
            side_force: 0.1,
            climber_attachment: Vector3::zeros(),
            platform_attachment: Vector3::zeros(),
        }
    }
}

impl Default for TightConfig {
    fn default() -> Self {
        Self {
            gravity: 9.80665,
            history: 0.6,
            accelerometer_bias: 0.2,
            accelerometer_bias_walk: 3e-4,
            gyroscope_bias: 0.09,
            gyroscope_bias_walk: 5e-5,
            initial_velocity: 1.5,
            attitude_floor: 0.01,
            pixel_floor: 0.03,
            pixel_systematic: 0.015,
            pixel_minimum: 0.01,
            marker_gate: 16.0,
            joint_gate: 1.0,
            lock_out_images: 5,
            climber_quantum: 0.001,
            climber_turn_quantum: 0.05_f64.to_radians(),
            climber_jerk: 0.05,
            climber_turn_jerk: 0.01,
            camera_clock: 0.05,
            camera_clock_offset: 0.0,
            climber_clock: 0.05,
            climber_clock_tied: 0.5,
            clock_walk: 1e-5,
            inertial_noise_limit: 30.0,
            rest_velocity: 0.002,
            lost_position: 0.2,
            pendulum: PendulumConfig::default(),
        }
    }
}

/// What the published filter assumes.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperConfig {
    /// R/Q, the ratio of the measurement's to the process' covariance that the paper found accurate.
    pub ratio: f64,
    /// Standard deviation of the visual position behind R, m: only its ratio to Q matters for the estimate.
    pub position_sigma: f64,
    /// Standard deviation of the visual rotation behind R, rad.
    pub rotation_sigma: f64,
    /// Gravity, m/s².
    pub gravity: f64,
    /// Threshold control: velocity changes below it count as none, m/s.
    pub velocity_threshold: f64,
    /// Takes the inertial velocity from the fused poses; the paper names nothing that corrects it.
    pub velocity_from_fused: bool,
}

impl Default for PaperConfig {
    fn default() -> Self {
        Self {
            ratio: 10.0,
            position_sigma: 0.005,
            rotation_sigma: 0.01,
            gravity: 9.80665,
            velocity_threshold: 1e-5,
            velocity_from_fused: false,
        }
    }
}
