//! Driver and simulated IMU, both pure, connected by a simulated host.

use imu_driver::{
    driver::{Driver, DriverConfig, Event, Input, Output, Sample},
    simulated_imu::{Line, SentSample, SimulatedImu, SimulatedImuConfig, SimulatedSample},
};
use nalgebra::{UnitQuaternion, Vector3};
use rig_model::Stamp;

const START: Stamp = Stamp::from_nanos(1_760_001_000_000_000_000);

/// Timing of the host's reads.
#[derive(Default)]
pub struct Host {
    /// Each read is late by 20 µs and up to this, s; 0: not late.
    pub lateness: f64,
    /// An overloaded host, which wakes up milliseconds after the first byte.
    pub busy: bool,
    pub random: u64,
    /// Bytes not read yet, and the time at which they will be.
    pub unread: Vec<u8>,
    wakes_at: Stamp,
    /// Sum of the steps of its clock, s.
    set_by: f64,
}

impl Host {
    /// Uniform random number in 0..1 (xorshift).
    fn share(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// Adds bytes that arrive at `now` on a busy host.
    fn queue(&mut self, bytes: Vec<u8>, now: Stamp) {
        if self.unread.is_empty() {
            let (kind, share) = (self.share(), self.share());
            // Mostly one time slice of other processes, sometimes several, rarely none.
            let delay = match kind {
                k if k < 0.15 => 1e-4,
                k if k < 0.85 => 5e-3,
                _ => 45e-3,
            };
            self.wakes_at = now.plus_seconds(delay * share);
        }
        self.unread.extend(bytes);
    }

    /// Time on the host's clock.
    fn clock(&self, at: Stamp) -> Stamp {
        at.plus_seconds(self.set_by)
    }
}

/// Driver and IMU on one line, and the outputs of the driver.
pub struct Bench {
    pub driver: Driver,
    pub imu: SimulatedImu,
    pub host: Host,
    pub now: Stamp,
    line: Option<Line>,
    pub plugged: bool,
    /// Samples, with stamps as if the clock of the host had not been set.
    pub samples: Vec<Sample>,
    pub events: Vec<Event>,
    pub bauds: Vec<u32>,
    pub written: usize,
}

fn motion(at: Stamp) -> SimulatedSample {
    let t = at.seconds_since(START);
    SimulatedSample {
        specific_force: Vector3::new(t.sin(), t.cos(), 9.81),
        angular_velocity: Vector3::new(0.1, -0.2, 0.3 * t.sin()),
        enu_from_imu: UnitQuaternion::from_euler_angles(0.1, -0.2, 0.3 * t),
        ..SimulatedSample::stationary()
    }
}

impl Bench {
    pub fn new(driver: DriverConfig, imu: SimulatedImuConfig) -> Self {
        Self {
            driver: Driver::new(driver).unwrap(),
            imu: SimulatedImu::new(imu, Box::new(motion), START),
            host: Host { random: 0x9E37_79B9_7F4A_7C15, wakes_at: START, ..Host::default() },
            now: START,
            line: None,
            plugged: true,
            samples: Vec::new(),
            events: Vec::new(),
            bauds: Vec::new(),
            written: 0,
        }
    }

    /// Driver and IMU after `seconds`.
    pub fn after(seconds: f64, driver: DriverConfig, imu: SimulatedImuConfig) -> Self {
        let mut bench = Self::new(driver, imu);
        bench.run(seconds);
        bench
    }

    /// Simulates `seconds`.
    pub fn run(&mut self, seconds: f64) {
        let end = self.now.plus_seconds(seconds);
        while self.now < end {
            let mut step = 0.001;
            if let Some(due) = self.imu.next_deadline() {
                step = due.seconds_since(self.now).clamp(0.000_01, step);
            }
            if !self.host.unread.is_empty() {
                step = self.host.wakes_at.seconds_since(self.now).clamp(0.000_01, step);
            }
            self.now = self.now.plus_seconds(step);
            self.step();
        }
    }

    /// Sets the host's clock, and reports it to the driver if `report`.
    pub fn set_clock(&mut self, by: f64, report: bool) {
        self.host.set_by += by;
        if report {
            self.driver.clock_set((by * 1e9).round() as i64);
        }
    }

    /// Processes everything up to `now`.
    pub fn step(&mut self) {
        let now = self.now;
        self.driver.handle(Input::Tick, self.host.clock(now));
        while let Some(bytes) = self.imu.poll(self.line.unwrap_or(Line::CLOSED), now) {
            if self.line.is_none() || bytes.is_empty() {
                continue;
            }
            if self.host.busy {
                self.host.queue(bytes, now);
                continue;
            }
            let mut arrival = now;
            if self.host.lateness > 0.0 {
                arrival = now.plus_seconds(20e-6 + self.host.lateness * self.host.share());
            }
            self.driver.handle(Input::Bytes(&bytes), self.host.clock(arrival));
        }
        if !self.host.unread.is_empty() && now >= self.host.wakes_at {
            let bytes = std::mem::take(&mut self.host.unread);
            self.driver.handle(Input::Bytes(&bytes), self.host.clock(now));
        }
        while let Some(output) = self.driver.poll() {
            self.output(output);
        }
    }

    fn output(&mut self, output: Output) {
        let (now, at) = (self.now, self.host.clock(self.now));
        match output {
            Output::Open { baud, two_stop_bits } if self.plugged => {
                self.line = Some(Line { baud, two_stop_bits });
                self.imu.opened(now);
                self.driver.handle(Input::Opened, at);
            }
            Output::Open { .. } => {
                self.driver.handle(Input::OpenFailed("no such port"), at);
            }
            Output::Close => self.line = None,
            Output::SetBaud(baud) => {
                self.bauds.push(baud);
                self.line = self.line.map(|line| Line { baud, ..line });
            }
            Output::Write(bytes) => {
                self.written += 1;
                if let Some(line) = self.line {
                    self.imu.handle(&bytes, line, now);
                }
            }
            Output::Sample(mut sample) => {
                sample.stamp = sample.stamp.plus_seconds(-self.host.set_by);
                self.samples.push(sample);
            }
            Output::Event(event) => self.events.push(event),
        }
    }

    /// Removes the adapter.
    pub fn unplug(&mut self) {
        self.plugged = false;
        self.line = None;
        self.driver.handle(Input::Lost("unplugged"), self.host.clock(self.now));
    }

    /// Removes the adapter for `seconds`, and simulates `after` seconds with it.
    pub fn replug(&mut self, seconds: f64, after: f64) {
        self.unplug();
        self.host.unread.clear();
        self.run(seconds);
        self.plugged = true;
        self.run(after);
    }

    pub fn has(&self, f: impl Fn(&Event) -> bool) -> bool {
        self.events.iter().any(f)
    }

    /// Stamp errors of all samples, s.
    pub fn stamp_errors(&mut self) -> Vec<f64> {
        let sent = self.imu.take_sent();
        self.samples.iter().map(|s| s.stamp.seconds_since(truth_of(s, &sent).measured)).collect()
    }

    /// Asserts that every sample equals the truth at its stamp, and that stamps increase.
    pub fn check_truth(&mut self, stamp_tolerance: f64) {
        let sent = self.imu.take_sent();
        assert!(!self.samples.is_empty());
        for pair in self.samples.windows(2) {
            assert!(pair[1].stamp > pair[0].stamp);
        }
        for sample in &self.samples {
            let truth = truth_of(sample, &sent);
            let error = sample.stamp.seconds_since(truth.measured);
            assert!(error.abs() < stamp_tolerance, "{error}");
            let imu = sample.imu.as_ref().unwrap();
            let expected = motion(truth.measured);
            assert!((imu.specific_force - expected.specific_force).norm() < 1e-5);
            assert!((imu.angular_velocity - expected.angular_velocity).norm() < 1e-6);
            if let Some(orientation) = &imu.orientation {
                assert!(orientation.enu_from_imu.angle_to(&expected.enu_from_imu) < 1e-5);
            }
        }
    }
}

/// The sample sent with this counter that is nearest in time.
fn truth_of<'a>(sample: &Sample, sent: &'a [SentSample]) -> &'a SentSample {
    sent.iter()
        .filter(|s| Some(s.counter) == sample.counter)
        .min_by_key(|s| (s.measured.as_nanos() - sample.stamp.as_nanos()).abs())
        .expect("a counter that was sent")
}

/// Root mean square and largest absolute value.
pub fn rms_and_worst(errors: &[f64]) -> (f64, f64) {
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    (rms, errors.iter().fold(0.0, |worst, e| worst.max(e.abs())))
}
