//! `make robustness`: the estimator on recordings that differ from their rig file in one thing, and
//! in every pair of two. Exit status 0 when nothing catastrophic happens; what a perturbation may
//! cost is in the table.

use anyhow::{Result, bail};
use clap::Args;
use indicatif::ProgressBar;
use node_kit::outln;
use pose_fusion::FusionConfig;
use rig_simulator::parallel;
use std::{
    fs,
    path::{Path, PathBuf},
};
use volant_test::{
    report::{TableFile, measured_with},
    robustness::{
        perturbation::{PERTURBED_FROM, Perturbation, TABLE},
        recording::{self, folders},
        table::{self, Bench},
    },
};

/// Change recordings in one thing, or in two, and compare the pose with the truth.
#[derive(Args)]
#[command(mut_arg("overwrite", |a| a.help("Replace an existing table; never a recording")))]
pub(crate) struct Arguments {
    /// Folder of recordings, each a folder with in.mcap, rig.yaml, truth.mcap and truth_markers.csv
    #[arg(long)]
    bags: PathBuf,
    /// Folder with replays of them (`NAME.mcap`) whose tracked markers are used; without it the
    /// true centroids with 0.1 px of noise
    #[arg(long)]
    markers: Option<PathBuf>,
    /// Only recordings whose name contains this text
    #[arg(long)]
    only: Option<String>,
    /// Beginning of a perturbation of limited duration, s after the first truth
    #[arg(long, default_value_t = PERTURBED_FROM)]
    from: f64,
    /// Also every pair of perturbations
    #[arg(long)]
    pairs: bool,
    #[command(flatten)]
    table: TableFile,
}

const HEAD: &str = "\
    # Robustness: recordings that differ from their rig file\n\n\
    Written by `make robustness`. Each recording is changed in one thing (the rig file stays\n\
    as it was, or is changed while the recording stays), and the estimator runs over it with\n\
    its default parameters. A cell is the position RMSE over that of the unchanged\n\
    recording, the largest position error, and the mean NEES of position and rotation (3\n\
    each where the covariance is right).\n\n\
    Bold: more than the perturbation may cost (`test/src/robustness/table.rs`).\n\n";

/// Longest perturbation of limited duration, until it has settled, and a second to measure, s.
const MEASURED: f64 = 4.0;

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    let recordings = fs::read_dir(&arguments.bags).into_iter().flatten().flatten();
    let recordings: Vec<PathBuf> = recordings.map(|entry| entry.path()).collect();
    let inputs: Vec<&Path> =
        recordings.iter().chain(&arguments.markers).map(PathBuf::as_path).collect();
    arguments.table.check(&inputs)?;
    let benches = read(arguments)?;
    let bar = ProgressBar::new((TABLE.len() * benches.len()) as u64);
    let mut rows = Vec::new();
    let mut catastrophes = Vec::new();
    for perturbation in TABLE {
        let mut cells = Vec::new();
        for bench in &benches {
            let cell = bench.single(&perturbation);
            catastrophes.extend(
                cell.catastrophe.iter().map(|c| format!("{}: {perturbation}: {c}", bench.name())),
            );
            for failure in &cell.failures {
                bar.suspend(|| outln!("{}: {perturbation}: {failure}", bench.name()))?;
            }
            cells.push(cell);
            bar.inc(1);
        }
        rows.push((perturbation, cells));
    }
    bar.finish_and_clear();
    let from = arguments.from;
    let beginning = if from == PERTURBED_FROM {
        String::new()
    } else {
        format!("Perturbations of limited duration begin at {from} s (`--from {from}`).\n\n")
    };
    let mut text = format!("{beginning}{}", table::markdown(&benches, &rows));
    if arguments.pairs {
        let pairs = table::pairs();
        catastrophes.extend(of_pairs(&benches, &pairs));
        text.push_str(&format!(
            "\nPairs: {} of two perturbations on each recording. Non-finite numbers, or poses\n\
             more than 1 m wrong that are called valid: {}.\n",
            pairs.len(),
            catastrophes.len()
        ));
    }
    // Before the table is written, which changes the working tree.
    let measured = measured_with();
    arguments.table.write(HEAD, &text)?;
    outln!("{HEAD}{measured}{text}")?;
    for catastrophe in &catastrophes {
        outln!("{catastrophe}")?;
    }
    Ok(catastrophes.is_empty())
}

/// Returns what never may happen of every pair on every recording, in their order.
fn of_pairs(benches: &[Bench], pairs: &[(Perturbation, Perturbation)]) -> Vec<String> {
    let jobs: Vec<_> =
        pairs.iter().flat_map(|pair| benches.iter().map(move |bench| (bench, pair))).collect();
    let bar = ProgressBar::new(jobs.len() as u64);
    let found = parallel::map(
        parallel::processors(),
        jobs.len(),
        || (),
        |(), job| {
            let (bench, (first, second)) = jobs[job];
            let catastrophe = bench.pair(first, second);
            bar.inc(1);
            catastrophe.map(|c| format!("{}: {first}, {second}: {c}", bench.name()))
        },
    );
    bar.finish_and_clear();
    found.into_iter().flatten().collect()
}

fn read(arguments: &Arguments) -> Result<Vec<Bench>> {
    let (bags, only) = (&arguments.bags, arguments.only.as_deref().unwrap_or_default());
    let mut benches = Vec::new();
    for folder in folders(bags, only)? {
        let replay =
            |markers: &PathBuf| Some(markers.join(folder.file_name()?).with_extension("mcap"));
        let markers = arguments.markers.as_ref().and_then(replay);
        if let Some(missing) = markers.as_ref().filter(|path| !path.is_file()) {
            bail!("--markers: {} is not there; replay the recording into it", missing.display());
        }
        let recording = recording::read(&folder, markers.as_deref())
            .map_err(|e| anyhow::anyhow!("{}: {e}", folder.display()))?;
        let end = recording.truth.span().map_or(0.0, |(first, last)| last.seconds_since(first));
        let latest = end - MEASURED;
        if !(0.0..=latest).contains(&arguments.from) {
            bail!(
                "--from {}: not between 0 and {latest:.1} s; {} lasts {end:.1} s, the longest \
                 perturbation and what is measured after it {MEASURED} s",
                arguments.from,
                folder.display()
            );
        }
        benches.push(Bench::new(recording, FusionConfig::default(), arguments.from));
    }
    if benches.is_empty() {
        bail!("{}: no folder `*{only}*` with truth.mcap in it", bags.display());
    }
    Ok(benches)
}
