//! How far a track is from the truth, axis by axis: the rows of the paper's Table II; and the
//! IMU alone.

use crate::live::Scenario;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use rig_model::{
    ImuSample, Stamp,
    score::{PoseError, SpreadSum},
};

pub use volant::report::{AXES, Track, UNITS, six};

/// Distance, mm, and angle, degrees, of a pose from the truth.
pub fn distance(pose: &Isometry3<f64>, truth: &Isometry3<f64>) -> [f64; 2] {
    let position = (pose.translation.vector - truth.translation.vector).norm() * 1e3;
    [position, pose.rotation.angle_to(&truth.rotation).to_degrees()]
}

/// Errors of a track, per axis and as a whole.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Errors {
    /// How many poses were compared.
    pub count: usize,
    /// Root of the mean square, mm and degrees.
    pub rmse: [f64; 6],
    /// Largest, mm and degrees.
    pub max: [f64; 6],
    /// Root of the mean square of the distance, mm.
    pub position_rmse: f64,
    /// Root of the mean square of the angle of the rotation that is missing, degrees.
    pub rotation_rmse: f64,
}

impl Errors {
    /// Errors of the poses stamped in `from ..= to`, against the truth at their stamps.
    pub fn of(
        track: &Track,
        from: Stamp,
        to: Stamp,
        truth: impl Fn(Stamp) -> Isometry3<f64>,
    ) -> Self {
        let mut axes = [SpreadSum::default(); 6];
        let (mut position, mut rotation) = (SpreadSum::default(), SpreadSum::default());
        for (stamp, pose) in track.iter().filter(|(stamp, _)| *stamp >= from && *stamp <= to) {
            let error = PoseError::new(pose, &truth(*stamp));
            let millimeters = error.position * 1e3;
            let degrees = error.roll_pitch_yaw.map(f64::to_degrees);
            let six = millimeters.iter().chain(degrees.iter());
            axes.iter_mut().zip(six).for_each(|(sum, error)| sum.add(*error));
            position.add(millimeters.norm());
            rotation.add(error.rotation.norm().to_degrees());
        }
        Self {
            count: position.count() as usize,
            rmse: axes.map(|sum| sum.rmse()),
            max: axes.map(|sum| sum.max()),
            position_rmse: position.rmse(),
            rotation_rmse: rotation.rmse(),
        }
    }
}

/// Threshold control of [`inertial_alone`] as published, m/s.
pub const THRESHOLD: f64 = 1e-5;

/// IMU alone, as in the paper: its own attitude gives the rotation (the unknown heading is that of
/// the first pose); accelerations, rotated into the world and without the scenario's gravity, are
/// integrated twice. Where the velocity changes by less than `threshold` (m/s) from one sample to
/// the next, the IMU counts as stationary, as it is at the first pose.
///
/// Samples before the first pose's stamp and samples without an attitude are passed over.
pub fn inertial_alone(
    scenario: &Scenario,
    samples: &[ImuSample],
    first: &(Stamp, Isometry3<f64>),
    threshold: f64,
) -> Track {
    let volant_from_imu = &scenario.rig.imu.volant_from_imu;
    let imu_from_volant = volant_from_imu.inverse();
    let gravity = Vector3::new(0.0, 0.0, scenario.sensors.gravity);
    let mut heading: Option<UnitQuaternion<f64>> = None;
    let (mut position, mut velocity) = (first.1.translation.vector, Vector3::<f64>::zeros());
    let mut last = first.0;
    // The IMU is not in the platform's origin: it measures the motion of its own place.
    let mut lever = Vector3::zeros();
    let mut before: Option<Vector3<f64>> = None;
    let mut track = Track::new();
    for sample in samples.iter().filter(|s| s.stamp >= first.0) {
        let Some(orientation) = &sample.orientation else { continue };
        let enu_from_volant = orientation.enu_from_imu * imu_from_volant.rotation;
        let heading = *heading.get_or_insert_with(|| {
            lever = first.1.rotation * volant_from_imu.translation.vector;
            position += lever;
            let (_, _, own) = enu_from_volant.euler_angles();
            let (_, _, true_yaw) = first.1.rotation.euler_angles();
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), true_yaw - own)
        });
        let world_from_volant = heading * enu_from_volant;
        let acceleration =
            world_from_volant * (volant_from_imu.rotation * sample.specific_force) - gravity;
        let dt = sample.stamp.seconds_since(last);
        last = sample.stamp;
        // By the trapezoid rule: the sample alone would lag by half a period.
        let change = (acceleration + before.unwrap_or(acceleration)) * (0.5 * dt);
        before = Some(acceleration);
        if change.norm() >= threshold {
            position += velocity * dt + change * (0.5 * dt);
            velocity += change;
        }
        lever = world_from_volant * volant_from_imu.translation.vector;
        track.push((
            sample.stamp,
            Isometry3::from_parts(Translation3::from(position - lever), world_from_volant),
        ));
    }
    track
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(noise: f64, bias: f64) -> (Errors, Errors) {
        let mut scenario = Scenario::swing(3, 6.0).unwrap();
        scenario.sensors.imu_noise_factor = noise;
        scenario.sensors.attitude_error = 1e-9 + 0.0096 * noise;
        scenario.sensors.accelerometer_bias = Vector3::repeat(bias);
        let samples = scenario.simulated_sensors().imu_samples();
        let epoch = scenario.sensors.epoch;
        let truth = |s: Stamp| scenario.motion.world_from_volant(s.seconds_since(epoch));
        let start = samples[0].stamp;
        let track = inertial_alone(&scenario, &samples, &(start, truth(start)), THRESHOLD);
        let at = |t| epoch.plus_seconds(t);
        let errors = |from, to| Errors::of(&track, at(from), at(to), truth);
        (errors(0.0, 1.0), errors(5.0, 6.0))
    }

    #[test]
    fn an_ideal_imu_alone_follows_the_truth_and_a_real_one_drifts() {
        let (_, late) = run(0.0, 0.0);
        assert!(late.position_rmse < 15.0 && late.rotation_rmse < 0.01, "{late:?}");
        let (early, late) = run(1.0, 0.03);
        // Half of bias times time squared is 390 mm an axis at 5 s.
        assert!(
            late.position_rmse > 200.0 && early.position_rmse < 0.2 * late.position_rmse,
            "{early:?} {late:?}"
        );
    }

    #[test]
    fn angle_errors_wrap_and_axes_are_separate() {
        let pose = |x: f64, yaw: f64| {
            Isometry3::from_parts(
                Translation3::new(x, 0.0, 0.0),
                UnitQuaternion::from_euler_angles(0.0, 0.0, yaw.to_radians()),
            )
        };
        let at = Stamp::from_nanos;
        let track = vec![
            (at(1), pose(0.003, 179.0)),
            (at(2), pose(-0.004, -179.0)),
            (at(9), pose(9.0, 0.0)),
        ];
        let errors = Errors::of(&track, at(0), at(5), |_| pose(0.0, 180.0));
        assert_eq!(errors.count, 2);
        assert!(
            (errors.rmse[0] - 12.5_f64.sqrt()).abs() < 1e-9 && (errors.max[0] - 4.0).abs() < 1e-9
        );
        assert!((errors.rmse[5] - 1.0).abs() < 1e-9 && errors.rmse[3] < 1e-9);
        assert!((errors.rotation_rmse - 1.0).abs() < 1e-9);
    }
}
