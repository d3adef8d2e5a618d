//! Formats an evaluation as a table and as CSV.

use super::{Evaluation, Quality, Spread};
use crate::report::Table;
use std::fmt::Write;

/// Formats a text table with one column per estimate.
pub fn table(evaluation: &Evaluation) -> String {
    rows(&evaluation.estimates).to_text()
}

/// Formats a figure to three decimals; `-` where nothing was compared.
fn figure(value: f64) -> String {
    if value.is_nan() { "-".to_owned() } else { format!("{value:.3}") }
}

/// Makes a table with one column per estimate.
pub(super) fn rows(q: &[Quality]) -> Table {
    let spread = |s: Spread| format!("{} / {}", figure(s.rmse), figure(s.max));
    let number = |x: Option<f64>| x.map_or("-".into(), |x| format!("{x:.2}"));
    let optional = |s: Option<Spread>| s.map_or("-".into(), spread);
    let cells = |name: &str, cell: &dyn Fn(&Quality) -> String| {
        std::iter::once(name.to_owned()).chain(q.iter().map(cell)).collect()
    };
    let mut table = Table { head: cells("", &|q| q.estimate.clone()), rows: vec![] };
    let mut row = |name: &str, cell: &dyn Fn(&Quality) -> String| table.push(cells(name, cell));
    row("RMSE / max", &|_| String::new());
    row("position (mm)", &|q| spread(q.position_mm));
    row("rotation (deg)", &|q| spread(q.rotation_deg));
    for (i, name) in ["x (mm)", "y (mm)", "z (mm)"].into_iter().enumerate() {
        row(name, &|q| spread(q.axes_mm[i]));
    }
    for (i, name) in ["roll (deg)", "pitch (deg)", "yaw (deg)"].into_iter().enumerate() {
        row(name, &|q| spread(q.angles_deg[i]));
    }
    if q.iter().any(|q| q.velocity_mm_s.is_some()) {
        row("velocity (mm/s)", &|q| optional(q.velocity_mm_s));
        row("turn rate (deg/s)", &|q| optional(q.turn_deg_s));
    }
    row("NEES position (3)", &|q| number(q.nees_position));
    row("NEES rotation (3)", &|q| number(q.nees_rotation));
    row("NEES pose (6)", &|q| number(q.nees_pose));
    row("compared", &|q| q.count.to_string());
    row("rate (Hz)", &|q| format!("{:.2}", q.rate_hz));
    row("gaps > 30 ms", &|q| q.gaps_over_30_ms.to_string());
    row("longest gap (ms)", &|q| format!("{:.1}", q.longest_gap_ms));
    row("first, last (s)", &|q| format!("{:.2}, {:.2}", q.first_s, q.last_s));
    for (name, get) in [
        ("unusable", (|q| q.unusable) as fn(&Quality) -> u64),
        ("without covariance", |q| q.without_covariance),
        ("without truth", |q| q.without_truth),
    ] {
        if q.iter().any(|q| get(q) > 0) {
            row(name, &|q| get(q).to_string());
        }
    }
    table
}

/// Formats CSV with one row per estimate; a figure is empty where nothing was compared.
pub fn csv(evaluation: &Evaluation) -> String {
    let mut out = String::from("estimate,count");
    for axis in ["position", "x", "y", "z"] {
        let _ = write!(out, ",{axis}_rmse_mm,{axis}_max_mm");
    }
    for axis in ["rotation", "roll", "pitch", "yaw"] {
        let _ = write!(out, ",{axis}_rmse_deg,{axis}_max_deg");
    }
    out += ",nees_position,nees_rotation,nees_pose,rate_hz,gaps_over_30_ms,longest_gap_ms,\
            first_s,last_s,unusable,without_covariance,without_truth\n";
    let figure = |value: f64| if value.is_nan() { String::new() } else { format!("{value:.6}") };
    for q in &evaluation.estimates {
        let spreads = [&[q.position_mm][..], &q.axes_mm, &[q.rotation_deg], &q.angles_deg].concat();
        let nees = [q.nees_position, q.nees_rotation, q.nees_pose];
        let mut cells = vec![q.estimate.clone(), q.count.to_string()];
        cells.extend(spreads.iter().flat_map(|s| [s.rmse, s.max]).map(figure));
        cells.extend(nees.map(|nees| nees.map_or(String::new(), |nees| format!("{nees:.4}"))));
        cells.extend([format!("{:.4}", q.rate_hz), q.gaps_over_30_ms.to_string()]);
        cells.extend([q.longest_gap_ms, q.first_s, q.last_s].map(|value| format!("{value:.3}")));
        let lacks = [q.unusable, q.without_covariance, q.without_truth];
        cells.extend(lacks.map(|count| count.to_string()));
        out += &(cells.join(",") + "\n");
    }
    out
}
