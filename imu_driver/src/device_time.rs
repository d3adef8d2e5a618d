//! Clock of the device without wraps, from the sample counter or SampleTimeFine.
//!
//! Counters and arrival times → device time (ns) and number of missing messages. A device without
//! either is counted by its messages, and what is missing follows from the time since the first.

use crate::{clock_fit::MAX_DRIFT, protocol::Measurement};
use rig_model::Stamp;

/// Period of SampleTimeFine of MTi-10 and MTi-100, ticks of 0.1 ms; others use all 32 bits.
const TICKS_PER_DAY: i64 = 864_000_000;
const NANOS_PER_TICK: i64 = 100_000;

/// Device time of one message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Placed {
    /// Time since the first message, ns.
    pub device: i64,
    /// Messages missing before this one.
    pub lost: u64,
    /// The device or its counter restarted: `device` starts at zero.
    pub restarted: bool,
    /// The message was received before, or is older than the last one.
    pub repeated: bool,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    counter: Option<u16>,
    fine: Option<u32>,
    device: i64,
    arrival: Stamp,
}

/// Delays of messages without a counter, in message periods since the first one.
#[derive(Clone, Copy, Debug, Default)]
struct Delays {
    /// Arrival of the first message.
    first: Stamp,
    /// Delay of the fastest message: negative if the first one was late.
    fastest: f64,
    /// Arrival since when messages are missing, and the smallest number of them since then.
    missing: Option<(Stamp, f64)>,
}

/// Unwraps the clock of the device.
#[derive(Clone, Copy, Debug)]
pub struct DeviceTime {
    /// Message period, ns, as an exact fraction without accumulated error.
    period: (i64, i64),
    count: i64,
    /// Messages without inertial data since the last one with them; they increment the counter too.
    others: i64,
    last: Option<Last>,
    delays: Delays,
}

/// Counted minus elapsed time beyond which the counter has restarted, s. A smaller difference is a
/// host that slept, lost the overflow of its buffers and received the rest at once.
const AHEAD: f64 = 5.0;
/// Elapsed minus counted time beyond which the counter has restarted, s. A smaller difference is a
/// host that slept and received everything from its buffers.
const BEHIND: f64 = 5.0;
/// Time for which messages without a counter must be missing, s. On a busy host (pauses of 45 ms),
/// behind an adapter that sends every 16 ms, a message is late by less than a period within it.
const BACKLOG: f64 = 0.3;
/// Smallest number of missing messages that is counted without a counter. Bursts of an adapter may
/// delay all messages by one period, which is no loss.
const FEWEST_MISSING: f64 = 2.0;
/// Shortest time that missing messages lack which is counted without a counter, s: three messages
/// at 100 Hz, less their jitter. A host or an adapter that becomes slower delays all messages by 5
/// to 25 ms for good, which at 400 Hz are several periods, but no loss.
const SHORTEST_LOSS: f64 = 0.027;
/// Part of a period by which all delays of the last [`BACKLOG`] may be too small or too large.
const JITTER: f64 = 0.2;

fn inconsistent(counted: f64, elapsed: f64) -> bool {
    counted - elapsed > AHEAD || elapsed - counted > BEHIND.max(0.5 * elapsed)
}

impl DeviceTime {
    /// Creates a clock with a message period of `ticks` / `ticks_per_second` seconds.
    pub fn new(ticks: u32, ticks_per_second: u32) -> Self {
        let period = (i64::from(ticks.max(1)) * 1_000_000_000, i64::from(ticks_per_second.max(1)));
        Self { period, count: 0, others: 0, last: None, delays: Delays::default() }
    }

    /// Message period, s.
    pub fn period(&self) -> f64 {
        self.period.0 as f64 / self.period.1 as f64 * 1e-9
    }

    /// Counts a message without inertial data, whose time is unrelated.
    pub fn pass(&mut self, m: &Measurement) {
        self.others += i64::from(m.counter.is_some());
    }

    /// Device time of a message that arrived at `arrival`.
    pub fn place(&mut self, m: &Measurement, arrival: Stamp) -> Placed {
        let Some(last) = self.last else {
            return self.first(m, arrival, false);
        };
        let repeated = Placed { device: last.device, repeated: true, ..Placed::default() };
        let elapsed = arrival.seconds_since(last.arrival);
        let by_counter = m.counter.zip(last.counter).map(|(now, before)| {
            // After a long dropout the arrival determines how often the counter has wrapped.
            let step = i64::from(now.wrapping_sub(before));
            let wraps =
                ((elapsed / self.period() - step as f64) / 65_536.0).round().clamp(0.0, 1e9);
            step + 65_536 * wraps as i64
        });
        if let Some((now, before)) = m.sample_time_fine.zip(last.fine) {
            let ticks = fine_step(now, before, elapsed);
            let advance = ticks.saturating_mul(NANOS_PER_TICK);
            if by_counter == Some(0) || ticks == 0 && by_counter.is_none() {
                return repeated;
            }
            if ticks < 0 || inconsistent(advance as f64 * 1e-9, elapsed) {
                return self.first(m, arrival, true);
            }
            let device = last.device.saturating_add(advance);
            let lost = by_counter.map_or(0, |step| (step - 1 - self.others).max(0) as u64);
            return self.remember(m, arrival, Placed { device, lost, ..Placed::default() });
        }
        let step = match by_counter {
            Some(0) => return repeated,
            Some(step) => (step - self.others).max(1),
            // Without a counter the message is the next one, however late it is: those behind it
            // may arrive at the same time.
            None => 1,
        };
        if inconsistent(step as f64 * self.period(), elapsed) {
            return self.first(m, arrival, true);
        }
        let step = if by_counter.is_none() { step + self.missing(arrival) } else { step };
        self.count = self.count.saturating_add(step);
        let device =
            (i128::from(self.count) * i128::from(self.period.0) / i128::from(self.period.1)) as i64;
        let lost = (step - 1) as u64;
        self.remember(m, arrival, Placed { device, lost, ..Placed::default() })
    }

    /// Number of messages that are missing before one without a counter: the smallest number since
    /// the gap, once the late messages have arrived.
    ///
    /// Zero where they lack less than [`SHORTEST_LOSS`]: such a loss is not distinguishable from a
    /// latency that has increased, and all later device times are too early by it.
    fn missing(&mut self, arrival: Stamp) -> i64 {
        let period = self.period();
        let periods = arrival.seconds_since(self.delays.first) / period;
        let delay = periods - (self.count + 1) as f64;
        let delays = &mut self.delays;
        // Rises with the largest drift, which would look like a loss after hours.
        delays.fastest = (delays.fastest + MAX_DRIFT).min(delay);
        let missing = delay - delays.fastest;
        if missing < FEWEST_MISSING - JITTER || missing * period < SHORTEST_LOSS {
            delays.missing = None;
            return 0;
        }
        let (since, smallest) = match delays.missing {
            Some((since, smallest)) if missing > smallest - 0.5 => (since, smallest.min(missing)),
            // The first one, or late messages are still arriving.
            _ => (arrival, missing),
        };
        if arrival.seconds_since(since) < BACKLOG {
            delays.missing = Some((since, smallest));
            return 0;
        }
        delays.missing = None;
        (smallest + JITTER).floor() as i64
    }

    fn first(&mut self, m: &Measurement, arrival: Stamp, restarted: bool) -> Placed {
        self.count = 0;
        self.delays = Delays { first: arrival, ..Delays::default() };
        self.remember(m, arrival, Placed { restarted, ..Placed::default() })
    }

    fn remember(&mut self, m: &Measurement, arrival: Stamp, placed: Placed) -> Placed {
        let device = placed.device;
        self.others = 0;
        self.last = Some(Last { counter: m.counter, fine: m.sample_time_fine, device, arrival });
        placed
    }
}

/// Ticks between two values of SampleTimeFine with either period; negative if the clock went back.
fn fine_step(now: u32, before: u32, elapsed: f64) -> i64 {
    let step = i64::from(now) - i64::from(before);
    if step >= 0 {
        return step;
    }
    let expected = elapsed * 1e4;
    [step, step + TICKS_PER_DAY, step + (1 << 32)]
        .into_iter()
        .min_by(|a, b| (*a as f64 - expected).abs().total_cmp(&(*b as f64 - expected).abs()))
        .unwrap_or(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted(counter: u16) -> Measurement {
        Measurement { counter: Some(counter), ..Measurement::default() }
    }

    fn fine(fine: u32) -> Measurement {
        Measurement { sample_time_fine: Some(fine), ..Measurement::default() }
    }

    fn at(seconds: f64) -> Stamp {
        Stamp::from_nanos(1_760_001_000_000_000_000).plus_seconds(seconds)
    }

    #[test]
    fn counter_wraps_lose_nothing() {
        let mut time = DeviceTime::new(288, 115_200);
        let mut counter = 65_000_u16;
        for k in 0..1_440_000_i64 {
            // One hour at 400 Hz: 22 wraps.
            let placed = time.place(&counted(counter), at(k as f64 * 0.0025));
            assert_eq!(placed, Placed { device: k * 2_500_000, ..Placed::default() });
            counter = counter.wrapping_add(1);
        }
    }

    #[test]
    fn lost_messages_are_counted_across_wraps() {
        let mut time = DeviceTime::new(1152, 115_200);
        time.place(&counted(10), at(0.0));
        assert_eq!(time.place(&counted(15), at(0.05)).lost, 4);
        let placed = time.place(&counted(16), at(0.05 + 655.37));
        assert_eq!((placed.lost, placed.device), (65_536, (5 + 65_537) * 10_000_000));
        assert!(time.place(&counted(16), at(655.43)).repeated);
    }

    #[test]
    fn a_reset_counter_is_a_restart_without_losses() {
        let mut time = DeviceTime::new(1152, 115_200);
        time.place(&counted(5000), at(0.0));
        let placed = time.place(&counted(0), at(0.7));
        assert_eq!((placed.restarted, placed.lost, placed.device), (true, 0, 0));
    }

    #[test]
    fn sample_time_fine_wraps_after_a_day_or_after_32_bits() {
        for (before, now) in [(863_999_950, 50), (4_294_967_246, 50)] {
            let mut time = DeviceTime::new(1152, 115_200);
            time.place(&fine(before), at(0.0));
            let placed = time.place(&fine(now), at(0.012));
            assert_eq!((placed.device, placed.restarted), (10_000_000, false), "{before}");
        }
        let mut time = DeviceTime::new(1152, 115_200);
        time.place(&fine(500_000), at(0.0));
        assert!(time.place(&fine(50), at(0.5)).restarted);
    }

    #[test]
    fn without_a_counter_each_message_is_the_next_one() {
        let mut time = DeviceTime::new(1152, 115_200);
        let none = Measurement::default();
        // Bursts of 16, 17 and 60 ms; none of the messages is missing.
        for (k, arrival) in (0..).zip([0.0, 0.016, 0.017, 0.077, 0.077, 0.077]) {
            let placed = time.place(&none, at(arrival));
            assert_eq!((placed.device, placed.lost), (k * 10_000_000, 0));
        }
        assert!(time.place(&none, at(60.0)).restarted);
    }

    #[test]
    fn without_a_counter_messages_that_stay_missing_are_counted() {
        for missing in [3, 30, 200] {
            let mut time = DeviceTime::new(1152, 115_200);
            let mut lost = 0;
            for k in (0..400_u64).chain(400 + missing..1000) {
                // In bursts of 16 ms; a busy host reads 0.3 s of messages at once.
                let busy = (200..=230).contains(&k);
                let milliseconds = if busy { 2304 } else { (10 * k).div_ceil(16) * 16 };
                let arrival = at(milliseconds as f64 * 1e-3);
                let placed = time.place(&Measurement::default(), arrival);
                lost += placed.lost;
                // Behind the gap, the late messages are awaited.
                if k < 400 || k > 440 + missing {
                    assert_eq!((placed.device, placed.restarted), (k as i64 * 10_000_000, false));
                    assert_eq!(lost, if k < 400 { 0 } else { missing });
                }
            }
        }
    }

    #[test]
    fn without_a_counter_a_latency_that_increases_is_no_loss() {
        let mut time = DeviceTime::new(288, 115_200);
        for k in 0..2000_i64 {
            let latency = if k < 800 { 0.0 } else { 0.01 };
            let arrival = at(k as f64 * 0.0025 + latency);
            let placed = time.place(&Measurement::default(), arrival);
            assert_eq!(placed, Placed { device: k * 2_500_000, ..Placed::default() });
        }
    }

    #[test]
    fn messages_without_inertial_data_take_no_time() {
        let mut time = DeviceTime::new(1152, 115_200);
        time.place(&counted(1), at(0.0));
        for k in 1..=100_u16 {
            time.pass(&counted(2 * k));
            let placed = time.place(&counted(2 * k + 1), at(f64::from(k) * 0.01));
            assert_eq!((placed.device, placed.lost), (i64::from(k) * 10_000_000, 0));
        }
        time.pass(&counted(202));
        assert_eq!(time.place(&counted(205), at(1.03)).lost, 2);
    }
}
