//! `volant replay`.

use crate::{
    settings::{self, BagTopics},
    terminal,
};
use anyhow::Context;
use bag::{BagReader, BagWriter, Compression};
use node_kit::{out, outln};
use pose_fusion::Model;
use std::path::{Path, PathBuf};
use volant::{
    command_line::{UsageError, quoted},
    replay::{ReplayOptions, ReplayReport, decoding_threads, replay},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Bag: an .mcap file or a rosbag2 folder
    input: PathBuf,
    /// Rig file
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// Bag to write: an .mcap file or a new folder
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    /// Replace an existing .mcap file
    #[arg(long)]
    overwrite: bool,
    /// ROS 2 parameter file of the nodes, in addition to the rig file; repeatable
    #[arg(long, value_name = "FILE")]
    params_file: Vec<PathBuf>,
    /// Estimator [default: that of the parameter files, else tight]
    #[arg(long, value_enum)]
    model: Option<ModelName>,
    #[command(flatten)]
    topics: BagTopics,
    /// Compression of the output
    #[arg(long, value_enum, default_value = "zstd")]
    compression: Compression,
    /// Add volant/smoothed_odometry: smoothing, each estimate also from at least the 20 s of data
    /// that follow it
    #[arg(long)]
    smooth: bool,
    /// Threads that decode images [default: number of cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    threads: Option<u16>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum ModelName {
    /// The error-state filter on the markers' pixels
    Tight,
    /// The published loosely coupled filter
    Paper,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    if arguments.smooth && matches!(arguments.model, Some(ModelName::Paper)) {
        let text = "--smooth requires the error-state filter; remove --model paper";
        return Err(UsageError(text.to_owned()).into());
    }
    let more = &arguments.params_file;
    let inputs: Vec<&Path> =
        [&arguments.input, &arguments.rig].into_iter().chain(more).map(PathBuf::as_path).collect();
    BagWriter::check(&arguments.out, arguments.overwrite, &inputs)?;
    let mut cores = settings::read(&arguments.rig, more, &arguments.topics)?;
    let model = match arguments.model {
        Some(ModelName::Tight) => Model::Tight,
        Some(ModelName::Paper) => Model::Paper,
        None => cores.fusion.model,
    };
    cores.fusion.model = model;
    anyhow::ensure!(
        !arguments.smooth || model == Model::Tight,
        "--smooth requires the error-state filter; add --model tight"
    );
    let workers = arguments.threads.map_or_else(decoding_threads, usize::from).clamp(1, 64);
    let options = ReplayOptions {
        input: arguments.input.clone(),
        output: arguments.out.clone(),
        overwrite: arguments.overwrite,
        cores,
        compression: arguments.compression,
        workers,
        smooth: arguments.smooth,
    };
    let bytes = BagReader::summary(&arguments.input)?.bytes;
    let bar = terminal::progress("replay", bytes);
    let result = replay(&options, |read| bar.set_position(read));
    bar.finish_and_clear();
    let report = result.context("replay")?;
    report.losses.iter().for_each(terminal::warn);
    report.counts.warning_lines().for_each(terminal::warn);
    for finding in &report.counts.findings {
        let check = check_command(arguments);
        terminal::warn(format!("rig file: {finding}; find the cause with `{check}`"));
    }
    let namespace = arguments.topics.namespace.trim_matches('/');
    if !namespace.is_empty() {
        outln!("namespace /{namespace}")?;
    }
    out!("{}", summary(&report, model, workers))?;
    outln!("wrote     {}", arguments.out.display())?;
    Ok(())
}

/// The `volant check` of the same files and topics, quoted for a shell.
fn check_command(arguments: &Arguments) -> String {
    let mut words = vec!["volant".to_owned(), "check".to_owned()];
    words.push(arguments.input.display().to_string());
    let mut add = |option: &str, value: String| words.extend([option.to_owned(), value]);
    add("--rig", arguments.rig.display().to_string());
    arguments.params_file.iter().for_each(|f| add("--params-file", f.display().to_string()));
    let topics = &arguments.topics;
    if !topics.namespace.is_empty() {
        add("--namespace", topics.namespace.clone());
    }
    topics.remap.iter().for_each(|remap| add("--remap", remap.to_string()));
    quoted(&words)
}

fn summary(report: &ReplayReport, model: Model, workers: usize) -> String {
    let c = &report.counts;
    let share = |part: u64, of: u64| if of == 0 { 0.0 } else { 100.0 * part as f64 / of as f64 };
    let wall = report.wall.as_secs_f64().max(1e-9);
    let mut out = String::new();
    if c.images > 0 {
        out += &format!("images    {}\n", c.images);
    }
    out += &format!(
        "markers   {} detected of {} ({:.1} %){}\n",
        c.detected,
        4 * c.markers,
        share(c.detected, 4 * c.markers),
        match model {
            Model::Tight =>
                format!(", {} used by the filter ({:.1} %)", c.used, share(c.used, 4 * c.markers)),
            // It uses visual poses, counted below.
            Model::Paper => String::new(),
        }
    );
    out += &format!("inputs    {} IMU samples, {} climber transforms\n", c.imu, c.climber);
    out += &format!(
        "outputs   {} odometries, {} visual poses; after the first second {:.2} % of the IMU \
         samples, longest gap {:.1} ms\n",
        c.odometry,
        c.visual,
        share(c.odometry_settled, c.imu_settled),
        c.longest_gap * 1e3
    );
    if c.smoothed > 0 {
        out += &format!("smoothed  {} odometries\n", c.smoothed);
    }
    out += &format!(
        "time      {:.2} s for {:.2} s: {:.1} x real time, {workers} decoding thread{}\n",
        wall,
        report.recorded,
        report.recorded / wall,
        if workers == 1 { "" } else { "s" }
    );
    out
}
