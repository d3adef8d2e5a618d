//! Fig. 9: the inertial unit's translation at rest, with and without threshold control.

use super::{Made, PaperError, write};
use crate::{
    accuracy::{Track, inertial_alone},
    live::Scenario,
    report::colours,
    rig::{
        inertial::{Message, Sensors},
        motion::MotionConfig,
    },
};
use nalgebra::Vector3;
use plotters::prelude::*;
use rig_model::ImuSample;
use std::{fmt::Write, path::Path};

/// The published threshold, m/s.
const LITERAL: f64 = 1e-5;
/// How long it is watched, s.
const SECONDS: f64 = 20.0;
/// A position that is off by less than this after that time is held, mm.
const HELD: f64 = 1.0;

/// Makes `fig-9.csv` and `fig-9.svg`.
///
/// # Errors
/// The scenario, or a place that cannot be written to.
pub fn figure_9(seed: u64, folder: &Path) -> Result<Made, PaperError> {
    let scenario = Scenario::new(MotionConfig { duration: SECONDS, ..MotionConfig::rest(seed) })?;
    let samples: Vec<ImuSample> =
        Sensors::new(&scenario.motion, &scenario.rig, &scenario.camera, &scenario.sensors)
            .imu()
            .into_iter()
            .filter_map(|(_, m)| if let Message::Imu(s) = m { Some(s) } else { None })
            .collect();
    let epoch = scenario.sensors.epoch;
    let start = (epoch, scenario.motion.world_from_volant(0.0));
    let with = |threshold: f64| -> Track {
        inertial_alone(&samples, &scenario.rig.imu.volant_from_imu, &start, Vector3::zeros(), threshold)
    };
    let off = |track: &Track| -> Vec<(f64, f64)> {
        track
            .iter()
            .map(|(at, pose)| {
                // The unit's attitude wanders, and with it the lever to the platform's origin: that is no drift.
                let lever = scenario.rig.imu.volant_from_imu.translation.vector;
                let place = (pose * nalgebra::Point3::from(lever)).coords;
                let truth = (start.1 * nalgebra::Point3::from(lever)).coords;
                (at.seconds_since(epoch), (place - truth).norm() * 1e3)
            })
            .collect()
    };
    let furthest = |curve: &[(f64, f64)]| curve.iter().map(|(_, d)| *d).fold(0.0, f64::max);
    let (without, literal) = (off(&with(0.0)), off(&with(LITERAL)));
    // The smallest of a fine ladder of thresholds that holds the position from there on.
    let mut smallest = LITERAL;
    let mut held = literal.clone();
    while furthest(&held) > HELD && smallest < 1.0 {
        smallest *= 1.05;
        held = off(&with(smallest));
    }
    let mut csv =
        String::from("seconds,without_mm,literal_1e-5_mm,smallest_that_holds_mm,smallest_threshold_m_s\n");
    for ((a, b), c) in without.iter().zip(&literal).zip(&held) {
        let _ = writeln!(csv, "{:.4},{:.4},{:.4},{:.4},{smallest:.3e}", a.0, a.1, b.1, c.1);
    }
    let path = folder.join("fig-9.csv");
    write(&path, &csv)?;
    let svg = folder.join("fig-9.svg");
    draw(&svg, &without, &literal, &held, smallest)
        .map_err(|e| PaperError::Drawing(format!("{}: {e}", svg.display())))?;
    let words = format!(
        "The unit lies still for {SECONDS:.0} s. Without threshold control its doubly integrated accelerations drift \
         {:.2} m off. The literal threshold of 1e-5 m/s leaves {:.2} m: a sample's velocity change by noise, bias and the attitude's error \
         alone is tens of times larger, so it hardly ever fires. The smallest threshold that holds the position (to {HELD:.0} mm) is \
         {smallest:.1e} m/s a sample, i.e. {:.2} m/s², which hides slow motion as well. Published: the control removes \
         most of the drift; with raw samples that needs the larger threshold.",
        furthest(&without) / 1e3,
        furthest(&literal) / 1e3,
        smallest * scenario.sensors.imu_rate,
    );
    Ok(Made {
        name: "fig-9",
        title: "Fig. 9: translation at rest, with and without threshold control",
        csv: path,
        svg: Some(svg),
        words,
    })
}

fn draw(
    path: &Path,
    without: &[(f64, f64)],
    literal: &[(f64, f64)],
    held: &[(f64, f64)],
    smallest: f64,
) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(path, (900, 460)).into_drawing_area();
    root.fill(&WHITE)?;
    // A logarithmic scale: the curves are orders of magnitude apart.
    let mut chart = ChartBuilder::on(&root)
        .margin(14)
        .x_label_area_size(40)
        .y_label_area_size(70)
        .caption("Fig. 9: translation of a unit at rest", ("sans-serif", 20))
        .build_cartesian_2d(0.0..SECONDS, (0.01..30_000.0).log_scale())?;
    chart
        .configure_mesh()
        .light_line_style(TRANSPARENT)
        .bold_line_style(RGBColor(225, 225, 225))
        .x_desc("time [s]")
        .y_desc("distance from the start [mm]")
        .x_label_formatter(&|t| format!("{t:.0}"))
        .draw()?;
    for (curve, name, colour, width) in [
        (without, "without threshold".to_owned(), colours::CAMERA, 4),
        (literal, "1e-5 m/s, as published".to_owned(), colours::INERTIAL, 2),
        (held, format!("{smallest:.1e} m/s, the smallest that holds"), colours::FUSED, 2),
    ] {
        let points = curve.iter().step_by(5).map(|(t, d)| (*t, d.max(0.01)));
        chart
            .draw_series(LineSeries::new(points, colour.stroke_width(width)))?
            .label(name)
            .legend(move |(x, y)| PathElement::new(vec![(x, y), (x + 22, y)], colour.stroke_width(width)));
    }
    chart
        .configure_series_labels()
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.85))
        .label_font(("sans-serif", 14))
        .draw()?;
    root.present()?;
    Ok(())
}
