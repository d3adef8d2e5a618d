//! Fig. 6: a marker is covered while the platform swings: its states in the tracker, and the pose
//! with and without its predicted position (eq. 3).

use super::{
    Made, Value,
    offline::{filter, fuse, record, track},
    stages::{chart_color, rgb_of},
};
use crate::{
    accuracy::{Track, distance},
    live::{ImageSequence, Scenario},
};
use anyhow::{Context, Result};
use marker_tracker::TrackerConfig;
use nalgebra::Vector2;
use pose_fusion::Model;
use rig_model::{MarkerColor, MarkerObservations, MarkerState};
use std::fmt::Write;
use volant::report::{Anchor, Axis, Drawing, Panel, Series, Shape, Sheet, colors, panels};

const TITLE: &str = "Fig. 6: an occluded marker";
/// Length of the run, s.
const SECONDS: f64 = 8.0;
/// Names in the legend.
const WITH: &str = "published pose with eq. 3";
const WITHOUT: &str = "published pose without eq. 3";

pub fn figure_6(seed: u64, threads: usize, progress: impl Fn(f64) + Sync) -> Result<Made> {
    let scenario = Scenario::swing(seed, SECONDS)?;
    let images = ImageSequence::render(&scenario, threads, |done, of| {
        progress(done as f64 / of.max(1) as f64)
    })
    .context("an image")?;
    let observed = track(&scenario, &images, TrackerConfig::default())?;
    let mean_flow = TrackerConfig { rigid_prediction: false, ..TrackerConfig::default() };
    let as_published = track(&scenario, &images, mean_flow)?;
    let cover = scenario.covers.first().copied().context("nothing is covered")?;
    let run = |observed: &[MarkerObservations], model| {
        fuse(&scenario, &record(&scenario, observed.to_vec()), filter(&scenario, model))
    };
    let places = [&observed, &as_published].map(|o| place_errors(&scenario, o, cover.color));
    // The published pose with and without the predicted position, and the default filter's.
    let poses = [
        run(&as_published, Model::Paper)?.visual,
        run(&without_predicted(&as_published), Model::Paper)?.visual,
        run(&observed, Model::Tight)?.fused,
    ]
    .map(|track| errors(&scenario, &track));
    let [with, without, fused] = &poses;
    let mut csv = String::from(concat!(
        "seconds,state,place_error_px,place_error_mean_flow_px,",
        "with_eq_3_mm,with_eq_3_deg,without_eq_3_mm,without_eq_3_deg,fused_mm,fused_deg\n"
    ));
    for (ours, mean) in places[0].iter().zip(&places[1]) {
        let _ = write!(csv, "{:.4},{}", ours.0, format!("{:?}", ours.1).to_lowercase());
        let errors = poses.iter().flat_map(|rows| at(rows, ours.0));
        for v in [ours.2, mean.2].into_iter().chain(errors) {
            if v.is_finite() {
                let _ = write!(csv, ",{v:.4}");
            } else {
                csv.push(',');
            }
        }
        csv.push('\n');
    }
    let [from, to] = cover.seconds;
    // Images whose hidden marker has a predicted position.
    let predicted = |places: &[Place]| -> Vec<Place> {
        let it = |p: &&Place| p.1 == MarkerState::Predicted && p.2.is_finite();
        places.iter().filter(it).copied().collect()
    };
    let times: Vec<f64> = predicted(&places[1]).iter().map(|p| p.0).collect();
    let rms = |rows: &[[f64; 3]], column: usize| {
        let errors = times.iter().map(|t| at(rows, *t)[column]);
        root_mean_square(errors.filter(|v| v.is_finite()))
    };
    let before = |rows: &[[f64; 3]], column: usize| {
        let rows = rows.iter().filter(|r| r[0] > 1.0 && r[0] < from - 0.4);
        root_mean_square(rows.map(|r| r[column + 1]))
    };
    let worst = |places: &[Place]| predicted(places).iter().map(|p| p.2).fold(0.0, f64::max);
    let back = places[0]
        .iter()
        .find(|p| p.0 > to && p.1 == MarkerState::Detected)
        .map_or(f64::NAN, |p| p.0 - to);
    let cell = |rows: &[[f64; 3]]| format!("{:.2} mm, {:.3}°", rms(rows, 0), rms(rows, 1));
    let visible = format!("{:.2} mm, {:.3}°", before(with, 0), before(with, 1));
    Ok(Made {
        name: "fig-6",
        title: TITLE,
        csv,
        svg: draw(&scenario, &images, &observed, &places, &poses)?,
        table: None,
        values: vec![
            Value::new("images with a predicted position", "6", times.len().to_string()),
            Value::new("pose from one image, four visible markers (RMS)", "–", visible),
            Value::new("the same in those images, with eq. 3 (RMS)", "barely changed", cell(with)),
            Value::new("the same without eq. 3, three markers (RMS)", "–", cell(without)),
            Value::new("default filter (RMS)", "–", cell(fused)),
        ],
        shows: format!(
            "A plank slides over the {} marker for {:.1} s. The tracker reports it as PREDICTED in \
             {} images, placed by the others' flow, then LOST, and measures it again {:.0} ms \
             after the plank begins to slide away (which takes 300 ms). The panels compare the \
             published pose with the predicted position as fourth marker and without it.",
            cover.color,
            to - from,
            times.len(),
            1e3 * back,
        ),
        published: format!(
            "Eq. 3 moves the hidden marker by the mean flow of the visible ones, which leaves out \
             the platform's turn: at worst {:.1} px off within these images. The default tracker \
             carries the others' flow over as a rigid motion: {:.1} px at worst. The published \
             pose uses the predicted position as if it were measured, so its error goes into the \
             pose, while three markers continue from the previous pose. The default filter never \
             uses a predicted position; it uses the pixels of the three visible markers.",
            worst(&places[1]),
            worst(&places[0]),
        ),
    })
}

/// The error in mm and degrees at an image, NaN where there is no pose.
fn at(rows: &[[f64; 3]], t: f64) -> [f64; 2] {
    let near = rows.iter().min_by(|a, b| (a[0] - t).abs().total_cmp(&(b[0] - t).abs()));
    near.filter(|r| (r[0] - t).abs() < 0.01).map_or([f64::NAN; 2], |r| [r[1], r[2]])
}

/// The same observations without the predicted positions.
fn without_predicted(observed: &[MarkerObservations]) -> Vec<MarkerObservations> {
    let mut observed = observed.to_vec();
    for marker in observed.iter_mut().flat_map(|o| o.markers.0.iter_mut()) {
        if marker.state == MarkerState::Predicted {
            marker.state = MarkerState::Lost;
            marker.centroid = Vector2::repeat(f64::NAN);
        }
    }
    observed
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
                scenario.true_centroid(color, t).map_or(f64::NAN, |p| (m.centroid - p).norm());
            (t, m.state, error)
        })
        .collect()
}

/// Seconds, mm and degrees.
fn errors(scenario: &Scenario, track: &Track) -> Vec<[f64; 3]> {
    track
        .iter()
        .map(|(at, pose)| {
            let t = at.seconds_since(scenario.sensors.epoch);
            let [mm, degrees] = distance(pose, &scenario.motion.world_from_volant(t));
            [t, mm, degrees]
        })
        .collect()
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let squares: Vec<f64> = values.map(|v| v * v).collect();
    (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
}

fn draw(
    scenario: &Scenario,
    images: &ImageSequence,
    observed: &[MarkerObservations],
    places: &[Vec<Place>; 2],
    [with, without, fused]: &[Vec<[f64; 3]>; 3],
) -> Result<String> {
    let cover = scenario.covers[0];
    let [from, to] = cover.seconds;
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, TITLE);
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
        let frame = images.frames.get(index).context("an image is missing")?;
        let image = marker_tracker::decode_compressed("jpeg", &frame.jpeg).context("an image")?;
        let x = 24.0 + (wide + 10.6) * k as f64;
        let high = wide * image.height as f64 / image.width as f64;
        bottom = top + high;
        let name = format!("{:.2} s: {name}", frame.seconds);
        d.text(x, top - 12.0, 15.0, colors::INK, Anchor::Start, &name);
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
    let span = [from - 1.0, to + 0.7];
    let time = || Axis::new("time [s]", span, false);
    let of = |name: &str, color, shape, places: &[Place], state: MarkerState| {
        let error = |p: &Place| (p.0, if p.1 == state { p.2 } else { f64::NAN });
        Series::new(name, color, shape, places.iter().map(error))
    };
    // Without a line across more than two images that have no pose.
    let column = |rows: &[[f64; 3]], c: usize| -> Vec<(f64, f64)> {
        let mut points = Vec::with_capacity(rows.len());
        let mut last = f64::NEG_INFINITY;
        for r in rows.iter().filter(|r| r[0] >= span[0]) {
            if r[0] - last > 0.08 && last.is_finite() {
                points.push((r[0], f64::NAN));
            }
            last = r[0];
            points.push((r[0], r[c]));
        }
        points
    };
    let covered = |high: f64, low: f64| {
        let ends = [(from, low), (from, high), (f64::NAN, f64::NAN), (to, low), (to, high)];
        Series::new("covered", colors::AXIS, Shape::Line(1), ends)
    };
    let errors = |title: &str, unit: &str, c: usize| {
        // Space for the largest error of the span.
        let within = |r: &&[f64; 3]| (span[0]..span[1]).contains(&r[0]);
        let rows = with.iter().chain(without).filter(within);
        let top = 1.2 * rows.map(|r| r[c]).fold(0.1, f64::max);
        Panel {
            title: title.into(),
            x: time(),
            y: Axis::new(format!("error [{unit}]"), [0.0, top], false),
            series: vec![
                covered(top, 0.0),
                Series::new(WITHOUT, colors::CAMERA, Shape::Line(3), column(without, c)),
                Series::new(WITH, colors::PAPER, Shape::Line(1), column(with, c)),
                Series::new("default filter", colors::FUSED, Shape::Line(2), column(fused, c)),
            ],
        }
    };
    let [rigid, mean] = places;
    let (detected, predicted) = (MarkerState::Detected, MarkerState::Predicted);
    let position = Panel {
        title: format!("reported position of the {} marker", cover.color),
        x: time(),
        y: Axis::new("off the truth [px]", [0.001, 30.0], true),
        series: vec![
            covered(30.0, 0.001),
            of("detected", chart_color(cover.color), Shape::Dots, rigid, detected),
            of("predicted, rigid motion", colors::VIOLET, Shape::Dotted, rigid, predicted),
            of("predicted, mean flow (eq. 3)", colors::PAPER, Shape::Dotted, mean, predicted),
        ],
    };
    let svg = panels(
        Sheet { title: "", size: (1120, 430), grid: (1, 3) },
        &[position, errors("translation", "mm", 1), errors("rotation", "deg", 2)],
    )?;
    d.embed(0.0, bottom + 4.0, &svg);
    Ok(d.finish(bottom + 440.0, TITLE))
}
