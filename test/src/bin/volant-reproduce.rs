//! `volant reproduce`: the paper's tables and figures, made anew.

#![allow(clippy::print_stdout, reason = "what it prints is its work")]

use anyhow::{Context, Result, bail};
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use std::{
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
};
use volant_test::{
    live::{Film, Scenario, processes::executables},
    paper::{Made, curves::Curves, report::write_report, rest::figure_9},
};

/// What can be made, in the order of the paper.
const NAMES: [&str; 6] = ["table-1", "table-2", "fig-9", "fig-11", "fig-12", "fig-13"];

/// Makes the paper's tables and figures anew, from the program's own nodes on a simulated bench.
#[derive(Parser)]
#[command(name = "volant reproduce", bin_name = "volant reproduce", version)]
struct Arguments {
    /// What to make (all without a name, or `all`): table-1, table-2, fig-9, fig-11, fig-12, fig-13
    #[arg(value_parser = name)]
    names: Vec<String>,
    /// Folder for NAME.csv, NAME.svg and report.html
    #[arg(long)]
    out: PathBuf,
    /// Everything random follows from it
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length of the swing, s
    #[arg(long, default_value_t = 20.0)]
    seconds: f64,
}

fn name(text: &str) -> Result<String, String> {
    if text == "all" || NAMES.contains(&text) {
        Ok(text.to_owned())
    } else {
        Err(format!("known are all, {}", NAMES.join(", ")))
    }
}

fn main() -> ExitCode {
    match reproduce(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("volant reproduce: {error:#}");
            ExitCode::FAILURE
        }
    }
}

fn reproduce(arguments: &Arguments) -> Result<()> {
    std::fs::create_dir_all(&arguments.out).with_context(|| format!("{}", arguments.out.display()))?;
    let all = arguments.names.is_empty() || arguments.names.iter().any(|n| n == "all");
    let wanted = |name: &str| all || arguments.names.iter().any(|n| n == name);
    let bar = ProgressBar::new(100);
    let style = ProgressStyle::with_template("{msg:<34} [{bar:34}] {percent:>3} %");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    let mut made = Vec::new();
    let mut missing: Vec<(&str, String)> = Vec::new();

    for (name, command, title) in [
        ("table-1", "bench", "Table I: the stages' times"),
        ("fig-11", "sweep", "Fig. 11: success over viewing angle and distance"),
        ("fig-12", "bench", "Fig. 12: mean error and deviation beside the rivals"),
    ] {
        if wanted(name) {
            bar.set_message(name);
            match rivals(arguments, name, command, title) {
                Ok(m) => made.push(m),
                Err(error) => missing.push((name, format!("{error:#}"))),
            }
        }
    }
    if wanted("table-2") || wanted("fig-13") {
        let scenario = Scenario::swing(arguments.seed, arguments.seconds)?;
        bar.set_message("rendering the camera");
        let threads = std::thread::available_parallelism().map_or(1, |n| n.get().min(4));
        let film = Film::shoot(&scenario, threads, |done, of| {
            bar.set_position((90 * done / of.max(1)) as u64);
        })?;
        bar.set_message("four estimators");
        let curves = Curves::of(&scenario, &film)?;
        if wanted("table-2") {
            made.push(curves.table_2(&scenario, &arguments.out)?);
        }
        if wanted("fig-13") {
            made.push(curves.figure_13(&scenario, &arguments.out)?);
        }
    }
    if wanted("fig-9") {
        bar.set_message("fig-9");
        made.push(figure_9(arguments.seed, &arguments.out)?);
    }
    bar.finish_and_clear();
    let command: Vec<String> = std::env::args().skip(1).collect();
    write_report(
        &arguments.out,
        &format!("volant reproduce {}", command.join(" ")),
        &machine(),
        &made,
        &missing,
    )?;
    for m in &made {
        println!("{}: {}", m.name, m.csv.display());
        println!("    {}", m.words);
    }
    println!("report: {}", arguments.out.join("report.html").display());
    if !missing.is_empty() {
        let names: Vec<String> = missing.iter().map(|(n, reason)| format!("{n} ({reason})")).collect();
        bail!("not made: {}", names.join("; "));
    }
    Ok(())
}

/// What needs the rivals (all of OpenCV, ArUco, AprilTag) is made by an executable of its own beside this one.
fn rivals(arguments: &Arguments, name: &'static str, command: &str, title: &'static str) -> Result<Made> {
    let program = executables().join("volant-peers");
    if !program.is_file() {
        bail!("needs volant-peers beside this executable; `make bench` builds it");
    }
    let csv = arguments.out.join(format!("{name}.csv"));
    let status = Command::new(&program)
        .arg(command)
        .arg("--out")
        .arg(&arguments.out)
        .args(["--seed", &arguments.seed.to_string()])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .with_context(|| format!("{}", program.display()))?;
    // A bench whose targets are missed still made its numbers.
    if !csv.is_file() {
        bail!("volant-peers {command} ended with {status} and made no {}", csv.display());
    }
    Ok(Made {
        name,
        title,
        csv,
        svg: None,
        words:
            "Measured in this run by volant-peers, on scenes with truth; where a rival wins, it stands here."
                .to_owned(),
    })
}

fn machine() -> String {
    let info = std::fs::read_to_string(Path::new("/proc/cpuinfo")).unwrap_or_default();
    let model = info
        .lines()
        .find_map(|l| l.strip_prefix("model name"))
        .map_or("a computer", |l| l.trim_start_matches([' ', '\t', ':']));
    let threads = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    format!("{model}, {threads} threads")
}
