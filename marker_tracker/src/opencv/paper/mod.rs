//! The published tracker (paper, II-B to II-D) on OpenCV: binary images of color layers, optical
//! flow and hue histograms as criteria, and eq. 3 for hidden markers. It knows neither the camera
//! nor the layout.

mod binary;
mod flow;
mod hue;
mod occlusion;
mod regions;
mod search;

use crate::{
    config::{BinaryThreshold, Method, TrackerConfig},
    debug_view::MarkerView,
    engine::Engine,
    image::{self, ImageView},
};
use binary::{Binarizer, Pixels};
use flow::{FrameFlow, Motions, region_flow};
use nalgebra::Vector2;
use occlusion::{Place, Sighting};
use opencv::{
    core::{self, Mat},
    prelude::*,
};
use rig_model::{MarkerColor, MarkerObservation, MarkerObservations, PerColor};
use search::{Marker, Previous, Scene};
use std::sync::Once;

/// The published tracker.
#[derive(Debug)]
pub(crate) struct PaperTracker {
    config: TrackerConfig,
    threshold: BinaryThreshold,
    binarizer: Binarizer,
    markers: PerColor<Marker>,
    places: PerColor<Place>,
    /// Of the last image.
    observations: PerColor<MarkerObservation>,
    previous: Option<Previous>,
    /// Memory for images whose rows are padded.
    packed: Vec<u8>,
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
        Self {
            markers: PerColor::from_fn(|color| Marker::new(color, &config)),
            config,
            threshold,
            binarizer: Binarizer::default(),
            places: PerColor::default(),
            observations: PerColor([MarkerObservation::lost(MarkerObservation::NEVER); 4]),
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
        let previous = self.previous.as_ref().filter(|_| self.config.use_flow);
        let (own, motions) = match previous {
            Some(previous) => self.flows(previous, &gray, &binary)?,
            None => Default::default(),
        };
        let (pixels, config) = (&pixels, &self.config);
        let scene = Scene { pixels, binary: &binary, previous, motions, config };
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
        self.observations =
            occlusion::observe(&mut self.places, &sightings, self.config.max_predicted);
        Ok(self.observations)
    }

    /// Scales the expected areas as the areas of the visible markers have changed since the
    /// previous image: by their median, so that one of them may be partly covered.
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

    /// Flow of each marker that was visible in the previous image (eq. 1), px, and the motions that
    /// flows are compared with.
    fn flows(
        &self,
        previous: &Previous,
        gray: &Mat,
        binary: &PerColor<Mat>,
    ) -> opencv::Result<(PerColor<Option<Vector2<f64>>>, Motions)> {
        let mut own = PerColor::default();
        let mut boxes = Vec::new();
        for (color, marker) in self.markers.iter() {
            if let Some(region) = &marker.region {
                own[color] = region_flow(&previous.binary[color], &binary[color], region)?;
                boxes.push(region.bounds);
            }
        }
        let flows: Vec<Vector2<f64>> = own.0.iter().flatten().copied().collect();
        let frame = FrameFlow::between(&previous.gray, gray, &boxes)?;
        Ok((own, Motions::new(frame, &flows)))
    }
}

impl Engine for PaperTracker {
    fn process(&mut self, image: &image::Pixels<'_>) -> Result<Option<MarkerObservations>, String> {
        let markers = self.track(image).map_err(|e| e.to_string())?;
        Ok(Some(MarkerObservations { stamp: image.stamp, markers }))
    }

    fn set_config(&mut self, config: TrackerConfig) {
        if let Method::Paper(threshold) = config.method {
            self.threshold = threshold;
        }
        self.config = config;
    }

    fn view(&self, color: MarkerColor) -> MarkerView {
        let (observation, w) = (&self.observations[color], self.markers[color].window);
        MarkerView {
            window: [w.x, w.y, w.x + w.width, w.y + w.height],
            outline: None,
            centroid: observation.centroid,
            flow: self.places[color].flow,
            state: observation.state,
            outcome: self.markers[color].outcome,
            color: None,
        }
    }
}
