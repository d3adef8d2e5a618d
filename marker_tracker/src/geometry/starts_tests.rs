use super::*;
use crate::geometry::Geometry;
use nalgebra::Point3;
use rig_model::Distortion;

fn layout() -> MarkerLayout {
    MarkerLayout {
        side: 0.076,
        centers: PerColor([
            Point3::new(0.157, 0.145, 0.022),
            Point3::new(-0.154, 0.151, 0.022),
            Point3::new(-0.145, -0.142, 0.022),
            Point3::new(0.147, -0.152, 0.022),
        ]),
    }
}

fn camera() -> CameraModel {
    CameraModel::new(
        640,
        480,
        [590.0, 588.0, 319.0, 236.0],
        Distortion::PlumbBob([-0.23, 0.08, 7e-4, -4e-4, -0.006]),
    )
    .unwrap()
}

fn poses() -> impl Iterator<Item = Isometry3<f64>> {
    [(0.02, 0.01, 0.3), (0.4, -0.2, 2.0), (-0.3, 0.5, -1.0), (0.9, 0.0, 3.0)].into_iter().map(
        |(a, b, c)| {
            Isometry3::from_parts(
                Translation3::new(0.05, -0.08, 1.4),
                UnitQuaternion::from_euler_angles(std::f64::consts::PI + a, b, c),
            )
        },
    )
}

#[test]
fn four_centroids_determine_the_pose() {
    for truth in poses() {
        let pixels =
            PerColor::from_fn(|c| layout().projected_centroid(c, &camera(), &truth).unwrap().pixel);
        let start = pose_from_four(&layout(), &camera(), &pixels).unwrap();
        let observations = MarkerColor::ALL.map(|color| PoseObservation {
            color,
            pixel: pixels[color],
            sigma: 0.1,
            outline: None,
        });
        let (pose, rms) = Geometry { layout: &layout(), camera: &camera() }
            .refine(&observations, &start, None, 20)
            .unwrap();
        assert!(rms < 1e-4, "{rms}");
        assert!((pose.translation.vector - truth.translation.vector).norm() < 1e-5);
        assert!(pose.rotation.angle_to(&truth.rotation) < 1e-5);
    }
}

#[test]
fn mirrored_markers_have_no_pose() {
    for truth in poses() {
        let mut pixels =
            PerColor::from_fn(|c| layout().projected_centroid(c, &camera(), &truth).unwrap().pixel);
        pixels.0.swap(0, 2);
        pixels.0.swap(1, 3);
        // Half a turn is a pose, a swap of two neighbors is none.
        assert!(pose_from_four(&layout(), &camera(), &pixels).is_some());
        pixels.0.swap(0, 1);
        assert!(pose_from_four(&layout(), &camera(), &pixels).is_none());
    }
}

#[test]
fn one_of_the_starts_from_three_centroids_converges_to_the_pose() {
    for truth in poses() {
        let observations =
            [MarkerColor::Red, MarkerColor::Blue, MarkerColor::Yellow].map(|color| {
                PoseObservation {
                    color,
                    pixel: layout().projected_centroid(color, &camera(), &truth).unwrap().pixel,
                    sigma: 0.1,
                    outline: None,
                }
            });
        let best = poses_from_three(&layout(), &camera(), &observations)
            .unwrap()
            .iter()
            .filter_map(|s| {
                Geometry { layout: &layout(), camera: &camera() }.refine(&observations, s, None, 30)
            })
            .map(|(pose, _)| pose.rotation.angle_to(&truth.rotation))
            .fold(f64::INFINITY, f64::min);
        assert!(best < 1e-4, "{best}");
    }
}
