//! Counters and insights of the filter, for diagnostics.

use crate::{
    adaptation::imu_noise::Densities,
    ekf::{
        calibration::{Constants, MARKERS, OFFSETS},
        consider::FileErrors,
    },
    input::imu_stamps::Bursts,
    measurements::rope::Rope,
};
use nalgebra::Vector3;
use rig_model::Stamp;

/// Counters since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Inputs.
    pub inputs: InputCounts,
    /// Inputs that were rejected.
    pub rejected: RejectedCounts,
    /// Recoveries and reinitializations.
    pub resets: ResetCounts,
    /// Markers that updated the state.
    pub used_markers: u64,
    /// Markers rejected by a gate.
    pub gated_markers: u64,
    /// Encoder readings excluded as outliers.
    pub excluded_readings: u64,
}

/// Inputs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InputCounts {
    /// IMU samples that came out of order and were put in place.
    pub late_imu: u64,
    /// Gaps between IMU samples.
    pub imu_gaps: u64,
    /// Images.
    pub images: u64,
    /// Messages that came twice.
    pub duplicates: u64,
    /// Measurements dropped because the history was full.
    pub overflows: u64,
}

/// Inputs that were rejected: not finite, too old, too far ahead, beyond the sensor's range.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RejectedCounts {
    /// IMU samples.
    pub imu: u64,
    /// Images.
    pub images: u64,
    /// Markers.
    pub markers: u64,
    /// Encoder readings.
    pub climber: u64,
}

/// Recoveries and reinitializations.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ResetCounts {
    /// Time jumped back: everything was reinitialized.
    pub time_jumps: u64,
    /// The IMU's clock stepped against that of camera and encoders.
    pub clock_steps: u64,
    /// Shocks of the platform that images revealed.
    pub shocks: u64,
    /// Poses reinitialized from markers that had contradicted the estimate.
    pub recoveries: u64,
    /// Unsound states.
    pub divergences: u64,
    /// Steps of the encoders that were adopted.
    pub encoder_steps: u64,
    /// Initializations of the camera time offset.
    pub time_offsets: u64,
}

/// Counters and the newest insights.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Status {
    /// There is an estimate.
    pub initialized: bool,
    /// The encoders.
    pub encoders: EncoderStatus,
    /// Newest stamp of the IMU samples.
    pub newest_imu: Option<Stamp>,
    /// Noise densities identified: specific force (m/s²)²/Hz, angular velocity (rad/s)²/Hz.
    pub imu_noise: Densities,
    /// The bursts in which IMU samples come, where they have the stamps of their arrival.
    pub imu_bursts: Option<Bursts>,
    /// Largest standard deviation of the position, m; infinite without an estimate.
    pub position_sigma: f64,
    /// Camera time offset, s (image time + offset = IMU time).
    pub time_offset: TimeOffsetStatus,
    /// Accelerometer (m/s²) and gyroscope bias (rad/s), IMU axes.
    pub biases: [Vector3<f64>; 2],
    /// Estimated constants: scale factors of gyroscope and accelerometer, rotations of both, rad;
    /// offsets of the markers, m.
    pub constants: Constants,
    /// Factor on the markers' claimed sigma that their innovations require.
    pub pixel_noise_factor: f64,
    /// Errors of the rig's files that images and IMU show; zero where they show none.
    pub file_errors: FileErrors,
    /// Rope as identified, where one is configured.
    pub rope: Option<Rope>,
    /// Counters.
    pub counts: Counts,
}

/// Trust in the encoders.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderStatus {
    /// They contradict the estimate and are not used.
    pub suspended: bool,
    /// What is wrong with their directions, as images and IMU show.
    pub wrong_directions: Option<&'static str>,
}

impl Status {
    /// Returns the largest estimated offset of a marker from the rig file, in one axis, m.
    pub fn marker_offset(&self) -> f64 {
        self.constants.fixed_rows::<OFFSETS>(MARKERS).amax()
    }
}

/// What is known of the camera time offset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimeOffsetStatus {
    /// Offset, s.
    pub offset: f64,
    /// `clock.camera_offset`, s.
    pub configured: f64,
    /// Standard deviation, s; NaN where it is not estimated (published filter).
    pub sigma: f64,
    /// The initial search still runs.
    pub searching: bool,
}
