//! Serial port, and the loop that connects it to a [`Driver`]; the only file that uses
//! `serialport`.

use crate::driver::{Driver, Event, Identity, Input, Output, Sample, Statistics};
use rig_model::Stamp;
use serialport::{
    ClearBuffer, DataBits, FlowControl, Parity, SerialPort, SerialPortType, StopBits, TTYPort,
};
use std::{
    io::{ErrorKind, Read, Write},
    os::fd::AsRawFd,
    time::Duration,
};

/// Timeout of reading, so that timers run.
const READ_TIMEOUT: Duration = Duration::from_millis(20);
/// Interval of the status, s.
const STATUS_INTERVAL: f64 = 0.5;

/// Open serial port.
pub struct Port {
    tty: TTYPort,
    /// The adapter forwards bytes without a latency timer.
    pub low_latency: bool,
}

impl Port {
    /// Opens a port exclusively: 8 data bits, no parity, no flow control.
    ///
    /// # Errors
    /// The reason, with the path of the port and the remedy.
    pub fn open(port: &str, baud: u32, two_stop_bits: bool) -> Result<Self, String> {
        let stop_bits = if two_stop_bits { StopBits::Two } else { StopBits::One };
        let missing = || {
            format!(
                "the serial port {port} does not exist; connect the IMU, or give its port (`volant \
                 imu find` lists ports)"
            )
        };
        if !std::path::Path::new(port).exists() {
            return Err(missing());
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
                    serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => format!(
                        "no permission to open the serial port {port}; add the user to the group \
                         that owns it (usually `dialout`) and log in again"
                    ),
                    serialport::ErrorKind::Io(ErrorKind::NotFound) => missing(),
                    _ if text.contains("busy") => format!(
                        "the serial port {port} is in use by another program; stop that program \
                         (ModemManager opens such ports)"
                    ),
                    serialport::ErrorKind::NoDevice if text.contains("No such") => missing(),
                    _ => format!(
                        "the serial port {port} cannot be opened: {text}; check that it is a \
                         serial port"
                    ),
                }
            })?;
        let low_latency = set_low_latency(&tty);
        // Remains of a previous stream.
        let _ = tty.clear(ClearBuffer::All);
        Ok(Self { tty, low_latency })
    }

    fn set_baud(&mut self, baud: u32) -> Result<(), String> {
        self.tty.set_baud_rate(baud).map_err(|e| e.to_string())?;
        self.tty.clear(ClearBuffer::All).map_err(|e| e.to_string())
    }
}

/// Requests low latency from the driver of the adapter; returns whether it is supported.
///
/// Without it an FTDI adapter delays bytes by up to 16 ms.
#[allow(
    unsafe_code,
    reason = "no safe wrapper for TIOCGSERIAL; the buffer is larger than the kernel's structure"
)]
fn set_low_latency(tty: &TTYPort) -> bool {
    /// Index of `flags` in `struct serial_struct`, after type, line, port and irq.
    const FLAGS: usize = 4;
    const ASYNC_LOW_LATENCY: libc::c_int = 1 << 13;
    // `struct serial_struct` has 72 bytes on 64-bit Linux, and fewer on 32-bit.
    let mut serial = [0 as libc::c_int; 32];
    let fd = tty.as_raw_fd();
    // SAFETY: fd is open as long as `tty`; the kernel writes at most sizeof(struct serial_struct).
    let result = unsafe { libc::ioctl(fd, libc::TIOCGSERIAL as _, serial.as_mut_ptr()) };
    if result != 0 {
        return false;
    }
    serial[FLAGS] |= ASYNC_LOW_LATENCY;
    // SAFETY: as above; the kernel reads the structure that it has written, with one more flag.
    unsafe { libc::ioctl(fd, libc::TIOCSSERIAL as _, serial.as_ptr()) == 0 }
}

/// Serial ports of this computer with descriptions of their adapters; adapters with an identifier
/// of the manufacturer first.
pub fn candidates() -> Vec<(String, String)> {
    let mut found: Vec<(bool, String, String)> = serialport::available_ports()
        .unwrap_or_default()
        .into_iter()
        .map(|port| match port.port_type {
            SerialPortType::UsbPort(usb) => {
                // Vendor 2639; 0403 with d388 to d38f: its FTDI cables.
                let likely = usb.vid == 0x2639
                    || (usb.vid == 0x0403 && (0xD388..=0xD38F).contains(&usb.pid));
                let product = usb.product.or(usb.manufacturer).unwrap_or_default();
                let adapter = format!("USB {:04x}:{:04x} {product}", usb.vid, usb.pid);
                (!likely, port.port_name, adapter)
            }
            _ => (true, port.port_name, "serial port".to_owned()),
        })
        .collect();
    found.sort();
    found.into_iter().map(|(_, path, adapter)| (path, adapter)).collect()
}

/// Status of the driver, reported twice per second.
#[derive(Clone, Debug)]
pub struct DriverStatus {
    /// Counts since the start.
    pub statistics: Statistics,
    /// Description of the phase.
    pub state: &'static str,
    /// The device is in the measurement state.
    pub measuring: bool,
    /// Identity of the device.
    pub identity: Identity,
    /// The adapter forwards bytes without a latency timer.
    pub low_latency: bool,
}

/// Report of the loop.
#[derive(Debug)]
pub enum Report {
    /// A sample.
    Sample(Sample),
    /// An event.
    Event(Event),
    /// The status.
    Status(Box<DriverStatus>),
    /// Received bytes, if requested by [`Runner::raw`].
    Bytes(Vec<u8>),
}

/// Connects a driver to a port.
pub struct Runner {
    /// Path of the port.
    pub port: String,
    /// The driver.
    pub driver: Driver,
    /// Report the received bytes too.
    pub raw: bool,
    /// The port, if it is open.
    pub opened: Option<Port>,
}

impl Runner {
    /// Runs until `report` or `go_on` returns false; `go_on` is called at least ten times per
    /// second.
    ///
    /// `now`: clock of the stamps; `set_by`: step of this clock since the last call, ns.
    pub fn run(
        mut self,
        now: impl Fn() -> Stamp,
        mut set_by: impl FnMut() -> Option<i64>,
        mut report: impl FnMut(Report) -> bool,
        mut go_on: impl FnMut() -> bool,
    ) {
        let mut buffer = [0_u8; 4096];
        let mut status_at = now();
        self.driver.handle(Input::Tick, now());
        loop {
            while let Some(output) = self.driver.poll() {
                let go_on = match output {
                    Output::Sample(sample) => report(Report::Sample(sample)),
                    Output::Event(event) => {
                        if matches!(event, Event::Measuring(_)) {
                            // The status contains the rate, which is needed with the first sample.
                            status_at = Stamp::default();
                        }
                        report(Report::Event(event))
                    }
                    command => {
                        self.execute(command, &now);
                        true
                    }
                };
                if !go_on {
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
                    low_latency: self.opened.as_ref().is_some_and(|p| p.low_latency),
                };
                if !report(Report::Status(Box::new(status))) {
                    return;
                }
            }
            let Some(open) = &mut self.opened else {
                std::thread::sleep(READ_TIMEOUT);
                self.driver.handle(Input::Tick, now());
                continue;
            };
            match open.tty.read(&mut buffer) {
                Ok(n) if n > 0 => {
                    let mut arrival = now();
                    if let Some(by) = set_by() {
                        // The clock may have been set before or after `arrival` was read.
                        self.driver.clock_set(by);
                        arrival = now();
                    }
                    let bytes = buffer.get(..n).unwrap_or_default();
                    if self.raw && !report(Report::Bytes(bytes.to_vec())) {
                        return;
                    }
                    self.driver.handle(Input::Bytes(bytes), arrival);
                }
                Ok(_) => self.lost(now(), "adapter disconnected"),
                Err(error)
                    if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::Interrupted) =>
                {
                    if let Some(by) = set_by() {
                        self.driver.clock_set(by);
                    }
                    self.driver.handle(Input::Tick, now());
                }
                Err(error) => self.lost(now(), &error.to_string()),
            }
        }
    }

    /// Executes a command of the driver on the port.
    fn execute(&mut self, command: Output, now: &impl Fn() -> Stamp) {
        let done = match command {
            Output::Open { baud, two_stop_bits } => {
                if self.opened.is_none() {
                    match Port::open(&self.port, baud, two_stop_bits) {
                        Ok(port) => self.opened = Some(port),
                        Err(reason) => {
                            return self.driver.handle(Input::OpenFailed(&reason), now());
                        }
                    }
                }
                return self.driver.handle(Input::Opened, now());
            }
            Output::Close => {
                self.opened = None;
                return;
            }
            Output::SetBaud(baud) => self.opened.as_mut().map(|p| p.set_baud(baud)),
            Output::Write(bytes) => {
                let port = self.opened.as_mut();
                port.map(|p| p.tty.write_all(&bytes).map_err(|e| e.to_string()))
            }
            // Reported.
            Output::Sample(_) | Output::Event(_) => None,
        };
        if let Some(Err(reason)) = done {
            self.lost(now(), &reason);
        }
    }

    /// Closes the port after an error.
    fn lost(&mut self, at: Stamp, reason: &str) {
        self.opened = None;
        self.driver.handle(Input::Lost(reason), at);
    }
}
