//! What a run has shown, for people: a table like the paper's Table II and a picture like its Fig. 13.

use crate::accuracy::{AXES, Errors, Track, UNITS, six};
use nalgebra::Isometry3;
use plotters::prelude::*;
use rig_model::Stamp;
use std::{fmt::Write, path::Path};

/// One estimate: its name, and the errors that it made.
pub type Row<'a> = (&'a str, &'a Errors);

/// Root mean square and maximum of each axis, one column per estimate.
pub fn table(rows: &[Row<'_>]) -> String {
    let mut text = format!("{:<12}", "");
    for (name, _) in rows {
        let _ = write!(text, "{name:>24}");
    }
    let _ = write!(text, "\n{:<12}", "");
    for _ in rows {
        let _ = write!(text, "{:>14}{:>10}", "RMSE", "max");
    }
    for (i, (axis, unit)) in AXES.iter().zip(UNITS).enumerate() {
        let _ = write!(text, "\n{:<12}", format!("{axis} [{unit}]"));
        for (_, errors) in rows {
            let digits = if i < 3 { 2 } else { 3 };
            let _ = write!(text, "{:>14.digits$}{:>10.digits$}", errors.rmse[i], errors.max[i]);
        }
    }
    let _ = write!(text, "\n{:<12}", "3-D [mm]");
    for (_, errors) in rows {
        let _ = write!(text, "{:>14.2}{:>10}", errors.position_rmse, "");
    }
    let _ = write!(text, "\n{:<12}", "angle [deg]");
    for (_, errors) in rows {
        let _ = write!(text, "{:>14.3}{:>10}", errors.rotation_rmse, "");
    }
    text
}

/// A curve of the picture.
#[derive(Clone, Copy, Debug)]
pub struct Curve<'a> {
    /// What the legend calls it.
    pub name: &'a str,
    /// Poses.
    pub track: &'a Track,
    /// Its colour.
    pub colour: RGBColor,
    /// Line width; 0: dots.
    pub width: u32,
}

/// Colours that tell the curves apart also for those who do not see all colours.
pub mod colours {
    use plotters::style::RGBColor;
    /// The truth.
    pub const TRUTH: RGBColor = RGBColor(40, 40, 40);
    /// The camera alone.
    pub const CAMERA: RGBColor = RGBColor(230, 159, 0);
    /// The inertial unit alone.
    pub const INERTIAL: RGBColor = RGBColor(86, 180, 233);
    /// The fused pose.
    pub const FUSED: RGBColor = RGBColor(213, 60, 60);
    /// The paper's filter.
    pub const PAPER: RGBColor = RGBColor(0, 158, 115);
}

/// Draws x, y, z, roll, pitch, yaw over the time from `epoch` to `epoch + seconds` as an SVG file. Times at which a marker
/// was covered are shaded. The range of each axis is the truth's, so that a curve that drifts leaves the picture
/// instead of flattening the others.
///
/// # Errors
/// What plotters says, as text.
pub fn six_curves(
    path: &Path,
    title: &str,
    epoch: Stamp,
    seconds: f64,
    truth: impl Fn(f64) -> Isometry3<f64>,
    curves: &[Curve<'_>],
    shaded: &[[f64; 2]],
) -> Result<(), String> {
    draw(path, title, epoch, seconds, truth, curves, shaded).map_err(|e| format!("{}: {e}", path.display()))
}

fn draw(
    path: &Path,
    title: &str,
    epoch: Stamp,
    seconds: f64,
    truth: impl Fn(f64) -> Isometry3<f64>,
    curves: &[Curve<'_>],
    shaded: &[[f64; 2]],
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(path, (1120, 920)).into_drawing_area();
    root.fill(&WHITE)?;
    let (head, body) = root.split_vertically(64);
    head.draw(&Text::new(title.to_owned(), (24, 14), ("sans-serif", 20).into_font().color(&colours::TRUTH)))?;
    legend(&head, curves, !shaded.is_empty())?;
    let truth: Vec<(f64, [f64; 6])> =
        (0..=(seconds * 50.0) as usize).map(|i| i as f64 / 50.0).map(|t| (t, six(&truth(t)))).collect();
    for (axis, area) in body.split_evenly((3, 2)).iter().enumerate() {
        // Positions in the left column, rotations in the right one.
        let axis = (axis % 2) * 3 + axis / 2;
        let values = truth.iter().map(|(_, v)| v[axis]);
        let (low, high) = values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let margin = (0.25 * (high - low)).max(if axis < 3 { 5.0 } else { 0.5 });
        let (low, high) = (low - margin, high + margin);
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .margin_right(18)
            .x_label_area_size(34)
            .y_label_area_size(56)
            .build_cartesian_2d(0.0..seconds, low..high)?;
        chart.draw_series(shaded.iter().map(|[from, to]| {
            Rectangle::new([(*from, low), (*to, high)], RGBColor(236, 236, 226).filled())
        }))?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(RGBColor(225, 225, 225))
            .axis_style(RGBColor(120, 120, 120))
            .x_labels(6)
            .y_labels(6)
            .x_desc("time [s]")
            .y_desc(format!("{} [{}]", AXES[axis], UNITS[axis]))
            .label_style(("sans-serif", 13))
            .x_label_formatter(&|t| format!("{t:.0}"))
            .y_label_formatter(&|v| format!("{v:.0}"))
            .draw()?;
        for curve in curves {
            let points = curve
                .track
                .iter()
                .map(|(at, pose)| (at.seconds_since(epoch), six(pose)[axis]))
                .filter(|(t, v)| (0.0..=seconds).contains(t) && (low..=high).contains(v));
            if curve.width == 0 {
                chart.draw_series(points.map(|p| Circle::new(p, 2, curve.colour.filled())))?;
                continue;
            }
            // A curve that leaves the picture is not drawn across it when it comes back.
            let mut part: Vec<(f64, f64)> = Vec::new();
            let style = curve.colour.stroke_width(curve.width);
            for point in points {
                if part.last().is_some_and(|last| point.0 - last.0 > 0.15) {
                    chart.draw_series(LineSeries::new(std::mem::take(&mut part), style))?;
                }
                // Finer than the picture's dots need not be.
                if part.last().is_none_or(|last| point.0 - last.0 > seconds / 1200.0) {
                    part.push(point);
                }
            }
            chart.draw_series(LineSeries::new(part, style))?;
        }
        let line = truth.iter().map(|(t, v)| (*t, v[axis]));
        chart.draw_series(LineSeries::new(line, colours::TRUTH.stroke_width(1)))?;
    }
    root.present()?;
    Ok(())
}

fn legend(
    head: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    curves: &[Curve<'_>],
    shaded: bool,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut x = 28;
    let mut entry = |name: &str, colour: RGBColor, width: u32| -> Result<(), Box<dyn std::error::Error>> {
        if width == 0 {
            for i in 0..3 {
                head.draw(&Circle::new((x + 4 + 8 * i, 50), 2, colour.filled()))?;
            }
        } else {
            head.draw(&PathElement::new(vec![(x, 50), (x + 24, 50)], colour.stroke_width(width)))?;
        }
        head.draw(&Text::new(
            name.to_owned(),
            (x + 32, 43),
            ("sans-serif", 15).into_font().color(&colours::TRUTH),
        ))?;
        x += 60 + 8 * name.chars().count() as i32;
        Ok(())
    };
    entry("truth", colours::TRUTH, 1)?;
    for curve in curves {
        entry(curve.name, curve.colour, curve.width)?;
    }
    if shaded {
        entry("a marker is covered", RGBColor(222, 222, 206), 12)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_names_every_axis_and_estimate_and_the_picture_is_an_svg() {
        let errors = Errors { rmse: [1.25, 2.0, 3.0, 0.5, 0.25, 0.125], count: 1, ..Errors::default() };
        let text = table(&[("camera alone", &errors), ("fused", &errors)]);
        for part in ["camera alone", "fused", "x [mm]", "yaw [deg]", "1.25", "0.125"] {
            assert!(text.contains(part), "{part} in\n{text}");
        }
        let path = std::env::temp_dir().join(format!("volant-report-{}.svg", std::process::id()));
        let at = |s: f64| Stamp::from_nanos(0).plus_seconds(s);
        let track: Track = (0..300).map(|i| (at(f64::from(i) / 100.0), Isometry3::identity())).collect();
        let curve = Curve { name: "fused", track: &track, colour: colours::FUSED, width: 2 };
        six_curves(&path, "a run", at(0.0), 3.0, |_| Isometry3::identity(), &[curve], &[[1.0, 2.0]]).unwrap();
        let svg = std::fs::read_to_string(&path).unwrap();
        std::fs::remove_file(&path).unwrap();
        assert!(
            svg.starts_with("<svg") && svg.contains("pitch [deg]") && svg.matches("<polyline").count() >= 12
        );
    }
}
