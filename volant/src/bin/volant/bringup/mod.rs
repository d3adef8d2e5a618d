//! `volant bringup`: from measured lengths to an accepted rig file, step by step.

mod acceptance;
mod camera;
mod dialog;
mod inputs;
mod motion;
mod report;
mod setup;
mod state;

use crate::terminal;
use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use dialog::{Paused, Source, choose};
use node_kit::{files, outln};
use ros_parameters::ParameterFile;
use state::{Item, Outcome, Record, State, Verdict};
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};
use volant::{
    live::record::{self as live, RecordOptions, RecordReport},
    stopwatch::Stopwatch,
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Run this step only [default: all that are not done yet]
    #[arg(value_enum)]
    step: Option<Step>,
    /// Rig file; a new one begins with the values of a common rig
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// HTML page to write with the result of every step
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    /// Replace an existing report
    #[arg(long)]
    overwrite: bool,
    /// Begin again: forget which steps are done. The rig file stays
    #[arg(long)]
    restart: bool,
}

/// Steps, in their order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Step {
    /// Measure the rig, print the marker squares
    Markers,
    /// Find the IMU, measure its noise
    Imu,
    /// Check rate, stamps and exposure of the images, measure the markers' colors
    Camera,
    /// Calibrate the lens
    Intrinsics,
    /// Find the encoders' names, signs, scales, zeros and the height
    Encoders,
    /// Refine mountings and marker positions
    Mounting,
    /// Compare the clocks
    Offsets,
    /// Judge a run with the finished rig file
    Acceptance,
}

impl Step {
    /// The name on the command line.
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    fn run(self, walk: &mut Walk) -> Result<()> {
        match self {
            Self::Markers => setup::markers(walk),
            Self::Imu => setup::imu(walk),
            Self::Camera => camera::camera(walk),
            Self::Intrinsics => camera::intrinsics(walk),
            Self::Encoders => motion::encoders(walk),
            Self::Mounting => motion::mounting(walk),
            Self::Offsets => motion::offsets(walk),
            Self::Acceptance => acceptance::acceptance(walk),
        }
    }
}

/// A bring-up under way.
struct Walk {
    rig: PathBuf,
    /// Name of the present step.
    step: String,
    /// Recordings, figures and sheets that the steps make.
    folder: PathBuf,
    state: State,
    /// Items of the present step.
    items: Vec<Item>,
    /// Files that it wrote.
    wrote: Vec<String>,
}

impl Walk {
    fn item(&mut self, verdict: Verdict, name: &str, text: impl Into<String>) -> Result<()> {
        let text = text.into();
        outln!("  {:<5}{name}: {text}", verdict.word())?;
        self.items.push(Item { name: name.to_owned(), verdict, text });
        Ok(())
    }

    fn check(&mut self, passes: bool, name: &str, text: impl Into<String>) -> Result<()> {
        self.item(if passes { Verdict::Pass } else { Verdict::Fail }, name, text)
    }

    fn note(&mut self, name: &str, text: impl Into<String>) -> Result<()> {
        self.item(Verdict::Note, name, text)
    }

    /// Path of a file of this bring-up.
    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Names of the rig file's parameters that differ from a former text.
    fn changed_since(&self, before: &str) -> Vec<String> {
        changed(before, &fs::read_to_string(&self.rig).unwrap_or_default())
    }

    /// Notes a file that the step has written.
    fn wrote(&mut self, path: &Path) {
        self.wrote.push(path.display().to_string());
    }

    /// The recording of some topics under a name: a bag of the operator's, or a new one.
    fn recording(&mut self, name: &str, topics: &[&str], seconds: f64) -> Result<PathBuf> {
        // A live recording is made again: its step is repeated because the rig has changed.
        let real = |path: &Path| fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let is_own = |path: &Path| real(path).starts_with(real(&self.folder));
        let known = self.state.recordings.get(name).filter(|path| !is_own(path));
        outln!("  Topics: {}", topics.join(", "))?;
        let path = match dialog::source(known.map(PathBuf::as_path), seconds)? {
            Source::Live(seconds) => {
                let path = self.file(&format!("{name}.mcap"));
                record(&path, topics, seconds)?;
                self.wrote(&path);
                path
            }
            Source::Bag(path) => path,
        };
        self.state.recordings.insert(name.to_owned(), path.clone());
        Ok(path)
    }
}

/// Time in which the publishers of a recording's topics are discovered.
const DISCOVERY: Duration = Duration::from_secs(5);

fn record(path: &Path, topics: &[&str], seconds: f64) -> Result<()> {
    outln!("  recording {seconds} s …")?;
    // A former recording stays where nobody publishes.
    let new = path.with_extension("new.mcap");
    let options = RecordOptions {
        output: new.clone(),
        topics: topics.iter().map(|t| format!("/{t}")).collect(),
        exclude: vec![],
        // The recording of an earlier try of this step.
        write: bag::WriteOptions { replace: true, ..bag::WriteOptions::default() },
        duration: Some(Duration::try_from_secs_f64(seconds)?),
    };
    let (stop, watch, mut reported) = (AtomicBool::new(false), Stopwatch::start(), false);
    let RecordReport { status, .. } = live::record(&options, &stop, |status| {
        let unpublished = &status.unpublished;
        if reported || unpublished.is_empty() || watch.elapsed() < DISCOVERY {
            return;
        }
        reported = true;
        if unpublished.len() == topics.len() {
            stop.store(true, Ordering::Release);
        } else {
            // A closed pipe ends the next question.
            let _ = outln!("  no publisher so far: {}", unpublished.join(", "));
        }
    })?;
    if status.unpublished.len() == topics.len() {
        fs::remove_file(new)?;
        bail!(
            "nobody publishes {}; start the drivers and the nodes, and check ROS_DOMAIN_ID",
            status.unpublished.join(" or ")
        );
    }
    fs::rename(new, path)?;
    for topic in status.unpublished {
        outln!("  {topic}: no publisher")?;
    }
    for failure in status.failures {
        outln!("  {failure}")?;
    }
    Ok(())
}

/// Runs the command; a failed step is an error at the end or before a pause.
pub fn run(arguments: &Arguments) -> Result<()> {
    let beside = |suffix: &str| {
        let mut name = arguments.rig.as_os_str().to_owned();
        name.push(suffix);
        PathBuf::from(name)
    };
    let (state_file, folder) = (beside(".bringup.json"), beside(".bringup"));
    let state = if arguments.restart { State::default() } else { State::read(&state_file)? };
    // The report of an earlier part of this bring-up is replaced.
    let overwrite =
        arguments.overwrite || state.report.is_some() && state.report == arguments.report;
    if let Some(path) = &arguments.report {
        files::check_outputs(&[path], overwrite, &[&arguments.rig, &state_file])?;
        // Files that do not exist yet are compared by their names.
        files::check_outputs(&[path, &arguments.rig, &state_file], true, &[])?;
    }
    // Nothing is written before the first answer.
    setup::read(&arguments.rig)?;
    let (rig, step) = (arguments.rig.clone(), String::new());
    let mut walk = Walk { rig, step, folder, state, items: vec![], wrote: vec![] };
    let mut steps = Step::value_variants().iter().copied();
    let walked = match arguments.step {
        Some(step) => take(step, &mut walk, &state_file),
        // A step may put later ones out of date.
        None => steps.try_for_each(|step| match walk.state.outcome(&step.name()) {
            Some(Outcome::Done) => Ok(()),
            _ => take(step, &mut walk, &state_file),
        }),
    };
    let paused = match walked {
        Err(error) if error.is::<Paused>() => Some(error),
        walked => walked.map(|()| None)?,
    };
    match &paused {
        Some(paused) => outln!("{paused}")?,
        None => summary(&walk.state)?,
    }
    if let Some(path) = &arguments.report {
        let page = report::page(&arguments.rig, &walk.state).render();
        files::write(path, page.as_bytes(), overwrite)?;
        terminal::line(&format!("{}: written", path.display()));
        walk.state.report = Some(path.clone());
        walk.state.write(&state_file)?;
    }
    let failed: Vec<String> = Step::value_variants()
        .iter()
        .map(|step| step.name())
        .filter(|n| walk.state.outcome(n) == Some(Outcome::Failed))
        .collect();
    if !failed.is_empty() {
        bail!(
            "{}: not accepted: {} failed; correct the causes above and run it again",
            arguments.rig.display(),
            failed.join(", ")
        );
    }
    Ok(())
}

/// Runs a step until it is done, skipped or given up, and keeps its result.
fn take(step: Step, walk: &mut Walk, state_file: &Path) -> Result<()> {
    let (steps, name) = (Step::value_variants(), step.name());
    let number = steps.iter().position(|s| *s == step).unwrap_or(0) + 1;
    let from = |first: usize| steps.iter().skip(first).map(|s| s.name());
    outln!("\n{number}/{} {name}", steps.len())?;
    walk.step.clone_from(&name);
    loop {
        (walk.items, walk.wrote) = (vec![], vec![]);
        let answer = choose("  Enter: begin, s: skip, q: quit", &["", "s"])?;
        let before = fs::read_to_string(&walk.rig).unwrap_or_default();
        let outcome = if answer == "s" {
            Outcome::Skipped
        } else {
            fs::create_dir_all(&walk.folder).with_context(|| walk.folder.display().to_string())?;
            setup::complete(&walk.rig)?;
            match step.run(walk) {
                Ok(()) => {}
                Err(error) if error.is::<Paused>() => {
                    if !walk.changed_since(&before).is_empty() {
                        walk.state.outdate(from(number - 1));
                    }
                    walk.state.write(state_file)?;
                    return Err(error);
                }
                Err(error) => walk.item(Verdict::Fail, &name, format!("{error:#}"))?,
            }
            let fails = walk.items.iter().any(|i| i.verdict == Verdict::Fail);
            if fails { Outcome::Failed } else { Outcome::Done }
        };
        let changed = walk.changed_since(&before);
        if !changed.is_empty() {
            walk.wrote.push(format!("{}: {}", walk.rig.display(), changed.join(", ")));
        }
        for wrote in &walk.wrote {
            outln!("  wrote {wrote}")?;
        }
        if !changed.is_empty() {
            let outdated = walk.state.outdate(from(number));
            if !outdated.is_empty() {
                outln!("  out of date: {}", outdated.join(", "))?;
            }
        }
        let record = Record { outcome, items: walk.items.clone(), wrote: walk.wrote.clone() };
        walk.state.steps.insert(name.clone(), record);
        walk.state.write(state_file)?;
        let question = "  r: repeat this step, Enter: go on, q: quit";
        if outcome != Outcome::Failed || choose(question, &["", "r"])? != "r" {
            return Ok(());
        }
    }
}

/// Names of the parameters in which two parameter files differ.
fn changed(before: &str, after: &str) -> Vec<String> {
    let nodes = ["/**", "/climber_driver", "/pose_fusion"];
    let mut names = vec![];
    let parsed = [before, after].map(|text| ParameterFile::parse(text).unwrap_or_default());
    for node in nodes {
        let [old, new] = [0, 1].map(|i| parsed[i].for_node(node));
        for (name, value) in new {
            if old.get(&name) != Some(&value) && !names.contains(&name) {
                names.push(name);
            }
        }
    }
    names
}

fn summary(state: &State) -> Result<()> {
    outln!("")?;
    for name in Step::value_variants().iter().map(|step| step.name()) {
        let Some(record) = state.steps.get(&name) else {
            outln!("{name:<12}not done")?;
            continue;
        };
        outln!("{name:<12}{}", record.outcome.word())?;
        for item in record.items.iter().filter(|i| i.verdict == Verdict::Fail) {
            outln!("            {}: {}", item.name, item.text)?;
        }
    }
    Ok(())
}
