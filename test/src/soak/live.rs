//! The long run in real time: four processes, looped images, rows of the fault table at random.

use super::Instances;
use crate::{
    faults::{Notes, Row, outcome, table},
    live::{ImageSequence, Received, Run, Scenario, Site, TopicLog},
};
use anyhow::Result;
use node_kit::environment::Network;
use rig_model::Stamp;
use rig_simulator::random::Random;
use std::{path::Path, sync::Arc};

#[derive(Clone, Copy, Debug)]
pub struct SoakConfig {
    /// Rig time, s.
    pub seconds: f64,
    /// The faults follow from it.
    pub seed: u64,
    /// Nodes are killed only before this time, so that the others' memory can be watched for long,
    /// s.
    pub kills_until: f64,
}

#[derive(Debug, Default)]
pub struct Seen {
    /// Faults so far, and what they were.
    pub faults: Vec<(f64, &'static str)>,
    pub odometry: u64,
    /// Odometry whose covariance the truth contradicts.
    pub contradicted: u64,
    pub contradictions: Vec<Contradiction>,
    /// Faults after which the pose was not back in time: when, which, after how long.
    pub late: Vec<(f64, &'static str, f64)>,
    pub failures: Vec<String>,
    /// Memory and threads.
    pub instances: Instances,
}

/// Odometry around a fault whose covariance the truth contradicts.
#[derive(Clone, Debug)]
pub struct Contradiction {
    pub fault: &'static str,
    pub poses: usize,
    /// First and last time, s of the run.
    pub seconds: [f64; 2],
    /// Largest NEES of position and rotation.
    pub largest: [f64; 2],
}

/// Largest growth of the memory after the first minute, bytes. A reliable publisher keeps up to
/// 8192 samples for a killed reader until its lease ends, so the growth since the last kill is
/// evaluated separately.
pub const GROWTH: i64 = 5 << 20;

/// Bounds of a fault's duration, and of the time from its end to the next one, s.
const LASTS: [f64; 2] = [0.5, 4.0];
const CALM: [f64; 2] = [4.0, 9.0];
/// Seconds after a fault during which the pose may still be off before it must be back.
const BACK_WITHIN: f64 = 3.0;

pub fn run(
    scenario: &Scenario,
    images: Arc<ImageSequence>,
    config: &SoakConfig,
    network: &Network,
    folder: &Path,
    mut progress: impl FnMut(f64, &Seen),
) -> Result<Seen> {
    let site = Site { endless: true, ..Site::here(network) };
    let mut run = Run::start(scenario, images, &site, folder)?;
    run.wait_for_pose(30.0)?;
    let epoch = run.begin();
    run.play_until(0.5, |_, _| {})?;
    drop(run.hardware.take_received());
    let rows: Vec<Row> = table().into_iter().filter(|row| row.soaks()).collect();
    let mut seen = Seen::default();
    let mut random = Random::fork(config.seed, "long run");
    while run.hardware.seconds() < config.seconds {
        let row = &rows[random.index(rows.len())];
        let [calm, lasts] = [CALM, LASTS].map(|[least, most]| random.within(least, most));
        let now = run.hardware.seconds();
        if row.kills.is_some() && now > config.kills_until {
            continue;
        }
        let mut notes = Notes::default();
        seen.faults.push((now, row.fault));
        if row.kills.is_some() {
            seen.instances.killed(now);
        }
        (row.begin)(&mut run, &mut notes)?;
        watch(&mut run, now + lasts, &mut seen, &mut progress);
        (row.end)(&mut run, &mut notes)?;
        let over = run.hardware.seconds();
        watch(&mut run, over + calm, &mut seen, &mut progress);
        seen.failures.extend(notes.failures);
        let received = run.hardware.take_received();
        judge(&received, scenario, epoch, over, row, &mut seen);
        run.nodes.check()?;
    }
    // Panics, and how they end, are seen at the end.
    let folder = folder.to_owned();
    let ended = run.finish()?;
    seen.failures.extend(outcome::ends(&ended, &folder));
    conclude(&mut seen);
    Ok(seen)
}

fn watch(run: &mut Run, until: f64, seen: &mut Seen, progress: &mut impl FnMut(f64, &Seen)) {
    loop {
        let now = run.hardware.seconds();
        seen.instances.sample(&run.nodes, now);
        progress(now, seen);
        if now >= until {
            return;
        }
        std::thread::sleep(std::time::Duration::from_secs_f64((until - now).clamp(0.001, 1.0)));
    }
}

fn judge(
    received: &Received,
    scenario: &Scenario,
    epoch: Stamp,
    over: f64,
    row: &Row,
    seen: &mut Seen,
) {
    let lap = scenario.duration();
    let truth = |s: Stamp| {
        scenario.motion.world_from_volant(s.seconds_since(epoch).max(0.0).rem_euclid(lap))
    };
    let fused = received.fused();
    let end = fused.last().map_or(epoch, |(stamp, _)| *stamp);
    let nees = received.nees(Stamp::default(), end, truth);
    seen.odometry += nees.len() as u64;
    let beyond = outcome::beyond(&nees);
    if let (Some((first, _)), Some((last, _))) = (beyond.first(), beyond.last()) {
        let since = |at: &Stamp| at.seconds_since(epoch);
        let largest = |i: usize| beyond.iter().map(|(_, n)| n[i]).fold(0.0, f64::max);
        seen.contradicted += beyond.len() as u64;
        seen.contradictions.push(Contradiction {
            fault: row.fault,
            poses: beyond.len(),
            seconds: [since(first), since(last)],
            largest: [largest(0), largest(1)],
        });
    }
    seen.failures.extend(
        outcome::not_a_number(received).map(|why| format!("{over:.0} s, {}: {why}", row.fault)),
    );
    let settled = epoch.plus_seconds(over + BACK_WITHIN);
    seen.failures.extend(
        silent(received, settled)
            .map(|node| format!("{over:.0} s, {}: {node} fell silent", row.fault)),
    );
    let back = outcome::back(&fused, epoch.plus_seconds(over), end, truth);
    let after = back.map_or(f64::INFINITY, |s| s.seconds_since(epoch.plus_seconds(over)));
    if after > BACK_WITHIN {
        seen.late.push((over, row.fault, after));
    }
}

/// Nodes that published nothing from `since` on.
fn silent(received: &Received, since: Stamp) -> impl Iterator<Item = &'static str> {
    fn last<M>(log: &TopicLog<M>) -> Option<Stamp> {
        log.last().map(|(at, _)| *at)
    }
    let nodes = [
        ("climber_driver", last(&received.climber)),
        ("imu_driver", last(&received.imu)),
        ("marker_tracker", last(&received.markers)),
        ("pose_fusion", last(&received.odometry)),
    ];
    nodes.into_iter().filter(move |(_, at)| at.is_none_or(|at| at < since)).map(|(node, _)| node)
}

fn conclude(seen: &mut Seen) {
    let share = seen.contradicted as f64 / (seen.odometry.max(1)) as f64;
    if seen.odometry == 0 {
        seen.failures.push("no odometry was received".to_owned());
    }
    if share > outcome::NEES_SHARE {
        seen.failures.push(format!(
            "the truth contradicts the covariance in {:.1} % of the odometry",
            share * 100.0
        ));
    }
    for (worst, when) in [
        (seen.instances.worst_undisturbed(), "while no node was killed"),
        (seen.instances.worst(), "after its first minute"),
    ] {
        if let Some((instance, growth)) = worst
            && growth >= GROWTH
        {
            let (node, id, growth) = (&instance.node, instance.id, growth as f64 / 1e6);
            seen.failures.push(format!("{node} ({id}) grew by {growth:.1} MB {when}"));
        }
    }
    for instance in seen.instances.iter() {
        if instance.growth().is_some()
            && let [first, last] = instance.threads
            && last > first
        {
            let (node, id) = (&instance.node, instance.id);
            seen.failures.push(format!(
                "{node} ({id}) had {first} threads in its first minute and {last} in its last"
            ));
        }
    }
    for (when, fault, after) in &seen.late {
        seen.failures.push(format!("at {when:.0} s, {fault}: back after {after:.1} s"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_without_a_newer_message_is_silent() {
        let at = Stamp::from_nanos;
        let mut received = Received::default();
        assert_eq!(silent(&received, at(1)).count(), 4);
        received.imu.push((at(2), Default::default()));
        received.climber.push((at(3), Default::default()));
        received.odometry.extend([(at(1), Default::default()), (at(2), Default::default())]);
        assert_eq!(silent(&received, at(2)).collect::<Vec<_>>(), ["marker_tracker"]);
        assert_eq!(silent(&received, at(3)).count(), 3);
    }
}
