//! Units and noise of the IMU.

use super::{Corrected, findings::Finding};
use crate::{problem::GRAVITY, recording::Recording};
use nalgebra::Vector3;
use rig_model::{ImuSample, median, topics};

/// Relative deviation of its median that motion and bias explain.
const TOLERANCE: f64 = 0.15;
/// Share of samples that equal the one before, above which a sensor is stuck: a coarse resolution
/// at rest, or samples that are sent twice, give less.
const REPEATED: f64 = 0.9;
/// Factor by which the measured noise exceeds the file's where the file is wrong.
const NOISE: f64 = 10.0;

/// Finds an accelerometer or gyroscope of which all three values repeat. One stuck axis beside two
/// that change is not found.
pub(crate) fn examine_repeated(state: &mut Corrected) {
    type Value = fn(&ImuSample) -> Vector3<f64>;
    let sensors: [(&str, Value); 2] =
        [("accelerometer", |s| s.specific_force), ("gyroscope", |s| s.angular_velocity)];
    let imu = &state.samples.imu;
    for (name, value) in sensors {
        let repeated = imu.windows(2).filter(|pair| value(&pair[0]) == value(&pair[1])).count();
        let Some(last) = imu.last().filter(|_| repeated as f64 > REPEATED * imu.len() as f64)
        else {
            continue;
        };
        let [x, y, z] = value(last).into();
        state.findings.push(Finding {
            blocks: true,
            ..Finding::wrong(
                &format!("imu.{name}"),
                format!("the {name} repeats one value ({x}, {y}, {z}): it is stuck or off"),
                format!("look at the IMU and at the driver that publishes {}", topics::IMU),
            )
        });
    }
}

/// Compares the median norm of the specific force with gravity.
pub(crate) fn examine_units(state: &mut Corrected) {
    let norms = state.samples.imu.iter().map(|s| s.specific_force.norm()).collect();
    let Some(norm) = median(norms).filter(|n| *n > 0.0) else { return };
    if (norm / GRAVITY - 1.0).abs() < TOLERANCE {
        return;
    }
    let in_g = (norm - 1.0).abs() < TOLERANCE;
    let (text, factor) = if in_g {
        (
            format!("the accelerometer measures {norm:.2} at rest: it reports g instead of m/s²"),
            GRAVITY,
        )
    } else {
        (format!("the accelerometer measures {norm:.2} m/s² instead of gravity"), GRAVITY / norm)
    };
    state.findings.push(Finding::wrong(
        "imu.accelerometer.unit",
        text,
        format!("let the driver of {} publish m/s² (sensor_msgs/Imu, REP-103)", topics::IMU),
    ));
    state.samples.imu.iter_mut().for_each(|s| s.specific_force *= factor);
}

/// Compares the noise of the samples with the rig file's densities.
///
/// Third differences remove the motion; their variance is 20 times that of white noise.
pub(crate) fn examine_noise(state: &mut Corrected, recording: &Recording) {
    let samples = &recording.imu;
    if samples.len() < 100 {
        return;
    }
    let rate = (samples.len() - 1) as f64 / (samples[samples.len() - 1].0 - samples[0].0);
    let density = |of: &dyn Fn(usize) -> Vector3<f64>| {
        let sizes = (0..samples.len() - 3)
            .flat_map(|i| {
                let d = of(i + 3) - of(i + 2) * 3.0 + of(i + 1) * 3.0 - of(i);
                [d.x.abs(), d.y.abs(), d.z.abs()]
            })
            .collect();
        // The median of |x| is 0.6745 sigma.
        median(sizes).unwrap_or(0.0) / 0.6745 / 20f64.sqrt() / rate.sqrt()
    };
    let measured = [density(&|i| samples[i].1), density(&|i| samples[i].2)];
    let imu = &mut state.rig.imu;
    let kinds = [
        ("accelerometer", "m/s²/√Hz", &mut imu.accelerometer_noise_density),
        ("gyroscope", "rad/s/√Hz", &mut imu.gyroscope_noise_density),
    ];
    for ((name, unit, file), measured) in kinds.into_iter().zip(measured) {
        if measured < NOISE * *file {
            continue;
        }
        state.findings.push(Finding::wrong(
            &format!("imu.{name}_noise_density"),
            format!(
                "imu.{name}_noise_density is {file:.2e} {unit}; the samples have {measured:.2e}"
            ),
            "measure it with `volant calibrate imu` from a recording at rest, or take it from the \
             data sheet",
        ));
        *file = measured;
    }
}
