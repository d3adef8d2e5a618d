//! Angular rates of the images against those of the gyroscope: time offset, rotation and unit of
//! the IMU, without knowledge of its mounting, and the unit of the climber's turn.

use super::{
    Corrected,
    findings::Finding,
    layout::{MIRRORED, w_first},
};
use crate::recording::{Recording, Shot};
use nalgebra::{Isometry3, Matrix2, Matrix3, Rotation3, UnitQuaternion, Vector3};
use rig_model::{PerColor, planar_pose};

/// Time over which a rate is measured, s: the noise of single poses is some tenths of a degree.
const SPAN: f64 = 0.2;
/// Standard deviation of the platform's tilt, rad: separates the two poses of a plane.
const TILT: f64 = 0.25;
/// Searches, the second where the first is in vain: largest time offset and step, s, and the
/// correlation from which the alignment counts. In the recordings of `test/CHECK.md` a swing
/// correlates by less than 0.9 with itself half a period later.
const SEARCHES: [(f64, f64, f64); 2] = [(1.5, STEP, 0.95), (10.0, 0.05, 0.6)];
/// Step of the time offset that is found, s: the batch estimate converges from there.
const STEP: f64 = 0.01;
/// Time offset from which it is gross, s.
const GROSS: f64 = 0.04;
/// Largest correlation of another rotation, at any time offset, that leaves the rotation certain:
/// share of the best one.
const RIVAL: f64 = 0.95;
/// Angle from which a rotation is gross, rad, and within which a rotation is a special one.
const GROSS_TURN: f64 = 0.35;
const SNAP: f64 = 0.3;
/// Rate in deg/s over rad/s, and how far from it a ratio may be.
const DEGREES: f64 = 57.295_78;
/// Range of the climber's turn from which its unit is examined, rad, and by how much more the rates
/// correlate where it is in degrees.
const FAR_TURN: f64 = 1.0;
const CLEARLY: f64 = 0.1;

/// Rates at one lag.
struct Aligned {
    /// Correlation: 1 where gyroscope and images agree up to a rotation and a factor.
    score: f64,
    /// `volant_from_imu`.
    rotation: UnitQuaternion<f64>,
    /// Rate of the gyroscope over that of the images.
    ratio: f64,
}

/// Names a climber whose turn is in degrees: its readings turn the images' rates, which then do not
/// correlate with the gyroscope's.
pub(crate) fn examine_turn(state: &mut Corrected, recording: &Recording) {
    let turns = || recording.climber.iter().map(|c| c.2);
    let range = turns().fold(f64::MIN, f64::max) - turns().fold(f64::MAX, f64::min);
    if range < FAR_TURN {
        return;
    }
    let (poses, integral) = (camera_poses(state, recording), integral(recording));
    let score = |unit: f64| {
        let rates = visual_rates(&poses, state, recording, unit);
        let at = |lag: f64| align(&rates, &integral, lag);
        let found = SEARCHES.iter().find_map(|search| best_lag(&at, *search));
        found.map_or(0.0, |(_, best, _)| best.score)
    };
    // A turn that is reversed is off by more than one that hardly turns.
    if score(1.0 / DEGREES) > score(1.0).max(score(-1.0)) + CLEARLY {
        let finding = Finding::wrong(
            "climber.turn.unit",
            "the joint `turn` is in degrees: with radians the images' rates contradict the \
             gyroscope's",
            "multiply `scale.turn` of climber_driver by 0.0174533 (π/180), or let the encoder's \
             driver publish rad (sensor_msgs/JointState, REP-103); then check again",
        );
        // The heading is known but for multiples of 6.28°.
        state.findings.push(Finding { blocks: true, ..finding });
    }
}

/// Examines time offset, unit and rotation, and corrects samples and rig.
pub(crate) fn examine(state: &mut Corrected, recording: &Recording) {
    let rates = visual_rates(&camera_poses(state, recording), state, recording, 1.0);
    let integral = integral(recording);
    if rates.len() < 30 {
        return;
    }
    let at = |lag: f64| align(&rates, &integral, lag);
    let Some((lag, best, certain)) = SEARCHES.iter().find_map(|search| best_lag(&at, *search))
    else {
        return;
    };
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
            "let the driver publish rad/s (sensor_msgs/Imu, REP-103)",
        ));
        state.samples.imu.iter_mut().for_each(|s| s.angular_velocity /= DEGREES);
    }
    rotation(state, &best.rotation, certain);
}

/// Returns the lag of the highest correlation to [`STEP`], its alignment, and whether the rotation
/// is certain; `None` where the correlation is low or still rises at an end of the search.
fn best_lag(
    at: &impl Fn(f64) -> Option<Aligned>,
    (largest, step, least): (f64, f64, f64),
) -> Option<(f64, Aligned, bool)> {
    let count = (largest / step).round() as i32;
    let mut lags: Vec<(f64, Aligned)> = (-count..=count)
        .map(|k| f64::from(k) * step)
        .filter_map(|lag| Some((lag, at(lag)?)))
        .collect();
    let score = |k: &usize| lags[*k].1.score;
    let place = (0..lags.len()).max_by(|a, b| score(a).total_cmp(&score(b)))?;
    if score(&place) < least || place == 0 || place + 1 == lags.len() {
        return None;
    }
    let (coarse, mut best) = lags.swap_remove(place);
    let mut lag = coarse;
    let finer = (step / STEP).round() as i32 - 1;
    for near in (-finer..=finer).map(|k| coarse + f64::from(k) * STEP) {
        if let Some(aligned) = at(near)
            && aligned.score > best.score
        {
            (lag, best) = (near, aligned);
        }
    }
    let rival = |a: &Aligned| {
        a.score > RIVAL * best.score && a.rotation.angle_to(&best.rotation) > GROSS_TURN
    };
    let certain = !lags.iter().any(|(_, aligned)| rival(aligned));
    Some((lag, best, certain))
}

/// Compares the rotation with the file's, and the direction of gravity with both.
fn rotation(state: &mut Corrected, measured: &UnitQuaternion<f64>, certain: bool) {
    let mean: Vector3<f64> = state.samples.imu.iter().map(|s| s.specific_force).sum();
    let file = state.rig.imu.volant_from_imu.rotation;
    let off = measured.angle_to(&file);
    let down = |r: &UnitQuaternion<f64>| (r * mean).z < 0.0;
    // A layout with a marker at a guessed place turns the visual rates.
    if off >= GROSS_TURN && (state.moved.is_some() || !certain) {
        return;
    }
    if off < GROSS_TURN {
        if down(&file) {
            state.findings.push(Finding::wrong(
                "imu.accelerometer.sign",
                "the accelerometer is negated: it measures gravity downwards at rest, while the \
                 gyroscope agrees with the images",
                "let the driver publish +9.81 m/s² upwards at rest (REP-145)",
            ));
            state.samples.imu.iter_mut().for_each(|s| s.specific_force = -s.specific_force);
        }
        return;
    }
    let swapped = w_first(&file);
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
        "write volant_from_imu as x, y, z, w; `volant calibrate rig` refines it",
    ));
    state.rig.imu.volant_from_imu.rotation = rotation;
}

/// Poses of the platform in the camera, `camera_from_volant`, with their times.
fn camera_poses(state: &Corrected, recording: &Recording) -> Vec<(f64, Isometry3<f64>)> {
    let rig = &state.rig;
    let up = rig.climber_from_camera.rotation.inverse() * Vector3::z();
    let tilt = planar_pose::TiltPrior { up_in_volant: Vector3::z(), up_in_camera: up, sigma: TILT };
    let covariance = Matrix2::identity() * 0.01;
    let pose = |shot: &Shot| {
        let measured = PerColor(shot.pixels.map(|pixel| Some((pixel, covariance))));
        let found =
            planar_pose::candidates(&rig.markers, &recording.camera, &measured, Some(&tilt));
        Some((shot.time, found.first()?.camera_from_volant))
    };
    recording.shots.iter().filter_map(pose).collect()
}

/// Mean angular velocities of the platform over [`SPAN`]: times of both ends, and the rate in
/// volant axes. `turn_unit`: unit of the climber's turn, rad.
fn visual_rates(
    poses: &[(f64, Isometry3<f64>)],
    state: &Corrected,
    recording: &Recording,
    turn_unit: f64,
) -> Vec<(f64, f64, Vector3<f64>)> {
    let rotation = |(time, pose): &(f64, Isometry3<f64>)| {
        let turn = recording.climber_at(*time).turn * turn_unit;
        let climber = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        (*time, climber * state.rig.climber_from_camera.rotation * pose.rotation)
    };
    let rotations: Vec<(f64, UnitQuaternion<f64>)> = poses.iter().map(rotation).collect();
    let mut rates = vec![];
    for (k, (from, first)) in rotations.iter().enumerate() {
        let later = rotations[k..].iter().find(|(t, _)| *t >= from + SPAN);
        let Some((to, last)) = later else { break };
        if to - from > 2.0 * SPAN {
            continue;
        }
        let turn = (first.inverse() * last).scaled_axis();
        rates.push((*from, *to, turn / (to - from)));
    }
    rates
}

/// Integral of the gyroscope's rates: times and angles.
fn integral(recording: &Recording) -> Vec<(f64, Vector3<f64>)> {
    let mut list = vec![(recording.imu[0].0, Vector3::<f64>::zeros())];
    for w in recording.imu.windows(2) {
        let step = (w[1].2 + w[0].2) * (0.5 * (w[1].0 - w[0].0));
        list.push((w[1].0, list[list.len() - 1].1 + step));
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Best lag where the stamps of the gyroscope, mounted as `mounting`, are late by `late`
    /// seconds: 20 s, stamps of the images and of the samples from 0 to 20 s.
    fn found(late: f64, mounting: &UnitQuaternion<f64>) -> Option<(f64, Aligned, bool)> {
        // Angles of a swing of 2.9 s about both axes, with turns that are not periodic.
        let angles = |t: f64| {
            let swing = 0.2 * (2.17 * t).sin();
            Vector3::new(swing + 0.04 * (0.9 * t).sin(), 0.7 * swing, 0.06 * (0.4 * t * t).sin())
        };
        let visual = |t: f64| (t, t + SPAN, (angles(t + SPAN) - angles(t)) / SPAN);
        let rates: Vec<_> = (0..590).map(|k| visual(f64::from(k) / 30.0)).collect();
        let sample = |t: f64| (t, mounting.inverse() * angles(t - late));
        let integral: Vec<_> = (0..=2000).map(|k| sample(f64::from(k) / 100.0)).collect();
        let at = |lag: f64| align(&rates, &integral, lag);
        SEARCHES.iter().find_map(|search| best_lag(&at, *search))
    }

    #[test]
    fn a_late_gyroscope_is_not_a_turned_one() {
        let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3.0);
        for late in [0.0, 0.2, -1.0, 3.02, -6.03] {
            for mounting in [UnitQuaternion::identity(), turned] {
                let (lag, aligned, certain) = found(late, &mounting).unwrap();
                assert!(certain && (lag - late).abs() < 0.006, "{late}: {lag}");
                assert!(aligned.rotation.angle_to(&mounting) < 0.02, "{late}");
            }
        }
        // Beyond the search a swing in the opposite phase fits best, but not alone.
        assert!(found(14.0, &UnitQuaternion::identity()).is_none_or(|found| !found.2));
    }
}
