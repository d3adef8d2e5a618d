//! One image after the other: acquisition, tracking, occlusion. Plain data in, plain data out; the facade is in `tracker`.

mod carry;
mod conclude;
mod learn;
mod repeat;
mod start;
mod track;

use crate::{
    acquire::Hypothesis,
    blob::{Palette, Scanner},
    config::TrackerConfig,
    edge::LAGS,
    flow::Outline,
    geometry::guessed_camera,
    image::ImageView,
    model::Appearance,
    outline::{Levels, QuadFit},
    signal::Sampler,
    tracker::{Mark, Seen},
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector2, Vector3};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, MarkerState, PerColor, Stamp};

/// What is remembered of one marker.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory {
    pub appearance: Option<Appearance>,
    /// Turn in its plane, rad, and from how many images it was learnt.
    turn: (f64, u32),
    /// Distance outside of the geometry, px, of the first and third edge and of the others, and from how many images it was learnt.
    edge_bias: ([f64; 2], u32),
    /// From how many images its place on the platform was learnt.
    placed: u32,
    /// How far it lay off that place of late, px.
    misplaced: f64,
    /// Where it was last measured or predicted.
    pub centroid: Option<Vector2<f64>>,
    /// Displacement over the last image interval, px.
    pub flow: Vector2<f64>,
    /// Standard deviation of a prediction, px.
    sigma: f64,
    /// Images since it was detected.
    occluded: Option<u16>,
    /// What was looked at: left, top, right, bottom (the last two excluded), px.
    window: [i32; 4],
    outline: Outline,
    /// Half-width across an edge that its blur needs, px; 0 until it was measured.
    blur: f64,
    /// How far the edges lay off the place where they were sought, px, as the largest of late.
    miss: f64,
    /// Levels inside and beside each edge, while it was whole of late.
    levels: Option<Levels>,
    /// Gradient of the signal inside, per px, over the last images.
    gradient: Option<Vector2<f64>>,
    /// The measurement in this image.
    pub fit: Option<QuadFit>,
    reason: &'static str,
}

/// A motion from one image to the next: of the platform's origin in the camera frame (m), and the turn (rad).
type Motion = (Vector3<f64>, Vector3<f64>);

#[derive(Debug)]
pub(crate) struct Engine {
    /// As the rig file has it.
    given: MarkerLayout,
    /// As the images have it: what is measured must not lean on what was measured by hand.
    layout: MarkerLayout,
    config: TrackerConfig,
    camera: Option<CameraModel>,
    /// The camera for the images' size, `None` where it cannot be scaled to it.
    fitted: Option<((u32, u32), Option<CameraModel>)>,
    guessed: Option<CameraModel>,
    pub pose: Option<Isometry3<f64>>,
    /// Over the last interval, where both its ends were told by three markers at least.
    motion: Option<Motion>,
    /// The same carried on through images in which fewer are seen.
    carried: Option<carry::Carried>,
    last_stamp: Option<Stamp>,
    /// Interval before the last image, s.
    interval: f64,
    pub markers: PerColor<Memory>,
    scanner: Scanner,
    found: Vec<Hypothesis>,
    /// Of the last image that was not a repetition, and how many repetitions came since.
    sample: repeat::Sample,
    repeated: u32,
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
/// Rows of an edge that are read while it is sought, and in a quick look; a thorough one takes all that there are.
const COARSE_ROWS: usize = 16;
const ROWS: usize = 32;

/// Largest turn of a square in its plane that counts as "a few degrees", rad.
const MAX_TURN: f64 = 0.35;

impl Engine {
    pub fn new(layout: MarkerLayout, config: TrackerConfig) -> Self {
        let palette = Palette::new(&config.start_colors);
        Self {
            given: layout.clone(),
            layout,
            config,
            camera: None,
            fitted: None,
            guessed: None,
            pose: None,
            motion: None,
            carried: None,
            last_stamp: None,
            interval: 0.0,
            markers: PerColor::default(),
            scanner: Scanner::new(palette),
            found: Vec::with_capacity(64),
            sample: repeat::Sample::default(),
            repeated: 0,
            images: 0,
            blind: 0,
            lag: [0.0; LAGS],
            excess: [0.0; 2],
        }
    }

    pub fn set_config(&mut self, config: TrackerConfig) {
        self.scanner.palette = Palette::new(&config.start_colors);
        self.config = config;
    }

    /// What became of a marker in the last image.
    pub fn reason(&self, color: MarkerColor) -> &'static str {
        self.markers[color].reason
    }

    /// What a debug picture shows of a marker.
    pub fn mark(&self, color: MarkerColor) -> Mark {
        let m = &self.markers[color];
        let state = match (m.fit, m.centroid) {
            (Some(_), _) => MarkerState::Detected,
            (None, Some(_)) => MarkerState::Predicted,
            (None, None) => MarkerState::Lost,
        };
        Mark {
            window: m.window,
            outline: m.fit.map(|f| f.quad.0),
            centroid: m.centroid.unwrap_or(Vector2::repeat(f64::NAN)),
            flow: m.flow,
            state,
        }
    }

    /// What was seen of a marker in the image that was processed last.
    pub fn seen(&self, color: MarkerColor, image: &ImageView<'_>) -> Option<Seen> {
        let m = &self.markers[color];
        let a = m.appearance.as_ref()?;
        let [x0, y0, x1, y1] = m.window;
        let width = usize::try_from(x1 - x0).ok()?;
        // The projection itself is not nought beside the marker.
        let beside: f32 = a.discriminant.weights.iter().zip(&a.surroundings).map(|(w, s)| w * s).sum();
        let sampler = Sampler::new(image, &a.discriminant);
        let signal = (y0..y1)
            .flat_map(|y| (x0..x1).map(move |x| (x, y)))
            .map(|(x, y)| sampler.at(x, y).map_or(f32::NAN, |v| v - beside))
            .collect();
        Some(Seen { origin: [x0, y0], width, signal, hue: a.hue.bins().to_vec() })
    }

    pub fn set_camera(&mut self, camera: CameraModel) {
        if self.camera.as_ref() != Some(&camera) {
            self.camera = Some(camera);
            self.fitted = None;
        }
    }

    /// The observations of one image, whose fields were checked.
    pub fn process(&mut self, image: &ImageView<'_>) -> MarkerObservations {
        if self.is_repeated(image) {
            return self.repeat(image);
        }
        self.repeated = 0;
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
        let camera = self.camera_for(image);
        if let Some(camera) = &camera {
            let mut detected = 0;
            if self.pose.is_some() {
                detected = self.track(image, camera, ratio);
            }
            let followed = detected >= 3;
            if detected < 2 && self.acquire(image, camera) {
                for m in &mut self.markers.0 {
                    m.flow = Vector2::zeros();
                    m.outline.clear();
                }
                self.motion = None;
                detected = self.track(image, camera, 1.0);
            }
            self.blind = if detected >= 2 { 0 } else { self.blind + 1 };
            // One marker's outline holds the pose for a while, none does not.
            let patience = if detected == 1 { 10 } else { 1 };
            if self.blind > patience * u32::from(self.config.max_predicted) {
                self.pose = None;
            }
            self.motion = match (pose_before, self.pose) {
                (Some(a), Some(b)) if followed => Some((
                    b.translation.vector - a.translation.vector,
                    (b.rotation * a.rotation.inverse()).scaled_axis(),
                )),
                _ => None,
            };
        }
        self.conclude(image, camera.as_ref(), before, ratio)
    }

    /// Where the platform is if it goes on as it did.
    fn predicted(&self, pose: &Isometry3<f64>, ratio: f64) -> Isometry3<f64> {
        match self.motion.filter(|_| self.config.use_flow) {
            Some((t, r)) => Isometry3::from_parts(
                Translation3::from(pose.translation.vector + t * ratio),
                UnitQuaternion::from_scaled_axis(r * ratio) * pose.rotation,
            ),
            None => *pose,
        }
    }

    /// The camera's model for images of this size: scaled where the camera_info is for another size of the same shape, and
    /// a guess where there is none.
    fn camera_for(&mut self, image: &ImageView<'_>) -> Option<CameraModel> {
        let size = (image.width as u32, image.height as u32);
        if self.fitted.as_ref().is_none_or(|(s, _)| *s != size) {
            let fitted = self.camera.as_ref().and_then(|c| c.resized(size.0, size.1));
            self.fitted = Some((size, fitted));
        }
        if let Some((_, Some(fitted))) = &self.fitted {
            return Some(fitted.clone());
        }
        if self.guessed.as_ref().is_none_or(|c| c.size() != size) {
            self.guessed = guessed_camera(image.width, image.height);
        }
        self.guessed.clone()
    }

    fn known_camera(&self) -> bool {
        matches!(self.fitted, Some((_, Some(_))))
    }

    /// The size that the camera's model is for, where it is not the image's.
    pub fn other_size(&self, image: &ImageView<'_>) -> Option<(u32, u32)> {
        let size = self.camera.as_ref()?.size();
        (size != (image.width as u32, image.height as u32)).then_some(size)
    }

    /// How many images in a row were the same as the one before.
    pub fn repeated(&self) -> u32 {
        self.repeated
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
        // A mean of n rows whose neighbours correlate by ρ has (1 + ρ)/(1 − ρ) times the variance. The centroids' residuals about
        // the pose tell by how much that is too little or too much; this many of them weigh as much as the expectation that it
        // is right.
        const WEIGHT: f64 = 50.0;
        let excess = (self.excess[0] + WEIGHT) / (self.excess[1] + WEIGHT);
        self.correlation() * excess.clamp(0.6, 4.0)
    }
}

/// The half-width across the edges that holds their blur.
fn half_width_for(f: &QuadFit) -> f64 {
    let widest = f.edges.iter().flatten().map(|e| e.blur).fold(0.0, f64::max);
    (0.8 + 2.5 * widest + (widest - 0.6).max(0.0)).clamp(1.5, COARSE - 0.1)
}

/// All four edges were seen along most of their length.
fn is_whole(f: &QuadFit) -> bool {
    f.filled > 0.8 && f.edges.iter().all(|e| e.is_some_and(|e| e.support > 0.7 && !e.foreign))
}

/// Whether the centroid of the whole square is told, covered in part as it may be.
fn is_told(f: &QuadFit, config: &TrackerConfig) -> bool {
    let seen = f.edges.iter().flatten().count();
    let limit = config.max_centroid_sigma;
    seen >= 2 && f.filled > 0.5 && f.unevenness < 0.3 && f.covariance.trace() < 2.0 * limit * limit
}
