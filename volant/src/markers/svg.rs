//! Sheets as SVG, one below the other, in millimeters.

use super::{Align, Mark, Paper, Sheet};
use std::fmt::Write;

/// Writes the sheets as one SVG.
pub fn svg(sheets: &[Sheet], paper: &Paper) -> String {
    let (width, height) = (paper.width, paper.height * sheets.len() as f64);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}mm\" height=\"{height}mm\" \
         viewBox=\"0 0 {width} {height}\" font-family=\"Helvetica, Arial, sans-serif\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n"
    );
    for (i, sheet) in sheets.iter().enumerate() {
        let _ = writeln!(svg, "<g transform=\"translate(0 {})\">", paper.height * i as f64);
        sheet.marks.iter().for_each(|mark| draw(mark, &mut svg));
        svg.push_str("</g>\n");
    }
    svg.push_str("</svg>\n");
    svg
}

fn draw(mark: &Mark, svg: &mut String) {
    let _ = match mark {
        Mark::Rectangle { at: [x, y], size: [width, height], color: [r, g, b] } => writeln!(
            svg,
            "<rect x=\"{x:.3}\" y=\"{y:.3}\" width=\"{width:.3}\" height=\"{height:.3}\" \
             fill=\"#{r:02x}{g:02x}{b:02x}\"/>"
        ),
        Mark::Line { from: [x1, y1], to: [x2, y2], width } => writeln!(
            svg,
            "<line x1=\"{x1:.3}\" y1=\"{y1:.3}\" x2=\"{x2:.3}\" y2=\"{y2:.3}\" stroke=\"#000000\" \
             stroke-width=\"{width}\"/>"
        ),
        Mark::Text { at: [x, y], size, align, text } => {
            let anchor = if *align == Align::Middle { " text-anchor=\"middle\"" } else { "" };
            let text = text.replace('&', "&amp;").replace('<', "&lt;");
            writeln!(
                svg,
                "<text x=\"{x:.2}\" y=\"{y:.2}\" font-size=\"{size}\"{anchor}>{text}</text>"
            )
        }
    };
}
