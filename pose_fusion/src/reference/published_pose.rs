//! Pose of the camera's frame as published (section II-E): homography, singular value
//! decomposition, then minimization of the reprojection error, from one image alone. Why the
//! minimizer is not OpenCV's: `docs/src/equations.md`, "The published filter".

use nalgebra::{Isometry3, Matrix2};
use rig_model::{
    CameraModel, MarkerLayout, PerColor,
    planar_pose::{self, MarkerPixels, PlanarPose},
};

/// Returns the published pose of four centroids (raw px, with covariances in px²).
///
/// Three have no homography, and the paper has nothing for them: the minimization then starts from
/// `previous`, the `camera_from_volant` of the image before. `None` without a start, or if the
/// minimization does not converge in front of the camera.
pub fn published_pose(
    layout: &MarkerLayout,
    camera: &CameraModel,
    pixels: &MarkerPixels,
    previous: Option<&Isometry3<f64>>,
) -> Option<PlanarPose> {
    let points = MarkerLayout { side: 0.0, ..layout.clone() };
    let measured = pixels.0.iter().flatten();
    let variance = measured.clone().map(|(_, c)| c.trace() / 2.0).sum::<f64>()
        / measured.clone().count().max(1) as f64;
    let alike = PerColor(pixels.0.map(|p| p.map(|(at, _)| (at, Matrix2::identity() * variance))));
    let start = if measured.count() == 4 {
        planar_pose::from_homography(&points, camera, &alike)
    } else {
        previous.copied()
    };
    planar_pose::refine(&points, camera, &alike, None, &start?)
}

#[cfg(test)]
mod tests {
    use super::{super::marker_measurement::tests::layout, *};
    use nalgebra::{Translation3, UnitQuaternion, Vector2, Vector3};
    use rig_model::Distortion;

    fn camera() -> CameraModel {
        let lens = Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -0.006]);
        CameraModel::new(640, 480, [591.0, 589.0, 319.3, 235.2], lens).unwrap()
    }

    /// Platform at 1.2 m below the camera with this tilt, rad.
    fn pose(tilt: f64) -> Isometry3<f64> {
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let lean = UnitQuaternion::from_scaled_axis(Vector3::new(0.8, 0.6, 0.0) * tilt);
        Isometry3::from_parts(Translation3::new(0.05, -0.04, 1.2), down * lean)
    }

    /// Centroids of markers with this side, m; 0: their centers.
    fn centroids(truth: &Isometry3<f64>, side: f64) -> MarkerPixels {
        let markers = MarkerLayout { side, ..layout() };
        PerColor::from_fn(|c| {
            let place = markers.projected_centroid(c, &camera(), truth)?;
            Some((place.pixel, Matrix2::identity() * 0.01))
        })
    }

    #[test]
    fn exact_centers_give_the_exact_pose_and_area_centroids_the_published_bias() {
        let truth = pose(0.5);
        let error = |pixels: &MarkerPixels| {
            let found = published_pose(&layout(), &camera(), pixels, None).unwrap();
            (truth.inverse() * found.camera_from_volant).translation.vector.norm()
        };
        assert!(error(&centroids(&truth, 0.0)) < 1e-7);
        let bias = error(&centroids(&truth, layout().side));
        assert!((1e-4..1e-2).contains(&bias), "{bias} m");
    }

    #[test]
    fn three_markers_continue_from_the_image_before() {
        let truth = pose(0.4);
        let mut pixels = centroids(&truth, 0.0);
        pixels.0[1] = None;
        assert!(published_pose(&layout(), &camera(), &pixels, None).is_none());
        let before = pose(0.38);
        let found = published_pose(&layout(), &camera(), &pixels, Some(&before)).unwrap();
        assert!((truth.inverse() * found.camera_from_volant).rotation.angle() < 1e-6);
        // A mirrored image is of no platform below the camera.
        let mut mirrored = centroids(&truth, 0.0);
        mirrored.0.iter_mut().flatten().for_each(|p| p.0 = Vector2::new(640.0 - p.0.x, p.0.y));
        assert!(published_pose(&layout(), &camera(), &mirrored, None).is_none());
    }
}
