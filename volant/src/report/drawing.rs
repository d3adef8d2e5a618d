//! Figures other than charts: images, bars, arrows.

use super::{
    chart::ChartError,
    page::escape,
    palette::{colors, finished, hex},
};
use data_encoding::BASE64;
use plotters::style::RGBColor;
use std::fmt::Write;

/// Alignment of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Starts at its position.
    Start,
    /// Centered on its position.
    Middle,
    /// Ends at its position.
    End,
}

/// Color and width of a line, px.
#[derive(Clone, Copy, Debug)]
pub struct Ink(pub RGBColor, pub f64);

/// SVG under construction.
#[derive(Clone, Debug)]
pub struct Drawing {
    width: f64,
    body: String,
}

impl Drawing {
    /// Creates an empty drawing of this width, px.
    pub fn new(width: f64) -> Self {
        Self { width, body: String::new() }
    }

    /// Adds a text with its baseline at `y`.
    pub fn text(&mut self, x: f64, y: f64, size: f64, color: RGBColor, anchor: Anchor, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let _ = writeln!(
            self.body,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" font-family=\"sans-serif\" \
             text-anchor=\"{anchor}\" \
             fill=\"{}\">{}</text>",
            hex(color),
            escape(text)
        );
    }

    /// Adds a straight line.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], ink: Ink) {
        let _ = writeln!(
            self.body,
            "<line x1=\"{:.2}\" y1=\"{:.2}\" x2=\"{:.2}\" y2=\"{:.2}\" stroke=\"{}\" \
             stroke-width=\"{}\" \
             stroke-linecap=\"round\"/>",
            from[0],
            from[1],
            to[0],
            to[1],
            hex(ink.0),
            ink.1
        );
    }

    /// Adds an arrow of any length.
    pub fn arrow(&mut self, from: [f64; 2], to: [f64; 2], ink: Ink) {
        self.line(from, to, ink);
        let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
        let length = dx.hypot(dy);
        if length < 1.0 {
            return;
        }
        let (ux, uy) = (dx / length, dy / length);
        let head = (3.5 * ink.1).min(0.6 * length);
        for side in [-0.5, 0.5] {
            let barb = [to[0] - head * ux - side * head * uy, to[1] - head * uy + side * head * ux];
            self.line(to, barb, ink);
        }
    }

    /// Adds a filled rectangle.
    pub fn bar(&mut self, x: f64, y: f64, width: f64, height: f64, color: RGBColor) {
        let _ = writeln!(
            self.body,
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{}\"/>",
            width.max(0.0),
            height.max(0.0),
            hex(color)
        );
    }

    /// Adds a polygon's outline.
    pub fn outline(&mut self, points: &[[f64; 2]], ink: Ink) {
        let points: Vec<String> =
            points.iter().map(|p| format!("{:.2},{:.2}", p[0], p[1])).collect();
        let _ = writeln!(
            self.body,
            "<polygon points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" \
             stroke-linejoin=\"round\"/>",
            points.join(" "),
            hex(ink.0),
            ink.1
        );
    }

    /// Adds a small circle; hollow where `filled` is false.
    pub fn dot(&mut self, center: [f64; 2], radius: f64, color: RGBColor, filled: bool) {
        let (fill, stroke) =
            if filled { (hex(color), "none".to_owned()) } else { ("none".to_owned(), hex(color)) };
        let _ = writeln!(
            self.body,
            "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"{stroke}\" \
             stroke-width=\"2\"/>",
            center[0], center[1]
        );
    }

    /// Adds an image in this rectangle: `rgb` row by row, `columns` px wide; `crisp`: without
    /// interpolation.
    ///
    /// # Errors
    /// The pixels do not fill the last row.
    #[allow(clippy::too_many_arguments)]
    pub fn image(
        &mut self,
        x: f64,
        y: f64,
        width: f64,
        height: f64,
        columns: usize,
        rgb: &[u8],
        crisp: bool,
    ) -> Result<(), ChartError> {
        let data = png(columns, rgb)?;
        let crisp = if crisp { " style=\"image-rendering:pixelated\"" } else { "" };
        let _ = writeln!(
            self.body,
            "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" \
             preserveAspectRatio=\"none\"{crisp} \
             href=\"data:image/png;base64,{}\"/>",
            BASE64.encode(&data)
        );
        Ok(())
    }

    /// Adds another finished drawing.
    pub fn embed(&mut self, x: f64, y: f64, svg: &str) {
        // The outer drawing has the style sheet.
        let bare = svg.replacen(&format!("<style>{}</style>", super::palette::style()), "", 1);
        let _ = writeln!(
            self.body,
            "{}",
            bare.replacen("<svg ", &format!("<svg x=\"{x}\" y=\"{y}\" "), 1)
        );
    }

    /// Finishes the SVG, `height` px high, with its accessible name.
    pub fn finish(self, height: f64, name: &str) -> String {
        let svg = format!(
            "<svg width=\"{0}\" height=\"{height}\" xmlns=\"http://www.w3.org/2000/svg\" \
             viewBox=\"0 0 {0} {height}\">\n\
             <rect x=\"0\" y=\"0\" width=\"{0}\" height=\"{height}\" fill=\"{1}\" \
             stroke=\"none\"/>\n{2}</svg>\n",
            self.width,
            hex(colors::BACK),
            self.body
        );
        finished(&svg, name)
    }
}

fn png(columns: usize, rgb: &[u8]) -> Result<Vec<u8>, ChartError> {
    let wrong = |e: &dyn std::fmt::Display| ChartError(format!("an image: {e}"));
    if columns == 0 || rgb.is_empty() || !rgb.len().is_multiple_of(3 * columns) {
        return Err(wrong(&"its pixels do not fill the last row"));
    }
    let mut data = Vec::new();
    let mut encoder =
        png::Encoder::new(&mut data, columns as u32, (rgb.len() / columns / 3) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|e| wrong(&e))?;
    writer.write_image_data(rgb).map_err(|e| wrong(&e))?;
    writer.finish().map_err(|e| wrong(&e))?;
    Ok(data)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn images_are_embedded_as_png_and_partial_rows_are_rejected() {
        let rgb: Vec<u8> = (0..5 * 4 * 3).map(|i| (i * 7) as u8).collect();
        let data = png(5, &rgb).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&data)).read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert_eq!(back, rgb);
        assert!(png(7, &rgb).is_err() && png(0, &rgb).is_err());
        let mut drawing = Drawing::new(100.0);
        drawing.image(0.0, 0.0, 50.0, 40.0, 5, &rgb, true).unwrap();
        drawing.text(1.0, 2.0, 14.0, colors::INK, Anchor::End, "a < b");
        let svg = drawing.finish(60.0, "an image");
        assert!(svg.contains("data:image/png;base64,iVBOR") && svg.contains("a &lt; b"));
        assert!(svg.contains("viewBox=\"0 0 100 60\""));
    }
}
