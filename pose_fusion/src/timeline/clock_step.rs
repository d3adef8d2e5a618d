//! Steps of one clock against the other: the IMU's against that of camera and encoders. Lost
//! messages make stamps jump as well, and a slow network changes the lags; only a step does both,
//! and lasts. Equations: `docs/src/equations.md`, "Initialization".

use super::arrival::Source;
use rig_model::Stamp;

/// Smallest step, s: the filter follows a smaller one by itself.
const SMALLEST: f64 = 0.05;
/// Time after a jump in which messages may still arrive that a stalled computer held up, s.
const STALL_SETTLING: f64 = 0.15;
/// Number of images that must all show the new lag.
const IMAGES: u32 = 3;
/// Largest difference between the change of the lag and the step, as a share of the step.
const SHARE: f64 = 0.3;
/// Number of lags whose median is the usual one, the fewest that give one, and the time between two
/// of them, s: a link that is congested for less than five seconds does not change it.
const LAGS: usize = 101;
const FEWEST: usize = 5;
const SPACING: f64 = 0.1;
/// Number of intervals between images whose median is the usual one.
const INTERVALS: usize = 15;
/// A jump of the stamps that is not confirmed within this time is no step of a clock, s.
const FORGOTTEN: f64 = 2.0;

/// Median of the newest `N` numbers.
#[derive(Clone, Copy, Debug)]
struct RunningMedian<const N: usize> {
    newest: [f64; N],
    count: usize,
    next: usize,
}

impl<const N: usize> Default for RunningMedian<N> {
    fn default() -> Self {
        Self { newest: [0.0; N], count: 0, next: 0 }
    }
}

impl<const N: usize> RunningMedian<N> {
    fn add(&mut self, number: f64) {
        self.newest[self.next] = number;
        self.next = (self.next + 1) % N;
        self.count = (self.count + 1).min(N);
    }

    fn median(&self) -> Option<f64> {
        let mut sorted = self.newest;
        let sorted = &mut sorted[..self.count];
        sorted.sort_unstable_by(f64::total_cmp);
        sorted.get(self.count / 2).copied().filter(|_| self.count >= FEWEST)
    }
}

/// Lag of one source: time from the stamp of a message to the newest IMU sample when the message
/// arrives.
#[derive(Clone, Debug, Default)]
struct Lag {
    usual: RunningMedian<LAGS>,
    /// Newest IMU sample when a lag was added last.
    added: Option<Stamp>,
    /// Change since a jump, s.
    changed: Option<f64>,
}

impl Lag {
    /// Adds a lag unless one was added just before, or the IMU is silent: it shrinks then.
    fn add(&mut self, lag: f64, imu: Stamp) {
        if self.added.is_none_or(|added| !(0.0..SPACING).contains(&imu.seconds_since(added))) {
            self.usual.add(lag);
            self.added = Some(imu);
        }
    }
}

/// Jump that may be a step.
#[derive(Clone, Copy, Debug)]
struct Jump {
    /// Change of the time offset, s.
    by: f64,
    /// First IMU sample with the new stamps, or newest one where those of the images jumped.
    at: Stamp,
    /// Time offset before, s.
    offset: f64,
    images: u32,
}

/// Change of the time offset (image time + offset = IMU time) by a step of a clock.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockStep {
    /// Change, s.
    pub by: f64,
    /// Time offset before, s.
    pub offset: f64,
}

/// Stamps and lags of the newest messages.
#[derive(Clone, Debug, Default)]
pub struct ClockSteps {
    imu: Option<Stamp>,
    image: Option<Stamp>,
    /// Time from one image to the next, s.
    interval: RunningMedian<INTERVALS>,
    images: Lag,
    encoders: Lag,
    jump: Option<Jump>,
}

impl ClockSteps {
    /// Notes an IMU sample; `jump`: by how much its stamp is further from the one before than the
    /// IMU's period, s; `offset`: the camera time offset before it, s.
    pub fn imu(&mut self, stamp: Stamp, jump: f64, offset: f64) {
        self.imu = Some(stamp);
        if jump.abs() > SMALLEST {
            self.jumps(jump, stamp, offset);
        }
    }

    fn jumps(&mut self, by: f64, at: Stamp, offset: f64) {
        let (before, offset) = self.jump.map_or((0.0, offset), |jump| (jump.by, jump.offset));
        self.jump = Some(Jump { by: before + by, at, offset, images: 0 });
        (self.images.changed, self.encoders.changed) = (None, None);
    }

    /// By how much the stamp of an image is further from the one before than usual, s.
    fn jump_of_image(&mut self, stamp: Stamp) -> Option<f64> {
        let interval = stamp.seconds_since(self.image.replace(stamp)?);
        let more = self.interval.median().map(|usual| interval - usual);
        self.interval.add(interval);
        more.filter(|more| more.abs() > SMALLEST)
    }

    /// Notes an image or encoder reading as it arrives. Returns the step that it confirms.
    pub fn message(&mut self, source: Source, stamp: Stamp, offset: f64) -> Option<ClockStep> {
        let imu = self.imu?;
        let is_image = source == Source::Image;
        if let Some(by) = if is_image { self.jump_of_image(stamp) } else { None } {
            self.jumps(-by, imu, offset);
        }
        let lag = imu.seconds_since(stamp);
        let source = if is_image { &mut self.images } else { &mut self.encoders };
        let Some(jump) = &mut self.jump else {
            source.add(lag, imu);
            return None;
        };
        let since = imu.seconds_since(jump.at);
        if (0.0..STALL_SETTLING).contains(&since) {
            return None;
        }
        source.changed = source.usual.median().map(|usual| lag - usual);
        let waits = self.encoders.usual.median().is_some() && self.encoders.changed.is_none();
        if !is_image || waits && since < FORGOTTEN {
            return None;
        }
        jump.images += 1;
        let Jump { by, offset, images, .. } = *jump;
        let is_step = |change: f64| (change - by).abs() < SHARE * by.abs();
        if waits
            || by.abs() < SMALLEST
            || !self.images.changed.is_some_and(is_step)
            || !self.encoders.changed.is_none_or(is_step)
        {
            self.jump = None;
        } else if images == IMAGES {
            *self = Self { imu: self.imu, ..Self::default() };
            return Some(ClockStep { by, offset });
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What happens after 2 s.
    #[derive(Clone, Copy, Default)]
    struct Event {
        /// Steps of the clocks of IMU and camera with encoders, s.
        imu: f64,
        camera: f64,
        /// For so long no message is sent of IMU, images and encoders, s.
        lost: [f64; 3],
        /// For so long everything is held up; what is sent then arrives together, s.
        stall: f64,
        /// Later messages of the images and encoders are delayed by this, s.
        delay: [f64; 2],
        /// The same of those in the second before, s.
        congested: [f64; 2],
    }

    /// Returns the steps that are found in 4 s: IMU at 100 Hz, images at 30 Hz, encoders at 50 Hz.
    fn found(event: Event) -> Vec<f64> {
        let mut messages = Vec::new();
        for (kind, period, latency) in [(0, 0.01, 0.002), (1, 0.0333, 0.03), (2, 0.02, 0.005)] {
            for k in 0..(4.0 / period) as usize {
                let t = k as f64 * period;
                let since = t - 2.0;
                if (0.0..event.lost[kind]).contains(&since) {
                    continue;
                }
                let step = if kind == 0 { event.imu } else { event.camera };
                let stamp = 100.0 + t + if since >= 0.0 { step } else { 0.0 };
                let delay = match kind {
                    0 => 0.0,
                    _ if since >= 0.0 => event.delay[kind - 1],
                    _ if since >= -1.0 => event.congested[kind - 1],
                    _ => 0.0,
                };
                let mut arrives = t + latency + delay;
                if (0.0..event.stall).contains(&since) {
                    arrives = 2.0 + event.stall + 1e-3 * kind as f64 + 1e-6 * k as f64;
                }
                messages.push((arrives, kind, stamp));
            }
        }
        messages.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (mut steps, mut result) = (ClockSteps::default(), Vec::new());
        let mut last: Option<f64> = None;
        for (_, kind, stamp) in messages {
            let at = Stamp::from_nanos((stamp * 1e9) as i64);
            if kind == 0 {
                let jump = last.replace(stamp).map_or(0.0, |last| stamp - last - 0.01);
                steps.imu(at, jump, 0.0);
            } else {
                let source = if kind == 1 { Source::Image } else { Source::Encoders };
                result.extend(steps.message(source, at, 0.0).map(|step| step.by));
            }
        }
        result
    }

    #[test]
    fn a_clock_that_steps_alone_is_found_with_its_step() {
        for by in [-0.5, -0.08, 0.08, 0.5] {
            for event in
                [Event { imu: by, ..Event::default() }, Event { camera: -by, ..Event::default() }]
            {
                let found = found(event);
                assert!(found.len() == 1 && (found[0] - by).abs() < 0.01, "{by}: {found:?}");
            }
        }
    }

    #[test]
    fn losses_stalls_delays_and_steps_of_all_clocks_are_no_step() {
        for t in [0.1, 0.3, 0.9] {
            for event in [
                Event { lost: [t, 0.0, 0.0], ..Event::default() },
                Event { lost: [0.0, t, 0.0], ..Event::default() },
                Event { lost: [0.0, 0.0, t], ..Event::default() },
                Event { lost: [t; 3], ..Event::default() },
                Event { stall: t, ..Event::default() },
                Event { stall: t, lost: [t, 0.0, 0.0], ..Event::default() },
                Event { delay: [t, 0.0], ..Event::default() },
                Event { delay: [t; 2], ..Event::default() },
                Event { delay: [t, 0.0], lost: [t, 0.0, 0.0], ..Event::default() },
                Event { congested: [t; 2], lost: [0.0, t, t], ..Event::default() },
                Event { imu: t, camera: t, ..Event::default() },
                Event { imu: -t, camera: -t, ..Event::default() },
            ] {
                let found = found(event);
                assert!(found.is_empty(), "{t}: {found:?}");
            }
        }
    }
}
