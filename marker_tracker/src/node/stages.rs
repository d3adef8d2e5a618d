//! Durations of the stages and counts of images, for the diagnostics.

use crate::image::ImageView;
use std::{
    fmt::Display,
    time::{Duration, Instant},
};

/// Sums since the last report.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    pub rejected: u32,
    /// Why the last image was rejected.
    reason: String,
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

/// Mean value of an image's colors (0–255), from eight of its rows.
fn brightness(image: &ImageView<'_>) -> f64 {
    const ROWS: usize = 8;
    let bytes = image.format.bytes_per_pixel();
    let pixels = (0..ROWS).flat_map(|i| {
        let start = (2 * i + 1) * image.height / (2 * ROWS) * image.step;
        let row = image.data.get(start..start + image.width * bytes).unwrap_or(&[]);
        row.chunks_exact(bytes)
    });
    let (sum, count) = pixels.fold((0_u64, 0_u64), |(sum, count), pixel| {
        (sum + pixel[..3].iter().map(|v| u64::from(*v)).sum::<u64>(), count + 3)
    });
    sum as f64 / count.max(1) as f64
}

impl Stages {
    /// Start of a stage.
    // Measures the duration of the work; no data is stamped with it.
    #[allow(clippy::disallowed_methods)]
    pub fn start(&self) -> Instant {
        Instant::now()
    }

    /// Counts a rejected image.
    pub fn reject(&mut self, reason: &dyn Display) {
        self.rejected += 1;
        self.reason = reason.to_string();
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
        let mut values = vec![
            ("images", self.convert.count.to_string()),
            ("rejected", self.rejected.to_string()),
            ("repeated", self.repeated.to_string()),
            ("all four detected", four.to_string()),
            ("three detected", three.to_string()),
            ("fewer detected", (none + one + two).to_string()),
            ("decoding, ms", self.convert.text()),
            ("tracking, ms", self.track.text()),
            ("drawing, ms", self.draw.text()),
        ];
        if self.rejected > 0 {
            values.push(("reason of the last rejection", self.reason.clone()));
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PixelFormat;
    use rig_model::Stamp;

    #[test]
    fn an_ignored_channel_adds_no_brightness() {
        let data = [[0u8, 10, 20, 255]; 16].concat();
        let (stamp, format) = (Stamp::default(), PixelFormat::Rgba8);
        let view = ImageView { stamp, width: 2, height: 8, step: 8, format, data: &data };
        assert_eq!(brightness(&view), 10.0);
    }
}
