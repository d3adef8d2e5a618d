//! `volant rigs`: 1, 2, 4, 8 … rigs on this machine until it is full.

use anyhow::{Context, Result, bail};
use clap::Args;
use node_kit::environment::Network;
use std::{path::PathBuf, sync::Arc};
use volant_test::{
    crowd::{Crowd, CrowdConfig, markdown},
    hosts::Island,
    live::{Film, Scenario},
};

/// Runs more and more simulated rigs, each with its four nodes, until the machine is full, and tells what one costs.
#[derive(Args)]
pub(crate) struct Arguments {
    /// How many, one crowd after the other
    #[arg(long, value_delimiter = ',', default_values_t = [1, 2, 4, 8, 16, 32])]
    rigs: Vec<usize>,
    /// Measures for so many seconds
    #[arg(long, default_value_t = 10.0)]
    seconds: f64,
    /// Each rig in a DDS domain of its own, from this one on, instead of all in one domain
    #[arg(long)]
    domains: Option<u16>,
    /// Goes on though the machine is full
    #[arg(long)]
    beyond: bool,
    /// Folder for the nodes' logs
    #[arg(long, default_value = "target/rigs")]
    out: PathBuf,
    /// Also write the table, as Markdown, to this file
    #[arg(long)]
    table: Option<PathBuf>,
    /// Everything random follows from it
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "# Many rigs on one machine\n\n\
    Written by `volant rigs --table test/RIGS.md` (as root, so that only the rigs' bytes are counted): each rig has four processes, a \
    camera of 640 × 480 JPEG at 30 Hz, an inertial unit at 100 Hz and encoders at 50 Hz; the simulated hardware runs on the same machine. \
    Full is where less than 97 % of the odometry comes, or the p99 from an image to the odometry that contains it is beyond 33 ms.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let scenario = Scenario::lap(arguments.seed, 10.0)?;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(4));
    eprintln!("rendering the camera's film of {} s", scenario.duration());
    let film = Arc::new(Film::shoot(&scenario, threads, |_, _| {})?);
    // A network of its own, so that nothing else is counted; the threads and processes from here on are in it.
    let island = Island::enter();
    if let Err(reason) = &island {
        eprintln!("everything on this machine's network is counted: {reason}");
    }
    let config = CrowdConfig { settle: 4.0, measure: arguments.seconds, first_domain: arguments.domains };
    let network = Network::from_environment()?;
    let mut crowds: Vec<Crowd> = Vec::new();
    for &count in &arguments.rigs {
        let folder = arguments.out.join(format!("{count:02}"));
        if folder.is_dir() {
            std::fs::remove_dir_all(&folder).with_context(|| format!("{}", folder.display()))?;
        }
        match Crowd::run(count, &scenario, &film, &config, &network, &folder) {
            Ok(crowd) => {
                eprintln!("{count} rigs: {}", crowd.full.as_deref().unwrap_or("holds"));
                crowds.push(crowd);
            }
            Err(error) => {
                eprintln!("{count} rigs: {error}");
                break;
            }
        }
        if crowds.last().is_some_and(|c| c.full.is_some()) && !arguments.beyond {
            break;
        }
    }
    let text = markdown(&crowds);
    println!("{text}");
    if let Some(path) = &arguments.table {
        std::fs::write(path, format!("{HEAD}{text}")).with_context(|| format!("{}", path.display()))?;
    }
    if !crowds.iter().any(|c| c.full.is_none()) {
        bail!("not one rig runs here as it should");
    }
    Ok(())
}
