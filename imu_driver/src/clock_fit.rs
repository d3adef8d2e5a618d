//! Fit of the device's clock to the host's: device time and arrival of each sample → host stamp
//! without the jitter of the arrival.
//!
//! `arrival − device time` is the offset of the two clocks, plus their drift, plus a delay ≥ 0
//! (latency timer of the adapter, scheduler). The fit is the line below all points with the
//! smallest sum of distances, a linear program in two unknowns. Its solution is the edge of the
//! lower convex hull over the mean of the abscissas (Zhang, Liu, Xia, "Clock synchronization
//! algorithms for network measurements", INFOCOM 2002).
//!
//! On a busy host all of the first samples can be late by tens of milliseconds.
//! [`ClockFit::is_settled`] indicates when enough samples have been observed; until then the caller
//! keeps the samples: [`ClockFit::observe`] on arrival, [`ClockFit::stamp`] once settled.
//!
//! A delay common to *all* samples is not observable. The caller subtracts the transmission time.
//! If complete messages arrive in bursts synchronous with the samples (periods of 16 ms and 10 ms
//! have five phases, 2 ms apart), all offsets within 2 ms have the same arrivals until the clocks
//! have drifted by as much (67 s at 30 ppm): no estimator is better than 2 ms / √12 = 0.58 ms RMS
//! over the possible phases; this one assumes the earliest, 1.15 ms RMS and 2 ms at worst. The
//! driver avoids this case with messages that a burst *splits*, whose begin is known to one byte
//! time.

use rig_model::Stamp;
use std::collections::VecDeque;

/// Time window of the samples used, s.
const WINDOW: f64 = 120.0;
/// Largest drift between the clocks, s/s.
pub const MAX_DRIFT: f64 = 150e-6;
/// Largest correction of a stamp towards a new fit, relative to the time since the last stamp.
const SLEW: f64 = 0.1;
/// Difference between arrivals and fit, s, which, if it lasts, means that a clock was set or the
/// device restarted.
const STEP: f64 = 0.1;
/// Arrival before the fit, s, beyond which the host's clock was set back; a smaller difference
/// means that all samples before were late.
const STEP_BACK: f64 = 1.0;
/// Largest delay relative to the fastest sample, s, of the consistent samples of a settled fit.
const CONSISTENCY: f64 = 0.3e-3;
/// Number of consistent samples of a settled fit: the delays of a busy host vary.
const CONSISTENT: usize = 5;
/// Shortest time from the first sample to a settled fit, s.
const SETTLING: f64 = 0.2;
/// Longest time from the first sample to a settled fit, s, for irregular adapters.
const LONGEST_SETTLING: f64 = 1.0;
/// Duration over which only the earliest arrival is a point of the fit, s, which bounds the memory.
const BUCKET: f64 = 0.5;

#[derive(Clone, Copy, Debug)]
struct Point {
    /// Device time since the origin, s.
    x: f64,
    /// Arrival minus device time, relative to the origin, s.
    y: f64,
}

#[derive(Clone, Copy, Debug)]
struct Origin {
    device: i64,
    host: Stamp,
}

/// Number of points, one per [`BUCKET`], from which on a drift beyond the limit is no jitter of the
/// arrivals: 1.5 ms of it over 10 s are the default limit.
const DRIFT_POINTS: usize = 20;

/// Largest number of samples until the fit counts as settled.
const MOST_SETTLING: usize = 512;

/// Decision whether the first samples determine the offset.
#[derive(Clone, Debug)]
struct Settling {
    /// Arrival minus device time of the first samples, s.
    delays: Vec<f64>,
    settled: bool,
}

impl Settling {
    fn observe(&mut self, point: Point) {
        if self.settled {
            return;
        }
        self.delays.push(point.y);
        let fastest = self.delays.iter().copied().fold(f64::INFINITY, f64::min);
        let consistent = self.delays.iter().filter(|d| **d - fastest < CONSISTENCY).count();
        self.settled = point.x >= LONGEST_SETTLING
            || self.delays.len() >= MOST_SETTLING
            || point.x >= SETTLING && consistent >= CONSISTENT;
    }
}

/// Fit of host time to device time.
#[derive(Clone, Debug)]
pub struct ClockFit {
    /// Time until a difference counts as a clock step, s.
    patience: f64,
    origin: Option<Origin>,
    points: VecDeque<Point>,
    hull: Vec<Point>,
    /// Offset at the origin (s) and drift (s/s).
    line: (f64, f64),
    /// The drift of the points exceeds [`MAX_DRIFT`].
    limited: bool,
    /// Correction of the last stamp, s, which follows the line with a limited slew.
    applied: f64,
    /// Device time of the last stamp since the restart, ns.
    last_device: Option<i64>,
    last_stamp: Option<Stamp>,
    last_arrival: Option<Stamp>,
    /// First point of a suspected step, and the smallest distance from the line since then, s.
    suspicious: Option<(Point, f64)>,
    settling: Settling,
}

impl ClockFit {
    /// Creates a fit without samples; a difference between arrivals and fit counts as a clock step
    /// after `patience` seconds.
    pub fn new(patience: f64) -> Self {
        let capacity = (WINDOW / BUCKET).ceil() as usize + 2;
        Self {
            patience,
            origin: None,
            points: VecDeque::with_capacity(capacity),
            hull: Vec::with_capacity(capacity),
            line: (0.0, 0.0),
            limited: false,
            applied: 0.0,
            last_device: None,
            last_stamp: None,
            last_arrival: None,
            suspicious: None,
            settling: Settling { delays: Vec::with_capacity(MOST_SETTLING), settled: false },
        }
    }

    /// Restarts the fit after a restart of the device or a new connection; stamps keep increasing.
    pub fn restart(&mut self) {
        let Self { patience, last_stamp, last_arrival, .. } = *self;
        *self = Self { last_stamp, last_arrival, ..Self::new(patience) };
    }

    /// Drift of the device's clock, s/s, positive if it is slow; `None` in the first seconds.
    pub fn drift(&self) -> Option<f64> {
        (self.points.len() >= 10).then_some(self.line.1)
    }

    /// Whether the clocks drift by more than [`MAX_DRIFT`]: the rate of messages is not the assumed
    /// one, or a clock is wrong. Stamps do not follow.
    pub fn drift_exceeded(&self) -> bool {
        self.limited && self.points.len() >= DRIFT_POINTS
    }

    /// Detects a step of a clock and returns its size, s; [`ClockFit::step`] must follow then.
    ///
    /// `device`: unwrapped device time of a sample, ns; `arrival`: its arrival.
    pub fn jump(&mut self, device: i64, arrival: Stamp) -> Option<f64> {
        let point = point_of(&self.origin?, device, arrival);
        let above = point.y - (self.line.0 + self.line.1 * point.x);
        if above < -STEP_BACK {
            return Some(above);
        }
        if above < STEP {
            self.suspicious = None;
            return None;
        }
        let (since, smallest) = self.suspicious.unwrap_or((point, above));
        let smallest = smallest.min(above);
        self.suspicious = Some((since, smallest));
        // By both clocks: a host that slept reads seconds of late messages from its buffers at
        // once.
        let by_device = point.x - since.x;
        let by_host = by_device + point.y - since.y;
        (by_device.min(by_host) > self.patience).then_some(smallest)
    }

    /// Restarts the fit after a step of `jump` seconds, detected by a sample that arrived at
    /// `arrival`.
    ///
    /// Stamps follow a host's clock that was set back.
    pub fn step(&mut self, jump: f64, arrival: Stamp) {
        self.restart();
        // After the host's clock was set back, stamps that keep increasing would be constant for as
        // long. If the device's clock jumped ahead instead, they continue.
        let earlier = self.last_arrival.is_some_and(|last| arrival.seconds_since(last) < -STEP);
        if jump < 0.0 && earlier {
            self.last_stamp = None;
        }
    }

    /// Adds a sample: device time, ns, and arrival.
    pub fn observe(&mut self, device: i64, arrival: Stamp) {
        let origin = self.origin.get_or_insert(Origin { device, host: arrival });
        let point = point_of(origin, device, arrival);
        if self.add(point) {
            self.fit();
        }
        self.settling.observe(point);
        self.last_arrival = Some(arrival);
    }

    /// Whether enough samples were observed for valid stamps.
    pub fn is_settled(&self) -> bool {
        self.settling.settled
    }

    /// Host stamp of an observed sample with device time `device`, ns: the time at which it was
    /// ready for transmission. Strictly increasing.
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
                // A large error (the first samples were late) is corrected faster, but never
                // backwards.
                let far = (target - self.applied).abs() > 5e-3;
                let limit = if far { 0.5 } else { SLEW } * elapsed;
                self.applied + (target - self.applied).clamp(-limit, limit)
            }
            None => target,
        };
        self.last_device = Some(device);
        let unconstrained = origin.host.plus_seconds(x + self.applied);
        let stamp = match self.last_stamp {
            // Later by at least a microsecond.
            Some(last) => {
                unconstrained.max(Stamp::from_nanos(last.as_nanos().saturating_add(1_000)))
            }
            None => unconstrained,
        };
        self.last_stamp = Some(stamp);
        stamp
    }

    /// Adds a point; returns whether the points of the fit have changed.
    fn add(&mut self, point: Point) -> bool {
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
                while self.points.front().is_some_and(|p| point.x - p.x > WINDOW) {
                    self.points.pop_front();
                }
                self.points.push_back(point);
                true
            }
        }
    }

    fn fit(&mut self) {
        // Lower hull from left to right: a point above the chord of its neighbors is removed.
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
        self.limited = drift.abs() > MAX_DRIFT;
        let drift = drift.clamp(-MAX_DRIFT, MAX_DRIFT);
        // The highest line of that drift below all points.
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
mod tests;
