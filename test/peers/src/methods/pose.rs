//! From points to a pose: OpenCV's solvers for the peers, Gauss–Newton on centroids for ours.

use crate::scene::Pinhole;
use anyhow::Result;
use nalgebra::{
    Isometry3, Matrix3, Matrix6, Point3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector2,
    Vector3, Vector6,
};
use opencv::{calib3d, core, prelude::*};
use rig_model::{
    CameraModel, MarkerLayout, MarkerObservations, MarkerState, PerColor, planar_pose,
};

pub fn camera_matrix(camera: &Pinhole) -> Result<core::Mat> {
    let c = camera.center();
    Ok(core::Mat::from_slice_2d(&[
        [camera.focal, 0.0, c.x],
        [0.0, camera.focal, c.y],
        [0.0, 0.0, 1.0],
    ])?)
}

fn to_isometry(rvec: &core::Mat, tvec: &core::Mat) -> Result<Isometry3<f64>> {
    let read = |m: &core::Mat| -> Result<Vector3<f64>> {
        Ok(Vector3::new(*m.at::<f64>(0)?, *m.at::<f64>(1)?, *m.at::<f64>(2)?))
    };
    Ok(Isometry3::from_parts(
        Translation3::from(read(tvec)?),
        UnitQuaternion::from_rotation_matrix(&Rotation3::new(read(rvec)?)),
    ))
}

/// `solvePnP` by `flag`, optionally refined by Levenberg–Marquardt.
pub fn solve_pnp(
    matrix: &core::Mat,
    object: &core::Vector<core::Point3d>,
    image: &core::Vector<core::Point2d>,
    flag: calib3d::SolvePnPMethod,
    refine: bool,
) -> Result<Option<Isometry3<f64>>> {
    let (mut rvec, mut tvec) = (core::Mat::default(), core::Mat::default());
    let none = core::no_array();
    if !calib3d::solve_pnp(object, image, matrix, &none, &mut rvec, &mut tvec, false, flag as i32)?
    {
        return Ok(None);
    }
    if refine {
        calib3d::solve_pnp_refine_lm_def(object, image, matrix, &none, &mut rvec, &mut tvec)?;
    }
    Ok(Some(to_isometry(&rvec, &tvec)?))
}

/// A point of a body as OpenCV has it.
pub fn point3(p: &Point3<f64>) -> core::Point3d {
    core::Point3d::new(p.x, p.y, p.z)
}

/// A pixel as OpenCV has it.
pub fn point2(p: &Vector2<f64>) -> core::Point2d {
    core::Point2d::new(p.x, p.y)
}

/// Gauss–Newton on the centroids of the projected squares, weighted by their covariances, from a
/// prior pose; `None` with less than three markers or without a solution.
pub fn gauss_newton(
    layout: &MarkerLayout,
    camera: &CameraModel,
    observed: &MarkerObservations,
    prior: &Isometry3<f64>,
) -> Option<Isometry3<f64>> {
    let mut pose = *prior;
    for _ in 0..12 {
        let (mut normal, mut right, mut used) = (Matrix6::zeros(), Vector6::zeros(), 0);
        for (color, marker) in observed.markers.iter() {
            if marker.state != MarkerState::Detected {
                continue;
            }
            let predicted = layout.projected_centroid(color, camera, &pose)?;
            let weight = marker.covariance.try_inverse()?;
            let residual = marker.centroid - predicted.pixel;
            let arm = pose.rotation * layout.centers[color].coords;
            let mut motion = SMatrix::<f64, 3, 6>::zeros();
            motion.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
            motion.fixed_view_mut::<3, 3>(0, 3).copy_from(&(-arm.cross_matrix()));
            let jacobian = predicted.jacobian_by_center * motion;
            let weighted = jacobian.transpose() * weight;
            normal += weighted * jacobian;
            right += weighted * residual;
            used += 1;
        }
        if used < 3 {
            return None;
        }
        let step = normal.cholesky()?.solve(&right);
        pose.translation.vector += step.fixed_rows::<3>(0);
        pose.rotation =
            UnitQuaternion::from_scaled_axis(step.fixed_rows::<3>(3).into_owned()) * pose.rotation;
        // In units of the weighted squares; the next step would gain far less than this one did.
        if step.dot(&right) < 1e-4 {
            break;
        }
    }
    (pose.translation.vector.z > 0.05).then_some(pose)
}

/// The pose without a prior: the best of the planar solutions.
pub fn pose_from_centroids(
    layout: &MarkerLayout,
    camera: &CameraModel,
    observed: &MarkerObservations,
) -> Option<Isometry3<f64>> {
    let pixels = PerColor::from_fn(|color| {
        let marker = &observed.markers[color];
        (marker.state == MarkerState::Detected).then_some((marker.centroid, marker.covariance))
    });
    if pixels.0.iter().any(Option::is_none) {
        return None;
    }
    planar_pose::candidates(layout, camera, &pixels, None).first().map(|c| c.camera_from_volant)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{scene::Rng, stage::Stage, trajectory};
    use nalgebra::Matrix2;
    use opencv::calib3d::SolvePnPMethod::SOLVEPNP_ITERATIVE;
    use pose_fusion::reference::published_pose::published_pose;

    #[test]
    fn the_published_pose_is_that_of_opencv_s_solver() {
        let camera = Pinhole::BENCH;
        let layout = crate::bench::layout(&Stage::new(camera, 1).unwrap()).unwrap();
        let matrix = camera_matrix(&camera).unwrap();
        let object: core::Vector<core::Point3d> = layout.centers.0.iter().map(point3).collect();
        let mut rng = Rng::new(5);
        let (mut far, count) = (0, 200);
        for i in 0..count {
            let truth = trajectory::standard(&camera, f64::from(i) / 10.0);
            let pixels = layout.centers.0.map(|c| {
                camera.project(&(truth * c))
                    + Vector2::new(rng.within(-0.2, 0.2), rng.within(-0.2, 0.2))
            });
            let image: core::Vector<core::Point2d> = pixels.iter().map(point2).collect();
            let theirs = solve_pnp(&matrix, &object, &image, SOLVEPNP_ITERATIVE, false);
            let theirs = theirs.unwrap().unwrap();
            let measured = PerColor(pixels.map(|p| Some((p, Matrix2::identity() * 0.01))));
            let ours = published_pose(&layout, &camera.model(), &measured, None).unwrap();
            let error = theirs.inverse() * ours.camera_from_volant;
            far += usize::from(
                error.translation.vector.norm() > 1e-5 || error.rotation.angle() > 1e-4,
            );
        }
        // Both minimize the same sum of squares from the same start; in a flat valley OpenCV stops
        // after 20 iterations.
        assert!(far <= count as usize / 20, "{far} of {count}");
    }
}
