//! `volant reproduce`: the paper's tables and figures from simulated data.

use anyhow::{Context, Result, bail};
use clap::Args;
use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use node_kit::{
    files::{self, Pending},
    outln,
};
use rig_simulator::parallel;
use std::path::{Path, PathBuf};
use volant::command_line::number;
use volant_test::{
    live::{ImageSequence, Scenario, processes::executables},
    paper::{
        Made, NAMES,
        curves::Curves,
        occlusion::figure_6,
        peers,
        report::{TITLE, render},
        stages::Stages,
        stationary::figure_9,
    },
};

/// Reproduce the paper's tables and figures with the program's own nodes on a simulated bench.
///
/// fig-2, fig-7, fig-11, fig-12 and table-1 compare with peers, which need the large OpenCV: `make
/// reproduce` builds them and writes everything. Without them the other results are written, and
/// the missing ones are named.
#[derive(Args)]
pub(crate) struct Arguments {
    /// What to make (all without a name, or `all`): fig-2, fig-4, fig-5, fig-6, fig-7, fig-9,
    /// fig-11, fig-12, fig-13, table-1, table-2
    #[arg(value_parser = name)]
    names: Vec<String>,
    /// Folder for NAME.csv, NAME.svg and report.html
    #[arg(long)]
    out: PathBuf,
    /// Replace existing files NAME.csv and NAME.svg; without it only the report of an earlier run
    /// is replaced
    #[arg(long)]
    overwrite: bool,
    /// Random seed
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Length of the swing of fig-13 and table-2, s
    #[arg(long, default_value_t = 20.0, value_parser = number(4.0..=120.0))]
    seconds: f64,
}

fn name(text: &str) -> Result<String, String> {
    if text == "all" || NAMES.contains(&text) {
        Ok(text.to_owned())
    } else {
        Err(format!("known are all, {}", NAMES.join(", ")))
    }
}

/// What the commands of `volant-peers` measure.
const BENCH: [&str; 2] = ["table-1", "fig-12"];
const SWEEP: [&str; 1] = ["fig-11"];
const BOARDS: [&str; 2] = ["fig-2", "fig-7"];

/// Shows the bar of a job beside those of others; it disappears when it drops.
fn show(bars: &MultiProgress, what: &'static str) -> ProgressBar {
    let bar = bars.add(ProgressBar::new(1000));
    let style = ProgressStyle::with_template("{msg:<40} [{bar:34}] {percent:>3} % {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()).progress_chars("=> "));
    bar.set_message(what);
    bar.enable_steady_tick(std::time::Duration::from_millis(250));
    bar
}

/// Shows the share that is done.
fn set_share(bar: &ProgressBar, share: f64) {
    bar.set_position((1000.0 * share) as u64);
}

/// What came of all jobs.
#[derive(Default)]
struct Results {
    made: Vec<Made>,
    missing: Vec<(&'static str, String)>,
}

impl Results {
    fn take(&mut self, name: &'static str, result: Result<Made>) {
        match result {
            Ok(made) => self.made.push(made),
            Err(error) => self.missing.push((name, format!("{error:#}"))),
        }
    }
}

pub(crate) fn run(arguments: &Arguments) -> Result<()> {
    let all = arguments.names.is_empty() || arguments.names.iter().any(|n| n == "all");
    let wanted = |name: &str| all || arguments.names.iter().any(|n| n == name);
    let creating = || format!("creating {}; name another --out", arguments.out.display());
    std::fs::create_dir_all(&arguments.out).with_context(creating)?;
    for name in NAMES.into_iter().filter(|n| wanted(n)) {
        for file in [format!("{name}.csv"), format!("{name}.svg")] {
            files::check_output(&arguments.out.join(file), arguments.overwrite, &[])?;
        }
    }
    let report = arguments.out.join("report.html");
    files::check_output(&report, arguments.overwrite || is_report(&report), &[])?;
    // The peers leave more than is wanted, such as the other names of a job.
    let work = Pending::new(&arguments.out.join("results"), false)?;
    std::fs::create_dir(&work.temporary).with_context(creating)?;
    let out = &work.temporary;
    let any = |names: &[&str]| names.iter().any(|n| wanted(n));
    let bars = MultiProgress::new();
    let peers = peers::find_peers(&executables());
    let cores = parallel::processors();
    let run_peers = |results: &mut Results, names: &[&'static str], command, what| -> bool {
        if !any(names) {
            return false;
        }
        let bar = show(&bars, what);
        let done = match &peers {
            None => Err(format!(
                "it compares with peers and needs {}, which is not built; `make reproduce` \
                 builds it and makes everything",
                peers::PEERS
            )),
            Some(program) => {
                peers::run(program, command, out, arguments.seed, |share| set_share(&bar, share))
            }
        };
        let Err(why) = done else { return true };
        let missing = names.iter().copied().filter(|n| wanted(n));
        results.missing.extend(missing.map(|n| (n, why.clone())));
        false
    };

    let mut results = Results::default();
    // Times are measured first, with nothing beside it.
    if run_peers(&mut results, &BENCH, "bench", "the tracker beside its peers") {
        if wanted("table-1") {
            results.take("table-1", peers::table_1(out));
        }
        if wanted("fig-12") {
            results.take("fig-12", peers::figure_12(out));
        }
    }
    let (own, others) = std::thread::scope(|scope| {
        let others = scope.spawn(|| {
            let mut results = Results::default();
            if run_peers(&mut results, &SWEEP, "sweep", "viewing angle and distance") {
                results.take("fig-11", peers::figure_11(out));
            }
            if run_peers(&mut results, &BOARDS, "boards", "chessboards") {
                for name in BOARDS.into_iter().filter(|n| wanted(n)) {
                    results.take(name, peers::boards(name, out));
                }
            }
            results
        });
        let beside = peers.is_some() && (any(&SWEEP) || any(&BOARDS));
        let threads = if beside { cores.saturating_sub(1).max(1) } else { cores.min(4) };
        let own = simulate(arguments, &wanted, &bars, threads);
        (own, others.join())
    });
    for part in [own?, others.unwrap_or_default()] {
        results.made.extend(part.made);
        results.missing.extend(part.missing);
    }
    conclude(arguments, results)
}

/// What needs the simulated rig alone.
fn simulate(
    arguments: &Arguments,
    wanted: &dyn Fn(&str) -> bool,
    bars: &MultiProgress,
    threads: usize,
) -> Result<Results> {
    let seed = arguments.seed;
    let mut results = Results::default();
    if wanted("fig-9") {
        let _bar = show(bars, "a stationary IMU");
        results.take("fig-9", figure_9(seed));
    }
    if wanted("fig-4") || wanted("fig-5") {
        let _bar = show(bars, "the tracker's stages");
        let stages = Stages::of(seed, threads)?;
        if wanted("fig-4") {
            results.take("fig-4", stages.figure_4());
        }
        if wanted("fig-5") {
            results.take("fig-5", stages.figure_5());
        }
    }
    if wanted("fig-6") {
        let bar = show(bars, "an occluded marker");
        results.take("fig-6", figure_6(seed, threads, |share| set_share(&bar, 0.9 * share)));
    }
    if wanted("table-2") || wanted("fig-13") {
        let bar = show(bars, "all estimators in a swing");
        let scenario = Scenario::swing(seed, arguments.seconds)?;
        let images = ImageSequence::render(&scenario, threads, |done, of| {
            set_share(&bar, 0.9 * done as f64 / of.max(1) as f64);
        })?;
        let curves = Curves::of(&scenario, &images)?;
        if wanted("table-2") {
            results.take("table-2", Ok(curves.table_2()));
        }
        if wanted("fig-13") {
            results.take("fig-13", curves.figure_13());
        }
    }
    Ok(results)
}

/// Whether a file is a report that this command wrote.
fn is_report(path: &Path) -> bool {
    std::fs::read_to_string(path).is_ok_and(|text| text.contains(TITLE))
}

/// Writes what was made to the output folder.
fn conclude(arguments: &Arguments, mut results: Results) -> Result<()> {
    let place = |name: &str| NAMES.iter().position(|n| *n == name);
    results.made.sort_by_key(|m| place(m.name));
    results.missing.sort_by_key(|m| place(m.0));
    let words: Vec<String> =
        std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned()).collect();
    let facts = [
        ("Command", format!("`volant {}`", words.join(" "))),
        ("Seed", arguments.seed.to_string()),
        ("Machine", machine()),
    ]
    .map(|(name, value)| (name.to_owned(), value));
    for m in &results.made {
        let path = |ending: &str| arguments.out.join(format!("{}.{ending}", m.name));
        let (csv, svg) = (path("csv"), path("svg"));
        files::write(&svg, m.svg.as_bytes(), arguments.overwrite)?;
        files::write(&csv, m.csv.as_bytes(), arguments.overwrite)?;
        outln!("{}: {}\n    {}", m.name, csv.display(), m.shows)?;
    }
    let page = render(facts.into(), &results.made, &results.missing);
    let report = arguments.out.join("report.html");
    files::write(&report, page.as_bytes(), arguments.overwrite || is_report(&report))?;
    outln!("report: {}", report.display())?;
    if !results.missing.is_empty() {
        let mut reasons: Vec<(String, Vec<&str>)> = Vec::new();
        for (name, why) in &results.missing {
            match reasons.iter_mut().find(|r| r.0 == *why) {
                Some(r) => r.1.push(name),
                None => reasons.push((why.clone(), vec![name])),
            }
        }
        let parts: Vec<String> =
            reasons.iter().map(|(why, names)| format!("{}: {why}", names.join(", "))).collect();
        bail!("not made: {}", parts.join("; "));
    }
    Ok(())
}

fn machine() -> String {
    let info = std::fs::read_to_string(Path::new("/proc/cpuinfo")).unwrap_or_default();
    let model = info
        .lines()
        .find_map(|l| l.strip_prefix("model name"))
        .map_or("a computer", |l| l.trim_start_matches([' ', '\t', ':']));
    format!("{model}, {} hardware threads", parallel::processors())
}
