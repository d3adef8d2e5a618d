//! Short recordings of live topics.

use crate::terminal;
use bag::WriteOptions;
use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};
use volant::live::record::{self, RecordOptions};

/// A recording that is deleted on drop.
pub struct Recorded {
    path: PathBuf,
    /// Topics that had no publisher.
    pub unpublished: Vec<String>,
}

impl Recorded {
    /// The bag.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Recorded {
    fn drop(&mut self) {
        // Nobody can be informed where that fails.
        let _ = fs::remove_file(&self.path);
    }
}

/// Records topics for some seconds, or until SIGINT or SIGTERM.
pub fn record(topics: Vec<String>, seconds: f64) -> anyhow::Result<Recorded> {
    let path = std::env::temp_dir().join(format!("volant-calibrate-{}.mcap", std::process::id()));
    let mut recorded = Recorded { path: path.clone(), unpublished: vec![] };
    terminal::line(&format!("listening to {} for {seconds} s", topics.join(", ")));
    let options = RecordOptions {
        output: path,
        topics,
        exclude: vec![],
        write: WriteOptions::default(),
        duration: Some(Duration::try_from_secs_f64(seconds)?),
    };
    let stop = node_kit::console::stop_flag()?;
    let report = record::record(&options, &stop, |_| {})?;
    report.status.failures.iter().for_each(terminal::warn);
    recorded.unpublished = report.status.unpublished;
    Ok(recorded)
}
