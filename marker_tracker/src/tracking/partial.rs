//! Markers that are covered in part, or were not where the prediction had them: measured again at
//! the places that the pose of the other markers gives.

use crate::{
    appearance::Appearance,
    config::TrackerConfig,
    debug_view::Outcome,
    edge::{Light, Tolerance},
    image::Pixels,
    outline::QuadFit,
    scan::Palette,
    signal::Sampler,
    tracking::{
        camera::View,
        consistency::{Fits, misfit, typical_bias},
        marker::MarkerTrack,
        meter::{KNOWN, OutlineMeter, SEARCH},
        platform::PlatformModel,
    },
};
use rig_model::MarkerColor;

/// Undetected images in a row from which on a marker's known colors may be out of date (white
/// balance, another light): one second of a usual camera, in which most covers pass.
const COLORS_AGE: u16 = 30;

/// Around an outline of unknown turn, known to a few pixels.
const UNKNOWN: Tolerance = Tolerance { half_width: 5.0, slope: 0.1, rows: KNOWN.rows, ..SEARCH };

/// Search for the markers that were not measured as a whole.
pub(super) struct PartialSearch<'a, 'p> {
    image: &'a Pixels<'p>,
    view: &'a View<'a>,
    whole: &'a Fits,
    palette: &'a Palette,
    config: &'a TrackerConfig,
    /// Number of markers that determine the pose: those in `whole`.
    pub determining: usize,
    /// Detected markers so far.
    pub detected: usize,
}

impl<'a, 'p> PartialSearch<'a, 'p> {
    /// Prepares the search where the markers in `whole` determine the view.
    pub fn new(
        image: &'a Pixels<'p>,
        view: &'a View<'a>,
        whole: &'a Fits,
        palette: &'a Palette,
        config: &'a TrackerConfig,
    ) -> Self {
        let determining = whole.0.iter().flatten().count();
        Self { image, view, whole, palette, config, determining, detected: determining }
    }

    /// Searches one marker; stores its measurement in the track where it is accepted.
    pub fn run(
        &mut self,
        color: MarkerColor,
        track: &mut MarkerTrack,
        meter: &OutlineMeter,
        platform: &PlatformModel,
    ) -> Outcome {
        // Rows with their own levels first: they bear a shadow's edge as well as a cover's. Where
        // too few are left, a shadow lies along an edge.
        let by_row = track.appearance.map(|a| a.light_by_row());
        let mut outcome = Outcome::Covered;
        for light in by_row.into_iter().chain([Light::ByPixel, Light::Even]) {
            let meter = meter.in_light(light);
            outcome = self.accept(color, track, &meter, platform);
            if track.fit.is_some() {
                return outcome;
            }
        }
        let is_old = track.occluded.is_some_and(|images| images >= COLORS_AGE);
        if is_old && self.resample(color, track, meter, platform) {
            return Outcome::Whole;
        }
        outcome
    }

    /// Measures a marker as a whole in the colors that its place has now, where they are of its
    /// class; the known colors are kept where that fails.
    fn resample(
        &mut self,
        color: MarkerColor,
        track: &mut MarkerTrack,
        meter: &OutlineMeter,
        platform: &PlatformModel,
    ) -> bool {
        let known = (track.appearance.take(), track.edges.levels.take());
        self.accept(color, track, &meter.without_levels(), platform);
        if track.fit.is_none() {
            (track.appearance, track.edges.levels) = known;
        }
        track.fit.is_some()
    }

    /// Measures one marker and stores the measurement in the track where it is accepted.
    fn accept(
        &mut self,
        color: MarkerColor,
        track: &mut MarkerTrack,
        meter: &OutlineMeter,
        platform: &PlatformModel,
    ) -> Outcome {
        // Standard deviations of place and edges, px: what one, two or three markers leave of a
        // pose's uncertainty at the place of another.
        let (place_sigma, edge_sigma) = match self.determining {
            1 => (3.0, 0.4),
            2 => (2.0, 0.25),
            _ => (0.8, 0.1),
        };
        let tolerance = Tolerance { edge: edge_sigma, place: place_sigma, ..KNOWN };
        let Some(fit) = self.measure(color, track, meter, platform, tolerance) else {
            return Outcome::Covered;
        };
        if !fit.relit && fit.is_shaded() {
            return Outcome::Covered;
        }
        if self.config.use_hue && !track.has_hue(self.image, &fit.quad) {
            return Outcome::OtherHue;
        }
        let geometry = &platform.markers[color];
        let trusted =
            self.view.is_known && geometry.is_shape_known() && geometry.is_roughly_placed();
        // Two markers constrain the pose too little to tell a cover's edge from the marker's.
        let (reach, edges, support) = if trusted && self.determining == 3 {
            let others = self.whole.0.iter().flatten().map(QuadFit::sigma).fold(0.0, f64::max);
            let sigma = fit.sigma() + others;
            (0.15 + 3.0 * sigma + 2.0 * geometry.misplacement, 2, 0.4)
        } else if fit.relit {
            // Rows with their own levels measure no cover's edge. Before the geometry is known, it
            // takes more of them (tuned; guarded by `tests/synthetic` and `tests/bags`).
            (3.0 * place_sigma, 3, if trusted { 0.6 } else { 0.85 })
        } else {
            // A cover's edge would be taken for that of a marker whose shape is not known.
            let edges = if self.view.is_known && !geometry.is_shape_known() { 4 } else { 3 };
            (3.0 * place_sigma, edges, 0.92)
        };
        let own = fit.edges.iter().flatten().filter(|e| !e.foreign);
        if own.filter(|e| e.support > support).count() < edges {
            return Outcome::Covered;
        }
        let count = self.detected.min(3);
        let typical = typical_bias(platform, self.whole, self.view);
        if misfit(platform, color, &fit, self.view, count, typical) > 1.0 {
            return Outcome::OtherShape;
        }
        match platform.layout.projected_centroid(color, self.view.camera, &self.view.pose) {
            Some(expected) if (expected.pixel - fit.centroid).norm() < reach => {
                track.fit = Some(fit);
                self.detected += 1;
                Outcome::PartlyCovered
            }
            _ => Outcome::Displaced,
        }
    }

    /// Measures a marker at the place that the pose gives.
    fn measure(
        &self,
        color: MarkerColor,
        track: &mut MarkerTrack,
        meter: &OutlineMeter,
        platform: &PlatformModel,
        tolerance: Tolerance,
    ) -> Option<QuadFit> {
        let outline = platform.outline(color, self.view)?;
        // Before the first detection they may be those of something else.
        let known = track.appearance.filter(|_| track.occluded.is_some());
        let appearance = known.or_else(|| {
            Appearance::sample(self.image, &outline)
                .filter(|a| self.palette.classify_mean(a.marker) == Some(color))
                .or(track.appearance)
        })?;
        let sampler = Sampler::new(self.image, &appearance.discriminant);
        // New colors may be those of a cover, which is no whole square.
        let fit = if track.appearance.is_some() && platform.markers[color].is_turn_known() {
            let (_, place) = outline.area_and_centroid();
            let wide = Tolerance { half_width: 3.5, slope: 0.012, ..tolerance };
            let first = meter.measure(&sampler, &outline, wide)?;
            let outline = outline.shifted(first.centroid - place);
            let fit = meter.measure(&sampler, &outline, Tolerance { half_width: 2.5, ..wide })?;
            fit.determines_centroid(self.config.max_centroid_sigma).then_some(fit)
        } else {
            meter.whole(&sampler, &outline, UNKNOWN)
        }?;
        track.appearance = Some(appearance);
        Some(fit)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{hue::HueHistogram, image::fixtures::drawn, signal::Discriminant};
    use nalgebra::{Isometry3, Matrix3, Point3};
    use rig_model::{CameraModel, Distortion, MarkerLayout, PerColor, Stamp};

    #[test]
    fn colors_are_sampled_again_until_the_first_detection() {
        let (red, blue, gray) = ([168u8, 47, 49], [40.0, 93.0, 146.0], [125.0; 3]);
        let image = drawn(80, 80, 125, &[([20, 20, 60, 60], red)]);
        let image = Pixels::whole(image.view(Stamp::default()), None);
        let lens = Distortion::PlumbBob([0.0; 5]);
        let camera = CameraModel::new(80, 80, [400.0, 400.0, 39.5, 39.5], lens).unwrap();
        let pose = Isometry3::translation(0.0, 0.0, 1.0);
        let view = View { camera: &camera, is_known: true, pose };
        let layout = MarkerLayout { side: 0.1, centers: PerColor([Point3::origin(); 4]) };
        let (platform, meter) = (PlatformModel::new(layout), OutlineMeter::default());
        let (whole, palette, config) =
            (Fits::default(), Palette::default(), TrackerConfig::default());
        let search = PartialSearch::new(&image, &view, &whole, &palette, &config);
        for (occluded, wanted) in [(None, red.map(f32::from)), (Some(1), blue)] {
            let appearance = Some(Appearance {
                marker: blue,
                surroundings: gray,
                scatter: Matrix3::zeros(),
                discriminant: Discriminant::between(blue, gray, &Matrix3::zeros()).unwrap(),
                hue: HueHistogram::default(),
            });
            let mut track = MarkerTrack { appearance, occluded, ..MarkerTrack::default() };
            let _ = search.measure(MarkerColor::Red, &mut track, &meter, &platform, UNKNOWN);
            assert_eq!(track.appearance.unwrap().marker, wanted, "{occluded:?}");
        }
    }
}
