//! Parameters of the node, and the core's configuration that follows from them.

use crate::{
    FusionConfig, Model, PaperConfig, PendulumConfig, TightConfig,
    config::{
        CalibrationSigmas, ClimberConfig, ClockConfig, ImuConfig, LimitConfig, MarkerConfig,
        PaperMeasurement, StatusConfig,
    },
};
use nalgebra::Vector3;

/// Defaults: those of the core.
const TIGHT: TightConfig = TightConfig::DEFAULT;
const STATUS: StatusConfig = StatusConfig::DEFAULT;
const PAPER: PaperConfig = PaperConfig::DEFAULT;

node_kit::parameters! {
    /// Parameters of the node: one field per ROS parameter, so there are more than a dozen.
    pub struct FusionParameters {
        /// The estimator: tight (error-state filter on pixels) or paper (the published filter).
        model: String = "tight", one_of(&["tight", "paper"]);
        /// Largest rate of odometry, poses, status, tf and prediction, for slow links; 0: that of the
        /// IMU.
        publish_rate: f64 = 0.0, unit("Hz"), range(0.0..=1000.0);
        /// Gravity.
        gravity: f64 = TIGHT.gravity, unit("m/s^2"), range(9.0..=10.5);
        /// How far back delayed measurements are accepted.
        history: f64 = TIGHT.history, unit("s"), range(0.1..=1.0);
        /// Initial accelerometer bias (1 sigma).
        accelerometer_bias: f64 = TIGHT.imu.accelerometer_bias, unit("m/s^2"), range(0.0..=10.0),
            name("imu_bias.accelerometer");
        /// Random walk of the accelerometer bias.
        accelerometer_bias_walk: f64 = TIGHT.imu.accelerometer_bias_walk, unit("m/s^2/sqrt(s)"),
            range(0.0..=1.0),
            name("imu_bias.accelerometer_walk");
        /// Initial gyroscope bias (1 sigma).
        gyroscope_bias: f64 = TIGHT.imu.gyroscope_bias, unit("rad/s"), range(0.0..=1.0),
            name("imu_bias.gyroscope");
        /// Random walk of the gyroscope bias.
        gyroscope_bias_walk: f64 = TIGHT.imu.gyroscope_bias_walk, unit("rad/s/sqrt(s)"),
            range(0.0..=1.0),
            name("imu_bias.gyroscope_walk");
        /// Initial scale factor of each axis of the accelerometer, relative (1 sigma).
        accelerometer_scale: f64 = TIGHT.imu.accelerometer_scale, range(0.0..=0.1),
            name("imu_scale.accelerometer");
        /// Initial scale factor of each axis of the gyroscope, relative (1 sigma).
        gyroscope_scale: f64 = TIGHT.imu.gyroscope_scale, range(0.0..=0.1),
            name("imu_scale.gyroscope");
        /// Initial rotation of gyroscope and accelerometer against the mounting, each axis (1
        /// sigma).
        misalignment: f64 = TIGHT.imu.misalignment, unit("rad"), range(0.0..=0.1),
            name("imu_scale.misalignment");
        /// Pixel error of the lens and marker model, beside the observation's covariance.
        pixel_floor: f64 = TIGHT.markers.pixel_floor, unit("px"), range(0.0..=10.0),
            name("markers.pixel_floor");
        /// Largest normalized innovation squared (2 degrees of freedom) of a marker that is used.
        marker_gate: f64 = TIGHT.markers.gate, range(1.0..=1000.0), name("markers.gate");
        /// Consecutive images that contradict the prediction, but not themselves, before the
        /// prediction gives way.
        lock_out_images: u32 = TIGHT.markers.lock_out_images, range(1..=1000),
            name("markers.lock_out_images");
        /// Step of the climber's x and y encoders.
        climber_quantum: f64 = TIGHT.climber.quantum, unit("m"), range(1e-6..=0.1),
            name("climber.quantum");
        /// Step of the climber's turn encoder.
        climber_turn_quantum: f64 = TIGHT.climber.turn_quantum, unit("rad"), range(1e-7..=0.1),
            name("climber.turn_quantum");
        /// Power spectral density of the climber's jerk.
        climber_jerk: f64 = TIGHT.climber.jerk, unit("m^2/s^5"), range(1e-9..=1e6),
            name("climber.jerk");
        /// Power spectral density of the jerk of the climber's turn.
        climber_turn_jerk: f64 = TIGHT.climber.turn_jerk, unit("rad^2/s^5"), range(1e-9..=1e6),
            name("climber.turn_jerk");
        /// Encoders that contradict the estimate for this long are adopted (re-homed or slipped).
        climber_step_timeout: f64 = TIGHT.climber.step_timeout, unit("s"), range(0.1..=3600.0),
            name("climber.step_timeout");
        /// Initial uncertainty of the camera time offset (1 sigma); 0 takes camera and IMU as
        /// synchronized.
        camera_clock: f64 = TIGHT.clock.camera_sigma, unit("s"), range(0.0..=0.2),
            name("clock.camera");
        /// Largest jitter of the image stamps (1 sigma) that is identified from their intervals; 0
        /// takes them as exact (a hardware trigger at varying intervals).
        image_jitter: f64 = TIGHT.clock.image_jitter, unit("s"), range(0.0..=0.1),
            name("clock.image_jitter");
        /// Initial camera time offset: image time + offset = IMU time.
        camera_clock_offset: f64 = TIGHT.clock.camera_offset, unit("s"), range(-1.0..=1.0),
            name("clock.camera_offset");
        /// Constant offset of the climber's stamps: encoder time + camera offset + this = IMU time.
        climber_offset: f64 = TIGHT.clock.climber_offset, unit("s"), range(-1.0..=1.0),
            name("clock.climber_offset");
        /// Uncertainty of that offset (1 sigma), which widens the covariance.
        climber_sigma: f64 = TIGHT.calibration.climber_offset, unit("s"), range(0.0..=0.1),
            name("clock.climber_sigma");
        /// Error of a marker's place, x and y on the platform (1 sigma), which widens the
        /// covariance. Where images contradict the places, the filter estimates them; 0 takes them
        /// as exact.
        marker_sigma: f64 = TIGHT.calibration.marker, unit("m"), range(0.0..=0.05),
            name("calibration.marker_sigma");
        /// Relative error of the focal length (1 sigma), which widens the covariance.
        focal_length_sigma: f64 = TIGHT.calibration.focal_length, range(0.0..=0.1),
            name("calibration.focal_length_sigma");
        /// Relative error of the marker layout's size (1 sigma), which widens the covariance.
        layout_sigma: f64 = TIGHT.calibration.layout, range(0.0..=0.1),
            name("calibration.layout_sigma");
        /// Orientation error of the camera mounting, each axis (1 sigma), which widens the
        /// covariance.
        mounting_sigma: f64 = TIGHT.calibration.mounting, unit("rad"), range(0.0..=0.1),
            name("calibration.mounting_sigma");
        /// Relative error of the x and y encoders' scale (1 sigma), which widens the covariance.
        encoder_scale_sigma: f64 = TIGHT.calibration.encoder_scale, range(0.0..=0.1),
            name("calibration.encoder_scale_sigma");
        /// Velocity of a platform at rest for the zero-velocity update (1 sigma); 0 disables it.
        zero_velocity_sigma: f64 = TIGHT.zero_velocity_sigma, unit("m/s"), range(0.0..=1.0);
        /// Distance of the platform from the climber beyond which the estimate is unsound.
        max_range: f64 = TIGHT.limits.max_range, unit("m"), range(0.1..=1000.0),
            name("limits.max_range");
        /// Speed of the platform beyond which the estimate is unsound.
        max_speed: f64 = TIGHT.limits.max_speed, unit("m/s"), range(0.1..=100.0),
            name("limits.max_speed");
        /// How far ahead volant/predicted_odometry lies; 0 publishes nothing.
        prediction_horizon: f64 = TIGHT.prediction_horizon, unit("s"), range(0.0..=1.0);
        /// With model tight: publish volant/swing.
        publish_swing: bool = TIGHT.swing;
        /// Without a used image for this long the pose is COASTING.
        max_image_age: f64 = STATUS.max_image_age, unit("s"), range(0.01..=60.0),
            name("status.max_image_age");
        /// Largest position sigma of a valid pose.
        max_position_sigma: f64 = STATUS.max_position_sigma, unit("m"), range(1e-4..=100.0),
            name("status.max_position_sigma");
        /// Largest rotation sigma of a valid pose.
        max_rotation_sigma: f64 = STATUS.max_rotation_sigma, unit("rad"), range(1e-4..=3.2),
            name("status.max_rotation_sigma");
        /// Position sigma above which the pose is LOST.
        lost_position: f64 = STATUS.lost_position_sigma, unit("m"), range(0.001..=100.0);
        /// volant/visual_pose with model tight: choose between the two planar solutions with the
        /// IMU's direction of gravity.
        visual_use_gravity: bool = false, name("visual_pose.use_gravity");
        /// Rope from the climber's attachment to the platform's, used while no marker is visible; 0
        /// disables it.
        rope_length: f64 = TIGHT.pendulum.rope_length, unit("m"), range(0.0..=100.0),
            name("pendulum.rope_length");
        /// Uncertainty of the rope's length (1 sigma) until images have measured it.
        rope_sigma: f64 = TIGHT.pendulum.rope_sigma, unit("m"), range(1e-4..=10.0),
            name("pendulum.rope_sigma");
        /// Smallest disturbance of the platform across the rope, each axis (1 sigma).
        side_force: f64 = TIGHT.pendulum.side_force, unit("m/s^2"), range(1e-3..=10.0),
            name("pendulum.side_force");
        /// Upper end of the rope in the climber's frame: x, y, z.
        climber_attachment: Vec<f64> = &[0.0, 0.0, 0.0], unit("m"), range(-100.0..=100.0),
            name("pendulum.climber_attachment");
        /// Lower end of the rope in the volant frame: x, y, z.
        platform_attachment: Vec<f64> = &[0.0, 0.0, 0.0], unit("m"), range(-100.0..=100.0),
            name("pendulum.platform_attachment");
        /// What corrects the published filter: pose (from one image) or markers (their coordinates
        /// reprojected to the world plane, eq. 8).
        paper_measurement: String = "pose", one_of(&["pose", "markers"]),
            name("paper.measurement");
        /// Visual position of the published filter, or each marker coordinate (1 sigma): R.
        paper_position_sigma: f64 = PAPER.position_sigma, unit("m"), range(1e-6..=10.0),
            name("paper.position_sigma");
        /// Visual rotation of the published filter (1 sigma): R.
        paper_rotation_sigma: f64 = PAPER.rotation_sigma, unit("rad"), range(1e-6..=3.2),
            name("paper.rotation_sigma");
        /// R/Q of the published filter: larger trusts the IMU more.
        paper_ratio: f64 = PAPER.ratio, range(1e-6..=1e6), name("paper.ratio");
        /// Threshold control of the published filter.
        paper_velocity_threshold: f64 = PAPER.velocity_threshold, unit("m/s"), range(0.0..=1.0),
            name("paper.velocity_threshold");
        /// Takes the published filter's inertial velocity from the fused poses.
        paper_velocity_from_fused: bool = PAPER.velocity_from_fused,
            name("paper.velocity_from_fused");
        /// Where ~/save_checkpoint writes what the filter knows and ~/load_checkpoint reads it;
        /// empty: nowhere.
        checkpoint_file: String = "";
        /// Publish world -> volant on /tf.
        publish_tf: bool = true;
        /// Publish what became of each marker on volant/marker_updates.
        publish_marker_updates: bool = true;
        /// Without IMU samples or used images for this long the diagnostics say so.
        silence_timeout: f64 = 0.5, unit("s"), range(0.01..=60.0);
    }
    check(p) { p.config().map(|_| ()) }
}

impl FusionParameters {
    /// Returns the core's configuration.
    ///
    /// # Errors
    /// An attachment that is not three numbers.
    pub fn config(&self) -> Result<FusionConfig, String> {
        Ok(FusionConfig {
            publish_rate: self.publish_rate,
            model: if self.model == "paper" { Model::Paper } else { Model::Tight },
            tight: self.tight()?,
            paper: PaperConfig {
                measurement: if self.paper_measurement == "markers" {
                    PaperMeasurement::Markers
                } else {
                    PaperMeasurement::Pose
                },
                ratio: self.paper_ratio,
                position_sigma: self.paper_position_sigma,
                rotation_sigma: self.paper_rotation_sigma,
                gravity: self.gravity,
                velocity_threshold: self.paper_velocity_threshold,
                velocity_from_fused: self.paper_velocity_from_fused,
            },
            visual_use_gravity: self.visual_use_gravity,
            status: StatusConfig {
                max_image_age: self.max_image_age,
                max_position_sigma: self.max_position_sigma,
                max_rotation_sigma: self.max_rotation_sigma,
                lost_position_sigma: self.lost_position,
            },
        })
    }

    fn tight(&self) -> Result<TightConfig, String> {
        let place = |name: &str, numbers: &[f64]| match *numbers {
            [x, y, z] => Ok(Vector3::new(x, y, z)),
            _ => Err(format!("{name} has {} numbers, not three: x, y, z", numbers.len())),
        };
        let default = TightConfig::default();
        Ok(TightConfig {
            gravity: self.gravity,
            history: self.history,
            imu: ImuConfig {
                accelerometer_bias: self.accelerometer_bias,
                accelerometer_bias_walk: self.accelerometer_bias_walk,
                gyroscope_bias: self.gyroscope_bias,
                gyroscope_bias_walk: self.gyroscope_bias_walk,
                accelerometer_scale: self.accelerometer_scale,
                gyroscope_scale: self.gyroscope_scale,
                misalignment: self.misalignment,
                ..default.imu
            },
            markers: MarkerConfig {
                pixel_floor: self.pixel_floor,
                gate: self.marker_gate,
                lock_out_images: self.lock_out_images,
                ..default.markers
            },
            climber: ClimberConfig {
                quantum: self.climber_quantum,
                turn_quantum: self.climber_turn_quantum,
                jerk: self.climber_jerk,
                turn_jerk: self.climber_turn_jerk,
                step_timeout: self.climber_step_timeout,
            },
            clock: ClockConfig {
                camera_sigma: self.camera_clock,
                image_jitter: self.image_jitter,
                camera_offset: self.camera_clock_offset,
                climber_offset: self.climber_offset,
                ..default.clock
            },
            calibration: CalibrationSigmas {
                marker: self.marker_sigma,
                focal_length: self.focal_length_sigma,
                layout: self.layout_sigma,
                mounting: self.mounting_sigma,
                encoder_scale: self.encoder_scale_sigma,
                climber_offset: self.climber_sigma,
            },
            zero_velocity_sigma: self.zero_velocity_sigma,
            limits: LimitConfig { max_range: self.max_range, max_speed: self.max_speed },
            prediction_horizon: self.prediction_horizon,
            swing: self.publish_swing,
            pendulum: PendulumConfig {
                rope_length: self.rope_length,
                rope_sigma: self.rope_sigma,
                side_force: self.side_force,
                climber_attachment: place("pendulum.climber_attachment", &self.climber_attachment)?,
                platform_attachment: place(
                    "pendulum.platform_attachment",
                    &self.platform_attachment,
                )?,
            },
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_parameters_the_node_is_configured_as_the_core() {
        assert_eq!(FusionParameters::default().config().unwrap(), FusionConfig::default());
    }

    #[test]
    fn an_attachment_is_three_numbers() {
        let parameters = FusionParameters {
            platform_attachment: vec![0.0, 0.1, 0.2, 0.3],
            ..FusionParameters::default()
        };
        let why = parameters.config().unwrap_err();
        assert!(why.contains("pendulum.platform_attachment has 4 numbers"), "{why}");
    }
}
