//! Color calibration: the mean color of each marker's paper over some images, and the patches of
//! the markers' colors without a layout.

use crate::{
    config::TrackerConfig,
    image::{ImageError, ImageView, Pixels},
    scan::{Patch, ScanConfig, Scanner},
    signal::mean_rgb,
    tracker::{Input, Output, Tracker},
};
use nalgebra::Vector2;
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerState, PerColor};

/// Smallest patch that is used, px²: 8 px of side, where the blurred rim is half of the area.
const MIN_AREA: f64 = 60.0;
/// Half the side of the sampled square about a picked place, px.
const PICK: i32 = 2;

/// Calibrated color of one marker's paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibratedColor {
    /// Median of the images' mean colors, r, g, b of 0–255.
    pub rgb: [f64; 3],
    /// Median distance of the images' colors from it, 0–255 per channel.
    pub spread: f64,
    /// Number of images.
    pub images: usize,
}

/// Collects the colors of the four markers over images.
///
/// With a layout the markers are the patches that stand as it requires, so that other colored
/// things are ignored; without one, the largest square-like patch of each color. A place picked by
/// hand takes precedence.
#[derive(Debug)]
pub struct ColorCalibration {
    tracker: Option<Tracker>,
    picks: PerColor<Option<Vector2<f64>>>,
    samples: PerColor<Vec<[f64; 3]>>,
}

impl ColorCalibration {
    /// Starts a calibration with the markers' layout (volant frame, m), where it is known, and with
    /// places (px) picked by hand.
    pub fn new(layout: Option<MarkerLayout>, picks: PerColor<Option<Vector2<f64>>>) -> Self {
        let tracker = layout.map(|layout| Tracker::new(layout, TrackerConfig::default()));
        Self { tracker, picks, samples: PerColor::from_fn(|_| Vec::new()) }
    }

    /// Sets the camera model, which makes the check of the layout stricter.
    pub fn camera(&mut self, camera: CameraModel) {
        if let Some(tracker) = &mut self.tracker {
            tracker.handle(Input::Camera(camera));
        }
    }

    /// Adds an image; the stamps of a sequence must increase.
    ///
    /// # Errors
    /// [`ImageError`] where the image's fields contradict each other.
    pub fn add(&mut self, image: &ImageView<'_>) -> Result<(), ImageError> {
        image.check()?;
        let mut found: PerColor<Option<[f64; 3]>> = PerColor([None; 4]);
        if let Some(tracker) = &mut self.tracker {
            tracker.handle(Input::Image(*image));
            while let Some(output) = tracker.poll() {
                let Output::Observations(o) = output else { continue };
                let views = tracker.views();
                for (color, _) in o.markers.iter().filter(|(_, m)| m.state == MarkerState::Detected)
                {
                    found[color] = views[color].color.map(|rgb| rgb.map(f64::from));
                }
            }
        } else {
            for patch in find_patches(image, MIN_AREA)? {
                // The largest comes first.
                let slot = &mut found[patch.color];
                *slot = slot.or(Some(patch.rgb.map(f64::from)));
            }
        }
        for color in MarkerColor::ALL {
            if let Some(place) = self.picks[color] {
                found[color] = mean_rgb(&Pixels::whole(*image, None), place, PICK);
            }
            self.samples[color].extend(found[color]);
        }
        Ok(())
    }

    /// The calibrated colors; `None` for a marker that no image shows.
    pub fn result(&self) -> PerColor<Option<CalibratedColor>> {
        PerColor::from_fn(|color| {
            let samples = &self.samples[color];
            if samples.is_empty() {
                return None;
            }
            let median = |mut values: Vec<f64>| {
                values.sort_unstable_by(f64::total_cmp);
                values[values.len() / 2]
            };
            let rgb = [0, 1, 2].map(|c| median(samples.iter().map(|s| s[c]).collect()));
            let distance =
                |s: &[f64; 3]| (0..3).map(|c| (s[c] - rgb[c]).powi(2)).sum::<f64>().sqrt();
            let spread = median(samples.iter().map(distance).collect());
            Some(CalibratedColor { rgb, spread, images: samples.len() })
        })
    }
}

fn is_square(patch: &Patch) -> bool {
    !patch.cut
        && (0.75..1.25).contains(&patch.fill())
        && patch.elongation() < 2.0
        && patch.saturation() > 0.2
}

/// Finds the square-like patches of the markers' colors of at least `min_area` px² in an image, the
/// largest first.
///
/// # Errors
/// [`ImageError::Size`] where the image's fields contradict each other.
pub fn find_patches(image: &ImageView<'_>, min_area: f64) -> Result<Vec<Patch>, ImageError> {
    image.check()?;
    let (w, h) = (image.width as i32, image.height as i32);
    let stride = (image.width.max(image.height) / 640).clamp(1, 8);
    let config = ScanConfig {
        stride,
        grid: stride.clamp(4, 8),
        min_saturation: 38,
        min_layer: 16,
        min_area,
        max_area: f64::from(w) * f64::from(h) / 6.0,
    };
    let mut scanner = Scanner::default();
    scanner.scan(&Pixels::whole(*image, None), [0, 0, w, h], &config);
    let mut patches = scanner.patches;
    patches.retain(is_square);
    patches.sort_by(|a, b| b.area.total_cmp(&a.area));
    Ok(patches)
}
