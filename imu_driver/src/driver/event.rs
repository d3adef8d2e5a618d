//! Events of the driver, for the log and the diagnostics of its shell.

use crate::{
    clock_fit::MAX_DRIFT,
    protocol::{Configuration, DeviceError, DeviceId, MessageId, OutputEntry},
};
use std::fmt;
use thiserror::Error;

/// Severity of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// Normal operation.
    Info,
    /// Something is wrong, but samples are available.
    Warning,
    /// No samples are available.
    Error,
}

/// Identity and configuration of the device.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identity {
    /// Device identifier.
    pub device_id: DeviceId,
    /// Product code; empty if unknown.
    pub product_code: String,
    /// Firmware revision; empty if unknown.
    pub firmware: String,
    /// Configuration as read from a legacy device.
    pub configuration: Option<Configuration>,
    /// Output configuration as read from an MTi-1, 10, 100, 600.
    pub outputs: Option<Vec<OutputEntry>>,
    /// Baud rate at which it was found.
    pub baud: u32,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name =
            if self.product_code.is_empty() { self.device_id.family() } else { &self.product_code };
        write!(f, "{name} {}", self.device_id)?;
        if !self.firmware.is_empty() {
            write!(f, ", firmware {}", self.firmware)?;
        }
        write!(f, ", {} baud", self.baud)
    }
}

/// Event of the driver.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Event {
    /// The port could not be opened.
    #[error("{reason}; next attempt in {pause:.1} s")]
    PortMissing {
        /// Reason, with the name of the port.
        reason: String,
        /// Time until the next attempt, s.
        pause: f64,
    },
    /// The open port was lost, with the reason.
    #[error("the port was lost ({0}); reconnect the adapter")]
    PortLost(String),
    /// The port was opened at this baud rate.
    #[error("port open at {0} baud")]
    PortOpened(u32),
    /// No device answers on the open port.
    #[error("{}", no_answer(bauds, *heard_at, *garbage))]
    NoAnswer {
        /// Baud rates tried.
        bauds: Vec<u32>,
        /// Baud rate at which valid frames were received.
        heard_at: Option<u32>,
        /// Bytes are received, but no valid frames (wrong baud rate, other device).
        garbage: bool,
    },
    /// No message was received for this time, s.
    #[error("no message for {0:.1} s; querying the IMU")]
    Silent(f64),
    /// A device answered.
    #[error("found {0}")]
    Found(Identity),
    /// The device has started (power-up, brown-out, reset).
    #[error("the IMU has started")]
    WokeUp,
    /// This setting was written to the flash of the device.
    #[error("{0}: written to the IMU")]
    Set(MessageId),
    /// The device rejected a setting or a request.
    #[error("the IMU rejected {what}: {error}")]
    Rejected {
        /// The message.
        what: MessageId,
        /// Reason.
        error: DeviceError,
    },
    /// The device does not answer this request.
    #[error("the IMU does not answer {0}; configuring it again")]
    Unanswered(MessageId),
    /// A setting read back differs from the written one; the driver uses the former.
    #[error("{what}: {wanted} was written, but the IMU has {found}, which is used")]
    NotApplied {
        /// The setting.
        what: MessageId,
        /// Value written.
        wanted: String,
        /// Value read back.
        found: String,
    },
    /// The line on which the device was found is too slow for the settings, with numbers; none was
    /// written.
    #[error("no setting was written: {0}")]
    LineTooSlow(String),
    /// The device entered the measurement state.
    #[error("measuring: {0}")]
    Measuring(Identity),
    /// The device sends on request only: no samples will come.
    #[error(
        "the IMU sends on request only (OutputSkipFactor FFFF); \
         let the driver set its rate (leave_settings: false)"
    )]
    OnRequestOnly,
    /// The device reported an error while measuring.
    #[error("the IMU reports {0}")]
    DeviceFault(DeviceError),
    /// Messages could not be decoded for this reason; the configuration is read again.
    #[error("messages do not decode: {0}")]
    Unreadable(String),
    /// The messages lack acceleration or angular velocity.
    #[error(
        "the messages lack acceleration or angular velocity; \
         let the driver set the outputs (leave_settings: false)"
    )]
    NoInertialData,
    /// This number of messages is missing, according to the counter, or to the time if there is
    /// none.
    #[error("{0} messages lost")]
    Lost(u64),
    /// The clock of the device restarted.
    #[error("the clock of the IMU restarted")]
    DeviceRestarted,
    /// The host's clock was set by this time (new minus old), s; stamps follow at once.
    #[error("the host's clock was set by {0:+.3} s")]
    ClockSet(f64),
    /// The offset of the clocks of device and host changed by this time, s.
    #[error(
        "samples arrive {0:+.3} s later than the clock of the IMU indicates: \
         one of the two clocks was set, or its data are delayed"
    )]
    ClockStepped(f64),
    /// The clocks of device and host drift by more than [`MAX_DRIFT`]; reported repeatedly.
    #[error(
        "the clocks of IMU and host drift by more than {:.0} ppm, so that stamps are wrong: \
         let the driver set the rate (leave_settings: false), and check whether the host's clock \
         is being corrected (chrony, ntpd)",
        MAX_DRIFT * 1e6
    )]
    DriftExceeded,
}

fn no_answer(bauds: &[u32], heard_at: Option<u32>, garbage: bool) -> String {
    if let Some(baud) = heard_at {
        return format!(
            "valid messages at {baud} baud, but no answer to requests: set two_stop_bits: true \
             (an MTx from before 2008 requires it), or check the line from host to IMU"
        );
    }
    let bauds: Vec<String> = bauds.iter().map(u32::to_string).collect();
    let remedy = if garbage {
        "the bytes received contain no valid message: \
         set the baud rate (baud: 0 searches) and check the device on this port"
    } else {
        "check power supply and port (an MTx from before 2008 needs two_stop_bits: true)"
    };
    format!("no IMU answers at {} baud; {remedy}", bauds.join(", "))
}

impl Event {
    /// Severity of the event.
    pub fn severity(&self) -> Severity {
        match self {
            Self::PortOpened(_) | Self::Found(_) | Self::Set(_) | Self::Measuring(_) => {
                Severity::Info
            }
            Self::PortMissing { .. }
            | Self::PortLost(_)
            | Self::NoAnswer { .. }
            | Self::Silent(_)
            | Self::LineTooSlow(_)
            | Self::OnRequestOnly
            | Self::NoInertialData => Severity::Error,
            _ => Severity::Warning,
        }
    }
}
