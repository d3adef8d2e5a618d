//! Steps in which the rig moves: encoders, mountings, clocks.

use super::{Walk, dialog, inputs, setup};
use crate::calibrate::{self, Output};
use anyhow::Result;
use nalgebra::Vector3;
use node_kit::outln;
use rig_calibration::{Refinement, climber::AXES};
use rig_model::topics;
use ros_parameters::ParameterFile;
use volant::parameter_update::{FUSION, Setting, number};

/// Position of a platform on the floor, m: the origin below it.
const RESTING: [f64; 3] = [0.0, 0.0, 0.1];

/// Largest coordinate of that position, m: rejects millimeters.
const LARGEST_POSITION: f64 = 50.0;

/// Item of a jog that has determined the camera's mounting.
const CORRECTED: &str = "camera mounting corrected";

/// Parameter of the climber's time offset.
const OFFSET: &str = "clock.climber_offset";

/// Topics of a recording in which the rig moves.
pub const MOTION: [&str; 6] = [
    topics::COMPRESSED_IMAGE,
    topics::MARKERS,
    topics::CAMERA_INFO,
    topics::JOINT_STATES,
    topics::CLIMBER_TRANSFORM,
    topics::IMU,
];

/// Names, signs, scales, zeros, height.
pub fn encoders(walk: &mut Walk) -> Result<()> {
    outln!(
        "  Lower the platform onto the floor, in view of the camera. Turn the climber to within 45 \
         degrees of where its turn shall be zero. Then jog one axis after the other back and \
         forth, as far as the platform stays in view."
    )?;
    outln!(
        "  Where is the platform's origin in the world while it rests, m? For an origin on the \
         floor below it: 0 0 Z with its height Z above the floor."
    )?;
    let platform: Vector3<f64> = dialog::numbers("  x y z", RESTING, |platform| {
        let near = platform.iter().all(|x| x.abs() <= LARGEST_POSITION);
        let [x, y, z] = platform;
        if near { Ok(()) } else { Err(format!("the position is {x} {y} {z} m: give it in meters")) }
    })?
    .into();
    let bag = walk.recording("jog", &MOTION[..4], 60.0)?;
    let topics = walk.topics(&bag, inputs::JOG)?;
    let found = calibrate::climber::run(&calibrate::climber::Arguments {
        bag: Some(bag),
        live: false,
        duration: 0.0,
        rig: walk.rig.clone(),
        params_file: None,
        node: calibrate::climber::NODE.to_owned(),
        platform: Some(platform),
        camera: true,
        topics,
        output: Output::default(),
    })?;
    let text = node_kit::files::read_text(&walk.rig)?;
    let present = ParameterFile::parse(&text)?.for_node(calibrate::climber::NODE);
    for (axis, name) in found.axes.iter().zip(AXES) {
        match axis {
            Some(axis) => {
                let zero = axis.zero.map_or("unobservable".to_owned(), |z| format!("{:.6}", z.0));
                walk.check(
                    axis.zero.is_some(),
                    name,
                    format!("joint {}, scale {:.6e}, zero {zero}", axis.joint, axis.scale.0),
                )?;
            }
            None if calibrate::climber::is_absent(&present, name) => {
                walk.note(name, "the climber has no such axis")?
            }
            None => walk.check(
                false,
                name,
                format!(
                    "unobservable: it did not move; survey it, or jog it; where the climber has no \
                     such axis, set joints.{name} of climber_driver to \"\" in the rig file"
                ),
            )?,
        }
    }
    if let Some((height, sigma)) = found.height {
        walk.check(sigma < 0.02, "height", format!("{height:.4} +- {sigma:.4} m"))?;
    }
    if let (Some([x, y]), Some([roll, pitch])) = (found.camera_offset, found.camera_tilt) {
        let (across, tilt) = (1e3 * x.1.max(y.1), roll.1.max(pitch.1).to_degrees());
        let text = format!("position +- {across:.1} mm, tilt +- {tilt:.2} deg");
        walk.note(CORRECTED, text)?;
    }
    let text = format!("{:.2} px RMS", found.pixel_rms);
    walk.check(found.pixel_rms < 2.0, "residual", text)
}

/// Mountings and marker positions.
pub fn mounting(walk: &mut Walk) -> Result<()> {
    outln!(
        "  Lift the platform. With the new encoder parameters, record a minute of free motion: let \
         it swing by 15 degrees about both horizontal axes and turn it back and forth, while the \
         climber drives along both rails and turns."
    )?;
    let bag = walk.recording("swing", &MOTION, 60.0)?;
    let topics = walk.topics(&bag, inputs::MOTION)?;
    // The jog has determined the camera's mounting.
    let encoders = walk.state.steps.get("encoders");
    let jogged = encoders.is_some_and(|s| s.items.iter().any(|i| i.name == CORRECTED));
    let found = calibrate::rig::run(&calibrate::rig::Arguments {
        bag,
        rig: walk.rig.clone(),
        params_file: vec![],
        hold_camera: jogged,
        topics,
        output: Output::default(),
    })?;
    let clock = |name: &str| {
        let row = found.rows.iter().find(|r| r.name == name);
        row.map(|r| (r.change, r.deviation))
    };
    let clocks = clock("camera clock against imu").zip(clock("climber clock against camera"));
    walk.state.clocks = clocks.map(|(camera, climber)| [camera, climber]);
    let text = format!("{:.3} px RMS", found.pixel_rms);
    walk.check(found.pixel_rms < 1.0, "residual", text)?;
    for row in &found.rows {
        let mounting = row.name.starts_with("camera ") || row.name.starts_with("imu ");
        if !mounting || row.name.contains("clock") {
            continue;
        }
        let text = match row.refinement {
            Refinement::Refined => {
                format!("changed by {:+.3} +- {:.3} {}", row.change, row.deviation, row.unit)
            }
            Refinement::Agrees => "agrees with this motion: as measured".to_owned(),
            Refinement::Undetermined if jogged && row.name.starts_with("camera ") => {
                "as the jog has found it".to_owned()
            }
            Refinement::Undetermined => "unobservable in this motion: as measured".to_owned(),
        };
        walk.note(&row.name, text)?;
    }
    Ok(())
}

/// Clocks of camera and climber against the IMU's.
pub fn offsets(walk: &mut Walk) -> Result<()> {
    let Some([camera, climber]) = walk.state.clocks else {
        return walk.check(false, "clocks", "unknown: run the step mounting");
    };
    walk.check(
        camera.0.abs() < 250.0,
        "camera",
        format!(
            "image stamp {:+.2} +- {:.2} ms = IMU time (250 at most: the filter finds up to 300)",
            camera.0, camera.1
        ),
    )?;
    // Image and encoder share a clock unless a constant is configured.
    let (apart, sigma) = climber;
    let text = format!("encoder stamp {apart:+.2} +- {sigma:.2} ms = image stamp");
    if sigma > 3.0 {
        return walk.note("encoders", format!("{text}: unobservable, the climber hardly moved"));
    }
    let needed = apart.abs() > (3.0 * sigma).max(2.0);
    let known = ParameterFile::parse(&setup::read(&walk.rig)?)?.for_node(FUSION);
    // An offset that was needed before is not kept.
    if !needed && !known.contains_key(OFFSET) {
        return walk.check(true, "encoders", text);
    }
    let value = number(if needed { apart / 1e3 } else { 0.0 }, 4);
    let text = format!("{text}: {OFFSET} is {value} s");
    setup::set(walk, &[Setting { node: FUSION.to_owned(), name: OFFSET.to_owned(), value }])?;
    walk.check(true, "encoders", text)
}
