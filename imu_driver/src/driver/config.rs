//! What the driver is asked to do, and what that means for the unit's settings.

use crate::{
    clock_fit::ClockFitConfig,
    protocol::{
        LegacyFormat, NumberFormat, OutputEntry, OutputMode, OutputSettings,
        configuration::{TICKS_PER_SECOND, period_and_skip},
        message::BAUD_SCAN,
        mtdata2::xdi,
    },
};
use thiserror::Error;

/// What the driver is asked to do.
#[derive(Clone, Debug, PartialEq)]
pub struct DriverConfig {
    /// Baud rate; `None`: the unit is looked for at the usual ones.
    pub baud: Option<u32>,
    /// Samples per second.
    pub rate: f64,
    /// Ask for the unit's own attitude.
    pub orientation: bool,
    /// Ask for the magnetic field.
    pub magnetic_field: bool,
    /// Ask for the temperature.
    pub temperature: bool,
    /// Ask for the status bits.
    pub status: bool,
    /// How numbers are to be written.
    pub number_format: NumberFormat,
    /// Change nothing in the unit: take its configuration as it is.
    pub leave_settings: bool,
    /// Set the unit to the baud rate of this code, and nothing else: it comes into force by a reset.
    pub set_baud: Option<u8>,
    /// Send two stop bits: an MTx from before 2008 hears nothing else.
    pub two_stop_bits: bool,
    /// From a sample to the arrival of its last bit, s; `None`: the time that the bytes take at the baud rate.
    pub transmission_delay: Option<f64>,
    /// The longest pause between two attempts to find the unit again, s.
    pub longest_pause: f64,
    /// How stamps are made.
    pub clock: ClockFitConfig,
}

impl Default for DriverConfig {
    fn default() -> Self {
        Self {
            baud: Some(115_200),
            rate: 100.0,
            orientation: true,
            magnetic_field: true,
            temperature: false,
            status: false,
            number_format: NumberFormat::Float32,
            leave_settings: false,
            set_baud: None,
            two_stop_bits: false,
            transmission_delay: None,
            longest_pause: 1.0,
            clock: ClockFitConfig::default(),
        }
    }
}

/// A configuration that cannot be.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ConfigError {
    /// No unit does that.
    #[error("a rate of {rate} Hz is not possible; use 0.01 to 512 Hz")]
    Rate {
        /// As given.
        rate: f64,
    },
    /// Not a baud rate of these units.
    #[error("no unit talks at {baud} baud; use {}, or 0 to look for it", BAUD_SCAN.map(|b| b.to_string()).join(", "))]
    Baud {
        /// As given.
        baud: u32,
    },
    /// The line is too slow.
    #[error(
        "{rate} Hz of {bytes} bytes need {needed} baud, but the line has {baud}; lower the rate, leave outputs out, or set the unit to a higher baud rate with `volant imu configure --set-baud`"
    )]
    LineTooSlow {
        /// As given, Hz.
        rate: f64,
        /// Length of a message.
        bytes: usize,
        /// What would be needed.
        needed: u32,
        /// What there is.
        baud: u32,
    },
}

impl DriverConfig {
    /// Whether it can be.
    ///
    /// # Errors
    /// [`ConfigError`]: which of the values cannot.
    pub fn check(&self) -> Result<(), ConfigError> {
        if period_and_skip(self.rate).is_none() {
            return Err(ConfigError::Rate { rate: self.rate });
        }
        let Some(baud) = self.baud else {
            return Ok(());
        };
        if crate::protocol::message::baud_code(baud).is_none() {
            return Err(ConfigError::Baud { baud });
        }
        let bytes = self.legacy_format().data_length() + 5;
        let needed = (bytes as f64 * 10.0 * self.rate).ceil() as u32;
        if needed > baud && !self.leave_settings {
            return Err(ConfigError::LineTooSlow { rate: self.rate, bytes, needed, baud });
        }
        Ok(())
    }

    /// The rates at which the unit is looked for, best first.
    pub(super) fn bauds(&self) -> Vec<u32> {
        self.baud.map_or_else(|| BAUD_SCAN.to_vec(), |baud| vec![baud])
    }

    /// The format that a legacy unit is to send: always calibrated data and the counter.
    pub fn legacy_format(&self) -> LegacyFormat {
        let when = |wanted: bool, bit: u16| if wanted { bit } else { 0 };
        let mode = OutputMode::CALIBRATED
            | when(self.orientation, OutputMode::ORIENTATION)
            | when(self.temperature, OutputMode::TEMPERATURE)
            | when(self.status, OutputMode::STATUS);
        let settings = OutputSettings::COUNTER
            | (self.number_format.bits() << 8)
            | if self.magnetic_field { 0 } else { OutputSettings::NO_MAGNETIC_FIELD };
        LegacyFormat { mode: OutputMode(mode), settings: OutputSettings(settings) }
    }

    /// What a newer unit is to send: counter and SampleTimeFine with everything.
    pub fn outputs(&self) -> Vec<OutputEntry> {
        let rate = self.rate.round().clamp(1.0, 2000.0) as u16;
        let format = self.number_format.bits() as u16;
        let with_all = |id| OutputEntry { id, rate: u16::MAX };
        let number = |id| OutputEntry { id: id | format, rate };
        let mut outputs = vec![with_all(xdi::COUNTER), with_all(xdi::SAMPLE_TIME_FINE)];
        if self.orientation {
            outputs.push(number(xdi::QUATERNION));
        }
        outputs.extend([number(xdi::ACCELERATION), number(xdi::ANGULAR_VELOCITY)]);
        if self.magnetic_field {
            outputs.push(number(xdi::MAGNETIC_FIELD));
        }
        if self.temperature {
            // It changes slowly.
            outputs.push(OutputEntry { id: xdi::TEMPERATURE | format, rate: 1 });
        }
        if self.status {
            outputs.push(with_all(xdi::STATUS_WORD));
        }
        outputs
    }

    /// Period and skip factor; those of 100 Hz where the rate cannot be (which [`DriverConfig::check`] says).
    pub(super) fn period_and_skip(&self) -> (u16, u16) {
        period_and_skip(self.rate).unwrap_or(((TICKS_PER_SECOND / 100.0) as u16, 0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_standard_format_at_100_hz() {
        let config = DriverConfig::default();
        assert_eq!(config.legacy_format(), LegacyFormat::STANDARD);
        assert_eq!(config.period_and_skip(), (1152, 0));
        assert_eq!(config.check(), Ok(()));
    }

    #[test]
    fn what_cannot_be_is_named() {
        let config = DriverConfig { rate: 400.0, ..DriverConfig::default() };
        let error = config.check().unwrap_err().to_string();
        assert!(error.contains("236000 baud"), "{error}");
        assert!(DriverConfig { rate: f64::NAN, ..DriverConfig::default() }.check().is_err());
        let error = DriverConfig { baud: Some(12_345), ..config }.check().unwrap_err().to_string();
        assert!(error.contains("12345") && error.contains("115200"), "{error}");
    }
}
