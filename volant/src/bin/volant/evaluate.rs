//! `volant evaluate`.

use crate::{settings::BagTopics, terminal};
use anyhow::Context;
use node_kit::{files, out};
use std::path::{Path, PathBuf};
use volant::{
    command_line::number,
    evaluate::{EvaluateOptions, csv, evaluate, page, table},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Bag with the estimates
    estimates: PathBuf,
    /// Bag with ground_truth/odometry
    #[arg(long, value_name = "TRUTH")]
    truth: PathBuf,
    /// Write the results as CSV, one row per estimate
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the results as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Write an HTML report with tables and curves
    #[arg(long, value_name = "OUT.html")]
    report: Option<PathBuf>,
    /// Replace existing files
    #[arg(long)]
    overwrite: bool,
    /// Time to skip at the start, s
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = number(0.0..=1e9))]
    skip: f64,
    #[command(flatten)]
    topics: BagTopics,
}

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let outputs = [&arguments.csv, &arguments.json, &arguments.report].into_iter().flatten();
    let outputs: Vec<&Path> = outputs.map(PathBuf::as_path).collect();
    let inputs: [&Path; 2] = [&arguments.estimates, &arguments.truth];
    files::check_outputs(&outputs, arguments.overwrite, &inputs)?;
    let write = |path: &Path, text: &str| files::write(path, text.as_bytes(), arguments.overwrite);
    let options = EvaluateOptions {
        estimates: arguments.estimates.clone(),
        truth: arguments.truth.clone(),
        skip: arguments.skip,
        names: arguments.topics.names(),
    };
    let evaluation = evaluate(&options).context("evaluate")?;
    evaluation.losses.iter().for_each(terminal::warn);
    if let Some(path) = &arguments.csv {
        write(path, &csv(&evaluation))?;
    }
    if let Some(path) = &arguments.json {
        write(path, &(serde_json::to_string_pretty(&evaluation)? + "\n"))?;
    }
    if let Some(path) = &arguments.report {
        write(path, &page(&evaluation, &options)?.render())?;
    }
    out!("{}", table(&evaluation))?;
    Ok(())
}
