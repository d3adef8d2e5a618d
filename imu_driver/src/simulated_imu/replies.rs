//! Replies of the simulated IMU to requests.

use super::model::{SimulatedImu, State};
use crate::protocol::{
    MessageId, OutputMode, OutputSettings,
    configuration::{output_configuration_from_data, output_configuration_to_data},
    message::baud_from_code,
};
use rig_model::Stamp;

// Error codes of the manual.
const PERIOD_OUT_OF_RANGE: u8 = 0x03;
const INVALID_MESSAGE: u8 = 0x04;
const BAUD_UNSUPPORTED: u8 = 0x20;
const PARAMETER_INVALID: u8 = 0x21;
const TOO_MUCH_DATA: u8 = 0x29;

impl SimulatedImu {
    pub(super) fn answer(&mut self, message: MessageId, data: &[u8], now: Stamp) {
        let soon = now.plus_seconds(self.config.ack_delay);
        match (self.state, message) {
            (_, MessageId::GO_TO_CONFIG) => {
                let late = now.plus_seconds(self.config.config_ack_delay);
                if matches!(self.state, State::Measuring { .. }) {
                    self.config_at = Some(self.config_at.unwrap_or(late));
                } else {
                    self.state = State::Config;
                }
                self.reply(message.ack(), &[], late);
            }
            (_, MessageId::RESET) => {
                self.reply(message.ack(), &[], soon);
                self.wire.baud = self.config.baud;
                self.counter = self.config.first_counter;
                self.state = State::Booting { until: soon.plus_seconds(self.config.boot) };
            }
            (State::Waking { .. }, MessageId::WAKE_UP_ACK) => self.state = State::Config,
            (State::Config, _) => match self.config_state(message, data, now) {
                Ok(reply) => self.reply(message.ack(), &reply, soon),
                Err(code) => self.reply(MessageId::ERROR, &[code], soon),
            },
            // While measuring, other requests are ignored.
            _ => {}
        }
    }

    fn config_state(&mut self, message: MessageId, data: &[u8], now: Stamp) -> Result<Vec<u8>, u8> {
        match message {
            MessageId::REQ_DEVICE_ID => Ok((self.config.device_id.0 as u32).to_be_bytes().to_vec()),
            MessageId::REQ_PRODUCT_CODE => {
                Ok(format!("{:<20}", self.config.product_code).into_bytes())
            }
            MessageId::REQ_FIRMWARE => Ok(self.config.firmware.to_vec()),
            MessageId::REQ_CONFIGURATION => Ok(self.config.configuration().to_data()),
            MessageId::GO_TO_MEASUREMENT => {
                if !self.line_carries_stream() {
                    return Err(TOO_MUCH_DATA);
                }
                // The acknowledgement precedes the first sample.
                let since = now.plus_seconds(self.config.ack_delay + 0.005);
                self.state = State::Measuring { since, next: 0 };
                Ok(vec![])
            }
            MessageId::OUTPUT_CONFIGURATION => {
                if !data.is_empty() {
                    self.set(message, data)?;
                }
                let entries = self.config.outputs.as_ref().ok_or(INVALID_MESSAGE)?;
                Ok(output_configuration_to_data(entries))
            }
            _ => self.set(message, data).map(|()| vec![]),
        }
    }

    /// Writes a setting to flash.
    fn set(&mut self, message: MessageId, data: &[u8]) -> Result<(), u8> {
        let modern = self.config.outputs.is_some();
        let word = <[u8; 2]>::try_from(data).map(u16::from_be_bytes).or(Err(PARAMETER_INVALID));
        match message {
            MessageId::PERIOD => {
                let period = word?;
                if !(225..=11_520).contains(&period) {
                    return Err(PERIOD_OUT_OF_RANGE);
                }
                self.config.period = period;
            }
            MessageId::OUTPUT_SKIP_FACTOR if !modern => self.config.skip = word?,
            MessageId::OUTPUT_MODE if !modern => {
                let mode = OutputMode::from_bits_retain(word?);
                let exclusive = OutputMode::CALIBRATED | OutputMode::ORIENTATION;
                if mode.contains(OutputMode::RAW_INERTIAL) && mode.intersects(exclusive) {
                    return Err(PARAMETER_INVALID);
                }
                self.config.format.mode = mode;
            }
            MessageId::OUTPUT_SETTINGS if !modern => {
                let bits = <[u8; 4]>::try_from(data).or(Err(PARAMETER_INVALID))?;
                let settings = OutputSettings::from_bits_retain(u32::from_be_bytes(bits));
                if settings.identity().is_none() {
                    return Err(PARAMETER_INVALID);
                }
                self.config.format.settings = settings;
            }
            MessageId::OUTPUT_CONFIGURATION if modern => {
                let entries = output_configuration_from_data(data).or(Err(PARAMETER_INVALID))?;
                self.config.outputs = Some(entries);
            }
            MessageId::BAUD_RATE => {
                let &[code] = data else { return Err(PARAMETER_INVALID) };
                self.config.baud = baud_from_code(code).ok_or(BAUD_UNSUPPORTED)?;
            }
            _ => return Err(INVALID_MESSAGE),
        }
        self.flash_writes += 1;
        Ok(())
    }
}
