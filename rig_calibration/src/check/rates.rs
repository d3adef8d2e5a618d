//! Angular rates of the images against those of the gyroscope: time offset, rotation and unit of
//! the IMU, without knowledge of its mounting.

use super::{Corrected, findings::Finding, layout::MIRRORED};
use crate::recording::Recording;
use nalgebra::{Isometry3, Matrix2, Matrix3, Rotation3, UnitQuaternion, Vector3};
use rig_model::{PerColor, planar_pose};

/// Time over which a rate is measured, s: the noise of single poses is some tenths of a degree.
const SPAN: f64 = 0.2;
/// Standard deviation of the platform's tilt, rad: separates the two poses of a plane.
const TILT: f64 = 0.25;
/// Largest time offset that is searched, s, its step, and the one from which it is gross.
const LARGEST: f64 = 1.5;
const STEP: f64 = 0.01;
const GROSS: f64 = 0.04;
/// Correlation from which the alignment counts.
const CERTAIN: f64 = 0.6;
/// Angle from which a rotation is gross, rad, and within which a rotation is a special one.
const GROSS_TURN: f64 = 0.35;
const SNAP: f64 = 0.3;
/// Rate in deg/s over rad/s, and how far from it a ratio may be.
const DEGREES: f64 = 57.295_78;

/// Rates at one lag.
struct Aligned {
    /// Correlation: 1 where gyroscope and images agree up to a rotation and a factor.
    score: f64,
    /// `volant_from_imu`.
    rotation: UnitQuaternion<f64>,
    /// Rate of the gyroscope over that of the images.
    ratio: f64,
}

/// Examines time offset, unit and rotation, and corrects samples and rig.
pub(crate) fn examine(state: &mut Corrected, recording: &Recording) {
    let rates = visual_rates(state, recording);
    let integral = integral(recording);
    if rates.len() < 30 {
        return;
    }
    let at = |lag: f64| align(&rates, &integral, lag);
    let count = (LARGEST / STEP) as i32;
    let Some((lag, best)) = (-count..=count)
        .map(|k| f64::from(k) * STEP)
        .filter_map(|lag| Some((lag, at(lag)?)))
        .max_by(|a, b| a.1.score.total_cmp(&b.1.score))
    else {
        return;
    };
    if best.score < CERTAIN {
        return;
    }
    if lag.abs() > GROSS && at(0.0).is_none_or(|zero| zero.score < best.score - 0.02) {
        for sample in &mut state.samples.imu {
            sample.stamp = sample.stamp.plus_seconds(-lag);
        }
        state.imu_clock += lag;
    }
    if best.ratio > 0.3 * DEGREES {
        state.findings.push(Finding::wrong(
            "imu.gyroscope.unit",
            format!(
                "the gyroscope's rates are {:.0} times those of the images: it reports deg/s \
                 instead of rad/s",
                best.ratio
            ),
            "let the driver publish rad/s (sensor_msgs/Imu, REP-103)".to_owned(),
        ));
        state.samples.imu.iter_mut().for_each(|s| s.angular_velocity /= DEGREES);
    }
    rotation(state, &best.rotation);
}

/// Compares the rotation with the file's, and the direction of gravity with both.
fn rotation(state: &mut Corrected, measured: &UnitQuaternion<f64>) {
    let mean: Vector3<f64> = state.samples.imu.iter().map(|s| s.specific_force).sum();
    let file = state.rig.imu.volant_from_imu.rotation;
    let off = measured.angle_to(&file);
    let down = |r: &UnitQuaternion<f64>| (r * mean).z < 0.0;
    // A layout with a marker at a guessed place turns the visual rates.
    if off >= GROSS_TURN && state.moved.is_some() {
        return;
    }
    if off < GROSS_TURN {
        if down(&file) {
            state.findings.push(Finding::wrong(
                "imu.accelerometer.sign",
                "the accelerometer is negated: it measures gravity downwards at rest, while the \
                 gyroscope agrees with the images"
                    .to_owned(),
                "let the driver publish +9.81 m/s² upwards at rest (REP-145)".to_owned(),
            ));
            state.samples.imu.iter_mut().for_each(|s| s.specific_force = -s.specific_force);
        }
        return;
    }
    let q = file.coords;
    let swapped = UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(q.x, q.y, q.z, q.w));
    let axes = [("x", Vector3::x_axis()), ("y", Vector3::y_axis()), ("z", Vector3::z_axis())];
    let special = axes.iter().flat_map(|(name, axis)| {
        [90.0, 180.0, -90.0].map(|degrees: f64| {
            let turn = UnitQuaternion::from_axis_angle(axis, degrees.to_radians());
            (*name, degrees, turn * file)
        })
    });
    let nearest = special.min_by(|a, b| a.2.angle_to(measured).total_cmp(&b.2.angle_to(measured)));
    // A layout mirrored along the other axis explains a half turn, too.
    let half = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::PI);
    if (half * file).angle_to(measured) < SNAP
        && let Some((layout, text)) = state.other_mirror.take()
    {
        state.rig.markers = layout;
        state.findings.iter_mut().filter(|f| f.key == MIRRORED).for_each(|f| f.text = text.clone());
        return;
    }
    let to_swapped = swapped.angle_to(measured);
    let (text, rotation) = match nearest {
        Some(ref special) if to_swapped < SNAP.min(special.2.angle_to(measured)) => (
            "imu.orientation is written as w, x, y, z; the file needs x, y, z, w".to_owned(),
            swapped,
        ),
        Some((axis, degrees, turned)) if turned.angle_to(measured) < SNAP => {
            let how = match (axis, degrees == 180.0) {
                ("z", _) => "turned on the platform",
                (_, true) => "mounted upside down",
                _ => "mounted on its side",
            };
            (
                format!(
                    "imu.orientation is wrong: the IMU is {how}, {degrees:.0}° about the {axis} \
                     axis from what the file has"
                ),
                turned,
            )
        }
        _ => (format!("imu.orientation is off by {:.0}°", off.to_degrees()), *measured),
    };
    state.findings.push(Finding::wrong(
        "imu.orientation",
        text,
        "write volant_from_imu as x, y, z, w; `volant calibrate rig` refines it".to_owned(),
    ));
    state.rig.imu.volant_from_imu.rotation = rotation;
}

/// Mean angular velocities of the platform over [`SPAN`]: times of both ends, and the rate in
/// volant axes.
fn visual_rates(state: &Corrected, recording: &Recording) -> Vec<(f64, f64, Vector3<f64>)> {
    let rig = &state.rig;
    let up = rig.climber_from_camera.rotation.inverse() * Vector3::z();
    let tilt = planar_pose::TiltPrior { up_in_volant: Vector3::z(), up_in_camera: up, sigma: TILT };
    let covariance = Matrix2::identity() * 0.01;
    let poses: Vec<Option<(f64, Isometry3<f64>)>> = recording
        .shots
        .iter()
        .map(|shot| {
            let measured = PerColor(shot.pixels.map(|pixel| Some((pixel, covariance))));
            let found =
                planar_pose::candidates(&rig.markers, &recording.camera, &measured, Some(&tilt));
            let turn = recording.climber_at(shot.time).1;
            let climber = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
            let camera = climber * rig.climber_from_camera.rotation;
            Some((shot.time, camera * found.first()?.camera_from_volant))
        })
        .collect();
    let poses: Vec<(f64, Isometry3<f64>)> = poses.into_iter().flatten().collect();
    let mut rates = vec![];
    for (k, (from, first)) in poses.iter().enumerate() {
        let Some((to, last)) = poses[k..].iter().find(|(t, _)| *t >= from + SPAN) else { break };
        if to - from > 2.0 * SPAN {
            continue;
        }
        let turn = (first.rotation.inverse() * last.rotation).scaled_axis();
        rates.push((*from, *to, turn / (to - from)));
    }
    rates
}

/// Integral of the gyroscope's rates: times and angles.
fn integral(recording: &Recording) -> Vec<(f64, Vector3<f64>)> {
    let mut sum = Vector3::zeros();
    let mut list = Vec::with_capacity(recording.imu.len());
    let mut before: Option<(f64, Vector3<f64>)> = None;
    for (time, _, rate) in &recording.imu {
        if let Some((last, old)) = before {
            sum += (rate + old) * (0.5 * (time - last));
        }
        before = Some((*time, *rate));
        list.push((*time, sum));
    }
    list
}

fn interpolated(integral: &[(f64, Vector3<f64>)], time: f64) -> Option<Vector3<f64>> {
    let k = integral.partition_point(|(t, _)| *t <= time);
    let (a, b) = (integral.get(k.checked_sub(1)?)?, integral.get(k)?);
    Some(a.1 + (b.1 - a.1) * ((time - a.0) / (b.0 - a.0).max(1e-9)))
}

/// Aligns the rates at a lag of the IMU's stamps (Kabsch's method).
fn align(
    rates: &[(f64, f64, Vector3<f64>)],
    integral: &[(f64, Vector3<f64>)],
    lag: f64,
) -> Option<Aligned> {
    let pairs: Vec<(Vector3<f64>, Vector3<f64>)> = rates
        .iter()
        .filter_map(|(from, to, visual)| {
            let turned = interpolated(integral, to + lag)? - interpolated(integral, from + lag)?;
            Some((*visual, turned / (to - from)))
        })
        .collect();
    if pairs.len() * 2 < rates.len() || pairs.len() < 20 {
        return None;
    }
    let n = pairs.len() as f64;
    let mean = pairs
        .iter()
        .fold((Vector3::zeros(), Vector3::zeros()), |m, p| (m.0 + p.0 / n, m.1 + p.1 / n));
    let (mut cross, mut visual, mut gyro) = (Matrix3::zeros(), 0.0, 0.0);
    for (v, g) in &pairs {
        let (v, g) = (v - mean.0, g - mean.1);
        cross += v * g.transpose();
        visual += v.norm_squared();
        gyro += g.norm_squared();
    }
    let svd = cross.svd(true, true);
    let (u, vt) = (svd.u?, svd.v_t?);
    let sign = (u * vt).determinant().signum();
    let rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * vt;
    let s = svd.singular_values;
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    Some(Aligned {
        score: (s[0] + s[1] + sign * s[2]) / (visual * gyro).sqrt().max(1e-12),
        rotation: UnitQuaternion::from_rotation_matrix(&rotation),
        ratio: (gyro / visual.max(1e-12)).sqrt(),
    })
}
