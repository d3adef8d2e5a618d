//! What the driver has to tell besides samples. It logs nothing: the shell does, once.

use crate::protocol::{Configuration, DeviceError, DeviceId, MessageId, OutputEntry};
use std::fmt;

/// How much an event matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    /// All is well.
    Info,
    /// Something is wrong and the driver copes with it.
    Warning,
    /// No samples come.
    Error,
}

/// Which unit it is and what it is set to.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Identity {
    /// Device identifier.
    pub device_id: DeviceId,
    /// Product code, empty where it gave none.
    pub product_code: String,
    /// Firmware revision, empty where it gave none.
    pub firmware: String,
    /// A legacy unit's configuration as read back.
    pub configuration: Option<Configuration>,
    /// A newer unit's output configuration as read back.
    pub outputs: Option<Vec<OutputEntry>>,
    /// At which rate it was found.
    pub baud: u32,
}

impl fmt::Display for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = if self.product_code.is_empty() { self.device_id.family() } else { &self.product_code };
        write!(f, "{name} {}", self.device_id)?;
        if !self.firmware.is_empty() {
            write!(f, ", firmware {}", self.firmware)?;
        }
        write!(f, ", {} baud", self.baud)
    }
}

/// What happened.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The port cannot be opened; the next attempt follows after `pause` seconds.
    PortMissing {
        /// Why.
        reason: String,
        /// s.
        pause: f64,
    },
    /// The port is gone while it was in use.
    PortLost {
        /// Why.
        reason: String,
    },
    /// The port is open.
    PortOpened {
        /// At this rate.
        baud: u32,
    },
    /// Nobody answers on the open port.
    NoAnswer {
        /// The rates that were tried.
        bauds: Vec<u32>,
        /// Something is being received, but it makes no sense (wrong baud rate, another device).
        garbage: bool,
    },
    /// The unit was silent for so many seconds.
    Silent {
        /// s.
        seconds: f64,
    },
    /// A unit answered.
    Found(Identity),
    /// The unit has just started (power-up, brown-out, reset).
    WokeUp,
    /// A setting was written into the unit's flash.
    Set {
        /// Which.
        what: MessageId,
    },
    /// The unit refused a setting or a request.
    Refused {
        /// Which.
        what: MessageId,
        /// Its reason.
        error: DeviceError,
    },
    /// The unit does not answer a request.
    Unanswered {
        /// Which.
        what: MessageId,
    },
    /// The read-back differs from what was asked for; the driver goes on with what the unit has.
    NotTaken {
        /// Which.
        what: MessageId,
        /// As asked.
        wanted: String,
        /// As read back.
        found: String,
    },
    /// The unit measures; samples follow.
    Measuring(Identity),
    /// The unit reports an error while it measures.
    DeviceComplains {
        /// Its reason.
        error: DeviceError,
    },
    /// Messages that cannot be read come in; the configuration is read anew.
    Unreadable {
        /// Why.
        reason: String,
    },
    /// The stream lacks what a sample needs.
    NoInertialData,
    /// The counter says that messages are missing.
    Lost {
        /// How many.
        count: u64,
    },
    /// The unit's clock started anew.
    UnitRestarted,
    /// The host's clock was set; stamps follow at once.
    ClockSet {
        /// By so many seconds.
        seconds: f64,
    },
    /// The unit's clock and the host's came apart, and stay so.
    ClockStepped {
        /// By so many seconds.
        seconds: f64,
    },
}

impl Event {
    /// How much it matters.
    pub fn severity(&self) -> Severity {
        match self {
            Self::PortOpened { .. } | Self::Found(_) | Self::Set { .. } | Self::Measuring(_) => {
                Severity::Info
            }
            Self::PortMissing { .. }
            | Self::PortLost { .. }
            | Self::NoAnswer { .. }
            | Self::Silent { .. }
            | Self::NoInertialData => Severity::Error,
            _ => Severity::Warning,
        }
    }
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::PortMissing { reason, pause } => write!(f, "{reason}; next attempt in {pause:.1} s"),
            Self::PortLost { reason } => write!(f, "the port is gone ({reason}): plug the unit in again"),
            Self::PortOpened { baud } => write!(f, "port open at {baud} baud"),
            Self::NoAnswer { bauds, garbage } => {
                let bauds: Vec<String> = bauds.iter().map(u32::to_string).collect();
                write!(f, "no unit answers at {} baud; ", bauds.join(", "))?;
                if *garbage {
                    f.write_str("bytes come that make no sense: is the baud rate another one (baud: 0 looks for it), or is this another device?")
                } else {
                    f.write_str("is it powered and is this its port? (units from before 2008 need two_stop_bits: true)")
                }
            }
            Self::Silent { seconds } => write!(f, "no message for {seconds:.1} s; asking the unit"),
            Self::Found(identity) => write!(f, "found {identity}"),
            Self::WokeUp => f.write_str("the unit has just started"),
            Self::Set { what } => write!(f, "{what}: written into the unit"),
            Self::Refused { what, error } => write!(f, "the unit refuses {what}: {error}"),
            Self::Unanswered { what } => write!(f, "the unit does not answer {what}; starting over"),
            Self::NotTaken { what, wanted, found } => {
                write!(f, "{what}: {wanted} was asked for, but the unit has {found}; going on with that")
            }
            Self::Measuring(identity) => write!(f, "measuring: {identity}"),
            Self::DeviceComplains { error } => write!(f, "the unit reports {error}"),
            Self::Unreadable { reason } => write!(f, "messages cannot be read: {reason}"),
            Self::NoInertialData => f.write_str(
                "the unit sends no acceleration and rate of turn in one message; let the driver set its outputs (leave_settings: false)",
            ),
            Self::Lost { count } => write!(f, "{count} messages lost"),
            Self::UnitRestarted => f.write_str("the unit's clock started anew"),
            Self::ClockSet { seconds } => write!(f, "the host's clock was set by {seconds:+.3} s"),
            Self::ClockStepped { seconds } => write!(
                f,
                "the unit's samples come {seconds:+.3} s later than its clock says: one of the two clocks was set, or all that the unit sends is held up"
            ),
        }
    }
}
