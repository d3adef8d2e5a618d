//! Steps of the first hour: measured lengths, printed markers, the IMU at rest.

use super::{Walk, dialog, inputs};
use crate::{
    calibrate::{self, Output, read_rig},
    markers, settings,
};
use anyhow::{Context, Result};
use nalgebra::{UnitQuaternion, Vector3};
use node_kit::{files, outln};
use rig_calibration::allan::Sensor;
use rig_model::{MarkerColor, Rig, topics};
use ros_parameters::{ParameterFile, ParameterValue};
use std::{path::Path, process::Command};
use volant::parameter_update::{
    self, ENCODER_SCALE_SIGMA, FUSION, LAYOUT_SIGMA, MARKER_SIGMA, MOUNTING_SIGMA, RIG, Setting,
    list, number, update,
};

/// Rig file of a common rig.
const TEMPLATE: &str = include_str!("../../../../../launch_config/config/rig.yaml");

/// Standard deviation of a center that a steel rule measures, mm.
const MEASURED: f64 = 0.5;
/// Standard deviations of a center that are possible, mm.
const POSSIBLE: std::ops::RangeInclusive<f64> = 0.01..=20.0;
/// Standard deviation of a mounting whose orientation is a multiple of 90°, rad: 1°.
const UNALIGNED: f64 = 0.0175;
/// Sides of the squares, mm: those that the rig file accepts.
const SIDES: std::ops::RangeInclusive<f64> = 5.0..=500.0;

/// The template without what must be measured: the climber's height.
fn template() -> &'static str {
    TEMPLATE.split_once("/**/climber_driver").map_or(TEMPLATE, |(rig, _)| rig)
}

/// The text of the rig file, without unknown keys: a misspelled one is not a missing one. Empty
/// where there is no file yet.
pub fn read(path: &Path) -> Result<String> {
    if !path.exists() {
        return Ok(String::new());
    }
    let text = files::read_text(path).with_context(|| path.display().to_string())?;
    if !is_blank(&text) {
        settings::check_given(path)?;
    }
    Ok(text)
}

/// Whether there are at most comments.
fn is_blank(text: &str) -> bool {
    text.lines().map(str::trim_start).all(|line| line.is_empty() || line.starts_with('#'))
}

/// Creates the rig file, or adds the keys that it lacks with the values of a common rig.
pub fn complete(path: &Path) -> Result<()> {
    let shown = || path.display().to_string();
    let text = read(path)?;
    if is_blank(&text) {
        return Ok(files::write(path, (text + template()).as_bytes(), true)?);
    }
    let present = ParameterFile::parse(&text).with_context(shown)?.for_node(RIG);
    let missing: Vec<Setting> = ParameterFile::parse(template())?
        .for_node(RIG)
        .into_iter()
        .filter(|(name, _)| !present.contains_key(name))
        .map(|(name, value)| Setting::rig(name, value))
        .collect();
    update(path, None, false, &missing, None).map(drop)
}

/// Writes settings of the rig file.
pub fn set(walk: &Walk, settings: &[Setting]) -> Result<()> {
    update(&walk.rig, None, false, settings, None).map(drop)
}

/// The lengths that a tape measures, and the sheets.
pub fn markers(walk: &mut Walk) -> Result<()> {
    outln!(
        "  Side of the printed squares, and their centers in the platform's frame: origin and axes \
         are yours to choose, z up. Lengths in mm."
    )?;
    let rig = read_rig(&walk.rig)?;
    let known = 1e3 * rig.markers.side;
    let [side] = dialog::numbers("  side", [known], |[side]| {
        let remedy = "give it in millimeters, 5 to 500";
        if SIDES.contains(side) { Ok(()) } else { Err(format!("the side is {side} mm: {remedy}")) }
    })?;
    if side != known {
        set(walk, &[Setting::rig("markers.size", number(side / 1e3, 6))])?;
    }
    let out = walk.file("markers.pdf");
    let (rig_file, page) = (walk.rig.clone(), markers::Page::A4);
    let sheets = markers::Arguments { rig: rig_file, out, overwrite: true, page, camera: None };
    markers::run(&sheets)?;
    walk.wrote(&sheets.out);
    outln!("  Print at 100 %, measure the bar, mount the squares, and measure their centers.")?;
    // Only what is answered is written: somebody may edit the file meanwhile.
    let mut settings = vec![];
    let mut centers = rig.markers.centers.0.map(|center| center.coords * 1e3);
    for color in MarkerColor::ALL {
        let center = &mut centers[color.index()];
        let question = format!("  {color} x y z");
        let answer: [f64; 3] = dialog::numbers(&question, (*center).into(), millimeters)?;
        if answer != <[f64; 3]>::from(*center) {
            *center = answer.into();
            settings.push(Setting::rig(format!("markers.{color}"), list(&answer.map(|c| c / 1e3))));
        }
    }
    settings.extend(precision(walk, &rig, &centers)?);
    outln!("  The camera in the climber's frame: x y z of the lens, mm; rotation as quaternion.")?;
    settings.extend(mounting("camera", &rig.climber_from_camera)?);
    outln!("  The IMU in the platform's frame.")?;
    settings.extend(mounting("imu", &rig.imu.volant_from_imu)?);
    set(walk, &settings)?;
    let turned = read_rig(&walk.rig)?.climber_from_camera.rotation;
    let same = turned.angle_to(&rig.climber_from_camera.rotation) < 1e-3;
    if !same || of_fusion(walk, MOUNTING_SIGMA)?.is_none() {
        set(walk, &[fusion(MOUNTING_SIGMA, number(UNALIGNED, 3))])?;
    }
    let [a, b] = [MarkerColor::Red, MarkerColor::Blue].map(|c| centers[c.index()]);
    walk.note("diagonal", format!("red - blue {:.1} mm: compare with a tape", (a - b).norm()))
}

/// Asks how well the centers are measured, and returns how well places and size of the layout are
/// known, and the scale of the encoders, which a jog measures in lengths of the layout. While the
/// centers stay, a calibration that knows the places better does, too.
fn precision(walk: &Walk, rig: &Rig, centers: &[Vector3<f64>; 4]) -> Result<Vec<Setting>> {
    let mean = centers.iter().sum::<Vector3<f64>>() / 4.0;
    let squares = centers.iter().map(|c| (c - mean).xy().norm_squared());
    let arms = squares.sum::<f64>().sqrt().max(1.0);
    let places = of_fusion(walk, MARKER_SIGMA)?;
    let before = of_fusion(walk, LAYOUT_SIGMA)?.map(|size| size * arms);
    let before = before.or(places.map(|known| 1e3 * known)).map(|x| (x * 100.0).round() / 100.0);
    let question = "  standard deviation of a center's x or y, mm: calipers 0.2, a steel rule 0.5, a \
                    tape 1";
    let [known] = dialog::numbers(question, [before.unwrap_or(MEASURED)], |[known]| {
        if POSSIBLE.contains(known) {
            Ok(())
        } else {
            Err(format!("{known} mm is not possible: 0.01 to 20"))
        }
    })?;
    let same =
        rig.markers.centers.0.iter().zip(centers).all(|(a, b)| (a.coords * 1e3 - b).norm() < 1e-6);
    let (own, size) = (known / 1e3, (known / arms).min(0.1));
    let mut settings = vec![];
    // Without a calibration it is what was answered before.
    let is_calibrated = |places: f64| before.is_some_and(|b| (1e3 * places - b).abs() > 0.1 * b);
    let better = |places: f64| before == Some(known) || places < own && is_calibrated(places);
    if !(same && places.is_some_and(better)) {
        settings.push(fusion(MARKER_SIGMA, number(own, 6)));
    }
    for name in [LAYOUT_SIGMA, ENCODER_SCALE_SIGMA] {
        if !(same && before == Some(known) && of_fusion(walk, name)?.is_some()) {
            settings.push(fusion(name, number(size, 3)));
        }
    }
    Ok(settings)
}

/// Setting of the fusion node.
pub fn fusion(name: &str, value: ParameterValue) -> Setting {
    Setting { node: FUSION.to_owned(), name: name.to_owned(), value }
}

/// Returns a number of the fusion node in the rig file.
pub fn of_fusion(walk: &Walk, name: &str) -> Result<Option<f64>> {
    Ok(parameter_update::of_fusion(&walk.rig, "", name)?.map(|(_, number)| number))
}

/// Rejects a position that is in meters, or beyond the rig file's limit of 100 m.
fn millimeters(position: &[f64; 3]) -> Result<(), String> {
    let largest = position.iter().map(|x| x.abs()).fold(0.0, f64::max);
    if largest == 0.0 || (1.0..=1e5).contains(&largest) {
        return Ok(());
    }
    let [x, y, z] = position;
    Err(format!("the position is {x} {y} {z} mm: give it in millimeters"))
}

/// Asks for a mounting: position (mm) and quaternion.
fn mounting(name: &str, known: &nalgebra::Isometry3<f64>) -> Result<Vec<Setting>> {
    let mut settings = vec![];
    let place: [f64; 3] = (known.translation.vector * 1e3).into();
    let position = dialog::numbers(&format!("  {name} x y z"), place, millimeters)?;
    if position != place {
        let value = list(&position.map(|c| c / 1e3));
        settings.push(Setting::rig(format!("{name}.position"), value));
    }
    let q: [f64; 4] = known.rotation.coords.into();
    let question = format!("  {name} quaternion x y z w");
    let orientation = dialog::numbers(&question, q, |q| {
        let length = nalgebra::Vector4::from(*q).norm();
        let unit = (0.9..1.1).contains(&length);
        if unit { Ok(()) } else { Err(format!("its length is {length:.3}: a rotation has 1")) }
    })?;
    if orientation != q {
        let [x, y, z, w] = orientation;
        let unit = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, x, y, z));
        let value = list(unit.coords.as_slice());
        settings.push(Setting::rig(format!("{name}.orientation"), value));
    }
    Ok(settings)
}

/// The IMU: port, rate, units, noise.
pub fn imu(walk: &mut Walk) -> Result<()> {
    outln!(
        "  Connect the IMU: with the udev rule 60-volant-imu.rules, which the Debian package \
         installs, it is /dev/volant_imu. imu_driver configures it at its start."
    )?;
    let question = "  f: find an Xsens IMU, Enter: its samples are published or recorded";
    if dialog::choose(question, &["", "f"])? == "f" {
        let found = Command::new(std::env::current_exe()?).args(["imu", "find"]).status();
        let fine = found.is_ok_and(|s| s.success());
        walk.check(fine, "port", "volant imu find: start imu_driver with -p port:=PORT")?;
    }
    outln!("  Lay the platform on the floor, fans off, and record the IMU for a minute.")?;
    let bag = walk.recording("rest", &[topics::IMU], 60.0)?;
    let mut losses = vec![];
    let topic = walk.topics(&bag, &[inputs::IMU])?.names().resolve(topics::IMU);
    let samples = calibrate::imu::read(&bag, Some(&topic), &mut losses)?;
    for loss in losses {
        walk.note("recording", loss)?;
    }
    let mean = |of: fn(&rig_model::ImuSample) -> Vector3<f64>| {
        samples.iter().map(of).sum::<Vector3<f64>>() / samples.len().max(1) as f64
    };
    let (force, rate) = (mean(|s| s.specific_force), mean(|s| s.angular_velocity));
    let g = force.norm();
    walk.check(
        (9.5..10.1).contains(&g),
        "accelerometer",
        format!("{g:.3} m/s^2 at rest (9.8 is right; 1 means g instead of m/s^2)"),
    )?;
    let rig = read_rig(&walk.rig)?;
    let up = rig.imu.volant_from_imu.rotation * force.normalize();
    let tilt = up.angle(&Vector3::z()).to_degrees();
    walk.check(
        tilt < 20.0,
        "imu.orientation",
        format!(
            "gravity is {tilt:.1} deg off the platform's z (20 is the limit on a level floor; more \
             means another mounting than entered, 180 upside down)"
        ),
    )?;
    let turn = rate.norm().to_degrees();
    walk.check(turn < 3.0, "gyroscope", format!("{turn:.2} deg/s at rest"))?;
    let plot = walk.file("allan.svg");
    let noise = calibrate::imu::run(&calibrate::imu::Arguments {
        bag,
        rig: walk.rig.clone(),
        topic: Some(topic),
        plot: Some(plot.clone()),
        output: Output { out: None, overwrite: true },
    })?;
    walk.wrote(&plot);
    walk.check(noise.rate > 45.0, "rate", format!("{:.1} Hz", noise.rate))?;
    for sensor in Sensor::ALL {
        let (density, unit) = (noise.density(sensor), sensor.unit());
        walk.note(&format!("{sensor} noise"), format!("{density:.3e} {unit}/sqrt(Hz)"))?;
    }
    Ok(())
}
