//! Fig. 12: mean error and standard deviation, by method.

use super::{Csv, label, named, rounded_up};
use crate::paper::{Made, PaperError, Value, read, write};
use std::path::Path;
use volant::report::{Anchor, Drawing, Ink, Table, colors};

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
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, title);
    let (names_end, wide, row) = (268.0, 350.0, 46.0);
    let base = 104.0 + row * methods.len() as f64;
    for (half, (means, spreads, unit)) in
        [(&mm, &mm_std, "mm"), (&deg, &deg_std, "deg")].into_iter().enumerate()
    {
        let x0 = names_end + 16.0 + (wide + 66.0) * half as f64;
        let most = means
            .iter()
            .zip(spreads)
            .map(|(m, s)| m + s)
            .filter(|v| v.is_finite())
            .fold(0.0, f64::max);
        let top = rounded_up(most);
        let x = |v: f64| x0 + wide * (v / top).clamp(0.0, 1.0);
        let what = if half == 0 { "translation" } else { "rotation" };
        d.text(
            x0,
            78.0,
            15.0,
            colors::INK,
            Anchor::Start,
            &format!("{what} [{unit}]: bar mean, whisker ± deviation"),
        );
        for k in 0..=4 {
            let v = top * f64::from(k) / 4.0;
            d.line(
                [x(v), 92.0],
                [x(v), base],
                Ink(if k == 0 { colors::AXIS } else { colors::GRID }, 1.0),
            );
            let digits = if top < 1.0 {
                3
            } else if top < 10.0 {
                2
            } else {
                1
            };
            d.text(x(v), base + 20.0, 13.0, colors::SOFT, Anchor::Middle, &format!("{v:.digits$}"));
        }
        for (i, name) in methods.iter().enumerate() {
            let (shown, color) = label(name);
            let y = 102.0 + row * i as f64;
            if half == 0 {
                d.text(names_end, y + 19.0, 15.0, colors::INK, Anchor::End, &shown);
            }
            if !means[i].is_finite() {
                d.text(x0 + 6.0, y + 19.0, 13.0, colors::SOFT, Anchor::Start, "no pose");
                continue;
            }
            d.bar(x0, y, x(means[i]) - x0, 26.0, color);
            let (low, high) = (x(means[i] - spreads[i]), x(means[i] + spreads[i]));
            d.line([low, y + 13.0], [high, y + 13.0], Ink(colors::INK, 1.5));
            for end in [low, high] {
                d.line([end, y + 8.0], [end, y + 18.0], Ink(colors::INK, 1.5));
            }
            let digits = if half == 0 { 2 } else { 3 };
            // Beside the whisker, or before it where space is missing.
            let (at, anchor) = if high + 50.0 > x0 + wide + 40.0 {
                (low - 8.0, Anchor::End)
            } else {
                (high + 7.0, Anchor::Start)
            };
            let label = format!("{:.digits$}", means[i]);
            if anchor == Anchor::Start {
                d.text(at, y + 18.0, 13.0, colors::SOFT, anchor, &label);
            }
        }
    }
    let svg = write(folder, "fig-12.svg", &d.finish(base + 40.0, title))?;
    let best = |values: &[f64]| {
        (0..values.len())
            .filter(|i| values[*i].is_finite())
            .min_by(|a, b| values[*a].total_cmp(&values[*b]))
            .map_or_else(String::new, |i| label(&methods[i]).0)
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
        let peers: Vec<String> = (0..methods.len())
            .filter(|i| values[*i] < values[recipe] && !methods[*i].starts_with("volant"))
            .map(|i| label(&methods[i]).0)
            .collect();
        if peers.is_empty() {
            "no peer's mean is lower here".to_owned()
        } else {
            format!("the mean of {} is lower here", peers.join(" and of "))
        }
    };
    let ours = methods
        .iter()
        .position(|m| m.starts_with("volant"))
        .ok_or_else(|| csv.wrong("no row of this program"))?;
    let aruco = methods
        .iter()
        .position(|m| m.contains("ArUco"))
        .ok_or_else(|| csv.wrong("no row of ArUco"))?;
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
            .map(|(m, n)| format!("{} in {n:.0} images", label(m).0))
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
        values: vec![
            Value::new(
                "lowest mean error (translation, rotation)",
                "the markers",
                format!("{}, {}", winners[0], winners[2]),
            ),
            Value::new(
                "lowest deviation (translation, rotation)",
                "the markers",
                format!("{}, {}", winners[1], winners[3]),
            ),
        ],
        shows: format!(
            "Errors over the bench's motion (1 to 2 m, up to 28°), all methods on the same poses. \
             {smallest} The markers by the default tracker are {} ArUco in all four figures: {:.2} \
             against {:.2} mm, {:.3} against {:.3}°. Failures beyond 50 mm or 5° are counted, not \
             averaged: {gross}.",
            if below { "below" } else { "not below" },
            mm[ours],
            mm[aruco],
            deg[ours],
            deg[aruco]
        ),
        published: format!(
            "The published bars are an image without numbers; the markers have the lowest mean and \
             deviation of its three methods (ARToolKit and SIFT are the others). By the paper's \
             recipe, written plainly, {} in translation and {} in rotation: peers have \
             become better since 2010, and the center of mass of a binary image has errors due to \
             perspective and the pixel grid. The default tracker has neither error.",
            better_than_recipe(&mm),
            better_than_recipe(&deg)
        ),
    })
}
