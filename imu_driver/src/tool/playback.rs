//! Processing of a log with the driver.

use super::{Failure, inputs, read_configuration, read_log};
use crate::{
    driver::{Driver, DriverConfig, Event, Input, Output, Severity},
    log::{configuration_in, frames_of},
    protocol::{
        Configuration, LegacyFormat, MessageId, OutputEntry,
        configuration::{output_configuration_from_data, output_configuration_to_data},
        frame,
        mtdata2::xdi,
    },
};
use node_kit::{
    errln,
    files::{FileError, OutputFile, check_output},
};
use rig_model::Stamp;
use std::{
    io::{BufWriter, Write},
    path::PathBuf,
};

/// Arguments of `volant imu playback`.
#[derive(Debug, clap::Args)]
pub struct Playback {
    /// Raw bytes recorded from an IMU
    log: PathBuf,
    /// Configuration of the IMU, if the log contains none
    #[arg(long)]
    config: Option<PathBuf>,
    /// Message rate in Hz, if the log contains no configuration with it
    #[arg(long, default_value_t = 100.0)]
    rate: f64,
    /// CSV to write, as published by the node: stamp, specific force, angular velocity, orientation
    /// (east-north-up)
    #[arg(long)]
    csv: Option<PathBuf>,
    /// Replace an existing file
    #[arg(long)]
    overwrite: bool,
}

/// Frames of a log, and the answers of its device.
struct Replayed {
    configuration: Configuration,
    /// Output configuration of a log with MTData2.
    outputs: Option<Vec<OutputEntry>>,
    data: Vec<Vec<u8>>,
}

fn read(arguments: &Playback) -> Result<Replayed, Failure> {
    let log = read_log(&arguments.log)?;
    let named = |reason: &str| Failure::from(format!("{}: {reason}", arguments.log.display()));
    let mut configuration: Option<Configuration> = None;
    let mut data = Vec::new();
    let mut modern = false;
    let mut outputs: Option<Vec<OutputEntry>> = None;
    frames_of(&log, |f| {
        if f.message == MessageId::REQ_CONFIGURATION.ack() {
            configuration = Configuration::from_data(f.data).ok().or(configuration);
        }
        if f.message == MessageId::OUTPUT_CONFIGURATION.ack() && !f.data.is_empty() {
            outputs = output_configuration_from_data(f.data).ok().or(outputs.take());
        }
        if f.message.is_data() {
            modern |= f.message == MessageId::MT_DATA2;
            data.push(frame(f.message, f.data));
        }
    });
    if data.is_empty() {
        return Err(named("no data message; give the raw bytes of an IMU"));
    }
    let given = read_configuration(arguments.config.as_deref())?;
    let format = given.or_else(|| configuration_in(&log));
    if !modern && format.is_none() {
        return Err(named(
            "legacy MTData without a Configuration; give one with --config CONFIGURATION.bin",
        ));
    }
    let rate = configuration.and_then(|c| c.rate()).unwrap_or(arguments.rate);
    let outputs = modern.then(|| {
        let rate = rate.round().clamp(1.0, 2000.0) as u16;
        outputs.unwrap_or_else(|| vec![OutputEntry { id: xdi::ACCELERATION, rate }])
    });
    let mut configuration = configuration.unwrap_or_else(|| Configuration {
        period: (115_200.0 / arguments.rate.clamp(2.0, 512.0)).round() as u16,
        ..Configuration::default()
    });
    configuration.format = format.unwrap_or(LegacyFormat::STANDARD);
    Ok(Replayed { configuration, outputs, data })
}

impl Replayed {
    fn answer(&self, request: &[u8]) -> Option<Vec<u8>> {
        let message = MessageId(*request.get(2)?);
        let data = match message {
            MessageId::GO_TO_CONFIG | MessageId::GO_TO_MEASUREMENT => vec![],
            MessageId::REQ_DEVICE_ID => {
                (self.configuration.device_id.0 as u32).to_be_bytes().to_vec()
            }
            MessageId::REQ_PRODUCT_CODE => b"recorded".to_vec(),
            MessageId::REQ_FIRMWARE => vec![0, 0, 0],
            MessageId::REQ_CONFIGURATION => self.configuration.to_data(),
            MessageId::OUTPUT_CONFIGURATION => match &self.outputs {
                Some(outputs) => output_configuration_to_data(outputs),
                None => return Some(frame(MessageId::ERROR, &[4])),
            },
            _ => return Some(frame(MessageId::ERROR, &[4])),
        };
        Some(frame(message.ack(), &data))
    }
}

pub(super) fn playback(arguments: &Playback) -> Result<(), Failure> {
    let inputs = inputs(&arguments.log, arguments.config.as_deref());
    let mut table = match &arguments.csv {
        Some(path) => {
            check_output(path, arguments.overwrite, &inputs)?;
            Some(BufWriter::new(OutputFile::create(path, arguments.overwrite)?))
        }
        None => None,
    };
    let log = read(arguments)?;
    let cannot = |source| FileError::Io { path: arguments.csv.clone().unwrap_or_default(), source };
    let mut write = |line: String| -> Result<(), Failure> {
        match &mut table {
            Some(table) => Ok(writeln!(table, "{line}").map_err(cannot)?),
            None => Ok(()),
        }
    };
    write("stamp,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,q_w,q_x,q_y,q_z".into())?;
    let config =
        DriverConfig { leave_settings: true, transmission_delay: 0.0, ..DriverConfig::default() };
    let mut driver = Driver::new(config).map_err(|e| e.to_string())?;
    let mut period =
        log.configuration.ticks_per_message().map_or(0.01, |t| f64::from(t) / 115_200.0);
    let mut at = Stamp::default();
    let mut data = log.data.iter();
    let (mut samples, mut ended) = (0_u64, false);
    while !ended {
        at = at.plus_seconds(period);
        if driver.is_measuring() {
            // Messages arrive at the rate that the driver has read.
            period = 1.0 / driver.statistics().rate;
            match data.next() {
                Some(bytes) => driver.handle(Input::Bytes { bytes, arrival: at }),
                None => {
                    driver.finish();
                    ended = true;
                }
            }
        } else {
            driver.handle(Input::Tick { at });
            // Ends if the driver never enters the measurement state.
            ended = at.as_nanos() > 60_000_000_000 && samples == 0;
        }
        while let Some(output) = driver.poll() {
            match output {
                Output::Open { .. } => driver.handle(Input::Opened { at }),
                Output::Write(request) => {
                    if let Some(reply) = log.answer(&request) {
                        driver.handle(Input::Bytes { bytes: &reply, arrival: at });
                    }
                }
                Output::Event(event) => {
                    if event.severity() > Severity::Info || matches!(event, Event::Measuring(_)) {
                        errln!("{at}: {event}");
                    }
                }
                Output::Sample(sample) => {
                    samples += 1;
                    if let Some(imu) = &sample.imu {
                        let (f, w) = (&imu.specific_force, &imu.angular_velocity);
                        let q = imu.orientation.as_ref().map_or(",,,".to_owned(), |o| {
                            let q = &o.enu_from_imu;
                            format!("{},{},{},{}", q.w, q.i, q.j, q.k)
                        });
                        write(format!(
                            "{},{},{},{},{},{},{},{q}",
                            sample.stamp, f.x, f.y, f.z, w.x, w.y, w.z
                        ))?;
                    }
                }
                Output::SetBaud(_) | Output::Close => {}
            }
        }
    }
    let statistics = driver.statistics();
    errln!(
        "{samples} messages, {} samples, {} lost, {} unreadable",
        statistics.samples,
        statistics.lost,
        statistics.unreadable
    );
    if samples == 0 {
        let log = arguments.log.display();
        return Err(format!("{log}: no sample was decoded; see the messages above").into());
    }
    if let Some(table) = table {
        table.into_inner().map_err(|e| cannot(e.into_error()))?.commit()?;
    }
    Ok(())
}
