//! Table I: time of one pose, by stage.

use super::{Csv, named, rounded_up};
use crate::paper::{Made, PaperError, Value, read, write};
use std::path::Path;
use volant::report::{Anchor, Color, Drawing, Ink, Table, colors};

/// Row of a method that does the first three stages in one pass.
const ONE_PASS: &str = "flow, tracking and extraction";
/// Cell of a stage whose time is part of that row.
const SHARED: &str = "in one pass, below";

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
    let total =
        stages.iter().position(|s| s == "total").ok_or_else(|| csv.wrong("no row `total`"))?;
    let title = "Table I: time of one pose, by stage";
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, title);
    let parts: Vec<(usize, Color)> = [
        ("optical flow", colors::CAMERA),
        ("tracking", colors::INERTIAL),
        ("feature extraction", colors::PAPER),
        (ONE_PASS, colors::FUSED),
        ("extrinsics", colors::VIOLET),
    ]
    .into_iter()
    .filter_map(|(name, color)| Some((stages.iter().position(|s| s == name)?, color)))
    .collect();
    let mut x = 28.0;
    for (i, color) in &parts {
        d.bar(x, 50.0, 20.0, 14.0, *color);
        d.text(x + 28.0, 63.0, 15.0, colors::INK, Anchor::Start, &stages[*i]);
        x += 60.0 + 8.2 * stages[*i].len() as f64;
    }
    let (x0, wide) = (240.0, 770.0);
    let top =
        rounded_up(values.iter().map(|v| v[total]).filter(|v| v.is_finite()).fold(0.0, f64::max));
    let scale = wide / top;
    let base = 264.0;
    for k in 0..=5 {
        let v = top * f64::from(k) / 5.0;
        let x = x0 + scale * v;
        d.line([x, 86.0], [x, base], Ink(if k == 0 { colors::AXIS } else { colors::GRID }, 1.0));
        d.text(x, base + 20.0, 13.0, colors::SOFT, Anchor::Middle, &format!("{v:.1}"));
    }
    d.text(
        x0 + wide / 2.0,
        base + 42.0,
        14.0,
        colors::INK,
        Anchor::Middle,
        "time of one image [ms]",
    );
    let rows = ["published, 2010", "the recipe in plain OpenCV", "default tracker"];
    for (k, (name, times)) in rows.iter().zip(&values).enumerate() {
        let y = 98.0 + 56.0 * k as f64;
        d.text(x0 - 14.0, y + 23.0, 15.0, colors::INK, Anchor::End, name);
        let mut at = x0;
        for (i, color) in &parts {
            // The sum of stages that have bars of their own needs none.
            let is_sum = stages[*i] == ONE_PASS && times[0].is_finite();
            if times[*i].is_finite() && !is_sum {
                d.bar(at, y, scale * times[*i], 34.0, *color);
                at += scale * times[*i];
            }
        }
        if times[total].is_finite() {
            let end = at.max(x0 + scale * times[total]);
            d.text(
                end + 10.0,
                y + 23.0,
                14.0,
                colors::INK,
                Anchor::Start,
                &format!("{:.3} ms", times[total]),
            );
        }
    }
    let svg = write(folder, "table-1.svg", &d.finish(base + 58.0, title))?;
    let [published, plain, ours] = values.map(|v| v[total]);
    let mut table = named(
        Table::from_csv(&read(&csv.path)?, 3, false),
        &["stage", "published [ms]", "recipe in plain OpenCV [ms]", "default tracker [ms]"],
    );
    let cells = table.rows.iter_mut().flat_map(|row| row.iter_mut());
    cells.filter(|cell| cell.0.is_empty()).for_each(|cell| SHARED.clone_into(&mut cell.0));
    let rate = |ms: f64| format!("{ms:.3} ms = {:.1} Hz", 1e3 / ms);
    Ok(Made {
        name: "table-1",
        title,
        table: Some(table),
        csv: csv.path,
        svg,
        values: vec![
            Value::new("one pose, recipe in plain OpenCV", &rate(published), rate(plain)),
            Value::new("one pose, default tracker", &rate(published), rate(ours)),
        ],
        shows: format!(
            "Median time of one core for a tracked image of 640×480, on the bench's motion. The \
             default tracker with all its criteria and the pose takes {ours:.3} ms, the paper's \
             recipe written plainly with OpenCV {plain:.2} ms in the same run: {:.0} times as \
             long. At {ours:.3} ms a core could follow {:.0} images a second.",
            plain / ours,
            1e3 / ours
        ),
        published: format!(
            "The published times are of a computer of 2010. Each stage of the recipe has its own \
             timer. The default tracker does the first three stages in one pass over each marker \
             (flow, edges and hue of one window after the other), so one timer measures them \
             together; it searches four windows instead of the frame, and at their edges instead \
             of all pixels. At {published:.2} ms the published system reached {:.2} Hz.",
            1e3 / published,
        ),
    })
}
