//! Marker identification (paper, II-B): the color layers of an image, and their binary images.

use crate::{
    config::BinaryThreshold,
    image::{ImageView, PixelFormat},
};
use opencv::{
    boxed_ref::BoxedRef,
    core::{self, Mat, Rect, Size, Vec3b, Vec4b, Vector},
    imgproc,
    prelude::*,
};
use rig_model::{MarkerColor, PerColor};

/// Smallest maximum of a layer, 0–255, that is made binary: JPEG and sensor noise of a gray scene
/// stay below it.
const MIN_MAXIMUM: f64 = 20.0;
/// Gain of a layer's maximum, which is the brightest of noisy pixels: with the threshold, the area
/// of the region would vary from image to image. And the largest share by which it falls: while a
/// marker is hidden, the floor's faint tints must not take its place, and lamps that are dimmed are
/// followed within seconds.
const MAXIMUM_GAIN: f64 = 0.1;
const MAXIMUM_DECAY: f64 = 0.01;

/// Pixels of an image as OpenCV reads them.
pub(super) struct Pixels<'a> {
    mat: BoxedRef<'a, Mat>,
    blue_first: bool,
}

impl<'a> Pixels<'a> {
    /// Borrows the pixels; rows with padding are copied into `packed` first.
    pub fn of(image: &ImageView<'a>, packed: &'a mut Vec<u8>) -> opencv::Result<Self> {
        let (width, height) = (image.width, image.height);
        let row = width * image.format.bytes_per_pixel();
        let bytes = if image.step == row {
            &image.data[..row * height]
        } else {
            packed.clear();
            (0..height)
                .for_each(|y| packed.extend_from_slice(&image.data[y * image.step..][..row]));
            packed
        };
        let (h, w) = (height as i32, width as i32);
        let mat = match image.format {
            PixelFormat::Rgb8 | PixelFormat::Bgr8 => {
                Mat::new_rows_cols_with_bytes::<Vec3b>(h, w, bytes)?
            }
            PixelFormat::Rgba8 | PixelFormat::Bgra8 => {
                Mat::new_rows_cols_with_bytes::<Vec4b>(h, w, bytes)?
            }
        };
        Ok(Self { mat, blue_first: image.format.blue_first() })
    }

    /// The whole image, px.
    pub fn bounds(&self) -> Rect {
        Rect::new(0, 0, self.mat.cols(), self.mat.rows())
    }

    /// Gray image of half the width and height, in which each pixel is the mean of four.
    pub fn half_gray(&self) -> opencv::Result<Mat> {
        let code = if self.blue_first { imgproc::COLOR_BGR2GRAY } else { imgproc::COLOR_RGB2GRAY };
        let (mut gray, mut half) = (Mat::default(), Mat::default());
        imgproc::cvt_color_def(&self.mat, &mut gray, code)?;
        let size = Size::new((gray.cols() / 2).max(1), (gray.rows() / 2).max(1));
        imgproc::resize(&gray, &mut half, size, 0.0, 0.0, imgproc::INTER_AREA)?;
        Ok(half)
    }

    /// H, S, V of a window; H is in units of 2°.
    pub fn hsv(&self, window: Rect) -> opencv::Result<Mat> {
        let code = if self.blue_first { imgproc::COLOR_BGR2HSV } else { imgproc::COLOR_RGB2HSV };
        let mut hsv = Mat::default();
        imgproc::cvt_color_def(&Mat::roi(&self.mat, window)?, &mut hsv, code)?;
        Ok(hsv)
    }

    /// The layers red R − G, green G − R, blue B − R, yellow R − red − B, each difference at least
    /// 0.
    pub fn layers(&self) -> opencv::Result<PerColor<Mat>> {
        let mut channels = Vector::<Mat>::new();
        core::split(&self.mat, &mut channels)?;
        let (first, g, third) = (channels.get(0)?, channels.get(1)?, channels.get(2)?);
        let (r, b) = if self.blue_first { (third, first) } else { (first, third) };
        let mut layers = PerColor::<Mat>::from_fn(|_| Mat::default());
        core::subtract_def(&r, &g, &mut layers[MarkerColor::Red])?;
        core::subtract_def(&g, &r, &mut layers[MarkerColor::Green])?;
        core::subtract_def(&b, &r, &mut layers[MarkerColor::Blue])?;
        let mut rest = Mat::default();
        core::subtract_def(&r, &layers[MarkerColor::Red], &mut rest)?;
        core::subtract_def(&rest, &b, &mut layers[MarkerColor::Yellow])?;
        Ok(layers)
    }
}

/// Makes layers binary.
#[derive(Clone, Debug, Default)]
pub(super) struct Binarizer {
    /// Recent maximum of each layer, 0–255; `None` before the first image.
    maxima: PerColor<Option<f64>>,
}

impl Binarizer {
    /// Binary images, 255 where the layer exceeds the threshold, else 0.
    pub fn binary(
        &mut self,
        layers: &PerColor<Mat>,
        threshold: BinaryThreshold,
    ) -> opencv::Result<PerColor<Mat>> {
        let mut binary = PerColor::<Mat>::from_fn(|_| Mat::default());
        for (color, layer) in layers.iter() {
            let mut range = 255.0;
            if threshold.of_maximum {
                let mut largest = 0.0;
                core::min_max_loc(layer, None, Some(&mut largest), None, None, &core::no_array())?;
                let recent = self.maxima[color].get_or_insert(largest);
                *recent += (MAXIMUM_GAIN * (largest - *recent)).max(-MAXIMUM_DECAY * *recent);
                range = recent.max(MIN_MAXIMUM);
            }
            imgproc::threshold(
                layer,
                &mut binary[color],
                threshold.share * range,
                255.0,
                imgproc::THRESH_BINARY,
            )?;
        }
        Ok(binary)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rig_model::Stamp;

    /// The layers of a column of pixels in padded rows.
    fn layers_of(rgb: &[[u8; 3]]) -> PerColor<Mat> {
        let data: Vec<u8> = rgb.iter().flat_map(|[r, g, b]| [*r, *g, *b, 9, 9]).collect();
        let (stamp, format) = (Stamp::from_nanos(0), PixelFormat::Rgb8);
        let image = ImageView { stamp, width: 1, height: rgb.len(), step: 5, format, data: &data };
        Pixels::of(&image, &mut Vec::new()).unwrap().layers().unwrap()
    }

    #[test]
    fn layers_are_those_of_the_paper() {
        let rgb = [[200, 40, 50], [40, 200, 50], [40, 50, 200], [220, 200, 60], [90, 200, 60]];
        // The last one is green: its yellow is R − B, since R − G is negative.
        let wanted =
            [[160, 0, 0, 0], [0, 160, 10, 0], [0, 10, 160, 0], [20, 0, 0, 140], [0, 110, 0, 30]];
        let layers = layers_of(&rgb);
        for (i, wanted) in wanted.iter().enumerate() {
            let found = layers.0.each_ref().map(|l| *l.at_2d::<u8>(i as i32, 0).unwrap());
            assert_eq!(found, *wanted, "pixel {i}");
        }
    }

    #[test]
    fn the_threshold_is_a_share_of_the_range_or_of_the_maximum() {
        let layers = layers_of(&[[200, 40, 40], [170, 40, 40], [140, 40, 40]]);
        let count = |binarizer: &mut Binarizer, layers, share, of_maximum| {
            let binary = binarizer.binary(layers, BinaryThreshold { share, of_maximum }).unwrap();
            core::count_non_zero(&binary[MarkerColor::Red]).unwrap()
        };
        let mut binarizer = Binarizer::default();
        // 160, 130 and 100 of 255: none exceeds 191, two exceed 0.75 · 160.
        assert_eq!(count(&mut binarizer, &layers, 0.75, false), 0);
        assert_eq!(count(&mut binarizer, &layers, 0.75, true), 2);
        // A faint thing does not replace a marker that has just been hidden.
        let faint = layers_of(&[[110, 40, 40]]);
        assert_eq!(count(&mut binarizer, &faint, 0.75, true), 0);
        (0..200).for_each(|_| drop(binarizer.binary(&faint, BinaryThreshold::default())));
        assert_eq!(count(&mut binarizer, &faint, 0.75, true), 1);
    }
}
