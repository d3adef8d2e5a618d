//! Fig. 9: the translation of a stationary IMU, with and without threshold control.

use super::{Made, Value};
use crate::{
    accuracy::{THRESHOLD, Track, inertial_alone},
    live::Scenario,
};
use anyhow::Result;
use nalgebra::{Isometry3, Point3};
use rig_simulator::motion::MotionConfig;
use std::fmt::Write;
use volant::report::{Axis, Panel, Series, Shape, Sheet, Table, colors, panels};

/// How long it is watched, s.
const SECONDS: f64 = 20.0;
/// A position that is off by less than this after that time is held, mm.
const HELD: f64 = 1.0;

pub fn figure_9(seed: u64) -> Result<Made> {
    let scenario = Scenario::new(MotionConfig { duration: SECONDS, ..MotionConfig::rest(seed) })?;
    let samples = scenario.simulated_sensors().imu_samples();
    let epoch = scenario.sensors.epoch;
    let start = (epoch, scenario.motion.world_from_volant(0.0));
    let with = |threshold: f64| inertial_alone(&scenario, &samples, &start, threshold);
    // The IMU's attitude error varies, and with it the lever arm to the platform's origin: that is
    // not drift.
    let lever = Point3::from(scenario.rig.imu.volant_from_imu.translation.vector);
    let truth = start.1 * lever;
    let off = |track: &Track| -> Vec<(f64, f64)> {
        let off = |pose: &Isometry3<f64>| (pose * lever - truth).norm() * 1e3;
        track.iter().map(|(at, pose)| (at.seconds_since(epoch), off(pose))).collect()
    };
    let furthest = |curve: &[(f64, f64)]| curve.iter().map(|(_, d)| *d).fold(0.0, f64::max);
    let (without, literal) = (off(&with(0.0)), off(&with(THRESHOLD)));
    // The smallest of a fine ladder of thresholds that holds the position from there on.
    let mut smallest = THRESHOLD;
    let mut held = literal.clone();
    while furthest(&held) > HELD && smallest < 1.0 {
        smallest *= 1.05;
        held = off(&with(smallest));
    }
    let mut csv = String::from(
        "seconds,without_mm,literal_1e-5_mm,smallest_that_holds_mm,smallest_threshold_m_s\n",
    );
    for ((a, b), c) in without.iter().zip(&literal).zip(&held) {
        let _ = writeln!(csv, "{:.4},{:.4},{:.4},{:.4},{smallest:.3e}", a.0, a.1, b.1, c.1);
    }
    let row = |threshold: &str, curve: &[(f64, f64)]| {
        [threshold.to_owned(), format!("{:.1}", furthest(curve))]
    };
    Ok(Made {
        name: "fig-9",
        title: "Fig. 9: translation while stationary, with and without threshold control",
        csv,
        svg: draw(&without, &literal, &held, smallest)?,
        table: Some(Table::new(
            &format!("threshold | furthest within {SECONDS:.0} s [mm]"),
            [
                row("none", &without),
                row("1e-5 m/s, as published", &literal),
                row(&format!("{smallest:.1e} m/s, the smallest that holds"), &held),
            ],
        )),
        values: vec![
            Value::new(
                "threshold that holds the position [m/s]",
                "1e-5",
                format!("{smallest:.1e}"),
            ),
            Value::new(
                &format!("drift that the published threshold leaves after {SECONDS:.0} s"),
                "most of it removed",
                format!("{:.0} %", 100.0 * furthest(&literal) / furthest(&without)),
            ),
        ],
        shows: format!(
            "The IMU is stationary for {SECONDS:.0} s. Without threshold control its doubly \
             integrated accelerations drift {:.2} m off. The literal threshold of 1e-5 m/s leaves \
             {:.2} m. The smallest threshold that holds the position (to {HELD:.0} mm) is \
             {smallest:.1e} m/s a sample.",
            furthest(&without) / 1e3,
            furthest(&literal) / 1e3,
        ),
        published: format!(
            "The published control removes most of the drift. On raw samples at {:.0} Hz it \
             does not: 1e-5 m/s a sample is {:.3} m/s², and a sample's noise, bias and the \
             attitude's error alone are tens of times larger, so it hardly ever triggers. The \
             smallest threshold that holds corresponds to {:.2} m/s² and hides slow motion as \
             well.",
            scenario.sensors.imu_rate,
            THRESHOLD * scenario.sensors.imu_rate,
            smallest * scenario.sensors.imu_rate,
        ),
    })
}

fn draw(
    without: &[(f64, f64)],
    literal: &[(f64, f64)],
    held: &[(f64, f64)],
    smallest: f64,
) -> Result<String> {
    let line = |name: &str, color, width, curve: &[(f64, f64)]| {
        // The scale is logarithmic: the curves are orders of magnitude apart.
        let points = curve.iter().step_by(5).map(|(t, d)| (*t, d.max(0.01)));
        Series::new(name, color, Shape::Line(width), points)
    };
    let panel = Panel {
        title: String::new(),
        x: Axis::new("time [s]", [0.0, SECONDS], false),
        y: Axis::new("distance from the start [mm]", [0.01, 30_000.0], true),
        series: vec![
            line("without threshold", colors::CAMERA, 5, without),
            line("1e-5 m/s, as published", colors::INERTIAL, 2, literal),
            line(&format!("{smallest:.1e} m/s, the smallest that holds"), colors::FUSED, 2, held),
        ],
    };
    let title = "Fig. 9: translation of a stationary IMU, doubly integrated";
    Ok(panels(Sheet { title, size: (1120, 520), grid: (1, 1) }, &[panel])?)
}
