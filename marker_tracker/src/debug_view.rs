//! What debug images and diagnostics show of the tracker.

use nalgebra::Vector2;
use rig_model::MarkerState;

/// Outcome of the search for one marker in one image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Outcome {
    /// No outline near the predicted place, and no pose that predicts it better.
    #[default]
    NotFound,
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
