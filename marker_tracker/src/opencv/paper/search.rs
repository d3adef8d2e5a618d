//! Search for one marker (paper, II-C): the region of the binary image that meets both criteria.

use super::{
    binary::Pixels,
    flow::{Motions, region_flow},
    hue::HueModel,
    occlusion::{Place, Sighting},
    regions::{RIM, Region, grown, regions},
};
use crate::{config::TrackerConfig, debug_view::Outcome};
use nalgebra::Vector2;
use opencv::{
    core::{self, Mat, Rect},
    imgproc,
    prelude::*,
};
use rig_model::{MarkerColor, PerColor};

/// Least half of the side of the window around a marker's previous center, px (paper, II-C), and
/// in units of the square root of its area, so that a near marker fits in at any rotation.
const HALF_WINDOW: f64 = 25.0;
const HALF_WINDOW_PER_SIDE: f64 = 0.9;
/// Smallest and largest area over the expected one of a region that is a whole marker. Noise
/// changes the area of a small marker by a tenth and more; a marker of which much is missing has
/// another centroid.
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
pub(super) struct Marker {
    /// Region in the previous image; `None` where it was hidden.
    pub region: Option<Region>,
    /// Expected area, px²; `None` before the first detection.
    pub area: Option<f64>,
    hue: HueModel,
    /// Consecutive images in which it moved with the frame and not with the markers.
    with_frame: u16,
    /// Images in which it moved otherwise than the frame.
    moved: u16,
    /// Searched window in the last image.
    pub window: Rect,
    pub outcome: Outcome,
}

/// What is known of the previous image.
#[derive(Debug)]
pub(super) struct Previous {
    pub gray: Mat,
    pub binary: PerColor<Mat>,
}

/// The current image with what the search in it needs.
pub(super) struct Scene<'a> {
    pub pixels: &'a Pixels<'a>,
    pub binary: &'a PerColor<Mat>,
    pub previous: Option<&'a Previous>,
    pub motions: Motions,
    pub config: &'a TrackerConfig,
}

impl Marker {
    /// A marker that was not yet seen.
    pub fn new(color: MarkerColor, config: &TrackerConfig) -> Self {
        Self {
            region: None,
            area: None,
            hue: HueModel::named(color, config.start_colors[color]),
            with_frame: 0,
            moved: 0,
            window: Rect::default(),
            outcome: Outcome::NotFound,
        }
    }

    /// Searches for the marker near its place or, where it has none, in the whole image. `own`: its
    /// flow, px.
    pub fn search(
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
            *self = Self::new(color, scene.config);
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
        let mut candidates = self.candidates(color, scene)?;
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

    /// Regions of the window that have the marker's hue and do not reach beyond it, largest first.
    fn candidates(&mut self, color: MarkerColor, scene: &Scene<'_>) -> opencv::Result<Vec<Region>> {
        if self.window.empty() {
            return Ok(Vec::new());
        }
        // Most of an image is empty: only the part that is not needs the hue.
        let found = imgproc::bounding_rect(&Mat::roi(&scene.binary[color], self.window)?)?;
        if found.empty() {
            return Ok(Vec::new());
        }
        let found = grown(found + self.window.tl(), RIM, scene.pixels.bounds());
        let mut mask = Mat::roi(&scene.binary[color], found)?.try_clone()?;
        if scene.config.use_hue {
            let like = self.hue.back_projection(scene.pixels, found)?;
            let mut both = Mat::default();
            core::bitwise_and_def(&mask, &like, &mut both)?;
            if core::count_non_zero(&both)? * 4 < core::count_non_zero(&mask)? {
                self.outcome = Outcome::OtherHue;
            }
            mask = both;
        }
        let mut candidates = regions(&mask, found.tl())?;
        candidates.retain(|r| !r.touches(self.window));
        Ok(candidates)
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
