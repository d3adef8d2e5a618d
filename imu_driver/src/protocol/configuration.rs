//! Identity and configuration of a device: Configuration (legacy, 118 bytes) and output
//! configuration (MTi-1, 10, 100, 600 series).

use super::{
    DecodeError,
    legacy::{LegacyFormat, OutputMode, OutputSettings},
    number::Reader,
};
use std::fmt;

/// Resolution of the sampling period, Hz.
pub const TICKS_PER_SECOND: f64 = 115_200.0;
/// Length of the data of a Configuration message for one device, bytes.
const CONFIGURATION_LENGTH: usize = 118;

/// Device identifier: 32 bits, 64 on the newest devices.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct DeviceId(pub u64);

impl DeviceId {
    /// Identifier from the data of a DeviceID message; `None` unless they have 4 or 8 bytes.
    pub fn from_data(data: &[u8]) -> Option<Self> {
        match data.len() {
            4 | 8 => Some(Self(data.iter().fold(0, |id, &b| (id << 8) | u64::from(b)))),
            _ => None,
        }
    }

    /// Name of the product family.
    pub fn family(self) -> &'static str {
        match self.0 & 0x00F0_0000 {
            0x0030_0000 => "MTi/MTx",
            0x0050_0000 => "MTi-G",
            _ => "IMU",
        }
    }
}

impl fmt::Display for DeviceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 > u64::from(u32::MAX) {
            write!(f, "{:016X}", self.0)
        } else {
            write!(f, "{:08X}", self.0)
        }
    }
}

/// The part of a legacy Configuration that the driver uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Configuration {
    /// Device identifier.
    pub device_id: DeviceId,
    /// Sampling period, ticks of 1/115200 s.
    pub period: u16,
    /// Number of samples omitted between two messages; FFFF: messages on request only.
    pub skip: u16,
    /// Length of the data of MTData, bytes.
    pub data_length: u16,
    /// Format of MTData.
    pub format: LegacyFormat,
}

impl Configuration {
    /// Configuration from the data of a Configuration message.
    ///
    /// # Errors
    /// [`DecodeError::Length`] unless they have 118 bytes (a chain of several devices has more).
    pub fn from_data(data: &[u8]) -> Result<Self, DecodeError> {
        let expected = CONFIGURATION_LENGTH;
        Self::read(data).ok_or(DecodeError::Length { found: data.len(), expected })
    }

    fn read(data: &[u8]) -> Option<Self> {
        let r = &mut Reader::new(data);
        r.take(4)?;
        let (period, skip) = (r.u16()?, r.u16()?);
        r.take(90)?;
        let configuration = Self {
            period,
            skip,
            device_id: DeviceId(u64::from(r.u32()?)),
            data_length: r.u16()?,
            format: LegacyFormat {
                mode: OutputMode::from_bits_retain(r.u16()?),
                settings: OutputSettings::from_bits_retain(r.u32()?),
            },
        };
        (data.len() == CONFIGURATION_LENGTH).then_some(configuration)
    }

    /// Data of a Configuration message (118 bytes); the other fields are zero.
    pub fn to_data(&self) -> Vec<u8> {
        let mut data = Vec::with_capacity(CONFIGURATION_LENGTH);
        let id = (self.device_id.0 as u32).to_be_bytes();
        data.extend_from_slice(&id);
        data.extend_from_slice(&self.period.to_be_bytes());
        data.extend_from_slice(&self.skip.to_be_bytes());
        data.resize(96, 0);
        data.extend_from_slice(&1_u16.to_be_bytes());
        data.extend_from_slice(&id);
        data.extend_from_slice(&self.data_length.to_be_bytes());
        data.extend_from_slice(&self.format.mode.bits().to_be_bytes());
        data.extend_from_slice(&self.format.settings.bits().to_be_bytes());
        data.resize(CONFIGURATION_LENGTH, 0);
        data
    }

    /// Whether the device sends on request only.
    pub fn is_on_request(&self) -> bool {
        self.skip == u16::MAX
    }

    /// Ticks of 1/115200 s between two messages.
    ///
    /// `None` if the device sends on request only, or if the period is zero.
    pub fn ticks_per_message(&self) -> Option<u32> {
        if self.is_on_request() || self.period == 0 {
            return None;
        }
        Some(u32::from(self.period) * (u32::from(self.skip) + 1))
    }

    /// Message rate, Hz.
    pub fn rate(&self) -> Option<f64> {
        self.ticks_per_message().map(|ticks| TICKS_PER_SECOND / f64::from(ticks))
    }
}

/// Period (ticks) and skip factor nearest to `rate` (Hz), with a period of 225 to 11520 ticks.
///
/// `None` unless the rate is 0.01 to 512 Hz.
pub fn period_and_skip(rate: f64) -> Option<(u16, u16)> {
    if !(0.01..=512.0).contains(&rate) {
        return None;
    }
    let ticks = (TICKS_PER_SECOND / rate).round().max(225.0);
    let divisor = (ticks / 11_520.0).ceil().max(1.0);
    Some(((ticks / divisor).round() as u16, (divisor - 1.0) as u16))
}

/// Entry of an output configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct OutputEntry {
    /// MTData2 identifier.
    pub id: u16,
    /// Rate, Hz; FFFF: with every message.
    pub rate: u16,
}

/// Rate of the messages with these outputs, Hz; `None` if none has a rate of its own.
pub fn message_rate(outputs: &[OutputEntry]) -> Option<u16> {
    outputs.iter().map(|output| output.rate).filter(|rate| (1..u16::MAX).contains(rate)).max()
}

/// Largest number of entries in an output configuration.
pub const MAX_OUTPUTS: usize = 32;

/// Decodes an output configuration.
///
/// # Errors
/// [`DecodeError::Length`] unless the data are at most 32 entries of four bytes.
pub fn output_configuration_from_data(data: &[u8]) -> Result<Vec<OutputEntry>, DecodeError> {
    let (entries, rest) = data.as_chunks::<4>();
    if !rest.is_empty() || entries.len() > MAX_OUTPUTS {
        let expected = 4 * entries.len().min(MAX_OUTPUTS);
        return Err(DecodeError::Length { found: data.len(), expected });
    }
    Ok(entries
        .iter()
        .map(|[a, b, c, d]| OutputEntry {
            id: u16::from_be_bytes([*a, *b]),
            rate: u16::from_be_bytes([*c, *d]),
        })
        .collect())
}

/// Encodes the data of a SetOutputConfiguration message.
pub fn output_configuration_to_data(entries: &[OutputEntry]) -> Vec<u8> {
    let bytes = |e: &OutputEntry| [e.id.to_be_bytes(), e.rate.to_be_bytes()];
    entries.iter().take(MAX_OUTPUTS).flat_map(bytes).flatten().collect()
}

/// Text of a message, such as the product code, without its padding.
pub fn text_from_data(data: &[u8]) -> String {
    data.iter()
        .map(|&b| if (0x20..0x7F).contains(&b) { char::from(b) } else { ' ' })
        .collect::<String>()
        .trim()
        .to_owned()
}

/// Firmware revision as `major.minor.revision`; `None` with fewer than three bytes.
pub fn firmware_from_data(data: &[u8]) -> Option<String> {
    let [major, minor, revision, ..] = data else {
        return None;
    };
    Some(format!("{major}.{minor}.{revision}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn periods_of_rates() {
        assert_eq!(period_and_skip(100.0), Some((1152, 0)));
        assert_eq!(period_and_skip(512.0), Some((225, 0)));
        assert_eq!(period_and_skip(400.0), Some((288, 0)));
        assert_eq!(period_and_skip(10.0), Some((11_520, 0)));
        assert_eq!(period_and_skip(5.0), Some((11_520, 1)));
        assert_eq!(period_and_skip(1.0), Some((11_520, 9)));
        for bad in [0.0, -1.0, 513.0, f64::NAN, f64::INFINITY] {
            assert_eq!(period_and_skip(bad), None);
        }
    }

    #[test]
    fn a_configuration_round_trips() {
        let c = Configuration {
            device_id: DeviceId(0x0030_1234),
            period: 1152,
            skip: 1,
            data_length: 54,
            format: LegacyFormat::STANDARD,
        };
        assert_eq!(Configuration::from_data(&c.to_data()), Ok(c));
        assert_eq!(c.rate(), Some(50.0));
        assert_eq!(Configuration { skip: 0xFFFF, ..c }.rate(), None);
        assert!(Configuration::from_data(&[0; 117]).is_err());
    }
}
