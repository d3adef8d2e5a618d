//! `volant replay`.

#[cfg(feature = "nodes")]
use crate::settings;
use crate::{say, settings::Settings};
use anyhow::Context;
use launch_config::{
    bag::{BagReader, Compression},
    replay::{ReplayOptions, ReplayReport, TopicNames, replay},
};
use pose_fusion::Model;
use rig_model::Rig;
use std::{path::PathBuf, time::Duration};

#[derive(clap::Args)]
pub struct Arguments {
    /// The bag: an .mcap file or a rosbag2 folder
    input: PathBuf,
    /// The rig file
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// The bag to write: an .mcap file (one that is there is replaced) or a new folder
    #[arg(long, value_name = "OUT")]
    out: PathBuf,
    #[cfg(feature = "nodes")]
    /// A parameter file of the nodes: marker_tracker and pose_fusion are set as it says; may be given several times
    #[arg(long, value_name = "FILE")]
    params_file: Vec<PathBuf>,
    /// Which estimator, whatever a parameter file says (tight where none says anything)
    #[arg(long, value_enum)]
    model: Option<ModelName>,
    /// The namespace of the rig's topics in the bag
    #[arg(long, default_value = "")]
    namespace: String,
    /// Another name of a topic, as from:=to; may be given several times
    #[arg(long, value_name = "FROM:=TO")]
    remap: Vec<String>,
    /// How the output is compressed
    #[arg(long, value_enum, default_value = "zstd")]
    compression: Compression,
    /// Adds volant/smoothed_odometry: forwards and backwards over the bag, every estimate with the knowledge of what came
    /// after it
    #[arg(long)]
    smooth: bool,
    /// Threads that decode images; as many as there are cores without it
    #[arg(long, value_name = "N")]
    threads: Option<usize>,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum ModelName {
    /// The error-state filter on the markers' pixels
    Tight,
    /// The published loosely coupled filter
    Paper,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let rig = node_kit::files::read_text(&arguments.rig)
        .map_err(anyhow::Error::from)
        .and_then(|text| Ok(Rig::from_yaml(&text)?))
        .with_context(|| format!("{}: not a usable rig file", arguments.rig.display()))?;
    #[cfg(feature = "nodes")]
    let settings = settings::read(&arguments.rig, rig, &arguments.params_file, &arguments.namespace)?;
    #[cfg(not(feature = "nodes"))]
    let settings = Settings::of(rig);
    let Settings { rig, tracker, mut fusion } = settings;
    match arguments.model {
        Some(ModelName::Tight) => fusion.model = Model::Tight,
        Some(ModelName::Paper) => fusion.model = Model::Paper,
        None => {}
    }
    anyhow::ensure!(
        !arguments.smooth || fusion.model == Model::Tight,
        "--smooth needs the error-state filter: leave --model paper out"
    );
    let workers = arguments
        .threads
        .unwrap_or_else(|| std::thread::available_parallelism().map_or(1, usize::from))
        .clamp(1, 64);
    let options = ReplayOptions {
        input: arguments.input.clone(),
        tracker,
        rig,
        output: arguments.out.clone(),
        fusion,
        names: TopicNames::new(&arguments.namespace, &arguments.remap)?,
        compression: arguments.compression,
        workers,
        smooth: arguments.smooth,
    };
    let bytes = BagReader::summary(&arguments.input)?.bytes;
    let bar = say::progress("replay", bytes);
    let result = replay(&options, |read, _| bar.set_position(read));
    bar.finish_and_clear();
    let report = result.context("replay")?;
    for loss in &report.losses {
        say::line(&format!("volant: {loss}"));
    }
    for (count, sentence) in report.counts.said.values() {
        let times = if *count > 1 { format!(" ({count} times)") } else { String::new() };
        say::line(&format!("volant: {sentence}{times}"));
    }
    print!("{}", summary(&report, workers));
    println!("wrote     {}", arguments.out.display());
    Ok(())
}

fn summary(report: &ReplayReport, workers: usize) -> String {
    let (c, s) = (&report.counts, &report.spent);
    let share = |part: u64, of: u64| if of == 0 { 0.0 } else { 100.0 * part as f64 / of as f64 };
    let seconds = |d: Duration| d.as_secs_f64();
    let work = seconds(report.decoding) + seconds(s.tracker) + seconds(s.fusion) + seconds(s.output);
    let of_work = |d: Duration| if work > 0.0 { 100.0 * seconds(d) / work } else { 0.0 };
    let wall = seconds(report.wall).max(1e-9);
    let mut out = String::new();
    if c.images > 0 {
        out += &format!("images    {}\n", c.images);
    }
    out += &format!(
        "markers   {} detected of {} ({:.1} %), {} used by the filter ({:.1} %)\n",
        c.detected,
        4 * c.markers,
        share(c.detected, 4 * c.markers),
        c.used,
        share(c.used, 4 * c.markers)
    );
    out += &format!("inputs    {} inertial samples, {} climber transforms\n", c.imu, c.climber);
    out += &format!(
        "outputs   {} odometries, {} visual poses; after the first second {:.2} % of the inertial samples, longest gap {:.1} ms\n",
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
    out += &format!(
        "work      {work:.3} s of one core: {:.1} % outside JPEG decoding (tracker {:.1} %, filter {:.1} %, output {:.1} %)\n",
        100.0 - of_work(report.decoding),
        of_work(s.tracker),
        of_work(s.fusion),
        of_work(s.output)
    );
    out
}
