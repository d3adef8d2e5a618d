//! Message identifiers, error codes and baud rate codes.

use std::fmt;

/// Message identifier (MID).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MessageId(pub u8);

macro_rules! messages {
    ($($(#[$doc:meta])* $name:ident = $mid:literal, $text:literal;)*) => {
        impl MessageId {
            $($(#[$doc])* pub const $name: Self = Self($mid);)*
        }

        /// Name in the manual.
        impl fmt::Display for MessageId {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                match self.0 {
                    $($mid => f.write_str($text),)*
                    other => write!(f, "message {other:02X}"),
                }
            }
        }
    };
}

messages! {
    /// Requests the device identifier.
    REQ_DEVICE_ID = 0x00, "ReqDID";
    /// Sampling period, u16, ticks of 1/115200 s.
    PERIOD = 0x04, "SetPeriod";
    /// Requests the Configuration (118 bytes).
    REQ_CONFIGURATION = 0x0C, "ReqConfiguration";
    /// Enters the measurement state.
    GO_TO_MEASUREMENT = 0x10, "GoToMeasurement";
    /// Requests the firmware revision.
    REQ_FIRMWARE = 0x12, "ReqFWRev";
    /// Baud rate as a code, effective after a reset.
    BAUD_RATE = 0x18, "SetBaudrate";
    /// Requests the product code.
    REQ_PRODUCT_CODE = 0x1C, "ReqProductCode";
    /// Enters the config state.
    GO_TO_CONFIG = 0x30, "GoToConfig";
    /// Data of a legacy device.
    MT_DATA = 0x32, "MTData";
    /// Data of the MTi-1, 10, 100, 600 series.
    MT_DATA2 = 0x36, "MTData2";
    /// From the device after its start.
    WAKE_UP = 0x3E, "WakeUp";
    /// Answer to WakeUp: enter the config state.
    WAKE_UP_ACK = 0x3F, "WakeUpAck";
    /// Restarts the device.
    RESET = 0x40, "Reset";
    /// Error from the device, its code first.
    ERROR = 0x42, "Error";
    /// Output configuration of the MTi-1, 10, 100, 600 series.
    OUTPUT_CONFIGURATION = 0xC0, "SetOutputConfiguration";
    /// Data that a legacy device outputs.
    OUTPUT_MODE = 0xD0, "SetOutputMode";
    /// Format of the data that a legacy device outputs.
    OUTPUT_SETTINGS = 0xD2, "SetOutputSettings";
    /// Number of samples omitted between two messages.
    OUTPUT_SKIP_FACTOR = 0xD4, "SetOutputSkipFactor";
}

impl MessageId {
    /// Identifier of the acknowledgement.
    pub const fn ack(self) -> Self {
        Self(self.0.wrapping_add(1))
    }

    /// Whether the message is a data message rather than a reply.
    pub fn is_data(self) -> bool {
        self == Self::MT_DATA || self == Self::MT_DATA2
    }
}

/// Code of an Error message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct DeviceError(pub u8);

impl fmt::Display for DeviceError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let meaning = match self.0 {
            0x03 => "the period is out of range",
            0x04 => "the message is invalid or not supported by this device",
            0x1E => "timer overflow",
            0x20 => "the baud rate is not supported",
            0x21 => "a parameter is invalid",
            0x28 => "device error",
            0x29 => {
                "more data than the line can carry; \
                 lower the rate, disable outputs, or raise the baud rate"
            }
            _ => "not documented",
        };
        write!(f, "error {:02X}: {meaning}", self.0)
    }
}

/// Baud rates and their codes.
const BAUDS: [(u32, u8); 15] = [
    (921_600, 0x80),
    (460_800, 0x00),
    (230_400, 0x01),
    (115_200, 0x02),
    (76_800, 0x03),
    (57_600, 0x04),
    (38_400, 0x05),
    (28_800, 0x06),
    (19_200, 0x07),
    (14_400, 0x08),
    (9_600, 0x09),
    (4_800, 0x0B),
    (2_000_000, 0x0C),
    (3_500_000, 0x0E),
    (4_000_000, 0x0D),
];

/// Baud rates in the order of the search.
pub const BAUD_SCAN: [u32; 8] = [115_200, 921_600, 460_800, 230_400, 57_600, 38_400, 19_200, 9_600];

/// Code of a baud rate; `None` if it has none.
pub fn baud_code(baud: u32) -> Option<u8> {
    BAUDS.iter().find(|(b, _)| *b == baud).map(|(_, code)| *code)
}

/// Baud rate of a code; `None` if the code is not documented.
pub fn baud_from_code(code: u8) -> Option<u32> {
    // 921600 has two codes.
    let code = if code == 0x0A { 0x80 } else { code };
    BAUDS.iter().find(|(_, c)| *c == code).map(|(baud, _)| *baud)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_and_errors_have_names() {
        assert_eq!(MessageId::OUTPUT_MODE.to_string(), "SetOutputMode");
        assert_eq!(MessageId(0x77).to_string(), "message 77");
        assert!(DeviceError(0x29).to_string().contains("line can carry"));
    }

    #[test]
    fn baud_codes_round_trip() {
        for (baud, code) in BAUDS {
            assert_eq!((baud_code(baud), baud_from_code(code)), (Some(code), Some(baud)));
        }
        assert_eq!(baud_from_code(0x0A), Some(921_600));
        assert_eq!((baud_code(12_345), baud_from_code(0x55)), (None, None));
        assert!(BAUD_SCAN.iter().all(|b| baud_code(*b).is_some()));
    }
}
