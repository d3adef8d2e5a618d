//! Configuration of the estimators: every number that is not in the rig file. Each row declares a
//! ROS parameter of the node and the field that holds it.
//!
//! Standard deviations are 1 sigma.

use ros_parameters::{choices, parameters};

choices! {
    /// Which estimator runs.
    pub enum Model {
        /// Tightly coupled error-state filter on marker pixels.
        Tight = "tight",
        /// Loosely coupled extended Kalman filter as published in 2010.
        Paper = "paper",
    }
}

choices! {
    /// Visual measurement of the published filter.
    pub enum PaperMeasurement {
        /// Pose from one image: three positions and three rotations.
        Pose = "pose",
        /// The markers' coordinates reprojected to the world plane (eq. 8).
        Markers = "markers",
    }
}

parameters! {
    /// Configuration of everything in this crate.
    #[derive(PartialEq)]
    pub struct FusionConfig {
        /// The estimator: tight (error-state filter on pixels) or paper (the published filter).
        model: Model = Model::Tight;
        /// Largest rate of odometry, pose, fused_pose, status, tf, predicted_odometry and swing,
        /// for slow links; 0: that of the IMU.
        publish_rate: f64 = 0.0, unit("Hz"), range(0.0..=1000.0);
        /// volant/visual_pose with model tight: choose between the two planar solutions with the
        /// IMU's direction of gravity.
        visual_use_gravity: bool = false, name("visual_pose.use_gravity");
        groups {
            /// Error-state filter.
            tight: TightConfig;
            /// When a pose is called valid.
            status: StatusConfig;
            /// Published filter.
            paper: PaperConfig;
        }
    }
    check(p) { p.check() }
}

impl FusionConfig {
    /// Checks values that are valid by themselves and exclude each other.
    fn check(&self) -> Result<(), String> {
        let (horizon, history) = (self.tight.prediction_horizon, self.tight.history);
        let (max, lost) = (self.status.max_position_sigma, self.status.lost_position_sigma);
        if horizon > history {
            // The prediction's noise is measured in the history.
            Err(format!(
                "`prediction_horizon` is {horizon} s and exceeds `history`, {history} s: increase \
                 `history` or predict less far"
            ))
        } else if max > lost {
            Err(format!(
                "`status.max_position_sigma` is {max} m and exceeds `lost_position`, {lost} m, \
                 above which no pose is valid: increase `lost_position`"
            ))
        } else {
            Ok(())
        }
    }
}

parameters! {
    /// Configuration of the error-state filter.
    #[derive(PartialEq)]
    pub struct TightConfig {
        /// Gravity.
        gravity: f64 = 9.80665, unit("m/s^2"), range(9.0..=10.5);
        /// How far back delayed measurements are accepted; at least the searched camera time offset
        /// (0.3 s) and 0.1 s of latency.
        history: f64 = 0.6, unit("s"), range(0.4..=1.0);
        /// Velocity of a platform at rest for the zero-velocity update (1 sigma); 0 disables it.
        zero_velocity_sigma: f64 = 0.002, unit("m/s"), range(0.0..=1.0);
        /// How far ahead volant/predicted_odometry lies; 0 publishes nothing.
        prediction_horizon: f64 = 0.0, unit("s"), range(0.0..=1.0);
        /// With model tight: publish volant/swing.
        swing: bool = true, name("publish_swing");
        groups {
            /// Errors of the IMU.
            imu: ImuConfig;
            /// Marker measurements.
            markers: MarkerConfig;
            /// Encoders and motion of the climber.
            climber: ClimberConfig;
            /// Time offsets.
            clock: ClockConfig;
            /// Calibration errors that widen the covariance.
            calibration: CalibrationSigmas;
            /// Values beyond which a state is unsound.
            limits: LimitConfig;
            /// Rope that the platform hangs on.
            pendulum: PendulumConfig;
        }
    }
}

parameters! {
    /// Errors of the IMU.
    #[derive(PartialEq)]
    pub struct ImuConfig {
        // MTx data sheet: 0.02; ten times that for an IMU that is not calibrated.
        /// Initial accelerometer bias (1 sigma).
        accelerometer_bias: f64 = 0.2, unit("m/s^2"), range(0.0..=10.0),
            name("imu_bias.accelerometer");
        /// Random walk of the accelerometer bias.
        accelerometer_bias_walk: f64 = 3e-4, unit("m/s^2/sqrt(s)"), range(0.0..=1.0),
            name("imu_bias.accelerometer_walk");
        // 5°/s, five times the MTx data sheet.
        /// Initial gyroscope bias (1 sigma).
        gyroscope_bias: f64 = 0.09, unit("rad/s"), range(0.0..=1.0), name("imu_bias.gyroscope");
        /// Random walk of the gyroscope bias.
        gyroscope_bias_walk: f64 = 5e-5, unit("rad/s/sqrt(s)"), range(0.0..=1.0),
            name("imu_bias.gyroscope_walk");
        // MTx data sheet: 0.0003.
        /// Initial scale factor of each axis of the accelerometer, relative (1 sigma).
        accelerometer_scale: f64 = 0.002, range(0.0..=0.1), name("imu_scale.accelerometer");
        /// Initial scale factor of each axis of the gyroscope, relative (1 sigma).
        gyroscope_scale: f64 = 0.003, range(0.0..=0.1), name("imu_scale.gyroscope");
        // MTx data sheet: 0.1°.
        /// Initial rotation of gyroscope and accelerometer against the mounting, each axis (1
        /// sigma).
        misalignment: f64 = 0.0015, unit("rad"), range(0.0..=0.1), name("imu_scale.misalignment");
        // 0.2°: it is aligned by hand; its tilt shows at rest.
        /// Initial rotation of the whole IMU about the vertical against the mounting (1 sigma).
        mounting_yaw: f64 = 0.003, unit("rad"), range(0.0..=0.1), name("imu_scale.mounting_yaw");
    }
}

parameters! {
    /// Marker measurements.
    #[derive(PartialEq)]
    pub struct MarkerConfig {
        /// Pixel error of the lens and marker model, beside the observation's covariance.
        pixel_floor: f64 = 0.03, unit("px"), range(0.0..=10.0), name("markers.pixel_floor");
        // 16: 0.9997 quantile of χ².
        /// Largest normalized innovation squared (2 degrees of freedom) of a marker that is used.
        gate: f64 = 16.0, range(1.0..=1000.0), name("markers.gate");
        /// Standard deviation of the camera's attitude against the climber's frame while it drives:
        /// a carriage that rocks, a camera that vibrates. All markers of an image share its error.
        /// Vibrations of a twelfth to half of the image rate are found without it.
        camera_tilt: f64 = 0.0, unit("rad"), range(0.0..=0.1), name("markers.camera_tilt_sigma");
        /// Consecutive rejected but self-consistent images before the state is re-propagated with
        /// extra process noise.
        lock_out_images: u32 = 2, range(1..=1000), name("markers.lock_out_images");
    }
}

parameters! {
    /// Encoders and motion of the climber.
    #[derive(PartialEq)]
    pub struct ClimberConfig {
        /// Step of the climber's x and y encoders.
        quantum: f64 = 0.001, unit("m"), range(1e-6..=0.1), name("climber.quantum");
        /// Step of the climber's turn encoder.
        turn_quantum: f64 = 0.05 * std::f64::consts::PI / 180.0, unit("rad"), range(1e-7..=0.1),
            name("climber.turn_quantum");
        /// Power spectral density of the climber's jerk.
        jerk: f64 = 0.2, unit("m^2/s^5"), range(1e-9..=1e6), name("climber.jerk");
        /// Power spectral density of the jerk of the climber's turn.
        turn_jerk: f64 = 0.04, unit("rad^2/s^5"), range(1e-9..=1e6), name("climber.turn_jerk");
        /// Encoders that contradict the estimate for this long are adopted (re-homed or slipped).
        step_timeout: f64 = 3.0, unit("s"), range(0.1..=3600.0), name("climber.step_timeout");
    }
}

parameters! {
    /// Time offsets between the sensors.
    #[derive(PartialEq)]
    pub struct ClockConfig {
        /// Initial uncertainty of the camera time offset (1 sigma); 0 takes camera and IMU as
        /// synchronized.
        camera_sigma: f64 = 0.05, unit("s"), range(0.0..=0.2), name("clock.camera");
        /// Largest jitter of the image stamps (1 sigma) that is identified from their intervals; 0
        /// takes them as exact (a hardware trigger at varying intervals).
        image_jitter: f64 = 0.02, unit("s"), range(0.0..=0.1), name("clock.image_jitter");
        /// Rolling shutter: time from the exposure of the first row of an image to that of the last
        /// (negative: the last row comes first). The stamp is that of the middle row, but for the
        /// camera time offset. 0: global shutter.
        image_readout: f64 = 0.0, unit("s"), range(-0.1..=0.1), name("clock.image_readout");
        /// Initial camera time offset: image time + offset = IMU time. With model paper it is not
        /// estimated.
        camera_offset: f64 = 0.0, unit("s"), range(-1.0..=1.0), name("clock.camera_offset");
        /// Constant offset of the climber's stamps: encoder time + camera offset + this = IMU time.
        climber_offset: f64 = 0.0, unit("s"), range(-1.0..=1.0), name("clock.climber_offset");
    }
}

parameters! {
    /// Standard deviations of calibration errors. They widen the published covariance and do not
    /// change the estimate. The defaults claim files that are nearly exact; `volant bringup` writes
    /// how well a rig was measured and calibrated.
    #[derive(PartialEq)]
    pub struct CalibrationSigmas {
        /// Uncertainty of clock.climber_offset (1 sigma), which widens the covariance.
        climber_offset: f64 = 0.002, unit("s"), range(0.0..=0.1), name("clock.climber_sigma");
        /// Error of a marker's place, x and y on the platform (1 sigma), which widens the
        /// covariance: on a small layout 1 mm may tilt the pose by 1 degree. Where images
        /// contradict the places, the filter estimates them; 0 takes them as exact.
        marker: f64 = 0.00004, unit("m"), range(0.0..=0.05), name("calibration.marker_sigma");
        /// Relative error of the focal length (1 sigma), which widens the covariance.
        focal_length: f64 = 0.0003, range(0.0..=0.1), name("calibration.focal_length_sigma");
        /// Relative error of the marker layout's size (1 sigma), which widens the covariance.
        layout: f64 = 0.0003, range(0.0..=0.1), name("calibration.layout_sigma");
        /// Orientation error of the camera mounting, each axis (1 sigma), which widens the
        /// covariance.
        mounting: f64 = 0.00005, unit("rad"), range(0.0..=0.1), name("calibration.mounting_sigma");
        /// Relative error of the x and y encoders' scale (1 sigma), which widens the covariance.
        encoder_scale: f64 = 0.0002, range(0.0..=0.1), name("calibration.encoder_scale_sigma");
        /// Distance of the climber from where encoders and `height` place it, each axis (1 sigma),
        /// which widens the covariance of positions: rails that are not straight or level over some
        /// meters.
        rails: f64 = 0.0, unit("m"), range(0.0..=0.1), name("calibration.rail_sigma");
    }
}

impl CalibrationSigmas {
    /// Sigmas of zero: every file is taken as exact.
    pub const NONE: Self = Self {
        climber_offset: 0.0,
        marker: 0.0,
        focal_length: 0.0,
        layout: 0.0,
        mounting: 0.0,
        encoder_scale: 0.0,
        rails: 0.0,
    };
}

parameters! {
    /// Values beyond which a state is unsound and the filter reinitializes.
    #[derive(PartialEq)]
    pub struct LimitConfig {
        /// Horizontal distance of the platform from the climber beyond which the estimate is
        /// unsound.
        max_range: f64 = 20.0, unit("m"), range(0.1..=1000.0), name("limits.max_range");
        /// Speed of the platform beyond which the estimate is unsound.
        max_speed: f64 = 10.0, unit("m/s"), range(0.1..=100.0), name("limits.max_speed");
    }
}

parameters! {
    /// When a pose is called valid.
    #[derive(PartialEq)]
    pub struct StatusConfig {
        /// Without a used image for this long the pose is COASTING.
        max_image_age: f64 = 0.2, unit("s"), range(0.01..=60.0), name("status.max_image_age");
        /// Largest position sigma of a valid pose.
        max_position_sigma: f64 = 0.1, unit("m"), range(1e-4..=100.0),
            name("status.max_position_sigma");
        /// Largest rotation sigma of a valid pose.
        max_rotation_sigma: f64 = 0.1, unit("rad"), range(1e-4..=3.2),
            name("status.max_rotation_sigma");
        /// Position sigma above which the pose is LOST.
        lost_position_sigma: f64 = 0.2, unit("m"), range(0.001..=100.0), name("lost_position");
    }
}

parameters! {
    /// Rope between climber and platform; used while no marker is visible.
    #[derive(PartialEq)]
    pub struct PendulumConfig {
        /// Rope from the climber's attachment to the platform's, used while no marker is visible; 0
        /// disables it.
        rope_length: f64 = 0.0, unit("m"), range(0.0..=100.0), name("pendulum.rope_length");
        /// Uncertainty of the rope's length (1 sigma) until images have measured it.
        rope_sigma: f64 = 0.02, unit("m"), range(1e-4..=10.0), name("pendulum.rope_sigma");
        /// Smallest disturbance of the platform across the rope, each axis (1 sigma).
        side_force: f64 = 0.1, unit("m/s^2"), range(1e-3..=10.0), name("pendulum.side_force");
        /// Upper end of the rope in the climber's frame: x, y, z.
        climber_attachment: [f64; 3] = [0.0; 3], unit("m"), range(-100.0..=100.0),
            name("pendulum.climber_attachment");
        /// Lower end of the rope in the volant frame: x, y, z.
        platform_attachment: [f64; 3] = [0.0; 3], unit("m"), range(-100.0..=100.0),
            name("pendulum.platform_attachment");
    }
}

parameters! {
    /// Configuration of the published filter.
    #[derive(PartialEq)]
    pub struct PaperConfig {
        /// What corrects the published filter: pose (from one image) or markers (their coordinates
        /// reprojected to the world plane, eq. 8).
        measurement: PaperMeasurement = PaperMeasurement::Pose, name("paper.measurement");
        // With poses as measurement only the ratio to Q matters for the estimate.
        /// Visual position of the published filter, or each marker coordinate (1 sigma): R.
        position_sigma: f64 = 0.005, unit("m"), range(1e-6..=10.0), name("paper.position_sigma");
        // With markers as measurement it scales Q alone.
        /// Visual rotation of the published filter (1 sigma): R.
        rotation_sigma: f64 = 0.01, unit("rad"), range(1e-6..=3.2), name("paper.rotation_sigma");
        // Paper, section III-C.
        /// R/Q of the published filter: larger trusts the IMU more.
        ratio: f64 = 10.0, range(1e-6..=1e6), name("paper.ratio");
        // Paper, section III-A.
        /// Velocity changes below this count as zero (threshold control of the published filter).
        velocity_threshold: f64 = 1e-5, unit("m/s"), range(0.0..=1.0),
            name("paper.velocity_threshold");
        // The paper names nothing that corrects the inertial velocity.
        /// Takes the published filter's inertial velocity from the fused poses.
        velocity_from_fused: bool = false, name("paper.velocity_from_fused");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros_parameters::{ParameterMap, ParameterSet, ParameterValue};

    #[test]
    fn values_that_exclude_each_other_are_rejected_with_their_names() {
        assert_eq!(FusionConfig::default().check(), Ok(()));
        for (name, value) in [("prediction_horizon", 0.8), ("status.max_position_sigma", 0.5)] {
            let map = ParameterMap::from([(name.to_owned(), ParameterValue::Double(value))]);
            let error = FusionConfig::from_map(&map).unwrap_err().to_string();
            assert!(error.contains(name), "{error}");
        }
    }
}
