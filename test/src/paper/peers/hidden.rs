//! The methods with a part of their target hidden (sections I and II-D).

use super::{Csv, distinct, label};
use crate::paper::{Made, PaperError, Value, write};
use std::path::Path;
use volant::report::{Anchor, Color, Drawing, Ink, Table, colors};

/// Success and error of each method under occlusion.
///
/// # Errors
/// A table that is not there or not as it should be.
pub fn occlusion(folder: &Path) -> Result<Made, PaperError> {
    let csv = Csv::read(folder.join("occlusion.csv"))?;
    let (hidden, methods) = (csv.texts("hidden")?, csv.texts("method")?);
    let (images, successes) = (csv.numbers("images")?, csv.numbers("successes")?);
    let (mm, deg) = (csv.numbers("mean_mm")?, csv.numbers("mean_deg")?);
    let (conditions, names) = (distinct(&hidden), distinct(&methods));
    let row = |condition: &str, method: &str| {
        (0..hidden.len()).find(|i| hidden[*i] == condition && methods[*i] == method)
    };
    let percent = |i: usize| 100.0 * successes[i] / images[i];
    let cell = |condition: &str, method: &str| match row(condition, method) {
        Some(i) if mm[i].is_finite() => {
            format!("{:.0} %: {:.2} mm, {:.3}°", percent(i), mm[i], deg[i])
        }
        Some(i) => format!("{:.0} %", percent(i)),
        None => "–".to_owned(),
    };
    let table = Table {
        head: std::iter::once("method".to_owned()).chain(conditions.iter().cloned()).collect(),
        rows: names
            .iter()
            .map(|m| {
                let cells = conditions.iter().map(|c| (cell(c, m), false));
                std::iter::once((label(m).0, false)).chain(cells).collect()
            })
            .collect(),
    };
    let bars: Vec<(String, Color)> = names.iter().map(|m| label(m)).collect();
    let shares: Vec<Vec<Option<f64>>> =
        conditions.iter().map(|c| names.iter().map(|m| row(c, m).map(percent)).collect()).collect();
    let drawn = draw(&conditions, &bars, &shares);
    let svg = write(folder, "occlusion.svg", &drawn)?;
    let best = |condition: &str| -> String {
        let top = names.iter().filter_map(|m| row(condition, m).map(percent)).fold(0.0, f64::max);
        let of = |m: &&String| row(condition, m).map(percent) == Some(top);
        let list: Vec<String> = names.iter().filter(of).map(|m| label(m).0).collect();
        if top == 0.0 {
            "none succeeds".to_owned()
        } else {
            format!("{} ({top:.0} %)", list.join(", "))
        }
    };
    Ok(Made {
        name: "occlusion",
        title: "Rivals under occlusion (sections I and II-D)",
        csv: csv.path,
        svg,
        values: conditions
            .iter()
            .skip(1)
            .map(|c| {
                let published = match c.as_str() {
                    c if c.starts_with("one") => "the markers; pose barely changed",
                    c if c.starts_with("two") => "no visual pose",
                    _ => "–",
                };
                Value::new(&format!("most successes: {c} hidden"), published, best(c))
            })
            .collect(),
        table: Some(table),
        shows: "Share of images with a pose within 5 mm and 1° of the truth, and mean errors of \
                the poses that are not gross failures (beyond 50 mm or 5°). The same patch covers \
                a marker, a corner of the tag's black square and that corner of the texture; the \
                hand reaches in over one side, as far as its second corner. Each method follows \
                the target for 15 images before anything is hidden. All poses are of one image: \
                the IMU, which carries the whole system over longer occlusions, takes no part."
            .to_owned(),
        published: "The paper counts robustness to occlusion among the advantages of its markers; \
                    no number of its rivals under occlusion is published. Tags need all corners \
                    of their quadrilateral and fail with the first hidden one. With eq. 3 or from \
                    three markers the published system keeps its pose; the plain recipe, which \
                    takes the largest region of each color, loses it to another object. A texture \
                    loses features in proportion to the covered area, so SIFT survives, at the \
                    cost of its time. With two markers hidden, two points remain, which determine \
                    no pose in one image: the filter then uses the two visible markers and the \
                    IMU, the published system the IMU alone."
            .to_owned(),
    })
}

/// Successes in % as bars, a group for each condition.
fn draw(conditions: &[String], bars: &[(String, Color)], shares: &[Vec<Option<f64>>]) -> String {
    let title = "Success under occlusion, a pose within 5 mm and 1°";
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, title);
    for (i, (name, color)) in bars.iter().enumerate() {
        let (x, y) = (28.0 + 360.0 * (i % 3) as f64, 50.0 + 26.0 * (i / 3) as f64);
        d.bar(x, y, 20.0, 14.0, *color);
        d.text(x + 28.0, y + 13.0, 15.0, colors::INK, Anchor::Start, name);
    }
    let top = 106.0 + 26.0 * bars.len().div_ceil(3) as f64;
    let (high, x0, wide) = (200.0, 84.0, 1000.0);
    let base = top + high;
    d.text(x0, top - 32.0, 15.0, colors::INK, Anchor::Start, "success [%]; hidden is");
    for tick in [0.0, 50.0, 100.0] {
        let y = base - high * tick / 100.0;
        let color = if tick == 0.0 { colors::AXIS } else { colors::GRID };
        d.line([x0, y], [x0 + wide, y], Ink(color, 1.0));
        let label = format!("{tick:.0}");
        d.text(x0 - 8.0, y + 4.5, 13.0, colors::SOFT, Anchor::End, &label);
    }
    let group = wide / conditions.len().max(1) as f64;
    let step = (0.86 * group / bars.len().max(1) as f64).min(40.0);
    for (k, (condition, shares)) in conditions.iter().zip(shares).enumerate() {
        let first = x0 + group * k as f64 + 0.5 * (group - step * bars.len() as f64);
        for (j, ((_, color), share)) in bars.iter().zip(shares).enumerate() {
            let Some(share) = share else { continue };
            let (x, y) = (first + step * j as f64, base - high * share / 100.0);
            d.bar(x, y, 0.78 * step, base - y, *color);
            let middle = x + 0.39 * step;
            let label = format!("{share:.0}");
            d.text(middle, y - 5.0, 13.0, colors::SOFT, Anchor::Middle, &label);
        }
        let middle = x0 + group * (k as f64 + 0.5);
        d.text(middle, base + 24.0, 15.0, colors::INK, Anchor::Middle, condition);
    }
    d.finish(base + 44.0, title)
}
