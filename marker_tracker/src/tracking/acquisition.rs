//! Acquisition: the markers in the whole image, wherever they are.

use crate::{
    appearance::Appearance,
    association::{Hypothesis, Strictness, hypotheses},
    debug_view::Outcome,
    edge::Tolerance,
    geometry::PoseObservation,
    image::Pixels,
    outline::QuadFit,
    quad::Quad,
    scan::{CELL, Palette, ScanConfig, Scanner},
    signal::{Sampler, mean_rgb},
    tracking::{
        camera::View,
        meter::{KNOWN, ONE_PASS_ROWS, OutlineMeter, SEARCH},
        platform::{MAX_TURN, PlatformModel},
    },
};
use nalgebra::{Isometry3, Vector2};
use rig_model::{CameraModel, MarkerColor, PerColor};

/// How far from its predicted outline a patch is searched at least, px: the paper's search window.
pub(super) const PATCH_REACH: f64 = 25.0;

/// A marker that an acquisition has measured.
#[derive(Clone, Copy, Debug)]
pub(super) struct AcquiredMarker {
    pub appearance: Appearance,
    /// Turn in its plane, rad.
    pub turn: f64,
    /// Half-width across the edges that their blur needs, px.
    pub half_width: f64,
    centroid: Vector2<f64>,
}

/// A hypothesis that its outlines confirm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Acquired {
    /// `camera_from_volant`.
    pub pose: Isometry3<f64>,
    pub markers: PerColor<Option<AcquiredMarker>>,
    count: usize,
    /// Reprojection error and deviation of the sizes, px.
    error: f64,
}

impl Acquired {
    fn is_better_than(&self, other: &Self) -> bool {
        (self.count, -self.error) > (other.count, -other.error)
    }

    /// Whether no common marker is more than 3 px apart.
    fn is_at_the_place_of(&self, other: &Self) -> bool {
        self.markers.0.iter().zip(&other.markers.0).all(|(a, b)| match (a, b) {
            (Some(a), Some(b)) => (a.centroid - b.centroid).norm() < 3.0,
            _ => true,
        })
    }
}

/// Patches of the markers' colors and hypotheses; their memory is reused.
#[derive(Debug)]
pub(super) struct Acquisition {
    /// With the palette of the calibrated colors.
    pub scanner: Scanner,
    found: Vec<Hypothesis>,
}

impl Acquisition {
    /// RMS error (px) below which a hypothesis with four outlines needs no comparison: tuned;
    /// guarded by the clutter bag of `tests/bags`.
    const CERTAIN: f64 = 0.6;

    /// Creates the search for papers of these colors (mean r, g, b of 0–255), where calibrated.
    pub fn new(colors: &PerColor<Option<[f64; 3]>>) -> Self {
        Self { scanner: Scanner::new(Palette::new(colors)), found: Vec::with_capacity(64) }
    }

    /// The outline moved to the nearest patch of the marker's color, size and shape, at most
    /// [`PATCH_REACH`] + `reach` px away.
    pub fn nearest_patch(
        &mut self,
        image: &Pixels<'_>,
        color: MarkerColor,
        outline: &Quad,
        reach: f64,
    ) -> Option<Quad> {
        let (area, place) = outline.area_and_centroid();
        let config = ScanConfig {
            stride: 1,
            grid: 4,
            min_saturation: 38,
            min_layer: 10,
            min_area: 0.5 * area.abs(),
            max_area: 1.5 * area.abs(),
        };
        self.scanner.scan(image, outline.bounds(PATCH_REACH + reach), &config);
        let patches = self.scanner.patches.iter();
        let nearest = patches
            .filter(|b| b.color == color && !b.cut && (0.8..1.2).contains(&b.fill()))
            .min_by(|a, b| (a.centroid - place).norm().total_cmp(&(b.centroid - place).norm()))?;
        Some(outline.shifted(nearest.centroid - place))
    }

    /// Searches the whole image.
    ///
    /// # Errors
    /// Why the markers are not found, where no four, and no unambiguous three, are.
    pub fn search(
        &mut self,
        image: &Pixels<'_>,
        camera: &CameraModel,
        known_camera: bool,
        platform: &PlatformModel,
        meters: &PerColor<OutlineMeter>,
    ) -> Result<Acquired, PerColor<Outcome>> {
        let size = (image.width * image.height) as f64;
        // An assumed camera admits larger deviations.
        let strictness = if known_camera {
            Strictness { reprojection: 0.08, area: 1.8 }
        } else {
            Strictness { reprojection: 0.3, area: 2.2 }
        };
        let stride = (image.width.max(image.height) / 320).clamp(1, 8);
        let full = [0, 0, image.width as i32, image.height as i32];
        // Paper is more colorful than most floors: a coarse search for that first. Small or pale
        // markers are left to the fine one.
        let coarse = ScanConfig {
            stride: 2 * stride,
            grid: CELL,
            min_saturation: 71,
            min_layer: 20,
            min_area: 100.0,
            max_area: size / 6.0,
        };
        let fine = ScanConfig {
            stride,
            grid: stride.clamp(4, 8),
            min_saturation: 38,
            min_layer: 12,
            min_area: 40.0,
            ..coarse
        };
        let palette = self.scanner.palette;
        let verification = Verification { image, camera, known_camera, platform, meters, palette };
        let mut outcomes = PerColor([Outcome::NoPatch; 4]);
        // Three patches only where no four are confirmed.
        for (config, sizes) in [(coarse, &[false] as &[bool]), (fine, &[false, true])] {
            self.scanner.scan(image, full, &config);
            for patch in &self.scanner.patches {
                outcomes[patch.color] = Outcome::NotInLayout;
            }
            for by_threes in sizes {
                let (geometry, patches) = (platform.geometry(camera), &self.scanner.patches);
                hypotheses(geometry, patches, strictness, *by_threes, &mut self.found);
                if let Some(best) = verification.best_of(&self.found, &mut outcomes) {
                    return Ok(best);
                }
            }
        }
        Err(outcomes)
    }
}

/// Measures the outlines that hypotheses claim.
struct Verification<'a, 'p> {
    image: &'a Pixels<'p>,
    camera: &'a CameraModel,
    known_camera: bool,
    platform: &'a PlatformModel,
    meters: &'a PerColor<OutlineMeter>,
    palette: Palette,
}

impl Verification<'_, '_> {
    /// The hypothesis that its outlines confirm best; none where three markers could be in several
    /// places. Notes in `outcomes` which outlines the likeliest hypothesis lacks.
    fn best_of(&self, found: &[Hypothesis], outcomes: &mut PerColor<Outcome>) -> Option<Acquired> {
        let mut best: Option<Acquired> = None;
        let mut ambiguous = false;
        for (rank, hypothesis) in found.iter().enumerate() {
            let mut measured = PerColor([false; 4]);
            let Some(v) = self.verify(hypothesis, &mut measured) else {
                for color in MarkerColor::ALL.into_iter().filter(|_| rank == 0) {
                    if hypothesis.patches[color].is_some() && !measured[color] {
                        outcomes[color] = Outcome::NoOutline;
                    }
                }
                continue;
            };
            if let Some(b) = &best {
                ambiguous |= b.count == v.count && !b.is_at_the_place_of(&v);
            }
            if best.as_ref().is_none_or(|b| v.is_better_than(b)) {
                best = Some(v);
            }
            if best.as_ref().is_some_and(|b| b.count == 4 && b.error < Acquisition::CERTAIN) {
                return best;
            }
        }
        if ambiguous && let Some(found) = best.take_if(|b| b.count < 4) {
            for color in MarkerColor::ALL.into_iter().filter(|c| found.markers[*c].is_some()) {
                outcomes[color] = Outcome::Ambiguous;
            }
        }
        best
    }

    /// Measures the outlines of one hypothesis and refines its pose. Notes which were `measured`.
    fn verify(&self, hypothesis: &Hypothesis, measured: &mut PerColor<bool>) -> Option<Acquired> {
        let start = View {
            camera: self.camera,
            is_known: self.known_camera,
            pose: hypothesis.camera_from_volant,
        };
        let mut markers = PerColor([None; 4]);
        let mut observations = [PoseObservation::NONE; 4];
        let (mut count, mut side, mut shape_error) = (0, 0.0, 0.0);
        for color in MarkerColor::ALL {
            let Some(patch) = &hypothesis.patches[color] else { continue };
            let Some(predicted) = self.platform.outline(color, &start) else { continue };
            let (_, place) = predicted.area_and_centroid();
            let predicted = predicted.shifted(patch.centroid - place);
            let Some(mut appearance) = Appearance::sample(self.image, &predicted) else { continue };
            if mean_rgb(self.image, patch.centroid, 1)
                .is_some_and(|rgb| self.palette.classify_mean(rgb.map(|v| v as f32)).is_none())
            {
                continue;
            }
            let Some(fit) = self.measure(color, &appearance, &predicted) else { continue };
            measured[color] = true;
            appearance.adapt(self.image, &fit.quad, 1.0);
            let turn = self.platform.turn_of(color, &start, &fit);
            let Some(turn) = turn.filter(|turn| turn.abs() <= MAX_TURN) else { continue };
            let centroid = fit.centroid;
            markers[color] =
                Some(AcquiredMarker { appearance, turn, half_width: fit.half_width(), centroid });
            let outline = Some((fit.quad, turn));
            observations[count] =
                PoseObservation { color, pixel: centroid, sigma: PoseObservation::SIGMA, outline };
            count += 1;
            side += fit.area.sqrt();
            let spread = fit.area.sqrt() - predicted.area_and_centroid().0.abs().sqrt();
            shape_error += spread.powi(2);
        }
        if count < 3 {
            return None;
        }
        let observations = &observations[..count];
        let geometry = self.platform.geometry(self.camera);
        let (pose, rms, _) = geometry.refine(observations, &start.pose, None, 20)?;
        side /= count as f64;
        let shape = (shape_error / count as f64).sqrt();
        // Largest RMS errors of position and size, px: of a layout measured by hand and, with an
        // assumed camera, of its focal length and distortion. Tuned; guarded by `tests/bags` and
        // `tests/synthetic`.
        let (limit, shape_limit) = if self.known_camera {
            (0.35 + 0.02 * side, 1.0 + 0.05 * side)
        } else {
            (2.0 + 0.1 * side, 2.0 + 0.15 * side)
        };
        (rms <= limit && shape <= shape_limit).then_some(Acquired {
            pose,
            markers,
            count,
            error: rms + 0.2 * shape,
        })
    }

    /// Measures a whole outline about a patch: its place is known to a few pixels, its size and
    /// turn roughly.
    fn measure(
        &self,
        color: MarkerColor,
        appearance: &Appearance,
        predicted: &Quad,
    ) -> Option<QuadFit> {
        let sampler = Sampler::new(self.image, &appearance.discriminant);
        let edge = if self.known_camera { 1.5 } else { 3.0 };
        let wide = Tolerance { half_width: 6.0, edge, place: 6.0, slope: 0.12, ..SEARCH };
        let narrow = Tolerance { half_width: 3.0, slope: 0.05, rows: ONE_PASS_ROWS, ..KNOWN };
        let meter = &self.meters[color];
        let first = meter.measure(&sampler, predicted, wide).filter(QuadFit::is_whole)?;
        meter.measure(&sampler, &first.quad, narrow).filter(QuadFit::is_whole)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        config::TrackerConfig, engine::Engine, image::fixtures::drawn, tracking::Pipeline,
    };
    use nalgebra::Point3;
    use rig_model::{Distortion, MarkerLayout, Stamp};

    #[test]
    fn an_acquisition_forgets_the_levels_of_the_former_colors() {
        const PAINT: [[u8; 3]; 4] = [[168, 47, 49], [77, 132, 76], [40, 93, 146], [194, 166, 67]];
        let corners = [(0.15, 0.15), (-0.15, 0.15), (-0.15, -0.15), (0.15, -0.15)];
        // At a distance of 1.2 m, seen from in front: squares of 25 px.
        let squares: [_; 4] = std::array::from_fn(|i| {
            let (x, y) = corners[i];
            let (left, top) = ((147.0 + 333.0 * x) as usize, (107.0 - 333.0 * y) as usize);
            ([left, top, left + 25, top + 25], PAINT[i])
        });
        let image = drawn(320, 240, 125, &squares);
        let image = Pixels::whole(image.view(Stamp::default()), None);
        let centers = PerColor(corners.map(|(x, y)| Point3::new(x, y, 0.0)));
        let layout = MarkerLayout { side: 0.076, centers };
        let lens = Distortion::PlumbBob([0.0; 5]);
        let camera = CameraModel::new(320, 240, [400.0, 400.0, 159.5, 119.5], lens).unwrap();
        let mut pipeline = Pipeline::new(layout, TrackerConfig::default());
        pipeline.set_camera(camera.clone());
        pipeline.process(&image).unwrap();
        assert!(pipeline.state.markers.0.iter().all(|m| m.edges.levels.is_some()));
        assert!(pipeline.acquire(&image, &camera));
        assert!(pipeline.state.markers.0.iter().all(|m| m.edges.levels.is_none()));
    }
}
