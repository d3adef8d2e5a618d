//! Fig. 5: hue histograms of the markers.

use super::{Shot, Stages, chart_color};
use crate::paper::{Made, Value};
use anyhow::Result;
use marker_tracker::hue;
use rig_model::{MarkerColor, PerColor};
use std::fmt::Write;
use volant::report::{Axis, Panel, Series, Shape, Sheet, Table, colors, panels};

const TITLE: &str = "Fig. 5: hue histograms of the markers";
/// Where the default tracker searches.
const WINDOW: &str = "4.5 px across the predicted edges";

impl Stages {
    pub fn figure_5(&self) -> Result<Made> {
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
        let rows = estimated.iter().filter(|(_, h)| !h.is_empty()).map(|(color, h)| {
            let peak = (0..bins).max_by(|a, b| h[*a].total_cmp(&h[*b])).unwrap_or(0);
            let near = |values: &[f32]| -> f32 {
                let reach = bins / 12;
                (0..=2 * reach).map(|k| values[(peak + bins + k - reach) % bins]).sum()
            };
            [
                color.to_string(),
                format!("{:.0}", (peak as f64 + 0.5) * 360.0 / bins as f64),
                format!("{:.0} %", 100.0 * near(h)),
                format!("{:.0} %", 100.0 * near(&around)),
            ]
        });
        let head = "marker | peak [deg] | share within 30 deg of it | rest of the image there";
        Ok(Made {
            name: "fig-5",
            title: TITLE,
            csv,
            svg: draw_5(&estimated, &around)?,
            table: Some(Table::new(head, rows)),
            values: vec![
                Value::new("search window around the previous center", "at least 25 px", WINDOW),
                Value::new("bins of a histogram", "–", bins.to_string()),
            ],
            shows:
                "The hue histograms that the tracker has estimated from the insides of the four \
                    squares in that image, beside the hues of the rest of the image (thin line). \
                    Each pixel counts by its saturation: a gray pixel's hue is noise. The four are \
                    separated, but a floor of wood or carpet can share one's hue: color alone does \
                    not distinguish a marker from its surroundings."
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

fn draw_5(estimated: &PerColor<Vec<f32>>, around: &[f32]) -> Result<String> {
    let most = estimated.0.iter().flatten().chain(around).copied().fold(0.1f32, f32::max);
    let line = |name: &str, color, width, h: &[f32]| {
        let hue = |k: usize| (k as f64 + 0.5) * 360.0 / h.len() as f64;
        let points = h.iter().enumerate().map(|(k, v)| (hue(k), f64::from(*v)));
        Series::new(name, color, Shape::Line(width), points)
    };
    let drawn: Vec<Panel> = estimated
        .iter()
        .map(|(color, h)| Panel {
            title: String::new(),
            x: Axis::new("hue [deg]", [0.0, 360.0], false),
            y: Axis::new("share", [0.0, f64::from((most * 10.0).ceil() / 10.0)], false),
            series: vec![
                line(color.name(), chart_color(color), 4, h),
                line("rest of the image", colors::INK, 1, around),
            ],
        })
        .collect();
    Ok(panels(Sheet { title: TITLE, size: (1120, 640), grid: (2, 2) }, &drawn)?)
}
