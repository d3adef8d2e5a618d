//! `volant sites`: rigs and an operator on two sites, connected by Zenoh bridges over a bad link.

use anyhow::{Result, ensure};
use clap::Args;
use node_kit::errln;
use std::path::PathBuf;
use volant_test::{
    hosts::{
        Hosts,
        sites::{Trial, markdown, rows},
    },
    report::TableFile,
    run_folder::RunFolder,
};

/// Run simulated rigs at one site and an operator at another (network namespaces, as root), each
/// in a DDS domain of its own, with Zenoh bridges over a link that loses, delays and is cut.
#[derive(Args)]
pub(crate) struct Arguments {
    /// Executable of the bridge (`make bridge` builds one)
    #[arg(long, default_value = "target/release/zenoh-bridge-ros2dds")]
    bridge: PathBuf,
    /// Folder with bridge_rig.json5 and bridge_operator.json5
    #[arg(long, default_value = "launch_config/config")]
    config: PathBuf,
    /// Number of rigs
    #[arg(long, default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=8))]
    rigs: u8,
    /// Folder for logs and bags: new, empty or of an earlier run, which is replaced
    #[arg(long, default_value = "target/sites")]
    out: PathBuf,
    #[command(flatten)]
    table: TableFile,
    /// Random seed
    #[arg(long, default_value_t = 5)]
    seed: u64,
}

const HEAD: &str = "\
    # Two sites\n\n\
    Written by `volant sites --table test/SITES.md` (as root). Simulated rigs ({rigs}) with their\n\
    nodes are in one network namespace, each in a DDS domain of its own; an operator's\n\
    `volant record` is in another. Eclipse's bridges, with the configurations of\n\
    `launch_config`, connect them over TCP; a link in user space loses and delays Ethernet\n\
    frames each way. Odometry at 10 Hz per rig, 10 s per row, one row after the other without\n\
    a restart; all processes share two processors. Bytes are those of all topics that cross.\n\n";

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    arguments.table.check(&[])?;
    ensure!(
        arguments.bridge.is_file(),
        "{}: there is no bridge; build one with `make bridge`, or name Eclipse's with --bridge",
        arguments.bridge.display()
    );
    let folder = RunFolder::create(&arguments.out)?;
    let hosts = Hosts::new(arguments.seed)?;
    errln!("{} rigs, {} rows; the rigs' images are drawn first", arguments.rigs, rows().len());
    let trial = Trial {
        hosts: &hosts,
        bridge: &arguments.bridge,
        config: &arguments.config,
        folder: folder.path(),
        rigs: arguments.rigs.into(),
        seed: arguments.seed,
    };
    let head = HEAD.replace("{rigs}", &arguments.rigs.to_string());
    arguments.table.publish(&head, &markdown(&trial.run()?))
}
