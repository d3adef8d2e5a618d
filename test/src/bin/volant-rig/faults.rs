//! `make faults`: every fault of the table on real processes. Exit status 0 when each row holds; 1 when one fails or is
//! skipped.

use anyhow::{Context, Result};
use clap::Args;
use node_kit::environment::Network;
use std::{path::PathBuf, sync::Arc};
use volant_test::{
    faults::{LENGTH, Outcome, Verdict, markdown, table},
    live::{Film, Scenario},
};

/// Breaks a live simulated rig in every way of the table and asserts on what the nodes publish.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Only rows whose fault contains this text
    #[arg(long)]
    only: Option<String>,
    /// Folder for the nodes' logs
    #[arg(long, default_value = "target/faults")]
    out: PathBuf,
    /// Also write the table, as Markdown, to this file
    #[arg(long)]
    table: Option<PathBuf>,
    /// Keep each row's run as a bag beside its logs
    #[arg(long)]
    bags: bool,
    /// DDS domain to run on, so that a rig on the usual one is not disturbed
    #[arg(long, default_value_t = 91)]
    domain: u16,
    /// Everything random follows from it
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "# Faults, and what becomes of the pose\n\n\
    Written by `volant faults --table test/FAULTS.md`: a live simulated rig (four processes over DDS, camera at 30 Hz, inertial unit \
    at 100 Hz, encoders at 50 Hz; 9 s of swing) is broken from 2 s to 5 s. Error and odometry are of these 3 s, against the truth; back \
    is who is nearer than 10 mm and 1° to it, to stay, without a gap of more than 60 ms; a row fails too where a message holds a \
    number that is none, a node panics or ends wrongly, or the truth contradicts the covariance (NEES of position or rotation beyond \
    the 0.9999 quantile of χ² with 3 degrees of freedom) in more than 2 % of the odometry.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    let mut scenario = Scenario::swing(arguments.seed, LENGTH)?;
    scenario.covers.clear();
    let rows: Vec<_> = table()
        .into_iter()
        .filter(|row| arguments.only.as_ref().is_none_or(|text| row.fault.contains(text.as_str())))
        .collect();
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(4));
    eprintln!("rendering the camera's film of {LENGTH} s for {} rows", rows.len());
    let film = Arc::new(Film::shoot(&scenario, threads, |_, _| {})?);
    let network = Network { domain_id: arguments.domain, ..Network::from_environment()? };
    let mut outcomes: Vec<(&'static str, Outcome)> = Vec::new();
    for (i, row) in rows.iter().enumerate() {
        let folder = arguments.out.join(format!("{:02}", i + 1));
        if folder.is_dir() {
            std::fs::remove_dir_all(&folder).with_context(|| format!("{}", folder.display()))?;
        }
        let bag = arguments.bags.then(|| folder.join("bag"));
        let outcome = match row.run(&scenario, &film, &network, &folder, bag.as_deref()) {
            Ok(outcome) => outcome,
            Err(error) => Outcome::skipped(error.to_string()),
        };
        let verdict = match &outcome.verdict {
            Verdict::Holds => "holds".to_owned(),
            Verdict::Fails(reasons) => format!("FAILS: {}", reasons.join("; ")),
            Verdict::Skipped(reason) => format!("SKIPPED: {reason}"),
        };
        eprintln!("[{:2}/{}] {}: {verdict}", i + 1, rows.len(), row.fault);
        outcomes.push((row.fault, outcome));
    }
    let text = markdown(&outcomes);
    println!("{text}");
    if let Some(path) = &arguments.table {
        std::fs::write(path, format!("{HEAD}{text}")).with_context(|| format!("{}", path.display()))?;
    }
    let held = outcomes.iter().filter(|(_, o)| o.verdict == Verdict::Holds).count();
    println!("{held} of {} rows hold", outcomes.len());
    Ok(held == outcomes.len() && !outcomes.is_empty())
}
