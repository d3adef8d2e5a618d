//! `volant checks`: faults in the files and messages of recordings, and whether `volant check`
//! names them. Exit status 0 when at least 95 % are right and no unchanged run is called wrong.

use anyhow::{Context, Result, bail, ensure};
use clap::Args;
use node_kit::outln;
use std::path::{Path, PathBuf};
use volant::report::Table;
use volant_test::{
    check::{Bench, FAULTS},
    report::TableFile,
    robustness::recording,
};

/// Make the files and messages of recordings wrong in one thing, and check them.
#[derive(Args)]
#[command(mut_arg("overwrite", |a| a.help("Replace an existing table; never a recording")))]
pub(crate) struct Arguments {
    /// Folder of recordings, each a folder with in.mcap, rig.yaml, truth.mcap and truth_markers.csv
    #[arg(long)]
    bags: Option<PathBuf>,
    /// Only recordings whose name contains this text
    #[arg(long, default_value = "")]
    only: String,
    /// Only faults whose name contains this text
    #[arg(long, default_value = "")]
    fault: String,
    /// Number of unchanged simulated runs
    #[arg(long, default_value_t = 10)]
    clean: u64,
    /// Also print the findings' sentences
    #[arg(long)]
    verbose: bool,
    #[command(flatten)]
    table: TableFile,
}

/// Share of right cells that is asserted.
const RIGHT: f64 = 0.95;

pub(crate) fn run(arguments: &Arguments) -> Result<bool> {
    let inputs: Vec<&Path> = arguments.bags.iter().map(PathBuf::as_path).collect();
    arguments.table.check(&inputs)?;
    let faults = FAULTS.iter().filter(|f| f.name.contains(arguments.fault.as_str()));
    let faults: Vec<_> = faults.collect();
    ensure!(
        !faults.is_empty(),
        "--fault {}: no fault has this in its name; test/CHECK.md lists them",
        arguments.fault
    );
    let mut benches = vec![];
    if let Some(bags) = &arguments.bags {
        for folder in recording::folders(bags, &arguments.only)? {
            let bench = Bench::read(&folder);
            benches.push(bench.with_context(|| format!("{}", folder.display()))?);
        }
    }
    if "simulated".contains(arguments.only.as_str()) {
        benches.push(Bench::simulated(1)?);
    }
    if benches.is_empty() {
        bail!("no recording whose name contains `{}`", arguments.only);
    }
    let (mut right, mut count) = (0, 0);
    let names: Vec<&str> = benches.iter().map(Bench::name).collect();
    let (mut rows, mut row) = (vec![], vec!["none".to_owned()]);
    let (mut alarms, mut unchanged_warned) = (0, 0);
    for bench in &benches {
        let findings: Vec<&str> = bench.clean().findings.iter().map(|f| f.text.as_str()).collect();
        alarms += usize::from(!findings.is_empty());
        let running = bench.while_running(None);
        unchanged_warned += usize::from(!running.is_empty());
        if !running.is_empty() {
            outln!("{}: false warning: {}", bench.name(), running.join("; "))?;
        }
        row.push(if findings.is_empty() { "ok".into() } else { findings.join("; ") });
    }
    row.push(unchanged_warned.to_string());
    rows.push(row);
    if arguments.verbose {
        for bench in &benches {
            for row in &bench.clean().rows {
                outln!(
                    "{}: {:<32} {:>10.3} {:>10.3} ± {:.3} {} {}",
                    bench.name(),
                    row.name,
                    row.file,
                    row.estimate,
                    row.deviation,
                    row.unit,
                    row.verdict
                )?;
            }
        }
    }
    for fault in faults {
        let mut row = vec![fault.name.to_owned()];
        let mut warned = 0;
        for bench in &benches {
            let cell = bench.cell(fault);
            count += 1;
            right += usize::from(cell.right);
            let mark = if cell.right { "" } else { "**" };
            row.push(format!("{mark}{}{mark}", cell.text));
            if arguments.verbose || !cell.right {
                let said = cell.sentences.join("; ");
                outln!("{}: {}: {} [{said}]", bench.name(), fault.name, cell.text)?;
            }
            let running = bench.while_running(Some(fault));
            warned += usize::from(!running.is_empty());
            if arguments.verbose {
                outln!("{}: {}: nodes: {}", bench.name(), fault.name, running.join("; "))?;
            }
        }
        row.push(warned.to_string());
        rows.push(row);
    }
    let mut false_alarms = vec![];
    for seed in 101..101 + arguments.clean {
        let bench = Bench::simulated(seed)?;
        for finding in &bench.clean().findings {
            false_alarms.push(format!("seed {seed}: {}", finding.text));
        }
        for finding in bench.while_running(None) {
            false_alarms.push(format!("seed {seed}, while running: {finding}"));
        }
    }
    let share = right as f64 / f64::max(f64::from(count), 1.0);
    let text = format!(
        "{}\nRight: {right} of {count} ({:.1} %). Findings in unchanged recordings: {alarms} of \
         {}, in {} unchanged simulated runs of other seeds: {}.\n",
        Table::new(&format!("fault | {} | nodes", names.join(" | ")), rows).to_markdown(),
        100.0 * share,
        benches.len(),
        arguments.clean,
        false_alarms.len()
    );
    for alarm in &false_alarms {
        outln!("false alarm: {alarm}")?;
    }
    arguments.table.publish(HEAD, &text)?;
    Ok(share >= RIGHT && false_alarms.is_empty() && alarms + unchanged_warned == 0)
}

const HEAD: &str = "\
    # Check: recordings whose files or messages are wrong\n\n\
    Written by `make checks`. Each recording is made wrong in one thing, and `volant check`\n\
    compares it with its files. A cell holds the findings' verdicts and keys; it is right where\n\
    they name the cause and nothing else is called wrong, or where the value is `unobservable` in\n\
    that recording. Bold: not right. The last column is the number of these recordings in which\n\
    `pose_fusion` itself reports a symptom in `/diagnostics` (`rig file`) while it runs.\n\n";
