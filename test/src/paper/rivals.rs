//! What `volant-peers` measured beside the rivals, drawn: Figs. 2, 7, 11, 12 and Table I.
//!
//! The rivals need all of OpenCV and AprilTag, which nothing that runs on the robot does; so they live in an executable of
//! their own, and this one runs it and draws its tables.

use super::{Made, PaperError, read, write};
use launch_config::report::{
    Anchor, Axis, Colour, Drawing, Ink, Panel, Series, Shape, Sheet, Table, cells, colours, panels,
};
use std::{
    io::{BufRead, BufReader},
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// What the rivals' executable is called.
pub const PEERS: &str = "volant-peers";

/// Where it is: `VOLANT_PEERS`, beside this program, or where a plain `cargo build --release` in `test/peers` leaves it.
pub fn find_peers(executables: &Path) -> Option<PathBuf> {
    let named = std::env::var_os("VOLANT_PEERS").map(PathBuf::from);
    let beside = executables.join(PEERS);
    let in_tree =
        executables.ancestors().nth(2).map(|root| root.join("test/peers/target/release").join(PEERS));
    named.into_iter().chain([beside]).chain(in_tree).find(|p| p.is_file())
}

/// Runs one of its commands; `progress` is given the share that is done.
///
/// # Errors
/// It cannot be run, or it failed: its own last words.
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
    if status.success() { Ok(()) } else { Err(format!("{shown} {command} ended with {status}: {last}")) }
}

/// A CSV whose columns are asked for by name.
struct Csv {
    path: PathBuf,
    head: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Csv {
    fn read(path: PathBuf) -> Result<Self, PaperError> {
        let text = read(&path)?;
        let mut lines = text.lines().map(cells);
        let head = lines.next().unwrap_or_default();
        let csv = Self { path, rows: lines.collect(), head };
        if csv.rows.is_empty() || csv.rows.iter().any(|r| r.len() != csv.head.len()) {
            return Err(csv.wrong("it has no rows, or rows of another length than its head"));
        }
        Ok(csv)
    }

    fn wrong(&self, what: &str) -> PaperError {
        PaperError::Table { path: self.path.clone(), what: what.to_owned() }
    }

    fn column(&self, name: &str) -> Result<usize, PaperError> {
        self.head.iter().position(|h| h == name).ok_or_else(|| self.wrong(&format!("no column {name}")))
    }

    /// A column as numbers; NaN where a cell is empty.
    fn numbers(&self, name: &str) -> Result<Vec<f64>, PaperError> {
        let i = self.column(name)?;
        Ok(self.rows.iter().map(|r| r[i].parse().unwrap_or(f64::NAN)).collect())
    }

    fn texts(&self, name: &str) -> Result<Vec<String>, PaperError> {
        let i = self.column(name)?;
        Ok(self.rows.iter().map(|r| r[i].clone()).collect())
    }
}

/// Each name once, in the order of its first appearance.
fn distinct(names: &[String]) -> Vec<String> {
    let mut list: Vec<String> = Vec::new();
    for n in names {
        if !list.contains(n) {
            list.push(n.clone());
        }
    }
    list
}

/// What a method is called in charts, and its colour.
fn look(method: &str) -> (String, Colour) {
    let colour = match method {
        m if m.starts_with("volant") || m.contains("default") => colours::FUSED,
        m if m.contains("recipe") => colours::PAPER,
        m if m.contains("ArUco") => colours::INERTIAL,
        m if m.contains("decimate 1") => colours::VIOLET,
        m if m.contains("decimate 2") => colours::BROWN,
        m if m.contains("48") => colours::INK,
        m if m.contains("corners") => colours::CAMERA,
        _ => colours::GREY,
    };
    let name = match method {
        m if m.starts_with("volant") => "four markers, default",
        m if m.starts_with("the paper's recipe") => "four markers, the paper's recipe",
        m => m,
    };
    (name.to_owned(), colour)
}

/// A table with other column names, its methods as in the charts.
fn named(mut table: Table, head: &[&str]) -> Table {
    table.head = head.iter().map(|h| (*h).to_owned()).collect();
    for row in &mut table.rows {
        if let Some((name, _)) = row.first_mut() {
            *name = look(name).0;
        }
    }
    table
}

fn axis(name: &str, range: [f64; 2], log: bool) -> Axis {
    Axis { name: name.into(), range, log }
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

/// Figs. 2 and 7: `which` is the one.
///
/// # Errors
/// A table that is not there or not as it should be.
pub fn boards(which: &'static str, folder: &Path) -> Result<Made, PaperError> {
    let csv = Csv::read(folder.join(format!("{which}.csv")))?;
    let (angle, methods) = (csv.numbers("angle_deg")?, csv.texts("method")?);
    let (mm, mm_std) = (csv.numbers("mean_mm")?, csv.numbers("std_mm")?);
    let (deg, deg_std) = (csv.numbers("mean_deg")?, csv.numbers("std_deg")?);
    let (pictures, found) = (csv.numbers("pictures")?, csv.numbers("found")?);
    let names = distinct(&methods);
    let series = |values: &[f64], spread: &[f64]| -> Vec<Series> {
        names
            .iter()
            .enumerate()
            .map(|(k, name)| {
                let (shown, colour) = look(name);
                let of = || methods.iter().enumerate().filter(|(_, m)| *m == name).map(|(i, _)| i);
                // Side by side, so that no whisker hides another.
                let aside = 0.45 * (k as f64 - 0.5 * (names.len() as f64 - 1.0));
                Series {
                    name: shown,
                    colour,
                    shape: Shape::Whiskers(2),
                    points: of().map(|i| (angle[i] + aside, values[i])).collect(),
                    spread: of().map(|i| spread[i]).collect(),
                }
            })
            .collect()
    };
    let top = |values: &[f64], spread: &[f64]| {
        rounded_up(
            values.iter().zip(spread).map(|(v, s)| v + s).filter(|v| v.is_finite()).fold(0.0, f64::max),
        )
    };
    let x = || axis("viewing angle [deg]", [-2.0, 62.0], false);
    let title = if which == "fig-2" {
        "Fig. 2: pose from all corners of a chessboard and from four"
    } else {
        "Fig. 7: pose from a chessboard and from four markers"
    };
    let drawn = panels(
        Sheet { title, size: (1120, 520), grid: (1, 2) },
        &[
            Panel {
                title: "translation, mean and deviation".into(),
                x: x(),
                y: axis("error [mm]", [0.0, top(&mm, &mm_std)], false),
                series: series(&mm, &mm_std),
            },
            Panel {
                title: "rotation, mean and deviation".into(),
                x: x(),
                y: axis("error [deg]", [0.0, top(&deg, &deg_std)], false),
                series: series(&deg, &deg_std),
            },
        ],
    )?;
    let svg = folder.join(format!("{which}.svg"));
    write(&svg, &drawn)?;
    // Over all angles, each weighted by the poses it has.
    let mut table = Table {
        head: ["from", "found", "mean [mm]", "mean [deg]"].map(String::from).to_vec(),
        rows: Vec::new(),
    };
    let mut means = Vec::new();
    for name in &names {
        let (mut sums, mut count, mut all) = ([0.0; 2], 0.0, 0.0);
        for i in (0..methods.len()).filter(|i| methods[*i] == *name) {
            all += pictures[i];
            if mm[i].is_finite() {
                count += found[i];
                sums[0] += mm[i] * found[i];
                sums[1] += deg[i] * found[i];
            }
        }
        means.push(sums.map(|s| s / count));
        let cell = |t: String| (t, false);
        table.rows.push(vec![
            cell(look(name).0),
            cell(format!("{:.0} %", 100.0 * count / all)),
            cell(format!("{:.3}", sums[0] / count)),
            cell(format!("{:.4}", sums[1] / count)),
        ]);
    }
    let ratio = |a: usize, b: usize| match (means.get(a), means.get(b)) {
        (Some(a), Some(b)) => [a[0] / b[0], a[1] / b[1]],
        _ => [f64::NAN; 2],
    };
    let (shows, published) = if which == "fig-2" {
        let r = ratio(1, 0);
        (
            format!(
                "A chessboard of 8×6 inner corners on the markers' footprint, 1 m below the camera, seen at angles from 0 to 60°. \
                 Four corners give {:.1} times the translation error and {:.1} times the rotation error of all 48.",
                r[0], r[1]
            ),
            "Published: four corners are nearly as good as all. With sub-pixel corners and independent noise they cannot be: 48 \
             points average it, four do not. But the error stays far within the 5 mm and 1° that \
             count as a success here, which makes four points, and so four markers, enough. Which way round a chessboard lies it does not tell itself (it looks the same \
             after half a turn); here the truth says it, on the platform the four colours do."
                .to_owned(),
        )
    } else {
        let (r, plain) = (ratio(3, 0), ratio(2, 0));
        (
            format!(
                "The same boards beside four coloured squares on the same footprint. By the paper's recipe (binary images, centres of \
                 mass, OpenCV's extrinsics) the markers have {:.1} times the translation error of 48 corners; by the default tracker \
                 {:.2} times ({:.2} times in rotation).",
                plain[0], r[0], r[1]
            ),
            "Published: the markers replace the board without loss. A recipe that takes centres of mass as images of the centres is \
             off by what perspective does to a tilted square, up to a pixel; predicting the centroid of the projected square takes \
             that away, and fitting its edges uses more pixels than 48 corners have. Failures beyond 50 mm or 5° are not \
             averaged; the table counts them as not found."
                .to_owned(),
        )
    };
    Ok(Made { name: which, title, csv: csv.path, svg, table: Some(table), shows, published })
}

/// Fig. 11.
///
/// # Errors
/// A table that is not there or not as it should be.
pub fn figure_11(folder: &Path) -> Result<Made, PaperError> {
    let csv = Csv::read(folder.join("fig-11.csv"))?;
    let (sweep, value) = (csv.texts("sweep")?, csv.numbers("value")?);
    let (methods, success) = (csv.texts("method")?, csv.numbers("success")?);
    let names = distinct(&methods);
    let panel = |which: &str, title: &str, name: &str, range: [f64; 2]| Panel {
        title: title.into(),
        x: axis(name, range, false),
        y: axis("success [%]", [-4.0, 104.0], false),
        series: names
            .iter()
            .enumerate()
            .map(|(k, m)| {
                let (shown, colour) = look(m);
                // Most are at 100 %: a little apart, so that none hides another.
                let apart = 1.3 * (0.5 * (names.len() as f64 - 1.0) - k as f64);
                let points = (0..methods.len())
                    .filter(|i| methods[*i] == *m && sweep[*i] == which)
                    .map(|i| (value[i], 100.0 * success[i] + apart))
                    .collect();
                Series { name: shown, colour, shape: Shape::Dotted, points, spread: Vec::new() }
            })
            .collect(),
    };
    let title = "Fig. 11: success, a pose within 5 mm and 1°";
    let drawn = panels(
        Sheet { title, size: (1120, 540), grid: (1, 2) },
        &[
            panel("angle_deg", "over the viewing angle, at 1.25 m", "viewing angle [deg]", [-2.0, 62.0]),
            panel("distance_m", "over the distance, at 20°", "distance [m]", [0.4, 3.1]),
        ],
    )?;
    let svg = folder.join("fig-11.svg");
    write(&svg, &drawn)?;
    let mut table = Table {
        head: ["method", "over the angle", "over the distance", "all"].map(String::from).to_vec(),
        rows: Vec::new(),
    };
    let mean = |m: &str, which: Option<&str>| {
        let values: Vec<f64> = (0..methods.len())
            .filter(|i| methods[*i] == m && which.is_none_or(|w| sweep[*i] == w))
            .map(|i| success[i])
            .collect();
        100.0 * values.iter().sum::<f64>() / values.len() as f64
    };
    let mut all: Vec<(f64, String)> = names.iter().map(|m| (mean(m, None), look(m).0)).collect();
    for m in &names {
        let cell = |w: Option<&str>| (format!("{:.1} %", mean(m, w)), false);
        table.rows.push(vec![
            (look(m).0, false),
            cell(Some("angle_deg")),
            cell(Some("distance_m")),
            cell(None),
        ]);
    }
    let mut beaten: Vec<String> = Vec::new();
    for i in (0..methods.len()).filter(|i| methods[*i] == names[0]) {
        let best = (0..methods.len())
            .filter(|j| sweep[*j] == sweep[i] && value[*j] == value[i] && success[*j] > success[i])
            .max_by(|a, b| success[*a].total_cmp(&success[*b]));
        if let Some(j) = best {
            let unit = if sweep[i] == "angle_deg" { "°" } else { " m" };
            beaten.push(format!(
                "at {}{unit} {} ({:.0} against {:.0} %)",
                value[i],
                look(&methods[j]).0,
                100.0 * success[j],
                100.0 * success[i]
            ));
        }
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let last =
        value.iter().zip(&sweep).filter(|(_, s)| *s == "distance_m").map(|(v, _)| *v).fold(0.0, f64::max);
    let furthest = (0..methods.len())
        .filter(|i| sweep[*i] == "distance_m" && value[*i] == last)
        .min_by(|a, b| success[*a].total_cmp(&success[*b]))
        .map_or((last, String::new()), |i| {
            (last, format!("{} with {:.0} %", look(&methods[i]).0, 100.0 * success[i]))
        });
    let lost = if beaten.is_empty() {
        "No rival is above the default tracker in any condition.".to_owned()
    } else {
        format!("Rivals are above the default tracker {}.", beaten.join(", "))
    };
    Ok(Made {
        name: "fig-11",
        title,
        csv: csv.path,
        svg,
        table: Some(table),
        shows: format!(
            "Share of pictures with a pose within 5 mm and 1° of the truth, for methods on one footprint (0.376 m), under the same \
             light and noise, on poses of a bench with steps of 0.01° and 0.1 mm (curves of one value are drawn a little apart). Best over all conditions: {} ({:.1} %). {lost}",
            all[0].1, all[0].0
        ),
        published: format!(
            "Published: the markers beat ARToolKit (template) and SIFT with RANSAC over angle and distance. ArUco and AprilTag stand in \
             for ARToolKit, which they replaced. What counts as a success the paper does not say; 5 mm and 1° is this program's \
             choice. Far away the depth of so \
             small a footprint rests on a tenth of a pixel: at {} m the lowest is {}.",
            furthest.0, furthest.1
        ),
    })
}

/// Fig. 12.
///
/// # Errors
/// A table that is not there or not as it should be.
pub fn figure_12(folder: &Path) -> Result<Made, PaperError> {
    let csv = Csv::read(folder.join("fig-12.csv"))?;
    let methods = csv.texts("method")?;
    let columns = ["mean_mm", "std_mm", "mean_deg", "std_deg"];
    let values = columns.map(|c| csv.numbers(c));
    let [mm, mm_std, deg, deg_std] = values;
    let (mm, mm_std, deg, deg_std) = (mm?, mm_std?, deg?, deg_std?);
    let title = "Fig. 12: mean error and standard deviation";
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colours::INK, Anchor::Start, title);
    let (names_end, wide, row) = (268.0, 350.0, 46.0);
    let base = 104.0 + row * methods.len() as f64;
    for (half, (means, spreads, unit)) in
        [(&mm, &mm_std, "mm"), (&deg, &deg_std, "deg")].into_iter().enumerate()
    {
        let x0 = names_end + 16.0 + (wide + 66.0) * half as f64;
        let most =
            means.iter().zip(spreads).map(|(m, s)| m + s).filter(|v| v.is_finite()).fold(0.0, f64::max);
        let top = rounded_up(most);
        let x = |v: f64| x0 + wide * (v / top).clamp(0.0, 1.0);
        let what = if half == 0 { "translation" } else { "rotation" };
        d.text(
            x0,
            78.0,
            15.0,
            colours::INK,
            Anchor::Start,
            &format!("{what} [{unit}]: bar mean, whisker ± deviation"),
        );
        for k in 0..=4 {
            let v = top * f64::from(k) / 4.0;
            d.line([x(v), 92.0], [x(v), base], Ink(if k == 0 { colours::AXIS } else { colours::GRID }, 1.0));
            let digits = if top < 1.0 {
                3
            } else if top < 10.0 {
                2
            } else {
                1
            };
            d.text(x(v), base + 20.0, 13.0, colours::SOFT, Anchor::Middle, &format!("{v:.digits$}"));
        }
        for (i, name) in methods.iter().enumerate() {
            let (shown, colour) = look(name);
            let y = 102.0 + row * i as f64;
            if half == 0 {
                d.text(names_end, y + 19.0, 15.0, colours::INK, Anchor::End, &shown);
            }
            if !means[i].is_finite() {
                d.text(x0 + 6.0, y + 19.0, 13.0, colours::SOFT, Anchor::Start, "no pose");
                continue;
            }
            d.bar(x0, y, x(means[i]) - x0, 26.0, colour);
            let (low, high) = (x(means[i] - spreads[i]), x(means[i] + spreads[i]));
            d.line([low, y + 13.0], [high, y + 13.0], Ink(colours::INK, 1.5));
            for end in [low, high] {
                d.line([end, y + 8.0], [end, y + 18.0], Ink(colours::INK, 1.5));
            }
            let digits = if half == 0 { 2 } else { 3 };
            // Beside the whisker, or before it where there is no room.
            let (at, anchor) = if high + 50.0 > x0 + wide + 40.0 {
                (low - 8.0, Anchor::End)
            } else {
                (high + 7.0, Anchor::Start)
            };
            let label = format!("{:.digits$}", means[i]);
            if anchor == Anchor::Start {
                d.text(at, y + 18.0, 13.0, colours::SOFT, anchor, &label);
            }
        }
    }
    let svg = folder.join("fig-12.svg");
    write(&svg, &d.finish(base + 40.0, title))?;
    let best = |values: &[f64]| {
        (0..values.len())
            .filter(|i| values[*i].is_finite())
            .min_by(|a, b| values[*a].total_cmp(&values[*b]))
            .map_or_else(String::new, |i| look(&methods[i]).0)
    };
    let winners = [best(&mm), best(&mm_std), best(&deg), best(&deg_std)];
    let smallest = if winners.iter().all(|w| *w == winners[0]) {
        format!("Mean and deviation of both are smallest for {}.", winners[0])
    } else {
        format!(
            "Smallest mean and deviation: {} and {} (translation), {} and {} (rotation).",
            winners[0], winners[1], winners[2], winners[3]
        )
    };
    let better_than_recipe = |values: &[f64]| -> String {
        let Some(recipe) = methods.iter().position(|m| m.contains("recipe")) else {
            return "the recipe was not measured".into();
        };
        let rivals: Vec<String> = (0..methods.len())
            .filter(|i| values[*i] < values[recipe] && !methods[*i].starts_with("volant"))
            .map(|i| look(&methods[i]).0)
            .collect();
        if rivals.is_empty() {
            "no rival's mean is lower here".to_owned()
        } else {
            format!("the mean of {} is lower here", rivals.join(" and of "))
        }
    };
    let ours = methods
        .iter()
        .position(|m| m.starts_with("volant"))
        .ok_or_else(|| csv.wrong("no row of this program"))?;
    let aruco =
        methods.iter().position(|m| m.contains("ArUco")).ok_or_else(|| csv.wrong("no row of ArUco"))?;
    let below = mm[ours] < mm[aruco]
        && mm_std[ours] < mm_std[aruco]
        && deg[ours] < deg[aruco]
        && deg_std[ours] < deg_std[aruco];
    let gross = Csv::read(folder.join("bench.csv")).and_then(|bench| {
        let (names, counts) = (bench.texts("method")?, bench.numbers("gross_errors")?);
        let list: Vec<String> = names
            .iter()
            .zip(counts)
            .filter(|(_, n)| *n > 0.0)
            .map(|(m, n)| format!("{} in {n:.0} pictures", look(m).0))
            .collect();
        Ok(if list.is_empty() { "none".to_owned() } else { list.join(", ") })
    })?;
    Ok(Made {
        name: "fig-12",
        title,
        table: Some(named(
            Table::from_csv(&read(&csv.path)?, 3, false),
            &["method", "mean [mm]", "deviation [mm]", "mean [deg]", "deviation [deg]"],
        )),
        csv: csv.path,
        svg,
        shows: format!(
            "Errors over the bench's motion (1 to 2 m, up to 28°), all methods on the same poses. {smallest} The markers by the \
             default tracker are {} ArUco in all four figures: {:.2} against {:.2} mm, {:.3} against {:.3}°. Failures beyond 50 mm or \
             5° are counted, not averaged: {gross}.",
            if below { "below" } else { "not below" },
            mm[ours],
            mm[aruco],
            deg[ours],
            deg[aruco]
        ),
        published: format!(
            "Published: the markers have the lowest mean and deviation of the three methods. By the paper's recipe, written plainly, \
             {} in translation and {} in rotation: rivals have become better since 2010, and the centre of mass of a binary image is \
             off by what perspective and the pixel grid do to it. The default tracker has neither error.",
            better_than_recipe(&mm),
            better_than_recipe(&deg)
        ),
    })
}

/// Table I.
///
/// # Errors
/// A table that is not there or not as it should be.
pub fn table_1(folder: &Path) -> Result<Made, PaperError> {
    let csv = Csv::read(folder.join("table-1.csv"))?;
    let stages = csv.texts("stage")?;
    let columns = ["published_ms", "plain_opencv_ms", "ours_ms"];
    let values = columns.map(|c| csv.numbers(c));
    let [published, plain, ours] = values;
    let values = [published?, plain?, ours?];
    let total = stages.iter().position(|s| s == "total").ok_or_else(|| csv.wrong("no row `total`"))?;
    let title = "Table I: time of one pose, by stage";
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colours::INK, Anchor::Start, title);
    let parts: Vec<(usize, Colour)> = [
        ("optical flow", colours::CAMERA),
        ("tracking", colours::INERTIAL),
        ("feature extraction", colours::PAPER),
        ("extrinsics", colours::VIOLET),
    ]
    .into_iter()
    .filter_map(|(name, colour)| Some((stages.iter().position(|s| s == name)?, colour)))
    .collect();
    let mut x = 28.0;
    for (i, colour) in &parts {
        d.bar(x, 50.0, 20.0, 14.0, *colour);
        d.text(x + 28.0, 63.0, 15.0, colours::INK, Anchor::Start, &stages[*i]);
        x += 60.0 + 8.2 * stages[*i].len() as f64;
    }
    let (x0, wide) = (240.0, 770.0);
    let top = rounded_up(values.iter().map(|v| v[total]).filter(|v| v.is_finite()).fold(0.0, f64::max));
    let scale = wide / top;
    let base = 264.0;
    for k in 0..=5 {
        let v = top * f64::from(k) / 5.0;
        let x = x0 + scale * v;
        d.line([x, 86.0], [x, base], Ink(if k == 0 { colours::AXIS } else { colours::GRID }, 1.0));
        d.text(x, base + 20.0, 13.0, colours::SOFT, Anchor::Middle, &format!("{v:.1}"));
    }
    d.text(x0 + wide / 2.0, base + 42.0, 14.0, colours::INK, Anchor::Middle, "time of one picture [ms]");
    let rows = ["published, 2010", "the recipe in plain OpenCV", "default tracker"];
    for (k, (name, times)) in rows.iter().zip(&values).enumerate() {
        let y = 98.0 + 56.0 * k as f64;
        d.text(x0 - 14.0, y + 23.0, 15.0, colours::INK, Anchor::End, name);
        let mut at = x0;
        for (i, colour) in &parts {
            if times[*i].is_finite() {
                d.bar(at, y, scale * times[*i], 34.0, *colour);
                at += scale * times[*i];
            }
        }
        if times[total].is_finite() {
            let end = at.max(x0 + scale * times[total]);
            d.text(
                end + 10.0,
                y + 23.0,
                14.0,
                colours::INK,
                Anchor::Start,
                &format!("{:.3} ms", times[total]),
            );
        }
    }
    let svg = folder.join("table-1.svg");
    write(&svg, &d.finish(base + 58.0, title))?;
    let saves = parts.iter().any(|(i, _)| values[2][*i] == 0.0);
    let [published, plain, ours] = values.map(|v| v[total]);
    Ok(Made {
        name: "table-1",
        title,
        table: Some(named(
            Table::from_csv(&read(&csv.path)?, 3, false),
            &["stage", "published [ms]", "recipe in plain OpenCV [ms]", "default tracker [ms]"],
        )),
        csv: csv.path,
        svg,
        shows: format!(
            "Median time of one core for a tracked picture of 640×480, on the bench's motion. The default tracker with all its \
             criteria and the pose takes {ours:.3} ms, the paper's recipe written plainly with OpenCV {plain:.2} ms in the same run: \
             {:.0} times as long. At {ours:.3} ms a core could follow {:.0} pictures a second.",
            plain / ours,
            1e3 / ours
        ),
        published: format!(
            "Published: 1.5, 2.1, 3.31 and 0.36 ms, together {published:.2} ms = {:.2} Hz, on a computer of 2010. The tracker does not \
             work in the paper's stages one after the other: what its criteria take is the difference of its time with and without each \
             (flow, then hue{}); what is left is finding and measuring the squares. It looks at four windows instead of the frame, and \
             at their edges instead of all pixels.",
            1e3 / published,
            if saves { "; a 0 says that a criterion saves as much time as it takes" } else { "" }
        ),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("volant-rivals-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_rival_that_is_better_is_named() {
        let folder = folder("better");
        std::fs::write(
            folder.join("fig-11.csv"),
            "sweep,value,method,success,mean_mm\nangle_deg,0,volant: all,0.5,1\nangle_deg,0,ArUco 36h11,0.75,1\n\
             distance_m,1,volant: all,1,1\ndistance_m,1,ArUco 36h11,0.5,1\n",
        )
        .unwrap();
        let made = figure_11(&folder).unwrap();
        assert!(made.shows.contains("at 0° ArUco 36h11 (75 against 50 %)"), "{}", made.shows);
        std::fs::write(
            folder.join("fig-12.csv"),
            "method,mean_mm,std_mm,mean_deg,std_deg\n\"volant: all, and pose\",0.3,0.1,0.02,0.01\nArUco 36h11,0.2,0.2,0.1,0.1\n",
        )
        .unwrap();
        std::fs::write(folder.join("bench.csv"), "method,gross_errors\nArUco 36h11,3\n").unwrap();
        let made = figure_12(&folder).unwrap();
        assert!(
            made.shows.contains("deviation: ArUco 36h11 and four markers, default (translation)"),
            "{}",
            made.shows
        );
        assert!(made.shows.contains("not below ArUco") && made.shows.contains("ArUco 36h11 in 3 pictures"));
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_table_of_another_version_is_refused_by_name() {
        let folder = folder("other");
        std::fs::write(folder.join("table-1.csv"), "stage,ours_ms\ntotal,1\n").unwrap();
        let error = table_1(&folder).unwrap_err().to_string();
        assert!(error.contains("table-1.csv") && error.contains("published_ms"), "{error}");
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn axes_end_at_round_numbers() {
        for (v, top) in [(0.13, 0.16), (1.0, 1.0), (2.1, 2.4), (7.27, 8.0), (0.0007, 0.0008)] {
            assert!((rounded_up(v) - top).abs() < 1e-12, "{v}: {}", rounded_up(v));
        }
    }

    #[test]
    fn a_program_that_fails_says_why() {
        let error =
            run(Path::new("/nowhere/volant-peers"), "bench", Path::new("/tmp"), 1, |_| {}).unwrap_err();
        assert!(error.contains("/nowhere/volant-peers"), "{error}");
        let error = run(Path::new("/bin/false"), "bench", Path::new("/tmp"), 1, |_| {}).unwrap_err();
        assert!(error.contains("exit status: 1"), "{error}");
    }
}
