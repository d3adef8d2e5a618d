//! Faults on real processes: each row of the table breaks one part of a live rig for some seconds
//! and asserts on what the nodes published meanwhile and afterwards.
//!
//! [`table`] has the rows, [`Row::run`] runs one, [`COLUMNS`] are the titles of their table.

mod injectors;
pub(crate) mod outcome;
mod recording;
mod table;

pub use outcome::Outcome;
pub use table::table;

use crate::{
    live::{ImageSequence, Run, Scenario, Site, bag},
    report::Measured,
};
use anyhow::{Result, anyhow};
use node_kit::environment::Network;
use std::{path::Path, sync::Arc};

/// Seconds of the scenario at which a fault begins and ends.
pub const WINDOW: [f64; 2] = [2.0, 5.0];
/// Length of the scenario, s.
pub const LENGTH: f64 = 9.0;

/// What a row finds beside the rig's own messages.
#[derive(Clone, Debug, Default)]
pub struct Notes {
    /// Report of the fault by a process without diagnostics.
    pub report: Option<String>,
    pub failures: Vec<String>,
}

/// What is done to a live rig; it may note what it finds.
type Action = Box<dyn Fn(&mut Run, &mut Notes) -> Result<()>>;

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
    pub(crate) begin: Action,
    pub(crate) end: Action,
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
    /// May it come again and again in a long run?
    pub fn soaks(&self) -> bool {
        !self.fault.starts_with("disk full") && self.clock_ahead == 0.0
    }

    /// Runs the row on the DDS domain of `network`, in `folder`, and writes its bag where one is
    /// configured. An error means that the row has neither passed nor failed.
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
        (self.begin)(&mut run, &mut notes)?;
        // A node that ends is an error unless the fault kills it.
        let wait = |run: &mut Run, until: f64| match self.kills {
            None => run.play_until(until, |_, _| {}),
            Some(_) => {
                run.wait_until(until);
                Ok(())
            }
        };
        wait(&mut run, WINDOW[1])?;
        (self.end)(&mut run, &mut notes)?;
        wait(&mut run, LENGTH - 0.2)?;
        let logs = folder.to_owned();
        let ended = run.finish()?;
        if let Some(bag) = bag {
            bag::write(bag, scenario, epoch, &ended.received)
                .map_err(|error| anyhow!("the run's bag: {error}"))?;
        }
        Ok(outcome::judge(self, scenario, epoch, &ended, &logs, notes))
    }
}

/// Column titles of the results.
pub const COLUMNS: &str = "fault | odometry meanwhile | largest error meanwhile | diagnostics | \
                           back after | verdict";

impl From<Outcome> for Measured {
    fn from(o: Outcome) -> Self {
        let error = format!("{:.1} mm, {:.2}°", o.worst_position, o.worst_rotation);
        let share = o.rate * 100.0;
        let cells = vec![
            format!("{share:.0} % of the samples, longest gap {:.0} ms", o.longest_gap * 1e3),
            if o.rate > 0.0 { error } else { "–".to_owned() },
            o.report.unwrap_or_else(|| "–".to_owned()),
            o.back_after.map_or("not".to_owned(), |s| format!("{s:.2} s")),
        ];
        Self { cells, remark: String::new(), failures: o.failures }
    }
}
