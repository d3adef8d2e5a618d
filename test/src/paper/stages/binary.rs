//! Fig. 4: binary images and optical flow of four images.

use super::{SHARE, Shot, Stages, chart_color, layer};
use crate::{
    live::quantile,
    paper::{Made, Value},
};
use anyhow::Result;
use nalgebra::Vector2;
use rig_model::MarkerColor;
use std::fmt::Write;
use volant::report::{Anchor, Drawing, Ink, colors};

const TITLE: &str = "Fig. 4: binary images and optical flow";
/// Arrows are longer than the flow by this factor.
const ARROW: f64 = 5.0;

/// Sums over the four images.
#[derive(Default)]
struct Tally {
    worst_flow: f64,
    /// Most pixels of a binary image that belong to no marker, and its color.
    most_stray: (usize, Option<MarkerColor>),
    /// Layers in which the literal threshold leaves nothing.
    literal_none: usize,
    /// Smallest difference of a marker's flow from its surroundings', px.
    least_difference: f64,
}

impl Stages {
    pub fn figure_4(&self) -> Result<Made> {
        let mut csv = String::from(concat!(
            "marker,x_px,y_px,flow_x_px,flow_y_px,true_flow_x_px,true_flow_y_px,",
            "largest_layer_value,pixels_over_literal_0.75,",
            "binary_pixels_on_marker,binary_pixels_elsewhere,signal_on_marker,signal_beside,",
            "seconds,surroundings_flow_x_px,surroundings_flow_y_px\n"
        ));
        let mut tally = Tally { least_difference: f64::INFINITY, ..Tally::default() };
        let binary: Vec<Vec<u8>> =
            self.0.iter().map(|shot| shot.binary_image(&mut csv, &mut tally)).collect();
        let layers = 4 * self.0.len();
        Ok(Made {
            name: "fig-4",
            title: TITLE,
            csv,
            svg: self.draw_4(&binary)?,
            table: None,
            values: vec![
                Value::new(
                    "threshold of a layer, as a share",
                    "0.75 of the intensity range",
                    "0.75 of the layer's largest value",
                ),
                Value::new(
                    "layers in which 0.75 of the range leaves nothing",
                    "–",
                    format!("{} of {layers}", tally.literal_none),
                ),
                Value::new(
                    "marker's flow minus the flow of its surroundings",
                    "larger than 0",
                    format!("{:.1} px at least", tally.least_difference),
                ),
            ],
            shows: format!(
                "Four images of a swing, a tenth of a second apart. Above what the camera sent: \
                 the outlines that the tracker measured (white), each marker's flow since the \
                 image before (white arrow) and the flow of the surroundings (yellow; \
                 Lucas–Kanade on a grid, where there is texture), all arrows {ARROW:.0} times as \
                 long. Below, the paper's four binary images in one, each layer cut at 0.75 of \
                 its own largest value, and the tracker's color signal around each marker in the \
                 last image: 1 on the marker, 0 beside it. The measured flow is within {:.2} px of \
                 the true motion of the centroids.",
                tally.worst_flow
            ),
            published: format!(
                "On paper as muted as here the published threshold leaves nothing in {} of \
                 {layers} layers, so 0.75 of the layer's largest value replaces it. {} The \
                 tracker adapts the direction in RGB in which each marker differs most from its \
                 surroundings, and keeps the signal linear, because rounding couples the center of \
                 mass to the pixel grid. The climber moves the camera, so the surroundings flow as \
                 well, as in the paper, which compares a marker's flow with the mean flow of the \
                 frame.",
                tally.literal_none,
                match tally.most_stray {
                    (count, Some(color)) => format!(
                        "It selects up to {count} pixels that belong to no marker in the {color} \
                         layer: objects of that color on the floor."
                    ),
                    _ => "It selects no pixel beside the markers in these images.".to_owned(),
                }
            ),
        })
    }

    fn draw_4(&self, binary: &[Vec<u8>]) -> Result<String> {
        let mut d = Drawing::new(1120.0);
        d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, TITLE);
        let (wide, left, top) = (526.0, 24.0, 88.0);
        let high = wide * self.0[0].image.height as f64 / self.0[0].image.width as f64;
        for (i, shot) in self.0.iter().enumerate() {
            let corner =
                [left + (wide + 20.0) * (i % 2) as f64, top + (high + 40.0) * (i / 2) as f64];
            let name = format!("{:.2} s: camera, outlines, flow × {ARROW:.0}", shot.seconds);
            d.text(corner[0], corner[1] - 14.0, 15.0, colors::INK, Anchor::Start, &name);
            shot.draw_camera(&mut d, corner, [wide, high])?;
        }
        let row = top + 2.0 * (high + 40.0) + 8.0;
        let (wide, high) = (260.0, 260.0 * high / wide);
        for (i, (shot, binary)) in self.0.iter().zip(binary).enumerate() {
            let x = left + 272.0 * i as f64;
            let name = format!("{:.2} s: binary images", shot.seconds);
            d.text(x, row - 12.0, 15.0, colors::INK, Anchor::Start, &name);
            d.image(x, row, wide, high, shot.image.width, binary, false)?;
        }
        let row = row + high + 48.0;
        let [.., shot] = &self.0;
        for (i, color) in MarkerColor::ALL.into_iter().enumerate() {
            shot.draw_signal(&mut d, color, [left + 272.0 * i as f64, row])?;
        }
        Ok(d.finish(row + 256.0 + 24.0, TITLE))
    }
}

impl Shot {
    /// The paper's four binary images, pixels where a color's layer reaches the threshold, in one,
    /// r, g, b; adds a row of the table for each.
    fn binary_image(&self, csv: &mut String, tally: &mut Tally) -> Vec<u8> {
        let w = self.image.width;
        let mut binary = vec![12u8; 3 * w * self.image.height];
        let around = self.surroundings();
        for color in MarkerColor::ALL {
            let m = &self.marks[color];
            let paint =
                [[225, 70, 80], [95, 200, 90], [90, 140, 245], [235, 210, 80]][color.index()];
            let values = || self.rgb.chunks_exact(3).map(|p| layer(color, [p[0], p[1], p[2]]));
            let largest = values().max().unwrap_or(0);
            let literal = values().filter(|v| f64::from(*v) >= SHARE * 255.0).count();
            let (mut on, mut off) = (0, 0);
            for (i, v) in values().enumerate() {
                if v > 0 && f64::from(v) >= SHARE * f64::from(largest) {
                    binary[3 * i..3 * i + 3].copy_from_slice(&paint);
                    let inside = self.on_marker(color, (i % w) as f64, (i / w) as f64);
                    *(if inside { &mut on } else { &mut off }) += 1;
                }
            }
            tally.literal_none += usize::from(literal == 0);
            if off > tally.most_stray.0 {
                tally.most_stray = (off, Some(color));
            }
            let truth = self.true_flow[color].unwrap_or(Vector2::repeat(f64::NAN));
            tally.worst_flow = tally.worst_flow.max((m.flow - truth).norm());
            tally.least_difference = tally.least_difference.min((m.flow - around).norm());
            let [inside, beside] = self.signal_levels(color);
            let _ = writeln!(
                csv,
                concat!(
                    "{},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{},{},{},{},{:.3},{:.3},",
                    "{:.4},{:.3},{:.3}"
                ),
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
                beside,
                self.seconds,
                around.x,
                around.y
            );
        }
        binary
    }

    /// Camera image with outlines and flow.
    fn draw_camera(
        &self,
        d: &mut Drawing,
        [left, top]: [f64; 2],
        [wide, high]: [f64; 2],
    ) -> Result<()> {
        d.image(left, top, wide, high, self.image.width, &self.rgb, false)?;
        let scale = wide / self.image.width as f64;
        let place = |p: Vector2<f64>| [left + (p.x + 0.5) * scale, top + (p.y + 0.5) * scale];
        // Light on a dark rim: seen on any floor, in the light and in the dark.
        let (rim, bright) = (colors::PICTURE_DARK, colors::PICTURE_LIGHT);
        for [at, flow] in &self.field {
            let from = at - flow * ARROW;
            for ink in [Ink(rim, 2.6), Ink(colors::PICTURE_YELLOW, 1.2)] {
                d.arrow(place(from), place(*at), ink);
            }
        }
        for m in &self.marks.0 {
            for ink in [Ink(rim, 4.0), Ink(bright, 1.8)] {
                if let Some(corners) = m.outline {
                    d.outline(&corners.map(place), ink);
                }
                d.arrow(place(m.centroid), place(m.centroid + m.flow * ARROW), ink);
            }
        }
        Ok(())
    }

    /// The tracker's color signal of a marker, 256 px wide.
    fn draw_signal(&self, d: &mut Drawing, color: MarkerColor, [x, row]: [f64; 2]) -> Result<()> {
        let m = &self.marks[color];
        let name = format!("{color}: signal, flow {:+.1} {:+.1} px", m.flow.x, m.flow.y);
        d.text(x, row - 12.0, 15.0, colors::INK, Anchor::Start, &name);
        let Some(seen) = self.seen[color].as_ref().filter(|s| s.width > 0) else { return Ok(()) };
        let rows = seen.signal.len() / seen.width;
        let level = |v: &f32| match v {
            v if v.is_finite() => (40.0 + 190.0 * v.clamp(0.0, 1.1)).min(255.0) as u8,
            _ => 12,
        };
        let gray: Vec<u8> = seen.signal.iter().flat_map(|v| [level(v); 3]).collect();
        let edge = 256.0 / seen.width.max(rows) as f64;
        let (wide, high) = (edge * seen.width as f64, edge * rows as f64);
        d.image(x, row, wide, high, seen.width, &gray, true)?;
        if let Some(corners) = m.outline {
            let origin = seen.origin.map(f64::from);
            let local = corners.map(|c| {
                [x + (c.x - origin[0] + 0.5) * edge, row + (c.y - origin[1] + 0.5) * edge]
            });
            d.outline(&local, Ink(chart_color(color), 2.5));
        }
        Ok(())
    }

    /// Median of the color signal on the marker and at the window's rim.
    fn signal_levels(&self, color: MarkerColor) -> [f64; 2] {
        let (mut on, mut off) = (Vec::new(), Vec::new());
        if let Some(seen) = &self.seen[color] {
            for (i, v) in seen.signal.iter().enumerate().filter(|(_, v)| v.is_finite()) {
                let x = f64::from(seen.origin[0]) + (i % seen.width) as f64;
                let y = f64::from(seen.origin[1]) + (i / seen.width) as f64;
                let values = if self.on_marker(color, x, y) { &mut on } else { &mut off };
                values.push(f64::from(*v));
            }
        }
        [on, off].map(|values| quantile(&values, 0.5))
    }
}
