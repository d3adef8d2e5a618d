//! A square's outline: four straight edges measured below the pixel, and the area centroid that
//! they enclose.
//!
//! Input: an image through a marker's discriminant ([`Sampler`](crate::signal::Sampler)) and the
//! predicted outline. Output: the measured outline, its centroid and the centroid's covariance. A
//! lens of ordinary distortion bends the image of a straight edge by a few hundredths of a pixel;
//! the line fitted by least squares encloses the same area, and so the same centroid to first
//! order.

mod beside;
mod combine;
mod fit;

pub(crate) use fit::{QuadFit, fit};
