//! The published tracker (paper, II-B to II-D) on OpenCV: binary images of color layers, optical
//! flow and hue histograms as criteria, and eq. 3 for hidden markers. It knows neither the camera
//! nor the layout.

mod binary;
mod flow;
mod hue;
mod occlusion;
mod regions;

use crate::{
    config::{BinaryThreshold, TrackerConfig},
    debug_view::MarkerView,
    engine::Engine,
    image::ImageView,
    tracking::Outcome,
};
use binary::{Binarizer, Pixels};
use flow::{FrameFlow, Motions, region_flow};
use hue::HueModel;
use nalgebra::Vector2;
use occlusion::{Place, Sighting};
use opencv::{
    core::{self, Mat, Rect},
    prelude::*,
};
use regions::{Region, regions};
use rig_model::{MarkerColor, MarkerObservation, MarkerObservations, MarkerState, PerColor};
use std::sync::Once;

/// Least half of the side of the window around a marker's previous center, px (paper, II-C), and
/// in units of the square root of its area, so that a near marker fits in at any rotation.
const HALF_WINDOW: f64 = 25.0;
const HALF_WINDOW_PER_SIDE: f64 = 0.9;
/// Smallest and largest area over the expected one of a region that is a whole marker. Noise
/// changes the area of a binary image by 3 %; a marker of which more is missing has another
/// centroid.
const AREA_RATIO: (f64, f64) = (0.75, 1.6);
/// Gains of the expected area where it rises and where it falls: what covers a marker makes it
/// smaller, and nothing makes it larger than it is.
const AREA_RISE: f64 = 0.2;
const AREA_FALL: f64 = 0.02;
/// Consecutive images after which a region that moves with the frame is no marker, and fewer where
/// it has not been seen to move on its own before. A marker that turns does so for shorter times.
const MAX_WITH_FRAME: u16 = 10;
/// Most images for which the area and hue of a hidden marker are kept. A region that has not been
/// seen to move on its own for as long may be something else, and is forgotten sooner.
const MEMORY: u16 = 90;

/// State of one marker.
#[derive(Clone, Debug)]
struct Marker {
    /// Region in the previous image; `None` where it was hidden.
    region: Option<Region>,
    /// Expected area, px²; `None` before the first detection.
    area: Option<f64>,
    hue: HueModel,
    /// Consecutive images in which it moved with the frame and not with the markers.
    with_frame: u16,
    /// Images in which it moved otherwise than the frame.
    moved: u16,
    /// Searched window in the last image.
    window: Rect,
    outcome: Outcome,
}

/// What is known of the previous image.
#[derive(Debug)]
struct Previous {
    gray: Mat,
    binary: PerColor<Mat>,
}

/// The published tracker.
#[derive(Debug)]
pub(crate) struct PaperTracker {
    config: TrackerConfig,
    threshold: BinaryThreshold,
    binarizer: Binarizer,
    markers: PerColor<Marker>,
    places: PerColor<Place>,
    previous: Option<Previous>,
    /// Memory for images whose rows are padded.
    packed: Vec<u8>,
}

/// The current image with what the search in it needs.
struct Scene<'a> {
    pixels: &'a Pixels<'a>,
    binary: &'a PerColor<Mat>,
    previous: Option<&'a Previous>,
    motions: Motions,
    config: &'a TrackerConfig,
}

impl PaperTracker {
    /// Creates a tracker that has seen no image.
    ///
    /// OpenCV uses one thread from then on, in the whole process: the cost is that of one core, and
    /// no result depends on the number of cores.
    pub fn new(config: TrackerConfig, threshold: BinaryThreshold) -> Self {
        // OpenCV's setting is not safe to change from two threads.
        static ONE_THREAD: Once = Once::new();
        ONE_THREAD.call_once(|| {
            // It fails for no number of threads.
            let _ = core::set_num_threads(1);
        });
        let markers = PerColor::from_fn(|color| Marker {
            region: None,
            area: None,
            hue: HueModel::named(color, config.start_colors[color]),
            with_frame: 0,
            moved: 0,
            window: Rect::default(),
            outcome: Outcome::NotFound,
        });
        Self {
            config,
            threshold,
            binarizer: Binarizer::default(),
            markers,
            places: PerColor::default(),
            previous: None,
            packed: Vec::new(),
        }
    }

    fn track(&mut self, image: &ImageView<'_>) -> opencv::Result<PerColor<MarkerObservation>> {
        let mut packed = std::mem::take(&mut self.packed);
        let pixels = Pixels::of(image, &mut packed)?;
        let gray = pixels.half_gray()?;
        let binary = self.binarizer.binary(&pixels.layers()?, self.threshold)?;
        if self.previous.as_ref().is_some_and(|p| p.gray.size().ok() != gray.size().ok()) {
            self.previous = None;
        }
        let own = self.own_flows(&binary)?;
        let scene = Scene {
            motions: self.motions(&gray, &own)?,
            pixels: &pixels,
            binary: &binary,
            previous: self.previous.as_ref().filter(|_| self.config.use_flow),
            config: &self.config,
        };
        let before = PerColor::from_fn(|c| self.markers[c].region.as_ref().map(|r| r.area));
        let mut sightings = PerColor::default();
        for color in MarkerColor::ALL {
            let marker = &mut self.markers[color];
            let place = &mut self.places[color];
            sightings[color] = marker.search(color, &scene, place, own[color])?;
        }
        self.scale_areas(&before, &sightings);
        self.previous = Some(Previous { gray, binary });
        self.packed = packed;
        Ok(occlusion::observe(&mut self.places, &sightings, self.config.max_predicted))
    }

    /// Scales the expected areas as the areas of the visible markers have changed since the previous
    /// image: by their median, so that one of them may be partly covered.
    fn scale_areas(
        &mut self,
        before: &PerColor<Option<f64>>,
        sightings: &PerColor<Option<Sighting>>,
    ) {
        let ratio = |color| Some(sightings[color]?.area / before[color]?);
        let mut ratios: Vec<f64> = MarkerColor::ALL.into_iter().filter_map(ratio).collect();
        ratios.sort_unstable_by(f64::total_cmp);
        if ratios.len() >= 2 {
            let scale = 0.5 * (ratios[(ratios.len() - 1) / 2] + ratios[ratios.len() / 2]);
            self.markers.0.iter_mut().filter_map(|m| m.area.as_mut()).for_each(|a| *a *= scale);
        }
    }

    /// Flow of each marker that was visible in the previous image (eq. 1), px.
    fn own_flows(&self, binary: &PerColor<Mat>) -> opencv::Result<PerColor<Option<Vector2<f64>>>> {
        let mut flows = PerColor::default();
        let Some(previous) = self.previous.as_ref().filter(|_| self.config.use_flow) else {
            return Ok(flows);
        };
        for color in MarkerColor::ALL {
            if let Some(region) = &self.markers[color].region {
                flows[color] = region_flow(&previous.binary[color], &binary[color], region)?;
            }
        }
        Ok(flows)
    }

    /// The motions that flows are compared with.
    fn motions(&self, gray: &Mat, own: &PerColor<Option<Vector2<f64>>>) -> opencv::Result<Motions> {
        let Some(previous) = self.previous.as_ref().filter(|_| self.config.use_flow) else {
            return Ok(Motions::default());
        };
        let regions = || self.markers.0.iter().filter_map(|m| m.region.as_ref());
        let boxes: Vec<Rect> = regions().map(|r| r.bounds).collect();
        let flows: Vec<Vector2<f64>> = own.0.iter().flatten().copied().collect();
        Ok(Motions::new(FrameFlow::between(&previous.gray, gray, &boxes)?, &flows))
    }
}

impl Marker {
    /// Searches for the marker near its place or, where it has none, in the whole image. `own`: its
    /// flow, px.
    fn search(
        &mut self,
        color: MarkerColor,
        scene: &Scene<'_>,
        place: &mut Place,
        mut own: Option<Vector2<f64>>,
    ) -> opencv::Result<Option<Sighting>> {
        self.outcome = Outcome::NotFound;
        self.region = None;
        if let Some(flow) = own {
            let is_with_frame = scene.motions.is_with_frame(flow);
            self.with_frame = if is_with_frame { self.with_frame + 1 } else { 0 };
            self.moved = (self.moved + u16::from(scene.motions.is_distinct(flow))).min(MEMORY);
        }
        let memory = scene.config.max_predicted.saturating_add(self.moved);
        if self.with_frame > self.moved.min(MAX_WITH_FRAME)
            || place.occluded.is_some_and(|n| n > memory)
        {
            (place.centroid, own) = (None, None);
            (self.area, self.with_frame, self.moved) = (None, 0, 0);
            self.hue = HueModel::named(color, scene.config.start_colors[color]);
        }
        let bounds = scene.pixels.bounds();
        let expected = own.unwrap_or(scene.motions.mean);
        self.window = match place.centroid {
            Some(center) => window(center, expected, self.area.unwrap_or(0.0)) & bounds,
            None => bounds,
        };
        let Some((region, flow)) = self.best(color, scene, place, own, expected)? else {
            return Ok(None);
        };
        self.outcome = Outcome::Whole;
        if self.area.is_none() {
            let around = region.bounds;
            self.hue = HueModel::of(
                scene.pixels,
                around,
                &Mat::roi(&scene.binary[color], around)?.try_clone()?,
            )?;
        }
        let area = self.area.get_or_insert(region.area);
        let gain = if region.area > *area { AREA_RISE } else { AREA_FALL };
        *area += gain * (region.area - *area);
        let sighting = Sighting {
            centroid: region.centroid,
            area: region.area,
            missing: (1.0 - region.area / *area).max(0.0),
            flow: flow
                .or(place.centroid.map(|c| region.centroid - c))
                .filter(|_| scene.config.use_flow),
        };
        self.region = Some(region);
        Ok(Some(sighting))
    }

    /// The region of the window that meets the criteria, with its flow: near a known place the
    /// nearest one to where the marker is expected, else the largest.
    fn best(
        &mut self,
        color: MarkerColor,
        scene: &Scene<'_>,
        place: &Place,
        own: Option<Vector2<f64>>,
        expected: Vector2<f64>,
    ) -> opencv::Result<Option<(Region, Option<Vector2<f64>>)>> {
        let window = self.window;
        if window.empty() {
            return Ok(None);
        }
        let mut mask = Mat::roi(&scene.binary[color], window)?.try_clone()?;
        if scene.config.use_hue && core::count_non_zero(&mask)? > 0 {
            let like = self.hue.back_projection(scene.pixels, window)?;
            let mut both = Mat::default();
            core::bitwise_and_def(&mask, &like, &mut both)?;
            if core::count_non_zero(&both)? * 4 < core::count_non_zero(&mask)? {
                self.outcome = Outcome::OtherHue;
            }
            mask = both;
        }
        let mut candidates = regions(&mask, window.tl())?;
        candidates.retain(|r| !r.touches(window));
        if let Some(center) = place.centroid {
            let off = |r: &Region| (r.centroid - center - expected).norm();
            candidates.sort_by(|a, b| off(a).total_cmp(&off(b)));
        }
        for region in candidates {
            if !self.is_whole(&region) {
                self.outcome = Outcome::Covered;
                continue;
            }
            let flow = match scene.previous {
                Some(previous) => {
                    region_flow(&scene.binary[color], &previous.binary[color], &region)?
                        .map(|backward| -backward)
                }
                None => None,
            };
            if scene.motions.admit(flow, own) {
                return Ok(Some((region, flow)));
            }
            self.outcome = Outcome::OtherMotion;
        }
        Ok(None)
    }

    /// Whether a region has the area of the whole marker.
    fn is_whole(&self, region: &Region) -> bool {
        let (low, high) = AREA_RATIO;
        self.area.is_none_or(|area| (low..=high).contains(&(region.area / area)))
    }
}

/// Window around a center and where it moves to, px.
fn window(center: Vector2<f64>, flow: Vector2<f64>, area: f64) -> Rect {
    let half = HALF_WINDOW.max(HALF_WINDOW_PER_SIDE * area.sqrt());
    let (low, high) = (center.inf(&(center + flow)), center.sup(&(center + flow)));
    let (x, y) = ((low.x - half) as i32, (low.y - half) as i32);
    Rect::new(x, y, (high.x + half) as i32 + 1 - x, (high.y + half) as i32 + 1 - y)
}

impl Engine for PaperTracker {
    fn process(&mut self, image: &ImageView<'_>) -> Result<MarkerObservations, String> {
        let markers = self.track(image).map_err(|e| e.to_string())?;
        Ok(MarkerObservations { stamp: image.stamp, markers })
    }

    fn set_config(&mut self, config: TrackerConfig) {
        if let crate::config::Method::Paper(threshold) = config.method {
            self.threshold = threshold;
        }
        self.config = config;
    }

    fn outcome(&self, color: MarkerColor) -> Outcome {
        self.markers[color].outcome
    }

    fn view(&self, color: MarkerColor) -> MarkerView {
        let (marker, place) = (&self.markers[color], &self.places[color]);
        let w = marker.window;
        MarkerView {
            window: [w.x, w.y, w.x + w.width, w.y + w.height],
            outline: None,
            centroid: place.centroid.unwrap_or(Vector2::repeat(f64::NAN)),
            flow: place.flow,
            state: match (&marker.region, place.centroid) {
                (Some(_), _) => MarkerState::Detected,
                (None, Some(_)) => MarkerState::Predicted,
                (None, None) => MarkerState::Lost,
            },
        }
    }
}
