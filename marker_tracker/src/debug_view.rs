//! What debug images and diagnostics show of the tracker.

use nalgebra::Vector2;
use rig_model::{MarkerState, PerColor};

/// Outcome of the search for one marker in one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// No outline near the predicted place, and no pose that predicts it better.
    #[default]
    NotFound,
    /// Nothing in the image has its color.
    NoPatch,
    /// What has its color is not where the layout has the marker beside the others.
    NotInLayout,
    /// What has its color could be in several poses of the platform.
    Ambiguous,
    /// What has its color, where the layout has the marker, is not bounded by four straight edges.
    NoOutline,
    /// Detected: all four edges were measured, or a region of the whole square's area.
    Whole,
    /// Detected from the edges that are not covered.
    PartlyCovered,
    /// Too little of the outline is visible.
    Covered,
    /// A square of another hue is there.
    OtherHue,
    /// The visible edges do not have the square's shape in the pose of the other markers.
    OtherShape,
    /// The visible edges are not where the pose of the other markers predicts them.
    Displaced,
    /// It moves as the surroundings do, or otherwise than the markers (published tracker).
    OtherMotion,
    /// The image is a copy of its predecessor.
    RepeatedImage,
}

impl Outcome {
    /// A phrase for diagnostics.
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::NotFound => "not found",
            Self::NoPatch => "nothing of its color in the image",
            Self::NotInLayout => "what has its color is not where the layout has it",
            Self::Ambiguous => "what has its color could be in several poses",
            Self::NoOutline => "what has its color is no square with four visible edges",
            Self::Whole => "whole",
            Self::PartlyCovered => "partly covered, measured by its other edges",
            Self::Covered => "covered",
            Self::OtherHue => "of another hue",
            Self::OtherShape => "partly covered, and of another shape",
            Self::Displaced => "not where the other markers predict it",
            Self::OtherMotion => "of another motion than the markers",
            Self::RepeatedImage => "the image is byte for byte the previous one",
        }
    }
}

/// The track of one marker after an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerView {
    /// Searched window: left, top, right, bottom (the last two excluded), px.
    pub window: [i32; 4],
    /// Corners of the measured outline, px.
    pub outline: Option<[Vector2<f64>; 4]>,
    /// Centroid, px; NaN where the marker is lost.
    pub centroid: Vector2<f64>,
    /// Displacement since the previous image, px.
    pub flow: Vector2<f64>,
    /// State of the marker.
    pub state: MarkerState,
    /// Outcome of the search for it.
    pub outcome: Outcome,
    /// Adapted color, r, g, b of 0–255; `None` until it is known.
    pub color: Option<[f32; 3]>,
}

/// A marker as the tracker measures it, for figures of its stages.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalView {
    /// Column and row of the window's first pixel, px.
    pub origin: [i32; 2],
    /// Columns of the window.
    pub width: usize,
    /// Color signal of the window, row by row: 1 on the marker, 0 beside it, NaN outside of the
    /// image. It is the paper's binary image before rounding, on which the optical flow is
    /// computed.
    pub signal: Vec<f32>,
    /// Adapted hue histogram of the marker: equal bins over the circle from 0°, weighted by
    /// saturation, with sum 1.
    pub hue: Vec<f32>,
}

/// Explains from the outcomes of the search why the markers were not found, with a remedy.
pub(crate) fn why_not_found(outcomes: &PerColor<Outcome>) -> Option<String> {
    let colors_of = |outcome: Outcome| {
        let of = outcomes.iter().filter(|(_, o)| **o == outcome).map(|(color, _)| color.name());
        of.collect::<Vec<&str>>().join(", ")
    };
    let count_of = |outcome: Outcome| outcomes.0.iter().filter(|o| **o == outcome).count();
    let absent = colors_of(Outcome::NoPatch);
    let nothing = format!(
        "nothing has the color of {absent}; if the markers are in view, check the light and \
         calibrate the colors (`volant calibrate colors`)"
    );
    // Three markers are enough to find them.
    if count_of(Outcome::NoPatch) > 1 {
        return Some(nothing);
    }
    let why = if count_of(Outcome::NoOutline) > 0 {
        format!(
            "what has the color of {} is no square of `markers.size` with four visible edges: look \
             for something in front of it, for a thing of its color against it, and for highlights",
            colors_of(Outcome::NoOutline)
        )
    } else if count_of(Outcome::NotInLayout) > 0 {
        format!(
            "what has the color of {} is not arranged as the markers are: if they are in view, \
             check `markers` in the rig file, camera_info and the colors (`volant calibrate colors`)",
            colors_of(Outcome::NotInLayout)
        )
    } else if count_of(Outcome::Ambiguous) > 0 {
        format!("what has the color of {} could be in several poses", colors_of(Outcome::Ambiguous))
    } else {
        return None;
    };
    Some(if absent.is_empty() { why } else { format!("{why}; {nothing}") })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reason_names_the_colors() {
        use Outcome::{NoOutline, NoPatch, NotFound, NotInLayout};
        for (outcomes, wanted) in [
            ([NoPatch, NotInLayout, NoPatch, NotInLayout], Some("color of red, blue; if")),
            (
                [NoPatch, NotInLayout, NotInLayout, NotInLayout],
                Some("green, blue, yellow is not arranged"),
            ),
            ([NotInLayout, NoOutline, NotInLayout, NotInLayout], Some("of green is no square")),
            ([NotFound; 4], None),
        ] {
            let why = why_not_found(&PerColor(outcomes));
            assert_eq!(why.is_some(), wanted.is_some());
            assert!(wanted.is_none_or(|w| why.as_ref().unwrap().contains(w)), "{why:?}");
        }
    }
}
