//! What a bring-up has done, in a file beside the rig file.

use anyhow::{Context, Result};
use node_kit::files;
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

/// Verdict on one item.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    Pass,
    Fail,
    Note,
}

impl Verdict {
    /// PASS, FAIL or nothing.
    pub fn word(self) -> &'static str {
        match self {
            Self::Pass => "PASS",
            Self::Fail => "FAIL",
            Self::Note => "",
        }
    }
}

/// A checked item.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Item {
    pub name: String,
    pub verdict: Verdict,
    pub text: String,
}

/// Outcome of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    Done,
    Failed,
    Skipped,
    /// Done before an earlier step changed the rig file.
    Outdated,
}

impl Outcome {
    /// PASS, FAIL, skipped or out of date.
    pub fn word(self) -> &'static str {
        match self {
            Self::Done => "PASS",
            Self::Failed => "FAIL",
            Self::Skipped => "skipped",
            Self::Outdated => "out of date",
        }
    }
}

/// A step that was run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    pub outcome: Outcome,
    pub items: Vec<Item>,
    /// Files that were written, and the parameters that changed.
    pub wrote: Vec<String>,
}

/// All steps that were run, and the recordings that they used, by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct State {
    pub steps: BTreeMap<String, Record>,
    pub recordings: BTreeMap<String, PathBuf>,
    /// Topics that the operator chose as the rig's, with the step that asked.
    #[serde(default)]
    pub topics: BTreeMap<String, String>,
    /// Clocks of the camera against the IMU's and of the climber against the camera's, and their
    /// standard deviations, ms.
    pub clocks: Option<[(f64, f64); 2]>,
    /// The page that was written.
    #[serde(default)]
    pub report: Option<PathBuf>,
}

impl State {
    /// Reads the state; none yet is an empty one.
    pub fn read(path: &Path) -> Result<Self> {
        if !path.exists() {
            return Ok(Self::default());
        }
        let text = files::read_text(path).with_context(|| path.display().to_string())?;
        serde_json::from_str(&text).with_context(|| {
            format!("{}: not the state of a bring-up; move it away to begin again", path.display())
        })
    }

    /// Outcome of a step; `None` where it was not run.
    pub fn outcome(&self, step: &str) -> Option<Outcome> {
        self.steps.get(step).map(|record| record.outcome)
    }

    /// Marks those of the steps that are done as out of date; returns their names.
    pub fn outdate(&mut self, steps: impl IntoIterator<Item = String>) -> Vec<String> {
        let mut outdated = vec![];
        for step in steps {
            if let Some(record) = self.steps.get_mut(&step).filter(|r| r.outcome == Outcome::Done) {
                record.outcome = Outcome::Outdated;
                outdated.push(step);
            }
        }
        outdated
    }

    /// Writes the state.
    pub fn write(&self, path: &Path) -> Result<()> {
        Ok(files::write(path, serde_json::to_string_pretty(self)?.as_bytes(), true)?)
    }
}
