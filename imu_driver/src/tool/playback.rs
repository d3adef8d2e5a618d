//! A log through the driver, as if its unit were there.

use super::{Failure, read_configuration, read_log};
use crate::{
    driver::{Driver, DriverConfig, Event, Input, Output, Severity},
    log::{configuration_in, frames_of},
    protocol::{Configuration, LegacyFormat, MessageId, frame, write_frame},
};
use rig_model::Stamp;
use std::{
    fs::File,
    io::{BufWriter, Write},
    path::PathBuf,
};

/// Which log.
#[derive(Debug, clap::Args)]
pub struct Playback {
    /// Raw bytes recorded from a unit
    log: PathBuf,
    /// The unit's Configuration, where the log holds none
    #[arg(long)]
    config: Option<PathBuf>,
    /// Messages per second, where the Configuration does not say
    #[arg(long, default_value_t = 100.0)]
    rate: f64,
    /// Write what the node would publish: stamp, specific force, rate of turn, orientation (east-north-up)
    #[arg(long)]
    csv: Option<PathBuf>,
}

/// The log's frames as a unit that answers and then streams them.
struct Replayed {
    configuration: Configuration,
    modern: bool,
    data: Vec<Vec<u8>>,
}

fn read(arguments: &Playback) -> Result<Replayed, Failure> {
    let log = read_log(&arguments.log)?;
    let named = |reason: &str| format!("{}: {reason}", arguments.log.display());
    let mut configuration = None;
    let mut data = Vec::new();
    let mut modern = false;
    frames_of(&log, |f| {
        if f.message == MessageId::REQ_CONFIGURATION.ack() {
            configuration = Configuration::from_data(f.data).ok().or(configuration);
        }
        if f.message.is_data() {
            modern |= f.message == MessageId::MT_DATA2;
            let mut bytes = Vec::with_capacity(f.wire_length);
            write_frame(f.bus_id, f.message, f.data, &mut bytes);
            data.push(bytes);
        }
    });
    if data.is_empty() {
        return Err(named("no data message is in it; is it a unit's raw log?"));
    }
    let given = read_configuration(arguments.config.as_deref())?;
    let format = given.or_else(|| configuration_in(&log));
    if !modern && format.is_none() {
        return Err(named("legacy MTData without a Configuration; give it with --config CONFIGURATION.bin"));
    }
    let mut configuration = configuration.unwrap_or_else(|| Configuration {
        period: (115_200.0 / arguments.rate.clamp(2.0, 512.0)).round() as u16,
        ..Configuration::default()
    });
    configuration.format = format.unwrap_or(LegacyFormat::STANDARD);
    Ok(Replayed { configuration, modern, data })
}

impl Replayed {
    fn answer(&self, request: &[u8]) -> Option<Vec<u8>> {
        let message = MessageId(*request.get(2)?);
        let data = match message {
            MessageId::GO_TO_CONFIG | MessageId::GO_TO_MEASUREMENT => vec![],
            MessageId::REQ_DEVICE_ID => (self.configuration.device_id.0 as u32).to_be_bytes().to_vec(),
            MessageId::REQ_PRODUCT_CODE => b"recorded".to_vec(),
            MessageId::REQ_FIRMWARE => vec![0, 0, 0],
            MessageId::REQ_CONFIGURATION => self.configuration.to_data(),
            MessageId::OUTPUT_CONFIGURATION if self.modern => vec![],
            _ => return Some(frame(MessageId::ERROR, &[4])),
        };
        Some(frame(message.ack(), &data))
    }
}

pub(super) fn playback(arguments: &Playback) -> Result<(), Failure> {
    let unit = read(arguments)?;
    let mut table = match &arguments.csv {
        Some(path) => {
            let file = File::create(path)
                .map_err(|e| format!("{} cannot be written: {e}; give another --csv", path.display()))?;
            Some(BufWriter::new(file))
        }
        None => None,
    };
    let mut write = |line: String| -> Result<(), Failure> {
        match &mut table {
            Some(table) => writeln!(table, "{line}").map_err(|e| format!("the table cannot be written: {e}")),
            None => Ok(()),
        }
    };
    write("stamp,acc_x,acc_y,acc_z,gyr_x,gyr_y,gyr_z,q_w,q_x,q_y,q_z".into())?;
    let config =
        DriverConfig { leave_settings: true, transmission_delay: Some(0.0), ..DriverConfig::default() };
    let mut driver = Driver::new(config).map_err(|e| e.to_string())?;
    let period = unit.configuration.ticks_per_message().map_or(0.01, |t| f64::from(t) / 115_200.0);
    let mut at = Stamp::default();
    let mut data = unit.data.iter();
    let (mut samples, mut ended) = (0_u64, false);
    while !ended {
        at = at.plus_seconds(period);
        if driver.is_measuring() {
            match data.next() {
                Some(bytes) => driver.handle(Input::Bytes { bytes, arrival: at }),
                None => {
                    driver.finish();
                    ended = true;
                }
            }
        } else {
            driver.handle(Input::Tick { at });
            // A log that the driver never gets to measure from ends too.
            ended = at.as_nanos() > 60_000_000_000 && samples == 0;
        }
        while let Some(output) = driver.poll() {
            match output {
                Output::Open { .. } => driver.handle(Input::Opened { at }),
                Output::Write(request) => {
                    if let Some(reply) = unit.answer(&request) {
                        driver.handle(Input::Bytes { bytes: &reply, arrival: at });
                    }
                }
                Output::Event(event) => {
                    if event.severity() > Severity::Info || matches!(event, Event::Measuring(_)) {
                        eprintln!("{at}: {event}");
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
    eprintln!(
        "{samples} messages, {} samples, {} lost, {} unreadable",
        statistics.samples, statistics.lost, statistics.unreadable
    );
    if samples == 0 {
        return Err(format!("{}: the driver made no sample of it; see above", arguments.log.display()));
    }
    Ok(())
}
