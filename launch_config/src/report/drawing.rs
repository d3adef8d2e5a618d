//! A drawing that is no chart: pictures, bars, arrows. Only what the figures need.

use super::{
    chart::ChartError,
    page::escape,
    palette::{colours, finished, hex},
};
use plotters::style::RGBColor;
use std::fmt::Write;

/// Where a text hangs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// It begins at its place.
    Start,
    /// It is centred on it.
    Middle,
    /// It ends there.
    End,
}

/// A line's colour and width, px.
#[derive(Clone, Copy, Debug)]
pub struct Ink(pub RGBColor, pub f64);

/// An SVG that grows.
#[derive(Clone, Debug)]
pub struct Drawing {
    width: f64,
    body: String,
}

impl Drawing {
    /// Empty, so many px wide.
    pub fn new(width: f64) -> Self {
        Self { width, body: String::new() }
    }

    /// A text whose baseline is at `y`.
    pub fn text(&mut self, x: f64, y: f64, size: f64, colour: RGBColor, anchor: Anchor, text: &str) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let _ = writeln!(
            self.body,
            "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{size}\" font-family=\"sans-serif\" text-anchor=\"{anchor}\" \
             fill=\"{}\">{}</text>",
            hex(colour),
            escape(text)
        );
    }

    /// A straight line.
    pub fn line(&mut self, from: [f64; 2], to: [f64; 2], ink: Ink) {
        let _ = writeln!(
            self.body,
            "<line x1=\"{:.2}\" y1=\"{:.2}\" x2=\"{:.2}\" y2=\"{:.2}\" stroke=\"{}\" stroke-width=\"{}\" \
             stroke-linecap=\"round\"/>",
            from[0],
            from[1],
            to[0],
            to[1],
            hex(ink.0),
            ink.1
        );
    }

    /// A line with a head at its end; as short as it may be, it is drawn.
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

    /// A filled rectangle.
    pub fn bar(&mut self, x: f64, y: f64, width: f64, height: f64, colour: RGBColor) {
        self.bar_of(x, y, width, height, &hex(colour));
    }

    /// A filled rectangle of a colour that is the same in the dark (a hue that is shown as such).
    pub fn bar_of(&mut self, x: f64, y: f64, width: f64, height: f64, css: &str) {
        let _ = writeln!(
            self.body,
            "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{css}\"/>",
            width.max(0.0),
            height.max(0.0)
        );
    }

    /// An outline.
    pub fn outline(&mut self, points: &[[f64; 2]], ink: Ink) {
        let points: Vec<String> = points.iter().map(|p| format!("{:.2},{:.2}", p[0], p[1])).collect();
        let _ = writeln!(
            self.body,
            "<polygon points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{}\" stroke-linejoin=\"round\"/>",
            points.join(" "),
            hex(ink.0),
            ink.1
        );
    }

    /// A small circle; hollow where `filled` is false.
    pub fn dot(&mut self, centre: [f64; 2], radius: f64, colour: RGBColor, filled: bool) {
        let (fill, stroke) =
            if filled { (hex(colour), "none".to_owned()) } else { ("none".to_owned(), hex(colour)) };
        let _ = writeln!(
            self.body,
            "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius}\" fill=\"{fill}\" stroke=\"{stroke}\" stroke-width=\"2\"/>",
            centre[0], centre[1]
        );
    }

    /// A picture in this rectangle: `rgb` row by row, `columns` px wide. `crisp`: its pixels stay squares.
    ///
    /// # Errors
    /// Pixels that are not whole rows.
    #[allow(clippy::too_many_arguments)]
    pub fn picture(
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
            "<image x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" preserveAspectRatio=\"none\"{crisp} \
             href=\"data:image/png;base64,{}\"/>",
            base64(&data)
        );
        Ok(())
    }

    /// Another finished drawing as a part of this one.
    pub fn embed(&mut self, x: f64, y: f64, svg: &str) {
        // The style sheet is the whole drawing's.
        let bare = svg.replacen(&format!("<style>{}</style>", super::palette::style()), "", 1);
        let _ = writeln!(self.body, "{}", bare.replacen("<svg ", &format!("<svg x=\"{x}\" y=\"{y}\" "), 1));
    }

    /// The whole, `height` px high, with what it is called.
    pub fn finish(self, height: f64, name: &str) -> String {
        let svg = format!(
            "<svg width=\"{}\" height=\"{height}\" xmlns=\"http://www.w3.org/2000/svg\">\n\
             <rect x=\"0\" y=\"0\" width=\"{}\" height=\"{height}\" fill=\"{}\" stroke=\"none\"/>\n{}</svg>\n",
            self.width,
            self.width,
            hex(colours::BACK),
            self.body
        );
        finished(&svg, name)
    }
}

fn png(columns: usize, rgb: &[u8]) -> Result<Vec<u8>, ChartError> {
    let wrong = |e: &dyn std::fmt::Display| ChartError(format!("a picture: {e}"));
    if columns == 0 || rgb.is_empty() || !rgb.len().is_multiple_of(3 * columns) {
        return Err(wrong(&"its pixels are not whole rows"));
    }
    let mut data = Vec::new();
    let mut encoder = png::Encoder::new(&mut data, columns as u32, (rgb.len() / columns / 3) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header().map_err(|e| wrong(&e))?;
    writer.write_image_data(rgb).map_err(|e| wrong(&e))?;
    writer.finish().map_err(|e| wrong(&e))?;
    Ok(data)
}

fn base64(data: &[u8]) -> String {
    const DIGITS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(data.len().div_ceil(3) * 4);
    for chunk in data.chunks(3) {
        let bits = chunk.iter().enumerate().fold(0u32, |b, (i, v)| b | u32::from(*v) << (16 - 8 * i));
        for i in 0..4 {
            let digit = DIGITS[(bits >> (18 - 6 * i)) as usize & 63];
            text.push(if i <= chunk.len() { char::from(digit) } else { '=' });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (plain, coded) in [
            ("", ""),
            ("f", "Zg=="),
            ("fo", "Zm8="),
            ("foo", "Zm9v"),
            ("foob", "Zm9vYg=="),
            ("fooba", "Zm9vYmE="),
            ("foobar", "Zm9vYmFy"),
        ] {
            assert_eq!(base64(plain.as_bytes()), coded);
        }
    }

    #[test]
    fn a_picture_comes_back_from_its_png_and_half_a_row_is_refused() {
        let rgb: Vec<u8> = (0..5 * 4 * 3).map(|i| (i * 7) as u8).collect();
        let data = png(5, &rgb).unwrap();
        let mut reader = png::Decoder::new(std::io::Cursor::new(&data)).read_info().unwrap();
        let mut back = vec![0; reader.output_buffer_size().unwrap()];
        reader.next_frame(&mut back).unwrap();
        assert_eq!(back, rgb);
        assert!(png(7, &rgb).is_err() && png(0, &rgb).is_err());
        let mut drawing = Drawing::new(100.0);
        drawing.picture(0.0, 0.0, 50.0, 40.0, 5, &rgb, true).unwrap();
        drawing.text(1.0, 2.0, 14.0, colours::INK, Anchor::End, "a < b");
        let svg = drawing.finish(60.0, "a picture");
        assert!(svg.contains("data:image/png;base64,iVBOR") && svg.contains("a &lt; b"));
        assert!(svg.contains("viewBox=\"0 0 100 60\""));
    }
}
