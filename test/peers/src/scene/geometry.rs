//! The camera's projection and exact areas of polygons.

use nalgebra::{Isometry3, Point3, Vector2};
use rig_model::{CameraModel, Distortion};

/// A camera without distortion; the center of the top left pixel is (0, 0).
#[derive(Clone, Copy, Debug)]
pub struct Pinhole {
    /// Focal length, px.
    pub focal: f64,
    pub width: usize,
    pub height: usize,
}

impl Pinhole {
    /// 640×480, f = 600 px.
    pub const BENCH: Self = Self { focal: 600.0, width: 640, height: 480 };

    /// Principal point, px.
    pub fn center(&self) -> Vector2<f64> {
        Vector2::new((self.width as f64 - 1.0) / 2.0, (self.height as f64 - 1.0) / 2.0)
    }

    /// Pixel of a point in the camera frame.
    pub fn project(&self, point: &Point3<f64>) -> Vector2<f64> {
        Vector2::new(point.x, point.y) * (self.focal / point.z) + self.center()
    }

    /// Pixels of a polygon of the plane `z = height` of a body.
    pub fn polygon(
        &self,
        camera_from_body: &Isometry3<f64>,
        corners: &[[f64; 2]],
        height: f64,
    ) -> Vec<Vector2<f64>> {
        corners
            .iter()
            .map(|c| self.project(&(camera_from_body * Point3::new(c[0], c[1], height))))
            .collect()
    }

    /// The same camera as the project's own code takes it.
    pub fn model(&self) -> CameraModel {
        let c = self.center();
        CameraModel::new(
            self.width as u32,
            self.height as u32,
            [self.focal, self.focal, c.x, c.y],
            Distortion::PlumbBob([0.0; 5]),
        )
        .unwrap_or_else(|e| unreachable!("constants of this bench: {e}"))
    }
}

/// Signed area and centroid of a polygon.
pub fn polygon_centroid(polygon: &[Vector2<f64>]) -> (f64, Vector2<f64>) {
    let origin = polygon[0];
    let (mut area, mut moment) = (0.0, Vector2::zeros());
    for i in 0..polygon.len() {
        let (a, b) = (polygon[i] - origin, polygon[(i + 1) % polygon.len()] - origin);
        let cross = a.x * b.y - a.y * b.x;
        area += cross;
        moment += (a + b) * cross;
    }
    (area / 2.0, origin + moment / (3.0 * area))
}

/// Area of the part of a convex polygon that lies in the pixel square around `(x, y)`: 0 to 1.
pub fn clip_area(polygon: &[Vector2<f64>], x: f64, y: f64) -> f64 {
    let mut a = [Vector2::zeros(); 16];
    let mut b = [Vector2::zeros(); 16];
    let mut n = polygon.len().min(10);
    a[..n].copy_from_slice(&polygon[..n]);
    for (axis, sign, limit) in
        [(0, 1.0, x + 0.5), (0, -1.0, -(x - 0.5)), (1, 1.0, y + 0.5), (1, -1.0, -(y - 0.5))]
    {
        let mut m = 0;
        for i in 0..n {
            let (p, q) = (a[i], a[(i + 1) % n]);
            let (dp, dq) = (sign * p[axis] - limit, sign * q[axis] - limit);
            if dp <= 0.0 {
                b[m] = p;
                m += 1;
            }
            if (dp < 0.0 && dq > 0.0) || (dp > 0.0 && dq < 0.0) {
                b[m] = p + (q - p) * (dp / (dp - dq));
                m += 1;
            }
        }
        if m < 3 {
            return 0.0;
        }
        a[..m].copy_from_slice(&b[..m]);
        n = m;
    }
    let mut area = 0.0;
    for i in 0..n {
        let (p, q) = (a[i] - a[0], a[(i + 1) % n] - a[0]);
        area += p.x * q.y - p.y * q.x;
    }
    (area / 2.0).abs()
}
