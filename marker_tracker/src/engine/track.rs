//! Tracking: each marker is sought near where it should be, by its flow and its hue, and the four must agree.

use super::{COARSE, COARSE_ROWS, Engine, ROWS, half_width_for, is_told, is_whole};
use crate::{
    blob::ScanConfig,
    edge::MAX_ROWS,
    geometry::{PosePrior, Sight, project_square, refine},
    image::ImageView,
    model::{Appearance, HueHistogram},
    outline::{QuadFit, ShapePrior, fit},
    quad::Quad,
    signal::Sampler,
};
use nalgebra::{Isometry3, Vector2};
use rig_model::{CameraModel, MarkerColor, PerColor};

/// Likeness (0 to 1) of the hue histograms from which on a thing can be the marker.
const MIN_LIKENESS: f32 = 0.6;
/// Sum of the four edges' supports from which on a square is but touched: each edge was seen along enough of its own length.
const TOUCHED: f64 = 3.3;
/// Pixels around the sought outline that a window shows.
const MARGIN: f64 = 9.0;
/// Pixels around it that are read in a quick look.
const STRIP: f64 = 5.0;

/// The part of the image around an outline.
fn window_of(image: &ImageView<'_>, quad: &Quad, margin: f64) -> [i32; 4] {
    let (w, h) = (image.width as i32, image.height as i32);
    let [x0, y0, x1, y1] = quad.bounds(margin);
    let (x0, y0) = (x0.clamp(0, w), y0.clamp(0, h));
    [x0, y0, x1.clamp(x0, w), y1.clamp(y0, h)]
}

/// Asks for a window's pixels, all at once: a fresh image is far from the core, and the rows that are read later would each
/// wait for their own.
fn fetch(image: &ImageView<'_>, [x0, y0, x1, y1]: [i32; 4]) {
    const LINE: usize = 64;
    let bytes = image.format.bytes_per_pixel();
    let mut sum = 0u8;
    for y in y0..y1 {
        let start = y as usize * image.step;
        let row = image.data.get(start + x0 as usize * bytes..start + x1 as usize * bytes).unwrap_or(&[]);
        for line in row.chunks(LINE) {
            sum ^= line[0];
        }
    }
    std::hint::black_box(sum);
}

/// How much is known beforehand of an outline's edges.
#[derive(Clone, Copy)]
pub(super) struct Slack {
    /// Half-width across the edges that is read, px.
    pub half_width: f64,
    /// Standard deviations as in [`ShapePrior`]: px, px, rad.
    pub edge: f64,
    pub place: f64,
    pub slope: f64,
    /// As in [`ShapePrior`].
    pub gradient: Option<Vector2<f64>>,
    /// Most rows of an edge that are read.
    pub rows: usize,
}

/// Least contrast of an edge, in units of that in which the marker's colours were learnt: light may drop to 0.45 of what it was.
const MIN_CONTRAST: f64 = 0.35;
/// Standard deviation of a centroid up to which one look is enough, px: where noise or compression leave more, a second look
/// about the place that was found gains a quarter.
const CERTAIN: f64 = 0.025;
/// While an outline is sought, and once it is known.
const SOUGHT: Slack =
    Slack { half_width: COARSE, edge: 1.0, place: 3.0, slope: 0.06, gradient: None, rows: COARSE_ROWS };
const KNOWN: Slack =
    Slack { half_width: 2.0, edge: 0.5, place: 3.0, slope: 0.03, gradient: None, rows: MAX_ROWS };

impl Engine {
    /// The image as it shows a marker.
    pub(super) fn sampler<'a>(&self, image: &ImageView<'a>, color: MarkerColor) -> Option<Sampler<'a>> {
        self.markers[color].appearance.as_ref().map(|a| Sampler::new(image, &a.discriminant))
    }

    /// Fits the outline near `quad`.
    pub(super) fn measure(
        &self,
        sampler: &Sampler<'_>,
        color: MarkerColor,
        quad: &Quad,
        slack: Slack,
    ) -> Option<QuadFit> {
        let prior = ShapePrior {
            edge_bias: self.markers[color].edge_bias.0,
            edge_sigma: slack.edge,
            place_sigma: slack.place,
            slope_sigma: slack.slope,
            correlation: self.correlation(),
            inflation: self.inflation(),
            half_width: slack.half_width,
            rows: slack.rows,
            gradient: slack.gradient,
            // As long as its shape is not known all edges are needed, whatever is beside them.
            levels: self.markers[color].levels.filter(|_| self.markers[color].edge_bias.1 > 3),
        };
        fit(sampler, quad, &prior, MIN_CONTRAST)
    }

    /// Whether what is inside has the marker's hues, where that is asked.
    fn hue_agrees(&self, image: &ImageView<'_>, color: MarkerColor, quad: &Quad) -> bool {
        if !self.config.use_hue {
            return true;
        }
        let Some(appearance) = self.markers[color].appearance.as_ref() else { return false };
        HueHistogram::of(image, quad).is_some_and(|h| h.likeness(&appearance.hue) > MIN_LIKENESS)
    }

    /// A whole outline where it should be. One look is enough where the last images told how wide the edges are and how
    /// well they are foretold, and the outline is found within that; else a wide look comes first.
    fn follow(&mut self, sampler: &Sampler<'_>, color: MarkerColor, quad: &Quad) -> Option<QuadFit> {
        let m = &self.markers[color];
        let mut found = None;
        if m.blur > 0.0 {
            let half_width = (m.blur + (1.3 * m.miss - 0.3).max(0.0)).min(COARSE - 0.1);
            let rows = if m.gradient.is_some() { ROWS } else { MAX_ROWS };
            let slack = Slack { half_width, gradient: m.gradient, rows, ..KNOWN };
            let f = self.measure(sampler, color, quad, slack).filter(is_whole);
            found = f.filter(|f| {
                let certain = f.covariance.trace() < 2.0 * CERTAIN * CERTAIN;
                certain && half_width_for(f) + f.miss - 0.4 <= half_width
            });
        }
        let found = found.or_else(|| {
            let first = self.measure(sampler, color, quad, SOUGHT).filter(is_whole)?;
            let slack = Slack { half_width: half_width_for(&first), ..KNOWN };
            let mut second = self.measure(sampler, color, &first.quad, slack).filter(is_whole)?;
            // The miss is that of the place where it was sought.
            second.miss += first.miss;
            Some(second)
        });
        let m = &mut self.markers[color];
        match &found {
            Some(f) => {
                m.blur = half_width_for(f);
                m.gradient = Some(f.gradient);
                m.miss = f.miss.max(0.85 * m.miss).clamp(0.1, 1.5);
            }
            None => (m.blur, m.gradient) = (0.0, None),
        }
        found
    }

    /// Looks for each marker near where it should be; the number of those detected.
    pub(super) fn track(&mut self, image: &ImageView<'_>, camera: &CameraModel, ratio: f64) -> usize {
        let Some(pose) = self.pose else { return 0 };
        let mut whole: [Option<QuadFit>; 4] = [None; 4];
        let start = self.predicted(&pose, ratio);
        let quads = PerColor::from_fn(|color| {
            let quad = project_square(&self.layout, color, self.markers[color].turn.0, camera, &start)?;
            fetch(image, window_of(image, &quad, STRIP));
            Some(quad)
        });
        for color in MarkerColor::ALL {
            let Some(sampler) = self.sampler(image, color) else { continue };
            let Some(quad) = quads[color] else { continue };
            let quad = if self.config.use_flow { self.moved_by_flow(&sampler, color, &quad) } else { quad };
            self.markers[color].window = window_of(image, &quad, MARGIN);
            let found = self.follow(&sampler, color, &quad).or_else(|| self.search(image, color, &quad));
            whole[color.index()] = match found {
                Some(f) if !self.hue_agrees(image, color, &f.quad) => {
                    self.markers[color].reason = "of another hue";
                    None
                }
                other => other,
            };
        }
        let known = self.known_camera();
        let now = self.agree(camera, &start, known, &mut whole);
        // What is covered in part, or was not where it was sought: again, from the pose that the others tell.
        let mut detected = whole.iter().flatten().count();
        let trust = match detected {
            0 => None,
            1 => Some((3.0, 0.4)),
            2 => Some((2.0, 0.25)),
            _ => Some((0.8, 0.1)),
        };
        for color in MarkerColor::ALL {
            if let Some(f) = whole[color.index()] {
                self.markers[color].fit = Some(f);
                self.markers[color].reason = "whole";
                continue;
            }
            let Some((place_sigma, edge_sigma)) = trust else { continue };
            self.markers[color].reason = "covered";
            let Some(fit) = self.measure_again(image, color, camera, &now, edge_sigma, place_sigma) else {
                continue;
            };
            if !self.hue_agrees(image, color, &fit.quad) {
                self.markers[color].reason = "of another hue";
                continue;
            }
            let expected = self.layout.projected_centroid(color, camera, &now).map(|p| p.pixel);
            let known_shape = self.markers[color].edge_bias.1 > 3 && self.markers[color].placed > 3;
            let sigma_of = |f: &QuadFit| (f.covariance.trace() / 2.0).sqrt();
            let sigma = sigma_of(&fit) + whole.iter().flatten().map(sigma_of).fold(0.0, f64::max);
            // What two markers tell of the pose does not suffice to tell a cover's edge from the marker's.
            let (room, edges, support) = match (known && known_shape, whole.iter().flatten().count()) {
                (true, 3) => (0.15 + 3.0 * sigma + 2.0 * self.markers[color].misplaced, 2, 0.4),
                _ => (3.0 * place_sigma, 3, 0.92),
            };
            let own = || fit.edges.iter().flatten().filter(|e| !e.foreign);
            let touched = own().count() == 4
                && own().all(|e| e.support > 0.5)
                && own().map(|e| e.support).sum::<f64>() > TOUCHED;
            if own().filter(|e| e.support > support).count() < edges && !(touched && known && known_shape) {
                continue;
            }
            if self.misfit(color, &fit, camera, &now, detected.min(3), known) > 1.0 {
                self.markers[color].reason = "covered in part, and of another shape";
                continue;
            }
            if expected.is_some_and(|e| (e - fit.centroid).norm() < room) {
                self.markers[color].fit = Some(fit);
                self.markers[color].reason = "covered in part, told by its other edges";
                detected += 1;
            } else {
                self.markers[color].reason = "not where the other markers say";
            }
        }
        // Before the layout goes after this image's noise.
        if known && self.images % 2 == 1 {
            self.learn_noise(camera, &now);
        }
        self.learn(image, camera, &now);
        self.pose = Some(now);
        detected
    }

    /// The predicted outline, moved to where the optical flow has it.
    fn moved_by_flow(&self, sampler: &Sampler<'_>, color: MarkerColor, quad: &Quad) -> Quad {
        let m = &self.markers[color];
        let Some(before) = m.centroid else { return *quad };
        let (_, place) = quad.area_and_centroid();
        let foretold = place - before;
        match m.outline.displacement(sampler, foretold) {
            Some(flow) => quad.shifted(flow - foretold),
            None => *quad,
        }
    }

    /// What a whole outline tells of the pose. Its corners are asked only where the centroids leave the tilt open.
    pub(super) fn sight(&self, color: MarkerColor, f: &QuadFit, with_outline: bool) -> Sight {
        let m = &self.markers[color];
        // Paper cut too large or a blooming sensor widen the outline; that is not nearness.
        let scale = 1.0 - (m.edge_bias.0[0] + m.edge_bias.0[1]) / f.area.sqrt().max(1.0);
        let outline = Quad(f.quad.0.map(|c| f.centroid + (c - f.centroid) * scale));
        Sight {
            color,
            pixel: f.centroid,
            sigma: 0.1,
            outline: (with_outline && m.turn.1 > 0).then_some((outline, m.turn.0)),
        }
    }

    /// A marker at the place that the others' pose gives, covered in part as it may be.
    fn measure_again(
        &mut self,
        image: &ImageView<'_>,
        color: MarkerColor,
        camera: &CameraModel,
        pose: &Isometry3<f64>,
        edge_sigma: f64,
        place_sigma: f64,
    ) -> Option<QuadFit> {
        let quad = project_square(&self.layout, color, self.markers[color].turn.0, camera, pose)?;
        let (unknown, known_turn) =
            (self.markers[color].appearance.is_none(), self.markers[color].turn.1 > 5);
        if unknown {
            let appearance = Appearance::learn(image, &quad)?;
            let rgb = appearance.marker.map(|v| v as u8);
            if self.scanner.palette.classify(rgb).is_none_or(|(c, _, _)| c != color) {
                return None;
            }
            self.markers[color].appearance = Some(appearance);
        }
        let sampler = self.sampler(image, color)?;
        let result = if known_turn {
            let (_, place) = quad.area_and_centroid();
            let slack =
                Slack { half_width: 3.5, edge: edge_sigma, place: place_sigma, slope: 0.012, ..KNOWN };
            self.measure(&sampler, color, &quad, slack)
                .and_then(|f| {
                    let quad = quad.shifted(f.centroid - place);
                    self.measure(&sampler, color, &quad, Slack { half_width: 2.5, ..slack })
                })
                .filter(|f| is_told(f, &self.config))
        } else {
            self.measure(
                &sampler,
                color,
                &quad,
                Slack { half_width: 5.0, slope: 0.1, rows: MAX_ROWS, ..SOUGHT },
            )
            .filter(is_whole)
            .and_then(|f| {
                let slack = Slack { half_width: half_width_for(&f), ..KNOWN };
                self.measure(&sampler, color, &f.quad, slack)
            })
            .filter(is_whole)
        };
        if unknown && result.is_none() {
            self.markers[color].appearance = None;
        }
        result
    }

    /// A marker that is further off than an edge can be followed: by its patch of colour.
    fn search(&mut self, image: &ImageView<'_>, color: MarkerColor, quad: &Quad) -> Option<QuadFit> {
        let (area, place) = quad.area_and_centroid();
        let margin = 25.0 + self.markers[color].flow.norm();
        let config = ScanConfig {
            stride: 1,
            grid: 4,
            min_saturation: 0.15,
            min_layer: 10,
            min_area: 0.5 * area.abs(),
            max_area: 1.5 * area.abs(),
        };
        self.scanner.scan(image, quad.bounds(margin), &config);
        let blob = self
            .scanner
            .blobs
            .iter()
            .filter(|b| b.color == color && !b.cut && (0.8..1.2).contains(&b.fill()))
            .min_by(|a, b| (a.centroid - place).norm().total_cmp(&(b.centroid - place).norm()))?;
        let quad = quad.shifted(blob.centroid - place);
        let sampler = self.sampler(image, color)?;
        let first = self.measure(&sampler, color, &quad, SOUGHT).filter(is_whole)?;
        let slack = Slack { half_width: half_width_for(&first), ..KNOWN };
        self.measure(&sampler, color, &first.quad, slack).filter(is_whole)
    }

    /// The pose that the whole outlines tell. Four centroids over-determine it by two, and each square has the widths that
    /// the pose gives it: what does not fit is no marker, or a marker whose edge is hidden behind a straight thing.
    fn agree(
        &mut self,
        camera: &CameraModel,
        start: &Isometry3<f64>,
        known_camera: bool,
        whole: &mut [Option<QuadFit>; 4],
    ) -> Isometry3<f64> {
        let prior = PosePrior { camera_from_volant: *start, position_sigma: 0.1, rotation_sigma: 0.1 };
        loop {
            let mut sights =
                [Sight { color: MarkerColor::Red, pixel: Vector2::zeros(), sigma: 0.1, outline: None }; 4];
            let count = whole.iter().flatten().count();
            let mut n = 0;
            for color in MarkerColor::ALL {
                if let Some(f) = whole[color.index()] {
                    sights[n] = self.sight(color, &f, count < 4);
                    n += 1;
                }
            }
            let sights = &sights[..n];
            if n == 0 {
                return *start;
            }
            let Some((now, rms)) = refine(&self.layout, camera, sights, start, Some(&prior), 8) else {
                return *start;
            };
            if n < 2 {
                return now;
            }
            // The outline that is most off the shape that the pose gives it.
            let (mut worst, mut culprit) = (0.0, None);
            for s in sights {
                let Some(f) = &whole[s.color.index()] else { continue };
                let off = self.misfit(s.color, f, camera, &now, count, known_camera);
                if off > worst {
                    (worst, culprit) = (off, Some(s.color));
                }
            }
            // What the layout may be wrong by, until it was learnt; what the measurements may be, then.
            let placed = self.markers.0.iter().all(|m| m.placed > 5);
            let side = whole.iter().flatten().map(|f| f.area.sqrt()).fold(0.0, f64::max);
            let sigma = whole.iter().flatten().map(|f| f.covariance.trace() / 2.0).fold(0.0, f64::max).sqrt();
            let misplaced = self.markers.0.iter().map(|m| m.misplaced).fold(0.0, f64::max);
            let tolerance = match (known_camera, placed) {
                (true, true) => 0.08 + 2.5 * sigma + 2.0 * misplaced,
                (true, false) => 0.5 + 0.02 * side,
                (false, _) => 3.0,
            };
            let inconsistent = rms > tolerance && n > 2;
            if worst < 1.0 && !inconsistent {
                return now;
            }
            // Where widths are right, the one whose displacement differs most from the others'.
            if worst < 1.0 {
                let moved = |c: MarkerColor| {
                    let m = &self.markers[c];
                    whole[c.index()].and_then(|f| Some(f.centroid - m.centroid? - m.flow))
                };
                let strangeness = |c: MarkerColor| {
                    let own = moved(c)?;
                    let mut distances = [f64::INFINITY; 4];
                    let mut k = 0;
                    for other in MarkerColor::ALL.into_iter().filter(|o| *o != c) {
                        if let Some(v) = moved(other) {
                            distances[k] = (v - own).norm();
                            k += 1;
                        }
                    }
                    distances[..k].sort_unstable_by(f64::total_cmp);
                    distances[..k].get(k / 2).copied()
                };
                culprit = sights
                    .iter()
                    .filter_map(|s| Some((s.color, strangeness(s.color)?)))
                    .max_by(|a, b| a.1.total_cmp(&b.1))
                    .map(|(c, _)| c);
            }
            let Some(culprit) = culprit else { return now };
            whole[culprit.index()] = None;
            self.markers[culprit].reason = "contradicts the other markers' geometry";
        }
    }

    /// How far an outline is off the shape that a pose, told by `count` markers, gives it, in units of what it may be off: the widths
    /// between opposite edges and the directions of the edges that were seen. What hides an edge, or goes on in its colour, shows
    /// in them.
    fn misfit(
        &self,
        color: MarkerColor,
        f: &QuadFit,
        camera: &CameraModel,
        pose: &Isometry3<f64>,
        count: usize,
        known_camera: bool,
    ) -> f64 {
        let m = &self.markers[color];
        let Some(expected) = project_square(&self.layout, color, m.turn.0, camera, pose) else {
            return f64::INFINITY;
        };
        let side = f.area.sqrt();
        // How well the shape is known: of the paper itself, and of the pose that it is seen from.
        let (width, slope) = match (known_camera, m.edge_bias.1 > 3, count) {
            (true, true, 4) => (0.1 + 0.004 * side, 0.01),
            (true, true, 3) => (0.2 + 0.008 * side, 0.015),
            (true, true, _) => (0.5 + 0.03 * side, 0.06),
            (true, false, _) => (1.0 + 0.05 * side, 0.08),
            (false, ..) => (1.5 + 0.15 * side, 0.15),
        };
        // Where the layout is still being learnt, so is the shape.
        let misplaced = self.markers.0.iter().map(|m| m.misplaced).fold(0.0, f64::max);
        let (width, slope) = (width + 1.5 * misplaced, slope + 1.5 * misplaced / side.max(10.0));
        let mut worst = 0.0f64;
        for (k, (measured, predicted)) in f.quad.widths().iter().zip(expected.widths()).enumerate() {
            // `widths` tells the distance between the edges k and k + 2.
            let (Some(a), Some(b)) = (f.edges[k], f.edges[k + 2]) else { continue };
            let sigma = (a.covariance[(0, 0)] + b.covariance[(0, 0)]).sqrt();
            let off = (measured - predicted - 2.0 * m.edge_bias.0[k]).abs();
            worst = worst.max(off / (width + 4.0 * sigma));
        }
        let (mut turns, mut mean, mut seen) = ([0.0; 4], 0.0, 0.0);
        for (i, turn) in turns.iter_mut().enumerate() {
            let side = |q: &Quad| q.0[(i + 1) % 4] - q.0[i];
            let (a, b) = (side(&expected), side(&f.quad));
            *turn = (a.x * b.y - a.y * b.x).atan2(a.dot(&b));
            if f.edges[i].is_some() {
                (mean, seen) = (mean + *turn, seen + 1.0);
            }
        }
        mean /= f64::max(seen, 1.0);
        for (turn, edge) in turns.iter().zip(&f.edges) {
            let Some(e) = edge else { continue };
            worst = worst.max((turn - mean).abs() / (slope + 4.0 * e.covariance[(1, 1)].sqrt()));
        }
        worst
    }
}
