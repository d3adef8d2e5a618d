//! Table I: time of one pose, by stage.

use super::{Csv, named};
use crate::paper::{
    Made, Value,
    bars::{Bars, decades, draw_bars},
};
use anyhow::Result;
use std::path::Path;
use volant::report::{Axis, Color, Table, colors};

/// Cell of a stage whose time is part of that row.
const SHARED: &str = "in one pass, below";

pub fn table_1(folder: &Path) -> Result<Made> {
    let csv = Csv::read(folder.join("table-1.csv"))?;
    let stages = csv.texts("stage")?;
    let values =
        [csv.numbers("published_ms")?, csv.numbers("plain_opencv_ms")?, csv.numbers("ours_ms")?];
    let total =
        stages.iter().position(|s| s == "total").ok_or_else(|| csv.wrong("no row `total`"))?;
    let title = "Table I: time of one pose, by stage";
    let rows: Vec<(String, Color)> =
        stages.iter().map(|stage| (stage.clone(), colors::CAMERA)).collect();
    let range = decades(values.iter().flatten().copied());
    let names = ["published, 2010", "the recipe in plain OpenCV", "default tracker"];
    let panels: Vec<Bars> = names
        .iter()
        .zip(&values)
        .map(|(name, times)| Bars {
            axis: Axis::new(format!("{name} [ms]"), range, true),
            values: times.clone(),
            spread: Vec::new(),
        })
        .collect();
    let svg = draw_bars(title, &rows, 3, &panels);
    let [published, plain, ours] = values.map(|v| v[total]);
    let mut table = named(
        Table::from_csv(&csv.text, 3, false),
        &["stage", "published [ms]", "recipe in plain OpenCV [ms]", "default tracker [ms]"],
    );
    let cells = table.rows.iter_mut().flat_map(|row| row.iter_mut());
    cells.filter(|cell| cell.0.is_empty()).for_each(|cell| SHARED.clone_into(&mut cell.0));
    let rate = |ms: f64| format!("{ms:.3} ms = {:.1} Hz", 1e3 / ms);
    Ok(Made {
        name: "table-1",
        title,
        table: Some(table),
        csv: csv.text,
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
