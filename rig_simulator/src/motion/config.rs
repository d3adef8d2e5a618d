//! Parameters of a motion.

/// Parameters of a motion. One flat struct, so that a test changes single fields by struct update.
#[derive(Clone, Debug, PartialEq)]
pub struct MotionConfig {
    /// Everything random follows from it.
    pub seed: u64,
    /// How long the run is, s.
    pub duration: f64,
    /// The rig is stationary until then, s; the motion starts smoothly.
    pub still_until: f64,
    /// The rig is stationary again from then on, s, at its first pose; the motion fades out before.
    pub still_from: f64,
    /// Duration of the motion's start and end, s. With a short one the climber moves abruptly.
    pub ramp: f64,
    /// Largest tilt by the swing, rad.
    pub swing: f64,
    /// How often it swings, Hz; the rope that belongs to it has the length g/(2πf)².
    pub frequency: f64,
    /// Largest tilt beside the swing (against the rope), rad.
    pub wobble: f64,
    /// Largest yaw against the climber, rad.
    pub yaw: f64,
    /// Largest speed of the climber in x and in y, m/s.
    pub climber_speed: f64,
    /// Largest rate at which the climber turns, rad/s.
    pub climber_turn_rate: f64,
    /// Height of the climber's frame above the world's origin, m.
    pub climber_height: f64,
    /// Height of the stationary platform, m.
    pub platform_height: f64,
    /// The platform swings freely as a spherical pendulum below the climber; else the swing is
    /// prescribed as the sum of two sines.
    pub free: bool,
}

impl MotionConfig {
    /// A calm swing below a driving climber.
    pub fn nominal(seed: u64) -> Self {
        Self {
            seed,
            duration: 12.0,
            still_until: -10.0,
            still_from: f64::INFINITY,
            ramp: 1.0,
            swing: 0.14,
            frequency: 0.45,
            wobble: 0.06,
            yaw: 0.4,
            climber_speed: 0.3,
            climber_turn_rate: 0.15,
            climber_height: 2.8,
            platform_height: 1.35,
            free: false,
        }
    }

    /// Up to 35° of tilt at about 1 Hz.
    pub fn fast_swing(seed: u64) -> Self {
        Self { swing: 0.55, frequency: 1.0, ..Self::nominal(seed) }
    }

    /// Nothing moves.
    pub fn rest(seed: u64) -> Self {
        Self {
            swing: 0.0,
            wobble: 0.0,
            yaw: 0.0,
            climber_speed: 0.0,
            climber_turn_rate: 0.0,
            ..Self::nominal(seed)
        }
    }
}
