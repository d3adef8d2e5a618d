//! Short recordings of live topics.

use crate::terminal;
use bag::WriteOptions;
use std::{
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
    time::Duration,
};
use volant::live::record::{self, RecordOptions};

/// A recording that is deleted on drop.
pub struct Recorded {
    path: PathBuf,
    /// Topics that had no publisher.
    pub unpublished: Vec<String>,
    /// Number of messages.
    pub messages: u64,
}

impl Recorded {
    /// The bag.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Recorded {
    fn drop(&mut self) {
        discard();
    }
}

/// Removes the recording of this process, which a signal ends.
pub fn discard() {
    // Nobody can be informed where that fails.
    let _ = fs::remove_file(path());
}

fn path() -> PathBuf {
    std::env::temp_dir().join(format!("volant-calibrate-{}.mcap", std::process::id()))
}

/// Records topics for some seconds, or until `stop` is set.
pub fn record(topics: Vec<String>, seconds: f64, stop: &AtomicBool) -> anyhow::Result<Recorded> {
    let path = path();
    let mut recorded = Recorded { path: path.clone(), unpublished: vec![], messages: 0 };
    terminal::line(&format!("listening to {} for {seconds} s", topics.join(", ")));
    let options = RecordOptions {
        output: path,
        topics,
        exclude: vec![],
        write: WriteOptions { in_place: true, ..WriteOptions::default() },
        duration: Some(Duration::try_from_secs_f64(seconds)?),
    };
    let report = record::record(&options, stop, |_| {})?;
    report.status.failures.iter().for_each(terminal::warn);
    recorded.unpublished = report.status.unpublished;
    recorded.messages = report.status.messages;
    Ok(recorded)
}
