//! Fig. 4: binary images and optical flow; Fig. 5: hue histograms. From the tracker's own stages on
//! camera images.

mod binary;
mod flow_field;
mod hue;

use crate::live::{ImageSequence, Scenario, quantile};
use anyhow::{Context, Result, anyhow};
use marker_tracker::{MarkerView, OwnedImage, SignalView, Tracker, TrackerConfig};
use nalgebra::Vector2;
use rig_model::{MarkerColor, PerColor, Stamp};
use rig_simulator::motion::MotionConfig;
use volant::report::colors;

/// The paper's threshold, as a share of the intensity range.
const SHARE: f64 = 0.75;
/// Images that the tracker follows before and between those that are shown.
const LEAD: usize = 4;
const STEP: usize = 3;
/// Images that are shown.
const SHOWN: usize = 4;

/// Colors of the markers in charts.
pub(super) fn chart_color(color: MarkerColor) -> volant::report::Color {
    match color {
        MarkerColor::Red => colors::FUSED,
        MarkerColor::Green => colors::GREEN,
        MarkerColor::Blue => colors::BLUE,
        MarkerColor::Yellow => colors::YELLOW,
    }
}

/// Pixels as r, g, b, without padding.
pub(super) fn rgb_of(image: &OwnedImage) -> Vec<u8> {
    image.view(Stamp::from_nanos(0)).to_rgb()
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
struct Shot {
    /// Time since the start of the swing, s.
    seconds: f64,
    image: OwnedImage,
    rgb: Vec<u8>,
    marks: PerColor<MarkerView>,
    seen: PerColor<Option<SignalView>>,
    /// Displacement of the centroids by the truth since the image before, px.
    true_flow: PerColor<Option<Vector2<f64>>>,
    /// Flow of the surroundings since the image before: place and displacement, px.
    field: Vec<[Vector2<f64>; 2]>,
}

/// Four instants of a swing, a tenth of a second apart.
pub struct Stages([Shot; SHOWN]);

impl Stages {
    /// Follows a swing for some images and keeps the stages of the last ones.
    pub fn of(seed: u64, threads: usize) -> Result<Self> {
        // Long enough for the full swing, of which the last images are tracked; over objects in the
        // markers' colors.
        let motion =
            MotionConfig { duration: 2.0, still_until: 0.0, ..MotionConfig::fast_swing(seed) };
        let mut scenario = Scenario { covers: Vec::new(), ..Scenario::new(motion)? };
        scenario.scene.clutter = true;
        let images = ImageSequence::render(&scenario, threads, |_, _| {}).context("an image")?;
        let mut tracker = Tracker::new(scenario.rig.markers.clone(), TrackerConfig::default());
        tracker.handle(marker_tracker::Input::Camera(scenario.camera.clone()));
        let place = |color: MarkerColor, t: f64| scenario.true_centroid(color, t);
        let first = images.frames.len().saturating_sub(LEAD + STEP * SHOWN);
        let mut shots = Vec::with_capacity(SHOWN);
        let mut before: Option<(OwnedImage, f64)> = None;
        for (i, frame) in images.frames[first..].iter().enumerate() {
            let image =
                marker_tracker::decode_compressed("jpeg", &frame.jpeg).context("an image")?;
            let stamp = scenario.sensors.epoch.plus_seconds(frame.seconds);
            tracker.handle(marker_tracker::Input::Image(image.view(stamp)));
            while tracker.poll().is_some() {}
            if let Some((earlier, seconds)) = &before
                && i >= LEAD
                && (i - LEAD) % STEP == STEP - 1
            {
                let marks = tracker.views();
                let seen = PerColor::from_fn(|c| tracker.signal(c, &image.view(stamp)));
                let mut shot = Shot {
                    seconds: frame.seconds,
                    rgb: rgb_of(&image),
                    image: image.clone(),
                    marks,
                    seen,
                    true_flow: PerColor::from_fn(|c| {
                        Some(place(c, frame.seconds)? - place(c, *seconds)?)
                    }),
                    field: Vec::new(),
                };
                let field = flow_field::between(earlier, &image)?;
                let on_marker = |p: &Vector2<f64>| {
                    MarkerColor::ALL.iter().any(|c| shot.on_marker(*c, p.x, p.y))
                };
                shot.field = field.into_iter().filter(|[p, _]| !on_marker(p)).collect();
                shots.push(shot);
            }
            before = Some((image, frame.seconds));
        }
        shots.try_into().map(Self).map_err(|_| anyhow!("the swing has too few images"))
    }
}

impl Shot {
    /// Median flow of the surroundings, px.
    fn surroundings(&self) -> Vector2<f64> {
        let median = |axis: usize| {
            let values: Vec<f64> = self.field.iter().map(|[_, flow]| flow[axis]).collect();
            quantile(&values, 0.5)
        };
        Vector2::new(median(0), median(1))
    }

    /// True inside of the square that was measured, grown by a pixel and a half for its blurred
    /// edge.
    fn on_marker(&self, color: MarkerColor, x: f64, y: f64) -> bool {
        let Some(corners) = self.marks[color].outline else { return false };
        let center = corners.iter().sum::<Vector2<f64>>() / 4.0;
        let mut sides = 0;
        for i in 0..4 {
            let (p, q) = (corners[i], corners[(i + 1) % 4]);
            let edge = q - p;
            let normal = Vector2::new(edge.y, -edge.x).normalize();
            let outward = if normal.dot(&(p - center)) > 0.0 { normal } else { -normal };
            sides += usize::from(outward.dot(&(Vector2::new(x, y) - p)) < 1.5);
        }
        sides == 4
    }
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
        assert_eq!(
            layer(MarkerColor::Yellow, [90, 200, 60]),
            30,
            "R − B where G is the larger: no yellow"
        );
    }

    #[test]
    fn the_figures_show_the_tracker_s_images() {
        let stages = Stages::of(3, 2).unwrap();
        let made = stages.figure_4().unwrap();
        assert_eq!(made.csv.lines().count(), 17, "four markers in four images");
        for line in made.csv.lines().skip(1) {
            let v: Vec<f64> = line.split(',').skip(1).map(|c| c.parse().unwrap()).collect();
            assert!((v[2] - v[4]).hypot(v[3] - v[5]) < 0.3, "flow: {line}");
            assert!(v[8] > 50.0 && v[10] > 0.8 && v[11] < 0.4, "{line}");
            // The markers move against their surroundings in a swing.
            assert!((v[2] - v[13]).hypot(v[3] - v[14]) > 1.0, "{line}");
        }
        assert_eq!(made.svg.matches("data:image/png").count(), 12);
        let csv = stages.figure_5().unwrap().csv;
        for column in 1..=5 {
            let sum: f64 = csv
                .lines()
                .skip(1)
                .map(|l| l.split(',').nth(column).unwrap().parse::<f64>().unwrap())
                .sum();
            assert!((sum - 1.0).abs() < 2e-3, "{column}: {sum}");
        }
    }
}
