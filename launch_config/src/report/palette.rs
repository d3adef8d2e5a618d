//! Colours that can be told apart by those who do not see all of them, on white and on nearly black.

use plotters::style::RGBColor;
use std::fmt::Write;

/// The light colours; `PAIRS` holds what each becomes in the dark.
pub mod colours {
    use plotters::style::RGBColor;
    /// Text, axes' names, the truth.
    pub const INK: RGBColor = RGBColor(40, 40, 40);
    /// Numbers at the axes, notes.
    pub const SOFT: RGBColor = RGBColor(92, 92, 92);
    /// Axes.
    pub const AXIS: RGBColor = RGBColor(120, 120, 120);
    /// Grid.
    pub const GRID: RGBColor = RGBColor(225, 225, 225);
    /// What is behind all.
    pub const BACK: RGBColor = RGBColor(255, 255, 255);
    /// A shaded span.
    pub const SHADE: RGBColor = RGBColor(236, 236, 226);
    /// A rim on a photograph: the same in the dark.
    pub const PICTURE_DARK: RGBColor = RGBColor(16, 16, 18);
    /// A line on a photograph: the same in the dark.
    pub const PICTURE_LIGHT: RGBColor = RGBColor(250, 250, 248);
    /// The truth.
    pub const TRUTH: RGBColor = INK;
    /// The camera alone.
    pub const CAMERA: RGBColor = RGBColor(192, 112, 0);
    /// The inertial unit alone.
    pub const INERTIAL: RGBColor = RGBColor(38, 124, 196);
    /// The fused pose, the default of this program.
    pub const FUSED: RGBColor = RGBColor(204, 44, 60);
    /// The paper's filter, the paper's recipe.
    pub const PAPER: RGBColor = RGBColor(0, 128, 96);
    /// A rival.
    pub const VIOLET: RGBColor = RGBColor(122, 76, 176);
    /// A rival.
    pub const GREY: RGBColor = RGBColor(108, 108, 110);
    /// A rival.
    pub const BROWN: RGBColor = RGBColor(128, 88, 60);
    /// The green marker.
    pub const GREEN: RGBColor = RGBColor(56, 136, 52);
    /// The blue marker.
    pub const BLUE: RGBColor = RGBColor(46, 98, 186);
    /// The yellow marker.
    pub const YELLOW: RGBColor = RGBColor(158, 124, 0);
}

/// A light colour and what it becomes in the dark.
const PAIRS: [(RGBColor, &str); 16] = [
    (colours::INK, "#eceae5"),
    (colours::SOFT, "#b9b6ae"),
    (colours::AXIS, "#8b8e94"),
    (colours::GRID, "#34363a"),
    (colours::BACK, "#1d1e21"),
    (colours::SHADE, "#2d2e2a"),
    (colours::CAMERA, "#f2a93b"),
    (colours::INERTIAL, "#6cb6f5"),
    (colours::FUSED, "#ff7a82"),
    (colours::PAPER, "#3fcb9f"),
    (colours::VIOLET, "#bb9bf5"),
    (colours::GREY, "#aeb0b4"),
    (colours::GREEN, "#7fce77"),
    (colours::BLUE, "#86aefc"),
    (colours::YELLOW, "#e6cc52"),
    (colours::BROWN, "#d0a27e"),
];

/// As `#RRGGBB`, the way plotters writes it.
pub fn hex(colour: RGBColor) -> String {
    format!("#{:02X}{:02X}{:02X}", colour.0, colour.1, colour.2)
}

/// What exchanges the light colours where dark is preferred.
pub(super) fn style() -> String {
    let mut css = String::from(
        "svg.volant text{font-family:system-ui,-apple-system,\"Segoe UI\",Roboto,\"DejaVu Sans\",sans-serif}\
         @media (prefers-color-scheme:dark){",
    );
    for (light, dark) in PAIRS {
        let light = hex(light);
        let _ = write!(
            css,
            "svg.volant [fill=\"{light}\"]{{fill:{dark}}}svg.volant [stroke=\"{light}\"]{{stroke:{dark}}}"
        );
    }
    css.push('}');
    css
}

/// A drawing made fit for a page and for itself: it scales, has a name for those who cannot see it, and a dark side.
pub fn finished(svg: &str, name: &str) -> String {
    let svg = &svg[svg.find("<svg").unwrap_or(0)..];
    let Some(end) = svg.find('>') else { return svg.to_owned() };
    let (head, rest) = svg.split_at(end);
    let attribute = |name: &str| {
        let start = head.find(&format!(" {name}=\""))? + name.len() + 3;
        head[start..].split('"').next()?.parse::<f64>().ok()
    };
    let view = match (attribute("width"), attribute("height")) {
        (Some(w), Some(h)) if !head.contains("viewBox") => format!(" viewBox=\"0 0 {w} {h}\""),
        _ => String::new(),
    };
    let name = super::page::escape(name);
    format!(
        "{head}{view} class=\"volant\" role=\"img\" aria-label=\"{name}\"><title>{name}</title><style>{}</style>{}",
        style(),
        &rest[1..]
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance of sRGB (WCAG 2).
    fn luminance(hex: &str) -> f64 {
        let channel = |i: usize| {
            let v = f64::from(u8::from_str_radix(&hex[i..i + 2], 16).unwrap()) / 255.0;
            if v <= 0.04045 { v / 12.92 } else { ((v + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
    }

    fn contrast(a: &str, b: &str) -> f64 {
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    #[test]
    fn every_colour_can_be_read_on_both_backgrounds() {
        let (white, black) = (hex(colours::BACK), "#1d1e21");
        for (light, dark) in PAIRS {
            if [colours::GRID, colours::BACK, colours::SHADE].contains(&light) {
                continue;
            }
            let (on_white, on_black) = (contrast(&hex(light), &white), contrast(dark, black));
            let least = if [colours::INK, colours::SOFT].contains(&light) { 4.5 } else { 3.0 };
            assert!(on_white >= least && on_black >= least, "{light:?} {on_white:.2} {on_black:.2}");
        }
        assert!((contrast("#000000", "#ffffff") - 21.0).abs() < 1e-9);
    }

    #[test]
    fn a_finished_drawing_scales_and_has_a_dark_side() {
        let made = finished("<?xml?><svg width=\"90\" height=\"40\" xmlns=\"x\"><g/></svg>", "a & b");
        assert!(made.starts_with(
            "<svg width=\"90\" height=\"40\" xmlns=\"x\" viewBox=\"0 0 90 40\" class=\"volant\""
        ));
        assert!(made.contains("<title>a &amp; b</title>") && made.ends_with("<g/></svg>"));
        assert!(made.contains("svg.volant [fill=\"#FFFFFF\"]{fill:#1d1e21}"));
    }
}
