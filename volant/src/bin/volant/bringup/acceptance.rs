//! The acceptance run: a replay with the finished rig file, and `volant check`.

use super::{Walk, inputs, motion::MOTION};
use crate::settings;
use anyhow::Result;
use bag::{BagReader, Compression};
use node_kit::outln;
use rig_model::{median, topics};
use std::process::Command;
use volant::replay::{ReplayOptions, decoding_threads, replay};
use volant_msgs::{
    cdr,
    msg::{MarkerUpdate, MarkerUpdates, PoseStatus},
};

/// Beginning of a run that is not judged, s.
const SETTLING: f64 = 2.0;

/// Judges a run.
pub fn acceptance(walk: &mut Walk) -> Result<()> {
    outln!("  Record half a minute of ordinary work, other than the recordings before.")?;
    let bag = walk.recording("acceptance", &MOTION, 30.0)?;
    let topics = walk.topics(&bag, inputs::MOTION)?;
    let output = walk.file("acceptance_replay.mcap");
    let options = ReplayOptions {
        input: bag.clone(),
        output: output.clone(),
        overwrite: true,
        cores: settings::read(&walk.rig, &[], &topics)?,
        compression: Compression::default(),
        workers: decoding_threads(),
        smooth: false,
    };
    let report = replay(&options, |_| {})?;
    walk.wrote(&output);
    let counts = &report.counts;
    let share = 100.0 * counts.detected as f64 / (4 * counts.markers).max(1) as f64;
    walk.check(share > 90.0, "markers", format!("{share:.1} % detected (90 at least)"))?;
    judge(walk, &output)?;
    for warning in counts.warning_lines() {
        walk.note("replay", warning)?;
    }
    // 0: nothing is wrong, 1: something is.
    let mut check = Command::new(std::env::current_exe()?);
    check.arg("check").arg(&bag).arg("--rig").arg(&walk.rig);
    for remap in &topics.remap {
        check.args(["--remap", &remap.to_string()]);
    }
    let status = check.status()?;
    match status.code() {
        Some(0) => walk.check(true, "volant check", "nothing is wrong"),
        Some(1) => walk.check(false, "volant check", "something is wrong, see its table"),
        _ => walk.note("volant check", "not run"),
    }
}

/// Judges the outputs of the replay.
fn judge(walk: &mut Walk, output: &std::path::Path) -> Result<()> {
    let mut bag = BagReader::open(output)?;
    let (mut first, mut valid, mut count) = (None, 0u32, 0u32);
    let (mut sigmas, mut reason) = (vec![], String::new());
    let (mut nis, mut used, mut measured) = (0.0, 0u32, 0u32);
    while let Some(message) = bag.next_message()? {
        let begun = *first.get_or_insert(message.log_time);
        if (message.log_time.saturating_sub(begun)) as f64 * 1e-9 < SETTLING {
            continue;
        }
        if message.topic.name == topics::absolute::STATUS {
            let status: PoseStatus = cdr::from_bytes(&message.data)?;
            count += 1;
            valid += u32::from(status.valid);
            sigmas.push(status.position_sigma);
            if !status.reason.is_empty() {
                reason = status.reason;
            }
        } else if message.topic.name == topics::absolute::MARKER_UPDATES {
            let updates: MarkerUpdates = cdr::from_bytes(&message.data)?;
            for update in updates.markers {
                measured += u32::from(update.outcome != MarkerUpdate::NOT_DETECTED);
                if update.outcome == MarkerUpdate::USED {
                    used += 1;
                    nis += update.nis;
                }
            }
        }
    }
    let percent = |part: u32, of: u32| 100.0 * f64::from(part) / f64::from(of.max(1));
    let share = percent(valid, count);
    let why = if reason.is_empty() { reason } else { format!("; last reason: {reason}") };
    walk.check(
        share > 98.0,
        "status",
        format!("valid {share:.1} % of the time (98 at least){why}"),
    )?;
    if let Some(median) = median(sigmas) {
        let text = format!(
            "standard deviation {:.2} mm (20 at most; `calibration.*_sigma` of pose_fusion widen it \
             by what is not calibrated)",
            1e3 * median
        );
        walk.check(median < 0.02, "position", text)?;
    }
    let share = percent(used, measured);
    walk.check(share > 95.0, "gating", format!("{share:.1} % of the markers used (95 at least)"))?;
    let nis = nis / f64::from(used.max(1));
    walk.check(
        nis < 4.0,
        "NIS",
        format!("mean {nis:.2} (2 is ideal, 4 the limit: more means a wrong rig file)"),
    )
}
