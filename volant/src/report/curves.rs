//! Curves of x, y, z, roll, pitch and yaw over time, as in the paper's Fig. 13.

use super::{
    chart::{Axis, ChartError, Panel, Series, Shape, Sheet, panels},
    palette::colors,
};
use nalgebra::Isometry3;
use plotters::prelude::RGBColor;
use rig_model::Stamp;

/// Rate of the truth's curve, Hz, and its most points: a stamp that is far off makes a time axis of
/// years.
const RATE: f64 = 50.0;
const MOST_POINTS: f64 = 60_000.0;

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
    let rate = RATE.min(MOST_POINTS / run.seconds);
    let count = (run.seconds * rate) as usize;
    let truth: Vec<(f64, [f64; 6])> = (0..=count)
        .map(|i| i as f64 / rate)
        .filter_map(|t| Some((t, six(&(run.truth)(t)?))))
        .collect();
    // Positions in the left column, rotations in the right one.
    let drawn = [0, 3, 1, 4, 2, 5].map(|axis| {
        let values = truth.iter().map(|(_, v)| v[axis]);
        let (low, high) =
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 0.0) };
        let margin = (0.25 * (high - low)).max(if axis < 3 { 5.0 } else { 0.5 });
        let range = [low - margin, high + margin];
        let mut series = Vec::new();
        if !run.shaded.is_empty() {
            let spans = run.shaded.iter().map(|[from, to]| (*from, *to));
            series.push(Series::new("a marker is covered", colors::SHADE, Shape::Spans, spans));
        }
        series.extend(curves.iter().map(|curve| {
            let shape = if curve.width == 0 { Shape::Dots } else { Shape::Line(curve.width) };
            Series::new(curve.name, curve.color, shape, points(run, curve, axis, range))
        }));
        let exact = truth.iter().map(|(t, v)| (*t, v[axis]));
        series.push(Series::new("truth", colors::TRUTH, Shape::Line(1), exact));
        Panel {
            title: String::new(),
            x: Axis::new("time [s]", [0.0, run.seconds], false),
            y: Axis::new(format!("{} [{}]", AXES[axis], UNITS[axis]), range, false),
            series,
        }
    });
    panels(Sheet { title: run.title, size: (1120, 960), grid: (3, 2) }, &drawn)
}

/// Points of a curve inside its panel. A line is thinned to the image's pixels, and has a gap where
/// the curve leaves the panel or pauses.
fn points(run: &Run<'_>, curve: &Curve<'_>, axis: usize, [low, high]: [f64; 2]) -> Vec<(f64, f64)> {
    let inside = curve
        .track
        .iter()
        .map(|(at, pose)| (at.seconds_since(run.epoch), six(pose)[axis]))
        .filter(|(t, v)| (0.0..=run.seconds).contains(t) && (low..=high).contains(v));
    if curve.width == 0 {
        return inside.collect();
    }
    let (mut points, mut before): (Vec<(f64, f64)>, f64) = (Vec::new(), f64::NEG_INFINITY);
    for (t, v) in inside {
        if t - before > 0.15 {
            points.push((t, f64::NAN));
        }
        if points.last().is_some_and(|p| p.1.is_nan() || t - p.0 > run.seconds / 1200.0) {
            points.push((t, v));
        }
        before = t;
    }
    points
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

    #[test]
    fn a_time_axis_of_years_has_a_bounded_number_of_points() {
        let calls = std::cell::Cell::new(0);
        let truth = |_: f64| -> Option<Isometry3<f64>> {
            calls.set(calls.get() + 1);
            None
        };
        let epoch = Stamp::from_nanos(0);
        let run = Run { title: "a run", epoch, seconds: 2e9, truth: &truth, shaded: &[] };
        six_curves(&run, &[]).unwrap();
        assert!(calls.get() <= MOST_POINTS as u32 + 1, "{}", calls.get());
    }
}
