//! Configuration of the core: joint names, calibration, plausibility limits.

use std::fmt;

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
    /// All three axes, in the order of [`ClimberConfig::joints`].
    pub const ALL: [Axis; 3] = [Axis::RailX, Axis::RailY, Axis::Turn];

    /// Name of the axis in `max_speed.*` and `uncertainty.*`, which the two rails share.
    pub const fn limit_name(self) -> &'static str {
        match self {
            Axis::RailX | Axis::RailY => "position",
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

/// Name of the axis in the parameters.
impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Axis::RailX => "rail_x",
            Axis::RailY => "rail_y",
            Axis::Turn => "turn",
        })
    }
}

/// Calibration of one joint: `axis = scale · (reading − zero)`.
#[derive(Clone, Debug, PartialEq)]
pub struct JointCalibration {
    /// The joint's name in `sensor_msgs/JointState`; empty where the climber does not have this
    /// axis, which is 0 then.
    pub name: String,
    /// Meters (radians for `turn`) per unit of the reading; negative if it counts backwards.
    pub scale: f64,
    /// Reading at the world's origin, in units of the reading.
    pub zero: f64,
    /// Standard deviation of the measured axis, m (rad): quantization, backlash.
    pub uncertainty: f64,
    /// Speed limit of the axis, m/s (rad/s); a faster change is rejected as a jump.
    pub max_speed: f64,
}

ros_parameters::parameters! {
    /// Configuration of [`crate::Climber`]; each row is a parameter of the node.
    #[derive(PartialEq)]
    pub struct ClimberConfig {
        /// Height of the climber's frame above the world's origin: measure it with a tape, or run
        /// `volant calibrate climber --platform X,Y,Z`.
        height: f64 = 0.0, required, unit("m"), range(-100.0..=100.0), live;
        /// Maximum age of a reading on receipt; an older one is rejected.
        max_age: f64 = 0.5, unit("s"), range(0.001..=60.0), live;
        /// Maximum time from receipt to a later stamp; a reading further ahead is rejected.
        max_ahead: f64 = 0.5, unit("s"), range(0.001..=60.0), live;
        /// Time without an accepted reading after which the diagnostics report an error.
        silence_timeout: f64 = 0.5, unit("s"), range(0.01..=60.0), live;
        /// Number of consecutive readings that must be consistent with each other before they are
        /// accepted after a jump (the encoders were re-zeroed).
        jump_patience: u32 = 25, range(2..=100000), live;
        plain {
            /// One calibration per axis, in the order of [`Axis::ALL`].
            joints: [JointCalibration; 3] = Axis::ALL.map(JointCalibration::of);
        }
    }
}

impl JointCalibration {
    /// Returns the default of an axis: readings in its unit, and its own name.
    fn of(axis: Axis) -> Self {
        Self {
            name: axis.to_string(),
            scale: 1.0,
            zero: 0.0,
            uncertainty: 0.001,
            max_speed: if axis == Axis::Turn { 3.0 } else { 2.0 },
        }
    }
}

impl ClimberConfig {
    /// Checks joint names, scales and zeros; the declaration of the node's parameters limits the
    /// other values.
    ///
    /// # Errors
    /// The first invalid parameter, its value and the valid ones.
    pub fn validate(&self) -> Result<(), String> {
        if self.joints.iter().all(|joint| joint.name.is_empty()) {
            let mistake = "the parameters `joints.rail_x`, `joints.rail_y` and `joints.turn` are all \
                           empty; name the joints of joint_states that the climber has";
            return Err(mistake.to_owned());
        }
        for (i, axis) in Axis::ALL.into_iter().enumerate() {
            let joint = &self.joints[i];
            let (name, scale, zero) = (&joint.name, joint.scale, joint.zero);
            let shared =
                (self.joints[..i].iter()).position(|other| !name.is_empty() && other.name == *name);
            let mistake = if let Some(j) = shared {
                format!(
                    "the parameters `joints.{}` and `joints.{axis}` are both `{name}`; name a \
                     different joint for each axis",
                    Axis::ALL[j]
                )
            } else if !scale.is_finite() || scale == 0.0 {
                format!(
                    "the parameter `scale.{axis}` is {scale}; it must be a finite number other \
                     than zero"
                )
            } else if !zero.is_finite() {
                format!("the parameter `zero.{axis}` is {zero}; it must be a finite number")
            } else {
                continue;
            };
            return Err(mistake);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_each_error_names_its_parameter() {
        assert_eq!(ClimberConfig::default().validate(), Ok(()));
        type Fault = fn(&mut ClimberConfig);
        let mistakes: [(&str, Fault); 4] = [
            ("scale.rail_y", |c| c.joints[1].scale = 0.0),
            ("zero.turn", |c| c.joints[2].zero = f64::NAN),
            ("`joints.rail_y` and `joints.turn` are all empty", |c| {
                c.joints.iter_mut().for_each(|joint| joint.name.clear())
            }),
            ("`joints.rail_x` and `joints.turn` are both `rail_x`", |c| {
                c.joints[2].name = "rail_x".into()
            }),
        ];
        for (expected, inject) in mistakes {
            let mut config = ClimberConfig::default();
            inject(&mut config);
            let error = config.validate().unwrap_err();
            assert!(error.contains(expected), "{expected}: {error}");
        }
    }
}
