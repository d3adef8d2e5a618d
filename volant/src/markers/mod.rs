//! Sheets to print: the marker squares at scale, a drawing of where they belong, and advice on
//! paper and size. Lengths are millimeters, x to the right and y down from the sheet's upper left
//! corner.

mod pdf;
mod sheets;
mod svg;

pub use pdf::pdf;
pub use sheets::sheets;
pub use svg::svg;

/// Size of the paper, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paper {
    /// Name of the format.
    pub name: &'static str,
    /// Width, mm.
    pub width: f64,
    /// Height, mm.
    pub height: f64,
}

impl Paper {
    /// ISO A4.
    pub const A4: Self = Self { name: "A4", width: 210.0, height: 297.0 };
    /// ISO A3.
    pub const A3: Self = Self { name: "A3", width: 297.0, height: 420.0 };
    /// US letter.
    pub const LETTER: Self = Self { name: "Letter", width: 215.9, height: 279.4 };
}

/// Alignment of a text at its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Align {
    /// The text starts there.
    Start,
    /// The text is centered there.
    Middle,
}

/// A mark on a sheet.
#[derive(Clone, Debug, PartialEq)]
pub enum Mark {
    /// Filled rectangle without outline.
    Rectangle {
        /// Upper left corner.
        at: [f64; 2],
        /// Width and height.
        size: [f64; 2],
        /// Color, RGB.
        color: [u8; 3],
    },
    /// Black line.
    Line {
        /// One end.
        from: [f64; 2],
        /// The other.
        to: [f64; 2],
        /// Width.
        width: f64,
    },
    /// Black text in Helvetica, whose encoding in PDF has the characters of Latin-1.
    Text {
        /// Start or middle of the baseline.
        at: [f64; 2],
        /// Height of the font.
        size: f64,
        /// Alignment.
        align: Align,
        /// The text.
        text: String,
    },
}

/// A sheet of paper.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sheet {
    /// Marks in the order of printing.
    pub marks: Vec<Mark>,
}

#[cfg(test)]
mod tests;
