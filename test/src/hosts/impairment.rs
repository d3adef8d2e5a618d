//! Impairment of a link: what happens to a frame, decided from a seed, and the queue of delayed
//! frames.

use rig_simulator::random::Random;
use std::{cmp::Reverse, collections::BinaryHeap, time::Duration};

/// How bad a link is, each way.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Impairment {
    /// Share of the frames that are lost.
    pub loss: f64,
    /// Delay, s.
    pub delay: f64,
    /// Half width of the delay's uniform distribution, s; frames overtake each other.
    pub spread: f64,
    /// Share of the frames that are delayed by [`LATE`] in addition, so that others overtake them.
    pub reordered: f64,
    /// Nothing passes.
    pub cut: bool,
}

/// How much longer a reordered frame is on its way.
pub const LATE: Duration = Duration::from_millis(15);

impl Impairment {
    /// How long a frame is on its way; `None`: it is lost.
    pub fn fate(&self, random: &mut Random) -> Option<Duration> {
        // Drawn always, so that one figure of the impairment does not change what another one does.
        let [lost, spread, late] = [0.0, -1.0, 0.0].map(|low| random.within(low, 1.0));
        if self.cut || lost < self.loss {
            return None;
        }
        let delay = Duration::from_secs_f64((self.delay + self.spread * spread).max(0.0));
        Some(if late < self.reordered { delay + LATE } else { delay })
    }
}

/// A frame in transit: when it is due; its number, because frames that are due at one instant leave
/// in the order in which they came; the end that it comes out of; its bytes.
type Frame = (Duration, u64, usize, Vec<u8>);

/// Frames in transit by time of arrival. Bounded as a router's buffer is.
#[derive(Default)]
pub struct Queue {
    frames: BinaryHeap<Reverse<Frame>>,
    count: u64,
}

/// A link buffers no more frames than this.
pub const MOST: usize = 20_000;

impl Queue {
    /// Adds a frame that arrives at end `to` at `due`; false when the queue is full.
    pub fn put(&mut self, due: Duration, to: usize, bytes: Vec<u8>) -> bool {
        if self.frames.len() >= MOST {
            return false;
        }
        self.count += 1;
        self.frames.push(Reverse((due, self.count, to, bytes)));
        true
    }

    /// When the next one arrives.
    pub fn next(&self) -> Option<Duration> {
        self.frames.peek().map(|Reverse((due, ..))| *due)
    }

    /// One that has arrived by `now`, with the end that it comes out of.
    pub fn take(&mut self, now: Duration) -> Option<(usize, Vec<u8>)> {
        if self.next()? > now {
            return None;
        }
        self.frames.pop().map(|Reverse((.., to, bytes))| (to, bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn loss_and_delay_are_as_configured() {
        let impairment =
            Impairment { loss: 0.05, delay: 0.05, spread: 0.02, ..Impairment::default() };
        let mut random = Random::fork(1, "impairment");
        let fates: Vec<_> = (0..20_000).map(|_| impairment.fate(&mut random)).collect();
        let lost = fates.iter().filter(|f| f.is_none()).count() as f64 / 20_000.0;
        assert!((lost - 0.05).abs() < 0.006, "{lost}");
        let delays: Vec<f64> = fates.iter().flatten().map(Duration::as_secs_f64).collect();
        let mean = delays.iter().sum::<f64>() / delays.len() as f64;
        assert!((mean - 0.05).abs() < 5e-4, "{mean}");
        assert!(delays.iter().all(|d| (0.03..=0.07).contains(d)));
        let cut = Impairment { cut: true, ..impairment };
        assert!((0..100).all(|_| cut.fate(&mut random).is_none()));
    }

    #[test]
    fn frames_leave_when_they_are_due() {
        let ms = Duration::from_millis;
        let mut queue = Queue::default();
        for (due, byte) in [(30, 1), (10, 2), (10, 3), (20, 4)] {
            assert!(queue.put(ms(due), 0, vec![byte]));
        }
        assert_eq!(queue.take(ms(5)), None);
        let order: Vec<u8> = std::iter::from_fn(|| queue.take(ms(100)))
            .filter_map(|(_, b)| b.first().copied())
            .collect();
        assert_eq!(order, [2, 3, 4, 1]);
    }
}
