//! Fig. 4: binary images and optical flow; Fig. 5: hue histograms. From the tracker's own stages on camera pictures.

use super::{Made, PaperError, write};
use crate::{
    live::{Film, Scenario},
    rig::motion::MotionConfig,
};
use launch_config::report::{Anchor, Drawing, Ink, Table, colours};
use marker_tracker::{Mark, OwnedImage, PixelFormat, Seen, Tracker, TrackerConfig};
use nalgebra::Vector2;
use rig_model::{MarkerColor, PerColor};
use std::{fmt::Write, path::Path};

/// The paper's threshold, as a share of the intensity range.
const SHARE: f64 = 0.75;
/// Pictures before the one that is shown.
const LEAD: usize = 12;

/// The colours of the markers in charts.
pub(super) fn chart_colour(color: MarkerColor) -> launch_config::report::Colour {
    match color {
        MarkerColor::Red => colours::FUSED,
        MarkerColor::Green => colours::GREEN,
        MarkerColor::Blue => colours::BLUE,
        MarkerColor::Yellow => colours::YELLOW,
    }
}

/// Pixels as r, g, b, without padding.
pub(super) fn rgb_of(image: &OwnedImage) -> Vec<u8> {
    let n = image.format.bytes_per_pixel();
    let mut rgb = Vec::with_capacity(3 * image.width * image.height);
    let blue_first = matches!(image.format, PixelFormat::Bgr8 | PixelFormat::Bgra8);
    for row in image.data.chunks(image.step).take(image.height) {
        for p in row.chunks_exact(n).take(image.width) {
            rgb.extend(if blue_first { [p[2], p[1], p[0]] } else { [p[0], p[1], p[2]] });
        }
    }
    rgb
}

/// The paper's layers (II-B): red R − G, green G − R, blue B − R, yellow R − red − B.
pub fn layer(color: MarkerColor, [r, g, b]: [u8; 3]) -> u8 {
    match color {
        MarkerColor::Red => r.saturating_sub(g),
        MarkerColor::Green => g.saturating_sub(r),
        MarkerColor::Blue => b.saturating_sub(r),
        MarkerColor::Yellow => r.saturating_sub(r.saturating_sub(g)).saturating_sub(b),
    }
}

/// What the tracker saw at one instant of a swing.
pub struct Stages {
    image: OwnedImage,
    rgb: Vec<u8>,
    marks: PerColor<Mark>,
    seen: PerColor<Option<Seen>>,
    /// Displacement of the centroids by the truth, px.
    true_flow: PerColor<Option<Vector2<f64>>>,
}

impl Stages {
    /// Follows a swing for some pictures and keeps the stages of the last one.
    ///
    /// # Errors
    /// The scenario or a picture.
    pub fn of(seed: u64, threads: usize) -> Result<Self, PaperError> {
        // Long enough to be in full swing, of which the last pictures are followed; over things of the markers' colours.
        let motion = MotionConfig { duration: 2.0, still_until: 0.0, ..MotionConfig::fast_swing(seed) };
        let mut scenario = Scenario { covers: Vec::new(), ..Scenario::new(motion)? };
        scenario.scene.clutter = true;
        let film =
            Film::shoot(&scenario, threads, |_, _| {}).map_err(|e| PaperError::Picture(e.to_string()))?;
        let mut tracker = Tracker::new(scenario.rig.markers.clone(), TrackerConfig::default());
        tracker.handle(marker_tracker::Input::Camera(scenario.camera.clone()));
        let first = film.frames.len().saturating_sub(LEAD);
        let mut last = None;
        for frame in &film.frames[first..] {
            let image = marker_tracker::decode_compressed("jpeg", &frame.jpeg)
                .map_err(|e| PaperError::Picture(e.to_string()))?;
            tracker.handle(marker_tracker::Input::Image(
                image.view(scenario.sensors.epoch.plus_seconds(frame.seconds)),
            ));
            while tracker.poll().is_some() {}
            last = Some((image, frame.seconds));
        }
        let (image, seconds) = last.ok_or_else(|| PaperError::Picture("the film is empty".into()))?;
        let before = film.frames[film.frames.len().saturating_sub(2)].seconds;
        let place = |color: MarkerColor, t: f64| {
            let camera = scenario.motion.world_from_camera(t, &scenario.rig);
            let pose = camera.inverse() * scenario.motion.world_from_volant(t);
            Some(scenario.rig.markers.projected_centroid(color, &scenario.camera, &pose)?.pixel)
        };
        let seen = {
            let view = image.view(scenario.sensors.epoch.plus_seconds(seconds));
            PerColor::from_fn(|c| tracker.seen(c, &view))
        };
        Ok(Self {
            rgb: rgb_of(&image),
            image,
            marks: tracker.marks(),
            seen,
            true_flow: PerColor::from_fn(|c| Some(place(c, seconds)? - place(c, before)?)),
        })
    }

    /// True inside of the square that was measured, grown by a pixel and a half for its blurred edge.
    fn on_marker(&self, color: MarkerColor, x: f64, y: f64) -> bool {
        let Some(corners) = self.marks[color].outline else { return false };
        let centre = corners.iter().sum::<Vector2<f64>>() / 4.0;
        let mut sides = 0;
        for i in 0..4 {
            let (p, q) = (corners[i], corners[(i + 1) % 4]);
            let edge = q - p;
            let normal = Vector2::new(edge.y, -edge.x).normalize();
            let outward = if normal.dot(&(p - centre)) > 0.0 { normal } else { -normal };
            sides += usize::from(outward.dot(&(Vector2::new(x, y) - p)) < 1.5);
        }
        sides == 4
    }

    /// The paper's binary image of a colour: where its layer reaches the threshold.
    fn binary(&self, color: MarkerColor) -> Vec<bool> {
        let values: Vec<u8> = self.rgb.chunks_exact(3).map(|p| layer(color, [p[0], p[1], p[2]])).collect();
        let limit = SHARE * f64::from(values.iter().copied().max().unwrap_or(0));
        values.iter().map(|v| *v > 0 && f64::from(*v) >= limit).collect()
    }

    /// Fig. 4.
    ///
    /// # Errors
    /// A drawing, or a place that cannot be written to.
    pub fn figure_4(&self, folder: &Path) -> Result<Made, PaperError> {
        let (w, h) = (self.image.width, self.image.height);
        let mut csv = String::from(
            "marker,x_px,y_px,flow_x_px,flow_y_px,true_flow_x_px,true_flow_y_px,largest_layer_value,pixels_over_literal_0.75,\
             binary_pixels_on_marker,binary_pixels_elsewhere,signal_on_marker,signal_beside\n",
        );
        let mut binary = vec![12u8; 3 * w * h];
        let (mut worst_flow, mut most_stray, mut literal_none) = (0.0f64, (0, MarkerColor::Red), 0);
        for color in MarkerColor::ALL {
            let m = &self.marks[color];
            let paint = [[225, 70, 80], [95, 200, 90], [90, 140, 245], [235, 210, 80]][color.index()];
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
                "{color},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{largest},{literal},{on},{off},{inside:.3},{beside:.3}",
                m.centroid.x, m.centroid.y, m.flow.x, m.flow.y, truth.x, truth.y
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
                "One picture of a swing. Top left what the camera sent, with the outlines that the tracker measured and each \
                 marker's flow since the picture before, drawn five times as long; top right the paper's four binary images \
                 in one, each layer cut at 0.75 of its own largest value. Below, the tracker's own colour signal around each \
                 marker: 1 on the marker, 0 beside it, not yet rounded. The flow is told from its edges. It is within \
                 {worst_flow:.2} px of the true motion of the centroids."
            ),
            published: format!(
                "The paper makes each layer binary at 0.75 of the normalised intensity range. On paper as muted as here the \
                 literal threshold leaves nothing in {literal_none} of 4 layers, so 0.75 of the layer's largest value stands \
                 in for it. {} The tracker learns the direction in RGB in which each marker differs most from what is around \
                 it, and keeps the signal linear, because a rounded one ties the centre of mass to the pixels' grid.",
                if most_stray.0 == 0 {
                    "It catches no pixel beside the markers in this picture.".to_owned()
                } else {
                    format!(
                        "It catches {} pixels that belong to no marker in the {} layer: things of that colour on the floor.",
                        most_stray.0, most_stray.1
                    )
                }
            ),
        })
    }

    /// Median of the colour signal on the marker and at the window's rim.
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
        d.text(24.0, 34.0, 20.0, colours::INK, Anchor::Start, "Fig. 4: binary images and optical flow");
        let (wide, left, right, top) = (526.0, 24.0, 570.0, 88.0);
        let high = wide * h / w;
        d.text(left, top - 14.0, 15.0, colours::INK, Anchor::Start, "camera, outlines, flow × 5");
        d.text(
            right,
            top - 14.0,
            15.0,
            colours::INK,
            Anchor::Start,
            "the paper's binary images, at 0.75 of the largest value",
        );
        d.picture(left, top, wide, high, self.image.width, &self.rgb, false)?;
        d.picture(right, top, wide, high, self.image.width, binary, false)?;
        let scale = wide / w;
        let place = |x: f64, y: f64| [left + (x + 0.5) * scale, top + (y + 0.5) * scale];
        // White on a dark rim: seen on any floor, in the light and in the dark.
        let (rim, bright) = (Ink(colours::PICTURE_DARK, 4.0), Ink(colours::PICTURE_LIGHT, 1.8));
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
                colours::INK,
                Anchor::Start,
                &format!("{color}: signal, flow {:+.1} {:+.1} px", m.flow.x, m.flow.y),
            );
            let Some(seen) = self.seen[color].as_ref().filter(|s| s.width > 0) else { continue };
            let rows = seen.signal.len() / seen.width;
            let gray: Vec<u8> = seen
                .signal
                .iter()
                .flat_map(|v| {
                    let level =
                        if v.is_finite() { (40.0 + 190.0 * v.clamp(0.0, 1.1)).min(255.0) as u8 } else { 12 };
                    [level; 3]
                })
                .collect();
            let edge = 256.0 / seen.width.max(rows) as f64;
            let (pw, ph) = (edge * seen.width as f64, edge * rows as f64);
            d.picture(x, row, pw, ph, seen.width, &gray, true)?;
            if let Some(corners) = m.outline {
                let local = corners.map(|c| {
                    [
                        x + (c.x - f64::from(seen.origin[0]) + 0.5) * edge,
                        row + (c.y - f64::from(seen.origin[1]) + 0.5) * edge,
                    ]
                });
                d.outline(&local, Ink(chart_colour(color), 2.5));
            }
        }
        Ok(d.finish(row + 256.0 + 24.0, "Fig. 4: binary images and optical flow"))
    }

    /// Fig. 5.
    ///
    /// # Errors
    /// A place that cannot be written to.
    pub fn figure_5(&self, folder: &Path) -> Result<Made, PaperError> {
        let learnt: PerColor<Vec<f32>> =
            PerColor::from_fn(|c| self.seen[c].as_ref().map(|s| s.hue.clone()).unwrap_or_default());
        let bins = learnt.0.iter().map(Vec::len).max().unwrap_or(0);
        let around = self.hues_around(bins);
        let mut csv = String::from("hue_deg,red,green,blue,yellow,rest_of_the_picture\n");
        for (bin, rest) in around.iter().enumerate() {
            let _ = write!(csv, "{:.3}", (bin as f64 + 0.5) * 360.0 / bins as f64);
            for h in &learnt.0 {
                let _ = write!(csv, ",{:.5}", h.get(bin).copied().unwrap_or(f32::NAN));
            }
            let _ = writeln!(csv, ",{rest:.5}");
        }
        let path = folder.join("fig-5.csv");
        write(&path, &csv)?;
        let svg = folder.join("fig-5.svg");
        write(&svg, &draw_5(&learnt, &around))?;
        let mut table = Table {
            head: ["marker", "peak [deg]", "share within 30 deg of it", "rest of the picture there"]
                .map(String::from)
                .to_vec(),
            rows: Vec::new(),
        };
        for (color, h) in learnt.iter().filter(|(_, h)| !h.is_empty()) {
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
            shows: "The hue histograms that the tracker has learnt from the insides of the four squares in that picture, in bars of \
                    their own hue, beside the hues of the rest of the picture (line). Each pixel counts by its saturation: a grey \
                    pixel's hue is noise. The four stand apart from each other, but a floor of wood or carpet can share one's \
                    hue: colour alone does not tell a marker from its surroundings."
                .to_owned(),
            published: "The paper seeks each marker's histogram in a window around its previous centre, as here; its own \
                        histograms are in a picture of which no numbers are at hand to compare with. Here a thing of another \
                        hue in a marker's place is refused, and what decides between things of one hue is geometry."
                .to_owned(),
        })
    }

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

/// Hue, degrees, and saturation; `None` for grey.
fn hue([r, g, b]: [u8; 3]) -> Option<(f32, f32)> {
    let [r, g, b] = [r, g, b].map(f32::from);
    let max = r.max(g).max(b);
    let delta = max - r.min(g).min(b);
    if delta < 1.0 {
        return None;
    }
    let sextant = if max == r {
        (g - b) / delta
    } else if max == g {
        2.0 + (b - r) / delta
    } else {
        4.0 + (r - g) / delta
    };
    Some(((sextant * 60.0).rem_euclid(360.0), delta / max))
}

fn draw_5(learnt: &PerColor<Vec<f32>>, around: &[f32]) -> String {
    let mut d = Drawing::new(1120.0);
    d.text(24.0, 34.0, 20.0, colours::INK, Anchor::Start, "Fig. 5: hue histograms of the markers");
    d.line([28.0, 58.0], [52.0, 58.0], Ink(colours::INK, 2.0));
    d.text(60.0, 63.0, 15.0, colours::INK, Anchor::Start, "rest of the picture");
    d.bar_of(236.0, 50.0, 24.0, 14.0, "hsl(0 60% 55%)");
    d.text(268.0, 63.0, 15.0, colours::INK, Anchor::Start, "the marker, as learnt (in bars of that hue)");
    let (wide, high) = (450.0, 170.0);
    let most = learnt.0.iter().flatten().chain(around).copied().fold(0.1f32, f32::max);
    let top_value = f64::from((most * 10.0).ceil() / 10.0);
    for (i, (color, h)) in learnt.iter().enumerate() {
        let (x0, y0) = (84.0 + 552.0 * (i % 2) as f64, 104.0 + 250.0 * (i / 2) as f64);
        let base = y0 + high;
        d.text(x0, y0 - 10.0, 16.0, colours::INK, Anchor::Start, color.name());
        for k in 0..=2 {
            let (value, y) = (top_value * f64::from(k) / 2.0, base - high * f64::from(k) / 2.0);
            d.line([x0, y], [x0 + wide, y], Ink(if k == 0 { colours::AXIS } else { colours::GRID }, 1.0));
            d.text(x0 - 8.0, y + 4.5, 13.0, colours::SOFT, Anchor::End, &format!("{value:.2}"));
        }
        for degrees in (0..=360).step_by(60) {
            let x = x0 + wide * f64::from(degrees) / 360.0;
            d.line([x, base], [x, base + 5.0], Ink(colours::AXIS, 1.0));
            d.text(x, base + 20.0, 13.0, colours::SOFT, Anchor::Middle, &degrees.to_string());
        }
        d.text(x0 + wide / 2.0, base + 40.0, 14.0, colours::INK, Anchor::Middle, "hue [deg]");
        let bin = wide / h.len().max(1) as f64;
        let height = |v: f32| high * f64::from(v) / top_value;
        for (k, v) in h.iter().enumerate() {
            let degrees = (k as f64 + 0.5) * 360.0 / h.len() as f64;
            let css = format!("hsl({degrees:.0} 60% 52%)");
            d.bar_of(x0 + bin * k as f64 + 0.5, base - height(*v), bin - 1.0, height(*v), &css);
        }
        for k in 1..around.len() {
            let at = |k: usize| [x0 + bin * (k as f64 + 0.5), base - height(around[k])];
            d.line(at(k - 1), at(k), Ink(colours::INK, 2.0));
        }
    }
    d.finish(590.0, "Fig. 5: hue histograms of the markers")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_layers_are_the_paper_s() {
        assert_eq!(layer(MarkerColor::Red, [200, 40, 50]), 160);
        assert_eq!(layer(MarkerColor::Green, [40, 200, 50]), 160);
        assert_eq!(layer(MarkerColor::Blue, [40, 50, 200]), 160);
        assert_eq!(layer(MarkerColor::Yellow, [220, 200, 60]), 140, "G − B where R is the larger");
        assert_eq!(layer(MarkerColor::Yellow, [90, 200, 60]), 30, "R − B where G is the larger: no yellow");
    }

    #[test]
    fn the_pictures_show_what_the_tracker_saw() {
        let folder = std::env::temp_dir().join(format!("volant-stages-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let stages = Stages::of(3, 2).unwrap();
        let made = stages.figure_4(&folder).unwrap();
        let csv = std::fs::read_to_string(&made.csv).unwrap();
        for line in csv.lines().skip(1) {
            let v: Vec<f64> = line.split(',').skip(1).map(|c| c.parse().unwrap()).collect();
            assert!((v[2] - v[4]).hypot(v[3] - v[5]) < 0.3, "flow: {line}");
            assert!(v[8] > 50.0 && v[10] > 0.8 && v[11] < 0.4, "{line}");
        }
        assert_eq!(std::fs::read_to_string(&made.svg).unwrap().matches("data:image/png").count(), 6);
        let made = stages.figure_5(&folder).unwrap();
        let csv = std::fs::read_to_string(&made.csv).unwrap();
        for column in 1..=5 {
            let sum: f64 =
                csv.lines().skip(1).map(|l| l.split(',').nth(column).unwrap().parse::<f64>().unwrap()).sum();
            assert!((sum - 1.0).abs() < 2e-3, "{column}: {sum}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
