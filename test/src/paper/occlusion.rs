//! Fig. 6: a marker is covered while the platform swings: its states in the tracker, and the effect
//! on the pose.

use super::{
    Made, PaperError,
    offline::{fuse, record_observed, track_with},
    stages::{chart_color, rgb_of},
    write,
};
use crate::live::{ImageSequence, Scenario};
use marker_tracker::TrackerConfig;
use nalgebra::Vector2;
use pose_fusion::Model;
use rig_model::{MarkerColor, MarkerObservations, MarkerState};
use std::{fmt::Write, path::Path};
use volant::report::{Anchor, Axis, Drawing, Panel, Series, Shape, Sheet, colors, panels};

/// Length of the run, s.
const SECONDS: f64 = 8.0;

/// Makes `fig-6.csv` and `fig-6.svg`.
///
/// # Errors
/// The scenario, an image, or a folder that is not writable.
pub fn figure_6(
    seed: u64,
    folder: &Path,
    threads: usize,
    progress: impl Fn(f64) + Sync,
) -> Result<Made, PaperError> {
    let scenario = Scenario::swing(seed, SECONDS)?;
    let images = ImageSequence::render(&scenario, threads, |done, of| {
        progress(done as f64 / of.max(1) as f64)
    })
    .map_err(|e| PaperError::Image(e.to_string()))?;
    let observed = track_with(&scenario, &images, TrackerConfig::default())?;
    let as_published = track_with(
        &scenario,
        &images,
        TrackerConfig { rigid_prediction: false, ..TrackerConfig::default() },
    )?;
    let recording = record_observed(&scenario, observed.clone());
    let poses = fuse(&scenario, &recording, Model::Tight)?;
    let cover = scenario
        .covers
        .first()
        .copied()
        .ok_or_else(|| PaperError::Image("nothing is covered".into()))?;

    let places = [&observed, &as_published].map(|o| place_errors(&scenario, o, cover.color));
    let visual = errors(&scenario, &poses.visual);
    let fused = errors(&scenario, &poses.fused);
    let mut csv = String::from(concat!(
        "seconds,state,place_error_px,place_error_mean_flow_px,",
        "camera_mm,camera_deg,fused_mm,fused_deg\n"
    ));
    let at = |rows: &[[f64; 3]], t: f64| -> [f64; 2] {
        let near = rows.iter().min_by(|a, b| (a[0] - t).abs().total_cmp(&(b[0] - t).abs()));
        near.filter(|r| (r[0] - t).abs() < 0.02).map_or([f64::NAN; 2], |r| [r[1], r[2]])
    };
    for (ours, mean) in places[0].iter().zip(&places[1]) {
        let (c, f) = (at(&visual, ours.0), at(&fused, ours.0));
        let _ = write!(csv, "{:.4},{}", ours.0, state_name(ours.1));
        for v in [ours.2, mean.2, c[0], c[1], f[0], f[1]] {
            if v.is_finite() {
                let _ = write!(csv, ",{v:.4}");
            } else {
                csv.push(',');
            }
        }
        csv.push('\n');
    }
    let path = folder.join("fig-6.csv");
    write(&path, &csv)?;

    let [from, to] = cover.seconds;
    let svg = folder.join("fig-6.svg");
    write(&svg, &draw(&scenario, &images, &observed, &places, &visual, &fused)?)?;
    let rms = |rows: &[[f64; 3]], column: usize, hidden: bool| -> f64 {
        let inside = |t: f64| t >= from && t <= to;
        let values: Vec<f64> = rows
            .iter()
            .filter(|r| r[0] > 1.0 && inside(r[0]) == hidden)
            .map(|r| r[column] * r[column])
            .collect();
        (values.iter().sum::<f64>() / values.len() as f64).sqrt()
    };
    let predicted = |rows: &[Place]| -> (f64, usize) {
        let values: Vec<f64> = rows
            .iter()
            .filter(|r| r.1 == MarkerState::Predicted && r.2.is_finite())
            .map(|r| r.2)
            .collect();
        (values.iter().copied().fold(0.0, f64::max), values.len())
    };
    let back = places[0]
        .iter()
        .find(|p| p.0 > to && p.1 == MarkerState::Detected)
        .map_or(f64::NAN, |p| p.0 - to);
    let ((rigid, count), (mean, _)) = (predicted(&places[0]), predicted(&places[1]));
    Ok(Made {
        name: "fig-6",
        title: "Fig. 6: an occluded marker",
        csv: path,
        svg,
        table: None,
        shows: format!(
            "A plank slides over the {} marker for {:.1} s. The tracker reports it as PREDICTED in \
             {count} images, placed by the others' flow, then LOST, and measures it again {:.0} ms \
             after the plank begins to slide away (which takes 300 ms). Camera alone: {:.2} mm and \
             {:.3}° RMS with four markers, {:.2} mm and {:.3}° with three. The filter: {:.2} mm \
             and {:.3}° with four, {:.2} mm and {:.3}° with three.",
            cover.color,
            to - from,
            1e3 * back,
            rms(&visual, 1, false),
            rms(&visual, 2, false),
            rms(&visual, 1, true),
            rms(&visual, 2, true),
            rms(&fused, 1, false),
            rms(&fused, 2, false),
            rms(&fused, 1, true),
            rms(&fused, 2, true),
        ),
        published: format!(
            "The paper reports that occlusion of one marker barely changes the pose, which holds \
             for the filter. It moves the hidden marker by the mean flow of the visible ones (eq. \
             3), which leaves out the platform's turn: at worst {mean:.1} px off within six images \
             here. The default carries the others' flow over as a rigid motion: {rigid:.1} px at \
             worst. A predicted place is shown and never used as a measurement: the pose depends \
             on visible markers only."
        ),
    })
}

/// Seconds, state and error of the reported place, px.
type Place = (f64, MarkerState, f64);

fn place_errors(
    scenario: &Scenario,
    observed: &[MarkerObservations],
    color: MarkerColor,
) -> Vec<Place> {
    observed
        .iter()
        .map(|o| {
            let t = o.stamp.seconds_since(scenario.sensors.epoch);
            let m = &o.markers[color];
            let error =
                true_place(scenario, color, t).map_or(f64::NAN, |p| (m.centroid - p).norm());
            (t, m.state, error)
        })
        .collect()
}

fn true_place(scenario: &Scenario, color: MarkerColor, t: f64) -> Option<Vector2<f64>> {
    let camera = scenario.motion.world_from_camera(t, &scenario.rig);
    let pose = camera.inverse() * scenario.motion.world_from_volant(t);
    Some(scenario.rig.markers.projected_centroid(color, &scenario.camera, &pose)?.pixel)
}

/// Seconds, mm and degrees.
fn errors(scenario: &Scenario, track: &crate::accuracy::Track) -> Vec<[f64; 3]> {
    track
        .iter()
        .map(|(at, pose)| {
            let t = at.seconds_since(scenario.sensors.epoch);
            let truth = scenario.motion.world_from_volant(t);
            let mm = (pose.translation.vector - truth.translation.vector).norm() * 1e3;
            [t, mm, pose.rotation.angle_to(&truth.rotation).to_degrees()]
        })
        .collect()
}

fn state_name(state: MarkerState) -> &'static str {
    match state {
        MarkerState::Detected => "detected",
        MarkerState::Predicted => "predicted",
        MarkerState::Lost => "lost",
    }
}

fn draw(
    scenario: &Scenario,
    images: &ImageSequence,
    observed: &[MarkerObservations],
    places: &[Vec<Place>; 2],
    visual: &[[f64; 3]],
    fused: &[[f64; 3]],
) -> Result<String, PaperError> {
    let cover = scenario.covers[0];
    let [from, to] = cover.seconds;
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, "Fig. 6: an occluded marker");
    let first = |state: MarkerState, after: f64| {
        places[0].iter().position(|p| p.0 >= after && p.1 == state).unwrap_or(0)
    };
    let shots = [
        ("before", first(MarkerState::Detected, from - 0.8)),
        ("predicted", (first(MarkerState::Predicted, from - 0.6) + 3).min(observed.len() - 1)),
        ("lost, three are seen", first(MarkerState::Lost, from + 0.3)),
        ("back", first(MarkerState::Detected, to)),
    ];
    let (wide, top) = (260.0, 84.0);
    let mut bottom = top;
    for (k, (name, index)) in shots.into_iter().enumerate() {
        let frame = images
            .frames
            .get(index)
            .ok_or_else(|| PaperError::Image("an image is missing".into()))?;
        let image = marker_tracker::decode_compressed("jpeg", &frame.jpeg)
            .map_err(|e| PaperError::Image(e.to_string()))?;
        let x = 24.0 + (wide + 10.6) * k as f64;
        let high = wide * image.height as f64 / image.width as f64;
        bottom = top + high;
        d.text(
            x,
            top - 12.0,
            15.0,
            colors::INK,
            Anchor::Start,
            &format!("{:.2} s: {name}", frame.seconds),
        );
        d.image(x, top, wide, high, image.width, &rgb_of(&image), false)?;
        let scale = wide / image.width as f64;
        for (color, m) in observed[index].markers.iter().filter(|(_, m)| m.centroid.x.is_finite()) {
            let place = [x + (m.centroid.x + 0.5) * scale, top + (m.centroid.y + 0.5) * scale];
            let filled = m.state == MarkerState::Detected;
            d.dot(place, 6.0, colors::PICTURE_DARK, filled);
            if filled {
                d.dot(place, 4.0, colors::PICTURE_LIGHT, true);
            } else {
                d.dot(place, 8.0, chart_color(color), false);
                d.dot(place, 10.0, colors::PICTURE_LIGHT, false);
            }
        }
    }
    let axis = |name: &str, range, log| Axis { name: name.into(), range, log };
    let line = |name: &str, color, shape, points: Vec<(f64, f64)>| Series {
        name: name.into(),
        color,
        shape,
        points,
        spread: Vec::new(),
    };
    let time = || axis("time [s]", [1.0, SECONDS], false);
    let of = |places: &[Place], state: MarkerState| -> Vec<(f64, f64)> {
        places.iter().map(|p| (p.0, if p.1 == state { p.2 } else { f64::NAN })).collect()
    };
    let column = |rows: &[[f64; 3]], c: usize, gap: f64| -> Vec<(f64, f64)> {
        let mut points = Vec::with_capacity(rows.len());
        let mut last = f64::NEG_INFINITY;
        for r in rows.iter().filter(|r| r[0] >= 1.0) {
            if r[0] - last > gap && last.is_finite() {
                points.push((r[0], f64::NAN));
            }
            last = r[0];
            points.push((r[0], r[c]));
        }
        points
    };
    // Space for the camera's largest error after the first second.
    let top =
        |c: usize| 1.2 * visual.iter().filter(|r| r[0] >= 1.0).map(|r| r[c]).fold(0.1, f64::max);
    let covered = |high: f64, low: f64| Series {
        name: "covered".into(),
        color: colors::AXIS,
        shape: Shape::Line(1),
        points: vec![(from, low), (from, high), (f64::NAN, f64::NAN), (to, low), (to, high)],
        spread: Vec::new(),
    };
    let sheet = Sheet { title: "", size: (1120, 430), grid: (1, 3) };
    let own = chart_color(cover.color);
    let svg = panels(
        sheet,
        &[
            Panel {
                title: format!("reported position of the {} marker", cover.color),
                x: time(),
                y: axis("off the truth [px]", [0.001, 30.0], true),
                series: vec![
                    covered(30.0, 0.001),
                    line("detected", own, Shape::Dots, of(&places[0], MarkerState::Detected)),
                    line(
                        "predicted, rigid motion",
                        colors::VIOLET,
                        Shape::Dotted,
                        of(&places[0], MarkerState::Predicted),
                    ),
                    line(
                        "predicted, mean flow (eq. 3)",
                        colors::PAPER,
                        Shape::Dotted,
                        of(&places[1], MarkerState::Predicted),
                    ),
                ],
            },
            Panel {
                title: "translation".into(),
                x: time(),
                y: axis("error [mm]", [0.0, top(1)], false),
                series: vec![
                    covered(top(1), 0.0),
                    line("camera alone", colors::CAMERA, Shape::Dots, column(visual, 1, 0.08)),
                    line("default filter", colors::FUSED, Shape::Line(2), column(fused, 1, 0.08)),
                ],
            },
            Panel {
                title: "rotation".into(),
                x: time(),
                y: axis("error [deg]", [0.0, top(2)], false),
                series: vec![
                    covered(top(2), 0.0),
                    line("camera alone", colors::CAMERA, Shape::Dots, column(visual, 2, 0.08)),
                    line("default filter", colors::FUSED, Shape::Line(2), column(fused, 2, 0.08)),
                ],
            },
        ],
    )?;
    d.embed(0.0, bottom + 4.0, &svg);
    Ok(d.finish(bottom + 440.0, "Fig. 6: an occluded marker"))
}
