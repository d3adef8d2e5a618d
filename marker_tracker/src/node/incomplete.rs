//! Memory of incomplete images.
//!
//! A raw image is sent in thousands of fragments. With best-effort transport one lost fragment
//! makes an image incomplete, and RustDDS 0.15.1 keeps the buffers of up to 128 incomplete messages
//! per publisher until 10 s pass (`rtps/fragment_assembler.rs`): 1.2 GB of images of 2048×1536. It
//! neither reports nor limits them. A camera announces each image by a small camera_info, so that
//! the missing ones are known; renewing the subscription frees their buffers.

use std::{
    fs,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// Memory of incomplete images at which the subscription is renewed, bytes: four of the largest
/// images of common 8 MP cameras, and 13 of 2048×1536.
const LIMIT: usize = 128 << 20;
/// Bytes per pixel of most cameras' raw images.
const BYTES_PER_PIXEL: usize = 3;

/// Counts announced and complete images since the last renewal.
#[derive(Debug, Default)]
pub(super) struct IncompleteImages {
    announced: usize,
    received: usize,
    /// Memory of the process when images were last complete, bytes; `None` where it is yet to be
    /// read.
    resident: Option<usize>,
    /// Whether the last camera_info has no usable model.
    pub is_info_rejected: bool,
    /// Number of incomplete images that were dropped since the start.
    pub dropped: u64,
    /// Number of images that were announced since the last report of the node's state.
    pub recent: u32,
}

impl IncompleteImages {
    /// Counts a complete image, whether the node processes it or not.
    pub fn count_received(&mut self) {
        self.received += 1;
        if self.received >= self.announced {
            self.resident = None;
        }
    }

    /// Counts an announced image of this size (width, height; px). True where the missing images
    /// occupy more than the limit, which the memory of the process confirms ([`resident`], bytes):
    /// a camera may also announce more images than it sends. They then count as dropped: the
    /// subscription is to be renewed.
    pub fn is_full_after(
        &mut self,
        size: (u32, u32),
        resident: impl Fn() -> Option<usize>,
    ) -> bool {
        let base = *self.resident.get_or_insert_with(|| resident().unwrap_or(0));
        self.announced += 1;
        self.recent = self.recent.saturating_add(1);
        let missing = self.announced.saturating_sub(self.received);
        let bytes = [size.0 as usize, size.1 as usize, BYTES_PER_PIXEL]
            .into_iter()
            .fold(missing, usize::saturating_mul);
        let is_full = bytes > LIMIT && resident().is_none_or(|now| now > base + LIMIT / 2);
        if is_full {
            self.dropped += missing as u64;
            (self.announced, self.received) = (0, 0);
        }
        is_full
    }

    /// Explains a second without images.
    pub fn why_none(&self) -> String {
        if self.dropped == 0 || self.recent == 0 {
            return "no image arrived in the last second".to_owned();
        }
        self.why_dropped()
    }

    /// Explains dropped images.
    pub fn why_dropped(&self) -> String {
        format!(
            "{} images arrived incomplete and were dropped: the socket buffer is too small for raw \
             images of this size and rate; raise net.core.rmem_max or set image_transport to \
             compressed",
            self.dropped
        )
    }
}

/// The counts, which the threads that receive the messages share with the node: it may drop a
/// message before it handles it.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedCounts(Arc<Mutex<IncompleteImages>>);

impl SharedCounts {
    pub fn lock(&self) -> MutexGuard<'_, IncompleteImages> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Resident memory of the process, bytes. (`statm` has it in pages, whose size varies on ARM.)
pub(super) fn resident() -> Option<usize> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let kilobytes = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(kilobytes.split_whitespace().next()?.parse::<usize>().ok()? << 10)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::{Arrival, CameraChanges, IfChanged, camera_info_input, image_input};
    use std::cell::Cell;
    use volant_msgs::sensor_msgs::msg::{CameraInfo, Image};

    const SIZE: (u32, u32) = (2048, 1536);
    const IMAGE: usize = 2048 * 1536 * 3;

    /// 20 Hz for a minute, of which each `period`-th image is complete: the most bytes that RustDDS
    /// holds, and the number of renewals.
    fn hold(period: Option<usize>, kept: usize) -> (usize, u32) {
        let mut images = IncompleteImages::default();
        let (held, mut most, mut renewals) = (Cell::new(0), 0, 0);
        for k in 0..1200 {
            if period.is_some_and(|p| k % p == 0) {
                images.count_received();
            } else {
                held.set(held.get() + kept);
            }
            most = most.max(held.get());
            if images.is_full_after(SIZE, || Some((33 << 20) + held.get())) {
                held.set(0);
                renewals += 1;
            }
        }
        (most, renewals)
    }

    #[test]
    fn incomplete_images_occupy_at_most_the_limit() {
        for period in [None, Some(2), Some(10)] {
            let (most, renewals) = hold(period, IMAGE);
            assert!(most <= LIMIT + 2 * IMAGE, "{period:?}: {most} bytes");
            assert!(renewals > 10, "{period:?}: {renewals}");
        }
    }

    #[test]
    fn neither_complete_images_nor_unsent_ones_renew_the_subscription() {
        assert_eq!(hold(Some(1), IMAGE).1, 0);
        assert_eq!(hold(Some(3), 0).1, 0);
    }

    #[test]
    fn memory_that_grows_while_images_are_complete_is_not_that_of_incomplete_ones() {
        let mut images = IncompleteImages::default();
        for k in 0..1200 {
            // Then the camera announces images that it does not send.
            if k < 600 {
                images.count_received();
            }
            assert!(!images.is_full_after(SIZE, || Some(k.min(600) << 20)), "image {k}");
        }
    }

    #[test]
    fn the_memory_of_the_process_is_in_bytes() {
        let before = resident().unwrap();
        let block = std::hint::black_box(vec![1u8; 256 << 20]);
        let more = resident().unwrap().saturating_sub(before);
        assert!((200 << 20..300 << 20).contains(&more), "{more} bytes");
        drop(block);
    }

    #[test]
    fn dropped_images_are_counted_and_explained() {
        let mut images = IncompleteImages::default();
        assert!(images.why_none().contains("no image"));
        while !images.is_full_after(SIZE, || None) {}
        assert_eq!(images.dropped as usize, LIMIT / IMAGE + 1);
        assert!(images.why_none().contains("rmem_max"));
        // The camera is silent now, with its camera_info.
        images.recent = 0;
        assert!(images.why_none().contains("no image"));
    }

    #[test]
    fn images_are_counted_as_they_arrive_whether_their_camera_info_is_usable_or_not() {
        let (counts, changes) = (SharedCounts::default(), CameraChanges::default());
        let uncalibrated =
            Arc::new(CameraInfo { width: 640, height: 480, ..CameraInfo::default() });
        let IfChanged(first) = camera_info_input(&counts, true, &changes, uncalibrated.clone());
        assert!(matches!(first, Some(Err(_))));
        let _ = camera_info_input(&counts, true, &changes, uncalibrated);
        // Nothing handles it.
        let image = image_input(&counts, Arc::new(Image::default()));
        assert!(matches!(image, Some(Arrival::Image(_))));
        let counts = counts.lock();
        assert_eq!((counts.announced, counts.received), (2, 1));
        assert!(counts.is_info_rejected);
    }
}
