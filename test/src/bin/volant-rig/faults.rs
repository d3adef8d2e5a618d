//! `make faults`: every fault of the table on real processes. Exit status 0 when each row holds; 1
//! when one fails or is skipped.

use anyhow::{Result, ensure};
use clap::Args;
use node_kit::{environment::Network, errln};
use std::{path::PathBuf, sync::Arc};
use volant_test::{
    faults::{COLUMNS, LENGTH, table},
    live::{ImageSequence, Scenario},
    report::{LiveTable, TableFile},
    run_folder::RunFolder,
};

/// Break a live simulated rig in every way of the table and assert on what the nodes publish.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Only rows whose fault contains this text
    #[arg(long)]
    only: Option<String>,
    /// Folder for the nodes' logs, one in it for each run: new, empty or of an earlier run, which
    /// is replaced
    #[arg(long, default_value = "target/faults")]
    out: PathBuf,
    #[command(flatten)]
    table: TableFile,
    /// Keep each row's run as a bag beside its logs
    #[arg(long)]
    bags: bool,
    /// DDS domain to run on, so that a rig on the usual one is not disturbed
    #[arg(long, default_value_t = 91)]
    domain: u16,
    /// Random seed
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "\
    # Faults, and what becomes of the pose\n\n\
    Written by `volant faults --table test/FAULTS.md`. A live simulated rig (four processes\n\
    over DDS, camera at 30 Hz, IMU at 100 Hz, encoders at 50 Hz; 9 s of swing) is broken\n\
    from 2 s to 5 s. Error and odometry are of these 3 s, against the ground truth. \"Back\"\n\
    is the time until the error stays below 10 mm and 1° without a gap of more than 60 ms.\n\n\
    A row fails too where a message contains a non-finite number, a node panics or ends\n\
    wrongly, or the truth contradicts the covariance (NEES of position or rotation beyond\n\
    the 0.9999 quantile of χ² with 3 degrees of freedom) in more than 2 % of the odometry.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    arguments.table.check(&[])?;
    let only = arguments.only.as_deref().unwrap_or_default();
    let rows: Vec<_> = table().into_iter().filter(|row| row.fault.contains(only)).collect();
    ensure!(!rows.is_empty(), "--only {only}: no row has this in its fault; see test/FAULTS.md");
    let mut scenario = Scenario::swing(arguments.seed, LENGTH)?;
    scenario.covers.clear();
    let folders = (1..=rows.len())
        .map(|i| RunFolder::create(&arguments.out.join(format!("{i:02}"))))
        .collect::<Result<Vec<_>, _>>()?;
    errln!("rendering the camera's images of {LENGTH} s for {} rows", rows.len());
    let images = Arc::new(ImageSequence::of(&scenario)?);
    let network = Network { domain_id: arguments.domain, ..Network::from_environment()? };
    let mut results = LiveTable::new(COLUMNS);
    for (i, (row, folder)) in rows.iter().zip(&folders).enumerate() {
        let folder = folder.path();
        let bag = arguments.bags.then(|| folder.join("bag"));
        let outcome = row.run(&scenario, &images, &network, folder, bag.as_deref());
        let verdict = results.add(row.fault, outcome);
        errln!("[{:2}/{}] {}: {verdict}", i + 1, rows.len(), row.fault);
    }
    results.finish(&arguments.table, HEAD)
}
