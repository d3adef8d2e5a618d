//! `volant record`.

use crate::{say, signals};
use launch_config::{
    bag::{Compression, WriteOptions},
    live::record::{RecordOptions, record},
};
use std::{path::PathBuf, sync::atomic::Ordering, time::Duration};

#[derive(clap::Args)]
pub struct Arguments {
    /// Topics; all without any
    topics: Vec<String>,
    /// The bag to write: a new folder, as rosbag2 has it, or an .mcap file
    #[arg(short, long, value_name = "OUT")]
    out: PathBuf,
    /// Records every topic, which is what happens without a name too
    #[arg(short, long, conflicts_with = "topics")]
    all: bool,
    /// Leaves a topic out; may be given several times
    #[arg(short = 'x', long, value_name = "TOPIC")]
    exclude: Vec<String>,
    /// How chunks are compressed
    #[arg(long, value_enum, default_value = "none")]
    compression: Compression,
    /// Begins a new file beyond so many MiB (folders only)
    #[arg(long, value_name = "MIB")]
    split_size: Option<u64>,
    /// Begins a new file after so many seconds (folders only)
    #[arg(long, value_name = "SECONDS")]
    split_duration: Option<f64>,
    /// Ends by itself after so many seconds
    #[arg(long, value_name = "SECONDS")]
    duration: Option<f64>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let absolute = |name: &String| if name.starts_with('/') { name.clone() } else { format!("/{name}") };
    let seconds = |s: f64| Duration::try_from_secs_f64(s).unwrap_or(Duration::MAX);
    let options = RecordOptions {
        output: arguments.out.clone(),
        topics: arguments.topics.iter().map(absolute).collect(),
        exclude: arguments.exclude.iter().map(absolute).collect(),
        write: WriteOptions {
            compression: arguments.compression,
            split_bytes: arguments.split_size.map(|mib| mib << 20),
            split_nanos: arguments.split_duration.map(|s| (s.max(0.0) * 1e9) as u64),
            ..WriteOptions::default()
        },
        duration: arguments.duration.map(seconds),
    };
    let stop = signals::stop_flag()?;
    let bar = say::spinner();
    let result = record(&options, &stop, |status| {
        bar.set_message(format!(
            "recording {} topics, {} messages, {}{}",
            status.topics.load(Ordering::Relaxed),
            status.messages.load(Ordering::Relaxed),
            say::mebibytes(status.bytes.load(Ordering::Relaxed)),
            match status.dropped.load(Ordering::Relaxed) {
                0 => String::new(),
                n => format!(", {n} DROPPED"),
            }
        ));
    });
    bar.finish_and_clear();
    let report = result?;
    for topic in &report.unseen {
        say::line(&format!(
            "volant: nobody published {topic}; see `ros2 topic list`, and check ROS_DOMAIN_ID"
        ));
    }
    for loss in &report.losses {
        say::line(&format!(
            "volant: {loss}; the domain was joined anew, and what was published meanwhile is not in the bag"
        ));
    }
    if report.dropped > 0 {
        say::line(&format!(
            "volant: {} messages were lost, the disk did not keep up; try --compression none or fewer topics",
            report.dropped
        ));
    }
    if report.lost > 0 {
        say::line(&format!(
            "volant: {} messages were lost on the way here; `sysctl net.core.rmem_max` of 4 MB or more helps",
            report.lost
        ));
    }
    let bag = report.bag;
    println!("{} messages, {}, in {}", bag.messages(), say::mebibytes(bag.bytes), arguments.out.display());
    Ok(())
}
