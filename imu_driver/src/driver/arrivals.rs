//! When did a message begin on the wire? An adapter that hands bytes over in bursts cuts messages in two, and each part
//! tells something: a message whose first 20 bytes arrived at t began no later than 20 byte times before t. With a burst
//! that falls *into* a message this is known to one byte time (87 µs at 115200 baud), however long the bursts are apart.
//!
//! In flow portions of bytes with their arrival; out flow the latest instant at which a message can have begun.

use rig_model::Stamp;
use std::collections::VecDeque;

/// Portions that are kept: more than one message is ever cut into, unless it comes byte by byte.
const KEPT: usize = 64;

#[derive(Clone, Copy, Debug)]
struct Portion {
    /// Bytes of the stream up to its end.
    end: u64,
    arrival: Stamp,
}

/// The newest portions of a stream.
#[derive(Debug)]
pub(super) struct Arrivals {
    portions: VecDeque<Portion>,
}

impl Arrivals {
    pub(super) fn new() -> Self {
        Self { portions: VecDeque::with_capacity(KEPT) }
    }

    /// The stream starts anew.
    pub(super) fn clear(&mut self) {
        self.portions.clear();
    }

    /// A portion came, which ends after so many bytes of the stream.
    pub(super) fn came(&mut self, end: u64, arrival: Stamp) {
        if self.portions.len() == KEPT {
            self.portions.pop_front();
        }
        self.portions.push_back(Portion { end, arrival });
    }

    /// The latest instant at which the message of these bytes can have begun, where a byte takes `byte_time` (s).
    /// `None` where none of its portions is known. Portions before it are forgotten.
    pub(super) fn begun(&mut self, offset: u64, length: usize, byte_time: f64) -> Option<Stamp> {
        while self.portions.front().is_some_and(|p| p.end <= offset) {
            self.portions.pop_front();
        }
        let end = offset + length as u64;
        let mut earliest: Option<Stamp> = None;
        for portion in &self.portions {
            let of_it = portion.end.min(end) - offset;
            let begun = portion.arrival.plus_seconds(-(of_it as f64) * byte_time);
            earliest = Some(earliest.map_or(begun, |e| e.min(begun)));
            if portion.end >= end {
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
    fn a_message_that_was_cut_is_known_to_one_byte() {
        let mut arrivals = Arrivals::new();
        // Bytes 0..50 are one message, 50..100 the next; a burst ends after 70 bytes, the rest waits for 16 ms.
        arrivals.came(70, at(1.0));
        arrivals.came(100, at(1.016));
        assert_eq!(arrivals.begun(0, 50, BYTE), Some(at(1.0 - 0.005)));
        assert_eq!(arrivals.begun(50, 50, BYTE), Some(at(1.0 - 0.002)));
        // Whole in one portion.
        arrivals.came(150, at(1.032));
        assert_eq!(arrivals.begun(100, 50, BYTE), Some(at(1.032 - 0.005)));
        assert_eq!(arrivals.begun(150, 50, BYTE), None);
    }

    #[test]
    fn a_first_part_that_was_held_back_does_no_harm() {
        let mut arrivals = Arrivals::new();
        arrivals.came(10, at(1.010));
        arrivals.came(50, at(1.0101));
        assert_eq!(arrivals.begun(0, 50, BYTE), Some(at(1.0101 - 0.005)));
    }

    #[test]
    fn byte_by_byte_the_newest_are_kept() {
        let mut arrivals = Arrivals::new();
        for k in 1..=1000_u64 {
            arrivals.came(k, at(k as f64 * BYTE));
        }
        let begun = arrivals.begun(0, 1000, BYTE).unwrap();
        assert!(begun.seconds_since(at(0.0)).abs() < 1e-9);
        arrivals.clear();
        assert_eq!(arrivals.begun(0, 1000, BYTE), None);
    }
}
