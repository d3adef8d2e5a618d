//! `volant rigs`: 1, 2, 4, 8 … rigs on this machine until it is full.

use anyhow::{Result, bail};
use clap::Args;
use node_kit::environment::Network;
use node_kit::{errln, files, outln};
use std::{path::PathBuf, sync::Arc};
use volant::command_line::number;
use volant_test::{
    hosts::Island,
    live::{ImageSequence, Scenario},
    load_test::{Load, LoadConfig, markdown},
    run_folder::RunFolder,
};

/// Load test: add simulated rigs, each with its four nodes, until the computer is saturated, and
/// report the cost of one.
#[derive(Args)]
pub(crate) struct Arguments {
    /// How many, one load after the other
    #[arg(long, value_delimiter = ',', default_values_t = [1, 2, 4, 8, 16, 32])]
    rigs: Vec<usize>,
    /// Duration of the measurement, s
    #[arg(long, default_value_t = 10.0, value_parser = number(1.0..=3600.0))]
    seconds: f64,
    /// Each rig in a DDS domain of its own, from this one on, instead of all in one domain
    #[arg(long)]
    domains: Option<u16>,
    /// Go on though the machine is full
    #[arg(long)]
    beyond: bool,
    /// Folder for the nodes' logs, one in it for each run: new, empty or of an earlier run, which
    /// is replaced
    #[arg(long, default_value = "target/rigs")]
    out: PathBuf,
    /// Also write the table, as Markdown, to this file
    #[arg(long)]
    table: Option<PathBuf>,
    /// Replace an existing table
    #[arg(long)]
    overwrite: bool,
    /// Random seed
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "\
    # Many rigs on one machine\n\n\
    Written by `volant rigs --table test/RIGS.md` (as root, so that only the rigs' bytes are\n\
    counted). Each rig has four processes, a camera of 640 × 480 JPEG at 30 Hz, an IMU at\n\
    100 Hz and encoders at 50 Hz; the simulated hardware runs on the same machine. The\n\
    machine is full where less than 97 % of the odometry arrives, or the p99 from an image\n\
    to the odometry that contains it exceeds 33 ms.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    if let Some(path) = &arguments.table {
        files::check_output(path, arguments.overwrite, &[])?;
    }
    let folders = arguments
        .rigs
        .iter()
        .map(|count| RunFolder::create(&arguments.out.join(format!("{count:02}"))))
        .collect::<Result<Vec<_>, _>>()?;
    let scenario = Scenario::lap(arguments.seed, 10.0)?;
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(4));
    errln!("rendering the camera's images of {} s", scenario.duration());
    let images = Arc::new(ImageSequence::render(&scenario, threads, |_, _| {})?);
    // A network of its own, so that nothing else is counted; the threads and processes from here on
    // are in it.
    let island = Island::enter();
    if let Err(reason) = &island {
        errln!("everything on this machine's network is counted: {reason}");
    }
    let config =
        LoadConfig { settle: 4.0, measure: arguments.seconds, first_domain: arguments.domains };
    let network = Network::from_environment()?;
    let mut loads: Vec<Load> = Vec::new();
    for (&count, folder) in arguments.rigs.iter().zip(&folders) {
        match Load::run(count, &scenario, &images, &config, &network, folder.path()) {
            Ok(load) => {
                errln!("{count} rigs: {}", load.full.as_deref().unwrap_or("holds"));
                loads.push(load);
            }
            Err(error) => {
                errln!("{count} rigs: {error}");
                break;
            }
        }
        if loads.last().is_some_and(|c| c.full.is_some()) && !arguments.beyond {
            break;
        }
    }
    let text = markdown(&loads);
    if let Some(path) = &arguments.table {
        files::write(path, format!("{HEAD}{text}").as_bytes(), arguments.overwrite)?;
    }
    outln!("{text}")?;
    if !loads.iter().any(|c| c.full.is_none()) {
        bail!("not one rig runs here as it should");
    }
    Ok(())
}
