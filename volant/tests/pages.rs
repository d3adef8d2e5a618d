//! Generated pages: `docs/src/parameters.md` from the nodes' declarations, `docs/src/figures.md`
//! and the table in `README.md` from the files that tests and tools write. `make pages` writes
//! them; these tests compare.
#![allow(clippy::unwrap_used, clippy::panic, reason = "tests")]

use climber_driver::node::ClimberNode;
use imu_driver::node::ImuNode;
use marker_tracker::node::MarkerTrackerNode;
use node_kit::{
    NodeShell, ParameterSet,
    parameters::{common_descriptors, markdown_table},
};
use pose_fusion::node::FusionNode;
use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

/// Set to write the pages instead of comparing them.
const UPDATE: &str = "VOLANT_UPDATE_PAGES";
const REPLAY: &str = "volant/tests/replay_figures.csv";
const PEERS: &str = "test/tests/data/bench.csv";
/// Version with which [`PEERS`] was measured.
const PEERS_VERSION: &str = "0.1.0, commit 2460bae of 2026-11-22";
/// Around the generated table in `README.md`.
const BEGIN: &str = "<!-- figures: written by `make pages` -->\n\n";
const END: &str = "\n<!-- end of the figures -->";
/// Recorded runs and what happens in them.
const RUNS: [(&str, &str); 4] = [
    ("nominal", "nominal"),
    ("occlude_two", "two markers hidden for 1.5 s, twice"),
    ("fast_swing", "swing of up to 35° at 1 Hz"),
    ("clutter", "distractors in the markers' colors on the floor"),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// Compares a file with its generated text, or writes it where [`UPDATE`] is set.
fn check(path: &str, generated: &str) {
    if std::env::var_os(UPDATE).is_some() {
        fs::write(root().join(path), generated).unwrap();
    } else {
        assert!(read(path) == generated, "{path} is not current: run `make pages`");
    }
}

/// Fields of each line of a CSV file after its header. Only a first field may be quoted.
fn csv(path: &str) -> Vec<Vec<String>> {
    let fields = |line: &str| -> Vec<String> {
        let (first, rest) = match line.strip_prefix('"') {
            Some(quoted) => quoted.split_once("\",").unwrap(),
            None => line.split_once(',').unwrap(),
        };
        [first].into_iter().chain(rest.split(',')).map(str::to_owned).collect()
    };
    read(path).lines().skip(1).map(fields).collect()
}

/// Errors of one estimate of one recorded run.
struct Errors {
    run: String,
    model: String,
    estimate: String,
    /// Messages; RMSE and largest error of position, mm, and rotation, degrees; NEES of both.
    fields: Vec<String>,
}

impl Errors {
    fn all() -> Vec<Errors> {
        let from = |mut row: Vec<String>| {
            let fields = row.split_off(3);
            let [run, model, estimate] = row.try_into().unwrap();
            Errors { run, model, estimate, fields }
        };
        csv(REPLAY).into_iter().map(from).collect()
    }

    fn number(&self, index: usize) -> f64 {
        self.fields[index].parse().unwrap()
    }

    /// RMSE of position and rotation as text.
    fn rmse(&self) -> String {
        let decimals = if self.number(1) < 10.0 { 2 } else { 0 };
        format!("{:.decimals$} mm, {:.3}°", self.number(1), self.number(3))
    }
}

fn readme_table() -> String {
    let all = Errors::all();
    let rmse = |run: &str, model: &str, estimate: &str| {
        let is = |e: &&Errors| e.run == run && e.model == model && e.estimate == estimate;
        all.iter().find(is).map_or("–".to_owned(), Errors::rmse)
    };
    let mut text = String::from(
        "| recorded run (12 s) | fused | one image alone | published filter |\n\
         | --- | --- | --- | --- |\n",
    );
    for (run, what) in RUNS {
        let fused = rmse(run, "tight", "volant/odometry");
        let image = rmse(run, "tight", "volant/visual_pose");
        let paper = rmse(run, "paper", "volant/odometry");
        writeln!(text, "| {what} | **{fused}** | {image} | {paper} |").unwrap();
    }
    text
}

/// Counts the rows of a generated table that end in "holds", and all rows with a verdict.
fn holds(path: &str) -> String {
    let text = read(path);
    let verdict = |row: &&str| !row.ends_with("|  |");
    let rows = text.lines().filter(|l| l.starts_with("| ")).skip(2).filter(verdict);
    let rows: Vec<&str> = rows.collect();
    let held = rows.iter().filter(|row| row.ends_with("| holds |")).count();
    format!("{held} of {}", rows.len())
}

/// Rest of the line of a file that begins with `start`.
fn rest_of_line(path: &str, start: &str) -> String {
    let text = read(path);
    let found = text.lines().find_map(|line| line.strip_prefix(start));
    found.unwrap_or_else(|| panic!("{path}: no line begins with `{start}`")).to_owned()
}

/// Tables with a verdict: what holds, and the version that was measured.
fn verdicts() -> String {
    let right = rest_of_line("test/CHECK.md", "Right: ");
    let right = right.split(" (").next().unwrap_or_default();
    let mut text = String::from(
        "\n## Tables with a verdict\n\n\
         | table | what holds | version | written by |\n| --- | --- | --- | --- |\n",
    );
    for (title, page, file, held, command) in [
        ("faults on live processes", "faults", "FAULTS", None, "volant faults --table"),
        ("wrong files that `volant check` names", "check", "CHECK", Some(right), "make checks"),
        ("closed loop", "loop", "LOOP", None, "make loop TABLE=…"),
        ("two computers with a bad link", "hosts", "HOSTS", None, "volant hosts --table"),
    ] {
        let path = format!("test/{file}.md");
        let held = held.map_or_else(|| format!("{} rows", holds(&path)), |h| format!("{h} cells"));
        let version = rest_of_line(&path, "Measured with version ");
        let version = version.trim_end_matches('.');
        writeln!(text, "| [{title}](table-{page}.md) | {held} | {version} | `{command}` |")
            .unwrap();
    }
    text
}

fn figures() -> String {
    let mut text = String::from(
        "# Figures\n\n\
         Written by `make pages` from the files named below; do not edit. Errors are RMSE against \
         the\n\
         ground truth, position as 3-D norm and rotation as angle, without the first second of a \
         run.\n\
         NEES has three degrees of freedom: 3 is the expected value of an exact covariance, less \
         is\n\
         cautious.\n\n\
         ## Recorded runs\n\n",
    );
    writeln!(
        text,
        "`volant replay` and `volant evaluate` on each recording. A test compares\n\
         `{REPLAY}` with a fresh replay; `VOLANT_UPDATE_FIGURES=1` writes it.\n\n\
         | run | model | estimate | messages | position RMSE, mm | largest, mm | rotation RMSE, ° \
         | largest, ° | NEES position | NEES rotation |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    .unwrap();
    for Errors { run, model, estimate, fields } in Errors::all() {
        let fields = fields.join(" | ");
        writeln!(text, "| {run} | {model} | `{estimate}` | {fields} |").unwrap();
    }
    text += &verdicts();
    text.push('\n');
    let robustness = read("test/ROBUSTNESS.md");
    let row = |start: &str| robustness.lines().find(|l| l.starts_with(start)).unwrap_or_default();
    let header = row("| perturbation");
    write!(
        text,
        "## Recordings that differ from their rig file\n\n\
         The unchanged recordings; [the whole table](table-robustness.md) is written by\n\
         `make robustness`.\n\n{header}\n|{}\n{}\n\n",
        " --- |".repeat(header.matches('|').count() - 1),
        row("| none"),
    )
    .unwrap();
    text += &real_imu(&read("test/BROAD.md"));
    writeln!(
        text,
        "## Marker tracker beside other methods\n\n\
         One image with its pose, on synthetic scenes, in one run of `make reproduce`\n\
         (`{PEERS}`, version {PEERS_VERSION}).\n\n\
         | method | median, µs | over the paper's recipe | centroid RMS, px | position RMSE, mm \
         | rotation RMSE, ° | success | gross errors |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    .unwrap();
    for row in csv(PEERS) {
        writeln!(text, "| {} |", row.join(" | ")).unwrap();
    }
    text
}

/// Summary of the table of `make broad`: the range of each of its numbers.
fn real_imu(table: &str) -> String {
    let rows: Vec<Vec<f64>> = table
        .lines()
        .filter(|l| l.starts_with("| ") && l.contains('_'))
        .map(|l| {
            let numbers = l.split(['|', ',']).skip(2).filter_map(|cell| cell.trim().parse().ok());
            numbers.collect()
        })
        .collect();
    let range = |column: usize| {
        let values = || rows.iter().filter_map(|row| row.get(column));
        let (least, most) = values()
            .fold((f64::INFINITY, 0.0_f64), |(least, most), v| (least.min(*v), most.max(*v)));
        format!("{least} to {most}")
    };
    format!(
        "## Real IMU samples\n\n\
         {} recordings of 30 s with the IMU samples and the motion of the public BROAD data set,\n\
         and a virtual camera; [the whole table](table-broad.md) is written by `make broad`.\n\n\
         | position RMSE, mm | rotation RMSE, ° | NEES of position (3) | NEES of rotation (3) |\n\
         | --- | --- | --- | --- |\n| {} | {} | {} | {} |\n\n",
        rows.len(),
        range(0),
        range(2),
        range(4),
        range(5),
    )
}

fn parameters() -> String {
    fn section<S: NodeShell>() -> String {
        let table = markdown_table(&S::Parameters::descriptors());
        format!("## `{}`\n\n{table}\n", S::NAME)
    }
    [
        "# Parameters\n\n\
         Written by `make pages` from the declarations in the code; do not edit. `NODE --help` \
         prints\n\
         the same list, `NODE --print-parameters=yaml` a parameter file with all defaults. An \
         unknown\n\
         parameter is an error. Parameters marked \"live\" can be changed while the node runs\n\
         (`ros2 param set`).\n\n\
         QoS: `qos_overrides.<topic>.<publisher|subscription>.<reliability|durability|depth>` \
         as in\n\
         rclcpp, with the absolute topic; `….publisher.max_samples` bounds what a reliable \
         publisher keeps\n\
         for readers that do not acknowledge.\n\n",
        &section::<MarkerTrackerNode>(),
        &section::<ImuNode>(),
        &section::<ClimberNode>(),
        &section::<FusionNode>(),
        "## Every node, and the rig file\n\n",
        &markdown_table(&common_descriptors()),
    ]
    .concat()
}

/// Groups of a table may come from several crates.
#[test]
fn a_node_declares_each_parameter_once() {
    fn check<S: NodeShell>() {
        let all = [S::Parameters::descriptors(), common_descriptors()].concat();
        let mut names: Vec<&str> = all.iter().map(|descriptor| descriptor.name.as_str()).collect();
        names.sort_unstable();
        for pair in names.windows(2) {
            assert_ne!(pair[0], pair[1], "{}", S::NAME);
        }
    }
    check::<MarkerTrackerNode>();
    check::<ImuNode>();
    check::<ClimberNode>();
    check::<FusionNode>();
}

#[test]
fn the_parameters_page_is_current() {
    check("docs/src/parameters.md", &parameters());
}

#[test]
fn the_figures_page_is_current() {
    check("docs/src/figures.md", &figures());
}

#[test]
fn the_table_in_the_readme_is_current() {
    let readme = read("README.md");
    let (before, rest) = readme.split_once(BEGIN).expect("README.md: the figures begin");
    let (_, after) = rest.split_once(END).expect("README.md: the figures end");
    check("README.md", &[before, BEGIN, &readme_table(), END, after].concat());
}

/// Folders without texts of this project.
const SKIPPED: [&str; 8] =
    ["target", ".git", ".venv", ".setup", "demo_run", "book", "rustdds", "ros2-client"];

fn markdown_files(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(Result::unwrap) {
        let (path, name) = (entry.path(), entry.file_name());
        if path.is_symlink() {
            continue;
        }
        if path.is_dir() && !SKIPPED.iter().any(|skipped| name == *skipped) {
            markdown_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
}

#[test]
fn every_relative_link_leads_to_a_file() {
    let mut files = vec![];
    markdown_files(&root(), &mut files);
    assert!(files.len() > 10, "{files:?}");
    let mut broken = vec![];
    for file in files {
        let text = fs::read_to_string(&file).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            let target = link.split('#').next().unwrap_or_default();
            let elsewhere = target.is_empty() || target.contains("://") || target.contains(' ');
            if !elsewhere && !file.with_file_name("").join(target).exists() {
                broken.push(format!("{}: {link}", file.display()));
            }
        }
    }
    assert!(broken.is_empty(), "{}", broken.join("\n"));
}

/// Functions below a crate's `tests` that are tests, each as `path::name`.
fn tests_below(folder: &Path, found: &mut Vec<String>) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for path in entries.map(|entry| entry.unwrap().path()) {
        if path.is_dir() {
            tests_below(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            let text = fs::read_to_string(&path).unwrap();
            let after = text.split("#[test]").skip(1).filter_map(|t| t.split_once("fn "));
            let names = after.filter_map(|(_, t)| t.split_once('('));
            found.extend(names.map(|(name, _)| format!("{}::{name}", path.display())));
        }
    }
}

/// `cargo test` with a filter that selects nothing succeeds.
#[test]
fn every_command_of_the_verification_page_selects_a_test() {
    let mut all = Vec::new();
    for entry in fs::read_dir(root()).unwrap() {
        tests_below(&entry.unwrap().path().join("tests"), &mut all);
    }
    let page = read("docs/src/verification.md");
    let mut commands = 0;
    for command in page.split('`').skip(1).step_by(2) {
        for selected in command.split("--test ").skip(1) {
            let mut words = selected.split_whitespace().take_while(|word| !word.starts_with('-'));
            let target = words.next().unwrap();
            let filter = words.next().unwrap_or_default();
            let of_target = |test: &&String| {
                let test = test.replace('\\', "/");
                let file = format!("/tests/{target}.rs::");
                test.contains(&file) || test.contains(&format!("/tests/{target}/"))
            };
            let selects =
                |test: &String| test.rsplit("::").next().is_some_and(|t| t.contains(filter));
            assert!(all.iter().filter(of_target).any(selects), "`{command}` selects no test");
            commands += 1;
        }
    }
    assert!(commands > 40, "{commands}");
}
