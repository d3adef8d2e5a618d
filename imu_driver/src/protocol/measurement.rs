//! What one data message says, in SI units, as the unit sent it: no frame is turned and nothing is made up.

/// In which global frame a unit gives its orientation and velocity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GlobalFrame {
    /// x east, y north, z up: the newer units' default.
    EastNorthUp,
    /// x north, y east, z down.
    NorthEastDown,
    /// x (magnetic) north, y west, z up: what a legacy unit means.
    NorthWestUp,
}

/// An attitude, global frame from sensor, in the form in which it was sent.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attitude {
    /// w, x, y, z.
    Quaternion([f64; 4]),
    /// Roll, pitch, yaw, **degrees** as sent.
    Euler([f64; 3]),
    /// The matrix global from sensor, column by column as sent.
    Matrix([f64; 9]),
}

/// An attitude with its global frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// The attitude.
    pub attitude: Attitude,
    /// Against what.
    pub frame: GlobalFrame,
}

/// Date and time of a unit with GNSS.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Utc {
    /// Nanoseconds of the second.
    pub nanosecond: u32,
    /// Year.
    pub year: u16,
    /// 1–12.
    pub month: u8,
    /// 1–31.
    pub day: u8,
    /// 0–23.
    pub hour: u8,
    /// 0–59.
    pub minute: u8,
    /// 0–59 (60 in a leap second).
    pub second: u8,
    /// Which of the fields are valid.
    pub flags: u8,
}

/// The status bits; a legacy unit and MTData2's short form send only the lowest eight.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Status(pub u32);

impl Status {
    /// The self-test at start-up was passed.
    pub const fn self_test_passed(self) -> bool {
        self.0 & 1 != 0
    }

    /// The orientation filter's output is valid.
    pub const fn filter_valid(self) -> bool {
        self.0 & 2 != 0
    }

    /// There is a GNSS fix.
    pub const fn gnss_fix(self) -> bool {
        self.0 & 4 != 0
    }

    /// Accelerometers (x, y, z in bits 0–2), gyroscopes (3–5), magnetometers (6–8) that clip.
    pub const fn clipping(self) -> u16 {
        ((self.0 >> 8) & 0x1FF) as u16
    }

    /// Any clipping at all.
    pub const fn any_clipping(self) -> bool {
        self.clipping() != 0 || self.0 & (1 << 19) != 0
    }
}

/// The readings of the analog-digital converter, uncalibrated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RawInertial {
    /// Accelerometers.
    pub acceleration: [u16; 3],
    /// Gyroscopes.
    pub angular_velocity: [u16; 3],
    /// Magnetometers.
    pub magnetic_field: [u16; 3],
    /// Temperature.
    pub temperature: u16,
}

/// Raw GPS data of an MTi-G, 44 bytes as they came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RawGps(pub [u8; 44]);

/// One data message, decoded. Vectors are in the unit's own axes unless said otherwise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurement {
    /// The message's own counter; wraps.
    pub counter: Option<u16>,
    /// Ticks of 0.1 ms; wraps.
    pub sample_time_fine: Option<u32>,
    /// Seconds.
    pub sample_time_coarse: Option<u32>,
    /// Date and time.
    pub utc: Option<Utc>,
    /// Specific force, m/s²: +9.81 up at rest.
    pub acceleration: Option<[f64; 3]>,
    /// The same, from the unit's faster path.
    pub acceleration_hr: Option<[f64; 3]>,
    /// Acceleration without gravity, m/s², in the global frame.
    pub free_acceleration: Option<[f64; 3]>,
    /// Velocity increment over one sample, m/s.
    pub delta_velocity: Option<[f64; 3]>,
    /// Rate of turn, rad/s.
    pub angular_velocity: Option<[f64; 3]>,
    /// The same, from the unit's faster path.
    pub angular_velocity_hr: Option<[f64; 3]>,
    /// Orientation increment over one sample, quaternion w, x, y, z.
    pub delta_orientation: Option<[f64; 4]>,
    /// Magnetic field in arbitrary units: the Earth's is about 1.
    pub magnetic_field: Option<[f64; 3]>,
    /// Attitude.
    pub orientation: Option<Orientation>,
    /// A second form of the attitude, where one message holds several.
    pub further_orientations: [Option<Orientation>; 2],
    /// °C.
    pub temperature: Option<f64>,
    /// Pa.
    pub pressure: Option<u32>,
    /// Status bits.
    pub status: Option<Status>,
    /// Analog inputs, as converted.
    pub analog: [Option<u16>; 2],
    /// Latitude and longitude, degrees.
    pub latitude_longitude: Option<[f64; 2]>,
    /// Height above the ellipsoid, m.
    pub altitude: Option<f64>,
    /// Earth-centred position, m.
    pub position_ecef: Option<[f64; 3]>,
    /// Velocity, m/s, in the global frame.
    pub velocity: Option<[f64; 3]>,
    /// Uncalibrated readings.
    pub raw: Option<RawInertial>,
    /// Raw GPS data.
    pub raw_gps: Option<RawGps>,
    /// The message holds GNSS receiver data (which are not decoded).
    pub has_gnss: bool,
}

impl Measurement {
    /// Whether the message carries inertial data. Only then do its counter and SampleTimeFine tell when a sample was
    /// taken: messages with GNSS data alone carry an unrelated time.
    pub fn is_inertial(&self) -> bool {
        self.acceleration.is_some()
            || self.acceleration_hr.is_some()
            || self.delta_velocity.is_some()
            || self.angular_velocity.is_some()
            || self.angular_velocity_hr.is_some()
            || self.delta_orientation.is_some()
            || self.magnetic_field.is_some()
            || self.orientation.is_some()
            || self.free_acceleration.is_some()
            || self.raw.is_some()
    }

    /// The quaternion w, x, y, z, if the message holds one (an attitude in another form is not converted).
    pub fn quaternion(&self) -> Option<[f64; 4]> {
        std::iter::once(&self.orientation).chain(&self.further_orientations).flatten().find_map(|o| {
            match o.attitude {
                Attitude::Quaternion(q) => Some(q),
                _ => None,
            }
        })
    }

    pub(super) fn add_orientation(&mut self, orientation: Orientation) {
        let free = std::iter::once(&mut self.orientation)
            .chain(&mut self.further_orientations)
            .find(|slot| slot.is_none());
        if let Some(slot) = free {
            *slot = Some(orientation);
        }
    }
}
