//! `volant record`.

use crate::terminal;
use bag::{Compression, WriteOptions, is_mcap_file};
use clap::ArgGroup;
use node_kit::outln;
use std::{
    path::PathBuf,
    time::{Duration, SystemTime},
};
use volant::{
    command_line::{UsageError, seconds, topic},
    live::record::{RecordOptions, RecordReport, bag_name, record},
};

#[derive(clap::Args)]
#[command(group(ArgGroup::new("split").args(["split_size", "split_duration"]).multiple(true)))]
pub struct Arguments {
    /// Topics [default: all]
    #[arg(value_parser = topic)]
    topics: Vec<String>,
    /// Bag to write: a new rosbag2 folder, or an .mcap file
    #[arg(short, long, value_name = "OUT", required_unless_present = "into")]
    out: Option<PathBuf>,
    /// Write a new bag in this folder, named by the time: volant_2026-11-23T20-15-00Z
    #[arg(long, value_name = "FOLDER", conflicts_with = "out")]
    into: Option<PathBuf>,
    /// Replace an existing .mcap file
    #[arg(long)]
    overwrite: bool,
    /// Record every topic (the default)
    #[arg(short, long, conflicts_with = "topics")]
    all: bool,
    /// Exclude a topic, in every namespace where it does not begin with a slash; repeatable
    #[arg(short = 'x', long, value_name = "TOPIC")]
    exclude: Vec<String>,
    /// Compression of the chunks
    #[arg(long, value_enum, default_value = "none")]
    compression: Compression,
    /// Start a new file after this many MiB (folders only)
    #[arg(long, value_name = "MIB", value_parser = clap::value_parser!(u64).range(1..=1 << 20))]
    split_size: Option<u64>,
    /// Start a new file after this time, s (folders only)
    #[arg(long, value_name = "SECONDS", value_parser = seconds(0.1..=1e9))]
    split_duration: Option<Duration>,
    /// Keep this many files of a split recording, and remove the oldest when a new one starts; each
    /// new one repeats the latched messages, such as /tf_static
    #[arg(
        long,
        value_name = "FILES",
        requires = "split",
        value_parser = clap::value_parser!(u32).range(1..)
    )]
    keep: Option<u32>,
    /// Stop after this time, s
    #[arg(long, value_name = "SECONDS", value_parser = seconds(0.0..=1e9))]
    duration: Option<Duration>,
}

#[allow(clippy::disallowed_methods, reason = "a shell: it names a file by the time")]
pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let output = match (&arguments.out, &arguments.into) {
        (None, Some(folder)) => folder.join(bag_name(SystemTime::now())),
        (out, _) => out.clone().unwrap_or_default(),
    };
    let is_split = arguments.split_size.is_some() || arguments.split_duration.is_some();
    if is_split && is_mcap_file(&output) {
        let text = format!(
            "{}: a recording with --split-size or --split-duration is a folder; name it without \
             .mcap",
            output.display()
        );
        return Err(UsageError(text).into());
    }
    let options = RecordOptions {
        output: output.clone(),
        topics: arguments.topics.clone(),
        exclude: arguments.exclude.clone(),
        write: WriteOptions {
            compression: arguments.compression,
            split_bytes: arguments.split_size.map(|mib| mib << 20),
            replace: arguments.overwrite,
            in_place: true,
            split_nanos: arguments.split_duration.map(|d| d.as_nanos() as u64),
            keep: arguments.keep.map(|files| files as usize),
            ..WriteOptions::default()
        },
        duration: arguments.duration,
    };
    let stop = node_kit::console::stop_flag()?;
    let bar = terminal::spinner();
    let mut reported = 0;
    let result = record(&options, &stop, |status| {
        for failure in status.failures.iter().skip(reported) {
            bar.suspend(|| terminal::warn(format!("{failure}; it is tried again")));
        }
        reported = status.failures.len();
        bar.set_message(format!(
            "recording {} topics, {} messages, {}{}",
            status.topics,
            status.messages,
            terminal::mebibytes(status.bytes),
            match status.dropped {
                0 => String::new(),
                n => format!(", {n} DROPPED"),
            }
        ));
    });
    bar.finish_and_clear();
    let RecordReport { bag, status, losses } = result?;
    for topic in &status.unpublished {
        terminal::warn(format!(
            "{topic} had no publisher; see `ros2 topic list`, and check ROS_DOMAIN_ID"
        ));
    }
    for loss in &losses {
        terminal::warn(format!(
            "{loss}; the domain was joined again, and messages published meanwhile are \
             missing"
        ));
    }
    if status.dropped > 0 {
        terminal::warn(format!(
            "{} messages were dropped because the disk did not keep up; try --compression none or \
             fewer topics",
            status.dropped
        ));
    }
    if status.lost > 0 {
        terminal::warn(format!(
            "{} messages were lost in transport; set `sysctl net.core.rmem_max` to 4 MB or \
             more",
            status.lost
        ));
    }
    if bag.messages() == 0 {
        terminal::warn("no message was recorded; see `ros2 topic list`, and check ROS_DOMAIN_ID");
    }
    outln!(
        "{} messages, {}, in {}",
        bag.messages(),
        terminal::mebibytes(bag.bytes),
        output.display()
    )?;
    Ok(())
}
