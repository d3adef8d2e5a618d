//! Durations of the stages and counts of images, for the diagnostics.

use crate::image::ImageView;
use std::time::{Duration, Instant};

/// Sums since the last report.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    pub rejected: u32,
    /// Number of images that were copies of their predecessor.
    pub repeated: u32,
    /// Of every image.
    pub convert: Span,
    pub track: Span,
    pub draw: Span,
    /// Number of accepted images with 0 to 4 detected markers.
    pub detected: [u32; 5],
    /// Σ of the mean values of the images without a marker.
    brightness: f64,
    /// Size of the newest image, px.
    pub size: (usize, usize),
}

/// Duration of one stage, image by image.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Span {
    sum: Duration,
    longest: Duration,
    pub count: u32,
}

impl Span {
    /// Adds the time since the stage's start.
    pub fn end(&mut self, start: Instant) {
        let time = start.elapsed();
        self.sum += time;
        self.longest = self.longest.max(time);
        self.count += 1;
    }

    fn text(&self) -> String {
        let mean = self.sum.as_secs_f64() * 1e3 / f64::from(self.count.max(1));
        format!("{mean:.3} (max {:.3})", self.longest.as_secs_f64() * 1e3)
    }
}

/// Mean value of an image (0–255), from eight of its rows.
fn brightness(image: &ImageView<'_>) -> f64 {
    const ROWS: usize = 8;
    let row = image.width * image.format.bytes_per_pixel();
    let bytes = (0..ROWS).flat_map(|i| {
        let start = (2 * i + 1) * image.height / (2 * ROWS) * image.step;
        image.data.get(start..start + row).unwrap_or(&[])
    });
    let (sum, count) =
        bytes.fold((0_u64, 0_u64), |(sum, count), byte| (sum + u64::from(*byte), count + 1));
    sum as f64 / count.max(1) as f64
}

impl Stages {
    /// Start of a stage.
    // Measures the duration of the work; no data is stamped with it.
    #[allow(clippy::disallowed_methods)]
    pub fn start(&self) -> Instant {
        Instant::now()
    }

    /// Records the brightness of an image without a marker.
    pub fn add_brightness(&mut self, image: &ImageView<'_>) {
        self.brightness += brightness(image);
    }

    /// Mean of the values of the images without a marker, 0 to 255.
    pub fn mean_brightness(&self) -> f64 {
        self.brightness / f64::from(self.detected[0].max(1))
    }

    /// Number of images in which the markers were searched.
    pub fn accepted(&self) -> u32 {
        self.detected.iter().sum()
    }

    /// Counts and durations for the diagnostics.
    pub fn values(&self) -> Vec<(&'static str, String)> {
        let [none, one, two, three, four] = self.detected;
        vec![
            ("images", self.convert.count.to_string()),
            ("rejected", self.rejected.to_string()),
            ("repeated", self.repeated.to_string()),
            ("all four detected", four.to_string()),
            ("three detected", three.to_string()),
            ("fewer detected", (none + one + two).to_string()),
            ("decoding, ms", self.convert.text()),
            ("tracking, ms", self.track.text()),
            ("drawing, ms", self.draw.text()),
        ]
    }
}
