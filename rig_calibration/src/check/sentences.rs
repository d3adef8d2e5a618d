//! What is wrong and what to do, in words.

use super::{
    findings::{Finding, Tilts, Verdict},
    groups::{Cause, Group},
};
use crate::parameters::Parameters;
use rig_model::MarkerColor;

pub(super) fn name(cause: Cause) -> &'static str {
    match cause {
        Cause::CameraTilt | Cause::CameraYaw => "camera.orientation",
        Cause::CameraPlace => "camera.position",
        Cause::ImuTurn => "imu.orientation",
        Cause::ImuPlace => "imu.position",
        Cause::Marker(i) => {
            ["markers.red", "markers.green", "markers.blue", "markers.yellow"][i.min(3)]
        }
        Cause::Focal => "camera_info: focal length",
        Cause::Principal => "camera_info: principal point",
        Cause::Distortion => "camera_info: distortion",
        Cause::LayoutScale => "markers: scale",
        Cause::RailX => "climber.rail_x scale",
        Cause::RailY => "climber.rail_y scale",
        Cause::TurnScale => "climber.turn scale",
        Cause::GyroScale => "gyroscope scale",
        Cause::AccelerometerScale => "accelerometer scale",
        Cause::ClimberClock => "climber clock",
        Cause::ImuClock => "imu clock",
        Cause::Readout => "clock.image_readout",
        Cause::Carriage => "carriage tilt by acceleration",
    }
}

/// Sentence and remedy of a cause.
pub(super) fn finding(
    group: &Group,
    verdict: Verdict,
    file: &Parameters,
    total: &dyn Fn(usize) -> f64,
    alternatives: &[Cause],
    tilts: Tilts,
) -> Finding {
    let of = |k: usize| total(group.first + k) * group.unit.1;
    let percent = || format!("{:+.1} %", 100.0 * total(group.first).exp_m1());
    let vector = || {
        let parts: Vec<String> =
            (0..group.count.min(3)).map(|k| format!("{:+.1}", of(k))).collect();
        format!("({}) {}", parts.join(", "), group.unit.0)
    };
    let (mut text, remedy) = match group.cause {
        Cause::CameraTilt => (
            format!("camera.orientation is tilted by {} about the climber's x and y", vector()),
            "run `volant calibrate rig`, or level the camera",
        ),
        Cause::CameraYaw => (
            format!(
                "camera.orientation is turned by {:+.1}° about the vertical, or the zero of the joint `turn` is off by it",
                of(0)
            ),
            "correct camera.orientation in the rig file, or `zero.turn` of climber_driver",
        ),
        Cause::CameraPlace => (
            format!("camera.position is off by {}", vector()),
            "measure the camera's place on the climber from the axis of its turn",
        ),
        Cause::ImuTurn => (
            format!("imu.orientation is off by {} about the platform's x, y, z", vector()),
            "run `volant calibrate rig`, or mount the IMU parallel to the platform",
        ),
        Cause::ImuPlace => (
            format!("imu.position is off by {}", vector()),
            "measure from the platform's origin to the IMU, in meters",
        ),
        Cause::Marker(i) => (
            format!("the {} marker is off by {}", MarkerColor::ALL[i.min(3)], vector()),
            "measure this marker's place on the platform again",
        ),
        Cause::Focal => (
            format!(
                "camera_info: the focal length is off: it would be right changed by {}",
                percent()
            ),
            "run `volant calibrate camera`; was camera_info made for another resolution or lens?",
        ),
        Cause::Principal => (
            format!("camera_info: the principal point is off by {}", vector()),
            "run `volant calibrate camera`; are the images cropped?",
        ),
        Cause::Distortion => (
            "camera_info: the distortion coefficients do not fit the images".to_owned(),
            "run `volant calibrate camera`; the order is k1, k2, p1, p2, k3 (plumb_bob) or k1, k2, \
             k3, k4 (equidistant)",
        ),
        Cause::LayoutScale => (
            format!(
                "the marker layout has the wrong size: it would be right changed by {}",
                percent()
            ),
            "measure the distances between the markers again; was the sheet printed to scale?",
        ),
        Cause::RailX | Cause::RailY | Cause::TurnScale => {
            let joint = match group.cause {
                Cause::RailX => "rail_x",
                Cause::RailY => "rail_y",
                _ => "turn",
            };
            (
                format!(
                    "the scale of the joint `{joint}` is off: true motion is {:.4} of its reading",
                    1.0 + total(group.first)
                ),
                "correct the joint's scale in climber_driver's parameters (`volant calibrate climber`)",
            )
        }
        Cause::GyroScale | Cause::AccelerometerScale => (
            format!("the {} is off by {}", name(group.cause), vector()),
            "check the IMU's unit and range; have it calibrated",
        ),
        Cause::ClimberClock => (
            format!(
                "the encoders' stamps are {:+.1} ms from the images', and clock.climber_offset is \
                 {} s",
                -(of(0) + group.unit.1 * file.climber_clock),
                file.climber_clock
            ),
            "stamp the encoders when they are sampled, or correct clock.climber_offset",
        ),
        Cause::Carriage => (
            format!(
                "the carriage tilts when it accelerates: by {:.2}° per m/s² along x and {:.2}° along \
                 y, up to {:.2}° in this recording",
                of(0),
                of(1),
                tilts.largest.to_degrees()
            ),
            "stiffen it, or declare twice the tilt at its full acceleration as \
             markers.camera_tilt_sigma (rad) of pose_fusion",
        ),
        Cause::ImuClock => (
            format!("the IMU's stamps are {:+.1} ms from the images'", of(0)),
            "synchronize the clocks, or stamp the images at mid-exposure",
        ),
        Cause::Readout => {
            let readout = file.readout + total(group.first);
            if readout.abs() < group.sizes[0] {
                let text = format!(
                    "the images show no rolling shutter, but clock.image_readout is {} s",
                    file.readout
                );
                (text, "set clock.image_readout of pose_fusion to 0")
            } else {
                let text = format!(
                    "the camera has a rolling shutter: it takes {readout:.4} s from the first row to \
                     the last, and clock.image_readout is {} s",
                    file.readout
                );
                (text, "set clock.image_readout of pose_fusion to it, or use a global shutter")
            }
        }
    };
    if !alternatives.is_empty() {
        let names: Vec<&str> = alternatives.iter().map(|c| name(*c)).collect();
        text = format!("{text} (or {})", names.join(", "));
    }
    Finding { verdict, ..Finding::wrong(name(group.cause), text, remedy) }
}
