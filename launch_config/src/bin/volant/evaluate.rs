//! `volant evaluate`.

use crate::say;
use anyhow::Context;
use indicatif::{ProgressBar, ProgressStyle};
use launch_config::{
    evaluate::{
        EvaluateOptions, csv, csv_of_many, evaluate, evaluate_many, page, page_of_many, pairs, table,
        table_of_many,
    },
    replay::TopicNames,
};
use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// The bag with the estimates, or a folder of such bags
    estimates: PathBuf,
    /// The bag with ground_truth/odometry; for a folder of runs, a folder with NAME.mcap or NAME/truth.mcap of each
    #[arg(long, value_name = "TRUTH")]
    truth: PathBuf,
    /// Writes the figures as CSV, one row for each estimate
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Writes the figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Writes a page with tables and curves
    #[arg(long, value_name = "OUT.html")]
    report: Option<PathBuf>,
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
    if arguments.estimates.is_dir() && !arguments.estimates.join("metadata.yaml").is_file() {
        return run_many(arguments);
    }
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
    if let Some(path) = &arguments.csv {
        write(path, csv(&evaluation))?;
    }
    if let Some(path) = &arguments.json {
        write(path, serde_json::to_string_pretty(&evaluation)? + "\n")?;
    }
    if let Some(path) = &arguments.report {
        write(path, page(&evaluation, &options)?.render())?;
    }
    Ok(())
}

fn write(path: &Path, text: String) -> anyhow::Result<()> {
    fs::write(path, text).with_context(|| format!("{}: cannot be written", path.display()))
}

/// A folder of runs, in parallel.
fn run_many(arguments: &Arguments) -> anyhow::Result<()> {
    let names = TopicNames::new(&arguments.namespace, &arguments.remap)?;
    let runs = pairs(&arguments.estimates, &arguments.truth).context("evaluate")?;
    let bar = ProgressBar::new(runs.len() as u64);
    let style = ProgressStyle::with_template("runs [{bar:34}] {pos}/{len} {eta}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let results = evaluate_many(&runs, arguments.skip, &names, threads, |done| bar.set_position(done as u64));
    bar.finish_and_clear();
    print!("{}", table_of_many(&results));
    if let Some(path) = &arguments.csv {
        write(path, csv_of_many(&results))?;
    }
    if let Some(path) = &arguments.json {
        let runs: BTreeMap<_, _> = results.iter().filter_map(|(n, r)| Some((n, r.as_ref().ok()?))).collect();
        write(path, serde_json::to_string_pretty(&runs)? + "\n")?;
    }
    if let Some(path) = &arguments.report {
        let command = format!(
            "volant evaluate {} --truth {}",
            arguments.estimates.display(),
            arguments.truth.display()
        );
        write(path, page_of_many(&results, &command)?.render())?;
    }
    let failed: Vec<String> =
        results.iter().filter_map(|(name, r)| r.as_ref().err().map(|e| format!("{name}: {e}"))).collect();
    anyhow::ensure!(
        failed.is_empty(),
        "evaluate: {} of {} runs failed: {}",
        failed.len(),
        results.len(),
        failed.join("; ")
    );
    Ok(())
}
