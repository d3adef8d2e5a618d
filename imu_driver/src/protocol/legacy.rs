//! Legacy MTData: what an MTi, MTx or MTi-G sends. The message carries no tag of its own format, so OutputMode and
//! OutputSettings must be known (from the Configuration) before it can be read.

use super::{
    DecodeError,
    measurement::{Attitude, GlobalFrame, Measurement, Orientation, RawGps, RawInertial, Status, Utc},
    number::{NumberFormat, Reader},
};

/// What a legacy unit sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct OutputMode(pub u16);

impl OutputMode {
    /// Temperature.
    pub const TEMPERATURE: u16 = 0x0001;
    /// Acceleration, rate of turn, magnetic field.
    pub const CALIBRATED: u16 = 0x0002;
    /// Attitude.
    pub const ORIENTATION: u16 = 0x0004;
    /// Analog inputs.
    pub const AUXILIARY: u16 = 0x0008;
    /// Position.
    pub const POSITION: u16 = 0x0010;
    /// Velocity.
    pub const VELOCITY: u16 = 0x0020;
    /// Status byte.
    pub const STATUS: u16 = 0x0800;
    /// Raw GPS data.
    pub const RAW_GPS: u16 = 0x1000;
    /// Uncalibrated readings, instead of the calibrated ones.
    pub const RAW_INERTIAL: u16 = 0x4000;

    /// Whether a bit is set.
    pub const fn has(self, bit: u16) -> bool {
        self.0 & bit != 0
    }
}

/// In which form a legacy unit sends its attitude.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum OrientationForm {
    /// Four numbers w, x, y, z.
    Quaternion,
    /// Three angles, degrees.
    Euler,
    /// Nine numbers.
    Matrix,
}

/// How a legacy unit writes what it sends.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct OutputSettings(pub u32);

impl OutputSettings {
    /// Send the sample counter.
    pub const COUNTER: u32 = 1;
    /// Send date and time.
    pub const UTC: u32 = 2;
    /// Leave the acceleration out.
    pub const NO_ACCELERATION: u32 = 1 << 4;
    /// Leave the rate of turn out.
    pub const NO_ANGULAR_VELOCITY: u32 = 1 << 5;
    /// Leave the magnetic field out.
    pub const NO_MAGNETIC_FIELD: u32 = 1 << 6;
    /// Leave analog input 1 out.
    pub const NO_ANALOG_1: u32 = 1 << 10;
    /// Leave analog input 2 out.
    pub const NO_ANALOG_2: u32 = 1 << 11;
    /// North-east-down.
    pub const NED: u32 = 1 << 31;

    /// Whether a bit is set.
    pub const fn has(self, bit: u32) -> bool {
        self.0 & bit != 0
    }

    /// How numbers are written.
    pub const fn number_format(self) -> NumberFormat {
        NumberFormat::from_bits(self.0 >> 8)
    }

    /// The attitude's form; `None` for the code that means none.
    pub const fn orientation_form(self) -> Option<OrientationForm> {
        match (self.0 >> 2) & 3 {
            0 => Some(OrientationForm::Quaternion),
            1 => Some(OrientationForm::Euler),
            2 => Some(OrientationForm::Matrix),
            _ => None,
        }
    }

    /// The attitude's global frame.
    pub const fn global_frame(self) -> GlobalFrame {
        if self.has(Self::NED) { GlobalFrame::NorthEastDown } else { GlobalFrame::NorthWestUp }
    }
}

/// The format of a legacy unit's MTData.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LegacyFormat {
    /// What is sent.
    pub mode: OutputMode,
    /// How it is written.
    pub settings: OutputSettings,
}

const RAW_LENGTH: usize = 20;
const RAW_GPS_LENGTH: usize = 44;
const UTC_LENGTH: usize = 12;

impl LegacyFormat {
    /// Calibrated data, quaternion, counter, float32: what the driver asks for.
    pub const STANDARD: Self = Self {
        mode: OutputMode(OutputMode::CALIBRATED | OutputMode::ORIENTATION),
        settings: OutputSettings(OutputSettings::COUNTER),
    };

    /// Whether one of the calibrated vectors is sent.
    pub const fn sends_vector(&self, leave_out: u32) -> bool {
        self.mode.has(OutputMode::CALIBRATED) && !self.settings.has(leave_out)
    }

    fn sends_analog(&self, leave_out: u32) -> bool {
        self.mode.has(OutputMode::AUXILIARY) && !self.settings.has(leave_out)
    }

    /// Length of a message's data in this format, bytes.
    pub fn data_length(&self) -> usize {
        use OutputMode as M;
        use OutputSettings as S;
        let size = self.settings.number_format().size();
        let if_set = |bit, n| if self.mode.has(bit) { n } else { 0 };
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
        let analogs = [S::NO_ANALOG_1, S::NO_ANALOG_2].iter().filter(|a| self.sends_analog(**a)).count();
        numbers * size
            + if_set(M::RAW_INERTIAL, RAW_LENGTH)
            + if_set(M::RAW_GPS, RAW_GPS_LENGTH)
            + 2 * analogs
            + if_set(M::STATUS, 1)
            + if self.settings.has(S::COUNTER) { 2 } else { 0 }
            + if self.settings.has(S::UTC) { UTC_LENGTH } else { 0 }
    }

    /// Decodes the data of one MTData message.
    ///
    /// # Errors
    /// [`DecodeError::Length`] where the data are not as long as the format says: it is not the unit's format.
    #[inline]
    pub fn decode(&self, data: &[u8]) -> Result<Measurement, DecodeError> {
        let mut m = Measurement::default();
        self.decode_into(data, &mut m)?;
        Ok(m)
    }

    /// [`LegacyFormat::decode`] into a measurement that is at hand: a measurement is large, and moving it costs more than
    /// reading it.
    ///
    /// # Errors
    /// As [`LegacyFormat::decode`].
    #[inline]
    pub fn decode_into(&self, data: &[u8], m: &mut Measurement) -> Result<(), DecodeError> {
        *m = Measurement::default();
        let expected = self.data_length();
        if data.len() != expected {
            return Err(DecodeError::Length { found: data.len(), expected });
        }
        // The length was checked, so no field can be missing.
        self.read(data, m).ok_or(DecodeError::Length { found: data.len(), expected })
    }

    fn read(&self, data: &[u8], m: &mut Measurement) -> Option<()> {
        use OutputMode as M;
        use OutputSettings as S;
        let r = &mut Reader::new(data);
        let format = self.settings.number_format();
        if self.mode.has(M::RAW_INERTIAL) {
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
        if self.mode.has(M::RAW_GPS) {
            m.raw_gps = Some(RawGps(r.take(RAW_GPS_LENGTH)?.try_into().ok()?));
            m.has_gnss = true;
        }
        if self.mode.has(M::TEMPERATURE) {
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
        if self.mode.has(M::ORIENTATION) {
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
        if self.mode.has(M::POSITION) {
            let [latitude, longitude, altitude] = r.numbers(format)?;
            m.latitude_longitude = Some([latitude, longitude]);
            m.altitude = Some(altitude);
        }
        if self.mode.has(M::VELOCITY) {
            m.velocity = Some(r.numbers(format)?);
        }
        if self.mode.has(M::STATUS) {
            m.status = Some(Status(u32::from(r.u8()?)));
        }
        if self.settings.has(S::COUNTER) {
            m.counter = Some(r.u16()?);
        }
        if self.settings.has(S::UTC) {
            m.utc = Some(read_utc(r)?);
        }
        Some(())
    }

    /// Appends the data of one MTData message: the inverse of [`LegacyFormat::decode`]. What the measurement does not
    /// hold is written as zero.
    pub fn encode(&self, m: &Measurement, out: &mut Vec<u8>) {
        use OutputMode as M;
        use OutputSettings as S;
        let format = self.settings.number_format();
        let write = |values: &[f64], out: &mut Vec<u8>| values.iter().for_each(|v| format.write(*v, out));
        if self.mode.has(M::RAW_INERTIAL) {
            let raw = m.raw.unwrap_or_default();
            let words = [raw.acceleration, raw.angular_velocity, raw.magnetic_field];
            for word in words.iter().flatten().chain(std::iter::once(&raw.temperature)) {
                out.extend_from_slice(&word.to_be_bytes());
            }
        }
        if self.mode.has(M::RAW_GPS) {
            out.extend_from_slice(&m.raw_gps.map_or([0; RAW_GPS_LENGTH], |g| g.0));
        }
        if self.mode.has(M::TEMPERATURE) {
            write(&[m.temperature.unwrap_or_default()], out);
        }
        let vectors = [
            (S::NO_ACCELERATION, m.acceleration),
            (S::NO_ANGULAR_VELOCITY, m.angular_velocity),
            (S::NO_MAGNETIC_FIELD, m.magnetic_field),
        ];
        for (leave_out, vector) in vectors {
            if self.sends_vector(leave_out) {
                write(&vector.unwrap_or_default(), out);
            }
        }
        if self.mode.has(M::ORIENTATION) {
            let attitude = m.orientation.map(|o| o.attitude);
            match (self.settings.orientation_form(), attitude) {
                (Some(OrientationForm::Quaternion), Some(Attitude::Quaternion(q))) => write(&q, out),
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
        for (leave_out, value) in [(S::NO_ANALOG_1, m.analog[0]), (S::NO_ANALOG_2, m.analog[1])] {
            if self.sends_analog(leave_out) {
                out.extend_from_slice(&value.unwrap_or_default().to_be_bytes());
            }
        }
        if self.mode.has(M::POSITION) {
            let [latitude, longitude] = m.latitude_longitude.unwrap_or_default();
            write(&[latitude, longitude, m.altitude.unwrap_or_default()], out);
        }
        if self.mode.has(M::VELOCITY) {
            write(&m.velocity.unwrap_or_default(), out);
        }
        if self.mode.has(M::STATUS) {
            out.push(m.status.unwrap_or_default().0 as u8);
        }
        if self.settings.has(S::COUNTER) {
            out.extend_from_slice(&m.counter.unwrap_or_default().to_be_bytes());
        }
        if self.settings.has(S::UTC) {
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
    fn the_real_unit_s_configuration_gives_its_real_length() {
        assert_eq!(LegacyFormat::STANDARD.data_length(), 0x36);
        assert_eq!(LegacyFormat::STANDARD.mode.0, 6);
        assert_eq!(LegacyFormat::STANDARD.settings.0, 1);
    }

    #[test]
    fn a_wrong_length_is_said_and_not_read() {
        let error = LegacyFormat::STANDARD.decode(&[0; 53]).unwrap_err();
        assert_eq!(error, DecodeError::Length { found: 53, expected: 54 });
    }
}
