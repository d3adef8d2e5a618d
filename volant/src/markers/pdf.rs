//! Sheets as PDF. Text is in one of the fonts that every reader has.

use super::{Align, Mark, Paper, Sheet};
use pdf_writer::{Content, Name, Pdf, Rect, Ref, Str};

/// Points per millimeter.
const POINT: f64 = 72.0 / 25.4;
/// Mean width of Helvetica's letters, of the font size: centers a label to a few percent.
const ADVANCE: f64 = 0.5;
const FONT: Name<'static> = Name(b"F1");

/// Writes the sheets as a PDF, one page each.
pub fn pdf(sheets: &[Sheet], paper: &Paper) -> Vec<u8> {
    let [catalog, tree, font] = [1, 2, 3].map(Ref::new);
    let page = |i: usize| Ref::new(4 + 2 * i as i32);
    let content = |i: usize| Ref::new(5 + 2 * i as i32);
    let mut pdf = Pdf::new();
    pdf.catalog(catalog).pages(tree);
    pdf.pages(tree).kids((0..sheets.len()).map(page)).count(sheets.len() as i32);
    // Its codes of printable characters are those of Latin-1.
    pdf.type1_font(font)
        .base_font(Name(b"Helvetica"))
        .encoding_predefined(Name(b"WinAnsiEncoding"));
    let (width, height) = ((paper.width * POINT) as f32, (paper.height * POINT) as f32);
    for (i, sheet) in sheets.iter().enumerate() {
        let mut leaf = pdf.page(page(i));
        leaf.parent(tree).media_box(Rect::new(0.0, 0.0, width, height)).contents(content(i));
        leaf.resources().fonts().pair(FONT, font);
        drop(leaf);
        pdf.stream(content(i), &drawn(sheet, paper));
    }
    pdf.finish()
}

fn drawn(sheet: &Sheet, paper: &Paper) -> Vec<u8> {
    // A PDF's y axis points up.
    let point = |at: [f64; 2]| ((at[0] * POINT) as f32, ((paper.height - at[1]) * POINT) as f32);
    let length = |mm: f64| (mm * POINT) as f32;
    let mut content = Content::new();
    for mark in &sheet.marks {
        match mark {
            Mark::Rectangle { at, size, color } => {
                let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
                let (x, y) = point([at[0], at[1] + size[1]]);
                content.set_fill_rgb(r, g, b);
                content.rect(x, y, length(size[0]), length(size[1])).fill_nonzero();
            }
            Mark::Line { from, to, width } => {
                let ((x, y), end) = (point(*from), point(*to));
                content.set_line_width(length(*width));
                content.move_to(x, y).line_to(end.0, end.1).stroke();
            }
            Mark::Text { at, size, align, text } => {
                let text = latin_1(text);
                let width = ADVANCE * size * text.len() as f64;
                let start = at[0] - if *align == Align::Middle { width / 2.0 } else { 0.0 };
                let (x, y) = point([start, at[1]]);
                content.set_fill_gray(0.0).begin_text();
                content.set_font(FONT, length(*size)).next_line(x, y);
                content.show(Str(&text)).end_text();
            }
        }
    }
    content.finish().to_vec()
}

/// Encodes a text, with `?` for what Latin-1 lacks: a frame's name may have any character.
fn latin_1(text: &str) -> Vec<u8> {
    let code = |c: char| u8::try_from(c).ok().filter(|code| matches!(code, 32..=126 | 160..));
    text.chars().map(|c| code(c).unwrap_or(b'?')).collect()
}
