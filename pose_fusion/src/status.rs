//! What the filter knows about itself: for diagnostics.

use crate::tight::pendulum::Rope;
use nalgebra::Vector3;
use rig_model::Stamp;

/// Counters since the start and the newest insights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// There is an estimate.
    pub initialised: bool,
    /// Markers are compared but not used.
    pub frozen: bool,
    /// The estimate is worth little: its position is more uncertain than the limit.
    pub lost: bool,
    /// Inertial samples taken.
    pub imu_samples: u64,
    /// Inertial samples refused (not finite, too old, too far ahead).
    pub refused_imu: u64,
    /// Inertial samples that came out of order and were put in place.
    pub late_imu: u64,
    /// Pauses between inertial samples.
    pub gaps: u64,
    /// Images seen.
    pub images: u64,
    /// Images refused.
    pub refused_images: u64,
    /// Markers refused as not finite.
    pub refused_markers: u64,
    /// Markers used.
    pub used_markers: u64,
    /// Markers rejected by a gate.
    pub rejected_markers: u64,
    /// Climber samples refused.
    pub refused_climber: u64,
    /// Messages that came twice.
    pub duplicates: u64,
    /// Jumps of time that made the filter start anew.
    pub time_jumps: u64,
    /// Starts from markers that had contradicted the estimate.
    pub recoveries: u64,
    /// Times that the estimate was not finite any more.
    pub divergences: u64,
    /// Odometry said.
    pub odometry: u64,
    /// Newest inertial stamp.
    pub newest_imu: Option<Stamp>,
    /// Newest image that was used.
    pub last_used_image: Option<Stamp>,
    /// Largest standard deviation of the position, m.
    pub position_sigma: f64,
    /// Camera clock offset, s: an image stamped t was taken at t plus this, on the inertial unit's clock.
    pub camera_clock_offset: f64,
    /// Its standard deviation, s.
    pub camera_clock_sigma: f64,
    /// Hypotheses of the clock offset that are still open.
    pub clock_hypotheses: usize,
    /// Climber clock offset d, s: a reading stamped t was taken at t plus the camera clock's offset plus d.
    pub climber_clock_offset: f64,
    /// Its standard deviation, s.
    pub climber_clock_sigma: f64,
    /// Probability that climber and camera have one clock (d = 0).
    pub climber_clock_tied: f64,
    /// Accelerometer bias, imu axes, m/s².
    pub accelerometer_bias: Vector3<f64>,
    /// Gyroscope bias, imu axes, rad/s.
    pub gyroscope_bias: Vector3<f64>,
    /// Noise density of the accelerometer as it was found, m/s²/√Hz.
    pub accelerometer_noise_density: f64,
    /// Noise density of the gyroscope as it was found, rad/s/√Hz.
    pub gyroscope_noise_density: f64,
    /// Factor on the markers' claimed sigma that their innovations ask for.
    pub pixel_noise_factor: f64,
    /// The rope as it was found, where one is configured.
    pub rope: Option<Rope>,
}
