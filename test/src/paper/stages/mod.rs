//! Fig. 4: binary images and optical flow; Fig. 5: hue histograms. From the tracker's own stages on
//! camera images.

mod binary;
mod hue;

use super::PaperError;
use crate::live::{ImageSequence, Scenario};
use marker_tracker::{MarkerView, OwnedImage, PixelFormat, SignalView, Tracker, TrackerConfig};
use nalgebra::Vector2;
use rig_model::{MarkerColor, PerColor};
use rig_simulator::motion::MotionConfig;
use volant::report::colors;

/// The paper's threshold, as a share of the intensity range.
const SHARE: f64 = 0.75;
/// Images before the one that is shown.
const LEAD: usize = 12;

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
    marks: PerColor<MarkerView>,
    seen: PerColor<Option<SignalView>>,
    /// Displacement of the centroids by the truth, px.
    true_flow: PerColor<Option<Vector2<f64>>>,
}

impl Stages {
    /// Follows a swing for some images and keeps the stages of the last one.
    ///
    /// # Errors
    /// The scenario or an image.
    pub fn of(seed: u64, threads: usize) -> Result<Self, PaperError> {
        // Long enough for the full swing, of which the last images are tracked; over objects in the
        // markers' colors.
        let motion =
            MotionConfig { duration: 2.0, still_until: 0.0, ..MotionConfig::fast_swing(seed) };
        let mut scenario = Scenario { covers: Vec::new(), ..Scenario::new(motion)? };
        scenario.scene.clutter = true;
        let images = ImageSequence::render(&scenario, threads, |_, _| {})
            .map_err(|e| PaperError::Image(e.to_string()))?;
        let mut tracker = Tracker::new(scenario.rig.markers.clone(), TrackerConfig::default());
        tracker.handle(marker_tracker::Input::Camera(scenario.camera.clone()));
        let first = images.frames.len().saturating_sub(LEAD);
        let mut last = None;
        for frame in &images.frames[first..] {
            let image = marker_tracker::decode_compressed("jpeg", &frame.jpeg)
                .map_err(|e| PaperError::Image(e.to_string()))?;
            tracker.handle(marker_tracker::Input::Image(
                image.view(scenario.sensors.epoch.plus_seconds(frame.seconds)),
            ));
            while tracker.poll().is_some() {}
            last = Some((image, frame.seconds));
        }
        let (image, seconds) =
            last.ok_or_else(|| PaperError::Image("there are no images".into()))?;
        let before = images.frames[images.frames.len().saturating_sub(2)].seconds;
        let place = |color: MarkerColor, t: f64| {
            let camera = scenario.motion.world_from_camera(t, &scenario.rig);
            let pose = camera.inverse() * scenario.motion.world_from_volant(t);
            Some(scenario.rig.markers.projected_centroid(color, &scenario.camera, &pose)?.pixel)
        };
        let seen = {
            let view = image.view(scenario.sensors.epoch.plus_seconds(seconds));
            PerColor::from_fn(|c| tracker.signal(c, &view))
        };
        Ok(Self {
            rgb: rgb_of(&image),
            image,
            marks: tracker.views(),
            seen,
            true_flow: PerColor::from_fn(|c| Some(place(c, seconds)? - place(c, before)?)),
        })
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
        assert_eq!(
            std::fs::read_to_string(&made.svg).unwrap().matches("data:image/png").count(),
            6
        );
        let made = stages.figure_5(&folder).unwrap();
        let csv = std::fs::read_to_string(&made.csv).unwrap();
        for column in 1..=5 {
            let sum: f64 = csv
                .lines()
                .skip(1)
                .map(|l| l.split(',').nth(column).unwrap().parse::<f64>().unwrap())
                .sum();
            assert!((sum - 1.0).abs() < 2e-3, "{column}: {sum}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
