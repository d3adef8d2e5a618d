//! Predicted marker centroids (paper, eq. 5) with their derivatives by state and calibration, and
//! their noise. Equations: `docs/src/equations.md`, "Markers".

use super::{
    geometry::Geometry,
    markers::{Block, ByCalibration, Image, Jacobian, Residual, SEEN},
};
use crate::ekf::{
    calibration::OFFSETS,
    consider::{FOCAL, MARKERS, MOUNTING},
    propagation::ImuReading,
    state::{Error, State},
};
use nalgebra::{Isometry3, Matrix2, Matrix2x3, Matrix3, SVector, UnitQuaternion, Vector2, Vector3};
use rig_model::{MarkerColor, marker::ProjectedCentroid};

/// Residuals of an image and their derivatives; zero for a marker that is not predicted.
#[derive(Default)]
pub struct Linearization {
    /// Measured minus predicted, px, two rows per marker.
    pub residual: Residual,
    /// Derivative of the measurement by the entries [`SEEN`] of the error.
    pub jacobian: Jacobian,
    /// Velocity of the markers in the image, px/s.
    pub velocity: Residual,
    /// Which markers could be projected.
    pub valid: [bool; 4],
    /// Frames and projections at the linearization point, for [`by_calibration`].
    camera_from_volant: Isometry3<f64>,
    projected: [Option<ProjectedCentroid>; 4],
}

/// Linearizes the measurement of `image` at `state`. `reading` is the IMU's at the exposure.
pub fn linearize(
    state: &State,
    geometry: &Geometry,
    image: &Image,
    reading: &ImuReading,
) -> Linearization {
    let late = state.time_offset - image.time_offset;
    let world_rate = state.attitude * state.motion(reading).angular_velocity;
    let climber = state.climber + state.climber_rate * late;
    let position = state.position + state.velocity * late;
    let attitude = UnitQuaternion::from_scaled_axis(world_rate * late) * state.attitude;
    let world_from_climber = image.rest.join(&climber);
    let world_from_camera = world_from_climber * geometry.climber_from_camera;
    let world_from_volant =
        Isometry3::from_parts(position.into(), attitude) * geometry.imu_from_volant;
    let camera_from_volant = world_from_camera.inverse() * world_from_volant;
    let to_camera = world_from_camera.rotation.inverse().to_rotation_matrix();
    let to_camera: &Matrix3<f64> = to_camera.matrix();
    let markers = state.calibration.layout(&geometry.markers);
    let pixels = image.pixels();
    let mut motion = SVector::<f64, 9>::zeros();
    motion.fixed_rows_mut::<3>(0).copy_from(&state.velocity);
    motion.fixed_rows_mut::<3>(3).copy_from(&world_rate);
    motion.fixed_rows_mut::<3>(6).copy_from(&state.climber_rate);
    let mut linear = Linearization { camera_from_volant, ..Linearization::default() };
    for color in MarkerColor::ALL {
        let i = color.index();
        let Some((measured, _)) = &pixels[i] else { continue };
        let Some(predicted) =
            markers.projected_centroid(color, &geometry.camera, &camera_from_volant)
        else {
            continue;
        };
        linear.valid[i] = true;
        linear.projected[i] = Some(predicted);
        let center = world_from_volant * markers.centers[color];
        let by_center: Matrix2x3<f64> = predicted.jacobian_by_center * to_camera;
        let by_turn: Matrix2x3<f64> = predicted.jacobian_by_turn * to_camera;
        let arm = center.coords - position;
        let by_attitude = by_turn - by_center * arm.cross_matrix();
        let about_climber = center.coords - world_from_climber.translation.vector;
        let by_climber_turn = -(by_center * Vector3::z().cross(&about_climber)) - by_turn.column(2);
        let mut rows = linear.jacobian.fixed_rows_mut::<2>(2 * i);
        rows.fixed_columns_mut::<3>(0).copy_from(&by_center);
        rows.fixed_columns_mut::<3>(3).copy_from(&by_attitude);
        rows.fixed_columns_mut::<2>(6).copy_from(&-by_center.fixed_columns::<2>(0));
        rows.fixed_columns_mut::<1>(8).copy_from(&by_climber_turn);
        let velocity = linear.jacobian.fixed_rows::<2>(2 * i) * motion;
        let moved = velocity * geometry.delay_of_row(measured.y);
        linear.velocity.fixed_rows_mut::<2>(2 * i).copy_from(&velocity);
        let residual = measured - predicted.pixel - moved;
        linear.residual.fixed_rows_mut::<2>(2 * i).copy_from(&residual);
    }
    linear
}

/// Returns the derivative of the markers by the consider parameters.
pub fn by_calibration(linear: &Linearization, geometry: &Geometry) -> ByCalibration {
    let mut by = ByCalibration::zeros();
    let pose = &linear.camera_from_volant;
    let principal = geometry.camera.principal_point();
    for color in MarkerColor::ALL {
        let i = color.index();
        let Some(predicted) = &linear.projected[i] else { continue };
        let center = (pose * geometry.markers.centers[color]).coords;
        let mounting =
            predicted.jacobian_by_turn - predicted.jacobian_by_center * center.cross_matrix();
        let mut rows = by.fixed_rows_mut::<2>(2 * i);
        let by_center = predicted.jacobian_by_center * pose.rotation.to_rotation_matrix();
        rows.fixed_columns_mut::<2>(MARKERS + 2 * i).copy_from(&by_center.fixed_columns::<2>(0));
        rows.fixed_columns_mut::<1>(FOCAL).copy_from(&(predicted.pixel - principal));
        rows.fixed_columns_mut::<3>(MOUNTING).copy_from(&mounting);
    }
    by
}

/// Returns the covariance that the uncertain places of the markers add to the residuals.
pub fn layout_spread(state: &State, by_parameter: &ByCalibration) -> Block {
    let by_offset = by_parameter.fixed_columns::<OFFSETS>(MARKERS);
    by_offset * state.calibration.offset_covariance() * by_offset.transpose()
}

/// Returns the covariance of the centroids of an image: their own, what the motion makes of the
/// error of its stamp, and the shake of the camera. Of a marker that is absent it is the identity.
pub fn measurement_noise(linear: &Linearization, image: &Image) -> Block {
    let moved = linear.velocity * f64::from(image.stamp_sigma);
    let mut noise = moved * moved.transpose();
    for (axis, variance) in image.shake.iter().enumerate() {
        for i in (axis..8).step_by(2) {
            (axis..8).step_by(2).for_each(|j| noise[(i, j)] += f64::from(*variance));
        }
    }
    for (i, pixel) in image.pixels().iter().enumerate() {
        let mut own = noise.fixed_view_mut::<2, 2>(2 * i, 2 * i);
        own += pixel.as_ref().map_or(Matrix2::identity(), |(_, covariance)| *covariance);
    }
    noise
}

/// Returns the variance of the mean of an image's markers, without the shake of the camera.
pub fn mean_variance(noise: &Block, image: &Image) -> Vector2<f64> {
    let detected = || (0..4).filter(|i| image.has(*i));
    let count = detected().count().max(1) as f64;
    Vector2::from_fn(|axis, _| {
        let row = |i: usize| detected().map(move |j| noise[(2 * i + axis, 2 * j + axis)]);
        let sum: f64 = detected().flat_map(row).sum();
        sum / (count * count) - f64::from(image.shake[axis])
    })
}

/// Returns `H P Hᵀ` from `P Hᵀ`.
pub fn innovation_spread(h: &Jacobian, gain: &super::markers::Gain) -> Block {
    let mut rows = nalgebra::SMatrix::<f64, 9, 8>::zeros();
    for (k, &index) in SEEN.iter().enumerate() {
        rows.row_mut(k).copy_from(&gain.row(index));
    }
    let s = h * rows;
    (s + s.transpose()) * 0.5
}

/// Returns `H δx`.
pub fn times_error(h: &Jacobian, error: &Error) -> Residual {
    h * SVector::<f64, 9>::from_fn(|k, _| error[SEEN[k]])
}

#[cfg(test)]
mod tests {
    use super::{
        super::markers::tests::{READING, example},
        *,
    };

    #[test]
    fn the_jacobian_is_the_numerical_one() {
        let (state, geometry, image) = example();
        let linear = linearize(&state, &geometry, &image, &READING);
        assert!(linear.residual.amax() < 1e-9);
        let h = 1e-5;
        for (k, &index) in SEEN.iter().enumerate() {
            let at =
                |by: f64| linearize(&state.moved(index, by), &geometry, &image, &READING).residual;
            let numeric = -(at(h) - at(-h)) / (2.0 * h);
            let error = (numeric - linear.jacobian.column(k)).amax();
            // The analytical derivative leaves out changes of the area's weights.
            assert!(error < 0.006 * numeric.amax() + 1e-3, "{k}: {error}");
        }
    }

    #[test]
    fn the_derivatives_by_calibration_are_the_numerical_ones() {
        let (state, geometry, image) = example();
        let linear = linearize(&state, &geometry, &image, &READING);
        let by = by_calibration(&linear, &geometry);
        let h = 1e-4;
        let check = |k: usize, changed: Geometry| {
            let numeric = -linearize(&state, &changed, &image, &READING).residual / h;
            let error = (numeric - by.column(k)).amax();
            assert!(error < 0.02 * numeric.amax(), "{k}: {error} of {}", numeric.amax());
        };
        let f = geometry.camera.focal_lengths() * (1.0 + h);
        let c = geometry.camera.principal_point();
        let (width, height) = geometry.camera.size();
        let camera = rig_model::CameraModel::new(
            width,
            height,
            [f.x, f.y, c.x, c.y],
            *geometry.camera.distortion(),
        );
        check(FOCAL, Geometry { camera: camera.unwrap(), ..geometry.clone() });
        for k in 0..8 {
            let mut moved = geometry.clone();
            moved.markers.centers.0[k / 2].coords[k % 2] += h;
            check(MARKERS + k, moved);
        }
        for axis in 0..3 {
            // The scene turns about the camera: the camera turns the other way.
            let turn = UnitQuaternion::from_scaled_axis(Vector3::ith(axis, -h));
            let mut turned = geometry.clone();
            turned.climber_from_camera.rotation *= turn;
            check(MOUNTING + axis, turned);
        }
    }
}
