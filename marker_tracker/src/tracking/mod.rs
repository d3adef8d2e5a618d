//! The tracking pipeline: acquisition, tracking and occlusion handling, image by image.
//!
//! [`Pipeline`] only orchestrates. Each component owns its state and its constants: the per-marker
//! tracks (`marker`), the outline measurement (`meter`, `partial`), the association of patches with
//! markers (`acquisition`), the consistency check (`consistency`), the adaptation of the platform's
//! geometry (`platform`) and of the noise (`noise`), the platform's motion (`motion`,
//! `extrapolation`) and the resulting marker states (`states`).

mod acquisition;
mod camera;
mod consistency;
mod extrapolation;
mod marker;
mod meter;
mod motion;
mod noise;
mod partial;
mod platform;
mod repeat;
mod states;

use crate::{
    config::TrackerConfig,
    debug_view::{MarkerView, Outcome, SignalView},
    engine::Engine,
    image::{ImageView, Pixels, Window},
    outline::QuadFit,
    scan::Palette,
    signal::Sampler,
};
use acquisition::{Acquisition, PATCH_REACH};
use camera::{ImageCamera, View};
use consistency::{Consistency, Fits};
use extrapolation::Extrapolator;
use marker::MarkerTrack;
use meter::OutlineMeter;
use motion::{ImageInterval, PlatformMotion};
use nalgebra::Vector2;
use noise::NoiseModel;
use partial::PartialSearch;
use platform::PlatformModel;
use repeat::RepeatDetector;
use rig_model::{CameraModel, MarkerColor, MarkerLayout, MarkerObservations, PerColor, Stamp};
use states::CommonFlow;

/// Margin around the searched outline that a debug view shows, px.
const VIEW_MARGIN: f64 = 9.0;
/// Margin around a predicted outline within which one image's measurements read as a rule, px: the
/// band, the level beyond it and the error of the prediction. Where more is read, the whole image
/// is decoded; `tests/bags/windows.rs` counts how often.
const WINDOW_MARGIN: f64 = 10.0;

/// The tracker: its settings, and one value per component.
#[derive(Debug)]
pub(crate) struct Pipeline {
    config: TrackerConfig,
    camera: ImageCamera,
    acquisition: Acquisition,
    state: State,
}

/// What the tracker knows from the images so far.
#[derive(Clone, Debug)]
struct State {
    platform: PlatformModel,
    motion: PlatformMotion,
    extrapolator: Extrapolator,
    interval: ImageInterval,
    markers: PerColor<MarkerTrack>,
    noise: NoiseModel,
    repeats: RepeatDetector,
    /// Processed images.
    images: u32,
    /// Consecutive images with fewer than two detected markers.
    unseen: u32,
}

impl Pipeline {
    /// Creates a tracker that searches for markers at the places of `layout` (volant frame, m).
    pub fn new(layout: MarkerLayout, config: TrackerConfig) -> Self {
        let state = State {
            platform: PlatformModel::new(layout),
            motion: PlatformMotion::default(),
            extrapolator: Extrapolator::default(),
            interval: ImageInterval::default(),
            markers: PerColor::default(),
            noise: NoiseModel::default(),
            repeats: RepeatDetector::default(),
            images: 0,
            unseen: 0,
        };
        let acquisition = Acquisition::new(&config.start_colors);
        Self { config, camera: ImageCamera::default(), acquisition, state }
    }

    /// Detects the markers by tracking or, with fewer than two, by acquisition, and updates the
    /// platform's pose and motion.
    fn update_pose(&mut self, image: &Pixels<'_>, camera: &CameraModel, ratio: f64) {
        let mut before = self.state.motion.pose;
        let mut detected = if before.is_some() { self.track(image, camera, ratio) } else { 0 };
        if detected < 2 && self.acquire(image, camera) {
            for track in &mut self.state.markers.0 {
                // What was measured at the former pose may be another thing.
                track.begin_image();
                track.flow = Vector2::zeros();
                track.features.clear();
            }
            (self.state.motion.last, before) = (None, None);
            detected = self.track(image, camera, 1.0);
        }
        self.state.unseen = if detected >= 2 { 0 } else { self.state.unseen + 1 };
        // The outline of one marker constrains the pose; without any marker it only drifts.
        let patience = if detected == 1 { 10 } else { 1 };
        if self.state.unseen > patience * u32::from(self.config.max_predicted) {
            self.state.motion.pose = None;
        }
        self.state.motion.update(before, detected >= 3);
    }

    /// Searches the whole image for the markers; true where they were found, with the pose set.
    fn acquire(&mut self, image: &Pixels<'_>, camera: &CameraModel) -> bool {
        // The levels are those of the former colors.
        let meters = PerColor::from_fn(|color| self.meter(color).without_levels());
        let known = self.camera.is_given;
        let found = self.acquisition.search(image, camera, known, &self.state.platform, &meters);
        let found = match found {
            Ok(found) => found,
            Err(outcomes) => {
                for (track, outcome) in self.state.markers.0.iter_mut().zip(outcomes.0) {
                    if track.outcome == Outcome::NotFound {
                        track.outcome = outcome;
                    }
                }
                return false;
            }
        };
        self.state.motion.pose = Some(found.pose);
        for color in MarkerColor::ALL {
            let track = &mut self.state.markers[color];
            if let Some(marker) = &found.markers[color] {
                track.appearance = Some(marker.appearance);
                track.edges.levels = None;
                self.state.platform.markers[color].init_turn(marker.turn);
            }
            track.edges.restart(found.markers[color].as_ref().map(|m| m.half_width));
        }
        true
    }

    /// Measures each marker near its predicted outline; returns the number of detected ones.
    fn track(&mut self, image: &Pixels<'_>, camera: &CameraModel, ratio: f64) -> usize {
        let Some(pose) = self.state.motion.predicted(ratio, self.config.use_flow) else {
            return 0;
        };
        let start = View { camera, is_known: self.camera.is_given, pose };
        let mut whole = self.measure_whole(image, &start);
        let check = Consistency { platform: &self.state.platform, tracks: &self.state.markers };
        let (pose, displaced) = check.pose(&start, &mut whole);
        let view = View { pose, ..start };
        let detected = self.measure_partial(image, &view, &whole);
        // Before the layout adapts to the noise of this image.
        if view.is_known && self.state.images % 2 == 1 {
            self.state.noise.adapt_excess(&self.state.platform, &self.state.markers, &view);
        }
        self.adapt(image, &view);
        self.state.platform.note_displaced(displaced, self.state.interval.seconds);
        self.state.motion.pose = Some(pose);
        detected
    }

    /// Measures each marker as a whole square near the outline that the predicted view has.
    fn measure_whole(&mut self, image: &Pixels<'_>, predicted: &View<'_>) -> Fits {
        let mut whole = Fits::default();
        for color in MarkerColor::ALL {
            let meter = self.meter(color);
            let track = &mut self.state.markers[color];
            let Some(appearance) = &track.appearance else { continue };
            let sampler = Sampler::new(image, &appearance.discriminant);
            let Some(mut outline) = self.state.platform.outline(color, predicted) else {
                continue;
            };
            if self.config.use_flow {
                outline = track.moved_by_flow(&sampler, &outline);
            }
            track.window = outline.window(image, VIEW_MARGIN);
            let found = track.edges.follow(&meter, &sampler, &outline).or_else(|| {
                let reach = track.flow.norm();
                let outline = self.acquisition.nearest_patch(image, color, &outline, reach)?;
                meter.whole(&sampler, &outline, meter::SEARCH)
            });
            let found = match found {
                Some(fit) if !track.edges.has_changed_light(&fit) => Some(fit),
                other => {
                    let meter = meter.in_light(appearance.light_by_row());
                    let relit = meter.whole(&sampler, &outline, meter::SEARCH);
                    QuadFit::in_changed_light(other, relit)
                }
            };
            whole[color] = found.filter(|f| {
                let accepted = !self.config.use_hue || track.has_hue(image, &f.quad);
                if !accepted {
                    track.outcome = Outcome::OtherHue;
                }
                accepted
            });
        }
        whole
    }

    /// Measures the markers that are not whole at the places that the other markers' pose gives;
    /// returns the number of detected markers.
    fn measure_partial(&mut self, image: &Pixels<'_>, view: &View<'_>, whole: &Fits) -> usize {
        let palette = &self.acquisition.scanner.palette;
        let mut search = PartialSearch::new(image, view, whole, palette, &self.config);
        for color in MarkerColor::ALL {
            let meter = self.meter(color);
            if let Some(fit) = whole[color] {
                self.state.markers[color].fit = Some(fit);
                self.state.markers[color].outcome = Outcome::Whole;
            } else if search.determining > 0 {
                let track = &mut self.state.markers[color];
                track.outcome = search.run(color, track, &meter, &self.state.platform);
            }
        }
        search.detected
    }

    /// Adapts noise, appearance and geometry to the markers that were measured as a whole.
    fn adapt(&mut self, image: &Pixels<'_>, view: &View<'_>) {
        let detected = self.state.markers.0.iter().filter(|m| m.fit.is_some()).count();
        for color in MarkerColor::ALL {
            let track = &mut self.state.markers[color];
            let Some(fit) = track.fit.filter(|f| f.is_whole() && !f.relit) else { continue };
            self.state.noise.add_rows(&fit);
            // Light drifts slowly: one marker's colors per image suffice.
            let is_due = self.state.images % 4 == color.index() as u32;
            track.adapt(image, &fit, is_due);
            self.state.platform.adapt(color, view, &fit, detected, is_due);
        }
        self.state.noise.forget_rows();
    }

    /// Processes one image.
    fn observe(&mut self, image: &Pixels<'_>) -> MarkerObservations {
        if self.state.repeats.is_repeated(image) {
            let max = self.config.max_predicted;
            let markers = PerColor::from_fn(|color| self.state.markers[color].repeat(max));
            return MarkerObservations { stamp: image.stamp, markers };
        }
        let ratio = self.state.interval.advance(image.stamp);
        let before = PerColor::from_fn(|color| self.state.markers[color].centroid);
        self.state.images = self.state.images.wrapping_add(1);
        self.state.markers.0.iter_mut().for_each(MarkerTrack::begin_image);
        let camera = self.camera.for_image(image);
        match &camera {
            Some(camera) => self.update_pose(image, camera, ratio),
            // A pose places no marker in such an image.
            None => self.state.motion.pose = None,
        }
        self.conclude(image, camera.as_ref(), &before, ratio)
    }

    /// Turns the measurements into the markers' states (paper, eq. 3, for unmeasured ones).
    fn conclude(
        &mut self,
        image: &Pixels<'_>,
        camera: Option<&CameraModel>,
        before: &PerColor<Option<Vector2<f64>>>,
        ratio: f64,
    ) -> MarkerObservations {
        let common = CommonFlow::of(&self.state.markers, before, ratio);
        let extrapolated = self
            .state
            .extrapolator
            .advance(
                &self.state.motion,
                &self.state.platform,
                &self.state.markers,
                camera,
                ratio,
                &self.state.interval,
            )
            .filter(|_| self.config.rigid_prediction);
        let has_pose = self.state.motion.pose.is_some();
        let markers = PerColor::from_fn(|color| {
            let rigid = extrapolated
                .and_then(|e| self.state.platform.geometry(camera?).predict_centroid(color, &e));
            let track = &mut self.state.markers[color];
            match track.fit {
                Some(fit) => track.conclude_detected(image, &fit, common.of_marker(color)),
                None => track.conclude_hidden(rigid, &common, &self.config, has_pose),
            }
        });
        MarkerObservations { stamp: image.stamp, markers }
    }

    /// The outline measurement with what is known of a marker.
    fn meter(&self, color: MarkerColor) -> OutlineMeter {
        OutlineMeter::new(
            &self.state.platform.markers[color],
            &self.state.markers[color].edges,
            &self.state.noise,
        )
    }
}

impl Engine for Pipeline {
    fn windows(&self, stamp: Stamp) -> Option<[Window; 4]> {
        // While the markers are searched, all of the image is needed.
        let State { motion, interval, markers, platform, unseen: 0, .. } = &self.state else {
            return None;
        };
        let view = View {
            camera: self.camera.latest()?,
            is_known: self.camera.is_given,
            pose: motion.predicted(interval.ratio(stamp), self.config.use_flow)?,
        };
        let window = |color: MarkerColor| {
            let outline = platform.outline(color, &view)?;
            let track = &markers[color];
            let margin = match track.fit {
                Some(fit) if fit.is_whole() && !fit.relit => WINDOW_MARGIN,
                // Its patch is searched, too.
                _ => WINDOW_MARGIN + PATCH_REACH + track.flow.norm(),
            };
            Some(outline.bounds(margin).map(|v| usize::try_from(v).unwrap_or(0)))
        };
        Some(MarkerColor::ALL.map(|color| window(color).unwrap_or_default()))
    }

    fn process(&mut self, image: &Pixels<'_>) -> Result<Option<MarkerObservations>, String> {
        let before = image.coverage.as_ref().map(|_| self.state.clone());
        let observations = self.observe(image);
        match before {
            Some(before) if image.is_missing() => {
                self.state = before;
                Ok(None)
            }
            _ => Ok(Some(observations)),
        }
    }

    fn set_config(&mut self, config: TrackerConfig) {
        self.acquisition.scanner.palette = Palette::new(&config.start_colors);
        self.config = config;
    }

    fn uses_camera(&self) -> bool {
        true
    }

    fn set_camera(&mut self, camera: CameraModel) {
        if self.camera.set(camera) {
            // They have adapted to the errors of the former model.
            self.state.platform.restart();
            self.state.noise = NoiseModel::default();
        }
    }

    fn mismatched_camera_size(&self, image: &ImageView<'_>) -> Option<(u32, u32)> {
        self.camera.mismatched_size(image)
    }

    fn repeated(&self) -> u32 {
        self.state.repeats.count
    }

    fn view(&self, color: MarkerColor) -> MarkerView {
        self.state.markers[color].view()
    }

    fn signal(&self, color: MarkerColor, image: &Pixels<'_>) -> Option<SignalView> {
        self.state.markers[color].signal(image)
    }
}
