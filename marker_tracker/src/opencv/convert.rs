//! Bayer and YUV 4:2:2 images into pixels.

use crate::image::{ImageError, ImageView, OwnedImage, PixelFormat};
use opencv::{
    core::{Mat, Vec2b, Vec3b},
    imgproc,
};

/// OpenCV's conversion of an encoding to r, g, b, and its bytes per pixel.
///
/// `sensor_msgs/image_encodings` names a Bayer pattern by the first two pixels of the first two
/// rows, OpenCV by the second and third of the second row: rggb is its BG.
fn conversion(encoding: &str) -> Option<(i32, usize)> {
    let code = match encoding {
        "bayer_rggb8" | "bayer_rggb16" => imgproc::COLOR_BayerBG2RGB,
        "bayer_bggr8" | "bayer_bggr16" => imgproc::COLOR_BayerRG2RGB,
        "bayer_gbrg8" | "bayer_gbrg16" => imgproc::COLOR_BayerGR2RGB,
        "bayer_grbg8" | "bayer_grbg16" => imgproc::COLOR_BayerGB2RGB,
        "yuv422" | "uyvy" => imgproc::COLOR_YUV2RGB_UYVY,
        "yuv422_yuy2" | "yuyv" => imgproc::COLOR_YUV2RGB_YUY2,
        _ => return None,
    };
    Some((code, if encoding.ends_with('8') { 1 } else { 2 }))
}

/// Largest value of 14 bits, those of the deepest common sensors. Some drivers leave 10, 12 or 14
/// bits in the low bits of 16, whose upper byte is then nearly black. An image of all 16 bits stays
/// below this only where its exposure uses less than a quarter of the range.
const LOW_BITS: u16 = (1 << 14) - 1;

/// Converts Bayer or YUV 4:2:2 into rgb8.
///
/// # Errors
/// [`ImageError::UnknownEncoding`], [`ImageError::Size`] where size, step and data contradict each
/// other, [`ImageError::LowBits`] where 16-bit values use the low bits only,
/// [`ImageError::Decode`] with OpenCV's reason.
pub(crate) fn convert(
    width: usize,
    height: usize,
    encoding: &str,
    big_endian: bool,
    step: usize,
    data: &[u8],
    scratch: &mut OwnedImage,
) -> Result<(), ImageError> {
    let (code, bytes_per_pixel) =
        conversion(encoding).ok_or_else(|| ImageError::UnknownEncoding(encoding.to_owned()))?;
    let row = width.saturating_mul(bytes_per_pixel);
    let yuv = encoding.starts_with('y') || encoding.starts_with('u');
    let holds_pattern = if yuv { width.is_multiple_of(2) } else { width.min(height) >= 2 };
    if !holds_pattern || !ImageView::fits(width, height, step, row, data.len()) {
        return Err(ImageError::Size { width, height, step, length: data.len() });
    }
    let packed: Vec<u8>;
    let bytes: &[u8] = if bytes_per_pixel == 2 && !yuv {
        let value = if big_endian { u16::from_be_bytes } else { u16::from_le_bytes };
        let largest = (0..height)
            .flat_map(|y| data[y * step..y * step + row].chunks_exact(2))
            .map(|pair| value([pair[0], pair[1]]))
            .max()
            .unwrap_or(0);
        if largest <= LOW_BITS {
            return Err(ImageError::LowBits { encoding: encoding.to_owned(), largest });
        }
        // The upper byte of each 16-bit value.
        let upper = usize::from(!big_endian);
        packed = (0..height)
            .flat_map(|y| data[y * step..y * step + row].iter().skip(upper).step_by(2).copied())
            .collect();
        &packed
    } else if step == row {
        &data[..row * height]
    } else {
        packed = (0..height).flat_map(|y| data[y * step..y * step + row].iter().copied()).collect();
        &packed
    };
    let (w, h) = (width as i32, height as i32);
    scratch.data.resize(width * height * 3, 0);
    (scratch.width, scratch.height, scratch.step, scratch.format) =
        (width, height, width * 3, PixelFormat::Rgb8);
    let converted = (|| {
        let mut out = Mat::new_rows_cols_with_bytes_mut::<Vec3b>(h, w, &mut scratch.data)?;
        let pixels = if yuv {
            Mat::new_rows_cols_with_bytes::<Vec2b>(h, w, bytes)
        } else {
            Mat::new_rows_cols_with_bytes::<u8>(h, w, bytes)
        };
        imgproc::cvt_color_def(&pixels?, &mut out, code)
    })();
    converted.map_err(|e| ImageError::Decode { format: "Bayer or YUV", reason: e.to_string() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A smooth colored image, sampled through a pattern, is recovered with every color in place.
    #[test]
    fn every_bayer_pattern_is_converted() {
        let (w, h) = (65usize, 47usize);
        let truth = |x: usize, y: usize| [60 + x as i32, 200 - 2 * y as i32, 40 + (x + y) as i32];
        for pattern in ["rggb", "bggr", "gbrg", "grbg"] {
            let channel = |k: usize| {
                let (x, y) = (k % w, k / w);
                let letter = &pattern[(y % 2) * 2 + x % 2..][..1];
                truth(x, y)["rgb".find(letter).unwrap()] as u8
            };
            let values: Vec<u8> = (0..w * h).map(channel).collect();
            let eight: Vec<u8> = values.chunks(w).flat_map(|row| [row, &[0; 6]].concat()).collect();
            let little: Vec<u8> = values.iter().flat_map(|v| [0, *v]).collect();
            let big: Vec<u8> = values.iter().flat_map(|v| [*v, 0]).collect();
            for (encoding, big_endian, step, data) in [
                (format!("bayer_{pattern}8"), false, w + 6, &eight),
                (format!("bayer_{pattern}16"), false, 2 * w, &little),
                (format!("bayer_{pattern}16"), true, 2 * w, &big),
            ] {
                let mut image = OwnedImage::default();
                convert(w, h, &encoding, big_endian, step, data, &mut image).unwrap();
                let inside =
                    |k: &usize| (4..w - 4).contains(&(k % w)) && (4..h - 4).contains(&(k / w));
                for k in (0..w * h).filter(inside) {
                    let (found, wanted) = (&image.data[3 * k..][..3], truth(k % w, k / w));
                    let off = |c: usize| (i32::from(found[c]) - wanted[c]).abs();
                    assert!((0..3).all(|c| off(c) <= 2), "{encoding} {k}: {found:?}, {wanted:?}");
                }
            }
        }
    }

    #[test]
    fn values_in_the_low_bits_are_rejected_with_the_remedy() {
        for big_endian in [false, true] {
            for (bits, is_rejected) in [(10, true), (12, true), (14, true), (16, false)] {
                let largest = ((1u32 << bits) - 1) as u16;
                let bytes = if big_endian { largest.to_be_bytes() } else { largest.to_le_bytes() };
                let data = bytes.repeat(8 * 8);
                let mut image = OwnedImage::default();
                let result = convert(8, 8, "bayer_rggb16", big_endian, 16, &data, &mut image);
                assert_eq!(result.is_err(), is_rejected, "{bits} bits: {result:?}");
                if let Err(error) = result {
                    let text = error.to_string();
                    assert!(text.contains("bayer_rggb16") && text.contains("set the camera"));
                }
            }
        }
    }

    #[test]
    fn yuv_422_is_converted_in_either_order() {
        let (w, h) = (16usize, 4usize);
        // BT.601, studio range: (200, 60, 40).
        let (r, g, b) = (200.0, 60.0, 40.0);
        let y = 16.0 + 0.257 * r + 0.504 * g + 0.098 * b;
        let u = 128.0 - 0.148 * r - 0.291 * g + 0.439 * b;
        let v = 128.0 + 0.439 * r - 0.368 * g - 0.071 * b;
        let [y, u, v] = [y, u, v].map(|x: f64| x.round() as u8);
        let (uyvy, yuyv) = ([u, y, v, y], [y, u, y, v]);
        for (encoding, unit) in
            [("yuv422", uyvy), ("uyvy", uyvy), ("yuv422_yuy2", yuyv), ("yuyv", yuyv)]
        {
            let (data, mut image) = (unit.repeat(w * h / 2), OwnedImage::default());
            convert(w, h, encoding, false, 2 * w, &data, &mut image).unwrap();
            for (found, wanted) in image.data.iter().zip([r, g, b].iter().cycle()) {
                assert!((f64::from(*found) - wanted).abs() < 4.0, "{encoding}: {found}, {wanted}");
            }
        }
    }

    #[test]
    fn contradicting_sizes_are_rejected() {
        let mut image = OwnedImage::default();
        for (width, encoding, step, length) in
            [(8, "bayer_rggb8", 8, 63), (7, "yuv422", 14, 112), (usize::MAX, "yuv422", 14, 112)]
        {
            let result = convert(width, 8, encoding, false, step, &[0; 112][..length], &mut image);
            assert!(matches!(result, Err(ImageError::Size { .. })), "{width} {encoding}");
        }
        assert!(matches!(
            convert(8, 8, "nv21", false, 8, &[0; 96], &mut image),
            Err(ImageError::UnknownEncoding(_))
        ));
    }
}
