//! HTML page of an evaluation: table of errors, curves of the poses and of their errors.

use super::{EvaluateOptions, Evaluation, report};
use crate::{
    command_line::quoted,
    report::{
        Axis, Block, ChartError, Curve, Page, Panel, Run, Section, Series, Shape, Sheet, colors,
        panels, six_curves,
    },
};
use nalgebra::Isometry3;
use rig_model::topics;

/// Most points of a drawn curve.
const POINTS: usize = 1500;

/// Lays out the page of an evaluation.
///
/// # Errors
/// A figure cannot be drawn.
pub fn page(evaluation: &Evaluation, options: &EvaluateOptions) -> Result<Page, ChartError> {
    let Evaluation { began, truth, .. } = evaluation;
    let seconds = truth.span().map_or(0.0, |(_, last)| last.seconds_since(*began)).max(0.1);
    // `fused_pose` is the same odometry, inverted: its curve would coincide.
    // The dots of single images first, so that the line is above them.
    let shown = evaluation.estimates.iter().rev().filter_map(|q| {
        let (name, color, width) = match q.estimate.as_str() {
            topics::VISUAL_POSE => ("camera alone", colors::CAMERA, 0),
            topics::ODOMETRY => ("fused", colors::FUSED, 3),
            _ => return None,
        };
        Some(Curve { name, track: &q.track, color, width })
    });
    let curves: Vec<Curve<'_>> = shown.collect();
    let run = Run {
        title: "Pose of the platform in the world frame",
        epoch: *began,
        seconds,
        truth: &|t| Some(truth.at(began.plus_seconds(t))?.world_from_volant),
        shaded: &[],
    };
    let six = six_curves(&run, &curves)?;
    let mut blocks = vec![Block::Table(report::rows(&evaluation.estimates))];
    blocks.extend(evaluation.losses.iter().cloned().map(Block::Note));
    let [bag, truth_bag] = [&options.estimates, &options.truth].map(|p| p.display().to_string());
    let words: [String; 5] = ["volant".into(), "evaluate".into(), bag, "--truth".into(), truth_bag];
    let mut facts = vec![
        ("Command".into(), format!("`{}`", quoted(&words))),
        ("Run".into(), format!("{seconds:.1} s; the table skips the first {} s", options.skip)),
    ];
    if let Some(q) = evaluation.estimates.iter().find(|q| q.estimate == topics::ODOMETRY) {
        facts.push((
            "Odometry".into(),
            format!("{:.2} Hz, longest gap {:.1} ms", q.rate_hz, q.longest_gap_ms),
        ));
    }
    Ok(Page {
        title: "Estimates against the truth".into(),
        lead: "The truth is interpolated at each estimate's stamp. NEES compares the covariance \
               with the errors: its expected value is 3 for position and for rotation; a larger \
               one means that the covariance is too small."
            .into(),
        facts,
        sections: vec![
            Section { id: "errors".into(), title: "Errors".into(), blocks },
            Section {
                id: "curves".into(),
                title: "Position and rotation over time".into(),
                blocks: vec![
                    Block::text(
                        "Each panel has the range of the truth (thin line); a curve that \
                                 drifts leaves it.",
                    ),
                    Block::Figure(six),
                ],
            },
            Section {
                id: "off".into(),
                title: "Distance from the truth over time".into(),
                blocks: vec![Block::Figure(distances(evaluation, seconds, options.skip, &curves)?)],
            },
        ],
    })
}

fn distances(
    evaluation: &Evaluation,
    seconds: f64,
    skip: f64,
    curves: &[Curve<'_>],
) -> Result<String, ChartError> {
    let Evaluation { began, truth, .. } = evaluation;
    let curve = |of: &dyn Fn(&Isometry3<f64>, &Isometry3<f64>) -> f64| -> (Vec<Series>, f64) {
        let mut all = Vec::new();
        let series = curves
            .iter()
            .map(|drawn| {
                let points: Vec<(f64, f64)> = drawn
                    .track
                    .iter()
                    .filter_map(|(stamp, pose)| {
                        Some((
                            stamp.seconds_since(*began),
                            of(pose, &truth.at(*stamp)?.world_from_volant),
                        ))
                    })
                    .filter(|p| p.0 >= skip)
                    .collect();
                all.extend(points.iter().map(|p| p.1));
                // The largest of neighboring values, so that no peak is lost.
                let step = points.len().div_ceil(POINTS).max(1);
                let thinned = points
                    .chunks(step)
                    .filter_map(|c| c.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)));
                let shape = if drawn.width == 0 { Shape::Dots } else { Shape::Line(2) };
                Series::new(drawn.name, drawn.color, shape, thinned)
            })
            .collect();
        all.sort_by(f64::total_cmp);
        let top = all.get(all.len().saturating_sub(1 + all.len() / 200)).copied().unwrap_or(1.0);
        (series, (1.2 * top).max(1e-3))
    };
    let (mm, top_mm) = curve(&|a, b| (a.translation.vector - b.translation.vector).norm() * 1e3);
    let (deg, top_deg) = curve(&|a, b| a.rotation.angle_to(&b.rotation).to_degrees());
    let panel = |title: &str, unit: &str, series, top| Panel {
        title: title.into(),
        x: Axis::new("time [s]", [0.0, seconds], false),
        y: Axis::new(format!("error [{unit}]"), [0.0, top], false),
        series,
    };
    let sheet = Sheet { title: "Distance from the truth", size: (1120, 460), grid: (1, 2) };
    panels(sheet, &[panel("position", "mm", mm, top_mm), panel("rotation", "deg", deg, top_deg)])
}
