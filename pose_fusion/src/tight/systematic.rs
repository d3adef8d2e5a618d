//! Constant offsets of the markers' centroids.
//!
//! What one image's centroid is off by has two parts: noise, new in each image, and an offset that stays as long as scene and
//! light do: uneven paper, a shadow along an edge, a neighbour's colour in the chroma. An observation's covariance tells the size of both together, but a
//! filter that takes all of it for noise believes to average the second part away, and its attitude is after some seconds surer than it may be.
//!
//! The offsets `b` (px, raw image, one for x and y of each marker) are unknown constants which the filter takes to be 0; beside its estimate stands how much that
//! would differ, per pixel of each of them (Friedland 1969, as in [`super::tie`]): `V ← V − K (H V + E)` at an image, where `E` is 1 for
//! the markers that were used, `V ← V − K H V` at any other measurement, `V ← F V` between two. What is said of the uncertainty is
//! `P + σ² V Vᵀ`: the covariance of a filter that was not told the offsets (the "consider" covariance of Schmidt 1966), while its gains stay
//! those without. The offsets are not estimated: 20 s of swing do not tell them from a tilt and the accelerometer's bias.

use super::state::N;
use nalgebra::SMatrix;

/// By how much the estimate would differ, per pixel of the offsets: x and y of red, green, blue, yellow.
pub type ByPixel = SMatrix<f64, N, 8>;
