//! Patches of the markers' colors without a layout: several of one color, each by itself.
//!
//! For color calibration ([`find_patches`]) and for colored paper of unknown geometry
//! ([`PatchTracker`]). Both criteria are the tracker's: a patch is searched where its optical flow
//! carries it, in a window of 25 px plus the displacement, and must have its hues.

use crate::{
    appearance::Appearance,
    config::TrackerConfig,
    flow::FlowFeatures,
    hue::HueHistogram,
    image::{ImageError, ImageView, Pixels},
    quad::Quad,
    scan::{Blob, Palette, ScanConfig, Scanner},
    signal::Sampler,
};
use nalgebra::Vector2;
use rig_model::{MarkerColor, MarkerState};

/// A patch of one of the markers' colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Its number while it is tracked.
    pub id: u32,
    /// Marker whose color it has.
    pub color: MarkerColor,
    /// Whether it was measured, predicted or lost in the last image.
    pub state: MarkerState,
    /// Number of images since the last measurement.
    pub occluded_frames: u16,
    /// Centroid of its pixels, px.
    pub centroid: Vector2<f64>,
    /// Displacement since the previous image, px.
    pub flow: Vector2<f64>,
    /// Area, px².
    pub area: f64,
    /// Mean color, r, g, b of 0–255.
    pub rgb: [f32; 3],
}

/// Half the side of the search window beyond patch and displacement, px (paper).
const WINDOW: f64 = 25.0;
/// Share of its area to which a whole patch may shrink: in the shade its rim falls below the
/// threshold. Tuned; guarded by the video of `tests/color.rs`.
const SHRUNK: f64 = 0.7;

fn is_square(blob: &Blob) -> bool {
    !blob.cut
        && (0.75..1.25).contains(&blob.fill())
        && blob.elongation() < 2.0
        && blob.saturation() > 0.2
}

fn scan_config(stride: usize, min_area: f64, max_area: f64) -> ScanConfig {
    ScanConfig {
        stride,
        grid: stride.clamp(4, 8),
        min_saturation: 0.15,
        min_layer: 16,
        min_area,
        max_area,
    }
}

/// Finds the square-like patches of the markers' colors of at least `min_area` px² in an image, the
/// largest first.
///
/// # Errors
/// [`ImageError::Size`] where the image's fields contradict each other.
pub fn find_patches(image: &ImageView<'_>, min_area: f64) -> Result<Vec<Patch>, ImageError> {
    image.check()?;
    let mut scanner = Scanner::default();
    scan_all(&mut scanner, &Pixels::whole(*image, None), min_area);
    let mut patches: Vec<Patch> =
        scanner.blobs.iter().filter(|b| is_square(b)).map(|b| patch_of(b, 0)).collect();
    patches.sort_by(|a, b| b.area.total_cmp(&a.area));
    Ok(patches)
}

fn scan_all(scanner: &mut Scanner, image: &Pixels<'_>, min_area: f64) {
    let (w, h) = (image.width as i32, image.height as i32);
    let stride = (image.width.max(image.height) / 640).clamp(1, 8);
    scanner.scan(
        image,
        [0, 0, w, h],
        &scan_config(stride, min_area, f64::from(w) * f64::from(h) / 6.0),
    );
}

fn patch_of(blob: &Blob, id: u32) -> Patch {
    Patch {
        id,
        color: blob.color,
        state: MarkerState::Detected,
        occluded_frames: 0,
        centroid: blob.centroid,
        flow: Vector2::zeros(),
        area: blob.area,
        rgb: blob.rgb,
    }
}

/// An upright square of a patch's size, in which its colors are sampled.
fn square(patch: &Patch) -> Quad {
    let h = patch.area.sqrt() / 2.0;
    Quad([(-h, -h), (h, -h), (h, h), (-h, h)].map(|(x, y)| patch.centroid + Vector2::new(x, y)))
}

/// A tracked patch.
#[derive(Clone, Debug)]
struct Followed {
    patch: Patch,
    appearance: Appearance,
    features: FlowFeatures,
    /// Area while it is whole, px².
    whole_area: f64,
}

/// Tracks every patch of a marker's color by itself.
#[derive(Debug)]
pub struct PatchTracker {
    config: TrackerConfig,
    min_area: f64,
    scanner: Scanner,
    followed: Vec<Followed>,
    patches: Vec<Patch>,
    next_id: u32,
}

impl PatchTracker {
    /// Creates a tracker for patches of at least `min_area` px². Of the settings it uses the two
    /// criteria, the longest prediction and the colors.
    pub fn new(config: TrackerConfig, min_area: f64) -> Self {
        let palette = Palette::new(&config.start_colors);
        Self {
            config,
            min_area,
            scanner: Scanner::new(palette),
            followed: Vec::new(),
            patches: Vec::new(),
            next_id: 0,
        }
    }

    /// Processes the next image; returns the tracked patches, whatever their state, and new ones.
    /// The whole image is searched at the start and while a patch is lost.
    ///
    /// # Errors
    /// [`ImageError::Size`] where the image's fields contradict each other.
    pub fn process(&mut self, image: &ImageView<'_>) -> Result<&[Patch], ImageError> {
        image.check()?;
        let image = &Pixels::whole(*image, None);
        for i in 0..self.followed.len() {
            self.follow(image, i);
        }
        let lost = self.followed.iter().any(|f| f.patch.state == MarkerState::Lost);
        if self.followed.is_empty() || lost {
            self.search(image);
        }
        for f in &mut self.followed {
            if f.patch.state == MarkerState::Detected {
                let sampler = Sampler::new(image, &f.appearance.discriminant);
                f.features.extract_patch(&sampler, f.patch.centroid, 0.8 * f.patch.area.sqrt());
            }
        }
        self.patches.clear();
        self.patches.extend(self.followed.iter().map(|f| f.patch));
        Ok(&self.patches)
    }

    fn follow(&mut self, image: &Pixels<'_>, index: usize) {
        let Self { config, scanner, followed, .. } = self;
        let f = &mut followed[index];
        if f.patch.state == MarkerState::Lost {
            f.patch.occluded_frames = f.patch.occluded_frames.saturating_add(1);
            return;
        }
        let before = f.patch;
        let sampler = Sampler::new(image, &f.appearance.discriminant);
        let flow = if config.use_flow {
            f.features.displacement(&sampler, before.flow).unwrap_or(before.flow)
        } else {
            Vector2::zeros()
        };
        let place = before.centroid + flow;
        let reach = WINDOW + flow.norm() + before.area.sqrt() / 2.0;
        let window = [
            (place.x - reach) as i32,
            (place.y - reach) as i32,
            (place.x + reach) as i32 + 1,
            (place.y + reach) as i32 + 1,
        ];
        scanner.scan(image, window, &scan_config(1, 0.3 * f.whole_area, 2.0 * f.whole_area));
        let found = scanner
            .blobs
            .iter()
            .filter(|b| b.color == before.color)
            .map(|b| (b, patch_of(b, before.id)))
            .filter(|(_, p)| {
                !config.use_hue
                    || HueHistogram::of(image, &square(p))
                        .is_some_and(|h| h.is_like(&f.appearance.hue))
            })
            .min_by(|a, b| (a.1.centroid - place).norm().total_cmp(&(b.1.centroid - place).norm()))
            .map(|(b, p)| (is_square(b), p));
        match found {
            Some((true, p)) if p.area > SHRUNK * f.whole_area && p.area < f.whole_area / SHRUNK => {
                f.patch = Patch { flow: p.centroid - before.centroid, ..p };
                f.whole_area += 0.1 * (p.area - f.whole_area);
                f.appearance.adapt(image, &square(&f.patch), 0.1);
            }
            _ => {
                // Covered in part or as a whole: its flow continues for a while.
                let since = before.occluded_frames.saturating_add(1);
                let state = if since <= config.max_predicted {
                    MarkerState::Predicted
                } else {
                    MarkerState::Lost
                };
                f.patch = Patch { state, occluded_frames: since, centroid: place, flow, ..before };
            }
        }
    }

    /// Adds new patches and recovers lost ones.
    fn search(&mut self, image: &Pixels<'_>) {
        scan_all(&mut self.scanner, image, self.min_area);
        let is_tracked = |followed: &[Followed], b: &Blob| {
            followed.iter().any(|f| {
                f.patch.state != MarkerState::Lost
                    && (f.patch.centroid - b.centroid).norm() < 0.7 * b.area.sqrt()
            })
        };
        for blob in self.scanner.blobs.iter().filter(|b| is_square(b)) {
            if is_tracked(&self.followed, blob) {
                continue;
            }
            let patch = patch_of(blob, self.next_id);
            let quad = square(&patch);
            // The nearest lost patch of its color, hues and size; otherwise it is new.
            let hue = HueHistogram::of(image, &quad);
            let back = self
                .followed
                .iter_mut()
                .filter(|f| {
                    f.patch.state == MarkerState::Lost
                        && f.patch.color == patch.color
                        && patch.area > SHRUNK * f.whole_area
                        && patch.area < f.whole_area / SHRUNK
                        && hue.as_ref().is_some_and(|h| h.is_like(&f.appearance.hue))
                })
                .min_by(|a, b| {
                    let off = |f: &Followed| (f.patch.centroid - patch.centroid).norm();
                    off(a).total_cmp(&off(b))
                });
            if let Some(f) = back {
                f.patch = Patch { id: f.patch.id, ..patch };
            } else if let Some(appearance) = Appearance::sample(image, &quad) {
                self.next_id += 1;
                let features = FlowFeatures::default();
                self.followed.push(Followed {
                    patch,
                    appearance,
                    features,
                    whole_area: patch.area,
                });
            }
        }
    }
}
