//! Acquisition: the markers in the whole image, wherever they are.

use super::{
    COARSE_ROWS, Engine, MAX_TURN, ROWS, half_width_for, is_whole, learn::compare_outline, track::Slack,
};
use crate::{
    acquire::{Extent, Hypothesis, Strictness, hypotheses},
    blob::{CELL, ScanConfig, mean_rgb},
    geometry::{Sight, project_square, refine},
    image::ImageView,
    model::Appearance,
    signal::Sampler,
};
use nalgebra::{Isometry3, Vector2};
use rig_model::{CameraModel, MarkerColor, PerColor};

impl Engine {
    /// The markers in the whole image, wherever they are. True where they were found; pose and colours are then set.
    pub(super) fn acquire(&mut self, image: &ImageView<'_>, camera: &CameraModel) -> bool {
        let size = (image.width * image.height) as f64;
        let known = self.known_camera();
        let strictness = if known {
            Strictness { reprojection: 0.08, area: 1.8 }
        } else {
            Strictness { reprojection: 0.3, area: 2.2 }
        };
        let stride = (image.width.max(image.height) / 320).clamp(1, 8);
        let full = [0, 0, image.width as i32, image.height as i32];
        // Paper is more colourful than floors are: a coarse look for that. What is small or pale is left to a close one.
        let coarse = ScanConfig {
            stride: 2 * stride,
            grid: CELL,
            min_saturation: 0.28,
            min_layer: 20,
            min_area: 100.0,
            max_area: size / 6.0,
        };
        let close = ScanConfig {
            stride,
            grid: stride.clamp(4, 8),
            min_saturation: 0.15,
            min_layer: 12,
            min_area: 40.0,
            ..coarse
        };
        let mut found = std::mem::take(&mut self.found);
        let mut best = None;
        // The best fours first; three only where no four are confirmed.
        for (config, extents) in [
            (coarse, &[Extent::Quick] as &[Extent]),
            (close, &[Extent::Quick, Extent::Fours, Extent::Threes]),
        ] {
            self.scanner.scan(image, full, &config);
            for extent in extents {
                hypotheses(&self.layout, camera, &self.scanner.blobs, strictness, *extent, &mut found);
                best = self.best_of(image, camera, &found, known);
                if best.is_some() {
                    break;
                }
            }
            if best.is_some() {
                break;
            }
        }
        self.found = found;
        let Some(v) = best else { return false };
        self.pose = Some(v.pose);
        for color in MarkerColor::ALL {
            let m = &mut self.markers[color];
            if v.appearances[color].is_some() {
                m.appearance = v.appearances[color];
            }
            if let Some(t) = v.turns[color].filter(|_| m.turn.1 == 0) {
                m.turn = (t, 1);
            }
            (m.blur, m.miss) = (v.blurs[color], 0.4);
        }
        true
    }

    /// The hypothesis that its outlines confirm best; none where three markers could be in several places.
    fn best_of(
        &mut self,
        image: &ImageView<'_>,
        camera: &CameraModel,
        found: &[Hypothesis],
        known_camera: bool,
    ) -> Option<Verified> {
        let mut best: Option<Verified> = None;
        let mut rivals = 0;
        for h in found {
            let Some(v) = self.verify(image, camera, h, known_camera) else { continue };
            let better = best.as_ref().is_none_or(|b| (v.count, -v.error) > (b.count, -b.error));
            if let Some(b) = &best
                && b.count == v.count
                && !same_place(&b.centroids, &v.centroids)
            {
                rivals += 1;
            }
            if better {
                best = Some(v);
            }
            // Four outlines that stand as the layout has them to a fraction of a pixel are no chance.
            if best.as_ref().is_some_and(|b| b.count == 4 && b.error < 0.6) {
                return best;
            }
        }
        best.filter(|b| b.count == 4 || rivals == 0)
    }

    /// Looks at the outlines that a hypothesis claims.
    fn verify(
        &mut self,
        image: &ImageView<'_>,
        camera: &CameraModel,
        hypothesis: &Hypothesis,
        known_camera: bool,
    ) -> Option<Verified> {
        let mut v = Verified {
            pose: hypothesis.camera_from_volant,
            appearances: PerColor([None; 4]),
            turns: PerColor([None; 4]),
            centroids: PerColor([None; 4]),
            blurs: PerColor([0.0; 4]),
            count: 0,
            error: 0.0,
        };
        let mut outlines = [None; 4];
        let mut shape_error = 0.0;
        let mut side = 0.0;
        for color in MarkerColor::ALL {
            let Some(index) = hypothesis.blobs[color] else { continue };
            let Some(blob) = self.scanner.blobs.get(index).copied() else { continue };
            let turn = self.markers[color].turn.0;
            let Some(quad) = project_square(&self.layout, color, turn, camera, &v.pose) else { continue };
            let (_, place) = quad.area_and_centroid();
            let quad = quad.shifted(blob.centroid - place);
            let Some(mut appearance) = Appearance::learn(image, &quad) else { continue };
            if mean_rgb(image, blob.centroid, 1)
                .is_some_and(|rgb| self.scanner.palette.classify(rgb.map(|c| c as u8)).is_none())
            {
                continue;
            }
            let tolerance = if known_camera { 1.5 } else { 3.0 };
            let sampler = Sampler::new(image, &appearance.discriminant);
            let slack = Slack {
                half_width: 6.0,
                edge: tolerance,
                place: 6.0,
                slope: 0.12,
                gradient: None,
                rows: COARSE_ROWS,
            };
            let Some(first) = self.measure(&sampler, color, &quad, slack).filter(is_whole) else { continue };
            let slack =
                Slack { half_width: 3.0, edge: 0.5, place: 3.0, slope: 0.05, gradient: None, rows: ROWS };
            let Some(second) = self.measure(&sampler, color, &first.quad, slack).filter(is_whole) else {
                continue;
            };
            appearance.follow(image, &second.quad, 1.0);
            v.appearances[color] = Some(appearance);
            v.centroids[color] = Some(second.centroid);
            v.blurs[color] = half_width_for(&second);
            let more = compare_outline(&self.layout, color, turn, camera, &v.pose, &second)?.0;
            if (turn + more).abs() > MAX_TURN {
                continue;
            }
            v.turns[color] = Some(turn + more);
            outlines[color.index()] = Some((second.quad, turn + more));
            v.count += 1;
            side += second.area.sqrt();
            let spread = second.area.sqrt() - quad.area_and_centroid().0.abs().sqrt();
            shape_error += spread.powi(2);
        }
        if v.count < 3 {
            return None;
        }
        let sights: Vec<Sight> = MarkerColor::ALL
            .into_iter()
            .filter_map(|color| {
                let outline = outlines[color.index()];
                outline.and(Some(Sight { color, pixel: v.centroids[color]?, sigma: 0.1, outline }))
            })
            .collect();
        let (pose, rms) = refine(&self.layout, camera, &sights, &v.pose, None, 20)?;
        side /= v.count as f64;
        let limit = if known_camera { 0.35 + 0.02 * side } else { 2.0 + 0.1 * side };
        let shape = (shape_error / v.count as f64).sqrt();
        let shape_limit = if known_camera { 1.0 + 0.05 * side } else { 2.0 + 0.15 * side };
        if rms > limit || shape > shape_limit {
            return None;
        }
        v.pose = pose;
        v.error = rms + 0.2 * shape;
        Some(v)
    }
}

struct Verified {
    pose: Isometry3<f64>,
    appearances: PerColor<Option<Appearance>>,
    turns: PerColor<Option<f64>>,
    centroids: PerColor<Option<Vector2<f64>>>,
    /// Half-width across the edges that their blur needs, px; 0 where it was not measured.
    blurs: PerColor<f64>,
    count: usize,
    error: f64,
}

fn same_place(a: &PerColor<Option<Vector2<f64>>>, b: &PerColor<Option<Vector2<f64>>>) -> bool {
    a.0.iter().zip(&b.0).all(|(a, b)| match (a, b) {
        (Some(a), Some(b)) => (a - b).norm() < 3.0,
        _ => true,
    })
}
