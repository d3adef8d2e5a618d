//! `volant evaluate`.

use crate::{settings::BagTopics, terminal};
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use node_kit::{files, out};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use volant::{
    command_line::number,
    evaluate::{
        EvaluateOptions, csv, csv_of_many, evaluate, evaluate_many, page, page_of_many, pairs,
        table, table_of_many,
    },
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Bag with the estimates, or a folder of such bags
    estimates: PathBuf,
    /// Bag with ground_truth/odometry; for a folder of runs, a folder with NAME.mcap or
    /// NAME/truth.mcap of each
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
    if arguments.estimates.is_dir() && !arguments.estimates.join("metadata.yaml").is_file() {
        return run_many(arguments);
    }
    arguments.check_outputs(&[&arguments.estimates, &arguments.truth])?;
    let options = EvaluateOptions {
        estimates: arguments.estimates.clone(),
        truth: arguments.truth.clone(),
        skip: arguments.skip,
        names: arguments.topics.names(),
    };
    let evaluation = evaluate(&options).context("evaluate")?;
    for loss in &evaluation.losses {
        terminal::line(&format!("volant: {loss}"));
    }
    if let Some(path) = &arguments.csv {
        arguments.write(path, &csv(&evaluation))?;
    }
    if let Some(path) = &arguments.json {
        arguments.write(path, &(serde_json::to_string_pretty(&evaluation)? + "\n"))?;
    }
    if let Some(path) = &arguments.report {
        arguments.write(path, &page(&evaluation, &options)?.render())?;
    }
    out!("{}", table(&evaluation))?;
    Ok(())
}

impl Arguments {
    /// Finds before the work what would not be written after it.
    fn check_outputs(&self, inputs: &[&Path]) -> anyhow::Result<()> {
        let outputs = [&self.csv, &self.json, &self.report].into_iter().flatten();
        let outputs: Vec<&Path> = outputs.map(PathBuf::as_path).collect();
        Ok(files::check_outputs(&outputs, self.overwrite, inputs)?)
    }

    fn write(&self, path: &Path, text: &str) -> anyhow::Result<()> {
        Ok(files::write(path, text.as_bytes(), self.overwrite)?)
    }
}

/// Evaluates a folder of runs, in parallel.
fn run_many(arguments: &Arguments) -> anyhow::Result<()> {
    let names = arguments.topics.names();
    let runs = pairs(&arguments.estimates, &arguments.truth).context("evaluate")?;
    let inputs: Vec<&Path> =
        runs.iter().flat_map(|run| [run.estimates.as_path(), &run.truth]).collect();
    arguments.check_outputs(&inputs)?;
    let bar = ProgressBar::new(runs.len() as u64);
    let style = ProgressStyle::with_template("runs [{bar:34}] {pos}/{len} {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let results =
        evaluate_many(&runs, arguments.skip, &names, threads, |done| bar.set_position(done as u64));
    bar.finish_and_clear();
    if let Some(path) = &arguments.csv {
        arguments.write(path, &csv_of_many(&results))?;
    }
    if let Some(path) = &arguments.json {
        let runs: BTreeMap<_, _> =
            results.iter().filter_map(|(n, r)| Some((n, r.as_ref().ok()?))).collect();
        arguments.write(path, &(serde_json::to_string_pretty(&runs)? + "\n"))?;
    }
    if let Some(path) = &arguments.report {
        let command = format!(
            "volant evaluate {} --truth {}",
            arguments.estimates.display(),
            arguments.truth.display()
        );
        arguments.write(path, &page_of_many(&results, &command)?.render())?;
    }
    out!("{}", table_of_many(&results))?;
    let failed: Vec<String> = results
        .iter()
        .filter_map(|(name, r)| r.as_ref().err().map(|e| format!("{name}: {e}")))
        .collect();
    anyhow::ensure!(
        failed.is_empty(),
        "evaluate: {} of {} runs failed: {}",
        failed.len(),
        results.len(),
        failed.join("; ")
    );
    Ok(())
}
