//! Colors that are distinguishable with color blindness, on white and on nearly black.

use plotters::style::RGBColor;
use std::fmt::Write;

/// Colors of the light scheme; `PAIRS` has those of the dark scheme.
pub mod colors {
    use plotters::style::RGBColor;
    /// Text, names of axes, truth.
    pub const INK: RGBColor = RGBColor(40, 40, 40);
    /// Numbers at axes, notes.
    pub const SOFT: RGBColor = RGBColor(92, 92, 92);
    /// Axes.
    pub const AXIS: RGBColor = RGBColor(120, 120, 120);
    /// Grid.
    pub const GRID: RGBColor = RGBColor(225, 225, 225);
    /// Background.
    pub const BACK: RGBColor = RGBColor(255, 255, 255);
    /// Shaded spans.
    pub const SHADE: RGBColor = RGBColor(236, 236, 226);
    /// Outline on an image, the same in both schemes.
    pub const PICTURE_DARK: RGBColor = RGBColor(16, 16, 18);
    /// Line on an image, the same in both schemes.
    pub const PICTURE_LIGHT: RGBColor = RGBColor(250, 250, 248);
    /// Second kind of line on an image, the same in both schemes.
    pub const PICTURE_YELLOW: RGBColor = RGBColor(255, 214, 64);
    /// Truth.
    pub const TRUTH: RGBColor = INK;
    /// Camera alone.
    pub const CAMERA: RGBColor = RGBColor(192, 112, 0);
    /// IMU alone.
    pub const INERTIAL: RGBColor = RGBColor(38, 124, 196);
    /// Fused pose.
    pub const FUSED: RGBColor = RGBColor(204, 44, 60);
    /// The paper's methods.
    pub const PAPER: RGBColor = RGBColor(0, 128, 96);
    /// A compared method.
    pub const VIOLET: RGBColor = RGBColor(122, 76, 176);
    /// A compared method.
    pub const GREY: RGBColor = RGBColor(108, 108, 110);
    /// A compared method.
    pub const BROWN: RGBColor = RGBColor(128, 88, 60);
    /// The green marker.
    pub const GREEN: RGBColor = RGBColor(56, 136, 52);
    /// The blue marker.
    pub const BLUE: RGBColor = RGBColor(46, 98, 186);
    /// The yellow marker.
    pub const YELLOW: RGBColor = RGBColor(158, 124, 0);
}

/// Colors of the light scheme with those of the dark scheme.
const PAIRS: [(RGBColor, &str); 16] = [
    (colors::INK, "#eceae5"),
    (colors::SOFT, "#b9b6ae"),
    (colors::AXIS, "#8b8e94"),
    (colors::GRID, "#34363a"),
    (colors::BACK, "#1d1e21"),
    (colors::SHADE, "#2d2e2a"),
    (colors::CAMERA, "#f2a93b"),
    (colors::INERTIAL, "#6cb6f5"),
    (colors::FUSED, "#ff7a82"),
    (colors::PAPER, "#3fcb9f"),
    (colors::VIOLET, "#bb9bf5"),
    (colors::GREY, "#aeb0b4"),
    (colors::GREEN, "#7fce77"),
    (colors::BLUE, "#86aefc"),
    (colors::YELLOW, "#e6cc52"),
    (colors::BROWN, "#d0a27e"),
];

/// Formats a color as plotters does, `#RRGGBB`.
pub fn hex(color: RGBColor) -> String {
    format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2)
}

/// Style sheet that replaces the light colors in a dark scheme.
pub(super) fn style() -> String {
    let mut css = String::from(
        "svg.volant text{font-family:system-ui,-apple-system,\"Segoe UI\",Roboto,\"DejaVu \
         Sans\",sans-serif}\
         @media (prefers-color-scheme:dark){",
    );
    for (light, dark) in PAIRS {
        let light = hex(light);
        let _ = write!(
            css,
            "svg.volant [fill=\"{light}\"]{{fill:{dark}}}svg.volant \
             [stroke=\"{light}\"]{{stroke:{dark}}}"
        );
    }
    css.push('}');
    css
}

/// Completes an SVG that has a `viewBox`: it gets an accessible name, and a dark scheme.
pub fn finished(svg: &str, name: &str) -> String {
    let svg = &svg[svg.find("<svg").unwrap_or(0)..];
    let Some(end) = svg.find('>') else { return svg.to_owned() };
    let (head, rest) = svg.split_at(end);
    let name = super::page::escape(name);
    format!(
        "{head} class=\"volant\" role=\"img\" \
         aria-label=\"{name}\"><title>{name}</title><style>{}</style>{}",
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
    fn every_color_can_be_read_on_both_backgrounds() {
        let (white, black) = (hex(colors::BACK), "#1d1e21");
        for (light, dark) in PAIRS {
            if [colors::GRID, colors::BACK, colors::SHADE].contains(&light) {
                continue;
            }
            let (on_white, on_black) = (contrast(&hex(light), &white), contrast(dark, black));
            let least = if [colors::INK, colors::SOFT].contains(&light) { 4.5 } else { 3.0 };
            assert!(
                on_white >= least && on_black >= least,
                "{light:?} {on_white:.2} {on_black:.2}"
            );
        }
        assert!((contrast("#000000", "#ffffff") - 21.0).abs() < 1e-9);
    }

    #[test]
    fn a_finished_drawing_has_a_name_and_a_dark_side() {
        let made = finished("<?xml?><svg width=\"90\" xmlns=\"x\"><g/></svg>", "a & b");
        assert!(made.starts_with("<svg width=\"90\" xmlns=\"x\" class=\"volant\""), "{made}");
        assert!(made.contains("<title>a &amp; b</title>") && made.ends_with("<g/></svg>"));
        assert!(made.contains("svg.volant [fill=\"#FFFFFF\"]{fill:#1d1e21}"));
    }
}
