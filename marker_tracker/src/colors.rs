//! Calibration of the colours: what each marker's paper looks like to the camera, over some images.

use crate::{
    Input, Output, Tracker, TrackerConfig,
    image::{ImageError, ImageView},
    patches::find_patches,
    signal::rgb_at,
};
use nalgebra::Vector2;
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerState, PerColor};

/// Smallest patch that counts, px².
const MIN_AREA: f64 = 60.0;
/// Half the side of the square about a picked place, px.
const PICK: i32 = 2;

/// One marker's paper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalibratedColor {
    /// Median of the mean colours, r, g, b of 0–255.
    pub rgb: [f64; 3],
    /// Median distance of the images' colours from it, of 255.
    pub spread: f64,
    /// From how many images.
    pub images: usize,
}

/// Gathers the colours of the four markers over images.
///
/// With the layout the markers are those patches that stand as it says, so that coloured things beside them do not count;
/// without it the largest square-like patch of each colour is taken. A place that was picked by hand goes before both.
#[derive(Debug)]
pub struct ColorCalibration {
    tracker: Option<Tracker>,
    picks: PerColor<Option<Vector2<f64>>>,
    samples: PerColor<Vec<[f64; 3]>>,
}

impl ColorCalibration {
    /// With the markers' layout, where it is known, and places (px) that were picked by hand.
    pub fn new(layout: Option<MarkerLayout>, picks: PerColor<Option<Vector2<f64>>>) -> Self {
        let tracker = layout.map(|layout| Tracker::new(layout, TrackerConfig::default()));
        Self { tracker, picks, samples: PerColor::from_fn(|_| Vec::new()) }
    }

    /// The camera's model, which the check of the layout gains by.
    pub fn camera(&mut self, camera: CameraModel) {
        if let Some(tracker) = &mut self.tracker {
            tracker.handle(Input::Camera(camera));
        }
    }

    /// Takes an image; the stamps of a sequence must grow.
    ///
    /// # Errors
    /// [`ImageError`] where the image's fields contradict each other.
    pub fn add(&mut self, image: &ImageView<'_>) -> Result<(), ImageError> {
        image.check()?;
        let mut found: PerColor<Option<[f64; 3]>> = PerColor([None; 4]);
        if let Some(tracker) = &mut self.tracker {
            tracker.handle(Input::Image(*image));
            while let Some(output) = tracker.poll() {
                if let Output::Observations(o) = output {
                    for (color, _) in o.markers.iter().filter(|(_, m)| m.state == MarkerState::Detected) {
                        found[color] = tracker.color(color).map(|rgb| rgb.map(f64::from));
                    }
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
                found[color] = mean_about(image, place);
            }
            self.samples[color].extend(found[color]);
        }
        Ok(())
    }

    /// What was gathered; `None` for a marker that was in no image.
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
            let distance = |s: &[f64; 3]| (0..3).map(|c| (s[c] - rgb[c]).powi(2)).sum::<f64>().sqrt();
            let spread = median(samples.iter().map(distance).collect());
            Some(CalibratedColor { rgb, spread, images: samples.len() })
        })
    }
}

fn mean_about(image: &ImageView<'_>, place: Vector2<f64>) -> Option<[f64; 3]> {
    let (cx, cy) = (place.x.round() as i32, place.y.round() as i32);
    let (mut sum, mut n) = ([0.0; 3], 0.0);
    for y in cy.saturating_sub(PICK)..=cy.saturating_add(PICK) {
        for x in cx.saturating_sub(PICK)..=cx.saturating_add(PICK) {
            if let Some(rgb) = rgb_at(image, x, y) {
                for (s, v) in sum.iter_mut().zip(rgb) {
                    *s += f64::from(v);
                }
                n += 1.0;
            }
        }
    }
    (n > 0.0).then(|| sum.map(|s| s / n))
}
