//! Legacy MTData, the data message of MTi, MTx and MTi-G.
//!
//! The message does not identify its format: OutputMode and OutputSettings from the Configuration
//! are needed to read it.

use super::{
    DecodeError,
    measurement::{Attitude, GlobalFrame, Measurement, Orientation, Status},
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
    /// Bits 3:2 are the form of the orientation, bits 9:8 the [`NumberFormat`].
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

impl OutputSettings {
    /// Number format of bits 9:8.
    pub const fn number_format(self) -> NumberFormat {
        NumberFormat::from_bits(self.bits() >> 8)
    }

    /// The same settings with another number format.
    pub const fn with_number_format(self, format: NumberFormat) -> Self {
        Self::from_bits_retain((self.bits() & !0x300) | (format.bits() << 8))
    }

    /// The identity in the form of bits 3:2; `None` for the invalid code 3.
    pub const fn identity(self) -> Option<Attitude> {
        match (self.bits() >> 2) & 3 {
            0 => Some(Attitude::Quaternion([1.0, 0.0, 0.0, 0.0])),
            1 => Some(Attitude::Euler([0.0; 3])),
            2 => Some(Attitude::Matrix([1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0])),
            _ => None,
        }
    }

    /// Global frame of the orientation.
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

/// Item of a message.
#[derive(Clone, Copy)]
enum Item {
    /// Data that the driver does not use.
    Skipped,
    Temperature,
    Acceleration,
    AngularVelocity,
    MagneticField,
    Orientation,
    Status,
    Counter,
}

impl LegacyFormat {
    /// Calibrated data, quaternion, counter, float32: the format that the driver sets.
    pub const STANDARD: Self = Self {
        mode: OutputMode::CALIBRATED.union(OutputMode::ORIENTATION),
        settings: OutputSettings::COUNTER,
    };

    /// Items in the order of the message, with their lengths, bytes; zero if they are not sent.
    fn items(&self) -> [(Item, usize); 14] {
        use OutputMode as M;
        use OutputSettings as S;
        let size = self.settings.number_format().size();
        let attitude = self.settings.identity().map_or(0, |identity| identity.numbers().len());
        let with = |mode: M, length: usize| if self.mode.contains(mode) { length } else { 0 };
        let set = |bit: S, length: usize| if self.settings.contains(bit) { length } else { 0 };
        let unless = |bit: S, length: usize| if self.settings.contains(bit) { 0 } else { length };
        let vector = |omit| with(M::CALIBRATED, unless(omit, 3 * size));
        [
            (Item::Skipped, with(M::RAW_INERTIAL, 20)),
            (Item::Skipped, with(M::RAW_GPS, 44)),
            (Item::Temperature, with(M::TEMPERATURE, size)),
            (Item::Acceleration, vector(S::NO_ACCELERATION)),
            (Item::AngularVelocity, vector(S::NO_ANGULAR_VELOCITY)),
            (Item::MagneticField, vector(S::NO_MAGNETIC_FIELD)),
            (Item::Orientation, with(M::ORIENTATION, attitude * size)),
            (Item::Skipped, with(M::AUXILIARY, unless(S::NO_ANALOG_1, 2))),
            (Item::Skipped, with(M::AUXILIARY, unless(S::NO_ANALOG_2, 2))),
            (Item::Skipped, with(M::POSITION, 3 * size)),
            (Item::Skipped, with(M::VELOCITY, 3 * size)),
            (Item::Status, with(M::STATUS, 1)),
            (Item::Counter, set(S::COUNTER, 2)),
            (Item::Skipped, set(S::UTC, 12)),
        ]
    }

    /// Length of the data of a message in this format, bytes.
    pub fn data_length(&self) -> usize {
        self.items().iter().map(|(_, length)| length).sum()
    }

    /// Decodes the data of one MTData message.
    ///
    /// # Errors
    /// [`DecodeError::Length`] if the data do not have the length of the format.
    #[inline]
    pub fn decode(&self, data: &[u8]) -> Result<Measurement, DecodeError> {
        self.read(data)
            .ok_or_else(|| DecodeError::Length { found: data.len(), expected: self.data_length() })
    }

    /// `None` if bytes are missing or left.
    fn read(&self, data: &[u8]) -> Option<Measurement> {
        let mut m = Measurement {
            other_inertial: self.mode.contains(OutputMode::RAW_INERTIAL),
            ..Measurement::default()
        };
        let r = &mut Reader::new(data);
        let format = self.settings.number_format();
        for (item, length) in self.items() {
            if length == 0 {
                continue;
            }
            match item {
                Item::Skipped => {
                    r.take(length)?;
                }
                Item::Temperature => m.temperature = Some(r.numbers::<1>(format)?[0]),
                Item::Acceleration => m.acceleration = Some(r.numbers(format)?),
                Item::AngularVelocity => m.angular_velocity = Some(r.numbers(format)?),
                Item::MagneticField => m.magnetic_field = Some(r.numbers(format)?),
                Item::Orientation => {
                    let attitude = match self.settings.identity()? {
                        Attitude::Quaternion(_) => Attitude::Quaternion(r.numbers(format)?),
                        Attitude::Euler(_) => Attitude::Euler(r.numbers(format)?),
                        Attitude::Matrix(_) => Attitude::Matrix(r.numbers(format)?),
                    };
                    let frame = self.settings.global_frame();
                    m.orientations[0] = Some(Orientation { attitude, frame });
                }
                Item::Status => m.status = Some(Status::from_bits_retain(u32::from(r.u8()?))),
                Item::Counter => m.counter = Some(r.u16()?),
            }
        }
        r.rest().is_empty().then_some(m)
    }

    /// Appends the data of one MTData message: the inverse of [`LegacyFormat::decode`].
    ///
    /// Data missing in the measurement are zero, a missing orientation is the identity.
    pub fn encode(&self, m: &Measurement, out: &mut Vec<u8>) {
        let format = self.settings.number_format();
        let write =
            |values: &[f64], out: &mut Vec<u8>| values.iter().for_each(|v| format.write(*v, out));
        for (item, length) in self.items() {
            if length == 0 {
                continue;
            }
            match item {
                Item::Skipped => out.resize(out.len() + length, 0),
                Item::Temperature => write(&[m.temperature.unwrap_or_default()], out),
                Item::Acceleration => write(&m.acceleration.unwrap_or_default(), out),
                Item::AngularVelocity => write(&m.angular_velocity.unwrap_or_default(), out),
                Item::MagneticField => write(&m.magnetic_field.unwrap_or_default(), out),
                Item::Orientation => {
                    let Some(identity) = self.settings.identity() else { continue };
                    let identity = identity.numbers();
                    let given = m.orientations[0].as_ref().map(|o| o.attitude.numbers());
                    let fitting = given.filter(|numbers| numbers.len() == identity.len());
                    write(fitting.unwrap_or(identity), out);
                }
                Item::Status => out.push(m.status.unwrap_or_default().bits() as u8),
                Item::Counter => {
                    out.extend_from_slice(&m.counter.unwrap_or_default().to_be_bytes());
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_standard_format_has_the_length_and_codes_of_a_recorded_configuration() {
        assert_eq!(LegacyFormat::STANDARD.data_length(), 0x36);
        assert_eq!(LegacyFormat::STANDARD.mode.bits(), 6);
        assert_eq!(LegacyFormat::STANDARD.settings.bits(), 1);
        let error = LegacyFormat::STANDARD.decode(&[0; 53]).unwrap_err();
        assert_eq!(error, DecodeError::Length { found: 53, expected: 54 });
    }
}
