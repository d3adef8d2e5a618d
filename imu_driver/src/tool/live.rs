//! Subcommands that communicate with an IMU.

use super::{Failure, seconds};
use crate::{
    driver::{Driver, DriverConfig, Event, Identity, Severity},
    protocol::{Attitude, MessageId, message::baud_code, mtdata2},
    serial::{Port, Report, Runner, candidates},
};
use node_kit::{
    console, errln,
    files::{FileError, OutputFile},
    outln,
};
use rig_model::Stamp;
use std::{
    io::Write,
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// Serial line of the IMU.
#[derive(Clone, Debug, clap::Args)]
pub struct Line {
    /// Serial port
    #[arg(long)]
    port: String,
    /// Baud rate; without it, search at the usual ones
    #[arg(long)]
    baud: Option<u32>,
    /// Two stop bits, for an MTx from before 2008
    #[arg(long)]
    two_stop_bits: bool,
    /// Time limit in seconds
    #[arg(long, default_value_t = 10.0, value_parser = seconds)]
    timeout: f64,
}

/// Arguments of `volant imu find`.
#[derive(Debug, clap::Args)]
pub struct Find {
    /// Search this port only (may be given several times)
    #[arg(long)]
    port: Vec<String>,
    /// Time limit per port in seconds
    #[arg(long, default_value_t = 7.0, value_parser = seconds)]
    timeout: f64,
}

/// Arguments of `volant imu configure`.
#[derive(Debug, clap::Args)]
pub struct Configure {
    #[command(flatten)]
    line: Line,
    /// Sampling rate in Hz
    #[arg(long, default_value_t = 100.0)]
    rate: f64,
    /// Disable the orientation
    #[arg(long)]
    no_orientation: bool,
    /// Disable the magnetic field
    #[arg(long)]
    no_magnetic_field: bool,
    /// Enable the temperature
    #[arg(long)]
    temperature: bool,
    /// Enable the status bits
    #[arg(long)]
    status: bool,
    /// Set this baud rate first (the IMU is reset)
    #[arg(long)]
    set_baud: Option<u32>,
}

/// Arguments of `volant imu log`.
#[derive(Debug, clap::Args)]
pub struct Log {
    #[command(flatten)]
    line: Line,
    /// File to write the raw bytes to
    #[arg(long)]
    out: PathBuf,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
    /// Duration of the samples in seconds; without it, until ctrl-c
    #[arg(long, value_parser = seconds)]
    duration: Option<f64>,
    /// Set the standard outputs first; without it the settings remain
    #[arg(long)]
    configure: bool,
}

#[allow(clippy::disallowed_methods, reason = "communication with a device runs in real time")]
fn now() -> Stamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}

/// Runs a driver for at most `seconds`, until `stop` is set or `handle` returns false; returns
/// whether it did.
#[allow(clippy::disallowed_methods, reason = "communication with a device runs in real time")]
fn converse(
    line: &Line,
    config: DriverConfig,
    seconds: f64,
    raw: bool,
    stop: &AtomicBool,
    mut handle: impl FnMut(&Report) -> bool,
) -> Result<bool, Failure> {
    let config =
        DriverConfig { baud: line.baud.unwrap_or(0), two_stop_bits: line.two_stop_bits, ..config };
    let first_baud = config.first_baud();
    let driver = Driver::new(config)?;
    let opened = Some(Port::open(&line.port, first_baud, line.two_stop_bits)?);
    let runner = Runner { port: line.port.clone(), driver, raw, opened };
    let end = Instant::now() + Duration::from_secs_f64(seconds.clamp(0.0, 1e9));
    let mut ended = false;
    let on_report = |report: Report| {
        ended = !handle(&report);
        !ended
    };
    runner.run(now, || None, on_report, || Instant::now() < end && !stop.load(Ordering::Relaxed));
    Ok(ended)
}

fn read_only() -> DriverConfig {
    DriverConfig { leave_settings: true, ..DriverConfig::default() }
}

/// Calls `handle` with the driver's events until it returns false, at most for the line's time;
/// returns whether it did.
///
/// # Errors
/// As [`converse`]; a line too slow for the settings, because no later attempt has another result.
fn events(
    line: &Line,
    config: DriverConfig,
    mut handle: impl FnMut(&Event) -> bool,
) -> Result<bool, Failure> {
    let mut too_slow = None;
    let no_signal = AtomicBool::new(false);
    let ended = converse(line, config, line.timeout, false, &no_signal, |report| match report {
        Report::Event(event @ Event::LineTooSlow(_)) => {
            too_slow = Some(event.to_string());
            false
        }
        Report::Event(event) => handle(event),
        _ => true,
    })?;
    match too_slow {
        Some(reason) => Err(format!("{}: {reason}", line.port).into()),
        None => Ok(ended),
    }
}

/// Waits until a device measures and returns its identity; `verbose` prints events.
fn identify(line: &Line, config: DriverConfig, verbose: bool) -> Result<Identity, Failure> {
    let mut found = None;
    let mut problem = None;
    let done = events(line, config, |event| {
        if verbose && (event.severity() > Severity::Info || matches!(event, Event::Set(_))) {
            errln!("{event}");
        }
        match event {
            Event::Measuring(identity) => {
                found = Some(identity.clone());
                return false;
            }
            Event::Found(identity) => found = Some(identity.clone()),
            _ if event.severity() > Severity::Info => problem = Some(event.to_string()),
            _ => {}
        }
        true
    })?;
    match (done, found) {
        (true, Some(identity)) => Ok(identity),
        (_, Some(identity)) if !verbose => Ok(identity),
        _ => Err(format!(
            "no IMU is ready at {} after {:.0} s: {}",
            line.port,
            line.timeout,
            problem.unwrap_or_else(|| "no answer; give another --port or --timeout".into())
        )
        .into()),
    }
}

pub(super) fn find(arguments: &Find) -> Result<(), Failure> {
    let mut ports: Vec<(String, String)> =
        arguments.port.iter().map(|p| (p.clone(), "as given".to_owned())).collect();
    if ports.is_empty() {
        ports = candidates();
    }
    if ports.is_empty() {
        let reason = "no serial port found; connect the IMU (and check `dmesg`), or give --port";
        return Err(reason.to_owned().into());
    }
    let mut any = false;
    for (port, adapter) in ports {
        let timeout = arguments.timeout;
        let line = Line { port, baud: None, two_stop_bits: false, timeout };
        let found = identify(&line, read_only(), false);
        any |= found.is_ok();
        let text = found.map_or_else(|reason| reason.to_string(), |identity| identity.to_string());
        outln!("{} ({adapter}): {text}", line.port)?;
    }
    if any {
        Ok(())
    } else {
        Err("no IMU found; check its power supply, or give its --port".to_owned().into())
    }
}

pub(super) fn info(line: &Line) -> Result<(), Failure> {
    show(&identify(line, read_only(), true)?)
}

fn show(identity: &Identity) -> Result<(), Failure> {
    outln!("{identity}")?;
    outln!("family: {}", identity.device_id.family())?;
    if let Some(c) = &identity.configuration {
        match c.rate() {
            Some(rate) => outln!("rate: {rate:.3} Hz (period {}, skip {})", c.period, c.skip)?,
            None => outln!("rate: on request only (period {}, skip {})", c.period, c.skip)?,
        }
        if identity.outputs.is_none() {
            let form = match c.format.settings.identity() {
                Some(Attitude::Quaternion(_)) => "quaternion",
                Some(Attitude::Euler(_)) => "Euler angles",
                Some(Attitude::Matrix(_)) => "matrix",
                None => "none",
            };
            outln!(
                "output mode {:04X}, settings {:08X}: {:?}, orientation as {form}, {:?}",
                c.format.mode.bits(),
                c.format.settings.bits(),
                c.format.settings.number_format(),
                c.format.settings.global_frame()
            )?;
            outln!("message: {} bytes", c.format.data_length() + 5)?;
        }
    }
    for output in identity.outputs.iter().flatten() {
        let every = if output.rate == u16::MAX {
            "every message".into()
        } else {
            format!("{} Hz", output.rate)
        };
        outln!("output {:04X}: {} ({every})", output.id, mtdata2::xdi::name(output.id))?;
    }
    Ok(())
}

pub(super) fn configure(arguments: &Configure) -> Result<(), Failure> {
    let config = DriverConfig {
        rate: arguments.rate,
        orientation: !arguments.no_orientation,
        magnetic_field: !arguments.no_magnetic_field,
        temperature: arguments.temperature,
        status: arguments.status,
        ..DriverConfig::default()
    };
    let mut line = arguments.line.clone();
    // Before anything is written: the line must carry the messages at its last baud rate. Those of
    // an MTi-1, 10, 100 or 600 are longer; the driver checks them once the IMU has answered.
    let baud = arguments.set_baud.or(line.baud).unwrap_or(0);
    DriverConfig { baud, ..config.clone() }.check()?;
    if let Some(baud) = arguments.set_baud {
        set_baud(&line, baud, &config)?;
        line.baud = Some(baud);
    }
    show(&identify(&line, config, true)?)
}

/// Sets the baud rate of an IMU that gets the outputs of `config` afterwards.
fn set_baud(line: &Line, baud: u32, config: &DriverConfig) -> Result<(), Failure> {
    let code = baud_code(baud).ok_or_else(|| format!("{baud} baud is not supported by the IMU"))?;
    let config = DriverConfig { set_baud: Some(code), ..config.clone() };
    let mut set = false;
    events(line, config, |event| {
        errln!("{event}");
        set |= *event == Event::Set(MessageId::BAUD_RATE);
        if set {
            // Keeps the port open until the device has received the Reset.
            std::thread::sleep(Duration::from_millis(100));
        }
        !set
    })?;
    if !set {
        let port = &line.port;
        return Err(
            format!("the IMU at {port} rejected {baud} baud; see the messages above").into()
        );
    }
    Ok(())
}

pub(super) fn log(arguments: &Log) -> Result<(), Failure> {
    let out = &arguments.out;
    // A new log bears its name from the start: its bytes are readable whatever ends the process.
    let mut file = match arguments.overwrite {
        true => OutputFile::create(out, true)?,
        false => OutputFile::in_place(out)?,
    };
    let stop = console::stop_flag().map_err(|e| e.to_string())?;
    let config = if arguments.configure { DriverConfig::default() } else { read_only() };
    let (mut samples, mut bytes_written) = (0_u64, 0_u64);
    let mut first = None;
    let mut failed = None;
    let forever = 1e9;
    let wait = arguments.duration.map_or(forever, |d| d + arguments.line.timeout);
    let ended = converse(&arguments.line, config, wait, true, &stop, |report| {
        match report {
            Report::Bytes(bytes) => {
                // Unbuffered, so that the file is complete after a kill.
                if let Err(error) = file.write_all(bytes) {
                    failed = Some(FileError::Io { path: out.clone(), error });
                    return false;
                }
                bytes_written += bytes.len() as u64;
            }
            Report::Event(event) => errln!("{event}"),
            Report::Status(_) => {}
            Report::Sample(sample) => {
                samples += 1;
                let start = *first.get_or_insert(sample.stamp);
                if samples % 100 == 0 {
                    errln!("{samples} samples, {bytes_written} bytes");
                }
                return arguments.duration.is_none_or(|d| sample.stamp.seconds_since(start) < d);
            }
        }
        true
    });
    if bytes_written == 0 && !arguments.overwrite {
        // Without a port or bytes there is no log, and another attempt may have its name.
        let _ = std::fs::remove_file(out);
    }
    ended?;
    if let Some(failure) = failed {
        return Err(failure.into());
    }
    if samples == 0 {
        let port = &arguments.line.port;
        return Err(format!("no sample received from {port}; see the messages above").into());
    }
    file.commit()?;
    errln!("{}: {samples} samples, {bytes_written} bytes", out.display());
    Ok(())
}
