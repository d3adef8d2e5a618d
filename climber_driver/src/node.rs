//! The shell: `climber/joint_states` in, `climber/transform`, `/tf` and `/tf_static` out.

use crate::{Climber, ClimberConfig, JointCalibration, JointReading, Output, Warning};
use node_kit::{
    Level, convert,
    node::{Health, Kit, NodeError, NodeShell, Publisher},
    qos::QosPreset,
};
use rig_model::{Frames, Stamp};
use volant_msgs::{geometry_msgs::msg::TransformStamped, sensor_msgs::msg::JointState};

node_kit::parameters! {
    /// Parameters of the climber's node.
    pub struct ClimberParameters {
        /// Name of the joint that tells the way along the world's x.
        joint_x: String = "rail_x", name("joints.rail_x");
        /// Name of the joint that tells the way along the world's y.
        joint_y: String = "rail_y", name("joints.rail_y");
        /// Name of the joint that tells the turn about the vertical.
        joint_turn: String = "turn", name("joints.turn");
        /// Metres per unit of the reading: axis = scale * (reading - zero); negative where the joint counts backwards.
        scale_x: f64 = 1.0, name("scale.rail_x"), live;
        /// Metres per unit of the reading.
        scale_y: f64 = 1.0, name("scale.rail_y"), live;
        /// Radians per unit of the reading.
        scale_turn: f64 = 1.0, name("scale.turn"), live;
        /// Reading at the world's origin.
        zero_x: f64 = 0.0, name("zero.rail_x"), live;
        /// Reading at the world's origin.
        zero_y: f64 = 0.0, name("zero.rail_y"), live;
        /// Reading where the climber's x points along the world's.
        zero_turn: f64 = 0.0, name("zero.turn"), live;
        /// Height of the climber's frame above the world's origin.
        height: f64 = 0.0, unit("m"), range(-100.0..=100.0), live;
        /// Standard deviation of the encoder on x and y; three of them are allowed on top of the speed limit.
        uncertainty: f64 = 0.001, unit("m"), range(0.0..=1.0), name("uncertainty.position"), live;
        /// Standard deviation of the turn's encoder.
        uncertainty_turn: f64 = 0.001, unit("rad"), range(0.0..=1.0), name("uncertainty.turn"), live;
        /// Faster than this the climber cannot drive: a reading that says so is refused.
        max_speed: f64 = 2.0, unit("m/s"), range(0.001..=100.0), name("max_speed.position"), live;
        /// Faster than this the climber cannot turn.
        max_speed_turn: f64 = 3.0, unit("rad/s"), range(0.001..=100.0), name("max_speed.turn"), live;
        /// A reading that is older on arrival is refused.
        max_age: f64 = 0.5, unit("s"), range(0.001..=60.0), live;
        /// A reading stamped further ahead of its arrival is refused.
        max_ahead: f64 = 0.5, unit("s"), range(0.001..=60.0), live;
        /// Without an accepted reading for so long the diagnostics call the climber silent.
        silence_timeout: f64 = 0.5, unit("s"), range(0.01..=60.0), live;
        /// After a jump, so many readings that agree with each other are believed: the encoders were re-zeroed.
        jump_patience: u32 = 25, range(2..=100000), live;
        /// Publish climber -> camera_optical on /tf_static; false where robot_state_publisher does it.
        publish_static_tf: bool = true;
        /// Publish world -> climber on /tf.
        publish_tf: bool = true;
    }
    check(p) { p.config().validate().map_err(|e| e.to_string()) }
}

impl ClimberParameters {
    /// As the core wants them.
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
            height: self.height,
            max_age: self.max_age,
            max_ahead: self.max_ahead,
            silence_timeout: self.silence_timeout,
            jump_patience: self.jump_patience,
        }
    }
}

/// A message with when it came.
pub struct Received {
    reading: JointReading,
    at: Stamp,
}

/// The node.
pub struct ClimberNode {
    climber: Climber,
    frames: Frames,
    publish_tf: bool,
    transform: Publisher<TransformStamped>,
    /// Refusals at the last tick, to tell what is new.
    refused_before: u64,
    /// Why the newest of them was refused.
    last_refusal: String,
}

impl NodeShell for ClimberNode {
    const NAME: &'static str = "climber_driver";
    const ABOUT: &'static str = "the climber's encoder readings in, where the climber is out";
    type Parameters = ClimberParameters;
    type Input = Received;

    fn start(kit: &mut Kit<Received>, parameters: ClimberParameters) -> Result<Self, NodeError> {
        let rig = kit.rig()?;
        let climber = Climber::new(parameters.config()).map_err(|e| NodeError::shell(e.to_string()))?;
        let transform = kit.advertise("climber/transform", QosPreset::Measurement)?;
        if parameters.publish_static_tf {
            kit.send_static_transform(convert::transform_message(
                &rig.frames.climber,
                &rig.frames.camera,
                kit.now(),
                &rig.climber_from_camera,
            ))?;
        }
        let clock = kit.clock();
        kit.subscribe(
            "climber/joint_states",
            QosPreset::State,
            move |message: std::sync::Arc<JointState>| {
                Some(Received {
                    reading: JointReading {
                        stamp: convert::stamp(&message.header.stamp),
                        names: message.name.clone(),
                        positions: message.position.clone(),
                    },
                    at: clock.now(),
                })
            },
        )?;
        Ok(Self {
            climber,
            frames: rig.frames,
            publish_tf: parameters.publish_tf,
            transform,
            refused_before: 0,
            last_refusal: String::new(),
        })
    }

    fn handle(&mut self, kit: &mut Kit<Received>, input: Received) {
        self.climber.handle(&input.reading, input.at);
        while let Some(output) = self.climber.poll() {
            match output {
                Output::Sample(sample) => {
                    let message = convert::climber_message(&sample, &self.frames);
                    if self.publish_tf
                        && let Err(error) = kit.send_transform(message.clone())
                    {
                        kit.log_throttled(Level::Error, "tf", error.to_string());
                    }
                    self.transform.publish(message);
                }
                Output::Warning(warning) => {
                    if let Warning::Refused(refusal) = &warning {
                        self.last_refusal = refusal.to_string();
                    }
                    say(kit, &warning);
                }
            }
        }
    }

    fn tick(&mut self, kit: &mut Kit<Received>) {
        let counts = self.climber.counts();
        let refused: u64 = counts.refused.values().sum();
        let mut values = vec![("accepted", counts.accepted.to_string())];
        values.extend(counts.refused.iter().map(|(kind, n)| (*kind, n.to_string())));
        let new = refused - self.refused_before;
        let why = if new == 0 {
            String::new()
        } else {
            format!("; {new} readings refused in the last second, at last: {}", self.last_refusal)
        };
        let (health, message) = match self.climber.silent_for(kit.now()) {
            Some(seconds) if seconds.is_finite() => {
                (Health::Error, format!("no reading was accepted for {seconds:.1} s{why}"))
            }
            Some(_) => (Health::Error, format!("no reading was accepted yet{why}")),
            None if new > 0 => (Health::Warn, format!("readings flow{why}")),
            None => (Health::Ok, "readings flow".to_owned()),
        };
        self.refused_before = refused;
        kit.diagnose("encoders", health, &message, &values);
    }

    fn parameters_changed(
        &mut self,
        _kit: &mut Kit<Received>,
        parameters: &ClimberParameters,
    ) -> Result<(), String> {
        self.climber.set_config(parameters.config()).map_err(|e| e.to_string())
    }
}

fn say(kit: &mut Kit<Received>, warning: &Warning) {
    match warning {
        Warning::Refused(refusal) => kit.log_throttled(Level::Warn, refusal.kind(), refusal.to_string()),
        Warning::Relocated { change, refused } => {
            let [x, y, turn] = change;
            kit.log(
                Level::Warn,
                format!(
                    "the climber is believed to be elsewhere: {x:+.3} m, {y:+.3} m, {turn:+.4} rad, after {refused} refused \
                     readings that agreed with each other; if nobody re-zeroed the encoders, check them"
                ),
            );
        }
        Warning::TimeWentBack { seconds } => {
            kit.log(Level::Warn, format!("time went back by {seconds:.3} s: starting anew"));
        }
    }
}
