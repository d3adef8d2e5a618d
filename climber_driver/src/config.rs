//! What must be known of the crane: which joints, how their readings become metres and radians, what is plausible.

use std::fmt;
use thiserror::Error;

/// One of the climber's three degrees of freedom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[repr(u8)]
pub enum Axis {
    /// Along the world's x, m.
    RailX = 0,
    /// Along the world's y, m.
    RailY = 1,
    /// About the world's z, rad.
    Turn = 2,
}

impl Axis {
    /// All three in the order of the arrays here.
    pub const ALL: [Axis; 3] = [Axis::RailX, Axis::RailY, Axis::Turn];

    /// Name, as in the parameters.
    pub const fn name(self) -> &'static str {
        match self {
            Axis::RailX => "rail_x",
            Axis::RailY => "rail_y",
            Axis::Turn => "turn",
        }
    }

    /// Unit of the axis after scaling.
    pub const fn unit(self) -> &'static str {
        match self {
            Axis::RailX | Axis::RailY => "m",
            Axis::Turn => "rad",
        }
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// From a joint's reading to its axis: `axis = scale · (reading − zero)`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointCalibration {
    /// The joint's name in `sensor_msgs/JointState`.
    pub name: String,
    /// Metres (radians for the turn) per unit of the reading; negative where the joint counts backwards.
    pub scale: f64,
    /// The reading at the world's origin, in units of the reading.
    pub zero: f64,
    /// One standard deviation of the axis as measured, m (rad): quantisation, backlash.
    pub uncertainty: f64,
    /// Faster than this, m/s (rad/s), the axis cannot move.
    pub max_speed: f64,
}

/// Everything that the core must be told.
#[derive(Clone, Debug, PartialEq)]
pub struct ClimberConfig {
    /// One per [`Axis`], in its order.
    pub joints: [JointCalibration; 3],
    /// Height of the climber's origin above the world's, m.
    pub height: f64,
    /// A reading that is older than this when it is received is stale, s.
    pub max_age: f64,
    /// A reading stamped further ahead of its receipt than this is refused, s.
    pub max_ahead: f64,
    /// Without an accepted reading for so long, the climber counts as silent, s.
    pub silence_timeout: f64,
    /// After a jump, so many readings in a row that agree with each other are believed: the encoders were re-zeroed.
    pub jump_patience: u32,
}

impl Default for ClimberConfig {
    fn default() -> Self {
        let joint = |axis: Axis, uncertainty, max_speed| JointCalibration {
            name: axis.name().to_owned(),
            scale: 1.0,
            zero: 0.0,
            uncertainty,
            max_speed,
        };
        Self {
            joints: [
                joint(Axis::RailX, 0.001, 2.0),
                joint(Axis::RailY, 0.001, 2.0),
                joint(Axis::Turn, 0.001, 3.0),
            ],
            height: 0.0,
            max_age: 0.5,
            max_ahead: 0.5,
            silence_timeout: 0.5,
            jump_patience: 25,
        }
    }
}

/// A configuration that cannot be.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ConfigError {
    /// A number out of its range.
    #[error("the parameter `{name}` is {value}, but {requirement}")]
    Value {
        /// The parameter.
        name: String,
        /// Its value.
        value: f64,
        /// What holds for such values.
        requirement: &'static str,
    },
    /// Two axes read one joint, or one reads none.
    #[error("the joint `{joint}` is named for {first} and for {second}; each axis takes a joint of its own")]
    SharedJoint {
        /// The joint's name.
        joint: String,
        /// One axis.
        first: Axis,
        /// The other.
        second: Axis,
    },
    /// An axis without a joint name.
    #[error("the parameter `joints.{axis}` is empty; name the joint in joint_states that tells this axis")]
    NoJoint {
        /// The axis.
        axis: Axis,
    },
}

impl ClimberConfig {
    /// Checks every value.
    ///
    /// # Errors
    /// The first value that cannot be, by the parameter's name.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let check = |ok: bool, name: String, value: f64, requirement: &'static str| {
            if ok { Ok(()) } else { Err(ConfigError::Value { name, value, requirement }) }
        };
        for (i, axis) in Axis::ALL.into_iter().enumerate() {
            let joint = &self.joints[i];
            if joint.name.is_empty() {
                return Err(ConfigError::NoJoint { axis });
            }
            if let Some(j) = self.joints[..i].iter().position(|other| other.name == joint.name) {
                return Err(ConfigError::SharedJoint {
                    joint: joint.name.clone(),
                    first: Axis::ALL[j],
                    second: axis,
                });
            }
            let positive = |x: f64| x.is_finite() && x > 0.0;
            check(
                joint.scale.is_finite() && joint.scale != 0.0,
                format!("scale.{axis}"),
                joint.scale,
                "it must be a finite number other than zero",
            )?;
            check(joint.zero.is_finite(), format!("zero.{axis}"), joint.zero, "it must be a finite number")?;
            check(
                joint.uncertainty.is_finite() && joint.uncertainty >= 0.0,
                format!("uncertainty.{axis}"),
                joint.uncertainty,
                "it must not be negative",
            )?;
            check(
                positive(joint.max_speed),
                format!("max_speed.{axis}"),
                joint.max_speed,
                "it must be greater than zero",
            )?;
        }
        check(
            self.height.is_finite() && self.height.abs() <= 100.0,
            "height".into(),
            self.height,
            "it is in metres and below 100 m",
        )?;
        for (name, value) in [
            ("max_age", self.max_age),
            ("max_ahead", self.max_ahead),
            ("silence_timeout", self.silence_timeout),
        ] {
            check(value.is_finite() && value > 0.0, name.into(), value, "it must be greater than zero")?;
        }
        check(
            self.jump_patience >= 2,
            "jump_patience".into(),
            f64::from(self.jump_patience),
            "at least two readings are needed to agree",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_defaults_are_valid_and_each_mistake_names_its_parameter() {
        assert_eq!(ClimberConfig::default().validate(), Ok(()));
        type Spoil = fn(&mut ClimberConfig);
        let mistakes: [(&str, Spoil); 9] = [
            ("scale.rail_y", |c| c.joints[1].scale = 0.0),
            ("zero.turn", |c| c.joints[2].zero = f64::NAN),
            ("uncertainty.rail_x", |c| c.joints[0].uncertainty = -1.0),
            ("max_speed.rail_x", |c| c.joints[0].max_speed = 0.0),
            ("height", |c| c.height = 2800.0),
            ("max_age", |c| c.max_age = f64::NAN),
            ("jump_patience", |c| c.jump_patience = 1),
            ("joints.turn", |c| c.joints[2].name.clear()),
            ("`rail_x` is named for rail_x and for turn", |c| c.joints[2].name = "rail_x".into()),
        ];
        for (expected, spoil) in mistakes {
            let mut config = ClimberConfig::default();
            spoil(&mut config);
            let error = config.validate().unwrap_err().to_string();
            assert!(error.contains(expected), "{expected}: {error}");
        }
    }
}
