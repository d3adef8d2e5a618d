//! The subcommands that talk to a unit.

use super::Failure;
use crate::{
    driver::{Driver, DriverConfig, Event, Identity, Sample, Severity},
    protocol::{MessageId, OrientationForm, message::baud_from_code, mtdata2},
    serial::{Port, Report, Runner, candidates},
};
use rig_model::Stamp;
use std::{
    fs::File,
    io::Write,
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant, SystemTime, UNIX_EPOCH},
};

/// Where the unit is.
#[derive(Clone, Debug, clap::Args)]
pub struct Line {
    /// Serial port
    #[arg(long)]
    port: String,
    /// Baud rate; without it the unit is looked for at the usual ones
    #[arg(long)]
    baud: Option<u32>,
    /// Two stop bits, for an MTx from before 2008
    #[arg(long)]
    two_stop_bits: bool,
    /// Give up after so many seconds
    #[arg(long, default_value_t = 10.0)]
    timeout: f64,
}

/// Look for units.
#[derive(Debug, clap::Args)]
pub struct Find {
    /// Look at this port only (may be given several times)
    #[arg(long)]
    port: Vec<String>,
    /// Seconds per port
    #[arg(long, default_value_t = 7.0)]
    timeout: f64,
}

/// What to set.
#[derive(Debug, clap::Args)]
pub struct Configure {
    #[command(flatten)]
    line: Line,
    /// Samples per second
    #[arg(long, default_value_t = 100.0)]
    rate: f64,
    /// Leave the orientation out
    #[arg(long)]
    no_orientation: bool,
    /// Leave the magnetic field out
    #[arg(long)]
    no_magnetic_field: bool,
    /// Send the temperature
    #[arg(long)]
    temperature: bool,
    /// Send the status bits
    #[arg(long)]
    status: bool,
    /// Set the unit to this baud rate first (it is reset for that)
    #[arg(long)]
    set_baud: Option<u32>,
}

/// What to log.
#[derive(Debug, clap::Args)]
pub struct Log {
    #[command(flatten)]
    line: Line,
    /// File to write the raw bytes to
    #[arg(long)]
    out: PathBuf,
    /// Stop after so many seconds of samples; without it, at ctrl-c
    #[arg(long)]
    duration: Option<f64>,
    /// Set the standard outputs first; without it the unit's settings are left as they are
    #[arg(long)]
    configure: bool,
}

#[allow(clippy::disallowed_methods, reason = "a tool that talks to a device lives in real time")]
pub(super) fn now() -> Stamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}

#[allow(clippy::disallowed_methods, reason = "a tool that talks to a device lives in real time")]
fn instant() -> Instant {
    Instant::now()
}

/// What the driver tells, until `take` has seen enough.
enum Told<'a> {
    Sample(&'a Sample),
    Event(&'a Event),
    Bytes(&'a [u8]),
}

/// Runs a driver until `take` returns false or the time is over; whether `take` ended it.
fn converse(
    line: &Line,
    config: DriverConfig,
    seconds: f64,
    raw: bool,
    mut take: impl FnMut(Told<'_>) -> bool,
) -> Result<bool, Failure> {
    let config = DriverConfig { baud: line.baud, two_stop_bits: line.two_stop_bits, ..config };
    let driver = Driver::new(config).map_err(|e| e.to_string())?;
    let opened = Port::open(&line.port, line.baud.unwrap_or(115_200), line.two_stop_bits)
        .map_err(|e| e.to_string())?;
    let runner = Runner { port: line.port.clone(), driver, raw, opened: Some(opened) };
    let end = instant() + Duration::from_secs_f64(seconds.clamp(0.0, 1e9));
    let ended = AtomicBool::new(false);
    let tell = |report: Report| {
        let go_on = match &report {
            Report::Sample(sample) => take(Told::Sample(sample)),
            Report::Event(event) => take(Told::Event(event)),
            Report::Bytes(bytes) => take(Told::Bytes(bytes)),
            Report::Status(_) => true,
        };
        ended.store(!go_on, Ordering::Relaxed);
        go_on
    };
    runner.run(now, || None, tell, || instant() < end);
    Ok(ended.load(Ordering::Relaxed))
}

fn look() -> DriverConfig {
    DriverConfig { leave_settings: true, ..DriverConfig::default() }
}

/// Waits until a unit measures; what it is.
fn identify(line: &Line, config: DriverConfig, say: bool) -> Result<Identity, Failure> {
    let mut found = None;
    let mut trouble = None;
    let done = converse(line, config, line.timeout, false, |told| {
        if let Told::Event(event) = told {
            if say && (event.severity() > Severity::Info || matches!(event, Event::Set { .. })) {
                eprintln!("{event}");
            }
            match event {
                Event::Measuring(identity) => {
                    found = Some(identity.clone());
                    return false;
                }
                Event::Found(identity) => found = Some(identity.clone()),
                _ if event.severity() > Severity::Info => trouble = Some(event.to_string()),
                _ => {}
            }
        }
        true
    })?;
    match (done, found) {
        (true, Some(identity)) => Ok(identity),
        (_, Some(identity)) if !say => Ok(identity),
        _ => Err(format!(
            "no unit is ready at {} after {:.0} s: {}",
            line.port,
            line.timeout,
            trouble.unwrap_or_else(|| "it does not answer; give another --port or --timeout".into())
        )),
    }
}

pub(super) fn find(arguments: &Find) -> Result<(), Failure> {
    let mut ports: Vec<(String, String)> =
        arguments.port.iter().map(|p| (p.clone(), "as given".to_owned())).collect();
    if ports.is_empty() {
        ports = candidates().into_iter().map(|c| (c.path, c.adapter)).collect();
    }
    if ports.is_empty() {
        return Err(
            "this machine has no serial port; plug the unit in (and see `dmesg`), or give --port".into()
        );
    }
    let mut any = false;
    for (port, adapter) in ports {
        let line = Line { port: port.clone(), baud: None, two_stop_bits: false, timeout: arguments.timeout };
        match identify(&line, look(), false) {
            Ok(identity) => {
                any = true;
                println!("{port} ({adapter}): {identity}");
            }
            Err(reason) => println!("{port} ({adapter}): {reason}"),
        }
    }
    if any { Ok(()) } else { Err("no unit was found; is it powered? (--port names one port)".into()) }
}

pub(super) fn info(line: &Line) -> Result<(), Failure> {
    show(&identify(line, look(), true)?);
    Ok(())
}

fn show(identity: &Identity) {
    println!("{identity}");
    println!("family: {}", identity.device_id.family());
    if let Some(c) = &identity.configuration {
        match c.rate() {
            Some(rate) => println!("rate: {rate:.3} Hz (period {}, skip {})", c.period, c.skip),
            None => println!("rate: on request only (period {}, skip {})", c.period, c.skip),
        }
        if identity.outputs.is_none() {
            let form = match c.format.settings.orientation_form() {
                Some(OrientationForm::Quaternion) => "quaternion",
                Some(OrientationForm::Euler) => "Euler angles",
                Some(OrientationForm::Matrix) => "matrix",
                None => "none",
            };
            println!(
                "output mode {:04X}, settings {:08X}: {:?}, orientation as {form}, {:?}",
                c.format.mode.0,
                c.format.settings.0,
                c.format.settings.number_format(),
                c.format.settings.global_frame()
            );
            println!("message: {} bytes", c.format.data_length() + 5);
        }
    }
    for output in identity.outputs.iter().flatten() {
        let every =
            if output.rate == u16::MAX { "every message".into() } else { format!("{} Hz", output.rate) };
        println!("output {:04X}: {} ({every})", output.id, name_of(output.id));
    }
}

fn name_of(id: u16) -> &'static str {
    use mtdata2::xdi;
    match id & 0xFFF0 {
        xdi::TEMPERATURE => "temperature",
        xdi::UTC => "date and time",
        xdi::COUNTER => "counter",
        xdi::SAMPLE_TIME_FINE => "time in 0.1 ms",
        xdi::SAMPLE_TIME_COARSE => "time in s",
        xdi::QUATERNION => "quaternion",
        xdi::MATRIX => "matrix",
        xdi::EULER => "Euler angles",
        xdi::PRESSURE => "pressure",
        xdi::DELTA_VELOCITY => "velocity increment",
        xdi::ACCELERATION => "acceleration",
        xdi::FREE_ACCELERATION => "free acceleration",
        xdi::ACCELERATION_HR => "acceleration, fast",
        xdi::ANGULAR_VELOCITY => "rate of turn",
        xdi::DELTA_ORIENTATION => "orientation increment",
        xdi::ANGULAR_VELOCITY_HR => "rate of turn, fast",
        xdi::MAGNETIC_FIELD => "magnetic field",
        xdi::STATUS_BYTE | xdi::STATUS_WORD => "status",
        _ => "other",
    }
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
    if let Some(baud) = arguments.set_baud {
        set_baud(&line, baud)?;
        line.baud = Some(baud);
    }
    DriverConfig { baud: line.baud, ..config.clone() }.check().map_err(|e| e.to_string())?;
    show(&identify(&line, config, true)?);
    Ok(())
}

fn set_baud(line: &Line, baud: u32) -> Result<(), Failure> {
    let code = crate::protocol::message::baud_code(baud)
        .and_then(|code| baud_from_code(code).map(|_| code))
        .ok_or_else(|| format!("no unit talks at {baud} baud"))?;
    let config = DriverConfig { set_baud: Some(code), ..look() };
    let mut set = false;
    converse(line, config, line.timeout, false, |told| {
        if let Told::Event(event) = told {
            eprintln!("{event}");
            set |= *event == Event::Set { what: MessageId::BAUD_RATE };
            if set {
                // The Reset that brings the rate into force is on the wire: the port stays open until the unit has it.
                std::thread::sleep(Duration::from_millis(100));
            }
            return !set;
        }
        true
    })?;
    if set { Ok(()) } else { Err(format!("the unit at {} did not take {baud} baud; see above", line.port)) }
}

pub(super) fn log(arguments: &Log) -> Result<(), Failure> {
    let out = &arguments.out;
    let cannot = |e: std::io::Error| format!("{} cannot be written: {e}; give another --out", out.display());
    let mut file = File::create(out).map_err(cannot)?;
    let config = if arguments.configure { DriverConfig::default() } else { look() };
    let (mut samples, mut bytes_written) = (0_u64, 0_u64);
    let mut first = None;
    let mut failed = None;
    let forever = 1e9;
    let wait = arguments.duration.map_or(forever, |d| d + arguments.line.timeout);
    converse(&arguments.line, config, wait, true, |told| {
        match told {
            Told::Bytes(bytes) => {
                // Unbuffered: what came before ctrl-c is in the file.
                if let Err(error) = file.write_all(bytes) {
                    failed = Some(cannot(error));
                    return false;
                }
                bytes_written += bytes.len() as u64;
            }
            Told::Event(event) => eprintln!("{event}"),
            Told::Sample(sample) => {
                samples += 1;
                let start = *first.get_or_insert(sample.stamp);
                if samples % 100 == 0 {
                    eprintln!("{samples} samples, {bytes_written} bytes");
                }
                return arguments.duration.is_none_or(|d| sample.stamp.seconds_since(start) < d);
            }
        }
        true
    })?;
    if let Some(failure) = failed {
        return Err(failure);
    }
    if samples == 0 {
        return Err(format!("no sample came from {}; see above", arguments.line.port));
    }
    eprintln!("{}: {samples} samples, {bytes_written} bytes", out.display());
    Ok(())
}
