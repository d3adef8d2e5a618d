//! Curves of x, y, z, roll, pitch and yaw over time, as in the paper's Fig. 13.

use super::{
    chart::{ChartError, Entry, Shape, font, headed},
    palette::{colors, finished},
};
use nalgebra::Isometry3;
use plotters::prelude::*;
use rig_model::Stamp;

/// Poses `world_from_volant` with their stamps, sorted.
pub type Track = Vec<(Stamp, Isometry3<f64>)>;

/// Names of the six axes, in the order of the arrays here.
pub const AXES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];
/// Units of the axes.
pub const UNITS: [&str; 6] = ["mm", "mm", "mm", "deg", "deg", "deg"];

/// Converts a pose to position, mm, and roll, pitch, yaw, degrees (rotations about the fixed axes
/// x, y, z in this order).
pub fn six(pose: &Isometry3<f64>) -> [f64; 6] {
    let p = pose.translation.vector * 1e3;
    let (roll, pitch, yaw) = pose.rotation.euler_angles();
    [p.x, p.y, p.z, roll.to_degrees(), pitch.to_degrees(), yaw.to_degrees()]
}

/// Curve of one estimate.
#[derive(Clone, Copy, Debug)]
pub struct Curve<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// Poses.
    pub track: &'a Track,
    /// Color.
    pub color: RGBColor,
    /// Line width; 0: dots.
    pub width: u32,
}

/// Run in which the curves are drawn.
pub struct Run<'a> {
    /// Title.
    pub title: &'a str,
    /// Start of the time axis.
    pub epoch: Stamp,
    /// Length of the time axis, s.
    pub seconds: f64,
    /// True `world_from_volant` at a time, s; `None` where it is unknown.
    pub truth: &'a dyn Fn(f64) -> Option<Isometry3<f64>>,
    /// Shaded spans in which a marker was covered, s.
    pub shaded: &'a [[f64; 2]],
}

/// Draws x, y, z, roll, pitch, yaw over time. Each axis has the range of the truth, so that a
/// drifting curve leaves the panel instead of flattening the others.
///
/// # Errors
/// plotters fails.
pub fn six_curves(run: &Run<'_>, curves: &[Curve<'_>]) -> Result<String, ChartError> {
    let mut svg = String::new();
    draw(&mut svg, run, curves)?;
    Ok(finished(&svg, run.title))
}

fn draw(svg: &mut String, run: &Run<'_>, curves: &[Curve<'_>]) -> Result<(), ChartError> {
    let seconds = run.seconds;
    let root = SVGBackend::with_string(svg, (1120, 960)).into_drawing_area();
    root.fill(&colors::BACK)?;
    let mut entries = vec![Entry { name: "truth", color: colors::TRUTH, shape: Shape::Line(1) }];
    for c in curves {
        let shape = if c.width == 0 { Shape::Dots } else { Shape::Line(c.width) };
        entries.push(Entry { name: c.name, color: c.color, shape });
    }
    if !run.shaded.is_empty() {
        entries.push(Entry {
            name: "a marker is covered",
            color: colors::SHADE,
            shape: Shape::Line(12),
        });
    }
    let body = headed(&root, run.title, &entries)?;
    let count = (seconds * 50.0) as usize;
    let truth: Vec<(f64, [f64; 6])> = (0..=count)
        .map(|i| i as f64 / 50.0)
        .filter_map(|t| Some((t, six(&(run.truth)(t)?))))
        .collect();
    for (place, area) in body.split_evenly((3, 2)).iter().enumerate() {
        // Positions in the left column, rotations in the right one.
        let axis = (place % 2) * 3 + place / 2;
        let values = truth.iter().map(|(_, v)| v[axis]);
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let margin = (0.25 * (high - low)).max(if axis < 3 { 5.0 } else { 0.5 });
        let (low, high) = (low - margin, high + margin);
        let mut chart = ChartBuilder::on(area)
            .margin(10)
            .margin_right(18)
            .x_label_area_size(46)
            .y_label_area_size(70)
            .build_cartesian_2d(0.0..seconds, low..high)?;
        chart.draw_series(run.shaded.iter().map(|[from, to]| {
            Rectangle::new([(*from, low), (*to, high)], colors::SHADE.filled())
        }))?;
        chart
            .configure_mesh()
            .light_line_style(TRANSPARENT)
            .bold_line_style(colors::GRID)
            .axis_style(colors::AXIS)
            .x_labels(6)
            .y_labels(6)
            .x_desc("time [s]")
            .y_desc(format!("{} [{}]", AXES[axis], UNITS[axis]))
            .axis_desc_style(font(14.0).color(&colors::INK))
            .label_style(font(13.0).color(&colors::SOFT))
            .x_label_formatter(&|t| format!("{t:.0}"))
            .y_label_formatter(&|v| {
                if high - low < 4.0 { format!("{v:.1}") } else { format!("{v:.0}") }
            })
            .draw()?;
        for curve in curves {
            let points = curve
                .track
                .iter()
                .map(|(at, pose)| (at.seconds_since(run.epoch), six(pose)[axis]))
                .filter(|(t, v)| (0.0..=seconds).contains(t) && (low..=high).contains(v));
            if curve.width == 0 {
                chart.draw_series(points.map(|p| Circle::new(p, 2, curve.color.filled())))?;
                continue;
            }
            // A curve that leaves the panel and returns is drawn in parts.
            let mut part: Vec<(f64, f64)> = Vec::new();
            let style = curve.color.stroke_width(curve.width);
            for point in points {
                if part.last().is_some_and(|last| point.0 - last.0 > 0.15) {
                    chart.draw_series(LineSeries::new(std::mem::take(&mut part), style))?;
                }
                // No finer than the image's pixels.
                if part.last().is_none_or(|last| point.0 - last.0 > seconds / 1200.0) {
                    part.push(point);
                }
            }
            chart.draw_series(LineSeries::new(part, style))?;
        }
        let line = truth.iter().map(|(t, v)| (*t, v[axis]));
        chart.draw_series(LineSeries::new(line, colors::TRUTH.stroke_width(1)))?;
    }
    root.present()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_axis_is_named_and_every_curve_drawn() {
        let at = |s: f64| Stamp::from_nanos(0).plus_seconds(s);
        let track: Track =
            (0..300).map(|i| (at(f64::from(i) / 100.0), Isometry3::identity())).collect();
        let curve = Curve { name: "fused", track: &track, color: colors::FUSED, width: 2 };
        let truth = |t: f64| (t < 2.0).then(Isometry3::identity);
        let run = Run {
            title: "a run",
            epoch: at(0.0),
            seconds: 3.0,
            truth: &truth,
            shaded: &[[1.0, 2.0]],
        };
        let svg = six_curves(&run, &[curve]).unwrap();
        for part in ["x [mm]", "pitch [deg]", "\nfused\n", "\ntruth\n", "a marker is covered"] {
            assert!(svg.contains(part), "{part}");
        }
        assert!(svg.starts_with("<svg") && svg.matches("<polyline").count() >= 12);
    }
}
