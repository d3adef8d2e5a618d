//! `volant evaluate`.

use crate::say;
use anyhow::Context;
use launch_config::{
    evaluate::{EvaluateOptions, csv, evaluate, table},
    replay::TopicNames,
};
use std::{fs, path::PathBuf};

#[derive(clap::Args)]
pub struct Arguments {
    /// The bag with the estimates
    estimates: PathBuf,
    /// The bag with ground_truth/odometry
    #[arg(long, value_name = "TRUTH")]
    truth: PathBuf,
    /// Writes the figures as CSV, one row for each estimate
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Writes the figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// How much of the beginning is left out, s
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0)]
    skip: f64,
    /// The namespace of the rig's topics
    #[arg(long, default_value = "")]
    namespace: String,
    /// Another name of a topic, as from:=to; may be given several times
    #[arg(long, value_name = "FROM:=TO")]
    remap: Vec<String>,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let options = EvaluateOptions {
        estimates: arguments.estimates.clone(),
        truth: arguments.truth.clone(),
        skip: arguments.skip,
        names: TopicNames::new(&arguments.namespace, &arguments.remap)?,
    };
    let evaluation = evaluate(&options).context("evaluate")?;
    for loss in &evaluation.losses {
        say::line(&format!("volant: {loss}"));
    }
    print!("{}", table(&evaluation));
    let write = |path: &PathBuf, text: String| {
        fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
    };
    if let Some(path) = &arguments.csv {
        write(path, csv(&evaluation))?;
    }
    if let Some(path) = &arguments.json {
        write(path, serde_json::to_string_pretty(&evaluation)? + "\n")?;
    }
    Ok(())
}
