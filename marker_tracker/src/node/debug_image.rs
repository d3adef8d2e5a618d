//! Debug images as JPEG, drawn with OpenCV.

use crate::{debug_view::MarkerView, image::ImageView};
use nalgebra::Vector2;
use opencv::{
    core::{Mat, Point, Scalar, Vec3b},
    imgproc,
};
use rig_model::{MarkerColor, MarkerState, PerColor};

/// Draws and encodes a debug image (quality 80).
///
/// # Errors
/// OpenCV's reason, the encoder's, or that of an image whose fields contradict each other.
pub(super) fn encode(
    view: &ImageView<'_>,
    markers: &PerColor<MarkerView>,
) -> Result<Vec<u8>, String> {
    view.check().map_err(|e| e.to_string())?;
    // A checked image has at most 16384 px a side.
    let (width, height) = (view.width as u16, view.height as u16);
    let mut pixels = view.to_rgb();
    draw(&mut pixels, (width, height), markers).map_err(|e| e.to_string())?;
    let mut data = Vec::new();
    jpeg_encoder::Encoder::new(&mut data, 80)
        .encode(&pixels, width, height, jpeg_encoder::ColorType::Rgb)
        .map_err(|e| e.to_string())?;
    Ok(data)
}

/// Draws into the rgb8 pixels of an image of this size: windows, outlines, flow (enlarged ten
/// times), centroids and states of the markers.
fn draw(
    pixels: &mut [u8],
    (width, height): (u16, u16),
    markers: &PerColor<MarkerView>,
) -> opencv::Result<()> {
    let (height, width) = (i32::from(height), i32::from(width));
    let mut out = Mat::new_rows_cols_with_bytes_mut::<Vec3b>(height, width, pixels)?;
    let white = Scalar::new(255.0, 255.0, 255.0, 0.0);
    for (color, m) in markers.iter() {
        let ink = match color {
            MarkerColor::Red => Scalar::new(255.0, 120.0, 120.0, 0.0),
            MarkerColor::Green => Scalar::new(120.0, 255.0, 120.0, 0.0),
            MarkerColor::Blue => Scalar::new(120.0, 200.0, 255.0, 0.0),
            MarkerColor::Yellow => Scalar::new(255.0, 255.0, 90.0, 0.0),
        };
        let [x0, y0, x1, y1] = m.window;
        if x1 > x0 && y1 > y0 {
            let last = Point::new(x1 - 1, y1 - 1);
            imgproc::rectangle_points_def(&mut out, Point::new(x0, y0), last, ink)?;
        }
        if let Some(outline) = m.outline {
            for i in 0..4 {
                let (from, to) = (fine(outline[i]), fine(outline[(i + 1) % 4]));
                imgproc::line(&mut out, from, to, white, 1, imgproc::LINE_AA, FINE_BITS)?;
            }
        }
        if !m.centroid.x.is_finite() || !m.centroid.y.is_finite() {
            continue;
        }
        let (center, ring) =
            (fine(m.centroid), if m.state == MarkerState::Detected { white } else { ink });
        imgproc::circle(&mut out, center, 3 << FINE_BITS, ring, 1, imgproc::LINE_AA, FINE_BITS)?;
        let end = fine(m.centroid + m.flow * 10.0);
        imgproc::line(&mut out, center, end, white, 1, imgproc::LINE_AA, FINE_BITS)?;
        let text = format!("{color} {:?}", m.state).to_lowercase();
        let at = Point::new(x0.max(0), (y0 - 3).max(8));
        let (font, smooth) = (imgproc::FONT_HERSHEY_SIMPLEX, imgproc::LINE_AA);
        imgproc::put_text(&mut out, &text, at, font, 0.35, ink, 1, smooth, false)?;
    }
    Ok(())
}

/// Binary digits of a pixel's fractions with which lines and circles are drawn.
const FINE_BITS: i32 = 4;

/// A place (px) in units of 1/16 px.
fn fine(place: Vector2<f64>) -> Point {
    let scale = f64::from(1_i32 << FINE_BITS);
    Point::new((place.x * scale).round() as i32, (place.y * scale).round() as i32)
}
