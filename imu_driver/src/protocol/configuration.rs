//! What a unit says about itself: the 118 bytes of a legacy Configuration, the list of a newer one's outputs, its
//! identity.

use super::{
    DecodeError,
    legacy::{LegacyFormat, OutputMode, OutputSettings},
    number::Reader,
};
use std::fmt;

/// The unit's period and skip factor are counted in these, Hz.
pub const TICKS_PER_SECOND: f64 = 115_200.0;
/// Length of a Configuration's data for one device, bytes.
pub const CONFIGURATION_LENGTH: usize = 118;

/// A device identifier: 32 bits, 64 on the newest units.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct DeviceId(pub u64);

impl DeviceId {
    /// From the data of a DeviceID message.
    pub fn from_data(data: &[u8]) -> Option<Self> {
        match data.len() {
            4 | 8 => Some(Self(data.iter().fold(0, |id, &b| (id << 8) | u64::from(b)))),
            _ => None,
        }
    }

    /// The family, as far as it is known.
    pub fn family(self) -> &'static str {
        match self.0 & 0x00F0_0000 {
            0x0030_0000 => "MTi/MTx",
            0x0050_0000 => "MTi-G",
            _ => "inertial unit",
        }
    }
}

impl fmt::Display for DeviceId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.0 > u64::from(u32::MAX) { write!(f, "{:016X}", self.0) } else { write!(f, "{:08X}", self.0) }
    }
}

/// A legacy unit's configuration: what of it the driver uses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Configuration {
    /// Which unit.
    pub device_id: DeviceId,
    /// Sampling period, ticks of 1/115200 s.
    pub period: u16,
    /// So many samples are left out between two that are sent; FFFF: sent only on request.
    pub skip: u16,
    /// Length of MTData's data, bytes, as the unit says it.
    pub data_length: u16,
    /// The format of its MTData.
    pub format: LegacyFormat,
}

impl Configuration {
    /// From the data of a Configuration message.
    ///
    /// # Errors
    /// [`DecodeError::Length`] where they are not 118 bytes (a chain of several units has more).
    pub fn from_data(data: &[u8]) -> Result<Self, DecodeError> {
        let error = DecodeError::Length { found: data.len(), expected: CONFIGURATION_LENGTH };
        if data.len() != CONFIGURATION_LENGTH {
            return Err(error);
        }
        Self::read(data).ok_or(error)
    }

    fn read(data: &[u8]) -> Option<Self> {
        let r = &mut Reader::new(data);
        r.take(4)?;
        let (period, skip) = (r.u16()?, r.u16()?);
        r.take(90)?;
        Some(Self {
            period,
            skip,
            device_id: DeviceId(u64::from(r.u32()?)),
            data_length: r.u16()?,
            format: LegacyFormat { mode: OutputMode(r.u16()?), settings: OutputSettings(r.u32()?) },
        })
    }

    /// The 118 bytes of a Configuration message with everything else zero.
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
        data.extend_from_slice(&self.format.mode.0.to_be_bytes());
        data.extend_from_slice(&self.format.settings.0.to_be_bytes());
        data.resize(CONFIGURATION_LENGTH, 0);
        data
    }

    /// Ticks of 1/115200 s from one message to the next; `None` where it sends only on request or the period is zero.
    pub fn ticks_per_message(&self) -> Option<u32> {
        if self.skip == u16::MAX || self.period == 0 {
            return None;
        }
        Some(u32::from(self.period) * (u32::from(self.skip) + 1))
    }

    /// Messages per second.
    pub fn rate(&self) -> Option<f64> {
        self.ticks_per_message().map(|ticks| TICKS_PER_SECOND / f64::from(ticks))
    }
}

/// Period and skip factor nearest to a rate (Hz): the period stays within the 225 to 11520 ticks that a unit takes.
pub fn period_and_skip(rate: f64) -> Option<(u16, u16)> {
    if !(0.01..=512.0).contains(&rate) {
        return None;
    }
    let ticks = (TICKS_PER_SECOND / rate).round().max(225.0);
    let divisor = (ticks / 11_520.0).ceil().max(1.0);
    Some(((ticks / divisor).round() as u16, (divisor - 1.0) as u16))
}

/// One entry of a newer unit's output configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct OutputEntry {
    /// What.
    pub id: u16,
    /// How often, Hz; FFFF for what comes with every message.
    pub rate: u16,
}

/// Most entries that an output configuration takes.
pub const MAX_OUTPUTS: usize = 32;

/// A newer unit's output configuration.
///
/// # Errors
/// [`DecodeError::Length`] where the data are no list of at most 32 four-byte entries.
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

/// The data of a SetOutputConfiguration message.
pub fn output_configuration_to_data(entries: &[OutputEntry]) -> Vec<u8> {
    let bytes = |e: &OutputEntry| [e.id.to_be_bytes(), e.rate.to_be_bytes()];
    entries.iter().take(MAX_OUTPUTS).flat_map(bytes).flatten().collect()
}

/// A product code or another text of at most 20 characters; its padding varies and is taken off.
pub fn text_from_data(data: &[u8]) -> String {
    data.iter()
        .map(|&b| if (0x20..0x7F).contains(&b) { char::from(b) } else { ' ' })
        .collect::<String>()
        .trim()
        .to_owned()
}

/// A firmware revision: major.minor.revision (three bytes, and eight more on newer units).
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
