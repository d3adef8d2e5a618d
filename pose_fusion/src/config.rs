//! Configuration of the estimators: every number that is not in the rig file, with its unit.
//!
//! Standard deviations are 1 sigma. Each default names its origin.

use nalgebra::Vector3;

/// Which estimator runs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Model {
    /// Tightly coupled error-state filter on marker pixels.
    #[default]
    Tight,
    /// Loosely coupled extended Kalman filter as published in 2010.
    Paper,
}

/// Visual measurement of the published filter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum PaperMeasurement {
    /// Pose from one image: three positions and three rotations.
    #[default]
    Pose,
    /// The markers' coordinates reprojected to the world plane (eq. 8).
    Markers,
}

/// Configuration of everything in this crate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FusionConfig {
    /// Which estimator runs.
    pub model: Model,
    /// Error-state filter.
    pub tight: TightConfig,
    /// Published filter.
    pub paper: PaperConfig,
    /// Single-image pose: choose between the two planar solutions with the IMU's direction of
    /// gravity.
    pub visual_use_gravity: bool,
    /// When a pose is called valid.
    pub status: StatusConfig,
    /// Largest rate of odometry, status and prediction, Hz; 0: that of the IMU.
    pub publish_rate: f64,
}

/// Configuration of the error-state filter.
#[derive(Clone, Debug, PartialEq)]
pub struct TightConfig {
    /// Gravity, m/s².
    pub gravity: f64,
    /// How far back delayed measurements are accepted, s.
    pub history: f64,
    /// IMU errors.
    pub imu: ImuConfig,
    /// Marker measurements.
    pub markers: MarkerConfig,
    /// Encoders and motion of the climber.
    pub climber: ClimberConfig,
    /// Time offsets.
    pub clock: ClockConfig,
    /// Calibration errors that widen the covariance.
    pub calibration: CalibrationSigmas,
    /// Velocity of a platform at rest (zero-velocity update), m/s; 0 disables the update.
    pub zero_velocity_sigma: f64,
    /// Values beyond which a state is unsound.
    pub limits: LimitConfig,
    /// How far ahead the predicted odometry lies, s; 0 disables it.
    pub prediction_horizon: f64,
    /// The swing relative to the climber is output.
    pub swing: bool,
    /// Rope that the platform hangs on.
    pub pendulum: PendulumConfig,
}

/// Errors of the IMU.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuConfig {
    /// Initial accelerometer bias, m/s² (MTx data sheet: 0.02; ten times that for a unit that is
    /// not calibrated).
    pub accelerometer_bias: f64,
    /// Random walk of the accelerometer bias, m/s²/√s.
    pub accelerometer_bias_walk: f64,
    /// Initial gyroscope bias, rad/s (5°/s, five times the MTx data sheet).
    pub gyroscope_bias: f64,
    /// Random walk of the gyroscope bias, rad/s/√s.
    pub gyroscope_bias_walk: f64,
    /// Initial scale factor of each axis of the accelerometer, relative (MTx data sheet: 0.0003).
    pub accelerometer_scale: f64,
    /// Initial scale factor of each axis of the gyroscope, relative.
    pub gyroscope_scale: f64,
    /// Initial rotation of gyroscope and accelerometer against the mounting, each axis, rad (MTx
    /// data sheet: 0.1°).
    pub misalignment: f64,
    /// Smallest uncertainty of the IMU's own roll and pitch, rad.
    pub attitude_floor: f64,
    /// Largest factor by which the identified noise may exceed the rig file's density.
    pub noise_limit: f64,
    /// Specific force beyond which a reading is rejected, m/s² (largest range of an MTx: 18 g).
    pub max_force: f64,
    /// Angular velocity beyond which a reading is rejected, rad/s (largest range of an MTx:
    /// 2000°/s).
    pub max_rate: f64,
}

/// Marker measurements.
#[derive(Clone, Debug, PartialEq)]
pub struct MarkerConfig {
    /// Pixel error of the lens and marker model beside the observation's covariance, px.
    pub pixel_floor: f64,
    /// Smallest pixel sigma accepted from an observation, px.
    pub pixel_minimum: f64,
    /// Largest NIS (2 degrees of freedom) of a marker that is used (16: 0.9997 quantile of χ²).
    pub gate: f64,
    /// Consecutive images that contradict the prediction, but not themselves, before the prediction
    /// gives way.
    pub lock_out_images: u32,
}

/// Encoders and motion of the climber.
#[derive(Clone, Debug, PartialEq)]
pub struct ClimberConfig {
    /// Step of the x and y encoders, m.
    pub quantum: f64,
    /// Step of the turn encoder, rad.
    pub turn_quantum: f64,
    /// Power spectral density of the climber's jerk, m²/s⁵.
    pub jerk: f64,
    /// Power spectral density of the turn's jerk, rad²/s⁵.
    pub turn_jerk: f64,
    /// Encoders that contradict the estimate for this long are adopted (re-homed or slipped), s.
    pub step_timeout: f64,
}

/// Time offsets between the sensors.
#[derive(Clone, Debug, PartialEq)]
pub struct ClockConfig {
    /// Initial uncertainty of the camera time offset, s; 0 takes camera and IMU as synchronized.
    pub camera_sigma: f64,
    /// Largest standard deviation of the image stamps that is identified from their intervals, s; 0
    /// takes them as exact.
    pub image_jitter: f64,
    /// Initial camera time offset, s (image time + offset = IMU time).
    pub camera_offset: f64,
    /// Random walk of the camera time offset, s/√s.
    pub offset_walk: f64,
    /// Constant offset of the climber's stamps against the camera's, s (encoder time + camera
    /// offset + this = IMU time).
    pub climber_offset: f64,
}

/// Standard deviations of calibration errors. They widen the published covariance and do not change
/// the estimate.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationSigmas {
    /// Place of each marker on the platform, x and y, m. Where images contradict it, it is
    /// estimated; 0 takes it as exact.
    pub marker: f64,
    /// Focal length, relative.
    pub focal_length: f64,
    /// Size of the marker layout, relative.
    pub layout: f64,
    /// Orientation of the camera on the climber, each axis, rad.
    pub mounting: f64,
    /// Scale of the x and y encoders, relative.
    pub encoder_scale: f64,
    /// Time offset of the climber's stamps, s.
    pub climber_offset: f64,
}

/// Values beyond which a state is unsound and the filter reinitializes.
#[derive(Clone, Debug, PartialEq)]
pub struct LimitConfig {
    /// Distance of the platform from the climber, m.
    pub max_range: f64,
    /// Speed of the platform, m/s.
    pub max_speed: f64,
}

/// When a pose is called valid.
#[derive(Clone, Debug, PartialEq)]
pub struct StatusConfig {
    /// Without a used image for this long the pose is COASTING, s.
    pub max_image_age: f64,
    /// Largest position sigma of a valid pose, m.
    pub max_position_sigma: f64,
    /// Largest rotation sigma of a valid pose, rad.
    pub max_rotation_sigma: f64,
    /// Position sigma above which the pose is LOST, m.
    pub lost_position_sigma: f64,
}

/// Rope between climber and platform; used while no marker is visible.
#[derive(Clone, Debug, PartialEq)]
pub struct PendulumConfig {
    /// Length from the climber's attachment to the platform's, m; 0 disables the measurement.
    pub rope_length: f64,
    /// Uncertainty of the length until images have measured it, m.
    pub rope_sigma: f64,
    /// Smallest disturbance of the platform across the rope, each axis, m/s².
    pub side_force: f64,
    /// Upper end in the climber's frame, m.
    pub climber_attachment: Vector3<f64>,
    /// Lower end in the volant frame, m.
    pub platform_attachment: Vector3<f64>,
}

/// Configuration of the published filter.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperConfig {
    /// What corrects the prediction.
    pub measurement: PaperMeasurement,
    /// R/Q, the ratio of measurement to process covariance (paper, section III-C: 10).
    pub ratio: f64,
    /// Standard deviation behind R of the visual position, or of each marker coordinate, m. With
    /// poses as measurement only the ratio to Q matters for the estimate.
    pub position_sigma: f64,
    /// Standard deviation of the visual rotation behind R, rad; with markers as measurement it
    /// scales Q alone.
    pub rotation_sigma: f64,
    /// Gravity, m/s².
    pub gravity: f64,
    /// Threshold control: smaller velocity changes count as none, m/s (paper, section III-A).
    pub velocity_threshold: f64,
    /// Takes the inertial velocity from the fused poses; the paper names nothing that corrects it.
    pub velocity_from_fused: bool,
}

impl TightConfig {
    /// Defaults.
    pub const DEFAULT: Self = Self {
        gravity: 9.80665,
        history: 0.6,
        imu: ImuConfig::DEFAULT,
        markers: MarkerConfig {
            pixel_floor: 0.03,
            pixel_minimum: 0.01,
            gate: 16.0,
            lock_out_images: 2,
        },
        climber: ClimberConfig::DEFAULT,
        clock: ClockConfig {
            camera_sigma: 0.05,
            image_jitter: 0.02,
            camera_offset: 0.0,
            offset_walk: 1e-5,
            climber_offset: 0.0,
        },
        calibration: CalibrationSigmas::DEFAULT,
        zero_velocity_sigma: 0.002,
        limits: LimitConfig { max_range: 20.0, max_speed: 10.0 },
        prediction_horizon: 0.0,
        swing: true,
        pendulum: PendulumConfig::DEFAULT,
    };
}

impl ImuConfig {
    /// Defaults.
    pub const DEFAULT: Self = Self {
        accelerometer_bias: 0.2,
        accelerometer_bias_walk: 3e-4,
        gyroscope_bias: 0.09,
        gyroscope_bias_walk: 5e-5,
        accelerometer_scale: 0.002,
        gyroscope_scale: 0.003,
        misalignment: 0.0015,
        attitude_floor: 0.01,
        noise_limit: 30.0,
        max_force: 180.0,
        max_rate: 40.0,
    };
}

impl ClimberConfig {
    /// Defaults.
    pub const DEFAULT: Self = Self {
        quantum: 0.001,
        turn_quantum: 0.05 * std::f64::consts::PI / 180.0,
        jerk: 0.05,
        turn_jerk: 0.01,
        step_timeout: 3.0,
    };
}

impl CalibrationSigmas {
    /// Sigmas of zero: every file is taken as exact.
    pub const NONE: Self = Self {
        marker: 0.0,
        focal_length: 0.0,
        layout: 0.0,
        mounting: 0.0,
        encoder_scale: 0.0,
        climber_offset: 0.0,
    };
    /// Sigmas of a rig calibrated with `volant calibrate`.
    pub const DEFAULT: Self = Self {
        marker: 0.00004,
        focal_length: 0.0003,
        layout: 0.0003,
        mounting: 0.00005,
        encoder_scale: 0.0002,
        climber_offset: 0.002,
    };
}

impl StatusConfig {
    /// Defaults.
    pub const DEFAULT: Self = Self {
        max_image_age: 0.2,
        max_position_sigma: 0.1,
        max_rotation_sigma: 0.1,
        lost_position_sigma: 0.2,
    };
}

impl PendulumConfig {
    /// Defaults.
    pub const DEFAULT: Self = Self {
        rope_length: 0.0,
        rope_sigma: 0.02,
        side_force: 0.1,
        climber_attachment: Vector3::new(0.0, 0.0, 0.0),
        platform_attachment: Vector3::new(0.0, 0.0, 0.0),
    };
}

impl PaperConfig {
    /// Defaults.
    pub const DEFAULT: Self = Self {
        measurement: PaperMeasurement::Pose,
        ratio: 10.0,
        position_sigma: 0.005,
        rotation_sigma: 0.01,
        gravity: 9.80665,
        velocity_threshold: 1e-5,
        velocity_from_fused: false,
    };
}

macro_rules! default_is_const {
    ($($config:ident)*) => {
        $(
            impl Default for $config {
                fn default() -> Self {
                    Self::DEFAULT
                }
            }
        )*
    };
}

default_is_const! {
    TightConfig ImuConfig ClimberConfig CalibrationSigmas StatusConfig PendulumConfig PaperConfig
}
