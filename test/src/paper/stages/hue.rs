//! Fig. 5: hue histograms of the markers.

use super::{Shot, Stages};
use crate::paper::{Made, PaperError, Value, write};
use marker_tracker::hue;
use rig_model::{MarkerColor, PerColor};
use std::{fmt::Write, path::Path};
use volant::report::{Anchor, Drawing, Ink, Table, colors};

/// Where the default tracker searches.
const WINDOW: &str = "4.5 px across the predicted edges";

impl Stages {
    /// Fig. 5.
    ///
    /// # Errors
    /// The folder is not writable.
    pub fn figure_5(&self, folder: &Path) -> Result<Made, PaperError> {
        let [.., shot] = &self.0;
        let estimated: PerColor<Vec<f32>> =
            PerColor::from_fn(|c| shot.seen[c].as_ref().map(|s| s.hue.clone()).unwrap_or_default());
        let bins = estimated.0.iter().map(Vec::len).max().unwrap_or(0);
        let around = shot.hues_around(bins);
        let mut csv = String::from("hue_deg,red,green,blue,yellow,rest_of_the_image\n");
        for (bin, rest) in around.iter().enumerate() {
            let _ = write!(csv, "{:.3}", (bin as f64 + 0.5) * 360.0 / bins as f64);
            for h in &estimated.0 {
                let _ = write!(csv, ",{:.5}", h.get(bin).copied().unwrap_or(f32::NAN));
            }
            let _ = writeln!(csv, ",{rest:.5}");
        }
        let path = write(folder, "fig-5.csv", &csv)?;
        let svg = write(folder, "fig-5.svg", &draw_5(&estimated, &around))?;
        let mut table = Table {
            head: ["marker", "peak [deg]", "share within 30 deg of it", "rest of the image there"]
                .map(String::from)
                .to_vec(),
            rows: Vec::new(),
        };
        for (color, h) in estimated.iter().filter(|(_, h)| !h.is_empty()) {
            let peak = (0..bins).max_by(|a, b| h[*a].total_cmp(&h[*b])).unwrap_or(0);
            let near = |values: &[f32]| -> f32 {
                let reach = bins / 12;
                (0..=2 * reach).map(|k| values[(peak + bins + k - reach) % bins]).sum()
            };
            let cell = |text: String| (text, false);
            table.rows.push(vec![
                cell(color.to_string()),
                cell(format!("{:.0}", (peak as f64 + 0.5) * 360.0 / bins as f64)),
                cell(format!("{:.0} %", 100.0 * near(h))),
                cell(format!("{:.0} %", 100.0 * near(&around))),
            ]);
        }
        Ok(Made {
            name: "fig-5",
            title: "Fig. 5: hue histograms of the markers",
            csv: path,
            svg,
            table: Some(table),
            values: vec![
                Value::new("search window around the previous center", "at least 25 px", WINDOW),
                Value::new("bins of a histogram", "–", bins.to_string()),
            ],
            shows:
                "The hue histograms that the tracker has estimated from the insides of the four \
                    squares in that image, in bars of their own hue, beside the hues of the rest \
                    of the image (line). Each pixel counts by its saturation: a gray pixel's hue \
                    is noise. The four are separated, but a floor of wood or carpet can share \
                    one's hue: color alone does not distinguish a marker from its surroundings."
                    .to_owned(),
            published:
                "The published histograms are an image without numbers. The paper searches each \
                        marker's histogram in a window around its previous center, widened by the \
                        flow; the default tracker checks the histogram inside of each square that \
                        it has measured, which needs no window. An object of another hue in a \
                        marker's place is rejected, and geometry decides between objects of one hue."
                    .to_owned(),
        })
    }
}

impl Shot {
    /// Hues of all pixels that lie on no marker, weighted by saturation, sum 1.
    fn hues_around(&self, bins: usize) -> Vec<f32> {
        let mut sums = vec![0f32; bins];
        for (i, p) in self.rgb.chunks_exact(3).enumerate() {
            let (x, y) = ((i % self.image.width) as f64, (i / self.image.width) as f64);
            let Some((hue, saturation)) = hue([p[0], p[1], p[2]]) else { continue };
            if MarkerColor::ALL.iter().any(|c| self.on_marker(*c, x, y)) {
                continue;
            }
            let bin = ((hue / 360.0 * bins as f32) as usize).min(bins.saturating_sub(1));
            if let Some(sum) = sums.get_mut(bin) {
                *sum += saturation;
            }
        }
        let total: f32 = sums.iter().sum();
        if total > 0.0 {
            sums.iter_mut().for_each(|s| *s /= total);
        }
        sums
    }
}

fn draw_5(estimated: &PerColor<Vec<f32>>, around: &[f32]) -> String {
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colors::INK, Anchor::Start, "Fig. 5: hue histograms of the markers");
    d.line([28.0, 58.0], [52.0, 58.0], Ink(colors::INK, 2.0));
    d.text(60.0, 63.0, 15.0, colors::INK, Anchor::Start, "rest of the image");
    d.bar_of(236.0, 50.0, 24.0, 14.0, "hsl(0 60% 55%)");
    d.text(
        268.0,
        63.0,
        15.0,
        colors::INK,
        Anchor::Start,
        "the marker, as estimated (in bars of that hue)",
    );
    let (wide, high) = (450.0, 170.0);
    let most = estimated.0.iter().flatten().chain(around).copied().fold(0.1f32, f32::max);
    let top_value = f64::from((most * 10.0).ceil() / 10.0);
    for (i, (color, h)) in estimated.iter().enumerate() {
        let (x0, y0) = (84.0 + 552.0 * (i % 2) as f64, 104.0 + 250.0 * (i / 2) as f64);
        let base = y0 + high;
        d.text(x0, y0 - 10.0, 16.0, colors::INK, Anchor::Start, color.name());
        for k in 0..=2 {
            let (value, y) = (top_value * f64::from(k) / 2.0, base - high * f64::from(k) / 2.0);
            d.line(
                [x0, y],
                [x0 + wide, y],
                Ink(if k == 0 { colors::AXIS } else { colors::GRID }, 1.0),
            );
            d.text(x0 - 8.0, y + 4.5, 13.0, colors::SOFT, Anchor::End, &format!("{value:.2}"));
        }
        for degrees in (0..=360).step_by(60) {
            let x = x0 + wide * f64::from(degrees) / 360.0;
            d.line([x, base], [x, base + 5.0], Ink(colors::AXIS, 1.0));
            d.text(x, base + 20.0, 13.0, colors::SOFT, Anchor::Middle, &degrees.to_string());
        }
        d.text(x0 + wide / 2.0, base + 40.0, 14.0, colors::INK, Anchor::Middle, "hue [deg]");
        let bin = wide / h.len().max(1) as f64;
        let height = |v: f32| high * f64::from(v) / top_value;
        for (k, v) in h.iter().enumerate() {
            let degrees = (k as f64 + 0.5) * 360.0 / h.len() as f64;
            let css = format!("hsl({degrees:.0} 60% 52%)");
            d.bar_of(x0 + bin * k as f64 + 0.5, base - height(*v), bin - 1.0, height(*v), &css);
        }
        for k in 1..around.len() {
            let at = |k: usize| [x0 + bin * (k as f64 + 0.5), base - height(around[k])];
            d.line(at(k - 1), at(k), Ink(colors::INK, 2.0));
        }
    }
    d.finish(590.0, "Fig. 5: hue histograms of the markers")
}
