//! States and residuals of the bundle adjustment.

use crate::{
    inertial::{self, Change},
    parameters::Parameters,
    recording::{Recording, Shot},
};
use nalgebra::{
    Isometry3, Matrix2, Matrix3, SMatrix, SVector, Translation3, UnitQuaternion, Vector3, Vector4,
};
use rig_model::{MarkerColor, Rig};

/// Standard gravity, m/s².
pub const GRAVITY: f64 = 9.806_65;
/// Standard deviation of a fitted climber pose: m along each axis, rad about the vertical.
pub const CLIMBER_NOISE: [f64; 4] = [0.25e-3, 0.25e-3, 0.25e-3, 1.5e-4];
/// Standard deviation of a centroid beyond its covariance, px.
const PIXEL_FLOOR: f64 = 0.03;

/// State of the platform at one image.
#[derive(Clone, Copy, Debug)]
pub struct State {
    /// `world_from_volant`.
    pub pose: Isometry3<f64>,
    /// Velocity of the IMU, world axes, m/s.
    pub velocity: Vector3<f64>,
}

impl State {
    /// Applies a step: rotation about world axes, position, velocity.
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

/// Moves the climber along the world's axes (m) and turns it about its own vertical (rad).
fn moved(climber: &Isometry3<f64>, by: &Vector4<f64>) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), by.w);
    let place = Translation3::from(climber.translation.vector + by.xyz());
    Isometry3::from_parts(place, climber.rotation * turn)
}

/// Measured minus predicted pixels of the four markers; `None` where one does not project.
pub fn pixels(
    recording: &Recording,
    shot: &Shot,
    p: &Parameters,
    state: &State,
) -> Option<SVector<f64, 8>> {
    pixels_from(&p.world_from_climber(recording, shot.time), shot, p, state)
}

/// [`pixels`] from a climber pose.
fn pixels_from(
    climber: &Isometry3<f64>,
    shot: &Shot,
    p: &Parameters,
    state: &State,
) -> Option<SVector<f64, 8>> {
    let at = |shift: &Vector3<f64>| {
        let climber = moved(climber, &Vector4::new(shift.x, shift.y, 0.0, shift.z));
        let pose = (climber * p.rig.climber_from_camera).inverse() * state.pose;
        let mut residual = SVector::<f64, 8>::zeros();
        for color in MarkerColor::ALL {
            let i = color.index();
            let predicted = p.layout.projected_centroid(color, &p.camera, &pose)?;
            let measured = shot.pixels[i] - shot.by_readout[i] * p.readout;
            residual.fixed_rows_mut::<2>(2 * i).copy_from(&(measured - predicted.pixel));
        }
        Some(residual)
    };
    if p.ignored == [false; 3] {
        return at(&Vector3::zeros());
    }
    // An ignored reading is far from the true one: linearize at the shift that fits best.
    let mut shift = Vector3::zeros();
    let mut linear = None;
    for _ in 0..3 {
        let here = at(&shift)?;
        let mut slope = SMatrix::<f64, 8, 3>::zeros();
        for axis in (0..3).filter(|axis| p.ignored[*axis]) {
            let mut step = shift;
            step[axis] += 1e-4;
            slope.column_mut(axis).copy_from(&((at(&step)? - here) / 1e-4));
        }
        linear = Some(here - slope * shift);
        let matrix = slope.transpose() * slope + Matrix3::identity() * 1e-3;
        shift -= matrix.cholesky()?.solve(&(slope.transpose() * here));
    }
    linear
}

/// Whitening matrix of an image's residuals: inverse Cholesky factor of the covariance of the
/// centroids plus the climber's noise, which is common to all four.
pub fn pixel_whitener(
    recording: &Recording,
    shot: &Shot,
    p: &Parameters,
    state: &State,
    noise: &[f64; 4],
) -> Option<SMatrix<f64, 8, 8>> {
    let mut covariance = SMatrix::<f64, 8, 8>::zeros();
    for i in 0..4 {
        let floor = Matrix2::identity() * (PIXEL_FLOOR * PIXEL_FLOOR);
        covariance.fixed_view_mut::<2, 2>(2 * i, 2 * i).copy_from(&(shot.covariances[i] + floor));
    }
    let climber = p.world_from_climber(recording, shot.time);
    let here = pixels_from(&climber, shot, p, state)?;
    for (axis, noise) in noise.iter().enumerate() {
        let mut step = Vector4::zeros();
        step[axis] = 1e-4;
        let slope = (pixels_from(&moved(&climber, &step), shot, p, state)? - here) / 1e-4;
        covariance += slope * slope.transpose() * (noise * noise);
    }
    covariance.cholesky()?.l().try_inverse()
}

/// Motion of the IMU between two images.
pub fn integrated(recording: &Recording, shots: (&Shot, &Shot), p: &Parameters) -> Change {
    let (t0, t1) = (shots.0.time + p.camera_clock, shots.1.time + p.camera_clock);
    inertial::integrate(&recording.imu, t0, t1, &p.sensor)
}

/// Whitened preintegration residuals between two images.
pub fn motion(change: &Change, p: &Parameters, from: &State, to: &State) -> SVector<f64, 9> {
    let dt = change.duration;
    let mounting = &p.rig.imu.volant_from_imu;
    let (a, b) = (from.pose * mounting, to.pose * mounting);
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
    let back = a.rotation.inverse();
    let turn = (change.rotation.inverse() * back * b.rotation).scaled_axis();
    let velocity = back * (to.velocity - from.velocity - gravity * dt) - change.velocity;
    let moved = b.translation.vector - a.translation.vector;
    let position =
        back * (moved - from.velocity * dt - gravity * (0.5 * dt * dt)) - change.position;
    // White noise of density q integrated once and twice: [[dt, dt²/2], [dt²/2, dt³/3]]·q², by its
    // Cholesky factor.
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

/// Rows that hold what images do not determine: mean position, rotation and size of the layout.
pub fn layout_gauge(rig: &Rig) -> SMatrix<f64, 7, 12> {
    let centers = &rig.markers.centers.0;
    let mean = centers.iter().map(|c| c.coords).sum::<Vector3<f64>>() / 4.0;
    let mut rows = SMatrix::<f64, 7, 12>::zeros();
    for (i, center) in centers.iter().enumerate() {
        let arm = center.coords - mean;
        rows.fixed_view_mut::<3, 3>(0, 3 * i).copy_from(&(Matrix3::identity() * 0.25));
        rows.fixed_view_mut::<3, 3>(3, 3 * i).copy_from(&arm.cross_matrix());
        rows.fixed_view_mut::<1, 3>(6, 3 * i).copy_from(&arm.transpose());
    }
    rows
}
