//! What became of a marker in one image.

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
    /// The outline contradicts the geometry of the other markers.
    Inconsistent,
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
            Self::Inconsistent => "contradicts the other markers' geometry",
            Self::OtherMotion => "of another motion than the markers",
            Self::RepeatedImage => "the image is byte for byte the previous one",
        }
    }
}
