//! `volant hosts`: the live rig on two computers with a bad link. Exit status 0 when each row
//! holds; 1 when one fails or is skipped.

use anyhow::{Result, ensure};
use clap::Args;
use node_kit::{environment::Network, errln};
use std::path::PathBuf;
use volant_test::{
    hosts::{
        Hosts,
        trial::{COLUMNS, COMPARED, LENGTH, Place, Swing, trials},
    },
    report::{LiveTable, TableFile},
    run_folder::RunFolder,
};

/// Run the climber's and the platform's nodes in two network namespaces (as root), with loss,
/// delay, reordering, a cut and restarts between them, and assert on what the nodes publish.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Only rows whose name contains this text; the clean link is run in any case, to compare with
    #[arg(long)]
    only: Option<String>,
    /// Folder for the nodes' logs, one in it for each run: new, empty or of an earlier run, which
    /// is replaced
    #[arg(long, default_value = "target/hosts")]
    out: PathBuf,
    #[command(flatten)]
    table: TableFile,
    /// Random seed
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "\
    # Two computers\n\n\
    Written by `volant hosts --table test/HOSTS.md` (as root). `marker_tracker`,\n\
    `climber_driver`, camera and encoders are in one network namespace; `imu_driver`,\n\
    `pose_fusion` and the observer are in another. A link in user space joins them and\n\
    loses, delays and reorders Ethernet frames from a seed, each way. 13 s of swing; RMSE\n\
    without the first second.\n\n\
    A cut lasts from 3 s to 8 s; a side is killed (`kill -9`) at 3 s and started at 4 s.\n\
    \"Back\" counts from the end of the cut or the start of the processes until the error\n\
    stays below 10 mm and 1°. The clean link and the one compared with it are run with five\n\
    rigs each (other motion, clocks, constant errors), taken together; the other rows with\n\
    the first of them. With centroids as accurate as these no causal filter stays below 1.32\n\
    times the clean link's error (`cargo test --release -p pose_fusion --test bounds\n\
    two_hosts -- --nocapture`).\n\n\
    Every row fails too where a message contains a non-finite number, a node panics, or the\n\
    truth contradicts the covariance in more than 2 % of the odometry.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    arguments.table.check(&[])?;
    let only = arguments.only.as_deref().unwrap_or_default();
    let all = trials();
    ensure!(
        all.iter().any(|trial| trial.name.contains(only)),
        "--only {only}: no row has this in its name; see test/HOSTS.md"
    );
    let trials = all.into_iter().enumerate();
    let trials: Vec<_> = trials.filter(|(i, t)| *i == 0 || t.name.contains(only)).collect();
    let folders = trials
        .iter()
        .map(|(i, _)| RunFolder::create(&arguments.out.join(format!("{:02}", i + 1))))
        .collect::<Result<Vec<_>, _>>()?;
    let hosts = Hosts::new(arguments.seed)?;
    errln!("drawing what {COMPARED} cameras see in {LENGTH} s");
    let swings = (0..COMPARED as u64)
        .map(|i| Swing::new(arguments.seed.wrapping_add(i)))
        .collect::<Result<Vec<_>>>()?;
    let network = Network::from_environment()?;
    let (mut results, mut clean) = (LiveTable::new(COLUMNS), None);
    for ((_, trial), folder) in trials.into_iter().zip(&folders) {
        let place = Place { hosts: &hosts, network: &network, folder: folder.path().to_owned() };
        let seen = trial.run(&swings, &place, clean);
        clean = clean.or(seen.as_ref().ok().map(|s| s.position));
        errln!("{}: {}", trial.name, results.add(trial.name, seen));
    }
    results.finish(&arguments.table, HEAD)
}
