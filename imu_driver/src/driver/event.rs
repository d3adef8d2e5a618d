//! Events of the driver, for the log and the diagnostics of its shell.

use super::ConfigError;
use crate::{
    clock_fit::MAX_DRIFT,
    protocol::{Configuration, DeviceError, DeviceId, MessageId, OutputEntry},
};
use std::fmt;

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
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The port could not be opened.
    PortMissing {
        /// Reason, with the name of the port.
        reason: String,
        /// Time until the next attempt, s.
        pause: f64,
    },
    /// The open port was lost.
    PortLost {
        /// Reason.
        reason: String,
    },
    /// The port was opened.
    PortOpened {
        /// Baud rate.
        baud: u32,
    },
    /// No device answers on the open port.
    NoAnswer {
        /// Baud rates tried.
        bauds: Vec<u32>,
        /// Baud rate at which valid frames were received.
        heard_at: Option<u32>,
        /// Bytes are received, but no valid frames (wrong baud rate, other device).
        garbage: bool,
    },
    /// No message was received.
    Silent {
        /// Time since the last message, s.
        seconds: f64,
    },
    /// A device answered.
    Found(Identity),
    /// The device has started (power-up, brown-out, reset).
    WokeUp,
    /// A setting was written to the flash of the device.
    Set {
        /// The setting.
        what: MessageId,
    },
    /// The device rejected a setting or a request.
    Rejected {
        /// The message.
        what: MessageId,
        /// Reason.
        error: DeviceError,
    },
    /// The device does not answer a request.
    Unanswered {
        /// The message.
        what: MessageId,
    },
    /// A setting read back differs from the written one; the driver uses the former.
    NotApplied {
        /// The setting.
        what: MessageId,
        /// Value written.
        wanted: String,
        /// Value read back.
        found: String,
    },
    /// The line on which the device was found is too slow for the settings; none was written.
    LineTooSlow(ConfigError),
    /// The device entered the measurement state.
    Measuring(Identity),
    /// The device sends on request only: no samples will come.
    OnRequestOnly,
    /// The device reported an error while measuring.
    DeviceFault {
        /// The error.
        error: DeviceError,
    },
    /// Messages could not be decoded; the configuration is read again.
    Unreadable {
        /// Reason.
        reason: String,
    },
    /// The messages lack acceleration or angular velocity.
    NoInertialData,
    /// Messages are missing, according to the counter.
    Lost {
        /// Number of messages.
        count: u64,
    },
    /// The clock of the device restarted.
    DeviceRestarted,
    /// The host's clock was set; stamps follow at once.
    ClockSet {
        /// New time minus old time, s.
        seconds: f64,
    },
    /// The clocks of device and host have a new offset.
    ClockStepped {
        /// Change of the offset, s.
        seconds: f64,
    },
    /// The clocks of device and host drift by more than [`MAX_DRIFT`]; reported repeatedly.
    DriftExceeded,
}

impl Event {
    /// Severity of the event.
    pub fn severity(&self) -> Severity {
        match self {
            Self::PortOpened { .. } | Self::Found(_) | Self::Set { .. } | Self::Measuring(_) => {
                Severity::Info
            }
            Self::PortMissing { .. }
            | Self::PortLost { .. }
            | Self::NoAnswer { .. }
            | Self::Silent { .. }
            | Self::LineTooSlow(_)
            | Self::OnRequestOnly
            | Self::NoInertialData => Severity::Error,
            _ => Severity::Warning,
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PortMissing { reason, pause } => {
                write!(f, "{reason}; next attempt in {pause:.1} s")
            }
            Self::PortLost { reason } => {
                write!(f, "the port was lost ({reason}); reconnect the adapter")
            }
            Self::PortOpened { baud } => write!(f, "port open at {baud} baud"),
            Self::NoAnswer { heard_at: Some(baud), .. } => write!(
                f,
                "valid messages at {baud} baud, but no answer to requests: set two_stop_bits: true \
                 (an MTx from before 2008 requires it), or check the line from host to IMU"
            ),
            Self::NoAnswer { bauds, garbage, .. } => {
                let bauds: Vec<String> = bauds.iter().map(u32::to_string).collect();
                write!(f, "no IMU answers at {} baud; ", bauds.join(", "))?;
                if *garbage {
                    f.write_str(
                        "the bytes received contain no valid message: \
                         set the baud rate (baud: 0 searches) and check the device on this port",
                    )
                } else {
                    f.write_str(
                        "check power supply and port \
                         (an MTx from before 2008 needs two_stop_bits: true)",
                    )
                }
            }
            Self::Silent { seconds } => {
                write!(f, "no message for {seconds:.1} s; querying the IMU")
            }
            Self::Found(identity) => write!(f, "found {identity}"),
            Self::WokeUp => f.write_str("the IMU has started"),
            Self::Set { what } => write!(f, "{what}: written to the IMU"),
            Self::Rejected { what, error } => write!(f, "the IMU rejected {what}: {error}"),
            Self::Unanswered { what } => {
                write!(f, "the IMU does not answer {what}; configuring it again")
            }
            Self::NotApplied { what, wanted, found } => {
                write!(f, "{what}: {wanted} was written, but the IMU has {found}, which is used")
            }
            Self::LineTooSlow(error) => write!(f, "no setting was written: {error}"),
            Self::Measuring(identity) => write!(f, "measuring: {identity}"),
            Self::OnRequestOnly => f.write_str(
                "the IMU sends on request only (OutputSkipFactor FFFF); \
                 let the driver set its rate (leave_settings: false)",
            ),
            Self::DeviceFault { error } => write!(f, "the IMU reports {error}"),
            Self::Unreadable { reason } => write!(f, "messages cannot be decoded: {reason}"),
            Self::NoInertialData => f.write_str(
                "the messages lack acceleration or angular velocity; \
                 let the driver set the outputs (leave_settings: false)",
            ),
            Self::Lost { count } => write!(f, "{count} messages lost"),
            Self::DeviceRestarted => f.write_str("the clock of the IMU restarted"),
            Self::ClockSet { seconds } => write!(f, "the host's clock was set by {seconds:+.3} s"),
            Self::ClockStepped { seconds } => write!(
                f,
                "samples arrive {seconds:+.3} s later than the clock of the IMU indicates: \
                 one of the two clocks was set, or its data are delayed"
            ),
            Self::DriftExceeded => write!(
                f,
                "the clocks of IMU and host drift by more than {:.0} ppm, so that stamps are \
                 wrong: let the driver set the rate (leave_settings: false), and check whether \
                 the host's clock is being corrected (chrony, ntpd)",
                MAX_DRIFT * 1e6
            ),
        }
    }
}
