//! Patches of the markers' colours without any layout: several of a colour, each for itself.
//!
//! For pictures of which nothing is known but the colours: to calibrate those ([`find_patches`]), and to follow coloured
//! paper whose geometry nobody measured ([`PatchTracker`]). Both criteria are those of the tracker: a patch is sought where
//! its optical flow carries it, in a window of at least 25 px widened by the displacement, and must have its hues.

use crate::{
    blob::{Blob, Palette, ScanConfig, Scanner},
    config::TrackerConfig,
    flow::Outline,
    image::{ImageError, ImageView},
    model::{Appearance, HueHistogram},
    quad::Quad,
    signal::Sampler,
};
use nalgebra::Vector2;
use rig_model::{MarkerColor, MarkerState};

/// A patch of one of the markers' colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// Its number, for as long as it is followed.
    pub id: u32,
    /// Which marker's colour it has.
    pub color: MarkerColor,
    /// Whether it was measured in the last image, predicted, or lost.
    pub state: MarkerState,
    /// Images since it was measured.
    pub occluded_frames: u16,
    /// Centroid of its pixels, px.
    pub centroid: Vector2<f64>,
    /// Displacement since the image before, px.
    pub flow: Vector2<f64>,
    /// px².
    pub area: f64,
    /// Mean colour r, g, b of 0–255.
    pub rgb: [f32; 3],
}

/// Half the side of the window in which a patch is sought, px, beside its displacement.
const WINDOW: f64 = 25.0;
/// Likeness of the hue histograms from which on a thing can be the patch.
const MIN_LIKENESS: f32 = 0.6;
/// To which part of its area a patch may shrink and still be whole: in the shade its rim falls below the threshold.
const SHRUNK: f64 = 0.7;

fn is_square(blob: &Blob) -> bool {
    !blob.cut && (0.75..1.25).contains(&blob.fill()) && blob.elongation() < 2.0 && blob.saturation() > 0.2
}

fn scan_config(stride: usize, min_area: f64, max_area: f64) -> ScanConfig {
    ScanConfig { stride, grid: stride.clamp(4, 8), min_saturation: 0.15, min_layer: 16, min_area, max_area }
}

/// The square-like patches of the markers' colours in an image, the largest first.
///
/// # Errors
/// [`ImageError::Size`] where the image's fields contradict each other.
pub fn find_patches(image: &ImageView<'_>, min_area: f64) -> Result<Vec<Patch>, ImageError> {
    image.check()?;
    let mut scanner = Scanner::default();
    scan_all(&mut scanner, image, min_area);
    let mut patches: Vec<Patch> =
        scanner.blobs.iter().filter(|b| is_square(b)).map(|b| patch_of(b, 0)).collect();
    patches.sort_by(|a, b| b.area.total_cmp(&a.area));
    Ok(patches)
}

fn scan_all(scanner: &mut Scanner, image: &ImageView<'_>, min_area: f64) {
    let (w, h) = (image.width as i32, image.height as i32);
    let stride = (image.width.max(image.height) / 640).clamp(1, 8);
    scanner.scan(image, [0, 0, w, h], &scan_config(stride, min_area, f64::from(w) * f64::from(h) / 6.0));
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

/// A square of a patch's size: good enough to sample its colours in.
fn square(patch: &Patch) -> Quad {
    let h = patch.area.sqrt() / 2.0;
    Quad([(-h, -h), (h, -h), (h, h), (-h, h)].map(|(x, y)| patch.centroid + Vector2::new(x, y)))
}

#[derive(Clone, Debug)]
struct Followed {
    patch: Patch,
    appearance: Appearance,
    outline: Outline,
    /// As large as it is when it is whole, px².
    whole_area: f64,
}

/// Follows every patch of a marker's colour, each for itself.
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
    /// For patches of at least `min_area` px². Of the settings, the two criteria and the longest prediction count.
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

    /// The patches in the next image: those followed, whatever became of them, and new ones. The whole image is searched at
    /// the start and as long as one is lost.
    ///
    /// # Errors
    /// [`ImageError::Size`] where the image's fields contradict each other.
    pub fn process(&mut self, image: &ImageView<'_>) -> Result<&[Patch], ImageError> {
        image.check()?;
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
                f.outline.remember_patch(&sampler, f.patch.centroid, 0.8 * f.patch.area.sqrt());
            }
        }
        self.patches.clear();
        self.patches.extend(self.followed.iter().map(|f| f.patch));
        Ok(&self.patches)
    }

    fn follow(&mut self, image: &ImageView<'_>, index: usize) {
        let Self { config, scanner, followed, .. } = self;
        let f = &mut followed[index];
        if f.patch.state == MarkerState::Lost {
            f.patch.occluded_frames = f.patch.occluded_frames.saturating_add(1);
            return;
        }
        let before = f.patch;
        let sampler = Sampler::new(image, &f.appearance.discriminant);
        let flow = if config.use_flow {
            f.outline.displacement(&sampler, before.flow).unwrap_or(before.flow)
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
                        .is_some_and(|h| h.likeness(&f.appearance.hue) > MIN_LIKENESS)
            })
            .min_by(|a, b| (a.1.centroid - place).norm().total_cmp(&(b.1.centroid - place).norm()))
            .map(|(b, p)| (is_square(b), p));
        match found {
            Some((true, p)) if p.area > SHRUNK * f.whole_area && p.area < f.whole_area / SHRUNK => {
                f.patch = Patch { flow: p.centroid - before.centroid, ..p };
                f.whole_area += 0.1 * (p.area - f.whole_area);
                f.appearance.follow(image, &square(&f.patch), 0.1);
            }
            _ => {
                // Covered, in part or as a whole: it goes where its flow carries it, for a while.
                let since = before.occluded_frames.saturating_add(1);
                let state =
                    if since <= config.max_predicted { MarkerState::Predicted } else { MarkerState::Lost };
                f.patch = Patch { state, occluded_frames: since, centroid: place, flow, ..before };
            }
        }
    }

    /// New patches, and lost ones that are back.
    fn search(&mut self, image: &ImageView<'_>) {
        scan_all(&mut self.scanner, image, self.min_area);
        let taken = |followed: &[Followed], b: &Blob| {
            followed.iter().any(|f| {
                f.patch.state != MarkerState::Lost
                    && (f.patch.centroid - b.centroid).norm() < 0.7 * b.area.sqrt()
            })
        };
        for blob in self.scanner.blobs.iter().filter(|b| is_square(b)) {
            if taken(&self.followed, blob) {
                continue;
            }
            let patch = patch_of(blob, self.next_id);
            let quad = square(&patch);
            // The nearest lost one of its colour, hues and size; else it is new.
            let hue = HueHistogram::of(image, &quad);
            let back = self
                .followed
                .iter_mut()
                .filter(|f| {
                    f.patch.state == MarkerState::Lost
                        && f.patch.color == patch.color
                        && patch.area > SHRUNK * f.whole_area
                        && patch.area < f.whole_area / SHRUNK
                        && hue.as_ref().is_some_and(|h| h.likeness(&f.appearance.hue) > MIN_LIKENESS)
                })
                .min_by(|a, b| {
                    let off = |f: &Followed| (f.patch.centroid - patch.centroid).norm();
                    off(a).total_cmp(&off(b))
                });
            if let Some(f) = back {
                f.patch = Patch { id: f.patch.id, ..patch };
            } else if let Some(appearance) = Appearance::learn(image, &quad) {
                self.next_id += 1;
                let outline = Outline::default();
                self.followed.push(Followed { patch, appearance, outline, whole_area: patch.area });
            }
        }
    }
}
