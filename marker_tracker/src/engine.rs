//! One image after the other: acquisition, tracking, occlusion. Plain data in, plain data out; the facade is in `tracker`.

use crate::{
    acquire::{Hypothesis, Strictness, hypotheses},
    blob::{ScanConfig, Scanner, classify, mean_rgb},
    config::TrackerConfig,
    flow::Outline,
    geometry::{PosePrior, Sight, guessed_camera, project_square, refine},
    image::ImageView,
    model::{Appearance, HueHistogram},
    quad::{LAGS, Quad, QuadFit, ShapePrior, fit},
    signal::Window,
    tracker::{Mark, Seen},
};
use nalgebra::{Isometry3, Matrix2, Vector2};
use rig_model::{
    CameraModel, MarkerColor, MarkerLayout, MarkerObservation, MarkerObservations, MarkerState, PerColor,
    Stamp,
};

/// What is remembered of one marker.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    pub appearance: Option<Appearance>,
    /// Turn in its plane, rad, and from how many images it was learnt.
    turn: (f64, u32),
    /// Edges' distance outside of the geometry, px, and from how many images it was learnt.
    edge_bias: (f64, u32),
    /// Where it was last measured or predicted.
    pub centroid: Option<Vector2<f64>>,
    /// Displacement over the last image interval, px.
    pub flow: Vector2<f64>,
    /// Standard deviation of a prediction, px.
    sigma: f64,
    /// Images since it was detected.
    occluded: Option<u16>,
    window: Window,
    outline: Outline,
    /// The measurement in this image.
    pub fit: Option<QuadFit>,
    reason: &'static str,
}

#[derive(Debug)]
pub(crate) struct Engine {
    layout: MarkerLayout,
    config: TrackerConfig,
    camera: Option<CameraModel>,
    guessed: Option<CameraModel>,
    pub pose: Option<Isometry3<f64>>,
    last_stamp: Option<Stamp>,
    /// Interval before the last image, s.
    interval: f64,
    pub markers: PerColor<Memory>,
    scanner: Scanner,
    found: Vec<Hypothesis>,
    /// Images so far.
    images: u32,
    /// Images since two markers were detected at once.
    blind: u32,
    /// Running sums of the correlation of the edges' rows, by lag.
    lag: [f64; LAGS],
    /// Running Σ χ² of the centroids about the pose and Σ of its degrees of freedom.
    excess: [f64; 2],
}

/// Half-width that is integrated across an edge while it is sought, px. Once it is known to a fraction of a pixel only its
/// blur's width is: the narrower the less noise.
const COARSE: f64 = 4.5;

/// Pixels around a predicted outline that are looked at.
const MARGIN: f64 = 9.0;
/// Likeness (0 to 1) of the hue histograms from which on a thing can be the marker.
const MIN_LIKENESS: f32 = 0.6;

/// Largest turn of a square in its plane that counts as "a few degrees", rad.
const MAX_TURN: f64 = 0.35;

impl Engine {
    pub fn new(layout: MarkerLayout, config: TrackerConfig) -> Self {
        Self {
            layout,
            config,
            camera: None,
            guessed: None,
            pose: None,
            last_stamp: None,
            interval: 0.0,
            markers: PerColor::default(),
            scanner: Scanner::default(),
            found: Vec::with_capacity(64),
            images: 0,
            blind: 0,
            lag: [0.0; LAGS],
            excess: [0.0; 2],
        }
    }

    pub fn set_config(&mut self, config: TrackerConfig) {
        self.config = config;
    }

    /// What became of a marker in the last image.
    pub fn reason(&self, color: MarkerColor) -> &'static str {
        self.markers[color].reason
    }

    /// What a debug picture shows of a marker.
    pub fn mark(&self, color: MarkerColor) -> Mark {
        let m = &self.markers[color];
        let w = &m.window;
        let state = match (m.fit, m.centroid) {
            (Some(_), _) => MarkerState::Detected,
            (None, Some(_)) => MarkerState::Predicted,
            (None, None) => MarkerState::Lost,
        };
        Mark {
            window: [w.x0, w.y0, w.x0 + w.width, w.y0 + w.height],
            outline: m.fit.map(|f| f.quad.0),
            centroid: m.centroid.unwrap_or(Vector2::repeat(f64::NAN)),
            flow: m.flow,
            state,
        }
    }

    /// What was seen of a marker, copied out.
    pub fn seen(&self, color: MarkerColor) -> Option<Seen> {
        let m = &self.markers[color];
        let a = m.appearance.as_ref()?;
        let w = &m.window;
        let width = usize::try_from(w.width).ok()?;
        // The window holds the projection itself, which is not nought beside the marker.
        let beside: f32 = a.discriminant.weights.iter().zip(&a.surroundings).map(|(w, s)| w * s).sum();
        let signal = w.values.iter().map(|v| v - beside).collect();
        Some(Seen { origin: [w.x0, w.y0], width, signal, hue: a.hue.bins().to_vec() })
    }

    pub fn set_camera(&mut self, camera: CameraModel) {
        if self.camera.as_ref() != Some(&camera) {
            self.camera = Some(camera);
        }
    }

    /// The observations of one image, whose fields were checked.
    pub fn process(&mut self, image: &ImageView<'_>) -> MarkerObservations {
        let elapsed = self.last_stamp.map(|last| image.stamp.seconds_since(last));
        let ratio = match elapsed {
            Some(dt) if self.interval > 0.0 => (dt / self.interval).clamp(0.2, 4.0),
            _ => 1.0,
        };
        self.interval = elapsed.unwrap_or(0.0);
        self.last_stamp = Some(image.stamp);
        let before: [Option<Vector2<f64>>; 4] = std::array::from_fn(|i| self.markers.0[i].centroid);
        let pose_before = self.pose;
        self.images = self.images.wrapping_add(1);
        for m in &mut self.markers.0 {
            m.fit = None;
            m.reason = "not found";
        }
        if let Some(camera) = self.camera_for(image) {
            let mut detected = 0;
            if self.pose.is_some() {
                detected = self.track(image, &camera, ratio);
            }
            if detected < 2 && self.acquire(image, &camera) {
                for m in &mut self.markers.0 {
                    m.flow = Vector2::zeros();
                }
                detected = self.track(image, &camera, 1.0);
            }
            self.blind = if detected >= 2 { 0 } else { self.blind + 1 };
            // One marker's outline holds the pose for a while, none does not.
            let patience = if detected == 1 { 10 } else { 1 };
            if self.blind > patience * u32::from(self.config.max_predicted) {
                self.pose = None;
            }
        }
        self.conclude(image, before, pose_before, ratio)
    }

    fn camera_for(&mut self, image: &ImageView<'_>) -> Option<CameraModel> {
        let size = (image.width as u32, image.height as u32);
        if let Some(c) = self.camera.as_ref().filter(|c| c.size() == size) {
            return Some(c.clone());
        }
        if self.guessed.as_ref().is_none_or(|c| c.size() != size) {
            self.guessed = guessed_camera(image.width, image.height);
        }
        self.guessed.clone()
    }

    fn known_camera(&self, image: &ImageView<'_>) -> bool {
        self.camera.as_ref().is_some_and(|c| c.size() == (image.width as u32, image.height as u32))
    }

    /// Variance of a mean of rows over that of as many independent ones.
    fn correlation(&self) -> f64 {
        let rho = self.rho();
        (1.0 + rho) / (1.0 - rho)
    }

    fn rho(&self) -> f64 {
        if self.lag[0] > 0.0 { (self.lag[1] / self.lag[0]).clamp(0.0, 0.7) } else { 0.4 }
    }

    fn inflation(&self) -> f64 {
        // A mean of n rows whose neighbours correlate by ρ has (1 + ρ)/(1 − ρ) times the variance. Levels and slow
        // correlation come on top; the centroids' residuals about the pose tell by how much, once there are some.
        let expected = 1.0 + 1.4 * self.rho();
        let weight = 60.0;
        let excess = (self.excess[0] + expected * weight) / (self.excess[1] + weight);
        self.correlation() * excess.clamp(0.6, 4.0)
    }

    /// Fills a marker's window with its colour signal around an outline.
    fn look(&mut self, image: &ImageView<'_>, color: MarkerColor, quad: &Quad, margin: f64) -> bool {
        let memory = &mut self.markers[color];
        let Some(appearance) = memory.appearance.as_ref() else { return false };
        memory.window.fill(image, quad, margin, &appearance.discriminant);
        true
    }

    /// Fits the outline in the window that was filled last.
    fn fit_in_window(
        &self,
        color: MarkerColor,
        quad: &Quad,
        half_width: f64,
        edge_sigma: f64,
        place_sigma: f64,
        slope_sigma: f64,
    ) -> Option<QuadFit> {
        let memory = &self.markers[color];
        let prior = ShapePrior {
            edge_bias: memory.edge_bias.0,
            edge_sigma,
            place_sigma,
            slope_sigma,
            correlation: self.correlation(),
            inflation: self.inflation(),
            half_width,
            rows: if half_width == COARSE { 16 } else { 96 },
        };
        fit(&memory.window, quad, &prior, 0.45)
    }

    #[allow(clippy::too_many_arguments)]
    fn measure(
        &mut self,
        image: &ImageView<'_>,
        color: MarkerColor,
        quad: &Quad,
        half_width: f64,
        edge_sigma: f64,
        place_sigma: f64,
        slope_sigma: f64,
    ) -> Option<QuadFit> {
        if !self.look(image, color, quad, 1.6 * half_width + 5.0) {
            return None;
        }
        self.fit_in_window(color, quad, half_width, edge_sigma, place_sigma, slope_sigma)
    }

    /// Whether what is inside has the marker's hues, where that is asked.
    fn hue_agrees(&self, image: &ImageView<'_>, color: MarkerColor, quad: &Quad) -> bool {
        if !self.config.use_hue {
            return true;
        }
        let Some(appearance) = self.markers[color].appearance.as_ref() else { return false };
        HueHistogram::of(image, quad).is_some_and(|h| h.likeness(&appearance.hue) > MIN_LIKENESS)
    }

    /// Looks for each marker near where it should be; the number of those detected.
    fn track(&mut self, image: &ImageView<'_>, camera: &CameraModel, ratio: f64) -> usize {
        let Some(pose) = self.pose else { return 0 };
        let mut whole: [Option<QuadFit>; 4] = [None; 4];
        for color in MarkerColor::ALL {
            if self.markers[color].appearance.is_none() {
                continue;
            }
            let Some(quad) = project_square(&self.layout, color, self.markers[color].turn.0, camera, &pose)
            else {
                continue;
            };
            let expected = self.markers[color].flow * ratio;
            let start = if self.config.use_flow { expected } else { Vector2::zeros() };
            self.look(image, color, &quad.shifted(start), MARGIN);
            let flow = if self.config.use_flow {
                let m = &self.markers[color];
                m.outline.displacement(&m.window, start).unwrap_or(start)
            } else {
                start
            };
            let moved = quad.shifted(flow);
            let first = self.fit_in_window(color, &moved, COARSE, 1.0, 3.0, 0.06).filter(is_whole);
            let fine = first.and_then(|f| {
                self.fit_in_window(color, &f.quad, half_width_for(&f), 0.5, 3.0, 0.03).filter(is_whole)
            });
            let fine = fine.or_else(|| self.search(image, color, &moved));
            whole[color.index()] = match fine {
                Some(f) if !self.hue_agrees(image, color, &f.quad) => {
                    self.markers[color].reason = "of another hue";
                    None
                }
                other => other,
            };
        }
        let known = self.known_camera(image);
        let now = self.agree(camera, &pose, known, &mut whole);
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
            if expected.is_some_and(|e| (e - fit.centroid).norm() < 3.0 * place_sigma) {
                self.markers[color].fit = Some(fit);
                self.markers[color].reason = "covered in part, told by its other edges";
                detected += 1;
            } else {
                self.markers[color].reason = "not where the other markers say";
            }
        }
        self.learn(image, camera, &now);
        if known {
            self.learn_noise(camera, &now);
        }
        self.pose = Some(now);
        detected
    }

    /// What a whole outline tells of the pose.
    fn sight(&self, color: MarkerColor, f: &QuadFit) -> Sight {
        let m = &self.markers[color];
        // Paper cut too large or a blooming sensor widen the outline; that is not nearness.
        let scale = 1.0 - 2.0 * m.edge_bias.0 / f.area.sqrt().max(1.0);
        let outline = Quad(f.quad.0.map(|c| f.centroid + (c - f.centroid) * scale));
        Sight { color, pixel: f.centroid, sigma: 0.1, outline: (m.turn.1 > 0).then_some((outline, m.turn.0)) }
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
            if classify(rgb).is_none_or(|(c, _, _)| c != color) {
                return None;
            }
            self.markers[color].appearance = Some(appearance);
        }
        let result = if known_turn {
            let (_, place) = quad.area_and_centroid();
            self.measure(image, color, &quad, 3.5, edge_sigma, place_sigma, 0.012)
                .and_then(|f| {
                    let quad = quad.shifted(f.centroid - place);
                    self.measure(image, color, &quad, 2.5, edge_sigma, place_sigma, 0.012)
                })
                .filter(|f| is_told(f, &self.config))
        } else {
            self.measure(image, color, &quad, 5.0, 1.0, 3.0, 0.1)
                .filter(is_whole)
                .and_then(|f| self.measure(image, color, &f.quad, half_width_for(&f), 0.5, 3.0, 0.03))
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
        let first = self.measure(image, color, &quad, COARSE, 1.0, 3.0, 0.06).filter(is_whole)?;
        self.measure(image, color, &first.quad, half_width_for(&first), 0.5, 3.0, 0.03).filter(is_whole)
    }

    /// The pose that the whole outlines tell. Four centroids over-determine it by two, and each square has the widths that
    /// the pose gives it: what does not fit is no marker, or a marker whose edge is hidden behind a straight thing.
    fn agree(
        &mut self,
        camera: &CameraModel,
        pose: &Isometry3<f64>,
        known_camera: bool,
        whole: &mut [Option<QuadFit>; 4],
    ) -> Isometry3<f64> {
        let tolerance = if known_camera { 0.6 } else { 3.0 };
        let prior = PosePrior { camera_from_volant: *pose, position_sigma: 0.1, rotation_sigma: 0.1 };
        loop {
            let mut sights =
                [Sight { color: MarkerColor::Red, pixel: Vector2::zeros(), sigma: 0.1, outline: None }; 4];
            let mut n = 0;
            for color in MarkerColor::ALL {
                if let Some(f) = whole[color.index()] {
                    sights[n] = self.sight(color, &f);
                    n += 1;
                }
            }
            let sights = &sights[..n];
            if n == 0 {
                return *pose;
            }
            let Some((now, rms)) = refine(&self.layout, camera, sights, pose, Some(&prior), 8) else {
                return *pose;
            };
            if n < 2 {
                return now;
            }
            // The width that is most off, in units of what it may be off.
            let (mut worst, mut culprit) = (0.0, None);
            for s in sights {
                let m = &self.markers[s.color];
                let Some(f) = whole[s.color.index()] else { continue };
                let Some(expected) = project_square(&self.layout, s.color, m.turn.0, camera, &now) else {
                    continue;
                };
                let side = f.area.sqrt();
                let allowed = match (known_camera, m.edge_bias.1 > 3, n) {
                    (true, true, 4) => 0.35 + 0.005 * side,
                    (true, true, 3) => 0.5 + 0.01 * side,
                    (true, ..) => 1.0 + 0.05 * side,
                    (false, ..) => 1.5 + 0.15 * side,
                };
                for (measured, predicted) in f.quad.widths().iter().zip(expected.widths()) {
                    let off = (measured - predicted - 2.0 * m.edge_bias.0).abs() / allowed;
                    if off > worst {
                        (worst, culprit) = (off, Some(s.color));
                    }
                }
            }
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

    /// How much larger the centroids' squared residuals about the best pose are than their covariances say: four
    /// centroids over-determine it by two. What the rows of an edge cannot tell (JPEG's blocks, demosaicing, paper that is
    /// not flat) is learnt so.
    fn learn_noise(&mut self, camera: &CameraModel, pose: &Isometry3<f64>) {
        let mut sights =
            [Sight { color: MarkerColor::Red, pixel: Vector2::zeros(), sigma: 1.0, outline: None }; 4];
        let mut covariances = [Matrix2::identity(); 4];
        for color in MarkerColor::ALL {
            let Some(f) = self.markers[color].fit.filter(is_whole) else { return };
            let sigma = (f.covariance.trace() / 2.0).sqrt();
            let inflation = f.inflation;
            sights[color.index()] = Sight { color, pixel: f.centroid, sigma, outline: None };
            // As they are without what is learnt here.
            covariances[color.index()] = f.covariance * (self.correlation() / inflation);
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
    fn learn(&mut self, image: &ImageView<'_>, camera: &CameraModel, pose: &Isometry3<f64>) {
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
            // Three leave the tilt too open to teach sizes from it, but the turn hardly depends on it.
            if detected < 3 || (detected < 4 && m.turn.1 > 10) {
                continue;
            }
            let turn = m.turn.0;
            let Some((more, bias)) = compare_outline(&self.layout, color, turn, camera, pose, &f) else {
                continue;
            };
            let rate = |n: u32| 1.0 / f64::from(n.min(30) + 1);
            m.turn.0 = (turn + rate(m.turn.1) * more).clamp(-MAX_TURN, MAX_TURN);
            m.turn.1 = m.turn.1.saturating_add(1);
            if detected < 4 {
                continue;
            }
            m.edge_bias.0 += rate(m.edge_bias.1) * (bias - m.edge_bias.0).clamp(-1.0, 1.0);
            m.edge_bias.1 = m.edge_bias.1.saturating_add(1);
        }
        if self.lag[0] > 100.0 {
            self.lag = self.lag.map(|v| v * 0.5);
        }
    }

    /// The markers in the whole image, wherever they are. True where they were found; pose and colours are then set.
    fn acquire(&mut self, image: &ImageView<'_>, camera: &CameraModel) -> bool {
        let size = (image.width * image.height) as f64;
        let config = ScanConfig {
            stride: (image.width.max(image.height) / 320).clamp(1, 8),
            min_saturation: 0.15,
            min_layer: 12,
            min_area: 40.0,
            max_area: size / 6.0,
        };
        self.scanner.scan(image, [0, 0, image.width as i32, image.height as i32], &config);
        let known = self.known_camera(image);
        let strictness = if known {
            Strictness { reprojection: 0.08, area: 1.8 }
        } else {
            Strictness { reprojection: 0.3, area: 2.2 }
        };
        // All four first; three only where no four are confirmed.
        let mut found = std::mem::take(&mut self.found);
        let mut best = None;
        for allow_three in [false, true] {
            hypotheses(&self.layout, camera, &self.scanner.blobs, strictness, allow_three, &mut found);
            best = self.best_of(image, camera, &found, known);
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
        let kept: PerColor<Option<Appearance>> = PerColor::from_fn(|c| self.markers[c].appearance);
        let mut v = Verified {
            pose: hypothesis.camera_from_volant,
            appearances: PerColor([None; 4]),
            turns: PerColor([None; 4]),
            centroids: PerColor([None; 4]),
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
            if mean_rgb(image, blob.centroid, 1).is_some_and(|rgb| classify(rgb.map(|c| c as u8)).is_none()) {
                continue;
            }
            self.markers[color].appearance = Some(appearance);
            let tolerance = if known_camera { 1.5 } else { 3.0 };
            let Some(first) = self.measure(image, color, &quad, 6.0, tolerance, 6.0, 0.12).filter(is_whole)
            else {
                continue;
            };
            let Some(second) = self.measure(image, color, &first.quad, 3.0, 0.5, 3.0, 0.05).filter(is_whole)
            else {
                continue;
            };
            appearance.follow(image, &second.quad, 1.0);
            v.appearances[color] = Some(appearance);
            v.centroids[color] = Some(second.centroid);
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
        for color in MarkerColor::ALL {
            self.markers[color].appearance = kept[color];
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
        let limit = if known_camera { 0.35 + 0.01 * side } else { 2.0 + 0.1 * side };
        let shape = (shape_error / v.count as f64).sqrt();
        let shape_limit = if known_camera { 1.0 + 0.05 * side } else { 2.0 + 0.15 * side };
        if rms > limit || shape > shape_limit {
            return None;
        }
        v.pose = pose;
        v.error = rms + 0.2 * shape;
        Some(v)
    }

    /// States of the markers from what was measured; eq. 3 for what was not.
    fn conclude(
        &mut self,
        image: &ImageView<'_>,
        before: [Option<Vector2<f64>>; 4],
        pose_before: Option<Isometry3<f64>>,
        ratio: f64,
    ) -> MarkerObservations {
        let camera = self.camera_for(image);
        // Flows of the visible markers that were known in the previous image as well.
        let (mut mean, mut n) = (Vector2::zeros(), 0.0);
        let mut flows = [None; 4];
        for i in 0..4 {
            if let (Some(f), Some(b)) = (self.markers.0[i].fit, before[i]) {
                let flow = f.centroid - b;
                flows[i] = Some(flow);
                mean += flow;
                n += 1.0;
            }
        }
        let mut spread = 1.0;
        if n > 0.0 {
            mean /= n;
            let sum: f64 = flows.iter().flatten().map(|f| (f - mean).norm_squared()).sum();
            spread = (sum / n / 2.0).sqrt() + 0.05;
        } else {
            // Nobody is seen: on as before.
            let known: Vec<Vector2<f64>> =
                self.markers.0.iter().filter(|m| m.centroid.is_some()).map(|m| m.flow * ratio).collect();
            if !known.is_empty() {
                mean = known.iter().sum::<Vector2<f64>>() / known.len() as f64;
                spread = 1.0 + mean.norm() * 0.5;
            }
        }
        let max = self.config.max_predicted;
        let pose_now = self.pose;
        // The others' flow as a rigid motion carries the turn about them too, which their mean leaves out.
        let rigid = |color: MarkerColor| {
            let (camera, before, now) = (camera.as_ref()?, pose_before?, pose_now?);
            let a = self.layout.projected_centroid(color, camera, &before)?.pixel;
            Some(self.layout.projected_centroid(color, camera, &now)?.pixel - a)
        };
        let rigid = PerColor::from_fn(|c| rigid(c).filter(|_| n >= 2.0 && self.config.rigid_prediction));
        let markers = PerColor::from_fn(|color| {
            let m = &mut self.markers[color];
            if let Some(f) = m.fit {
                m.outline.remember(&m.window, &f.quad);
                m.flow = flows[color.index()].unwrap_or(mean);
                m.centroid = Some(f.centroid);
                m.occluded = Some(0);
                m.sigma = 0.1;
                return MarkerObservation {
                    state: MarkerState::Detected,
                    occluded_frames: 0,
                    centroid: f.centroid,
                    covariance: f.covariance,
                    area: f.area as f32,
                };
            }
            m.outline.clear();
            let (flow, spread) = match rigid[color] {
                _ if !self.config.use_flow => (Vector2::zeros(), 2.0),
                Some(flow) if (flow - mean).norm() < 4.0 * spread + 2.0 => {
                    (flow, if n >= 3.0 { 0.04 } else { 0.1 })
                }
                _ => (mean, spread),
            };
            m.flow = flow;
            let Some(since) = m.occluded else { return MarkerObservation::lost(MarkerObservation::NEVER) };
            let since = since.saturating_add(1).min(MarkerObservation::NEVER - 1);
            m.occluded = Some(since);
            match m.centroid {
                Some(c) if since <= max && self.pose.is_some() => {
                    let place = c + flow;
                    m.sigma += spread;
                    m.centroid = Some(place);
                    MarkerObservation {
                        state: MarkerState::Predicted,
                        occluded_frames: since,
                        centroid: place,
                        covariance: Matrix2::identity() * m.sigma * m.sigma,
                        area: 0.0,
                    }
                }
                _ => {
                    m.centroid = None;
                    MarkerObservation::lost(since)
                }
            }
        });
        MarkerObservations { stamp: image.stamp, markers }
    }
}

/// By how much an outline is turned further than `turn` (rad), and how far its edges lie outside of the geometry (px).
fn compare_outline(
    layout: &MarkerLayout,
    color: MarkerColor,
    turn: f64,
    camera: &CameraModel,
    pose: &Isometry3<f64>,
    f: &QuadFit,
) -> Option<(f64, f64)> {
    let here = project_square(layout, color, turn, camera, pose)?;
    let turned = project_square(layout, color, turn + 0.01, camera, pose)?;
    let (mut gain, mut sum, mut bias) = (0.0, 0.0, 0.0);
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
        bias += (half(&f.quad, f.centroid) - half(&here, here_centre)) / 4.0;
    }
    let more = sum / gain;
    (more.is_finite() && bias.is_finite()).then_some((more, bias))
}

struct Verified {
    pose: Isometry3<f64>,
    appearances: PerColor<Option<Appearance>>,
    turns: PerColor<Option<f64>>,
    centroids: PerColor<Option<Vector2<f64>>>,
    count: usize,
    error: f64,
}

fn same_place(a: &PerColor<Option<Vector2<f64>>>, b: &PerColor<Option<Vector2<f64>>>) -> bool {
    a.0.iter().zip(&b.0).all(|(a, b)| match (a, b) {
        (Some(a), Some(b)) => (a - b).norm() < 3.0,
        _ => true,
    })
}

/// The half-width across the edges that holds their blur.
fn half_width_for(f: &QuadFit) -> f64 {
    let widest = f.edges.iter().flatten().map(|e| e.blur).fold(0.0, f64::max);
    (0.8 + 2.5 * widest).clamp(1.5, COARSE - 0.1)
}

/// All four edges were seen along most of their length.
fn is_whole(f: &QuadFit) -> bool {
    f.filled > 0.8 && f.edges.iter().all(|e| e.is_some_and(|e| e.support > 0.7))
}

/// Whether the centroid of the whole square is told, covered in part as it may be.
fn is_told(f: &QuadFit, config: &TrackerConfig) -> bool {
    let seen = f.edges.iter().flatten().count();
    let limit = config.max_centroid_sigma;
    seen >= 2 && f.filled > 0.5 && f.unevenness < 0.3 && f.covariance.trace() < 2.0 * limit * limit
}
