//! When was a sample taken? The unit's clock says *how far apart* two samples are, their arrival says *not later than
//! this*. In flow pairs of device time and arrival; out flow host stamps without the jitter of the arrival.
//!
//! `arrival − device time` is the offset between the two clocks, plus their drift, plus a delay that is never negative:
//! the adapter's latency timer, the scheduler. So the samples that came through fastest tell the offset: the line is
//! sought that lies below all points and is nearest to them. It is an edge of their lower convex hull: the one over the
//! mean of the abscissas, because the sum of the distances is smallest there (a linear programme in two unknowns).
//! Method: Zhang, Liu, Xia, "Clock synchronization algorithms for network measurements", INFOCOM 2002.
//!
//! The first samples have nothing before them to be compared with: on a host with more to do than it can, they are all
//! late, by tens of milliseconds. So the fit says when it is settled ([`ClockFit::is_settled`]), and whoever can wait
//! keeps the first samples until then: [`ClockFit::observe`] takes each as it comes, [`ClockFit::stamp`] gives the stamps.
//!
//! What no method can see is a delay that *every* sample has. The wire's share is known and subtracted by the caller.
//! Beyond that: where whole messages come in bursts whose period is in step with the samples' (16 ms and 10 ms meet in
//! five phases, 2 ms apart), the arrivals are the same for every offset within 2 ms until the clocks have drifted apart
//! by as much (67 s at 30 ppm). No estimator does better there than 2 ms / √12 = 0.58 ms RMS over the possible phases;
//! this one takes the earliest, 1.15 ms RMS and 2 ms at worst. The driver does not come to that: it uses the messages
//! that the bursts *cut*, whose begin is known to one byte time.

use rig_model::Stamp;
use std::collections::VecDeque;

/// What the fit takes for granted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockFitConfig {
    /// How far back samples are used, s.
    pub window: f64,
    /// No two of the clocks in question differ by more, s/s.
    pub max_drift: f64,
    /// A stamp is moved towards a better fit by at most this share of the time since the last one.
    pub slew: f64,
    /// Where the fit and the arrivals disagree by more than this for [`ClockFitConfig::patience`], the host's clock was
    /// set or the unit started anew, s.
    pub step: f64,
    /// s.
    pub patience: f64,
    /// An arrival that is earlier than the fit by more than this means that the host's clock was set back; by less, that
    /// all samples before came through late, s.
    pub step_back: f64,
    /// The fit is settled once [`ClockFitConfig::agreeing`] samples came through within this of the fastest, s …
    pub agreement: f64,
    /// … so many: a stalled host is late by something else each time.
    pub agreeing: usize,
    /// … not sooner than this after the first, s …
    pub settling: f64,
    /// … and in any case after this, s: an adapter may be more irregular than that.
    pub longest_settling: f64,
}

impl Default for ClockFitConfig {
    fn default() -> Self {
        Self {
            window: 120.0,
            max_drift: 150e-6,
            slew: 0.1,
            step: 0.1,
            patience: 1.0,
            step_back: 1.0,
            agreement: 0.3e-3,
            agreeing: 5,
            settling: 0.2,
            longest_settling: 1.0,
        }
    }
}

/// Samples within so many seconds share one point of the fit, the earliest of them to arrive: memory stays flat.
const BUCKET: f64 = 0.5;

#[derive(Clone, Copy, Debug)]
struct Point {
    /// Device time since the origin, s.
    x: f64,
    /// Arrival minus device time, relative to the origin's, s.
    y: f64,
}

#[derive(Clone, Copy, Debug)]
struct Origin {
    device: i64,
    host: Stamp,
}

/// More samples than this are never looked at for settling.
const MOST_SETTLING: usize = 512;

/// Fits host time to device time.
#[derive(Clone, Debug)]
pub struct ClockFit {
    config: ClockFitConfig,
    origin: Option<Origin>,
    points: VecDeque<Point>,
    hull: Vec<Point>,
    /// Offset at the origin (s) and drift (s/s) of the line.
    line: (f64, f64),
    /// The correction that the last stamp had, s: it follows the line by a limited slew.
    applied: f64,
    /// Of the last stamp since the fit began.
    last_device: Option<i64>,
    last_stamp: Option<Stamp>,
    last_arrival: Option<Stamp>,
    /// Since which point the arrivals have been far off the line, and the smallest distance since.
    suspicious: Option<(Point, f64)>,
    /// Arrival minus device time of the first samples, s, until they agree.
    first: Vec<f64>,
    settled: bool,
}

impl ClockFit {
    /// A fit that has seen nothing.
    pub fn new(config: ClockFitConfig) -> Self {
        let capacity = (config.window / BUCKET).ceil() as usize + 2;
        Self {
            config,
            origin: None,
            points: VecDeque::with_capacity(capacity),
            hull: Vec::with_capacity(capacity),
            line: (0.0, 0.0),
            applied: 0.0,
            last_device: None,
            last_stamp: None,
            last_arrival: None,
            suspicious: None,
            first: Vec::with_capacity(MOST_SETTLING),
            settled: false,
        }
    }

    /// The unit's clock starts anew (a restart, a new connection). Stamps go on where they were: never backwards.
    pub fn restart(&mut self) {
        self.origin = None;
        self.points.clear();
        self.line = (0.0, 0.0);
        self.applied = 0.0;
        self.last_device = None;
        self.suspicious = None;
        self.first.clear();
        self.settled = false;
    }

    /// Drift of the unit's clock against the host's, s/s: positive where the unit runs slow. `None` before the first
    /// few seconds.
    pub fn drift(&self) -> Option<f64> {
        (self.points.len() >= 10).then_some(self.line.1)
    }

    /// By how much a clock has jumped (s), where a sample with this device time (ns, unwrapped, growing) that arrived at
    /// `arrival` makes that certain. The fit is then to be begun anew, with [`ClockFit::step`].
    pub fn jump(&mut self, device: i64, arrival: Stamp) -> Option<f64> {
        let origin = self.origin?;
        self.clock_stepped(point_of(&origin, device, arrival))
    }

    /// The fit begins anew after a jump by so many seconds that a sample which arrived at `arrival` has shown. Stamps
    /// follow a host's clock that was set back.
    pub fn step(&mut self, jump: f64, arrival: Stamp) {
        self.restart();
        // Where the host's clock was set back, waiting until it catches up would hold all stamps for as long. (The unit's
        // may have jumped ahead instead: then stamps go on.)
        let earlier = self.last_arrival.is_some_and(|last| arrival.seconds_since(last) < -self.config.step);
        if jump < 0.0 && earlier {
            self.last_stamp = None;
        }
    }

    /// Takes in when a sample came.
    pub fn observe(&mut self, device: i64, arrival: Stamp) {
        let origin = match self.origin {
            Some(origin) => origin,
            None => self.begin(device, arrival),
        };
        let point = point_of(&origin, device, arrival);
        if !self.settled {
            self.first.push(point.y);
        }
        if self.take(point) {
            self.fit();
        }
        if !self.settled {
            self.settled = self.agree(point.x);
        }
        self.last_arrival = Some(arrival);
    }

    /// Whether enough samples were observed for stamps to be right from the first one on.
    pub fn is_settled(&self) -> bool {
        self.settled
    }

    fn agree(&self, elapsed: f64) -> bool {
        let fastest = self.first.iter().copied().fold(f64::INFINITY, f64::min);
        let agreeing = self.first.iter().filter(|y| **y - fastest < self.config.agreement).count();
        elapsed >= self.config.longest_settling
            || self.first.len() >= MOST_SETTLING
            || elapsed >= self.config.settling && agreeing >= self.config.agreeing
    }

    /// The host's stamp of a sample with this device time, which was observed: when it was ready to be sent.
    pub fn stamp(&mut self, device: i64) -> Stamp {
        let Some(origin) = self.origin else {
            return self.last_stamp.unwrap_or_default();
        };
        let x = device.saturating_sub(origin.device) as f64 * 1e-9;
        let (offset, drift) = self.line;
        let target = offset + drift * x;
        self.applied = match self.last_device {
            Some(last) => {
                let elapsed = device.saturating_sub(last).max(0) as f64 * 1e-9;
                // A fit that is far off (the first samples came through late) is left quickly, but never backwards.
                let far = (target - self.applied).abs() > 5e-3;
                let limit = if far { 0.5 } else { self.config.slew } * elapsed;
                self.applied + (target - self.applied).clamp(-limit, limit)
            }
            None => target,
        };
        self.last_device = Some(device);
        let unconstrained = origin.host.plus_seconds(x + self.applied);
        let stamp = match self.last_stamp {
            // Strictly later, if only by a microsecond.
            Some(last) => unconstrained.max(Stamp::from_nanos(last.as_nanos().saturating_add(1_000))),
            None => unconstrained,
        };
        self.last_stamp = Some(stamp);
        stamp
    }

    fn begin(&mut self, device: i64, arrival: Stamp) -> Origin {
        let origin = Origin { device, host: arrival };
        self.origin = Some(origin);
        origin
    }

    /// How far a clock has jumped, once that is certain.
    fn clock_stepped(&mut self, point: Point) -> Option<f64> {
        let above = point.y - (self.line.0 + self.line.1 * point.x);
        if above < -self.config.step_back {
            return Some(above);
        }
        if above < self.config.step {
            self.suspicious = None;
            return None;
        }
        let (since, smallest) = self.suspicious.unwrap_or((point, above));
        let smallest = smallest.min(above);
        self.suspicious = Some((since, smallest));
        // By both clocks: a host that slept finds seconds of messages in its buffers, all late, and reads them in no time.
        let by_device = point.x - since.x;
        let by_host = by_device + point.y - since.y;
        (by_device.min(by_host) > self.config.patience).then_some(smallest)
    }

    /// Whether the point changes the lower envelope's candidates.
    fn take(&mut self, point: Point) -> bool {
        let bucket = |p: &Point| (p.x / BUCKET).floor();
        let drift = self.line.1;
        match self.points.back_mut() {
            Some(last) if bucket(last) >= bucket(&point) => {
                if point.y - drift * point.x < last.y - drift * last.x {
                    *last = point;
                    return true;
                }
                false
            }
            _ => {
                while self.points.front().is_some_and(|p| point.x - p.x > self.config.window) {
                    self.points.pop_front();
                }
                self.points.push_back(point);
                true
            }
        }
    }

    fn fit(&mut self) {
        // Lower hull, from left to right: the middle one of three is dropped where it lies above the outer two's chord.
        self.hull.clear();
        for &p in &self.points {
            while let [.., a, b] = self.hull.as_slice() {
                if (b.x - a.x) * (p.y - a.y) - (p.x - a.x) * (b.y - a.y) > 0.0 {
                    break;
                }
                self.hull.pop();
            }
            self.hull.push(p);
        }
        let mean = self.points.iter().map(|p| p.x).sum::<f64>() / self.points.len().max(1) as f64;
        let edge = self.hull.windows(2).find_map(|w| match w {
            [a, b] if b.x >= mean => Some((*a, (b.y - a.y) / (b.x - a.x))),
            _ => None,
        });
        let drift = edge.map_or(0.0, |(_, slope)| slope);
        let drift = if drift.is_finite() { drift } else { 0.0 };
        let drift = drift.clamp(-self.config.max_drift, self.config.max_drift);
        // The highest line of that drift that lies below all points.
        let offset = self.hull.iter().map(|p| p.y - drift * p.x).fold(f64::INFINITY, f64::min);
        if offset.is_finite() {
            self.line = (offset, drift);
        }
    }
}

fn point_of(origin: &Origin, device: i64, arrival: Stamp) -> Point {
    let x = device.saturating_sub(origin.device) as f64 * 1e-9;
    Point { x, y: arrival.seconds_since(origin.host) - x }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Without waiting for the fit to settle, and what stepped.
    fn stamp(fit: &mut ClockFit, device: i64, arrival: Stamp) -> (Stamp, Option<f64>) {
        let jump = fit.jump(device, arrival);
        if let Some(jump) = jump {
            fit.step(jump, arrival);
        }
        fit.observe(device, arrival);
        (fit.stamp(device), jump)
    }

    /// Deterministic uniform numbers in 0..1.
    struct Uniform(u64);

    impl Uniform {
        fn next(&mut self) -> f64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) as f64 / (1_u64 << 53) as f64
        }
    }

    /// How bytes come through the adapter.
    #[derive(Clone, Copy, Debug)]
    struct Line {
        rate: f64,
        ppm: f64,
        /// Handed over every so many seconds.
        burst: f64,
        /// Each such period is longer by up to this, s.
        jitter: f64,
        /// Every so often the host sleeps for up to 30 ms.
        hiccups: f64,
    }

    struct Outcome {
        rms: f64,
        max: f64,
        mean: f64,
        backwards: usize,
        interval_rms: f64,
    }

    fn simulate(line: Line, seconds: f64, seed: u64) -> Outcome {
        let start = Stamp::from_nanos(1_760_001_000_000_000_000);
        let mut random = Uniform(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
        let mut fit = ClockFit::new(ClockFitConfig::default());
        let mut burst = random.next() * line.burst;
        let (mut sum, mut squares, mut interval_squares, mut max, mut n) = (0.0, 0.0, 0.0, 0.0_f64, 0.0);
        let mut backwards = 0;
        let mut last: Option<(Stamp, f64)> = None;
        let mut not_before = 0.0_f64;
        for k in 0..(seconds * line.rate) as i64 {
            let device = k as f64 / line.rate;
            let truth = device / (1.0 + line.ppm * 1e-6);
            while line.burst > 0.0 && burst < truth {
                burst += line.burst + line.jitter * random.next();
            }
            let mut arrival = if line.burst > 0.0 { burst } else { truth };
            arrival += 20e-6 + 80e-6 * random.next();
            if random.next() < line.hiccups {
                not_before = arrival + 0.03 * random.next();
            }
            arrival = arrival.max(not_before);
            let (stamp, stepped) =
                stamp(&mut fit, (device * 1e9).round() as i64, start.plus_seconds(arrival));
            assert_eq!(stepped, None);
            let error = stamp.seconds_since(start) - truth;
            if let Some((before, previous)) = last {
                backwards += usize::from(stamp <= before);
                if device > 5.0 {
                    let interval = stamp.seconds_since(before) - (truth - previous);
                    interval_squares += interval * interval;
                }
            }
            last = Some((stamp, truth));
            if device > 5.0 {
                sum += error;
                squares += error * error;
                max = max.max(error.abs());
                n += 1.0;
            }
        }
        Outcome {
            rms: (squares / n).sqrt(),
            max,
            mean: sum / n,
            backwards,
            interval_rms: (interval_squares / n).sqrt(),
        }
    }

    #[test]
    fn bursts_of_an_adapter_and_drift_leave_less_than_a_fifth_of_a_millisecond() {
        println!("rate ppm burst jitter hiccups | rms max mean interval-rms, ms (worst seed of 20)");
        for (rate, burst, jitter, hiccups, bound) in [
            (100.0, 0.016, 0.001, 0.001, 0.2e-3),
            (100.0, 0.016, 0.004, 0.01, 0.2e-3),
            (400.0, 0.016, 0.001, 0.001, 0.2e-3),
            (100.0, 0.0, 0.0, 0.01, 0.1e-3),
            // Whole messages in bursts that are in step with the samples: up to 2 ms that cannot be seen (see above).
            (100.0, 0.016, 0.0, 0.0, 2.2e-3),
        ] {
            for ppm in [-30.0, 0.0, 30.0] {
                let line = Line { rate, ppm, burst, jitter, hiccups };
                let mut worst = simulate(line, 60.0, 1);
                for seed in 2..=20 {
                    let outcome = simulate(line, 60.0, seed);
                    assert_eq!(outcome.backwards, 0);
                    if outcome.rms > worst.rms {
                        worst = outcome;
                    }
                }
                let Outcome { rms, max, mean, interval_rms, .. } = worst;
                println!(
                    "{rate} {ppm} {burst} {jitter} {hiccups} | {:.3} {:.3} {:.3} {:.4}",
                    rms * 1e3,
                    max * 1e3,
                    mean * 1e3,
                    interval_rms * 1e3
                );
                assert!(rms <= bound, "{line:?}: {rms}");
            }
        }
    }

    #[test]
    fn a_clock_that_is_set_is_noticed_and_stamps_follow_it() {
        let start = Stamp::from_nanos(1_760_001_000_000_000_000);
        for jump in [3.0, -3.0] {
            let mut fit = ClockFit::new(ClockFitConfig::default());
            let mut steps = Vec::new();
            let mut last_error = 0.0;
            for k in 0..2000_i64 {
                let t = k as f64 * 0.01;
                let arrival = start.plus_seconds(t + if k >= 1000 { jump } else { 0.0 });
                let (stamp, stepped) = stamp(&mut fit, k * 10_000_000, arrival);
                steps.extend(stepped);
                last_error = stamp.seconds_since(arrival);
            }
            assert_eq!(steps.len(), 1, "{jump}");
            assert!((steps[0] - jump).abs() < 1e-3);
            assert!(last_error.abs() < 1e-3, "{jump}: {last_error}");
        }
    }

    #[test]
    fn a_host_that_slept_finds_its_messages_late_and_its_clock_right() {
        let start = Stamp::from_nanos(1_760_001_000_000_000_000);
        for sleep in [0.5, 1.5, 3.0, 10.0] {
            let mut fit = ClockFit::new(ClockFitConfig::default());
            for k in 0..4000_i64 {
                let t = k as f64 * 0.01;
                // From 10 s on nothing is read for a while, then all at once.
                let arrival = if t > 10.0 && t < 10.0 + sleep { 10.0 + sleep + 1e-5 * k as f64 } else { t };
                let (stamp, stepped) = stamp(&mut fit, k * 10_000_000, start.plus_seconds(arrival));
                assert_eq!(stepped, None, "{sleep} {t}");
                let error = stamp.seconds_since(start) - t;
                assert!(error.abs() < 1e-4, "{sleep} {t}: {error}");
            }
        }
    }

    #[test]
    fn a_restart_never_goes_back_and_forgets_the_old_offset() {
        let start = Stamp::from_nanos(0);
        let mut fit = ClockFit::new(ClockFitConfig::default());
        let first = stamp(&mut fit, 1_000_000_000, start.plus_seconds(10.0)).0;
        fit.restart();
        let second = stamp(&mut fit, 0, start.plus_seconds(10.0)).0;
        assert!(second > first);
        let third = stamp(&mut fit, 500_000_000, start.plus_seconds(10.5)).0;
        assert!(third.seconds_since(start.plus_seconds(10.5)).abs() < 1e-5);
    }
}
