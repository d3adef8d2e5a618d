//! Debug images.

use crate::{
    debug_view::MarkerView,
    image::{ImageView, OwnedImage, PixelFormat},
};
use nalgebra::Vector2;
use opencv::{
    core::{Mat, Point, Scalar, Vec3b},
    imgproc,
};
use rig_model::{MarkerColor, MarkerState, PerColor};

/// Draws a debug image: the image with windows, outlines, flow (enlarged ten times), centroids and
/// states of the markers.
///
/// # Errors
/// OpenCV's reason, or that of an image whose fields contradict each other.
pub fn draw(view: &ImageView<'_>, markers: &PerColor<MarkerView>) -> Result<OwnedImage, String> {
    view.check().map_err(|e| e.to_string())?;
    let mut image = OwnedImage {
        width: view.width,
        height: view.height,
        step: view.width * 3,
        format: PixelFormat::Rgb8,
        data: view.to_rgb(),
    };
    let mut draw = || -> opencv::Result<()> {
        let mut out = Mat::new_rows_cols_with_bytes_mut::<Vec3b>(
            view.height as i32,
            view.width as i32,
            &mut image.data,
        )?;
        // OpenCV draws in units of 1/16 px.
        let place =
            |v: Vector2<f64>| Point::new((v.x * 16.0).round() as i32, (v.y * 16.0).round() as i32);
        let smooth = imgproc::LINE_AA;
        for (color, m) in markers.iter() {
            let ink = match color {
                MarkerColor::Red => Scalar::new(255.0, 120.0, 120.0, 0.0),
                MarkerColor::Green => Scalar::new(120.0, 255.0, 120.0, 0.0),
                MarkerColor::Blue => Scalar::new(120.0, 200.0, 255.0, 0.0),
                MarkerColor::Yellow => Scalar::new(255.0, 255.0, 90.0, 0.0),
            };
            let white = Scalar::new(255.0, 255.0, 255.0, 0.0);
            let [x0, y0, x1, y1] = m.window;
            if x1 > x0 && y1 > y0 {
                imgproc::rectangle_points(
                    &mut out,
                    Point::new(x0, y0),
                    Point::new(x1 - 1, y1 - 1),
                    ink,
                    1,
                    imgproc::LINE_8,
                    0,
                )?;
            }
            if let Some(outline) = m.outline {
                for i in 0..4 {
                    imgproc::line(
                        &mut out,
                        place(outline[i]),
                        place(outline[(i + 1) % 4]),
                        white,
                        1,
                        smooth,
                        4,
                    )?;
                }
            }
            if !m.centroid.x.is_finite() || !m.centroid.y.is_finite() {
                continue;
            }
            imgproc::circle(
                &mut out,
                place(m.centroid),
                3 * 16,
                if m.state == MarkerState::Detected { white } else { ink },
                1,
                smooth,
                4,
            )?;
            imgproc::line(
                &mut out,
                place(m.centroid),
                place(m.centroid + m.flow * 10.0),
                white,
                1,
                smooth,
                4,
            )?;
            let word = match m.state {
                MarkerState::Detected => "detected",
                MarkerState::Predicted => "predicted",
                MarkerState::Lost => "lost",
            };
            let at = Point::new(x0.max(0), (y0 - 3).max(8));
            imgproc::put_text(
                &mut out,
                &format!("{color} {word}"),
                at,
                imgproc::FONT_HERSHEY_SIMPLEX,
                0.35,
                ink,
                1,
                smooth,
                false,
            )?;
        }
        Ok(())
    };
    draw().map_err(|e| e.to_string())?;
    Ok(image)
}
