//! Legacy MTData, the data message of MTi, MTx and MTi-G.
//!
//! The message does not identify its format: OutputMode and OutputSettings from the Configuration
//! are needed to read it.

use super::{
    DecodeError,
    measurement::{
        Attitude, GlobalFrame, Measurement, Orientation, RawGps, RawInertial, Status, Utc,
    },
    number::{NumberFormat, Reader},
};
use bitflags::bitflags;

bitflags! {
    /// OutputMode: data that a legacy device outputs.
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct OutputMode: u16 {
        /// Temperature.
        const TEMPERATURE = 0x0001;
        /// Acceleration, angular velocity, magnetic field.
        const CALIBRATED = 0x0002;
        /// Orientation.
        const ORIENTATION = 0x0004;
        /// Analog inputs.
        const AUXILIARY = 0x0008;
        /// Position.
        const POSITION = 0x0010;
        /// Velocity.
        const VELOCITY = 0x0020;
        /// Status byte.
        const STATUS = 0x0800;
        /// Raw GPS data.
        const RAW_GPS = 0x1000;
        /// Uncalibrated readings instead of the calibrated ones.
        const RAW_INERTIAL = 0x4000;
    }
}

bitflags! {
    /// OutputSettings: format of the data that a legacy device outputs.
    ///
    /// Bits 3:2 are the [`OrientationForm`], bits 9:8 the [`NumberFormat`].
    #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
    pub struct OutputSettings: u32 {
        /// Send the sample counter.
        const COUNTER = 1;
        /// Send date and time.
        const UTC = 2;
        /// Omit the acceleration.
        const NO_ACCELERATION = 1 << 4;
        /// Omit the angular velocity.
        const NO_ANGULAR_VELOCITY = 1 << 5;
        /// Omit the magnetic field.
        const NO_MAGNETIC_FIELD = 1 << 6;
        /// Omit analog input 1.
        const NO_ANALOG_1 = 1 << 10;
        /// Omit analog input 2.
        const NO_ANALOG_2 = 1 << 11;
        /// The global frame is north-east-down instead of north-west-up.
        const NED = 1 << 31;
        // The multi-bit fields are valid bits too.
        const _ = !0;
    }
}

/// Form in which a legacy device outputs its orientation.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OrientationForm {
    /// Four numbers w, x, y, z.
    Quaternion,
    /// Roll, pitch, yaw, degrees.
    Euler,
    /// Nine numbers.
    Matrix,
}

impl OutputSettings {
    /// Number format of bits 9:8.
    pub const fn number_format(self) -> NumberFormat {
        NumberFormat::from_bits(self.bits() >> 8)
    }

    /// The same settings with another number format.
    pub const fn with_number_format(self, format: NumberFormat) -> Self {
        Self::from_bits_retain((self.bits() & !0x300) | (format.bits() << 8))
    }

    /// Orientation form of bits 3:2; `None` for the invalid code 3.
    pub const fn orientation_form(self) -> Option<OrientationForm> {
        match (self.bits() >> 2) & 3 {
            0 => Some(OrientationForm::Quaternion),
            1 => Some(OrientationForm::Euler),
            2 => Some(OrientationForm::Matrix),
            _ => None,
        }
    }

    /// Global frame of orientation and velocity.
    pub const fn global_frame(self) -> GlobalFrame {
        if self.contains(Self::NED) { GlobalFrame::NorthEastDown } else { GlobalFrame::NorthWestUp }
    }
}

/// Format of MTData.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LegacyFormat {
    /// Data in the message.
    pub mode: OutputMode,
    /// Encoding of the data.
    pub settings: OutputSettings,
}

const RAW_LENGTH: usize = 20;
const RAW_GPS_LENGTH: usize = 44;
const UTC_LENGTH: usize = 12;

impl LegacyFormat {
    /// Calibrated data, quaternion, counter, float32: the format that the driver sets.
    pub const STANDARD: Self = Self {
        mode: OutputMode::CALIBRATED.union(OutputMode::ORIENTATION),
        settings: OutputSettings::COUNTER,
    };

    /// Whether the message contains the calibrated vector that `omit` would omit.
    pub const fn sends_vector(&self, omit: OutputSettings) -> bool {
        self.mode.contains(OutputMode::CALIBRATED) && !self.settings.contains(omit)
    }

    fn sends_analog(&self, omit: OutputSettings) -> bool {
        self.mode.contains(OutputMode::AUXILIARY) && !self.settings.contains(omit)
    }

    /// Length of the data of a message in this format, bytes.
    pub fn data_length(&self) -> usize {
        use OutputMode as M;
        use OutputSettings as S;
        let size = self.settings.number_format().size();
        let if_set = |bit, n| if self.mode.contains(bit) { n } else { 0 };
        let vectors = [S::NO_ACCELERATION, S::NO_ANGULAR_VELOCITY, S::NO_MAGNETIC_FIELD];
        let attitude = match self.settings.orientation_form() {
            Some(OrientationForm::Quaternion) => 4,
            Some(OrientationForm::Euler) => 3,
            Some(OrientationForm::Matrix) => 9,
            None => 0,
        };
        let numbers = if_set(M::TEMPERATURE, 1)
            + 3 * vectors.iter().filter(|v| self.sends_vector(**v)).count()
            + if_set(M::ORIENTATION, attitude)
            + if_set(M::POSITION, 3)
            + if_set(M::VELOCITY, 3);
        let analogs =
            [S::NO_ANALOG_1, S::NO_ANALOG_2].iter().filter(|a| self.sends_analog(**a)).count();
        numbers * size
            + if_set(M::RAW_INERTIAL, RAW_LENGTH)
            + if_set(M::RAW_GPS, RAW_GPS_LENGTH)
            + 2 * analogs
            + if_set(M::STATUS, 1)
            + if self.settings.contains(S::COUNTER) { 2 } else { 0 }
            + if self.settings.contains(S::UTC) { UTC_LENGTH } else { 0 }
    }

    /// Decodes the data of one MTData message.
    ///
    /// # Errors
    /// [`DecodeError::Length`] if the data do not have the length of the format.
    #[inline]
    pub fn decode(&self, data: &[u8]) -> Result<Measurement, DecodeError> {
        let expected = self.data_length();
        if data.len() != expected {
            return Err(DecodeError::Length { found: data.len(), expected });
        }
        // The length was checked, so no field can be missing.
        self.read(data).ok_or(DecodeError::Length { found: data.len(), expected })
    }

    fn read(&self, data: &[u8]) -> Option<Measurement> {
        use OutputMode as M;
        use OutputSettings as S;
        let mut m = Measurement::default();
        let r = &mut Reader::new(data);
        let format = self.settings.number_format();
        if self.mode.contains(M::RAW_INERTIAL) {
            let mut words = [0_u16; 10];
            for word in &mut words {
                *word = r.u16()?;
            }
            let [ax, ay, az, gx, gy, gz, mx, my, mz, temperature] = words;
            m.raw = Some(RawInertial {
                acceleration: [ax, ay, az],
                angular_velocity: [gx, gy, gz],
                magnetic_field: [mx, my, mz],
                temperature,
            });
        }
        if self.mode.contains(M::RAW_GPS) {
            m.raw_gps = Some(RawGps(r.take(RAW_GPS_LENGTH)?.try_into().ok()?));
            m.has_gnss = true;
        }
        if self.mode.contains(M::TEMPERATURE) {
            m.temperature = Some(r.numbers::<1>(format)?[0]);
        }
        if self.sends_vector(S::NO_ACCELERATION) {
            m.acceleration = Some(r.numbers(format)?);
        }
        if self.sends_vector(S::NO_ANGULAR_VELOCITY) {
            m.angular_velocity = Some(r.numbers(format)?);
        }
        if self.sends_vector(S::NO_MAGNETIC_FIELD) {
            m.magnetic_field = Some(r.numbers(format)?);
        }
        if self.mode.contains(M::ORIENTATION) {
            let frame = self.settings.global_frame();
            let attitude = match self.settings.orientation_form() {
                Some(OrientationForm::Quaternion) => Some(Attitude::Quaternion(r.numbers(format)?)),
                Some(OrientationForm::Euler) => Some(Attitude::Euler(r.numbers(format)?)),
                Some(OrientationForm::Matrix) => Some(Attitude::Matrix(r.numbers(format)?)),
                None => None,
            };
            m.orientation = attitude.map(|attitude| Orientation { attitude, frame });
        }
        if self.sends_analog(S::NO_ANALOG_1) {
            m.analog[0] = Some(r.u16()?);
        }
        if self.sends_analog(S::NO_ANALOG_2) {
            m.analog[1] = Some(r.u16()?);
        }
        if self.mode.contains(M::POSITION) {
            let [latitude, longitude, altitude] = r.numbers(format)?;
            m.latitude_longitude = Some([latitude, longitude]);
            m.altitude = Some(altitude);
        }
        if self.mode.contains(M::VELOCITY) {
            m.velocity = Some(r.numbers(format)?);
        }
        if self.mode.contains(M::STATUS) {
            m.status = Some(Status::from_bits_retain(u32::from(r.u8()?)));
        }
        if self.settings.contains(S::COUNTER) {
            m.counter = Some(r.u16()?);
        }
        if self.settings.contains(S::UTC) {
            m.utc = Some(read_utc(r)?);
        }
        Some(m)
    }

    /// Appends the data of one MTData message: the inverse of [`LegacyFormat::decode`].
    ///
    /// Data missing in the measurement are zero, a missing orientation is the identity.
    pub fn encode(&self, m: &Measurement, out: &mut Vec<u8>) {
        use OutputMode as M;
        use OutputSettings as S;
        let format = self.settings.number_format();
        let write =
            |values: &[f64], out: &mut Vec<u8>| values.iter().for_each(|v| format.write(*v, out));
        if self.mode.contains(M::RAW_INERTIAL) {
            let raw = m.raw.unwrap_or_default();
            let words = [raw.acceleration, raw.angular_velocity, raw.magnetic_field];
            for word in words.iter().flatten().chain(std::iter::once(&raw.temperature)) {
                out.extend_from_slice(&word.to_be_bytes());
            }
        }
        if self.mode.contains(M::RAW_GPS) {
            out.extend_from_slice(&m.raw_gps.map_or([0; RAW_GPS_LENGTH], |g| g.0));
        }
        if self.mode.contains(M::TEMPERATURE) {
            write(&[m.temperature.unwrap_or_default()], out);
        }
        let vectors = [
            (S::NO_ACCELERATION, m.acceleration),
            (S::NO_ANGULAR_VELOCITY, m.angular_velocity),
            (S::NO_MAGNETIC_FIELD, m.magnetic_field),
        ];
        for (omit, vector) in vectors {
            if self.sends_vector(omit) {
                write(&vector.unwrap_or_default(), out);
            }
        }
        if self.mode.contains(M::ORIENTATION) {
            let attitude = m.orientation.map(|o| o.attitude);
            match (self.settings.orientation_form(), attitude) {
                (Some(OrientationForm::Quaternion), Some(Attitude::Quaternion(q))) => {
                    write(&q, out)
                }
                (Some(OrientationForm::Quaternion), _) => write(&[1.0, 0.0, 0.0, 0.0], out),
                (Some(OrientationForm::Euler), Some(Attitude::Euler(e))) => write(&e, out),
                (Some(OrientationForm::Euler), _) => write(&[0.0; 3], out),
                (Some(OrientationForm::Matrix), Some(Attitude::Matrix(c))) => write(&c, out),
                (Some(OrientationForm::Matrix), _) => {
                    write(&[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0], out);
                }
                (None, _) => {}
            }
        }
        for (omit, value) in [(S::NO_ANALOG_1, m.analog[0]), (S::NO_ANALOG_2, m.analog[1])] {
            if self.sends_analog(omit) {
                out.extend_from_slice(&value.unwrap_or_default().to_be_bytes());
            }
        }
        if self.mode.contains(M::POSITION) {
            let [latitude, longitude] = m.latitude_longitude.unwrap_or_default();
            write(&[latitude, longitude, m.altitude.unwrap_or_default()], out);
        }
        if self.mode.contains(M::VELOCITY) {
            write(&m.velocity.unwrap_or_default(), out);
        }
        if self.mode.contains(M::STATUS) {
            out.push(m.status.unwrap_or_default().bits() as u8);
        }
        if self.settings.contains(S::COUNTER) {
            out.extend_from_slice(&m.counter.unwrap_or_default().to_be_bytes());
        }
        if self.settings.contains(S::UTC) {
            write_utc(&m.utc.unwrap_or_default(), out);
        }
    }
}

pub(super) fn read_utc(r: &mut Reader<'_>) -> Option<Utc> {
    Some(Utc {
        nanosecond: r.u32()?,
        year: r.u16()?,
        month: r.u8()?,
        day: r.u8()?,
        hour: r.u8()?,
        minute: r.u8()?,
        second: r.u8()?,
        flags: r.u8()?,
    })
}

pub(super) fn write_utc(utc: &Utc, out: &mut Vec<u8>) {
    out.extend_from_slice(&utc.nanosecond.to_be_bytes());
    out.extend_from_slice(&utc.year.to_be_bytes());
    out.extend_from_slice(&[utc.month, utc.day, utc.hour, utc.minute, utc.second, utc.flags]);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_format_has_the_length_and_codes_of_a_recorded_configuration() {
        assert_eq!(LegacyFormat::STANDARD.data_length(), 0x36);
        assert_eq!(LegacyFormat::STANDARD.mode.bits(), 6);
        assert_eq!(LegacyFormat::STANDARD.settings.bits(), 1);
    }

    #[test]
    fn data_of_another_length_are_rejected() {
        let error = LegacyFormat::STANDARD.decode(&[0; 53]).unwrap_err();
        assert_eq!(error, DecodeError::Length { found: 53, expected: 54 });
    }
}
