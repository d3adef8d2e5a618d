//! Content of one data message in SI units, in the frames of the device.

use bitflags::bitflags;

/// Global frame of the orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum GlobalFrame {
    /// x east, y north, z up: default of MTi-1, 10, 100, 600 series.
    EastNorthUp,
    /// x north, y east, z down.
    NorthEastDown,
    /// x (magnetic) north, y west, z up: legacy devices.
    NorthWestUp,
}

/// Rotation from the sensor to the global frame, in the form of the message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Attitude {
    /// w, x, y, z.
    Quaternion([f64; 4]),
    /// Roll, pitch, yaw, **degrees**.
    Euler([f64; 3]),
    /// Rotation matrix, column by column.
    Matrix([f64; 9]),
}

impl Attitude {
    /// The numbers of the form.
    pub fn numbers(&self) -> &[f64] {
        match self {
            Self::Quaternion(q) => q,
            Self::Euler(angles) => angles,
            Self::Matrix(columns) => columns,
        }
    }
}

/// Orientation of the device.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orientation {
    /// Rotation from the sensor to the global frame.
    pub attitude: Attitude,
    /// The global frame.
    pub frame: GlobalFrame,
}

bitflags! {
    /// Status bits; legacy devices and MTData2's status byte have the lowest eight only.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct Status: u32 {
        /// The self-test at start-up passed.
        const SELF_TEST_PASSED = 1;
        /// The output of the orientation filter is valid.
        const FILTER_VALID = 2;
        /// Clipping of accelerometers (x, y, z in bits 8–10), gyroscopes (11–13), magnetometers
        /// (14–16), or any of them (19).
        const CLIPPING = (0x1FF << 8) | (1 << 19);
    }
}

/// Decoded data message; vectors are in the sensor frame.
///
/// One field per data item of the two protocols that the driver uses, hence their number.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measurement {
    /// Message counter; wraps.
    pub counter: Option<u16>,
    /// Sample time, ticks of 0.1 ms; wraps.
    pub sample_time_fine: Option<u32>,
    /// Specific force, m/s²: +9.81 up at rest.
    pub acceleration: Option<[f64; 3]>,
    /// Specific force from the high-rate channel, m/s².
    pub acceleration_hr: Option<[f64; 3]>,
    /// Velocity increment over one sample, m/s.
    pub delta_velocity: Option<[f64; 3]>,
    /// Angular velocity, rad/s.
    pub angular_velocity: Option<[f64; 3]>,
    /// Angular velocity from the high-rate channel, rad/s.
    pub angular_velocity_hr: Option<[f64; 3]>,
    /// Orientation increment over one sample, quaternion w, x, y, z.
    pub delta_orientation: Option<[f64; 4]>,
    /// Magnetic field, arbitrary unit (about 1 in the Earth's field).
    pub magnetic_field: Option<[f64; 3]>,
    /// Orientation, in up to three forms.
    pub orientations: [Option<Orientation>; 3],
    /// Temperature, °C.
    pub temperature: Option<f64>,
    /// Status bits.
    pub status: Option<Status>,
    /// The message contains inertial data that are not decoded: uncalibrated readings or
    /// acceleration without gravity.
    pub other_inertial: bool,
}

impl Measurement {
    /// Whether the message contains inertial data.
    ///
    /// Only then are its counter and SampleTimeFine the time of a sample; messages with GNSS data
    /// alone have an unrelated time.
    pub fn is_inertial(&self) -> bool {
        self.acceleration.is_some()
            || self.acceleration_hr.is_some()
            || self.delta_velocity.is_some()
            || self.angular_velocity.is_some()
            || self.angular_velocity_hr.is_some()
            || self.delta_orientation.is_some()
            || self.magnetic_field.is_some()
            || self.orientations[0].is_some()
            || self.other_inertial
    }

    /// Quaternion w, x, y, z, if the message contains one; other forms are not converted.
    pub fn quaternion(&self) -> Option<[f64; 4]> {
        self.orientations.iter().flatten().find_map(|o| match o.attitude {
            Attitude::Quaternion(q) => Some(q),
            _ => None,
        })
    }
}
