//! Evaluation of a folder of bags against a folder with their truths.

use super::{EvaluateError, EvaluateOptions, Evaluation, Quality, evaluate, report::figure};
use crate::{replay::TopicNames, report::Table};
use std::{
    fmt::Write,
    path::{Path, PathBuf},
    sync::{
        Mutex,
        atomic::{AtomicUsize, Ordering},
    },
};

/// One run of a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RunFiles {
    /// Name of the bag without extension.
    pub name: String,
    /// Bag with the estimates.
    pub estimates: PathBuf,
    /// Bag with the truth.
    pub truth: PathBuf,
}

fn is_bag(path: &Path) -> bool {
    path.join("metadata.yaml").is_file()
        || (path.is_file() && path.extension().is_some_and(|e| e == "mcap"))
}

fn without_ending(path: &Path) -> String {
    path.file_stem().map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

/// Pairs the bags of `estimates` with those of `truth`: `NAME.mcap` or the rosbag2 folder `NAME`
/// with `NAME.mcap`, with the rosbag2 folder `NAME`, or with `NAME/truth.mcap`. Sorted by name.
///
/// # Errors
/// An unreadable folder, one without bags, or a run without truth.
pub fn pairs(estimates: &Path, truth: &Path) -> Result<Vec<RunFiles>, EvaluateError> {
    let folder =
        |path: &Path, reason: String| EvaluateError::Folder { path: path.to_owned(), reason };
    let entries = std::fs::read_dir(estimates).map_err(|e| folder(estimates, e.to_string()))?;
    let mut bags: Vec<PathBuf> =
        entries.filter_map(|e| e.ok().map(|e| e.path())).filter(|p| is_bag(p)).collect();
    bags.sort();
    if bags.is_empty() {
        return Err(folder(estimates, "it holds no bag (NAME.mcap, or rosbag2 folders)".into()));
    }
    bags.into_iter()
        .map(|bag| {
            let name = if bag.is_dir() {
                bag.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
            } else {
                without_ending(&bag)
            };
            let places = [
                truth.join(format!("{name}.mcap")),
                truth.join(&name),
                truth.join(&name).join("truth.mcap"),
            ];
            match places.into_iter().find(|p| is_bag(p)) {
                Some(truth) => Ok(RunFiles { name, estimates: bag, truth }),
                None => Err(folder(
                    truth,
                    format!(
                        "it holds no truth of the run {name}: neither {name}.mcap, nor a \
                             rosbag2 folder {name}, nor {name}/truth.mcap"
                    ),
                )),
            }
        })
        .collect()
}

/// Result of one run.
pub type RunResult = (String, Result<Evaluation, EvaluateError>);

/// Evaluates all runs on `threads` threads, and calls `done` with the number of finished runs after
/// each; the results are in the order of `runs`.
pub fn evaluate_many(
    runs: &[RunFiles],
    skip: f64,
    names: &TopicNames,
    threads: usize,
    done: impl Fn(usize) + Sync,
) -> Vec<RunResult> {
    let (next, finished) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let results = Mutex::new(Vec::with_capacity(runs.len()));
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, runs.len().max(1)) {
            scope.spawn(|| {
                loop {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    let Some(run) = runs.get(index) else { break };
                    let result = evaluate(&EvaluateOptions {
                        estimates: run.estimates.clone(),
                        truth: run.truth.clone(),
                        skip,
                        names: names.clone(),
                    });
                    if let Ok(mut results) = results.lock() {
                        results.push((index, (run.name.clone(), result)));
                    }
                    done(finished.fetch_add(1, Ordering::Relaxed) + 1);
                }
            });
        }
    });
    let mut results = results.into_inner().unwrap_or_default();
    results.sort_by_key(|(index, _)| *index);
    results.into_iter().map(|(_, r)| r).collect()
}

/// Formats a text table: one row per run and estimate, and the worst of each estimate.
pub fn table_of_many(results: &[RunResult]) -> String {
    rows(results).to_text(2)
}

/// Makes the table of [`table_of_many`].
pub(super) fn rows(results: &[RunResult]) -> Table {
    let head = [
        "run",
        "estimate",
        "mm RMSE",
        "mm max",
        "deg RMSE",
        "deg max",
        "NEES pos",
        "NEES rot",
        "Hz",
        "longest gap ms",
    ];
    let mut table = Table { head: head.map(String::from).to_vec(), rows: vec![] };
    let number = |x: Option<f64>| x.map_or("-".into(), |x| format!("{x:.2}"));
    let mut worst: Vec<(String, [f64; 4])> = Vec::new();
    for (name, result) in results {
        let Ok(evaluation) = result else {
            table.push(vec![name.clone(), "failed".into()]);
            continue;
        };
        for q in &evaluation.estimates {
            let figures =
                [q.position_mm.rmse, q.position_mm.max, q.rotation_deg.rmse, q.rotation_deg.max];
            let mut row = vec![name.clone(), q.estimate.clone()];
            row.extend(figures.map(figure));
            row.extend([
                number(q.nees_position),
                number(q.nees_rotation),
                format!("{:.2}", q.rate_hz),
                format!("{:.1}", q.longest_gap_ms),
            ]);
            table.push(row);
            match worst.iter_mut().find(|w| w.0 == q.estimate) {
                Some((_, w)) => w.iter_mut().zip(figures).for_each(|(w, f)| *w = w.max(f)),
                None => worst.push((q.estimate.clone(), figures)),
            }
        }
    }
    for (estimate, figures) in worst {
        let mut row = vec!["worst".into(), estimate];
        row.extend(figures.map(figure));
        table.push(row);
    }
    table
}

/// Formats CSV: the rows of [`super::csv`] with the run in the first column.
pub fn csv_of_many(results: &[RunResult]) -> String {
    let mut text = String::new();
    for (name, evaluation) in results.iter().filter_map(|(n, r)| Some((n, r.as_ref().ok()?))) {
        let csv = super::csv(evaluation);
        for (i, line) in csv.lines().enumerate() {
            match i {
                0 if text.is_empty() => text = format!("run,{line}\n"),
                0 => {}
                _ => {
                    let _ = writeln!(text, "{name},{line}");
                }
            }
        }
    }
    text
}

/// Iterates over the qualities of all runs that did not fail.
pub(super) fn qualities(results: &[RunResult]) -> Vec<(&str, &Quality)> {
    results
        .iter()
        .filter_map(|(name, r)| Some((name.as_str(), r.as_ref().ok()?)))
        .flat_map(|(name, e)| e.estimates.iter().map(move |q| (name, q)))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_paired_by_name_and_a_missing_truth_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let (out, truth) = (folder.path().join("out"), folder.path().join("truth"));
        for f in [&out, &truth, &truth.join("b")] {
            std::fs::create_dir_all(f).unwrap();
        }
        assert!(pairs(&out, &truth).unwrap_err().to_string().contains("no bag"));
        for f in [
            out.join("a.mcap"),
            out.join("b.mcap"),
            truth.join("a.mcap"),
            truth.join("b/truth.mcap"),
        ] {
            std::fs::write(f, "").unwrap();
        }
        std::fs::write(out.join("notes.txt"), "").unwrap();
        let found = pairs(&out, &truth).unwrap();
        assert_eq!(found.iter().map(|r| r.name.as_str()).collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(found[1].truth, truth.join("b/truth.mcap"));
        // An unreadable run fails, and the others are evaluated.
        let results = evaluate_many(&found, 1.0, &TopicNames::default(), 2, |_| {});
        assert!(results.len() == 2 && results.iter().all(|(_, r)| r.is_err()));
        assert!(table_of_many(&results).contains("a    failed"), "{}", table_of_many(&results));
        std::fs::write(out.join("c.mcap"), "").unwrap();
        assert!(pairs(&out, &truth).unwrap_err().to_string().contains("no truth of the run c"));
    }
}
