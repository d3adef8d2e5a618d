//! R/Q of the published filter from 0.1 to 1000 (section III-C).

use super::{
    Made, PaperError, Value,
    curves::{Curves, errors_of, published_filter},
    offline::{Recording, fuse},
    write,
};
use crate::{accuracy::Errors, live::Scenario};
use std::{fmt::Write, path::Path};
use volant::report::{Axis, Color, Panel, Series, Shape, Sheet, colors, panels};

/// Published R/Q.
const PUBLISHED: f64 = 10.0;
/// Steps of a decade.
const STEPS: i32 = 4;

/// One system over all ratios.
struct Line<'a> {
    key: &'a str,
    name: &'a str,
    color: Color,
    errors: Vec<Errors>,
}

/// Makes `ratio.csv` and `ratio.svg`.
///
/// # Errors
/// A filter without output, or a folder that is not writable.
pub fn ratio(scenario: &Scenario, curves: &Curves, folder: &Path) -> Result<Made, PaperError> {
    let ratios: Vec<f64> =
        (-STEPS..=3 * STEPS).map(|i| 10f64.powf(f64::from(i) / f64::from(STEPS))).collect();
    let line = |key, name, color, recording: &Recording, velocity_from_fused| {
        let errors = ratios
            .iter()
            .map(|ratio| {
                let mut config = published_filter(scenario, velocity_from_fused);
                config.paper.ratio = *ratio;
                Ok(errors_of(scenario, &fuse(scenario, recording, config)?.fused))
            })
            .collect::<Result<Vec<_>, PaperError>>()?;
        Ok::<_, PaperError>(Line { key, name, color, errors })
    };
    let ours = &curves.recording;
    let corrected = "published filter, velocity from fused poses";
    let whole = "published system, whole";
    let lines = [
        line("paper", "published filter, our tracker", colors::PAPER, ours, false)?,
        line("paper_whole", whole, colors::BROWN, &curves.published, false)?,
        line("paper_velocity_from_fused", corrected, colors::VIOLET, ours, true)?,
    ];
    let mut csv = String::from("ratio");
    for l in &lines {
        let _ = write!(csv, ",{0}_mm,{0}_deg", l.key);
    }
    for (i, ratio) in ratios.iter().enumerate() {
        let _ = write!(csv, "\n{ratio:.4}");
        for l in &lines {
            let e = &l.errors[i];
            let _ = write!(csv, ",{:.4},{:.5}", e.position_rmse, e.rotation_rmse);
        }
    }
    csv.push('\n');
    let path = write(folder, "ratio.csv", &csv)?;
    let svg = write(folder, "ratio.svg", &draw(&ratios, &lines)?)?;

    let best = |l: &Line<'_>, value: fn(&Errors) -> f64| {
        (0..ratios.len())
            .min_by(|a, b| value(&l.errors[*a]).total_cmp(&value(&l.errors[*b])))
            .map_or(f64::NAN, |i| ratios[i])
    };
    let values = lines
        .iter()
        .map(|l| {
            Value::new(
                &format!("best R/Q: {}", l.name),
                &format!("{PUBLISHED}"),
                format!(
                    "{:.2} (position), {:.2} (rotation)",
                    best(l, |e| e.position_rmse),
                    best(l, |e| e.rotation_rmse)
                ),
            )
        })
        .collect();
    Ok(Made {
        name: "ratio",
        title: "R/Q of the published filter (section III-C)",
        csv: path,
        svg,
        table: None,
        values,
        shows: format!(
            "RMSE of position and rotation over R/Q from 0.1 to 1000, on the run of Table II \
             ({:.0} s). A small ratio follows the camera, a large one the IMU.",
            scenario.duration()
        ),
        published: "Published: R/Q = 10 was found accurate; a smaller Q pulls the output towards \
                    the inertial data, a smaller R towards the camera. The direction is confirmed. \
                    Where the velocity is not corrected, the position is the better the smaller \
                    the ratio, because each image takes a larger part of the drift away. On the \
                    markers of the default tracker the rotation is best below the published \
                    value: the noise of the camera's tilt averages out, and the error of the IMU's \
                    attitude does not."
            .to_owned(),
    })
}

fn draw(ratios: &[f64], lines: &[Line<'_>]) -> Result<String, PaperError> {
    let panel = |title: &str, unit: &str, value: fn(&Errors) -> f64| {
        let values = || lines.iter().flat_map(|l| l.errors.iter().map(value));
        let low = values().fold(f64::INFINITY, f64::min).max(1e-3);
        let high = values().fold(low, f64::max);
        // A logarithmic scale needs more than a decade.
        let log = high > 30.0 * low;
        let range = if log {
            [10f64.powf(low.log10().floor()), 10f64.powf((high * 1.01).log10().ceil())]
        } else {
            [0.0, 1.2 * high]
        };
        let series = |name: &str, color, shape, points| Series {
            name: name.to_owned(),
            color,
            shape,
            points,
            spread: Vec::new(),
        };
        let mark = vec![(PUBLISHED, range[0]), (PUBLISHED, range[1])];
        let mut all = vec![series("published: 10", colors::AXIS, Shape::Line(1), mark)];
        all.extend(lines.iter().map(|l| {
            let points = ratios.iter().copied().zip(l.errors.iter().map(value)).collect();
            series(l.name, l.color, Shape::Dotted, points)
        }));
        Panel {
            title: title.to_owned(),
            x: Axis { name: "R/Q".into(), range: [0.08, 1250.0], log: true },
            y: Axis { name: format!("RMSE [{unit}]"), range, log },
            series: all,
        }
    };
    let title = "R/Q of the published filter";
    Ok(panels(
        Sheet { title, size: (1120, 500), grid: (1, 2) },
        &[
            panel("position", "mm", |e| e.position_rmse),
            panel("rotation", "deg", |e| e.rotation_rmse),
        ],
    )?)
}
