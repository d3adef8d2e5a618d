//! Hue histogram (paper, II-C, second criterion): H of HSV of a marker, and its back projection.

use super::binary::Pixels;
use opencv::{
    core::{self, Mat, Rect, Vector},
    imgproc,
    prelude::*,
};
use rig_model::MarkerColor;

/// Bins over OpenCV's range of H, 0–180 for the circle: 12° each.
const BINS: usize = 30;
const RANGE: [f32; 2] = [0.0, 180.0];
/// Least back projection, 0–255, of a pixel with the marker's hue: a bin with a sixth of the
/// fullest one's pixels.
const MIN_LIKELIHOOD: f64 = 40.0;
/// Hues of the markers' names, degrees, in the order red, green, blue, yellow, and the half-width
/// of the hues that are searched for before a marker's own histogram is known: half of the smallest
/// distance between two of the names.
const NAMED: [f32; 4] = [355.0, 130.0, 215.0, 50.0];
const NAMED_HALF_WIDTH: f32 = 27.5;

/// Hue histogram of a marker, its fullest bin 255.
#[derive(Clone, Debug)]
pub(super) struct HueModel {
    bins: [f32; BINS],
}

impl HueModel {
    /// All hues of a color's name, or around that of calibrated paper (r, g, b of 0–255).
    pub fn named(color: MarkerColor, calibrated: Option<[f64; 3]>) -> Self {
        let center = calibrated
            .and_then(|rgb| crate::hue::hue(rgb.map(|v| v.clamp(0.0, 255.0) as u8)))
            .map_or(NAMED[color.index()], |(degrees, _)| degrees);
        let bins = std::array::from_fn(|i| {
            let off = (i as f32 + 0.5) * 360.0 / BINS as f32 - center;
            let off = (off + 180.0).rem_euclid(360.0) - 180.0;
            if off.abs() <= NAMED_HALF_WIDTH { 255.0 } else { 0.0 }
        });
        Self { bins }
    }

    /// The histogram of the pixels of a window in which `mask` is set.
    pub fn of(pixels: &Pixels<'_>, window: Rect, mask: &Mat) -> opencv::Result<Self> {
        let images: Vector<Mat> = [pixels.hsv(window)?].into_iter().collect();
        let (mut histogram, mut scaled) = (Mat::default(), Mat::default());
        imgproc::calc_hist_def(
            &images,
            &Vector::from_slice(&[0]),
            mask,
            &mut histogram,
            &Vector::from_slice(&[BINS as i32]),
            &Vector::from_slice(&RANGE),
        )?;
        core::normalize(
            &histogram,
            &mut scaled,
            255.0,
            0.0,
            core::NORM_INF,
            -1,
            &core::no_array(),
        )?;
        let mut bins = [0.0; BINS];
        bins.copy_from_slice(scaled.data_typed::<f32>()?);
        Ok(Self { bins })
    }

    /// Binary image of a window: 255 at pixels with the marker's hue.
    pub fn back_projection(&self, pixels: &Pixels<'_>, window: Rect) -> opencv::Result<Mat> {
        let images: Vector<Mat> = [pixels.hsv(window)?].into_iter().collect();
        let histogram = Mat::new_rows_cols_with_data::<f32>(BINS as i32, 1, &self.bins)?;
        let (mut likelihood, mut binary) = (Mat::default(), Mat::default());
        imgproc::calc_back_project(
            &images,
            &Vector::from_slice(&[0]),
            &histogram,
            &mut likelihood,
            &Vector::from_slice(&RANGE),
            1.0,
        )?;
        imgproc::threshold(
            &likelihood,
            &mut binary,
            MIN_LIKELIHOOD,
            255.0,
            imgproc::THRESH_BINARY,
        )?;
        Ok(binary)
    }
}
