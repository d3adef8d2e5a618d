//! ROS 2 node: `climber/joint_states` → `climber/transform`, `/tf`, `/tf_static`, `/diagnostics`.

use crate::{Climber, ClimberConfig, JointCalibration, Output, Warning};
use node_kit::{
    Level, convert,
    node::{Health, NodeContext, NodeError, NodeShell, Publisher},
    qos::QosPreset,
};
use rig_model::{Frames, JointReading, Stamp, topics};
use volant_msgs::{geometry_msgs::msg::TransformStamped, sensor_msgs::msg::JointState};

node_kit::parameters! {
    /// Parameters of the node `climber_driver`, one field each.
    pub struct ClimberParameters {
        /// Name of the joint that measures the position along the world's x; empty ("") where the
        /// climber does not move along it.
        joint_x: String = "rail_x", name("joints.rail_x");
        /// Name of the joint that measures the position along the world's y, or empty.
        joint_y: String = "rail_y", name("joints.rail_y");
        /// Name of the joint that measures the rotation about the vertical, or empty.
        joint_turn: String = "turn", name("joints.turn");
        /// Meters per unit of the reading: axis = scale * (reading - zero); negative if the joint
        /// counts backwards.
        scale_x: f64 = 1.0, name("scale.rail_x"), live;
        /// Meters per unit of the reading.
        scale_y: f64 = 1.0, name("scale.rail_y"), live;
        /// Radians per unit of the reading.
        scale_turn: f64 = 1.0, name("scale.turn"), live;
        /// Reading at the world's origin.
        zero_x: f64 = 0.0, name("zero.rail_x"), live;
        /// Reading at the world's origin.
        zero_y: f64 = 0.0, name("zero.rail_y"), live;
        /// Reading at which the climber's x axis is parallel to the world's.
        zero_turn: f64 = 0.0, name("zero.turn"), live;
        /// Standard deviation of the encoders on x and y; the jump check allows three standard
        /// deviations of the difference of two readings on top of the speed limit.
        uncertainty: f64 = 0.001,
            unit("m"), range(0.0..=1.0), name("uncertainty.position"), live;
        /// Standard deviation of the encoder of the rotation.
        uncertainty_turn: f64 = 0.001,
            unit("rad"), range(0.0..=1.0), name("uncertainty.turn"), live;
        /// Speed limit along x and y; a faster change is rejected.
        max_speed: f64 = 2.0,
            unit("m/s"), range(0.001..=100.0), name("max_speed.position"), live;
        /// Limit of the rotation rate; a faster change is rejected.
        max_speed_turn: f64 = 3.0,
            unit("rad/s"), range(0.001..=100.0), name("max_speed.turn"), live;
        /// Publish climber -> camera_optical on /tf_static; false if robot_state_publisher does.
        publish_static_tf: bool = true;
        /// Publish world -> climber on /tf.
        publish_tf: bool = true;
        groups {
            /// Configuration of the core, without the joints.
            core: ClimberConfig;
        }
    }
    check(p) { p.config().validate() }
}

impl ClimberParameters {
    /// Configuration of the core with these values.
    pub fn config(&self) -> ClimberConfig {
        let joint = |name: &String, scale, zero, uncertainty, max_speed| JointCalibration {
            name: name.clone(),
            scale,
            zero,
            uncertainty,
            max_speed,
        };
        ClimberConfig {
            joints: [
                joint(&self.joint_x, self.scale_x, self.zero_x, self.uncertainty, self.max_speed),
                joint(&self.joint_y, self.scale_y, self.zero_y, self.uncertainty, self.max_speed),
                joint(
                    &self.joint_turn,
                    self.scale_turn,
                    self.zero_turn,
                    self.uncertainty_turn,
                    self.max_speed_turn,
                ),
            ],
            ..self.core.clone()
        }
    }
}

/// A reading with its time of receipt.
pub type Received = (JointReading, Stamp);

/// Shell of the node `climber_driver`.
pub struct ClimberNode {
    climber: Climber,
    frames: Frames,
    publish_tf: bool,
    transform: Publisher<TransformStamped>,
    /// Number of rejections at the last tick.
    rejected_before: u64,
    last_rejection: String,
}

impl NodeShell for ClimberNode {
    const NAME: &'static str = "climber_driver";
    const ABOUT: &'static str = "encoder readings of the climber to the transform world -> climber";
    type Parameters = ClimberParameters;
    type Input = Received;

    fn start(
        context: &mut NodeContext<Received>,
        parameters: ClimberParameters,
    ) -> Result<Self, NodeError> {
        let rig = context.rig()?;
        let climber = Climber::new(parameters.config()).map_err(NodeError::shell)?;
        let transform = context.advertise(topics::CLIMBER_TRANSFORM, QosPreset::Measurement)?;
        if parameters.publish_tf {
            context.advertise_transforms()?;
        }
        if parameters.publish_static_tf {
            let transform = convert::transform_message(
                &rig.frames.climber,
                &rig.frames.camera,
                context.now(),
                &rig.climber_from_camera,
            );
            context.send_static_transform(transform)?;
        }
        let clock = context.clock();
        context.subscribe(
            topics::JOINT_STATES,
            QosPreset::State,
            move |message: std::sync::Arc<JointState>| {
                Some((convert::joint_reading(&message), clock.now()))
            },
        )?;
        Ok(Self {
            climber,
            frames: rig.frames,
            publish_tf: parameters.publish_tf,
            transform,
            rejected_before: 0,
            last_rejection: String::new(),
        })
    }

    fn handle(&mut self, context: &mut NodeContext<Received>, (reading, received): Received) {
        self.climber.handle(&reading, received);
        while let Some(output) = self.climber.poll() {
            match output {
                Output::Sample(sample) => {
                    let message = convert::climber_message(&sample, &self.frames);
                    if self.publish_tf
                        && let Err(error) = context.send_transform(message.clone())
                    {
                        context.log_throttled(Level::Error, "tf", error.to_string());
                    }
                    self.transform.publish(message);
                }
                Output::Warning(warning) => {
                    let text = warning.to_string();
                    if matches!(warning, Warning::Rejected { .. }) {
                        context.log_throttled(Level::Warn, warning.kind(), &text);
                        self.last_rejection = text;
                    } else {
                        context.log(Level::Warn, text);
                    }
                }
            }
        }
    }

    fn tick(&mut self, context: &mut NodeContext<Received>) {
        let counts = self.climber.counts();
        let rejected: u64 = counts.rejected.values().sum();
        let mut values = vec![("accepted", counts.accepted.to_string())];
        values.extend(counts.rejected.iter().map(|(kind, n)| (*kind, n.to_string())));
        values.push(("messages of other joints", counts.foreign.to_string()));
        let new = rejected - self.rejected_before;
        let why = if new == 0 {
            String::new()
        } else {
            format!("; {new} readings rejected in the last second, last: {}", self.last_rejection)
        };
        let silence = self.climber.silent_for(context.now());
        let (health, message) = summary(silence, &why);
        self.rejected_before = rejected;
        context.diagnose("encoders", health, &message, &values);
    }

    fn parameters_changed(
        &mut self,
        _context: &mut NodeContext<Received>,
        parameters: &ClimberParameters,
    ) -> Result<(), String> {
        self.climber.set_config(parameters.config())
    }
}

/// Health and message of the diagnostics.
///
/// `silence`: as [`Climber::silent_for`]; `why`: rejections of the last second, or empty.
fn summary(silence: Option<f64>, why: &str) -> (Health, String) {
    match silence {
        Some(seconds) if seconds.is_finite() => {
            (Health::Error, format!("no reading was accepted for {seconds:.1} s{why}"))
        }
        Some(_) => (
            Health::Error,
            format!(
                "no reading was accepted yet; check the publisher of climber/joint_states{why}"
            ),
        ),
        None if !why.is_empty() => (Health::Warn, format!("readings are received{why}")),
        None => (Health::Ok, "readings are received".to_owned()),
    }
}
