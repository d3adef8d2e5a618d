//! Durations of the stages and counts of images, for the diagnostics.

use crate::image::ImageView;
use std::time::{Duration, Instant};

/// Sums since the last report.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    images: u32,
    accepted: u32,
    rejected: u32,
    repeated: u32,
    convert: Span,
    track: Span,
    draw: Span,
    /// Number of images with 0 to 4 detected markers.
    detected: [u32; 5],
    /// Σ of the mean values of the images without a marker.
    brightness: f64,
    /// Size of the newest image, px.
    size: (usize, usize),
}

#[derive(Clone, Copy, Debug, Default)]
struct Span {
    sum: Duration,
    longest: Duration,
    count: u32,
}

impl Span {
    fn add(&mut self, time: Duration) {
        self.sum += time;
        self.longest = self.longest.max(time);
        self.count += 1;
    }

    fn text(&self) -> String {
        let mean = self.sum.as_secs_f64() * 1e3 / f64::from(self.count.max(1));
        format!("{mean:.3} (max {:.3})", self.longest.as_secs_f64() * 1e3)
    }
}

/// Summary of one second.
pub(crate) struct Report {
    pub images: u32,
    pub accepted: u32,
    /// Number of images that were copies of their predecessor.
    pub repeated: u32,
    pub rejected: u32,
    /// Number of images with at least 1, 2, 3 and 4 markers.
    pub detected: [u32; 4],
    /// Mean of the values of the images without a marker, 0 to 255.
    pub brightness: f64,
    /// Size of the newest image, px.
    pub size: (usize, usize),
    pub values: Vec<(&'static str, String)>,
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

    pub fn converted(&mut self, since: Instant) {
        self.images += 1;
        self.convert.add(since.elapsed());
    }

    pub fn tracked(&mut self, since: Instant) {
        self.track.add(since.elapsed());
    }

    #[cfg(feature = "opencv")]
    pub fn drawn(&mut self, since: Instant) {
        self.draw.add(since.elapsed());
    }

    /// Records the size of the last image, px.
    pub fn set_size(&mut self, size: (usize, usize)) {
        self.size = size;
    }

    /// Records the brightness of an image without a marker.
    pub fn add_brightness(&mut self, image: &ImageView<'_>) {
        self.brightness += brightness(image);
    }

    /// Number of images without a marker.
    pub fn unseen(&self) -> u32 {
        self.detected[0]
    }

    pub fn rejected(&mut self) {
        self.rejected += 1;
    }

    pub fn repeated(&mut self) {
        self.repeated += 1;
    }

    pub fn finished(&mut self, detected: usize) {
        self.accepted += 1;
        self.detected[detected.min(4)] += 1;
    }

    /// Summary since the last report; resets all sums.
    pub fn report(&mut self) -> Report {
        let s = std::mem::take(self);
        let at_least = [1, 2, 3, 4].map(|n| s.detected[n..].iter().sum());
        Report {
            images: s.images,
            accepted: s.accepted,
            repeated: s.repeated,
            rejected: s.rejected,
            detected: at_least,
            brightness: s.brightness / f64::from(s.detected[0].max(1)),
            size: s.size,
            values: vec![
                ("images", s.images.to_string()),
                ("rejected", s.rejected.to_string()),
                ("repeated", s.repeated.to_string()),
                ("all four detected", s.detected[4].to_string()),
                ("three detected", s.detected[3].to_string()),
                ("fewer detected", (s.detected[0] + s.detected[1] + s.detected[2]).to_string()),
                ("decoding, ms", s.convert.text()),
                ("tracking, ms", s.track.text()),
                ("drawing, ms", s.draw.text()),
            ],
        }
    }
}
