//! Measurements of `volant-peers` as charts: Figs. 2, 7, 11, 12 and Table I.
//!
//! The peers need all of OpenCV and AprilTag, which nothing that runs on the robot does; so they
//! live in an executable of their own, and this one runs it and draws its tables.

mod boards;
mod errors;
mod success;
mod times;

pub use boards::boards;
pub use errors::figure_12;
pub use success::figure_11;
pub use times::table_1;

use anyhow::{Context, Error, Result, anyhow};
use std::{
    collections::BTreeSet,
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};
use volant::report::{Color, Table, cells, colors};

/// What the peers' executable is called.
pub const PEERS: &str = "volant-peers";

/// Where it is: `VOLANT_PEERS`, or beside this program.
pub fn find_peers(executables: &Path) -> Option<PathBuf> {
    let named = std::env::var_os("VOLANT_PEERS").map(PathBuf::from);
    let beside = executables.join(PEERS);
    named.into_iter().chain([beside]).find(|p| p.is_file())
}

/// Runs one of its commands; `progress` is given the share that is done. The error is its last line
/// on standard error.
pub fn run(
    program: &Path,
    command: &str,
    out: &Path,
    seed: u64,
    progress: impl Fn(f64),
) -> Result<(), String> {
    let shown = program.display();
    let mut child = Command::new(program)
        .arg(command)
        .arg("--progress")
        .arg("--out")
        .arg(out)
        .args(["--seed", &seed.to_string()])
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .map_err(|e| format!("{shown}: {e}"))?;
    let mut last = String::new();
    if let Some(words) = child.stderr.take() {
        for line in BufReader::new(words).lines().map_while(Result::ok) {
            match line.strip_prefix("progress ").and_then(|s| s.parse().ok()) {
                Some(share) => progress(share),
                None => last = line,
            }
        }
    }
    let status = child.wait().map_err(|e| format!("{shown}: {e}"))?;
    if status.success() {
        Ok(())
    } else {
        Err(format!("{shown} {command} ended with {status}: {last}"))
    }
}

/// A CSV whose columns are asked for by name.
struct Csv {
    path: PathBuf,
    text: String,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Csv {
    fn read(path: PathBuf) -> Result<Self> {
        let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        let mut lines = text.lines().map(cells);
        let head = lines.next().unwrap_or_default();
        let csv = Self { rows: lines.collect(), path, text, head };
        if csv.rows.is_empty() || csv.rows.iter().any(|r| r.len() != csv.head.len()) {
            return Err(csv.wrong("it has no rows, or rows of another length than its head"));
        }
        Ok(csv)
    }

    fn wrong(&self, what: &str) -> Error {
        anyhow!(
            "{}: {what}; rebuild volant-peers with `make reproduce`, so that the versions match",
            self.path.display()
        )
    }

    fn column(&self, name: &str) -> Result<usize> {
        self.head
            .iter()
            .position(|h| h == name)
            .ok_or_else(|| self.wrong(&format!("no column {name}")))
    }

    /// A column as numbers; NaN where a cell is empty.
    fn numbers(&self, name: &str) -> Result<Vec<f64>> {
        let i = self.column(name)?;
        Ok(self.rows.iter().map(|r| r[i].parse().unwrap_or(f64::NAN)).collect())
    }

    fn texts(&self, name: &str) -> Result<Vec<String>> {
        let i = self.column(name)?;
        Ok(self.rows.iter().map(|r| r[i].clone()).collect())
    }
}

/// Each name once, in the order of its first appearance.
fn distinct(names: &[String]) -> Vec<String> {
    let mut seen = BTreeSet::new();
    names.iter().filter(|name| seen.insert(*name)).cloned().collect()
}

/// Name and color of a method in charts.
fn label(method: &str) -> (String, Color) {
    let color = match method {
        m if m.starts_with("volant") || m.contains("default") => colors::FUSED,
        m if m.contains("recipe") => colors::PAPER,
        m if m.contains("ArUco") => colors::INERTIAL,
        m if m.contains("decimate 1") => colors::VIOLET,
        m if m.contains("decimate 2") => colors::BROWN,
        m if m.contains("48") => colors::INK,
        m if m.contains("corners") => colors::CAMERA,
        _ => colors::GREY,
    };
    let name = match method {
        m if m.starts_with("volant") => "four markers, default",
        m if m.starts_with("the paper's recipe") => "four markers, the paper's recipe",
        m => m,
    };
    (name.to_owned(), color)
}

/// A table with other column names, its methods as in the charts.
fn named(mut table: Table, head: &[&str]) -> Table {
    table.head = head.iter().map(|h| (*h).to_owned()).collect();
    for row in &mut table.rows {
        if let Some((name, _)) = row.first_mut() {
            *name = label(name).0;
        }
    }
    table
}

/// The next round number.
fn rounded_up(v: f64) -> f64 {
    let decade = 10f64.powf(v.max(1e-6).log10().floor());
    [1.0, 1.2, 1.6, 2.0, 2.4, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0]
        .map(|k| k * decade)
        .into_iter()
        .find(|x| *x >= v)
        .unwrap_or(10.0 * decade)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_better_peer_is_named() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(
            folder.path().join("fig-11.csv"),
            "sweep,value,method,success,mean_mm\nangle_deg,0,volant: all,0.5,1\nangle_deg,0,ArUco \
             36h11,0.75,1\n\
             distance_m,1,volant: all,1,1\ndistance_m,1,ArUco 36h11,0.5,1\n",
        )
        .unwrap();
        let made = figure_11(folder.path()).unwrap();
        assert!(made.shows.contains("at 0° ArUco 36h11 (75 against 50 %)"), "{}", made.shows);
        std::fs::write(
            folder.path().join("fig-12.csv"),
            "method,mean_mm,std_mm,mean_deg,std_deg\n\"volant: all, and \
             pose\",0.3,0.1,0.02,0.01\nArUco 36h11,0.2,0.2,0.1,0.1\n",
        )
        .unwrap();
        std::fs::write(folder.path().join("bench.csv"), "method,gross_errors\nArUco 36h11,3\n")
            .unwrap();
        let made = figure_12(folder.path()).unwrap();
        assert!(
            made.shows.contains("deviation: ArUco 36h11 and four markers, default (translation)"),
            "{}",
            made.shows
        );
        assert!(
            made.shows.contains("not below ArUco")
                && made.shows.contains("ArUco 36h11 in 3 images")
        );
    }

    #[test]
    fn stages_that_share_a_time_refer_to_its_row() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(
            folder.path().join("table-1.csv"),
            "stage,published_ms,plain_opencv_ms,ours_ms\noptical flow,1.5,2,\nflow, tracking and \
             extraction,6.91,3,0.04\nextrinsics,0.36,0.1,0.002\ntotal,7.27,3.1,0.042\n"
                .replace("flow, tracking and extraction", "\"flow, tracking and extraction\""),
        )
        .unwrap();
        let rows = table_1(folder.path()).unwrap().table.unwrap().rows;
        assert_eq!(rows[0][3].0, "in one pass, below");
        assert_eq!(rows[1][0].0, "flow, tracking and extraction");
        assert!(rows.iter().flatten().all(|cell| !cell.0.is_empty()));
    }

    #[test]
    fn a_table_of_another_version_is_rejected_by_name() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("table-1.csv"), "stage,ours_ms\ntotal,1\n").unwrap();
        let error = table_1(folder.path()).unwrap_err().to_string();
        assert!(error.contains("table-1.csv") && error.contains("published_ms"), "{error}");
    }

    #[test]
    fn axes_end_at_round_numbers() {
        for (v, top) in [(0.13, 0.16), (1.0, 1.0), (2.1, 2.4), (7.27, 8.0), (0.0007, 0.0008)] {
            assert!((rounded_up(v) - top).abs() < 1e-12, "{v}: {}", rounded_up(v));
        }
    }

    #[test]
    fn a_failed_program_reports_the_reason() {
        let error = run(Path::new("/nowhere/volant-peers"), "bench", Path::new("/tmp"), 1, |_| {})
            .unwrap_err();
        assert!(error.contains("/nowhere/volant-peers"), "{error}");
        let error =
            run(Path::new("/bin/false"), "bench", Path::new("/tmp"), 1, |_| {}).unwrap_err();
        assert!(error.contains("exit status: 1"), "{error}");
    }
}
