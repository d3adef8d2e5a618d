//! `volant hosts`: the live rig on two computers with a bad link. Exit status 0 when each row holds; 1 when one fails or is skipped.

use anyhow::{Context, Result};
use clap::Args;
use node_kit::environment::Network;
use std::path::PathBuf;
use volant_test::hosts::{
    Hosts,
    trial::{COMPARED, LENGTH, Place, Seen, Swing, markdown, trials},
};

/// Runs the climber's and the platform's nodes in two network namespaces (as root), with loss, delay, reordering, a cut and
/// restarts between them, and asserts on what the nodes publish.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Only rows whose name contains this text; the clean link is run in any case, to compare with
    #[arg(long)]
    only: Option<String>,
    /// Folder for the nodes' logs
    #[arg(long, default_value = "target/hosts")]
    out: PathBuf,
    /// Also write the table, as Markdown, to this file
    #[arg(long)]
    table: Option<PathBuf>,
    /// Everything random follows from it
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "# Two computers\n\n\
    Written by `volant hosts --table test/HOSTS.md` (as root): `marker_tracker`, `climber_driver`, camera and encoders in one network \
    namespace, `imu_driver`, `pose_fusion` and who listens in another, joined by a cable in user space that loses, delays and \
    reorders Ethernet frames from a seed, each way. 13 s of swing; RMSE without the first second; a cut lasts from 3 s to 8 s, a side \
    is killed (`kill -9`) at 3 s and started at 4 s; back counts from the end of the cut or the start of the processes and means nearer \
    than 10 mm and 1° to the truth, to stay. The clean link and the one that is compared with it are tried with five rigs each (other motion, clocks, \
    constant errors), taken together; the other rows with the first of them; with centroids as exact as \
    these no causal filter stays below 1.32 times the clean link's error (`cargo test --release -p pose_fusion --test bounds \
    two_hosts -- --nocapture`). Every row fails too where a message holds a number that is \
    none, a node panics, or the truth contradicts the covariance in more than 2 % of the odometry.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    let hosts = Hosts::new(arguments.seed)?;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(4));
    eprintln!("drawing what {COMPARED} cameras see in {LENGTH} s");
    let swings = (0..COMPARED as u64)
        .map(|i| Swing::new(arguments.seed.wrapping_add(i), threads))
        .collect::<Result<Vec<_>>>()?;
    let network = Network::from_environment()?;
    let wanted = |name: &str| arguments.only.as_ref().is_none_or(|text| name.contains(text.as_str()));
    let mut rows: Vec<(&'static str, Result<Seen, String>)> = Vec::new();
    let mut clean = None;
    for (i, trial) in trials().into_iter().enumerate().filter(|(i, t)| *i == 0 || wanted(t.name)) {
        let folder = arguments.out.join(format!("{:02}", i + 1));
        if folder.is_dir() {
            std::fs::remove_dir_all(&folder).with_context(|| format!("{}", folder.display()))?;
        }
        let place = Place { hosts: &hosts, network: &network, folder };
        let seen = trial.run(&swings, &place, clean).map_err(|error| error.to_string());
        clean = clean.or(seen.as_ref().ok().map(|s| s.position));
        let verdict = match &seen {
            Err(reason) => format!("SKIPPED: {reason}"),
            Ok(s) if s.failures.is_empty() => format!("holds ({:.2} mm)", s.position),
            Ok(s) => format!("FAILS ({:.2} mm): {}", s.position, s.failures.join("; ")),
        };
        eprintln!("{}: {verdict}", trial.name);
        rows.push((trial.name, seen));
    }
    let text = markdown(&rows);
    println!("{text}");
    if let Some(path) = &arguments.table {
        std::fs::write(path, format!("{HEAD}{text}")).with_context(|| format!("{}", path.display()))?;
    }
    let held = rows.iter().filter(|(_, s)| s.as_ref().is_ok_and(|s| s.failures.is_empty())).count();
    println!("{held} of {} rows hold", rows.len());
    Ok(held == rows.len())
}
