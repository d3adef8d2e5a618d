//! Configuration of the driver, and the device settings that follow from it.

use crate::protocol::{
    LegacyFormat, NumberFormat, OutputEntry, OutputMode, OutputSettings,
    configuration::period_and_skip,
    message::{BAUD_SCAN, baud_code, baud_from_code},
    mtdata2::{data_length, xdi},
};

ros_parameters::parameters! {
    /// Configuration of the driver; each row is a parameter of the node.
    #[derive(PartialEq)]
    pub struct DriverConfig {
        /// Baud rate; 0 searches at the usual ones.
        baud: u32 = 115200, range(0..=4000000);
        /// Send two stop bits, which an MTx from before 2008 requires.
        two_stop_bits: bool = false;
        /// Sampling rate.
        rate: f64 = 100.0, unit("Hz"), range(0.01..=512.0);
        /// Output the orientation estimated by the IMU.
        orientation: bool = true, name("outputs.orientation");
        /// Output the magnetic field and publish imu/mag.
        magnetic_field: bool = true, name("outputs.magnetic_field");
        /// Output the temperature and publish imu/temperature.
        temperature: bool = false, name("outputs.temperature");
        /// Output the status bits: self-test, filter, clipping.
        status: bool = false, name("outputs.status");
        /// Number format of the messages: float32, fp12.20, fp16.32 or double.
        number_format: NumberFormat = NumberFormat::Float32, name("outputs.number_format");
        /// Do not change the settings of the IMU.
        leave_settings: bool = false;
        /// Time from a sample to the arrival of its last bit; negative: transmission time at the
        /// baud rate.
        transmission_delay: f64 = -1.0, unit("s"), range(-1.0..=1.0);
        /// Longest pause between two attempts to find the IMU.
        longest_pause: f64 = 1.0, unit("s"), range(0.1..=60.0);
        plain {
            /// Only set the device to the baud rate of this code, followed by a reset, if that
            /// carries the messages.
            set_baud: Option<u8> = None;
            /// Time until late arrivals count as a clock step, s.
            step_patience: f64 = 1.0;
        }
    }
    check(config) { config.check() }
}

impl DriverConfig {
    /// Checks all values.
    ///
    /// # Errors
    /// The first invalid value, and the valid ones.
    pub fn check(&self) -> Result<(), String> {
        let (rate, baud) = (self.rate, self.baud);
        if period_and_skip(rate).is_none() {
            return Err(format!("a rate of {rate} Hz is out of range; use 0.01 to 512 Hz"));
        }
        if baud == 0 {
            return Ok(());
        }
        if baud_code(baud).is_none() {
            let scanned = BAUD_SCAN.map(|b| b.to_string()).join(", ");
            return Err(format!("{baud} baud is not supported; use {scanned}, or 0 to search"));
        }
        // MTData2 is longer, but which device answers is not known yet.
        self.check_line(baud, false)
    }

    /// Checks that a line of `baud`, or of the baud rate to set, carries the messages (MTData2 or
    /// legacy ones), unless the settings of the IMU remain.
    pub(super) fn check_line(&self, baud: u32, mtdata2: bool) -> Result<(), String> {
        let baud = self.set_baud.and_then(baud_from_code).unwrap_or(baud);
        let bytes = 5 + match mtdata2 {
            true => data_length(&self.outputs()),
            false => self.legacy_format().data_length(),
        };
        let rate = self.rate;
        let needed = (bytes as f64 * 10.0 * rate).ceil() as u32;
        if needed > baud && !self.leave_settings {
            return Err(format!(
                "{rate} Hz of {bytes} bytes need {needed} baud, but the line has {baud}; lower \
                 the rate, disable outputs, or set a higher baud rate with `volant imu configure \
                 --set-baud`"
            ));
        }
        Ok(())
    }

    /// Baud rates in the order of the search.
    pub(super) fn bauds(&self) -> Vec<u32> {
        if self.baud == 0 { BAUD_SCAN.to_vec() } else { vec![self.baud] }
    }

    /// Baud rate to open the port with.
    pub fn first_baud(&self) -> u32 {
        if self.baud == 0 { BAUD_SCAN[0] } else { self.baud }
    }

    /// Format to set on a legacy device; always with calibrated data and counter.
    pub fn legacy_format(&self) -> LegacyFormat {
        let mut mode = OutputMode::CALIBRATED;
        mode.set(OutputMode::ORIENTATION, self.orientation);
        mode.set(OutputMode::TEMPERATURE, self.temperature);
        mode.set(OutputMode::STATUS, self.status);
        let mut settings = OutputSettings::COUNTER.with_number_format(self.number_format);
        settings.set(OutputSettings::NO_MAGNETIC_FIELD, !self.magnetic_field);
        LegacyFormat { mode, settings }
    }

    /// Output configuration to set on an MTi-1, 10, 100, 600: counter and SampleTimeFine with every
    /// message.
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
            // The temperature changes slowly.
            outputs.push(OutputEntry { id: xdi::TEMPERATURE | format, rate: 1 });
        }
        if self.status {
            outputs.push(with_all(xdi::STATUS_WORD));
        }
        outputs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_the_standard_format() {
        let config = DriverConfig::default();
        assert_eq!(config.legacy_format(), LegacyFormat::STANDARD);
        assert_eq!(config.check(), Ok(()));
    }

    #[test]
    fn errors_name_the_invalid_value() {
        let config = DriverConfig { rate: 400.0, ..DriverConfig::default() };
        let error = config.check().unwrap_err();
        assert!(error.contains("236000 baud"), "{error}");
        assert!(DriverConfig { rate: f64::NAN, ..DriverConfig::default() }.check().is_err());
        let error = DriverConfig { baud: 12_345, ..config }.check().unwrap_err();
        assert!(error.contains("12345") && error.contains("115200"), "{error}");
    }
}
