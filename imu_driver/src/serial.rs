//! The serial port, and the loop that lets a [`Driver`] drive it. The only file that knows `serialport`.

use crate::driver::{Driver, Event, Identity, Input, Output, Sample, Statistics};
use rig_model::Stamp;
use serialport::{ClearBuffer, DataBits, FlowControl, Parity, SerialPort, SerialPortType, StopBits, TTYPort};
use std::{
    fmt,
    io::{ErrorKind, Read, Write},
    os::fd::AsRawFd,
    time::Duration,
};
use thiserror::Error;

/// Reading waits for so long at most, so that timers run.
const READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Status goes out this often, s.
const STATUS_INTERVAL: f64 = 0.5;

/// Why a port cannot be opened.
#[derive(Debug, Error)]
pub enum PortError {
    /// It is not there.
    #[error(
        "the serial port {port} is not there; plug the unit in, or give its port (`volant imu find` lists them)"
    )]
    Missing {
        /// As given.
        port: String,
    },
    /// The user may not.
    #[error(
        "the serial port {port} may not be opened; add the user to the group that owns it (usually `dialout`) and log in again"
    )]
    Forbidden {
        /// As given.
        port: String,
    },
    /// Somebody else has it.
    #[error(
        "the serial port {port} is in use by another program; end it (ModemManager is one that grabs such ports)"
    )]
    Busy {
        /// As given.
        port: String,
    },
    /// Something else.
    #[error("the serial port {port} cannot be opened: {reason}; is it a serial port?")]
    Other {
        /// As given.
        port: String,
        /// The system's reason.
        reason: String,
    },
}

/// An open port.
pub struct Port {
    tty: TTYPort,
    /// The adapter hands bytes over at once.
    pub low_latency: bool,
}

impl fmt::Debug for Port {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Port").field("low_latency", &self.low_latency).finish()
    }
}

impl Port {
    /// Opens a port for this process alone: 8 data bits, no parity, no flow control.
    ///
    /// # Errors
    /// [`PortError`] with the remedy.
    pub fn open(port: &str, baud: u32, two_stop_bits: bool) -> Result<Self, PortError> {
        let stop_bits = if two_stop_bits { StopBits::Two } else { StopBits::One };
        let named = || port.to_owned();
        if !std::path::Path::new(port).exists() {
            return Err(PortError::Missing { port: named() });
        }
        let tty = serialport::new(port, baud)
            .data_bits(DataBits::Eight)
            .parity(Parity::None)
            .stop_bits(stop_bits)
            .flow_control(FlowControl::None)
            .timeout(READ_TIMEOUT)
            .open_native()
            .map_err(|error| {
                let text = error.to_string();
                match error.kind {
                    serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => {
                        PortError::Forbidden { port: named() }
                    }
                    serialport::ErrorKind::Io(ErrorKind::NotFound) => PortError::Missing { port: named() },
                    _ if text.contains("busy") => PortError::Busy { port: named() },
                    serialport::ErrorKind::NoDevice if text.contains("No such") => {
                        PortError::Missing { port: named() }
                    }
                    _ => PortError::Other { port: named(), reason: text },
                }
            })?;
        let low_latency = set_low_latency(&tty);
        // What the old stream left in the system's buffers is not the new stream's beginning.
        let _ = tty.clear(ClearBuffer::All);
        Ok(Self { tty, low_latency })
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), String> {
        self.tty.set_baud_rate(baud).map_err(|e| e.to_string())?;
        self.tty.clear(ClearBuffer::All).map_err(|e| e.to_string())
    }
}

/// Asks the adapter's kernel driver for no latency timer: an FTDI's holds bytes back for up to 16 ms otherwise. Not every
/// driver knows the flag, and a pseudo-terminal has none.
#[allow(
    unsafe_code,
    reason = "no safe wrapper offers TIOCGSERIAL; the buffer is larger than the kernel's structure"
)]
fn set_low_latency(tty: &TTYPort) -> bool {
    /// Index of `flags` in `struct serial_struct`: type, line, port, irq come before it.
    const FLAGS: usize = 4;
    const ASYNC_LOW_LATENCY: libc::c_int = 1 << 13;
    // `struct serial_struct` has 72 bytes on 64-bit Linux, and fewer on 32-bit.
    let mut serial = [0 as libc::c_int; 32];
    let fd = tty.as_raw_fd();
    // SAFETY: fd is open for the lifetime of `tty`; the kernel writes at most sizeof(struct serial_struct) bytes.
    let got = unsafe { libc::ioctl(fd, libc::TIOCGSERIAL as _, serial.as_mut_ptr()) };
    if got != 0 {
        return false;
    }
    serial[FLAGS] |= ASYNC_LOW_LATENCY;
    // SAFETY: as above; the kernel reads what it has just written, with one flag more.
    unsafe { libc::ioctl(fd, libc::TIOCSSERIAL as _, serial.as_ptr()) == 0 }
}

/// A port that might have a unit, for people.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Candidate {
    /// Its path.
    pub path: String,
    /// What is known of the adapter.
    pub adapter: String,
    /// The adapter is one of the units' maker.
    pub likely: bool,
}

/// The serial ports of this machine, the likely ones first.
pub fn candidates() -> Vec<Candidate> {
    let mut found: Vec<Candidate> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| match port.port_type {
            SerialPortType::UsbPort(usb) => Candidate {
                path: port.port_name,
                // 2639 is the maker's; 0403 with d388 to d38f are its FTDI cables.
                likely: usb.vid == 0x2639 || (usb.vid == 0x0403 && (0xD388..=0xD38F).contains(&usb.pid)),
                adapter: format!(
                    "USB {:04x}:{:04x} {}",
                    usb.vid,
                    usb.pid,
                    usb.product.or(usb.manufacturer).unwrap_or_default()
                ),
            },
            _ => Candidate { path: port.port_name, adapter: "serial port".into(), likely: false },
        })
        .collect();
    found.sort_by(|a, b| b.likely.cmp(&a.likely).then_with(|| a.path.cmp(&b.path)));
    found
}

/// How the driver fares, twice a second.
#[derive(Clone, Debug)]
pub struct DriverStatus {
    /// Counts.
    pub statistics: Statistics,
    /// What it is doing.
    pub state: &'static str,
    /// Samples are coming.
    pub measuring: bool,
    /// Which unit.
    pub identity: Identity,
    /// The adapter hands bytes over at once.
    pub low_latency: bool,
}

/// What the loop tells.
#[derive(Debug)]
pub enum Report {
    /// A sample.
    Sample(Sample),
    /// Something happened.
    Event(Event),
    /// How it fares.
    Status(Box<DriverStatus>),
    /// Bytes as they came (only where they were asked for).
    Bytes(Vec<u8>),
}

/// Lets a driver drive a port.
#[derive(Debug)]
pub struct Runner {
    /// Path of the port.
    pub port: String,
    /// The driver.
    pub driver: Driver,
    /// Report the raw bytes too.
    pub raw: bool,
    /// Taken at the first opening instead of opening the port anew.
    pub opened: Option<Port>,
}

impl Runner {
    /// Runs until `tell` returns false, which is asked for at least ten times a second. `now` is the clock of the stamps, and `set_by`
    /// tells by how many ns somebody set it since it was asked last.
    pub fn run(
        mut self,
        now: impl Fn() -> Stamp,
        mut set_by: impl FnMut() -> Option<i64>,
        mut tell: impl FnMut(Report) -> bool,
        mut go_on: impl FnMut() -> bool,
    ) {
        let mut port: Option<Port> = None;
        let mut buffer = [0_u8; 4096];
        let mut status_at = now();
        self.driver.handle(Input::Tick { at: now() });
        loop {
            while let Some(output) = self.driver.poll() {
                let told = match output {
                    Output::Sample(sample) => tell(Report::Sample(sample)),
                    Output::Event(event) => tell(Report::Event(event)),
                    Output::Close => {
                        port = None;
                        true
                    }
                    Output::Open { baud, two_stop_bits } => {
                        let opened = match self.opened.take() {
                            Some(port) => Ok(port),
                            None => Port::open(&self.port, baud, two_stop_bits),
                        };
                        match opened {
                            Ok(opened) => {
                                port = Some(opened);
                                self.driver.handle(Input::Opened { at: now() });
                            }
                            Err(error) => {
                                let reason = error.to_string();
                                self.driver.handle(Input::OpenFailed { at: now(), reason: &reason });
                            }
                        }
                        true
                    }
                    Output::SetBaud(baud) => {
                        if let Some(Err(reason)) = port.as_mut().map(|p| p.set_baud(baud)) {
                            port = None;
                            self.driver.handle(Input::Lost { at: now(), reason: &reason });
                        }
                        true
                    }
                    Output::Write(bytes) => {
                        if let Some(Err(error)) = port.as_mut().map(|p| p.tty.write_all(&bytes)) {
                            port = None;
                            self.driver.handle(Input::Lost { at: now(), reason: &error.to_string() });
                        }
                        true
                    }
                };
                if !told {
                    return;
                }
            }
            if !go_on() {
                return;
            }
            let at = now();
            if !(0.0..STATUS_INTERVAL).contains(&at.seconds_since(status_at)) {
                status_at = at;
                let status = DriverStatus {
                    statistics: self.driver.statistics(),
                    state: self.driver.state(),
                    measuring: self.driver.is_measuring(),
                    identity: self.driver.identity().clone(),
                    low_latency: port.as_ref().is_some_and(|p| p.low_latency),
                };
                if !tell(Report::Status(Box::new(status))) {
                    return;
                }
            }
            let Some(open) = &mut port else {
                std::thread::sleep(READ_TIMEOUT);
                self.driver.handle(Input::Tick { at: now() });
                continue;
            };
            match open.tty.read(&mut buffer) {
                Ok(n) if n > 0 => {
                    let arrival = now();
                    let arrival = match set_by() {
                        // Before the arrival was read or after it: by the clock as it is now in either case.
                        Some(by) => {
                            self.driver.handle(Input::ClockSet { by });
                            now()
                        }
                        None => arrival,
                    };
                    let bytes = buffer.get(..n).unwrap_or_default();
                    if self.raw && !tell(Report::Bytes(bytes.to_vec())) {
                        return;
                    }
                    self.driver.handle(Input::Bytes { bytes, arrival });
                }
                Ok(_) => {
                    port = None;
                    self.driver.handle(Input::Lost { at: now(), reason: "it was unplugged" });
                }
                Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) => {
                    if let Some(by) = set_by() {
                        self.driver.handle(Input::ClockSet { by });
                    }
                    self.driver.handle(Input::Tick { at: now() });
                }
                Err(error) => {
                    port = None;
                    self.driver.handle(Input::Lost { at: now(), reason: &error.to_string() });
                }
            }
        }
    }
}
