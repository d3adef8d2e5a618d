//! `volant simulate`: recordings of ideal sensors on the simulated rig, with ground truth.

use anyhow::{Context, Result};
use clap::Args;
use node_kit::{convert, files, outln};
use rig_model::topics;
use std::{fs, path::PathBuf};
use volant::command_line::{UsageError, number};
use volant_test::live::{Scenario, bag::from_sensors};

/// Write simulated runs: markers, IMU, climber and ground truth, without images and nodes.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Folder of the runs, each a folder NAME with in.mcap and rig.yaml
    #[arg(long)]
    out: PathBuf,
    /// Number of runs
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    runs: u64,
    /// Duration of each, s
    #[arg(long, default_value_t = 10.0, value_parser = number(1.0..=3600.0))]
    seconds: f64,
    /// Seed of the first run; the others follow
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Replace existing runs
    #[arg(long)]
    overwrite: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let (seed, runs) = (arguments.seed, arguments.runs);
    let Some(end) = seed.checked_add(runs) else {
        let text = format!("--seed {seed}: the seeds of {runs} runs are beyond 64 bits");
        return Err(UsageError(text).into());
    };
    let seeds = seed..end;
    let outputs = |seed: u64| {
        let folder = arguments.out.join(format!("run_{seed:05}"));
        (folder.join("in.mcap"), folder.join("rig.yaml"), folder)
    };
    for (bag, rig, _) in seeds.clone().map(outputs) {
        for output in [&bag, &rig] {
            files::check_output(output, arguments.overwrite, &[])?;
        }
    }
    for seed in seeds {
        let (bag, rig, folder) = outputs(seed);
        fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        let scenario = Scenario::swing(seed, arguments.seconds)?;
        let frames = scenario.rig.frames.clone();
        let topic = topics::absolute::CLIMBER_TRANSFORM;
        from_sensors(&bag, &scenario, topic, |sample| convert::climber_message(sample, &frames))?;
        files::write(&rig, scenario.rig_file().as_bytes(), arguments.overwrite)?;
    }
    outln!("{} runs in {}", arguments.runs, arguments.out.display())?;
    Ok(())
}
