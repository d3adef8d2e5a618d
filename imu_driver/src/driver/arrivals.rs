//! Upper bound of the time at which a message began on the wire, from the arrival of its parts.
//!
//! A message whose first 20 bytes arrived at t began no later than 20 byte times before t. A burst
//! of the adapter that splits a message determines its begin to one byte time (87 µs at 115200
//! baud), independent of the interval of the bursts.

use rig_model::Stamp;
use std::collections::VecDeque;

/// Number of chunks kept: more than the parts of a message, unless it arrives byte by byte.
const KEPT: usize = 64;

#[derive(Clone, Copy, Debug)]
struct Chunk {
    /// Position of its end in the stream, bytes.
    end: u64,
    arrival: Stamp,
}

/// The newest chunks of a stream.
#[derive(Debug)]
pub(super) struct Arrivals {
    chunks: VecDeque<Chunk>,
}

impl Arrivals {
    pub(super) fn new() -> Self {
        Self { chunks: VecDeque::with_capacity(KEPT) }
    }

    /// Discards all chunks: another stream starts.
    pub(super) fn clear(&mut self) {
        self.chunks.clear();
    }

    /// Adds a chunk that ends at position `end` of the stream, bytes.
    pub(super) fn received(&mut self, end: u64, arrival: Stamp) {
        if self.chunks.len() == KEPT {
            self.chunks.pop_front();
        }
        self.chunks.push_back(Chunk { end, arrival });
    }

    /// Latest time at which the message at position `offset` with `length` bytes can have begun.
    ///
    /// `byte_time`: duration of one byte, s. `None` if no chunk of the message is known. Discards
    /// the chunks before the message.
    pub(super) fn begun(&mut self, offset: u64, length: usize, byte_time: f64) -> Option<Stamp> {
        while self.chunks.front().is_some_and(|p| p.end <= offset) {
            self.chunks.pop_front();
        }
        let end = offset + length as u64;
        let mut earliest: Option<Stamp> = None;
        for chunk in &self.chunks {
            let received = chunk.end.min(end) - offset;
            let begun = chunk.arrival.plus_seconds(-(received as f64) * byte_time);
            earliest = Some(earliest.map_or(begun, |e| e.min(begun)));
            if chunk.end >= end {
                break;
            }
        }
        earliest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BYTE: f64 = 1e-4;

    fn at(seconds: f64) -> Stamp {
        Stamp::from_nanos(1_760_001_000_000_000_000).plus_seconds(seconds)
    }

    #[test]
    fn the_begin_of_a_split_message_is_known_to_one_byte() {
        let mut arrivals = Arrivals::new();
        // Messages in bytes 0..50 and 50..100; the first burst has 70 bytes, the next is 16 ms
        // later.
        arrivals.received(70, at(1.0));
        arrivals.received(100, at(1.016));
        assert_eq!(arrivals.begun(0, 50, BYTE), Some(at(1.0 - 0.005)));
        assert_eq!(arrivals.begun(50, 50, BYTE), Some(at(1.0 - 0.002)));
        // Whole in one chunk.
        arrivals.received(150, at(1.032));
        assert_eq!(arrivals.begun(100, 50, BYTE), Some(at(1.032 - 0.005)));
        assert_eq!(arrivals.begun(150, 50, BYTE), None);
    }

    #[test]
    fn a_delayed_first_chunk_has_no_effect() {
        let mut arrivals = Arrivals::new();
        arrivals.received(10, at(1.010));
        arrivals.received(50, at(1.0101));
        assert_eq!(arrivals.begun(0, 50, BYTE), Some(at(1.0101 - 0.005)));
    }

    #[test]
    fn of_single_bytes_the_newest_are_kept() {
        let mut arrivals = Arrivals::new();
        for k in 1..=1000_u64 {
            arrivals.received(k, at(k as f64 * BYTE));
        }
        let begun = arrivals.begun(0, 1000, BYTE).unwrap();
        assert!(begun.seconds_since(at(0.0)).abs() < 1e-9);
        arrivals.clear();
        assert_eq!(arrivals.begun(0, 1000, BYTE), None);
    }
}
