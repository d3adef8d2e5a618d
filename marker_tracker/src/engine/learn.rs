//! What clean looks teach: colours, turns, edge bias, the correlation and the excess of the noise.

use super::{Engine, MAX_TURN, is_whole};
use crate::{
    geometry::{Sight, project_square, refine},
    image::ImageView,
    outline::{Levels, QuadFit},
    quad::Quad,
};
use nalgebra::{Isometry3, Matrix2, Vector2};
use rig_model::{CameraModel, MarkerColor, MarkerLayout};

/// From so many images on what was learnt changes slowly: the mean of the last ones, not their noise.
const LEARNT: u32 = 12;

impl Engine {
    /// How much larger the centroids' squared residuals about the best pose are than their covariances say: four
    /// centroids over-determine it by two. What the rows of an edge cannot tell (JPEG's blocks, demosaicing, paper that is
    /// not flat) is learnt so.
    pub(super) fn learn_noise(&mut self, camera: &CameraModel, pose: &Isometry3<f64>) {
        let mut sights =
            [Sight { color: MarkerColor::Red, pixel: Vector2::zeros(), sigma: 1.0, outline: None }; 4];
        let mut covariances = [Matrix2::identity(); 4];
        for color in MarkerColor::ALL {
            let m = &self.markers[color];
            let Some(f) = m.fit.filter(is_whole).filter(|_| m.placed > LEARNT) else { return };
            let sigma = (f.covariance.trace() / 2.0).sqrt();
            sights[color.index()] = Sight { color, pixel: f.centroid, sigma, outline: None };
            // As they are without what is learnt here.
            covariances[color.index()] = f.covariance * (self.correlation() / f.inflation);
        }
        let Some((best, _)) = refine(&self.layout, camera, &sights, pose, None, 4) else { return };
        let mut chi2 = 0.0;
        for (s, c) in sights.iter().zip(&covariances) {
            let Some(p) = self.layout.projected_centroid(s.color, camera, &best) else { return };
            let Some(inverse) = c.try_inverse() else { return };
            let r = s.pixel - p.pixel;
            chi2 += (r.transpose() * inverse * r)[0];
        }
        if chi2.is_finite() && chi2 < 200.0 {
            // A frame in which something went wrong is not to teach the noise.
            self.excess[0] += chi2.min(30.0);
            self.excess[1] += 2.0;
        }
        if self.excess[1] > 400.0 {
            self.excess = self.excess.map(|v| v * 0.5);
        }
    }

    /// Keeps what a clean look teaches: colours, turn, edge bias, correlation of the noise.
    pub(super) fn learn(&mut self, image: &ImageView<'_>, camera: &CameraModel, pose: &Isometry3<f64>) {
        let detected = self.markers.0.iter().filter(|m| m.fit.is_some()).count();
        for color in MarkerColor::ALL {
            let Some(f) = self.markers[color].fit.filter(is_whole) else { continue };
            for e in f.edges.iter().flatten() {
                for (sum, lag) in self.lag.iter_mut().zip(&e.lag) {
                    *sum += lag;
                }
            }
            let m = &mut self.markers[color];
            // Light drifts slowly: one marker's colours per image.
            if self.images % 4 == color.index() as u32
                && let Some(a) = &mut m.appearance
            {
                a.follow(image, &f.quad, 0.3);
            }
            if let Some(now) = Levels::of(&f) {
                match &mut m.levels {
                    Some(levels) => levels.follow(&now, 0.2),
                    None => m.levels = Some(now),
                }
            }
            // What is known well changes no more: one marker per image.
            if m.turn.1 > 30 && m.edge_bias.1 > 30 && self.images % 4 != color.index() as u32 {
                continue;
            }
            // Three leave the tilt too open to teach sizes from it, but the turn hardly depends on it.
            if detected < 3 || (detected < 4 && m.turn.1 > 10) {
                continue;
            }
            let turn = m.turn.0;
            let Some((more, bias)) = compare_outline(&self.layout, color, turn, camera, pose, &f) else {
                continue;
            };
            let rate = |n: u32| 1.0 / f64::from(n.min(LEARNT) + 1);
            m.turn.0 = (turn + rate(m.turn.1) * more).clamp(-MAX_TURN, MAX_TURN);
            m.turn.1 = m.turn.1.saturating_add(1);
            if detected < 4 {
                continue;
            }
            let gain = rate(m.edge_bias.1);
            for (known, now) in m.edge_bias.0.iter_mut().zip(bias) {
                *known += gain * (now - *known).clamp(-1.0, 1.0);
            }
            m.edge_bias.1 = m.edge_bias.1.saturating_add(1);
            self.place(camera, pose, color, &f);
        }
        if self.lag[0] > 100.0 {
            self.lag = self.lag.map(|v| v * 0.5);
        }
    }
}

/// A marker is sought as far as this from where the rig file has it, in parts of its side.
const MISPLACED: f64 = 0.15;

impl Engine {
    /// Moves a marker on the platform towards where it is seen. The four centroids over-determine the pose by two; what they leave
    /// of it, pose after pose, is how the layout was measured.
    fn place(&mut self, camera: &CameraModel, pose: &Isometry3<f64>, color: MarkerColor, f: &QuadFit) {
        let Some(p) = self.layout.projected_centroid(color, camera, pose) else { return };
        let plane = pose.rotation.to_rotation_matrix().matrix().fixed_columns::<2>(0).into_owned();
        let Some(inverse) = (p.jacobian_by_centre * plane).try_inverse() else { return };
        let off = f.centroid - p.pixel;
        let m = &mut self.markers[color];
        // What is known is not to be moved by an outline that something touches.
        if m.placed > 5 && off.norm() > 0.3 + 3.0 * m.misplaced {
            return;
        }
        m.misplaced += 0.2 * (off.norm() - m.misplaced);
        let by = inverse * off / f64::from(m.placed.min(LEARNT) + 1);
        m.placed = m.placed.saturating_add(1);
        let limit = MISPLACED * self.layout.side;
        let (given, place) = (self.given.centres[color], &mut self.layout.centres[color]);
        for i in 0..2 {
            place[i] = (place[i] + by[i]).clamp(given[i] - limit, given[i] + limit);
        }
    }
}

/// By how much an outline is turned further than `turn` (rad), and how far its edges lie outside of the geometry (px).
pub(super) fn compare_outline(
    layout: &MarkerLayout,
    color: MarkerColor,
    turn: f64,
    camera: &CameraModel,
    pose: &Isometry3<f64>,
    f: &QuadFit,
) -> Option<(f64, [f64; 2])> {
    let here = project_square(layout, color, turn, camera, pose)?;
    let turned = project_square(layout, color, turn + 0.01, camera, pose)?;
    let (mut gain, mut sum, mut bias) = (0.0, 0.0, [0.0; 2]);
    let (_, here_centre) = here.area_and_centroid();
    for i in 0..4 {
        let side = |q: &Quad| q.0[(i + 1) % 4] - q.0[i];
        let (a, b, measured) = (side(&here), side(&turned), side(&f.quad));
        let turn_of = |v: &Vector2<f64>| (a.x * v.y - a.y * v.x).atan2(a.dot(v));
        let g = turn_of(&b) / 0.01;
        gain += g * g;
        sum += g * turn_of(&measured);
        // Distance of the measured edge's middle outside of the predicted one, about the same centre.
        let normal = Vector2::new(a.y, -a.x) / a.norm();
        let outward = (here.0[i] + here.0[(i + 1) % 4]) / 2.0 - here_centre;
        let normal = if normal.dot(&outward) < 0.0 { -normal } else { normal };
        let half = |q: &Quad, c: Vector2<f64>| ((q.0[i] + q.0[(i + 1) % 4]) / 2.0 - c).dot(&normal);
        bias[i % 2] += (half(&f.quad, f.centroid) - half(&here, here_centre)) / 2.0;
    }
    let more = sum / gain;
    (more.is_finite() && bias.iter().all(|b| b.is_finite())).then_some((more, bias))
}
