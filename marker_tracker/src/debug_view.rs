//! What debug images show of the tracker.

use nalgebra::Vector2;
use rig_model::MarkerState;

/// What a debug image shows of one marker.
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
