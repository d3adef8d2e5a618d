//! `volant check`.

use crate::{
    settings::{self, BagTopics},
    terminal,
};
use anyhow::Context;
use node_kit::{files, outln};
use pose_fusion::FusionConfig;
use rig_calibration::{Report, Verdict};
use serde_json::json;
use std::path::{Path, PathBuf};
use volant::calibration::check_bag;

/// Bag and files to compare.
#[derive(clap::Args)]
pub struct Arguments {
    /// Bag with images (or climber/markers), camera_info, climber/transform (or
    /// climber/joint_states) and volant/imu/data
    bag: PathBuf,
    /// Rig file
    #[arg(long, value_name = "FILE")]
    rig: PathBuf,
    /// ROS 2 parameter file of the nodes, in addition to the rig file; repeatable
    #[arg(long, value_name = "FILE")]
    params_file: Vec<PathBuf>,
    #[command(flatten)]
    topics: BagTopics,
    /// Write the result as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Replace an existing JSON file
    #[arg(long)]
    overwrite: bool,
}

/// Returns whether nothing is wrong.
pub fn run(arguments: &Arguments) -> anyhow::Result<bool> {
    let more = &arguments.params_file;
    let inputs = [&arguments.bag, &arguments.rig].into_iter().chain(more).map(PathBuf::as_path);
    let outputs: Vec<&Path> = arguments.json.as_deref().into_iter().collect();
    files::check_outputs(&outputs, arguments.overwrite, &inputs.collect::<Vec<_>>())?;
    let cores = settings::read(&arguments.rig, more, &arguments.topics)?;
    let mut losses = vec![];
    let report = check_bag(&arguments.bag, &cores, &mut losses);
    let report = terminal::with_losses(report.context("check"), &losses)?;
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&as_json(&report))? + "\n";
        files::write(path, text.as_bytes(), arguments.overwrite)?;
        terminal::line(&format!("wrote {}", path.display()));
    }
    print(&report)?;
    let assumed = cores.fusion.tight.calibration.marker;
    if assumed == FusionConfig::default().tight.calibration.marker {
        outln!(
            "The covariance of pose_fusion assumes markers within {} mm of their places \
             (calibration.marker_sigma, its default): give how well they were measured.",
            1e3 * assumed
        )?;
    }
    Ok(!report.is_wrong())
}

/// A number, or nothing.
fn number(value: f64) -> String {
    if value.is_finite() { format!("{value:.3}") } else { "-".to_owned() }
}

fn print(report: &Report) -> anyhow::Result<()> {
    if !report.rows.is_empty() {
        outln!(
            "{} images with all four markers ({} rejected); pixel residual {:.3} px RMS",
            report.images.0,
            report.images.1,
            report.pixel_rms
        )?;
        outln!("{:<32}{:>12}{:>12}{:>11}      verdict", "", "files", "estimate", "std dev")?;
    }
    for row in &report.rows {
        let shown = row.verdict != Verdict::Unobservable;
        outln!(
            "{:<32}{:>12}{:>12}{:>11} {:<4} {}",
            row.name,
            number(row.file),
            number(if shown { row.estimate } else { f64::NAN }),
            number(if shown { row.deviation } else { f64::NAN }),
            row.unit,
            row.verdict
        )?;
    }
    let unobservable = report.rows.iter().filter(|r| r.verdict == Verdict::Unobservable);
    let names: Vec<&str> = unobservable.map(|r| r.name.as_str()).collect();
    if !names.is_empty() {
        outln!("unobservable in this recording, survey it: {}", names.join(", "))?;
    }
    for finding in &report.findings {
        outln!("{}: {}. Remedy: {}.", finding.verdict, finding.text, finding.remedy)?;
    }
    if report.findings.is_empty() {
        outln!("nothing is wrong")?;
    }
    Ok(())
}

fn as_json(report: &Report) -> serde_json::Value {
    let finite = |v: f64| v.is_finite().then_some(v);
    json!({
        "wrong": report.is_wrong(),
        "rows": report.rows.iter().map(|r| json!({
            "name": r.name,
            "unit": r.unit,
            "file": finite(r.file),
            "estimate": finite(r.estimate),
            "standard_deviation": finite(r.deviation),
            "verdict": r.verdict.to_string(),
        })).collect::<Vec<_>>(),
        "findings": report.findings.iter().map(|f| json!({
            "key": f.key,
            "verdict": f.verdict.to_string(),
            "text": f.text,
            "remedy": f.remedy,
        })).collect::<Vec<_>>(),
        "images": report.images.0,
        "rejected_images": report.images.1,
        "pixel_rms": finite(report.pixel_rms),
        "reduced": finite(report.reduced),
    })
}
