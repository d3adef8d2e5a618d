//! Parameters, states and residuals of the bundle adjustment.

use super::{
    inertial,
    recording::{Recording, Shot},
};
use nalgebra::{
    DVector, Isometry3, Matrix2, Matrix3, Point3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3,
};
use rig_model::{MarkerColor, Rig};

/// Gravity in world, m/s².
const GRAVITY: f64 = 9.806_65;
/// Numbers that describe the rig, in this order: camera turn (climber axes) and place, inertial unit turn (volant axes)
/// and place, four markers' places, accelerometer and gyroscope bias, camera's and climber's clock offset.
pub const PARAMETERS: usize = 32;
/// Noise of a fitted climber pose: m along each axis, rad about the vertical.
const CLIMBER_NOISE: (f64, f64) = (0.25e-3, 1.5e-4);
/// What a centroid is off by beyond its covariance, px.
const PIXEL_FLOOR: f64 = 0.03;

/// The rig as it is being refined, with what the sensors add.
#[derive(Clone, Debug)]
pub struct Parameters {
    /// The rig.
    pub rig: Rig,
    /// m/s².
    pub force_bias: Vector3<f64>,
    /// rad/s.
    pub rate_bias: Vector3<f64>,
    /// To be added to the camera's stamps to have the inertial unit's time, s.
    pub camera_clock: f64,
    /// The same for the climber.
    pub climber_clock: f64,
}

impl Parameters {
    /// Moved by a small step of [`PARAMETERS`] numbers.
    pub fn moved(&self, step: &[f64]) -> Self {
        let v = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
        let mut next = self.clone();
        let camera = &mut next.rig.climber_from_camera;
        camera.rotation = UnitQuaternion::from_scaled_axis(v(0)) * camera.rotation;
        camera.translation.vector += v(3);
        let imu = &mut next.rig.imu.volant_from_imu;
        imu.rotation = UnitQuaternion::from_scaled_axis(v(6)) * imu.rotation;
        imu.translation.vector += v(9);
        for (i, centre) in next.rig.markers.centres.0.iter_mut().enumerate() {
            centre.coords += v(12 + 3 * i);
        }
        next.force_bias += v(24);
        next.rate_bias += v(27);
        next.camera_clock += step[30];
        next.climber_clock += step[31];
        next
    }

    /// Difference to another set in the same numbers.
    pub fn minus(&self, other: &Self) -> DVector<f64> {
        let mut d = DVector::zeros(PARAMETERS);
        let (a, b) = (&self.rig.climber_from_camera, &other.rig.climber_from_camera);
        let (c, e) = (&self.rig.imu.volant_from_imu, &other.rig.imu.volant_from_imu);
        d.fixed_rows_mut::<3>(0).copy_from(&(a.rotation * b.rotation.inverse()).scaled_axis());
        d.fixed_rows_mut::<3>(3).copy_from(&(a.translation.vector - b.translation.vector));
        d.fixed_rows_mut::<3>(6).copy_from(&(c.rotation * e.rotation.inverse()).scaled_axis());
        d.fixed_rows_mut::<3>(9).copy_from(&(c.translation.vector - e.translation.vector));
        for i in 0..4 {
            let moved = self.rig.markers.centres.0[i] - other.rig.markers.centres.0[i];
            d.fixed_rows_mut::<3>(12 + 3 * i).copy_from(&moved);
        }
        d.fixed_rows_mut::<3>(24).copy_from(&(self.force_bias - other.force_bias));
        d.fixed_rows_mut::<3>(27).copy_from(&(self.rate_bias - other.rate_bias));
        d[30] = self.camera_clock - other.camera_clock;
        d[31] = self.climber_clock - other.climber_clock;
        d
    }
}

/// The platform at one image.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// `world_from_volant`.
    pub pose: Isometry3<f64>,
    /// Of the inertial unit, world axes, m/s.
    pub velocity: Vector3<f64>,
}

impl State {
    /// Moved by a small step: turn about world axes, place, velocity.
    pub fn moved(&self, step: &[f64]) -> Self {
        let v = |at: usize| Vector3::new(step[at], step[at + 1], step[at + 2]);
        Self {
            pose: Isometry3::from_parts(
                Translation3::from(self.pose.translation.vector + v(3)),
                UnitQuaternion::from_scaled_axis(v(0)) * self.pose.rotation,
            ),
            velocity: self.velocity + v(6),
        }
    }
}

/// `camera_from_volant` of an image.
pub fn camera_from_volant(
    recording: &Recording,
    shot: &Shot,
    p: &Parameters,
    state: &State,
) -> Isometry3<f64> {
    let climber = recording.world_from_climber(shot.time + p.camera_clock - p.climber_clock);
    (climber * p.rig.climber_from_camera).inverse() * state.pose
}

/// Measured minus predicted pixels of the four markers; `None` where one does not project.
pub fn pixels(recording: &Recording, shot: &Shot, p: &Parameters, state: &State) -> Option<SVector<f64, 8>> {
    let pose = camera_from_volant(recording, shot, p, state);
    let mut residual = SVector::<f64, 8>::zeros();
    for color in MarkerColor::ALL {
        let i = color.index();
        let predicted = p.rig.markers.projected_centroid(color, &recording.camera, &pose)?;
        residual.fixed_rows_mut::<2>(2 * i).copy_from(&(shot.pixels[i] - predicted.pixel));
    }
    Some(residual)
}

/// What whitens an image's residuals: the inverse of the Cholesky factor of the centroids' covariance and of the
/// climber's noise, which moves all four together.
pub fn pixel_whitener(
    recording: &Recording,
    shot: &Shot,
    p: &Parameters,
    state: &State,
) -> Option<SMatrix<f64, 8, 8>> {
    let mut covariance = SMatrix::<f64, 8, 8>::zeros();
    for i in 0..4 {
        let floor = Matrix2::identity() * (PIXEL_FLOOR * PIXEL_FLOOR);
        covariance.fixed_view_mut::<2, 2>(2 * i, 2 * i).copy_from(&(shot.covariances[i] + floor));
    }
    let here = pixels(recording, shot, p, state)?;
    let climber = recording.world_from_climber(shot.time + p.camera_clock - p.climber_clock);
    for axis in 0..4 {
        // Moving the climber one way is moving the platform the other way, seen from it.
        let (moved, noise, size) = if axis < 3 {
            let mut shift = Vector3::zeros();
            shift[axis] = 1e-4;
            let pose =
                Isometry3::from_parts(Translation3::from(-shift), UnitQuaternion::identity()) * state.pose;
            (State { pose, ..*state }, CLIMBER_NOISE.0, 1e-4)
        } else {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -1e-4);
            let about = Point3::from(climber.translation.vector);
            let turned = Isometry3::from_parts(Translation3::identity(), turn);
            let around = Translation3::from(about.coords) * turned * Translation3::from(-about.coords);
            (State { pose: around * state.pose, ..*state }, CLIMBER_NOISE.1, 1e-4)
        };
        let slope = (pixels(recording, shot, p, &moved)? - here) / size;
        covariance += slope * slope.transpose() * (noise * noise);
    }
    covariance.cholesky()?.l().try_inverse()
}

/// Whitened residuals of what the inertial unit says between two images.
pub fn motion(
    recording: &Recording,
    shots: (&Shot, &Shot),
    p: &Parameters,
    from: &State,
    to: &State,
) -> SVector<f64, 9> {
    let (t0, t1) = (shots.0.time + p.camera_clock, shots.1.time + p.camera_clock);
    let change = inertial::integrate(&recording.imu, t0, t1, &p.force_bias, &p.rate_bias);
    let dt = change.duration;
    let mounting = &p.rig.imu.volant_from_imu;
    let (a, b) = (from.pose * mounting, to.pose * mounting);
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
    let back = a.rotation.inverse();
    let turn = (change.rotation.inverse() * back * b.rotation).scaled_axis();
    let velocity = back * (to.velocity - from.velocity - gravity * dt) - change.velocity;
    let moved = b.translation.vector - a.translation.vector;
    let position = back * (moved - from.velocity * dt - gravity * (0.5 * dt * dt)) - change.position;
    // White noise of density q integrated once and twice: [[dt, dt²/2], [dt²/2, dt³/3]]·q², by its Cholesky factor.
    let gyroscope = p.rig.imu.gyroscope_noise_density.max(1e-5) * dt.sqrt();
    let accelerometer = p.rig.imu.accelerometer_noise_density.max(1e-4) * 1.5;
    let first = accelerometer * dt.sqrt();
    let slope = 0.5 * dt;
    let second = accelerometer * (dt * dt * dt / 12.0).sqrt();
    let mut residual = SVector::<f64, 9>::zeros();
    residual.fixed_rows_mut::<3>(0).copy_from(&(turn / gyroscope));
    residual.fixed_rows_mut::<3>(3).copy_from(&(velocity / first));
    residual.fixed_rows_mut::<3>(6).copy_from(&((position - velocity * slope) / second));
    residual
}

/// Rows that hold the layout where images cannot tell: its mean place, its turn and its size keep the rig file's.
pub fn layout_gauge(rig: &Rig) -> SMatrix<f64, 7, 12> {
    let centres = &rig.markers.centres.0;
    let mean = centres.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 4.0;
    let mut rows = SMatrix::<f64, 7, 12>::zeros();
    for (i, centre) in centres.iter().enumerate() {
        let arm = centre.coords - mean;
        rows.fixed_view_mut::<3, 3>(0, 3 * i).copy_from(&(Matrix3::identity() * 0.25));
        rows.fixed_view_mut::<3, 3>(3, 3 * i).copy_from(&arm.cross_matrix());
        rows.fixed_view_mut::<1, 3>(6, 3 * i).copy_from(&arm.transpose());
    }
    rows
}
