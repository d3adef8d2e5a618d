//! The methods with a part of their target hidden (sections I and II-D).

use super::{Csv, axis, distinct, label};
use crate::paper::{Made, PaperError, Value, write};
use std::path::Path;
use volant::report::{Panel, Series, Shape, Sheet, Table, panels};

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
        head: std::iter::once("method".to_owned())
            .chain(conditions.iter().cloned())
            .collect(),
        rows: names
            .iter()
            .map(|m| {
                let cells = conditions.iter().map(|c| (cell(c, m), false));
                std::iter::once((label(m).0, false)).chain(cells).collect()
            })
            .collect(),
    };
    let title = "Success under occlusion, a pose within 5 mm and 1°";
    let series = names
        .iter()
        .enumerate()
        .map(|(k, m)| {
            let (name, color) = label(m);
            // A little apart, so that none hides another.
            let apart = 0.06 * (k as f64 - 0.5 * (names.len() as f64 - 1.0));
            let points = conditions
                .iter()
                .enumerate()
                .filter_map(|(x, c)| Some((x as f64 + apart, percent(row(c, m)?))))
                .collect();
            Series { name, color, shape: Shape::Dotted, points, spread: Vec::new() }
        })
        .collect();
    let last = conditions.len() as f64 - 1.0;
    let drawn = panels(
        Sheet { title, size: (1120, 420), grid: (1, 1) },
        &[Panel {
            title: conditions
                .iter()
                .enumerate()
                .map(|(i, c)| format!("{i}: {c}"))
                .collect::<Vec<_>>()
                .join("     "),
            x: axis("hidden", [-0.4, last + 0.4], false),
            y: axis("success [%]", [-4.0, 104.0], false),
            series,
        }],
    )?;
    let svg = folder.join("occlusion.svg");
    write(&svg, &drawn)?;
    let best = |condition: &str| -> String {
        let top = names
            .iter()
            .filter_map(|m| row(condition, m).map(percent))
            .fold(0.0, f64::max);
        let of = |m: &&String| row(condition, m).map(percent) == Some(top);
        let list: Vec<String> = names.iter().filter(of).map(|m| label(m).0).collect();
        if top == 0.0 { "none succeeds".to_owned() } else { format!("{} ({top:.0} %)", list.join(", ")) }
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
        published: "The paper argues that tags and templates fail as soon as a corner is hidden, \
                    and that four markers do not; it gives no numbers. Of the tags that holds: \
                    their quadrilateral needs its four corners. A texture loses features in \
                    proportion to the covered area, so SIFT survives, at a cost in time and \
                    accuracy. With two markers hidden, two points remain, which determine no pose \
                    in one image."
            .to_owned(),
    })
}
