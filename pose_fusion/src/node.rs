//! The shell: markers, inertial samples and the climber's transform in; odometry, fused pose, visual pose, tf, marker records and
//! diagnostics out.

use crate::{
    Fusion, FusionConfig, Input, Model, Output, PaperConfig, PendulumConfig, TightConfig, Warning, messages,
    services::{self, Request},
};
use nalgebra::Vector3;
use node_kit::{
    Level, convert,
    node::{Health, Kit, NodeError, NodeShell, Publisher},
    qos::QosPreset,
};
use rig_model::{Frames, Stamp};
use std::sync::Arc;
use volant_msgs::{
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    msg::{MarkerObservations, MarkerUpdates},
    nav_msgs, sensor_msgs,
};

node_kit::parameters! {
    /// Parameters of the fusion's node.
    pub struct FusionParameters {
        /// The estimator: tight (error-state filter on pixels) or paper (the published filter).
        model: String = "tight", one_of(&["tight", "paper"]);
        /// Gravity.
        gravity: f64 = 9.80665, unit("m/s^2"), range(9.0..=10.5);
        /// How far back late data may reach.
        history: f64 = 0.6, unit("s"), range(0.1..=5.0);
        /// Accelerometer bias at the start (1 sigma).
        accelerometer_bias: f64 = 0.2, unit("m/s^2"), range(0.0..=10.0), name("imu_bias.accelerometer");
        /// Its random walk.
        accelerometer_bias_walk: f64 = 3e-4, unit("m/s^2/sqrt(s)"), range(0.0..=1.0), name("imu_bias.accelerometer_walk");
        /// Gyroscope bias at the start (1 sigma).
        gyroscope_bias: f64 = 0.09, unit("rad/s"), range(0.0..=1.0), name("imu_bias.gyroscope");
        /// Its random walk.
        gyroscope_bias_walk: f64 = 5e-5, unit("rad/s/sqrt(s)"), range(0.0..=1.0), name("imu_bias.gyroscope_walk");
        /// What the lens and marker model are off by, beside the observation's covariance.
        pixel_floor: f64 = 0.03, unit("px"), range(0.0..=10.0), name("markers.pixel_floor");
        /// What a marker's centroid is off by in all images alike, each axis (1 sigma).
        pixel_systematic: f64 = 0.015, unit("px"), range(0.0..=10.0), name("markers.pixel_systematic");
        /// Largest normalised innovation squared (2 degrees of freedom) of a marker that is used.
        marker_gate: f64 = 16.0, range(1.0..=1000.0), name("markers.gate");
        /// So many images in a row that contradict the estimate, but not themselves, start it anew.
        lock_out_images: u32 = 5, range(1..=1000), name("markers.lock_out_images");
        /// Step of the climber's x and y encoders.
        climber_quantum: f64 = 0.001, unit("m"), range(1e-6..=0.1), name("climber.quantum");
        /// Step of the climber's turn encoder.
        climber_turn_quantum: f64 = 0.05_f64.to_radians(), unit("rad"), range(1e-7..=0.1), name("climber.turn_quantum");
        /// Power density of the climber's jerk.
        climber_jerk: f64 = 0.05, unit("m^2/s^5"), range(1e-9..=1e6), name("climber.jerk");
        /// Power density of the jerk of the climber's turn.
        climber_turn_jerk: f64 = 0.01, unit("rad^2/s^5"), range(1e-9..=1e6), name("climber.turn_jerk");
        /// Camera clock against the inertial unit's at the start (1 sigma); 0 takes them as one.
        camera_clock: f64 = 0.05, unit("s"), range(0.0..=0.2), name("clock.camera");
        /// Camera clock's offset at the start: an image stamped t was taken at t plus this on the inertial unit's clock.
        camera_clock_offset: f64 = 0.0, unit("s"), range(-1.0..=1.0), name("clock.camera_offset");
        /// Climber clock against the camera's where they are not one (1 sigma); 0 takes them as one for certain.
        climber_clock: f64 = 0.05, unit("s"), range(0.0..=0.2), name("clock.climber");
        /// Probability at the start that climber and camera have one clock.
        climber_clock_tied: f64 = 0.5, range(0.0..=1.0), name("clock.climber_tied");
        /// Velocity of a platform at rest for the zero-motion update (1 sigma); 0 switches it off.
        rest_velocity: f64 = 0.002, unit("m/s"), range(0.0..=1.0);
        /// Position uncertainty (1 sigma) beyond which the estimate is called lost.
        lost_position: f64 = 0.2, unit("m"), range(0.001..=100.0);
        /// Rope from the climber's attachment to the platform's, which counts while no marker is seen; 0: nothing is assumed.
        rope_length: f64 = 0.0, unit("m"), range(0.0..=100.0), name("pendulum.rope_length");
        /// Uncertainty of it (1 sigma) until the images have told it.
        rope_sigma: f64 = 0.02, unit("m"), range(1e-4..=10.0), name("pendulum.rope_sigma");
        /// What pushes the platform across the rope at least, each axis (1 sigma).
        side_force: f64 = 0.1, unit("m/s^2"), range(1e-3..=10.0), name("pendulum.side_force");
        /// Upper end of the rope in the climber's frame: x, y, z.
        climber_attachment: Vec<f64> = &[0.0, 0.0, 0.0], unit("m"), range(-100.0..=100.0), name("pendulum.climber_attachment");
        /// Lower end of the rope in the volant frame: x, y, z.
        platform_attachment: Vec<f64> = &[0.0, 0.0, 0.0], unit("m"), range(-100.0..=100.0), name("pendulum.platform_attachment");
        /// R/Q of the published filter.
        paper_ratio: f64 = 10.0, range(1e-6..=1e6), name("paper.ratio");
        /// Threshold control of the published filter.
        paper_velocity_threshold: f64 = 1e-5, unit("m/s"), range(0.0..=1.0), name("paper.velocity_threshold");
        /// Takes the published filter's inertial velocity from the fused poses.
        paper_velocity_from_fused: bool = false, name("paper.velocity_from_fused");
        /// Where ~/save_checkpoint writes what the filter knows and ~/load_checkpoint reads it; empty: nowhere.
        checkpoint_file: String = "";
        /// Publish world -> volant on /tf.
        publish_tf: bool = true;
        /// Publish what became of each marker on volant/marker_updates.
        publish_marker_updates: bool = true;
        /// Without inertial samples or used images for so long the diagnostics say so.
        silence_timeout: f64 = 0.5, unit("s"), range(0.01..=60.0);
    }
    check(p) { p.config().map(|_| ()) }
}

impl FusionParameters {
    /// As the core wants them.
    ///
    /// # Errors
    /// A place that is not three numbers.
    pub fn config(&self) -> Result<FusionConfig, String> {
        let place = |name: &str, numbers: &[f64]| match *numbers {
            [x, y, z] => Ok(Vector3::new(x, y, z)),
            _ => Err(format!("{name} has {} numbers, not three: x, y, z", numbers.len())),
        };
        Ok(FusionConfig {
            model: if self.model == "paper" { Model::Paper } else { Model::Tight },
            tight: TightConfig {
                gravity: self.gravity,
                history: self.history,
                accelerometer_bias: self.accelerometer_bias,
                accelerometer_bias_walk: self.accelerometer_bias_walk,
                gyroscope_bias: self.gyroscope_bias,
                gyroscope_bias_walk: self.gyroscope_bias_walk,
                pixel_floor: self.pixel_floor,
                pixel_systematic: self.pixel_systematic,
                marker_gate: self.marker_gate,
                lock_out_images: self.lock_out_images,
                climber_quantum: self.climber_quantum,
                climber_turn_quantum: self.climber_turn_quantum,
                climber_jerk: self.climber_jerk,
                climber_turn_jerk: self.climber_turn_jerk,
                camera_clock: self.camera_clock,
                camera_clock_offset: self.camera_clock_offset,
                climber_clock: self.climber_clock,
                climber_clock_tied: self.climber_clock_tied,
                rest_velocity: self.rest_velocity,
                lost_position: self.lost_position,
                pendulum: PendulumConfig {
                    rope_length: self.rope_length,
                    rope_sigma: self.rope_sigma,
                    side_force: self.side_force,
                    climber_attachment: place("pendulum.climber_attachment", &self.climber_attachment)?,
                    platform_attachment: place("pendulum.platform_attachment", &self.platform_attachment)?,
                },
                ..TightConfig::default()
            },
            paper: PaperConfig {
                ratio: self.paper_ratio,
                gravity: self.gravity,
                velocity_threshold: self.paper_velocity_threshold,
                velocity_from_fused: self.paper_velocity_from_fused,
                ..PaperConfig::default()
            },
        })
    }
}

/// The node.
pub struct FusionNode {
    fusion: Fusion,
    frames: Frames,
    parameters: FusionParameters,
    odometry: Publisher<nav_msgs::msg::Odometry>,
    fused_pose: Publisher<PoseWithCovarianceStamped>,
    visual_pose: Publisher<PoseWithCovarianceStamped>,
    updates: Option<Publisher<MarkerUpdates>>,
    gathered: messages::Gathered,
    rejected_before: u64,
    camera_refused: Option<String>,
    refusals: Refusals,
}

/// Inputs that the filter refused since the last tick, and why the newest was.
#[derive(Debug, Default)]
struct Refusals {
    count: u64,
    newest: String,
}

impl Refusals {
    fn note(&mut self, warning: &Warning) {
        if matches!(warning, Warning::Ahead { .. } | Warning::TooOld { .. } | Warning::NotFinite { .. }) {
            self.count += 1;
            self.newest = warning.to_string();
        }
    }

    /// Adds them to what the last second was.
    fn tell(&mut self, health: Health, message: String) -> (Health, String) {
        let Self { count, newest } = std::mem::take(self);
        if count == 0 {
            return (health, message);
        }
        let told = format!("{message}; {count} inputs of the last second were refused, at last: {newest}");
        (health.max(Health::Warn), told)
    }
}

/// What comes to the node.
pub enum Event {
    /// An input of the filter.
    Input(Box<Input>),
    /// Something that an operator asks.
    Request(Request),
    /// A message that cannot be used, and why.
    Refused(String),
}

fn input(input: Input) -> Option<Event> {
    Some(Event::Input(Box::new(input)))
}

impl NodeShell for FusionNode {
    const NAME: &'static str = "pose_fusion";
    const ABOUT: &'static str =
        "markers, inertial samples and the climber's transform in, the platform's pose out";
    type Parameters = FusionParameters;
    type Input = Event;

    fn start(kit: &mut Kit<Event>, parameters: FusionParameters) -> Result<Self, NodeError> {
        let rig = kit.rig()?;
        let frames = rig.frames.clone();
        let odometry = kit.advertise("volant/odometry", QosPreset::State)?;
        let fused_pose = kit.advertise("volant/fused_pose", QosPreset::State)?;
        let visual_pose = kit.advertise("volant/visual_pose", QosPreset::State)?;
        let updates = if parameters.publish_marker_updates {
            Some(kit.advertise("volant/marker_updates", QosPreset::State)?)
        } else {
            None
        };
        kit.subscribe("volant/imu/data", QosPreset::Sensor, |m: Arc<sensor_msgs::msg::Imu>| {
            input(Input::Imu(convert::imu_sample(&m)))
        })?;
        kit.subscribe("climber/markers", QosPreset::Measurement, |m: Arc<MarkerObservations>| {
            match convert::marker_observations(&m) {
                Ok(markers) => input(Input::Markers(markers)),
                Err(error) => Some(Event::Refused(format!("climber/markers: {error}"))),
            }
        })?;
        let names = frames.clone();
        kit.subscribe("climber/transform", QosPreset::Measurement, move |m: Arc<TransformStamped>| {
            match convert::climber_sample(&m, &names) {
                Ok(sample) => input(Input::Climber(sample)),
                Err(error) => Some(Event::Refused(format!("climber/transform: {error}"))),
            }
        })?;
        kit.subscribe(
            "climber/camera/camera_info",
            QosPreset::Sensor,
            |m: Arc<sensor_msgs::msg::CameraInfo>| match convert::camera_model(&m) {
                Ok(camera) => input(Input::Camera(camera)),
                Err(error) => Some(Event::Refused(error.to_string())),
            },
        )?;
        services::offer(kit, &frames)?;
        Ok(Self {
            fusion: Fusion::new(rig, parameters.config().map_err(NodeError::shell)?),
            frames,
            parameters,
            odometry,
            fused_pose,
            visual_pose,
            updates,
            gathered: messages::Gathered::default(),
            rejected_before: 0,
            camera_refused: None,
            refusals: Refusals::default(),
        })
    }

    fn handle(&mut self, kit: &mut Kit<Event>, event: Event) {
        match event {
            Event::Input(input) => {
                if matches!(*input, Input::Camera(_)) {
                    self.camera_refused = None;
                }
                self.fusion.handle(*input);
            }
            Event::Request(request) => {
                let done = services::answer(&mut self.fusion, request, &self.parameters.checkpoint_file);
                if let Err(why) = done {
                    kit.log_throttled(Level::Warn, "refused", &why);
                }
            }
            Event::Refused(why) => {
                kit.log_throttled(Level::Warn, "refused", &why);
                if why.starts_with("camera_info") {
                    self.camera_refused = Some(why);
                }
            }
        }
        while let Some(output) = self.fusion.poll() {
            match output {
                Output::Odometry(o) => {
                    if self.parameters.publish_tf
                        && let Err(error) = kit.send_transform(messages::transform(&o, &self.frames))
                    {
                        kit.log_throttled(Level::Error, "tf", error.to_string());
                    }
                    self.odometry.publish(messages::odometry(&o, &self.frames));
                    self.fused_pose.publish(messages::fused_pose(&o, &self.frames));
                }
                Output::VisualPose(p) => self.visual_pose.publish(messages::visual_pose(&p, &self.frames)),
                Output::MarkerUpdate(record) => {
                    if let (Some(updates), Some(message)) =
                        (&self.updates, self.gathered.add(record, &self.frames))
                    {
                        updates.publish_shared(message);
                    }
                }
                Output::Warning(warning) => {
                    self.refusals.note(&warning);
                    let level = match warning {
                        Warning::Initialised { .. } => Level::Info,
                        Warning::Diverged { .. } => Level::Error,
                        _ => Level::Warn,
                    };
                    kit.log_throttled(level, warning.kind(), warning.to_string());
                }
            }
        }
    }

    fn tick(&mut self, kit: &mut Kit<Event>) {
        let s = self.fusion.status();
        let now: Stamp = kit.now();
        let age = |stamp: Option<Stamp>| stamp.map_or(f64::INFINITY, |s| now.seconds_since(s));
        let (imu_age, image_age) = (age(s.newest_imu), age(s.last_used_image));
        let rejected = s.rejected_markers - self.rejected_before.min(s.rejected_markers);
        self.rejected_before = s.rejected_markers;
        let limit = self.parameters.silence_timeout;
        let tight = self.parameters.model == "tight";
        let (health, message) = if let Some(why) = &self.camera_refused {
            (Health::Error, why.clone())
        } else if !tight {
            (Health::Ok, "the published filter runs".to_owned())
        } else if !s.initialised {
            (
                Health::Warn,
                "not initialised: needs three markers, inertial samples, the climber and camera_info"
                    .to_owned(),
            )
        } else if imu_age > limit {
            (Health::Error, format!("no inertial sample for {imu_age:.1} s"))
        } else if s.lost {
            (
                Health::Error,
                format!(
                    "lost: no marker used for {image_age:.1} s, position within {:.2} m",
                    s.position_sigma
                ),
            )
        } else if image_age > limit {
            (
                Health::Warn,
                format!("no marker used for {image_age:.1} s, position within {:.3} m", s.position_sigma),
            )
        } else if rejected > 0 {
            (Health::Warn, format!("{rejected} markers rejected in the last second"))
        } else {
            (Health::Ok, "fusing".to_owned())
        };
        // Without inertial samples everything else is ahead of them, and that is no fault of the clocks.
        if imu_age > limit {
            self.refusals = Refusals::default();
        }
        let (health, message) = self.refusals.tell(health, message);
        let values = [
            ("position sigma (m)", format!("{:.5}", s.position_sigma)),
            ("markers used", s.used_markers.to_string()),
            ("markers rejected", s.rejected_markers.to_string()),
            ("restarts from contradicting markers", s.recoveries.to_string()),
            ("inertial samples refused", s.refused_imu.to_string()),
            ("inertial samples late", s.late_imu.to_string()),
            ("inertial gaps", s.gaps.to_string()),
            ("images refused", s.refused_images.to_string()),
            ("climber samples refused", s.refused_climber.to_string()),
            ("duplicates", s.duplicates.to_string()),
            ("jumps of time", s.time_jumps.to_string()),
            (
                "camera clock (ms)",
                format!("{:.2} +- {:.2}", s.camera_clock_offset * 1e3, s.camera_clock_sigma * 1e3),
            ),
            (
                "climber clock against the camera's (ms)",
                format!("{:.2} +- {:.2}", s.climber_clock_offset * 1e3, s.climber_clock_sigma * 1e3),
            ),
            ("one clock for camera and climber (probability)", format!("{:.3}", s.climber_clock_tied)),
            ("accelerometer noise density", format!("{:.5}", s.accelerometer_noise_density)),
            ("gyroscope noise density", format!("{:.6}", s.gyroscope_noise_density)),
            ("pixel noise factor", format!("{:.2}", s.pixel_noise_factor)),
            (
                "rope (m)",
                s.rope.map_or("none".to_owned(), |r| {
                    format!("{:.4} +- {:.4}", r.length, (r.length_variance + r.stretch_variance).sqrt())
                }),
            ),
            (
                "force across the rope (m/s^2)",
                s.rope.map_or("none".to_owned(), |r| format!("{:.3}", r.side_variance.sqrt())),
            ),
        ];
        kit.diagnose("filter", health, &message, &values);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_parameters_the_node_is_set_as_the_core_is() {
        assert_eq!(FusionParameters::default().config().unwrap(), FusionConfig::default());
    }

    #[test]
    fn a_place_is_three_numbers() {
        let parameters =
            FusionParameters { platform_attachment: vec![0.0, 0.1, 0.2, 0.3], ..FusionParameters::default() };
        let why = parameters.config().unwrap_err();
        assert!(why.contains("pendulum.platform_attachment has 4 numbers"), "{why}");
    }
}
