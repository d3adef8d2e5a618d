//! Fig. 4: binary images and optical flow.

use super::{SHARE, Stages, chart_color, layer};
use crate::paper::{Made, PaperError, write};
use nalgebra::Vector2;
use rig_model::MarkerColor;
use std::{fmt::Write, path::Path};
use volant::report::{Anchor, Drawing, Ink, colors};

impl Stages {
    /// The paper's binary image of a color: pixels where its layer reaches the threshold.
    fn binary(&self, color: MarkerColor) -> Vec<bool> {
        let values: Vec<u8> =
            self.rgb.chunks_exact(3).map(|p| layer(color, [p[0], p[1], p[2]])).collect();
        let limit = SHARE * f64::from(values.iter().copied().max().unwrap_or(0));
        values.iter().map(|v| *v > 0 && f64::from(*v) >= limit).collect()
    }

    /// Fig. 4.
    ///
    /// # Errors
    /// A drawing, or a folder that is not writable.
    pub fn figure_4(&self, folder: &Path) -> Result<Made, PaperError> {
        let (w, h) = (self.image.width, self.image.height);
        let mut csv = String::from(concat!(
            "marker,x_px,y_px,flow_x_px,flow_y_px,true_flow_x_px,true_flow_y_px,",
            "largest_layer_value,pixels_over_literal_0.75,",
            "binary_pixels_on_marker,binary_pixels_elsewhere,signal_on_marker,signal_beside\n"
        ));
        let mut binary = vec![12u8; 3 * w * h];
        let (mut worst_flow, mut most_stray, mut literal_none) = (0.0f64, (0, MarkerColor::Red), 0);
        for color in MarkerColor::ALL {
            let m = &self.marks[color];
            let paint =
                [[225, 70, 80], [95, 200, 90], [90, 140, 245], [235, 210, 80]][color.index()];
            let (mut on, mut off) = (0, 0);
            for (i, set) in self.binary(color).into_iter().enumerate() {
                if set {
                    binary[3 * i..3 * i + 3].copy_from_slice(&paint);
                    let inside = self.on_marker(color, (i % w) as f64, (i / w) as f64);
                    *(if inside { &mut on } else { &mut off }) += 1;
                }
            }
            let values = || self.rgb.chunks_exact(3).map(|p| layer(color, [p[0], p[1], p[2]]));
            let largest = values().max().unwrap_or(0);
            let literal = values().filter(|v| f64::from(*v) >= SHARE * 255.0).count();
            literal_none += usize::from(literal == 0);
            if off > most_stray.0 {
                most_stray = (off, color);
            }
            let truth = self.true_flow[color].unwrap_or(Vector2::repeat(f64::NAN));
            worst_flow = worst_flow.max((m.flow - truth).norm());
            let (inside, beside) = self.signal_levels(color);
            let _ = writeln!(
                csv,
                concat!("{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{},{},{},{},{:.3},{:.3}"),
                color,
                m.centroid.x,
                m.centroid.y,
                m.flow.x,
                m.flow.y,
                truth.x,
                truth.y,
                largest,
                literal,
                on,
                off,
                inside,
                beside
            );
        }
        let svg = folder.join("fig-4.svg");
        write(&svg, &self.draw_4(&binary)?)?;
        let path = folder.join("fig-4.csv");
        write(&path, &csv)?;
        Ok(Made {
            name: "fig-4",
            title: "Fig. 4: binary images and optical flow",
            csv: path,
            svg,
            table: None,
            shows: format!(
                "One image of a swing. Top left what the camera sent, with the outlines that the \
                 tracker measured and each marker's flow since the image before, drawn five times \
                 as long; top right the paper's four binary images in one, each layer cut at 0.75 \
                 of its own largest value. Below, the tracker's own color signal around each \
                 marker: 1 on the marker, 0 beside it, not yet rounded. The flow is measured from \
                 its edges. It is within {worst_flow:.2} px of the true motion of the centroids."
            ),
            published: format!(
                "The paper makes each layer binary at 0.75 of the normalized intensity range. On \
                 paper as muted as here the literal threshold leaves nothing in {literal_none} of \
                 4 layers, so 0.75 of the layer's largest value replaces it. {} The tracker adapts \
                 the direction in RGB in which each marker differs most from its surroundings, and \
                 keeps the signal linear, because rounding couples the center of mass to the pixel \
                 grid.",
                if most_stray.0 == 0 {
                    "It catches no pixel beside the markers in this image.".to_owned()
                } else {
                    format!(
                        "It selects {} pixels that belong to no marker in the {} layer: objects of \
                         that color on the floor.",
                        most_stray.0, most_stray.1
                    )
                }
            ),
        })
    }

    /// Median of the color signal on the marker and at the window's rim.
    fn signal_levels(&self, color: MarkerColor) -> (f32, f32) {
        let (mut on, mut off) = (Vec::new(), Vec::new());
        if let Some(seen) = &self.seen[color] {
            for (i, v) in seen.signal.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                let x = f64::from(seen.origin[0]) + (i % seen.width) as f64;
                let y = f64::from(seen.origin[1]) + (i / seen.width) as f64;
                if self.on_marker(color, x, y) { on.push(*v) } else { off.push(*v) }
            }
        }
        let median = |values: &mut Vec<f32>| {
            values.sort_by(f32::total_cmp);
            values.get(values.len() / 2).copied().unwrap_or(f32::NAN)
        };
        (median(&mut on), median(&mut off))
    }

    fn draw_4(&self, binary: &[u8]) -> Result<String, PaperError> {
        let (w, h) = (self.image.width as f64, self.image.height as f64);
        let mut d = Drawing::new(1120.0);
        d.text(
            24.0,
            34.0,
            20.0,
            colors::INK,
            Anchor::Start,
            "Fig. 4: binary images and optical flow",
        );
        let (wide, left, right, top) = (526.0, 24.0, 570.0, 88.0);
        let high = wide * h / w;
        d.text(left, top - 14.0, 15.0, colors::INK, Anchor::Start, "camera, outlines, flow × 5");
        d.text(
            right,
            top - 14.0,
            15.0,
            colors::INK,
            Anchor::Start,
            "the paper's binary images, at 0.75 of the largest value",
        );
        d.image(left, top, wide, high, self.image.width, &self.rgb, false)?;
        d.image(right, top, wide, high, self.image.width, binary, false)?;
        let scale = wide / w;
        let place = |x: f64, y: f64| [left + (x + 0.5) * scale, top + (y + 0.5) * scale];
        // White on a dark rim: seen on any floor, in the light and in the dark.
        let (rim, bright) = (Ink(colors::PICTURE_DARK, 4.0), Ink(colors::PICTURE_LIGHT, 1.8));
        for m in &self.marks.0 {
            for ink in [rim, bright] {
                if let Some(corners) = m.outline {
                    d.outline(&corners.map(|c| place(c.x, c.y)), ink);
                }
                let (from, to) = (m.centroid, m.centroid + m.flow * 5.0);
                d.arrow(place(from.x, from.y), place(to.x, to.y), ink);
            }
        }
        let row = top + high + 48.0;
        for (i, color) in MarkerColor::ALL.into_iter().enumerate() {
            let x = left + 272.0 * i as f64;
            let m = &self.marks[color];
            d.text(
                x,
                row - 12.0,
                15.0,
                colors::INK,
                Anchor::Start,
                &format!("{color}: signal, flow {:+.1} {:+.1} px", m.flow.x, m.flow.y),
            );
            let Some(seen) = self.seen[color].as_ref().filter(|s| s.width > 0) else { continue };
            let rows = seen.signal.len() / seen.width;
            let gray: Vec<u8> = seen
                .signal
                .iter()
                .flat_map(|v| {
                    let level = if v.is_finite() {
                        (40.0 + 190.0 * v.clamp(0.0, 1.1)).min(255.0) as u8
                    } else {
                        12
                    };
                    [level; 3]
                })
                .collect();
            let edge = 256.0 / seen.width.max(rows) as f64;
            let (pw, ph) = (edge * seen.width as f64, edge * rows as f64);
            d.image(x, row, pw, ph, seen.width, &gray, true)?;
            if let Some(corners) = m.outline {
                let local = corners.map(|c| {
                    [
                        x + (c.x - f64::from(seen.origin[0]) + 0.5) * edge,
                        row + (c.y - f64::from(seen.origin[1]) + 0.5) * edge,
                    ]
                });
                d.outline(&local, Ink(chart_color(color), 2.5));
            }
        }
        Ok(d.finish(row + 256.0 + 24.0, "Fig. 4: binary images and optical flow"))
    }
}
