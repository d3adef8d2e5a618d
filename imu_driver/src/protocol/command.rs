//! The configuration messages, all of them: what a host may say, and what the answers mean.

use super::{
    DecodeError, DeviceError, Frame, MessageId, Utc,
    configuration::{Configuration, DeviceId, OutputEntry, output_configuration_to_data},
    frame::frame,
    legacy::{OutputMode, OutputSettings, read_utc, write_utc},
    message::{baud_code, baud_from_code},
    number::Reader,
};

/// A message to a unit. Where a setting is an `Option`, `None` asks for it.
#[derive(Clone, Debug, PartialEq)]
pub enum Command {
    /// Answers WakeUp within 0.5 s: go to the config state.
    WakeUpAck,
    /// To the config state.
    GoToConfig,
    /// To the measurement state.
    GoToMeasurement,
    /// Start anew; in both states.
    Reset,
    /// Which unit?
    ReqDeviceId,
    /// Which product?
    ReqProductCode,
    /// Which hardware?
    ReqHardware,
    /// Which firmware?
    ReqFirmware,
    /// The 118 bytes.
    ReqConfiguration,
    /// How long are the data of an MTData message?
    ReqDataLength,
    /// Send one data message now.
    ReqData,
    /// Sampling period, ticks of 1/115200 s.
    Period(Option<u16>),
    /// Samples left out between two messages.
    OutputSkipFactor(Option<u16>),
    /// What a legacy unit sends.
    OutputMode(Option<OutputMode>),
    /// How it writes it.
    OutputSettings(Option<OutputSettings>),
    /// What a newer unit sends.
    OutputConfiguration(Option<Vec<OutputEntry>>),
    /// Baud rate, in force after a reset; one that has no code is asked as 115200.
    BaudRate(Option<u32>),
    /// What the unit does after an error.
    ErrorMode(Option<u16>),
    /// A number of the user's own.
    LocationId(Option<u16>),
    /// All settings back to the factory's.
    RestoreFactory,
    /// 0 stores, 1 resets the heading, 3 the object, 4 the alignment.
    ResetOrientation(u16),
    /// Estimate the gyroscopes' bias for so many seconds of rest.
    SetNoRotation(u16),
    /// Date and time.
    Utc(Option<Utc>),
}

impl Command {
    /// Its identifier.
    pub const fn message(&self) -> MessageId {
        match self {
            Self::WakeUpAck => MessageId::WAKE_UP_ACK,
            Self::GoToConfig => MessageId::GO_TO_CONFIG,
            Self::GoToMeasurement => MessageId::GO_TO_MEASUREMENT,
            Self::Reset => MessageId::RESET,
            Self::ReqDeviceId => MessageId::REQ_DEVICE_ID,
            Self::ReqProductCode => MessageId::REQ_PRODUCT_CODE,
            Self::ReqHardware => MessageId::REQ_HARDWARE,
            Self::ReqFirmware => MessageId::REQ_FIRMWARE,
            Self::ReqConfiguration => MessageId::REQ_CONFIGURATION,
            Self::ReqDataLength => MessageId::REQ_DATA_LENGTH,
            Self::ReqData => MessageId::REQ_DATA,
            Self::Period(_) => MessageId::PERIOD,
            Self::OutputSkipFactor(_) => MessageId::OUTPUT_SKIP_FACTOR,
            Self::OutputMode(_) => MessageId::OUTPUT_MODE,
            Self::OutputSettings(_) => MessageId::OUTPUT_SETTINGS,
            Self::OutputConfiguration(_) => MessageId::OUTPUT_CONFIGURATION,
            Self::BaudRate(_) => MessageId::BAUD_RATE,
            Self::ErrorMode(_) => MessageId::ERROR_MODE,
            Self::LocationId(_) => MessageId::LOCATION_ID,
            Self::RestoreFactory => MessageId::RESTORE_FACTORY,
            Self::ResetOrientation(_) => MessageId::RESET_ORIENTATION,
            Self::SetNoRotation(_) => MessageId::SET_NO_ROTATION,
            Self::Utc(_) => MessageId::UTC,
        }
    }

    /// Its data: empty for a request.
    pub fn data(&self) -> Vec<u8> {
        let word = |value: u16| value.to_be_bytes().to_vec();
        match self {
            Self::Period(v) | Self::OutputSkipFactor(v) | Self::ErrorMode(v) | Self::LocationId(v) => {
                v.map(word).unwrap_or_default()
            }
            Self::OutputMode(v) => v.map(|m| word(m.0)).unwrap_or_default(),
            Self::OutputSettings(v) => v.map(|s| s.0.to_be_bytes().to_vec()).unwrap_or_default(),
            Self::OutputConfiguration(v) => {
                v.as_deref().map(output_configuration_to_data).unwrap_or_default()
            }
            Self::BaudRate(v) => v.map(|b| vec![baud_code(b).unwrap_or(2)]).unwrap_or_default(),
            Self::ResetOrientation(v) | Self::SetNoRotation(v) => word(*v),
            Self::Utc(Some(utc)) => {
                let mut data = Vec::with_capacity(12);
                write_utc(utc, &mut data);
                data
            }
            _ => Vec::new(),
        }
    }

    /// The whole frame, from the master.
    pub fn frame(&self) -> Vec<u8> {
        frame(self.message(), &self.data())
    }
}

/// An answer of a unit; it borrows the frame's data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reply<'a> {
    /// It has just started.
    WakeUp,
    /// An acknowledgement that says nothing more: the setting was taken, the state changed.
    Done(MessageId),
    /// Which unit.
    DeviceId(DeviceId),
    /// Which product, ASCII; padding varies.
    ProductCode(&'a [u8]),
    /// Which hardware: major, minor.
    Hardware(u8, u8),
    /// Which firmware: major, minor, revision.
    Firmware(u8, u8, u8),
    /// The configuration.
    Configuration(Configuration),
    /// Length of MTData's data.
    DataLength(u16),
    /// Ticks of 1/115200 s.
    Period(u16),
    /// Samples left out between two messages.
    OutputSkipFactor(u16),
    /// What a legacy unit sends.
    OutputMode(OutputMode),
    /// How it writes it.
    OutputSettings(OutputSettings),
    /// What a newer unit really sends: four-byte entries, see
    /// [`output_configuration_from_data`](super::configuration::output_configuration_from_data).
    OutputConfiguration(&'a [u8]),
    /// Baud rate in flash; `None` for a code that is not in the manual.
    BaudRate(Option<u32>),
    /// What it does after an error.
    ErrorMode(u16),
    /// The user's number.
    LocationId(u16),
    /// Date and time.
    Utc(Utc),
    /// A complaint, and what it adds to it.
    Error(DeviceError, &'a [u8]),
}

impl<'a> Reply<'a> {
    /// What a frame answers; `Ok(None)` for data and for messages that are not known.
    ///
    /// # Errors
    /// [`DecodeError::Length`] where a known answer is too short.
    pub fn from_frame(frame: &Frame<'a>) -> Result<Option<Self>, DecodeError> {
        if frame.message == MessageId::REQ_CONFIGURATION.ack() {
            return Configuration::from_data(frame.data).map(Self::Configuration).map(Some);
        }
        let expected = match frame.message {
            m if m == MessageId::REQ_DEVICE_ID.ack() || m == MessageId::OUTPUT_SETTINGS.ack() => 4,
            m if m == MessageId::REQ_FIRMWARE.ack() => 3,
            m if m == MessageId::UTC.ack() => 12,
            MessageId::ERROR => 1,
            _ => 2,
        };
        Self::read(frame).ok_or(DecodeError::Length { found: frame.data.len(), expected })
    }

    /// `None` where the data are too short, `Some(None)` where the message is no answer.
    fn read(frame: &Frame<'a>) -> Option<Option<Self>>
    where
        Self: 'a,
    {
        let r = &mut Reader::new(frame.data);
        let message = frame.message;
        if message.is_data() {
            return Some(None);
        }
        Some(Some(match message {
            MessageId::WAKE_UP => Self::WakeUp,
            MessageId::ERROR => Self::Error(DeviceError(r.u8()?), r.rest()),
            m => {
                let request = MessageId(m.0.wrapping_sub(1));
                match request {
                    _ if m.0 & 1 == 0 || request.name().is_none() => return Some(None),
                    MessageId::REQ_DEVICE_ID => Self::DeviceId(DeviceId::from_data(frame.data)?),
                    MessageId::REQ_PRODUCT_CODE => Self::ProductCode(frame.data),
                    MessageId::REQ_HARDWARE => Self::Hardware(r.u8()?, r.u8()?),
                    MessageId::REQ_FIRMWARE => Self::Firmware(r.u8()?, r.u8()?, r.u8()?),
                    MessageId::REQ_DATA_LENGTH => Self::DataLength(r.u16()?),
                    MessageId::OUTPUT_CONFIGURATION => Self::OutputConfiguration(frame.data),
                    // The acknowledgement of a setting is empty, the answer to a request is not.
                    _ if frame.data.is_empty() => Self::Done(request),
                    MessageId::PERIOD => Self::Period(r.u16()?),
                    MessageId::OUTPUT_SKIP_FACTOR => Self::OutputSkipFactor(r.u16()?),
                    MessageId::OUTPUT_MODE => Self::OutputMode(OutputMode(r.u16()?)),
                    MessageId::OUTPUT_SETTINGS => Self::OutputSettings(OutputSettings(r.u32()?)),
                    MessageId::BAUD_RATE => Self::BaudRate(baud_from_code(r.u8()?)),
                    MessageId::ERROR_MODE => Self::ErrorMode(r.u16()?),
                    MessageId::LOCATION_ID => Self::LocationId(r.u16()?),
                    MessageId::UTC => Self::Utc(read_utc(r)?),
                    other => Self::Done(other),
                }
            }
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::FrameParser;

    fn reply_to(command: &Command, data: &[u8]) -> String {
        let bytes = frame(command.message().ack(), data);
        let mut told = String::new();
        FrameParser::new().parse(&bytes, |f| told = format!("{:?}", Reply::from_frame(&f)));
        told
    }

    #[test]
    fn every_setting_comes_back_as_it_was_sent() {
        let utc =
            Utc { nanosecond: 1, year: 2026, month: 11, day: 21, hour: 1, minute: 2, second: 3, flags: 7 };
        for (command, expected) in [
            (Command::Period(Some(1152)), "Period(1152)"),
            (Command::OutputSkipFactor(Some(0xFFFF)), "OutputSkipFactor(65535)"),
            (Command::OutputMode(Some(OutputMode(6))), "OutputMode(OutputMode(6))"),
            (Command::OutputSettings(Some(OutputSettings(1))), "OutputSettings(OutputSettings(1))"),
            (Command::BaudRate(Some(921_600)), "BaudRate(Some(921600))"),
            (Command::ErrorMode(Some(1)), "ErrorMode(1)"),
            (Command::LocationId(Some(9)), "LocationId(9)"),
            (
                Command::OutputConfiguration(Some(vec![OutputEntry { id: 0x1020, rate: 0xFFFF }])),
                "OutputConfiguration([16, 32, 255, 255])",
            ),
            (Command::Utc(Some(utc)), "year: 2026"),
        ] {
            let told = reply_to(&command, &command.data());
            assert!(told.contains(expected), "{told} {expected}");
            assert_eq!(command.frame()[2], command.message().0);
        }
    }

    #[test]
    fn requests_are_empty_and_acknowledgements_are_told_from_answers() {
        for command in [
            Command::WakeUpAck,
            Command::GoToConfig,
            Command::GoToMeasurement,
            Command::Reset,
            Command::ReqDeviceId,
            Command::Period(None),
            Command::OutputMode(None),
            Command::OutputConfiguration(None),
            Command::Utc(None),
            Command::RestoreFactory,
        ] {
            assert_eq!(command.frame().len(), 5);
        }
        assert_eq!(reply_to(&Command::Period(None), &[]), "Ok(Some(Done(04 (SetPeriod))))");
        assert_eq!(reply_to(&Command::RestoreFactory, &[]), "Ok(Some(Done(0E (RestoreFactoryDef))))");
        assert_eq!(
            reply_to(&Command::ReqDeviceId, &[0, 0x30, 1, 2]),
            "Ok(Some(DeviceId(DeviceId(3145986))))"
        );
        assert_eq!(reply_to(&Command::ReqFirmware, &[2, 6, 0]), "Ok(Some(Firmware(2, 6, 0)))");
        assert!(reply_to(&Command::ReqFirmware, &[2]).contains("expected: 3"));
        let mut told = String::new();
        let error = [frame(MessageId::ERROR, &[0x29, 1]), frame(MessageId::MT_DATA, &[1])].concat();
        FrameParser::new().parse(&error, |f| told += &format!("{:?} ", Reply::from_frame(&f)));
        assert_eq!(told, "Ok(Some(Error(DeviceError(41), [1]))) Ok(None) ");
    }
}
