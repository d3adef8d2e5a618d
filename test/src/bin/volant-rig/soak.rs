//! `volant soak`: the long run. Exit status 0 when all of it held.

use anyhow::Result;
use clap::Args;
use node_kit::environment::Network;
use node_kit::{errln, outln};
use std::{path::PathBuf, sync::Arc};
use volant::{command_line::number, report::Table};
use volant_test::{
    live::{ImageSequence, Scenario},
    run_folder::RunFolder,
    soak::live::{self, Seen, SoakConfig},
};

/// Run the live rig lap by lap with faults at random, and watch memory, threads, numbers and
/// covariances.
#[derive(Args)]
pub(crate) struct Arguments {
    /// For how long
    #[arg(long, default_value_t = 60.0, value_parser = number(0.1..=1e6))]
    minutes: f64,
    /// Nodes are killed in the first part of the run only, so that memory can be watched for long
    /// in the rest
    #[arg(long, default_value_t = 0.3, value_parser = number(0.0..=1.0))]
    kills: f64,
    /// Folder for the nodes' logs: an empty or new one, or that of an earlier run, which is
    /// replaced
    #[arg(long, default_value = "target/soak")]
    out: PathBuf,
    /// DDS domain to run on, so that a rig on the usual one is not disturbed
    #[arg(long, default_value_t = 93)]
    domain: u16,
    /// Random seed
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    let _folder = RunFolder::create(&arguments.out)?;
    let scenario = Scenario::lap(arguments.seed, 20.0)?;
    errln!("rendering the camera's images of {} s", scenario.duration());
    let images = Arc::new(ImageSequence::of(&scenario)?);
    let network = Network { domain_id: arguments.domain, ..Network::from_environment()? };
    let seconds = arguments.minutes * 60.0;
    let config =
        SoakConfig { seconds, seed: arguments.seed, kills_until: seconds * arguments.kills };
    let mut minute = 0.0;
    let seen = live::run(&scenario, images, &config, &network, &arguments.out, |now, seen| {
        if now >= minute {
            errln!("{:4.0} min: {}", now / 60.0, line(seen));
            minute += 60.0;
        }
    })?;
    outln!("{} faults; {}", seen.faults.len(), line(&seen))?;
    let change =
        |bytes: Option<i64>| bytes.map_or("–".to_owned(), |b| format!("{:+.2}", b as f64 / 1e6));
    let rows = seen.instances.iter().map(|instance| {
        [
            instance.node.clone(),
            instance.id.to_string(),
            format!("{:.1}", (instance.until - instance.since) / 60.0),
            instance.settled.map_or("–".to_owned(), |b| format!("{:.2}", b as f64 / 1e6)),
            format!("{:.2}", instance.last as f64 / 1e6),
            change(instance.growth()),
            change(instance.undisturbed_growth()),
            instance.threads[1].to_string(),
        ]
    });
    let head = "node | process | minutes | MB after the first minute | MB at the end | \
                growth, MB | since a minute after the last kill | threads";
    outln!("\n{}", Table::new(head, rows).to_markdown())?;
    let lap = scenario.duration();
    for c in &seen.contradictions {
        let [from, to] = c.seconds;
        outln!(
            "contradicted: {} poses between {from:.1} and {to:.1} s ({:.1} to {:.1} s of the \
             lap), NEES up to {:.0} and {:.0}: {}",
            c.poses,
            from % lap,
            to % lap,
            c.largest[0],
            c.largest[1],
            c.fault
        )?;
    }
    for failure in &seen.failures {
        outln!("FAILS: {failure}")?;
    }
    outln!("{}", if seen.failures.is_empty() { "all of it held" } else { "it did not hold" })?;
    Ok(seen.failures.is_empty())
}

fn line(seen: &Seen) -> String {
    let share = 100.0 * seen.contradicted as f64 / seen.odometry.max(1) as f64;
    let growth = seen.instances.worst().map_or("–".to_owned(), |(instance, bytes)| {
        format!("{:+.2} MB ({})", bytes as f64 / 1e6, instance.node)
    });
    format!(
        "{} odometry, {share:.2} % contradicted, {} late returns, largest growth {growth}",
        seen.odometry,
        seen.late.len()
    )
}
