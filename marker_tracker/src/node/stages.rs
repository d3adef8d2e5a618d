//! How long each stage of an image takes and how many images came, for the diagnostics.

use crate::ImageView;
use std::time::{Duration, Instant};

/// Sums since the last report.
#[derive(Debug, Default)]
pub(crate) struct Stages {
    images: u32,
    taken: u32,
    refused: u32,
    repeated: u32,
    convert: Span,
    track: Span,
    draw: Span,
    /// Images with none, one … four markers detected.
    detected: [u32; 5],
    /// Mean values of the images with none, summed.
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

/// One second.
pub(crate) struct Report {
    pub images: u32,
    pub taken: u32,
    /// Images that were the one before, byte for byte.
    pub repeated: u32,
    pub refused: u32,
    /// Images with at least one marker, at least two, ….
    pub detected: [u32; 4],
    /// Mean of the values of the images without a marker, 0 to 255.
    pub brightness: f64,
    /// Size of the newest image, px.
    pub size: (usize, usize),
    pub values: Vec<(&'static str, String)>,
}

/// Mean value of an image, from a few of its rows.
fn brightness(image: &ImageView<'_>) -> f64 {
    const ROWS: usize = 8;
    let row = image.width * image.format.bytes_per_pixel();
    let bytes = (0..ROWS).flat_map(|i| {
        let start = (2 * i + 1) * image.height / (2 * ROWS) * image.step;
        image.data.get(start..start + row).unwrap_or(&[])
    });
    let (sum, count) = bytes.fold((0_u64, 0_u64), |(sum, count), byte| (sum + u64::from(*byte), count + 1));
    sum as f64 / count.max(1) as f64
}

impl Stages {
    /// A stage begins.
    #[allow(clippy::disallowed_methods)] // how long the work takes is what is measured; no data is stamped with it
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

    /// What the image was like, of which `finished` told last.
    pub fn looked_at(&mut self, image: &ImageView<'_>, unseen_before: u32) {
        self.size = (image.width, image.height);
        if self.detected[0] > unseen_before {
            self.brightness += brightness(image);
        }
    }

    /// Images without a marker.
    pub fn unseen(&self) -> u32 {
        self.detected[0]
    }

    pub fn refused(&mut self) {
        self.refused += 1;
    }

    pub fn repeated(&mut self) {
        self.repeated += 1;
    }

    pub fn finished(&mut self, detected: usize) {
        self.taken += 1;
        self.detected[detected.min(4)] += 1;
    }

    /// What the last second held; starts anew.
    pub fn report(&mut self) -> Report {
        let s = std::mem::take(self);
        let at_least = [1, 2, 3, 4].map(|n| s.detected[n..].iter().sum());
        Report {
            images: s.images,
            taken: s.taken,
            repeated: s.repeated,
            refused: s.refused,
            detected: at_least,
            brightness: s.brightness / f64::from(s.detected[0].max(1)),
            size: s.size,
            values: vec![
                ("images", s.images.to_string()),
                ("refused", s.refused.to_string()),
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
