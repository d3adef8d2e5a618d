//! Which marker a color belongs to.

use rig_model::{MarkerColor, PerColor};

/// A pixel's color class.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Class {
    pub color: MarkerColor,
    /// Layer difference, 0–255.
    pub layer: i32,
    /// Brightest channel, 0–255.
    pub max: i32,
}

/// Classifies a pixel by the paper's layer differences, each taken against the stronger of the
/// layers that it has to exceed.
#[inline(always)]
fn classify([r, g, b]: [u8; 3]) -> Option<Class> {
    let (r, g, b) = (i32::from(r), i32::from(g), i32::from(b));
    let max = r.max(g).max(b);
    let (color, layer) = if r >= g && g >= b {
        // Between red and yellow; orange (hue 30°) is where they meet.
        if 2 * (g - b) >= r - b { (MarkerColor::Yellow, g - b) } else { (MarkerColor::Red, r - g) }
    } else if r >= g {
        (MarkerColor::Red, r - g.max(b))
    } else if g >= b {
        // Yellow-green (hue 75°) is where yellow meets green.
        if 4 * (r - b) >= 3 * (g - b) {
            (MarkerColor::Yellow, r - b)
        } else {
            (MarkerColor::Green, g - r.max(b))
        }
    } else {
        (MarkerColor::Blue, b - g.max(r))
    };
    (layer > 0).then_some(Class { color, layer, max })
}

/// Assigns pixels to markers: by the hues of the markers' names, or by those of calibrated paper.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Palette {
    /// Unit vectors of the markers' hues.
    hues: Option<[[f32; 2]; 4]>,
}

impl Palette {
    /// cos 40°, the largest angle between a pixel's hue and its marker's: tuned; guarded by
    /// this file's test.
    const FURTHEST: f32 = 0.766;
    /// Ordinary paper, for a marker without calibration beside calibrated ones.
    const ORDINARY: [[f64; 3]; 4] =
        [[200.0, 40.0, 40.0], [50.0, 170.0, 70.0], [40.0, 90.0, 190.0], [210.0, 190.0, 50.0]];

    /// From the calibrated mean colors, r, g, b of 0–255.
    pub fn new(colors: &PerColor<Option<[f64; 3]>>) -> Self {
        let any = colors.0.iter().any(Option::is_some);
        Self {
            hues: any.then(|| {
                std::array::from_fn(|i| {
                    let [a, b] = chroma(colors.0[i].unwrap_or(Self::ORDINARY[i]).map(|v| v as f32));
                    let length = a.hypot(b).max(1e-6);
                    [a / length, b / length]
                })
            }),
        }
    }

    /// Class of a pixel; `None` for gray and for other hues.
    #[inline(always)]
    pub fn classify(&self, rgb: [u8; 3]) -> Option<Class> {
        let Some(hues) = &self.hues else { return classify(rgb) };
        let [a, b] = chroma(rgb.map(f32::from));
        let along = hues.map(|h| h[0] * a + h[1] * b);
        let mut best = 0;
        for i in 1..4 {
            if along[i] > along[best] {
                best = i;
            }
        }
        if along[best] <= 0.0 || along[best].powi(2) < Self::FURTHEST.powi(2) * (a * a + b * b) {
            return None;
        }
        let (max, min) = (rgb[0].max(rgb[1]).max(rgb[2]), rgb[0].min(rgb[1]).min(rgb[2]));
        let (layer, max) = (i32::from(max - min), i32::from(max));
        Some(Class { color: MarkerColor::ALL[best], layer, max })
    }

    /// Marker of a mean color, r, g, b of 0–255.
    pub fn classify_mean(&self, rgb: [f32; 3]) -> Option<MarkerColor> {
        self.classify(rgb.map(|c| c as u8)).map(|c| c.color)
    }
}

/// A color's component across the gray axis; its direction is the hue.
#[inline(always)]
fn chroma([r, g, b]: [f32; 3]) -> [f32; 2] {
    [2.0 * r - g - b, 1.732_050_8 * (g - b)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_calibrated_palette_separates_other_hues() {
        let ordinary = Palette::default();
        let name = |p: &Palette, rgb| p.classify(rgb).map(|c| c.color);
        for (i, rgb) in Palette::ORDINARY.iter().enumerate() {
            assert_eq!(name(&ordinary, rgb.map(|v| v as u8)), Some(MarkerColor::ALL[i]));
        }
        // Turquoise paper for blue, orange for red.
        let (turquoise, orange) = ([40.0, 170.0, 160.0], [220.0, 120.0, 40.0]);
        let colors = PerColor([Some(orange), None, Some(turquoise), None]);
        let calibrated = Palette::new(&colors);
        assert_eq!(name(&ordinary, [40, 170, 160]), Some(MarkerColor::Green));
        assert_eq!(name(&calibrated, [40, 170, 160]), Some(MarkerColor::Blue));
        assert_eq!(name(&ordinary, [220, 120, 40]), Some(MarkerColor::Red));
        assert_eq!(name(&calibrated, [220, 120, 40]), Some(MarkerColor::Red));
        assert_eq!(name(&calibrated, [200, 30, 160]), None);
    }
}
