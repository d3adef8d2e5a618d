//! Adaptation of the platform's geometry: where the markers are, how they are turned in their
//! plane, and how far their edges lie outside of the nominal square.

use crate::{
    edge::Side,
    geometry::{Geometry, PoseObservation, project_square},
    outline::QuadFit,
    quad::Quad,
    tracking::camera::View,
};
use rig_model::{CameraModel, MarkerColor, MarkerLayout, PerColor};

/// Largest turn of a square in its plane, rad (20°): markers are mounted "a few degrees" off.
pub(super) const MAX_TURN: f64 = 0.35;
/// Number of images after which an adapted value is a running mean with a constant gain.
const SETTLED: u32 = 12;
/// Largest distance of a marker from where the rig file has it, in units of its side: 11 mm for a
/// side of 76 mm.
const MAX_MISPLACEMENT: f64 = 0.15;
/// Time of consecutive images after which a marker at another place was mounted there, s.
const REMOUNTED: f64 = 2.0;
/// Longest image interval that counts towards it, s: nothing is known of a pause of the camera.
const MAX_INTERVAL: f64 = 0.25;

/// Gain of the n-th update of a mean that becomes a running mean.
fn gain(n: u32) -> f64 {
    1.0 / f64::from(n.min(SETTLED) + 1)
}

/// Adapted geometry of one marker.
#[derive(Clone, Debug, Default)]
pub(super) struct MarkerGeometry {
    /// Turn in its plane, rad.
    turn: f64,
    turn_updates: u32,
    /// Distance of its edges outside of the nominal square, px (paper cut too large, blooming):
    /// first and third edge, second and fourth edge.
    pub edge_bias: [f64; 2],
    edge_bias_updates: u32,
    place_updates: u32,
    /// Recent distance of its centroid from its adapted place, px.
    pub misplacement: f64,
}

impl MarkerGeometry {
    /// Sets the turn, rad, unless one is known.
    pub fn init_turn(&mut self, turn: f64) {
        if self.turn_updates == 0 {
            (self.turn, self.turn_updates) = (turn, 1);
        }
    }

    /// Whether the edges' bias is known: after 4 images its noise is half of an edge's.
    pub fn is_shape_known(&self) -> bool {
        self.edge_bias_updates > 3
    }

    /// Whether the turn is known, so that an outline is predicted to 0.012 rad: after 6 images.
    pub fn is_turn_known(&self) -> bool {
        self.turn_updates > 5
    }

    /// Whether the place has been adapted: roughly after 4 images, then after 6, well after 13.
    pub fn is_roughly_placed(&self) -> bool {
        self.place_updates > 3
    }
    pub fn is_placed(&self) -> bool {
        self.place_updates > 5
    }
    pub fn is_placed_well(&self) -> bool {
        self.place_updates > SETTLED
    }

    /// Whether more images improve little, so that one update in four images suffices.
    fn is_settled(&self) -> bool {
        self.turn_updates > 30 && self.edge_bias_updates > 30
    }
}

/// Difference of a measured outline from the predicted one.
struct OutlineDifference {
    /// Turn in the square's plane, rad.
    turn: f64,
    /// Distance of its edges outside of the prediction, px, as [`MarkerGeometry::edge_bias`].
    edge_bias: [f64; 2],
}

/// The layout as the rig file has it and as the images show it.
#[derive(Clone, Debug)]
pub(super) struct PlatformModel {
    given: MarkerLayout,
    /// Adapted layout (volant frame, m).
    pub layout: MarkerLayout,
    pub markers: PerColor<MarkerGeometry>,
    /// The marker that is not at its place, and the time of the consecutive images that show it, s.
    displaced: Option<(MarkerColor, f64)>,
}

impl PlatformModel {
    /// Starts from the layout of the rig file.
    pub fn new(layout: MarkerLayout) -> Self {
        Self { given: layout.clone(), layout, markers: PerColor::default(), displaced: None }
    }

    /// Adds up the time in which the three other markers contradict the place of the same one in
    /// each image; `interval`: before the current image, s. After [`REMOUNTED`] the adaptation
    /// restarts: the tolerances of adapted places would reject a marker for good that was mounted
    /// elsewhere.
    pub fn note_displaced(&mut self, color: Option<MarkerColor>, interval: f64) {
        let before = self.displaced.filter(|(displaced, _)| Some(*displaced) == color);
        let lasts = before.map_or(0.0, |(_, lasts)| lasts) + interval.clamp(0.0, MAX_INTERVAL);
        self.displaced = color.map(|color| (color, lasts));
        let is_placed = self.markers.0.iter().all(MarkerGeometry::is_placed);
        if color.is_some() && lasts >= REMOUNTED && is_placed {
            self.restart();
        }
    }

    /// Restarts the adaptation; the turns are kept as a start, because they hardly depend on the
    /// camera model and on the places.
    pub fn restart(&mut self) {
        let markers = PerColor::from_fn(|color| {
            let MarkerGeometry { turn, turn_updates, .. } = self.markers[color];
            MarkerGeometry { turn, turn_updates: turn_updates.min(1), ..Default::default() }
        });
        *self = Self { markers, ..Self::new(self.given.clone()) };
    }

    /// The adapted layout and a camera, to estimate poses.
    pub fn geometry<'a>(&'a self, camera: &'a CameraModel) -> Geometry<'a> {
        Geometry { layout: &self.layout, camera }
    }

    /// The outline (px) of a marker; `None` outside of the camera model's range.
    pub fn outline(&self, color: MarkerColor, view: &View<'_>) -> Option<Quad> {
        project_square(&self.layout, color, self.markers[color].turn, view.camera, &view.pose)
    }

    /// What a whole outline says about the pose. Its corners only enter `with_outline`, where the
    /// centroids leave the tilt open.
    pub fn observation(
        &self,
        color: MarkerColor,
        fit: &QuadFit,
        with_outline: bool,
    ) -> PoseObservation {
        let m = &self.markers[color];
        // Paper cut too large or a blooming sensor widen the outline; that is not nearness.
        let scale = 1.0 - (m.edge_bias[0] + m.edge_bias[1]) / fit.area.sqrt().max(1.0);
        let outline = Quad(fit.quad.0.map(|c| fit.centroid + (c - fit.centroid) * scale));
        PoseObservation {
            color,
            pixel: fit.centroid,
            sigma: PoseObservation::SIGMA,
            outline: (with_outline && m.turn_updates > 0).then_some((outline, m.turn)),
        }
    }

    /// Recent distance of the worst marker from its adapted place, px.
    pub fn largest_misplacement(&self) -> f64 {
        self.markers.0.iter().map(|m| m.misplacement).fold(0.0, f64::max)
    }

    /// Turn (rad) of an outline in its plane.
    pub fn turn_of(&self, color: MarkerColor, view: &View<'_>, fit: &QuadFit) -> Option<f64> {
        Some(self.markers[color].turn + self.compare(color, view, fit)?.turn)
    }

    /// Adapts one marker to a whole outline, one of `detected` markers that determine the view. A
    /// marker whose geometry has settled adapts only where it `is_due`.
    pub fn adapt(
        &mut self,
        color: MarkerColor,
        view: &View<'_>,
        fit: &QuadFit,
        detected: usize,
        is_due: bool,
    ) {
        let m = &self.markers[color];
        // Three markers leave the tilt too open to measure sizes, but hardly the turn.
        let determined = detected >= 4 || (detected == 3 && m.turn_updates <= 10);
        if (m.is_settled() && !is_due) || !determined {
            return;
        }
        let Some(difference) = self.compare(color, view, fit) else { return };
        let m = &mut self.markers[color];
        m.turn = (m.turn + gain(m.turn_updates) * difference.turn).clamp(-MAX_TURN, MAX_TURN);
        m.turn_updates = m.turn_updates.saturating_add(1);
        // With an assumed camera model, sizes and places would adapt to its errors.
        if detected < 4 || !view.is_known {
            return;
        }
        let gain = gain(m.edge_bias_updates);
        for (known, now) in m.edge_bias.iter_mut().zip(difference.edge_bias) {
            *known += gain * (now - *known).clamp(-1.0, 1.0);
        }
        m.edge_bias_updates = m.edge_bias_updates.saturating_add(1);
        self.adapt_place(color, view, fit);
    }

    /// Moves a marker on the platform towards where it is seen. The four centroids over-determine
    /// the pose by two; what remains, pose after pose, is the error of the layout.
    fn adapt_place(&mut self, color: MarkerColor, view: &View<'_>, fit: &QuadFit) {
        let Some(p) = self.layout.projected_centroid(color, view.camera, &view.pose) else {
            return;
        };
        let plane =
            view.pose.rotation.to_rotation_matrix().matrix().fixed_columns::<2>(0).into_owned();
        let Some(inverse) = (p.jacobian_by_center * plane).try_inverse() else { return };
        let off = fit.centroid - p.pixel;
        let m = &mut self.markers[color];
        // An outline that something touches must not move a known place.
        if m.is_placed() && off.norm() > 0.3 + 3.0 * m.misplacement {
            return;
        }
        m.misplacement += 0.2 * (off.norm() - m.misplacement);
        let by = inverse * off / f64::from(m.place_updates.min(SETTLED) + 1);
        m.place_updates = m.place_updates.saturating_add(1);
        let limit = MAX_MISPLACEMENT * self.layout.side;
        let (given, place) = (self.given.centers[color], &mut self.layout.centers[color]);
        for i in 0..2 {
            place[i] = (place[i] + by[i]).clamp(given[i] - limit, given[i] + limit);
        }
    }

    /// Difference of a measured outline from the predicted one.
    fn compare(
        &self,
        color: MarkerColor,
        view: &View<'_>,
        fit: &QuadFit,
    ) -> Option<OutlineDifference> {
        /// Step of the numerical derivative, rad.
        const STEP: f64 = 0.01;
        let turn = self.markers[color].turn;
        let here = project_square(&self.layout, color, turn, view.camera, &view.pose)?;
        let turned = project_square(&self.layout, color, turn + STEP, view.camera, &view.pose)?;
        let (mut gain, mut sum, mut edge_bias) = (0.0, 0.0, [0.0; 2]);
        let (by_step, measured) = (here.turns_to(&turned), here.turns_to(&fit.quad));
        let (_, here_center) = here.area_and_centroid();
        for (i, side) in Side::of(&here, here_center).iter().enumerate() {
            let g = by_step[i] / STEP;
            gain += g * g;
            sum += g * measured[i];
            // Distance of the measured edge's middle outside of the predicted one, about the same
            // center.
            let middle = (fit.quad.0[i] + fit.quad.0[(i + 1) % 4]) / 2.0;
            let distance = (middle - fit.centroid).dot(&side.normal);
            edge_bias[i % 2] += (distance - side.distance) / 2.0;
        }
        let turn = sum / gain;
        let finite = turn.is_finite() && edge_bias.iter().all(|b| b.is_finite());
        finite.then_some(OutlineDifference { turn, edge_bias })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    #[test]
    fn the_adaptation_restarts_after_one_marker_was_elsewhere_for_two_seconds() {
        let layout = MarkerLayout { side: 0.076, centers: PerColor([Point3::origin(); 4]) };
        let red = Some(MarkerColor::Red);
        let is_placed = |platform: &PlatformModel| platform.markers[MarkerColor::Blue].is_placed();
        // Images per second; in the last case every interval is a pause that counts for less.
        for (rate, images) in [(5.0, 10), (30.0, 60), (120.0, 240), (0.1, 8)] {
            // The sum of the intervals is not exact.
            let interval = 1.001 / rate;
            for last in [red, Some(MarkerColor::Blue), None] {
                let mut platform = PlatformModel::new(layout.clone());
                platform.markers.0.iter_mut().for_each(|m| m.place_updates = 100);
                (1..images).for_each(|_| platform.note_displaced(red, interval));
                assert!(is_placed(&platform), "{rate} Hz");
                platform.note_displaced(last, interval);
                assert_eq!(is_placed(&platform), last != red, "{rate} Hz");
            }
        }
    }
}
