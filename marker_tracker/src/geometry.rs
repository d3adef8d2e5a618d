//! The platform's pose in the camera frame, as far as the tracker needs it: to predict where the squares' outlines are and
//! to tell whether four things of the right colours can be the markers.

use crate::quad::Quad;
use nalgebra::{
    Isometry3, Matrix2, Matrix3, Matrix6, Point3, Rotation3, SMatrix, Translation3, UnitQuaternion, Vector2,
    Vector3, Vector6,
};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, PerColor};

/// A centroid that a pose has to explain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    pub color: MarkerColor,
    pub pixel: Vector2<f64>,
    /// Standard deviation that is granted to it, px.
    pub sigma: f64,
    /// The measured outline and the square's turn in its plane (rad), where it was measured: the squares' size and shape
    /// tell the tilt that three or fewer centroids leave open.
    pub outline: Option<(Quad, f64)>,
}

/// Standard deviation that is granted to a corner of an outline, px. The centroids are to decide wherever they can.
const CORNER_SIGMA: f64 = 0.5;

/// What is known of a pose beforehand: where it is and how far off it may be.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PosePrior {
    pub camera_from_volant: Isometry3<f64>,
    /// Standard deviation of each coordinate, m.
    pub position_sigma: f64,
    /// Standard deviation of the rotation about each axis, rad.
    pub rotation_sigma: f64,
}

/// Corners, in the volant frame (m), of a square that is turned by `turn` (rad) in its plane.
fn corners_of(layout: &MarkerLayout, color: MarkerColor, turn: f64) -> [Point3<f64>; 4] {
    let h = layout.side / 2.0;
    let (s, c) = turn.sin_cos();
    let centre = layout.centres[color];
    [(-h, -h), (h, -h), (h, h), (-h, h)]
        .map(|(u, v)| Point3::new(centre.x + c * u - s * v, centre.y + s * u + c * v, centre.z))
}

/// Image of the outline of a square that is turned by `turn` (rad) in its plane.
pub(crate) fn project_square(
    layout: &MarkerLayout,
    color: MarkerColor,
    turn: f64,
    camera: &CameraModel,
    camera_from_volant: &Isometry3<f64>,
) -> Option<Quad> {
    let mut corners = [Vector2::zeros(); 4];
    for (corner, point) in corners.iter_mut().zip(corners_of(layout, color, turn)) {
        *corner = camera.project(&(camera_from_volant * point))?;
    }
    Some(Quad(corners))
}

/// A pose that explains the sights as well as it can, by Gauss–Newton on the reprojected centroids, and the RMS of the
/// residuals in units of their sigmas per degree of freedom (raw RMS px second). With a prior any number of sights will do.
pub(crate) fn refine(
    layout: &MarkerLayout,
    camera: &CameraModel,
    sights: &[Sight],
    start: &Isometry3<f64>,
    prior: Option<&PosePrior>,
    iterations: usize,
) -> Option<(Isometry3<f64>, f64)> {
    let mut pose = *start;
    let mut now = evaluate(layout, camera, sights, &pose, prior)?;
    let mut damping = 1e-6;
    for _ in 0..iterations {
        let mut damped = now.normal;
        for i in 0..6 {
            damped[(i, i)] *= 1.0 + damping;
            damped[(i, i)] += 1e-9;
        }
        let step = damped.cholesky()?.solve(&now.gradient);
        // What is left to gain.
        let gain = step.dot(&now.gradient);
        if gain < 1e-4 * now.cost.min(1.0) {
            break;
        }
        let candidate = moved(&pose, &step);
        // A step this short ends where its quadratic has its bottom: what is left there need not be looked at.
        let last = gain < 1e-2;
        match evaluate(layout, camera, sights, &candidate, prior) {
            Some(new) if new.cost <= now.cost * (1.0 + 1e-9) => {
                (pose, now) = (candidate, new);
                if last {
                    break;
                }
                damping = (damping * 0.1).max(1e-9);
            }
            _ => {
                damping = (damping * 100.0).max(1e-4);
                if damping > 1e6 {
                    break;
                }
            }
        }
    }
    Some((pose, (now.square / (sights.len().max(1) as f64)).sqrt()))
}

/// Covariance of a pose (position, rotation about the camera's axes; m², m·rad, rad²) that sights and a prior tell.
pub(crate) fn covariance(
    layout: &MarkerLayout,
    camera: &CameraModel,
    sights: &[Sight],
    pose: &Isometry3<f64>,
    prior: &PosePrior,
) -> Option<Matrix6<f64>> {
    Some(evaluate(layout, camera, sights, pose, Some(prior))?.normal.cholesky()?.inverse())
}

/// A marker's centroid in the image (px) from a pose with its covariance, and the centroid's covariance, px².
pub(crate) fn foretell(
    layout: &MarkerLayout,
    color: MarkerColor,
    camera: &CameraModel,
    pose: &Isometry3<f64>,
    covariance: &Matrix6<f64>,
) -> Option<(Vector2<f64>, Matrix2<f64>)> {
    let predicted = layout.projected_centroid(color, camera, pose)?;
    let arm = pose.rotation * layout.centres[color].coords;
    let mut j = SMatrix::<f64, 2, 6>::zeros();
    j.fixed_columns_mut::<3>(0).copy_from(&predicted.jacobian_by_centre);
    j.fixed_columns_mut::<3>(3).copy_from(&(predicted.jacobian_by_centre * (-arm.cross_matrix())));
    Some((predicted.pixel, j * covariance * j.transpose()))
}

/// Translation and a rotation about the camera's axes, applied at the platform's origin.
pub(crate) fn moved(pose: &Isometry3<f64>, step: &Vector6<f64>) -> Isometry3<f64> {
    let t = Vector3::new(step[0], step[1], step[2]);
    let r = UnitQuaternion::from_scaled_axis(Vector3::new(step[3], step[4], step[5]));
    Isometry3::from_parts(Translation3::from(pose.translation.vector + t), r * pose.rotation)
}

/// Weighted cost, its normal equations, and the plain sum of the centroids' squared residuals, px².
struct Normal {
    cost: f64,
    normal: Matrix6<f64>,
    gradient: Vector6<f64>,
    square: f64,
}

fn evaluate(
    layout: &MarkerLayout,
    camera: &CameraModel,
    sights: &[Sight],
    pose: &Isometry3<f64>,
    prior: Option<&PosePrior>,
) -> Option<Normal> {
    let (mut cost, mut normal, mut gradient, mut square) = (0.0, Matrix6::zeros(), Vector6::zeros(), 0.0);
    for s in sights {
        let predicted = layout.projected_centroid(s.color, camera, pose)?;
        let arm = pose.rotation * layout.centres[s.color].coords;
        let by_point = predicted.jacobian_by_centre;
        let by_rotation = by_point * (-arm.cross_matrix());
        let mut j = SMatrix::<f64, 2, 6>::zeros();
        j.fixed_columns_mut::<3>(0).copy_from(&by_point);
        j.fixed_columns_mut::<3>(3).copy_from(&by_rotation);
        let w = s.sigma.powi(-2);
        let residual = s.pixel - predicted.pixel;
        square += residual.norm_squared();
        cost += w * residual.norm_squared();
        normal += j.transpose() * j * w;
        gradient += j.transpose() * residual * w;
        if let Some((outline, turn)) = &s.outline {
            let w = CORNER_SIGMA.powi(-2);
            for (point, corner) in corners_of(layout, s.color, *turn).iter().zip(&outline.0) {
                let arm = pose.rotation * point.coords;
                let (pixel, by_point) =
                    camera.project_with_jacobian(&Point3::from(arm + pose.translation.vector))?;
                j.fixed_columns_mut::<3>(0).copy_from(&by_point);
                j.fixed_columns_mut::<3>(3).copy_from(&(by_point * (-arm.cross_matrix())));
                let residual = corner - pixel;
                cost += w * residual.norm_squared();
                normal += j.transpose() * j * w;
                gradient += j.transpose() * residual * w;
            }
        }
    }
    if let Some(p) = prior {
        let dt = p.camera_from_volant.translation.vector - pose.translation.vector;
        let dr = (p.camera_from_volant.rotation * pose.rotation.inverse()).scaled_axis();
        let (wt, wr) = (p.position_sigma.powi(-2), p.rotation_sigma.powi(-2));
        cost += wt * dt.norm_squared() + wr * dr.norm_squared();
        for i in 0..3 {
            normal[(i, i)] += wt;
            normal[(3 + i, 3 + i)] += wr;
            gradient[i] += wt * dt[i];
            gradient[3 + i] += wr * dr[i];
        }
    }
    cost.is_finite().then_some(Normal { cost, normal, gradient, square })
}

/// The pose of the platform from the homography between its marker plane and the undistorted image, for four sights.
/// `None` where the four cannot be an image of the layout seen from in front.
pub(crate) fn pose_from_four(
    layout: &MarkerLayout,
    camera: &CameraModel,
    pixels: &PerColor<Vector2<f64>>,
) -> Option<Isometry3<f64>> {
    let mean_z = MarkerColor::ALL.map(|c| layout.centres[c].z).iter().sum::<f64>() / 4.0;
    let mut a = SMatrix::<f64, 8, 8>::zeros();
    let mut b = SMatrix::<f64, 8, 1>::zeros();
    for (i, color) in MarkerColor::ALL.into_iter().enumerate() {
        let n = camera.undistort(&pixels[color])?;
        let (x, y) = (layout.centres[color].x, layout.centres[color].y);
        let rows =
            [[x, y, 1.0, 0.0, 0.0, 0.0, -n.x * x, -n.x * y], [0.0, 0.0, 0.0, x, y, 1.0, -n.y * x, -n.y * y]];
        for (r, row) in rows.iter().enumerate() {
            for (c, v) in row.iter().enumerate() {
                a[(2 * i + r, c)] = *v;
            }
        }
        b[2 * i] = n.x;
        b[2 * i + 1] = n.y;
    }
    let h = a.lu().solve(&b)?;
    let (mut h1, mut h2, mut t) =
        (Vector3::new(h[0], h[3], h[6]), Vector3::new(h[1], h[4], h[7]), Vector3::new(h[2], h[5], 1.0));
    let scale = (h1.norm() * h2.norm()).sqrt();
    if !(scale.is_finite() && scale > 1e-9) {
        return None;
    }
    // The two axes of the plane are seen equally long but for noise.
    let ratio = h1.norm() / h2.norm();
    if !(0.6..1.67).contains(&ratio) || (h1.dot(&h2) / (scale * scale)).abs() > 0.5 {
        return None;
    }
    h1 /= scale;
    h2 /= scale;
    t /= scale;
    let h3 = h1.cross(&h2);
    let svd = Matrix3::from_columns(&[h1, h2, h3]).svd(true, true);
    let rotation = svd.u? * svd.v_t?;
    if rotation.determinant() < 0.0 {
        return None;
    }
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
    // The markers' plane is at mean_z of the platform; its origin is below.
    let origin = t - rotation * Vector3::new(0.0, 0.0, mean_z);
    // Seen from in front: the platform's z points at the camera.
    let up = rotation * Vector3::z();
    (up.dot(&t) < 0.0 && t.z > 0.0).then(|| Isometry3::from_parts(Translation3::from(origin), rotation))
}

/// The pose from three sights under parallel projection, in its two mirror forms: starts for [`refine`].
pub(crate) fn poses_from_three(
    layout: &MarkerLayout,
    camera: &CameraModel,
    sights: &[Sight; 3],
) -> Option<[Isometry3<f64>; 2]> {
    let n: [Vector2<f64>; 3] = [
        camera.undistort(&sights[0].pixel)?,
        camera.undistort(&sights[1].pixel)?,
        camera.undistort(&sights[2].pixel)?,
    ];
    let p = sights.map(|s| layout.centres[s.color]);
    // Affine map of the plane: n = t + A·(x, y).
    let (e, f) = (p[1] - p[0], p[2] - p[0]);
    let det = e.x * f.y - e.y * f.x;
    if det.abs() < 1e-9 {
        return None;
    }
    let (u, v) = (n[1] - n[0], n[2] - n[0]);
    let ax = (u * f.y - v * e.y) / det;
    let ay = (v * e.x - u * f.x) / det;
    // Columns of s·R[0..2, 0..2]: lengths and angle are completed by the third components c, d with |.| = s, orthogonal.
    let (aa, bb, ab) = (ax.norm_squared(), ay.norm_squared(), ax.dot(&ay));
    // s² = aa + c² = bb + d², c·d = −ab.
    let diff = aa - bb;
    let c2 = ((diff * diff + 4.0 * ab * ab).sqrt() - diff) / 2.0;
    let c = c2.max(0.0).sqrt();
    let s2 = aa + c2.max(0.0);
    let d_abs = (s2 - bb).max(0.0).sqrt();
    let d = if ab > 0.0 { -d_abs } else { d_abs };
    let s = s2.sqrt();
    if s.is_nan() || s <= 1e-9 {
        return None;
    }
    let make = |sign: f64| {
        let r1 = Vector3::new(ax.x, ax.y, sign * c) / s;
        let r2 = Vector3::new(ay.x, ay.y, sign * d) / s;
        let m = Matrix3::from_columns(&[r1, r2, r1.cross(&r2)]);
        let svd = m.svd(true, true);
        let (u, v_t) = (svd.u?, svd.v_t?);
        let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(u * v_t));
        let z = 1.0 / s;
        let origin = n[0] - ax * p[0].x - ay * p[0].y;
        let at = Vector3::new(origin.x * z, origin.y * z, z);
        let pose = Isometry3::from_parts(
            Translation3::from(at - rotation * Vector3::new(0.0, 0.0, p[0].z)),
            rotation,
        );
        ((rotation * Vector3::z()).dot(&at) < 0.0).then_some(pose)
    };
    match (make(1.0), make(-1.0)) {
        (Some(a), Some(b)) => Some([a, b]),
        (Some(a), None) | (None, Some(a)) => Some([a, a]),
        _ => None,
    }
}

/// A camera for images of which nothing is known: 60° wide, no distortion.
pub(crate) fn guessed_camera(width: usize, height: usize) -> Option<CameraModel> {
    let f = 0.9 * width.max(height) as f64;
    CameraModel::new(
        width as u32,
        height as u32,
        [f, f, (width as f64 - 1.0) / 2.0, (height as f64 - 1.0) / 2.0],
        rig_model::Distortion::PlumbBob([0.0; 5]),
    )
    .ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::Distortion;

    fn layout() -> MarkerLayout {
        MarkerLayout {
            side: 0.076,
            centres: PerColor([
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
    fn four_sights_give_the_pose_back() {
        for truth in poses() {
            let pixels =
                PerColor::from_fn(|c| layout().projected_centroid(c, &camera(), &truth).unwrap().pixel);
            let start = pose_from_four(&layout(), &camera(), &pixels).unwrap();
            let sights = MarkerColor::ALL.map(|color| Sight {
                color,
                pixel: pixels[color],
                sigma: 0.1,
                outline: None,
            });
            let (pose, rms) = refine(&layout(), &camera(), &sights, &start, None, 20).unwrap();
            assert!(rms < 1e-4, "{rms}");
            assert!((pose.translation.vector - truth.translation.vector).norm() < 1e-5);
            assert!(pose.rotation.angle_to(&truth.rotation) < 1e-5);
        }
    }

    #[test]
    fn mirrored_markers_are_refused() {
        for truth in poses() {
            let mut pixels =
                PerColor::from_fn(|c| layout().projected_centroid(c, &camera(), &truth).unwrap().pixel);
            pixels.0.swap(0, 2);
            pixels.0.swap(1, 3);
            // A half turn is a pose; a swap of two neighbours is none.
            assert!(pose_from_four(&layout(), &camera(), &pixels).is_some());
            pixels.0.swap(0, 1);
            assert!(pose_from_four(&layout(), &camera(), &pixels).is_none());
        }
    }

    #[test]
    fn three_sights_lead_to_the_pose_from_one_of_the_two_starts() {
        for truth in poses() {
            let sights = [MarkerColor::Red, MarkerColor::Blue, MarkerColor::Yellow].map(|color| Sight {
                color,
                pixel: layout().projected_centroid(color, &camera(), &truth).unwrap().pixel,
                sigma: 0.1,
                outline: None,
            });
            let best = poses_from_three(&layout(), &camera(), &sights)
                .unwrap()
                .iter()
                .filter_map(|s| refine(&layout(), &camera(), &sights, s, None, 30))
                .map(|(pose, _)| pose.rotation.angle_to(&truth.rotation))
                .fold(f64::INFINITY, f64::min);
            assert!(best < 1e-4, "{best}");
        }
    }
}
