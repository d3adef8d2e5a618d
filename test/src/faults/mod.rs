//! Faults on real processes: each row of the table breaks one part of a live rig for some seconds
//! and asserts on what the nodes published meanwhile and afterwards.
//!
//! [`table`] has the rows, [`Row::run`] runs one, [`markdown`] writes the table of the results.

mod injectors;
pub(crate) mod outcome;
mod recording;
mod table;

pub use outcome::{Outcome, Verdict};
pub use table::table;

use crate::live::{ImageSequence, Run, Scenario, Site, bag};
use anyhow::{Result, anyhow};
use node_kit::environment::Network;
use rig_model::Stamp;
use std::{fmt::Write, path::Path, sync::Arc};

/// Seconds of the scenario at which a fault begins and ends.
pub const WINDOW: [f64; 2] = [2.0, 5.0];
/// Length of the scenario, s.
pub const LENGTH: f64 = 9.0;

/// A live rig, and what a fault needs of it.
pub struct Bench<'a> {
    pub run: &'a mut Run,
    /// Stamp of the scenario's zero.
    pub epoch: Stamp,
    pub scenario: &'a Scenario,
    /// What the row itself found.
    pub notes: &'a mut Notes,
}

/// What a row finds beside the rig's own messages.
#[derive(Clone, Debug, Default)]
pub struct Notes {
    /// Report of the fault by a process without diagnostics.
    pub report: Option<String>,
    pub failures: Vec<String>,
}

type Action = Box<dyn Fn(&mut Bench<'_>) -> Result<()>>;

/// What the odometry does while the fault lasts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Flow {
    /// It comes with every IMU sample.
    Unbroken,
    /// It stops, because no pose can be estimated.
    Stops,
    /// It has gaps.
    Gaps,
}

/// One row: a fault and what must hold.
pub struct Row {
    pub fault: &'static str,
    begin: Action,
    end: Action,
    pub flow: Flow,
    /// Node whose diagnostics must report the fault at WARN or above, and words of which one must
    /// occur in the line: they name the fault itself, so that no other fault is accepted in its
    /// place. `None`: too small to be reported, or the reporting node is gone.
    pub diagnostics: Option<(&'static str, &'static [&'static str])>,
    /// Largest time from its end until the pose is back, s.
    pub back_within: f64,
    /// Ends of nodes by a signal that belong to the fault.
    pub kills: Option<&'static str>,
    /// So far ahead the nodes' clock is set while the fault lasts, s; 0: it is left alone.
    pub clock_ahead: f64,
}

impl Row {
    pub fn start(&self, bench: &mut Bench<'_>) -> Result<()> {
        (self.begin)(bench)
    }

    pub fn stop(&self, bench: &mut Bench<'_>) -> Result<()> {
        (self.end)(bench)
    }

    /// May it come again and again in a long run?
    pub fn soaks(&self) -> bool {
        !self.fault.starts_with("disk full") && self.clock_ahead == 0.0
    }

    /// Runs the row on the DDS domain of `network`, in `folder`, and writes its bag where one is
    /// asked for. An error means that there is no verdict.
    pub fn run(
        &self,
        scenario: &Scenario,
        images: &Arc<ImageSequence>,
        network: &Network,
        folder: &Path,
        bag: Option<&Path>,
    ) -> Result<Outcome> {
        let site = Site { settable_clock: self.clock_ahead != 0.0, ..Site::here(network) };
        let mut run = Run::start(scenario, Arc::clone(images), &site, folder)?;
        run.wait_for_pose(30.0)?;
        let epoch = run.begin();
        run.play_until(WINDOW[0], |_, _| {})?;
        let mut notes = Notes::default();
        (self.begin)(&mut Bench { run: &mut run, epoch, scenario, notes: &mut notes })?;
        wait(&mut run, WINDOW[1], self.kills.is_some())?;
        (self.end)(&mut Bench { run: &mut run, epoch, scenario, notes: &mut notes })?;
        wait(&mut run, LENGTH - 0.2, self.kills.is_some())?;
        let logs = folder.to_owned();
        let ended = run.finish()?;
        if let Some(bag) = bag {
            bag::write(bag, scenario, epoch, &ended.sent, &ended.received)
                .map_err(|error| anyhow!("the run's bag: {error}"))?;
        }
        Ok(outcome::judge(self, scenario, &ended, &logs, notes))
    }
}

/// Waits for a time of the scenario; a node that ended meanwhile is an error unless the fault kills
/// it.
fn wait(run: &mut Run, until: f64, may_end: bool) -> Result<()> {
    if !may_end {
        return run.play_until(until, |_, _| {});
    }
    while run.hardware.seconds() < until {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    Ok(())
}

/// The results as a Markdown table: fault, odometry, diagnostics, time until the pose was back.
pub fn markdown(outcomes: &[(&'static str, Outcome)]) -> String {
    let mut text = String::from(
        "| fault | odometry meanwhile | largest error meanwhile | diagnostics | back after | \
         verdict |\n| --- | --- | --- | --- | --- | --- |\n",
    );
    for (fault, o) in outcomes {
        let verdict = match &o.verdict {
            Verdict::Holds => "holds".to_owned(),
            Verdict::Fails(reasons) => format!("**fails**: {}", reasons.join("; ")),
            Verdict::Skipped(reason) => format!("**skipped**: {reason}"),
        };
        let back = o.back_after.map_or("not".to_owned(), |s| format!("{s:.2} s"));
        let error = if o.rate > 0.0 {
            format!("{:.1} mm, {:.2}°", o.worst_position, o.worst_rotation)
        } else {
            "–".to_owned()
        };
        let _ = writeln!(
            text,
            "| {fault} | {:.0} % of the samples, longest gap {:.0} ms | {error} | {} | {back} | \
             {verdict} |",
            o.rate * 100.0,
            o.longest_gap * 1e3,
            o.report.as_deref().unwrap_or("–"),
        );
    }
    text
}
