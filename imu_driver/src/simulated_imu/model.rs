//! States and data of the simulated IMU.

use super::{
    SimulatedImuConfig, SimulatedSample, Source,
    line::{Line, Wire},
};
use crate::{
    orientation::enu_from_global,
    protocol::{
        Attitude, FrameParser, GlobalFrame, Measurement, MessageId, NumberFormat, Orientation,
        Status,
        configuration::TICKS_PER_SECOND,
        frame,
        mtdata2::{self, xdi},
    },
};
use nalgebra::UnitQuaternion;
use rig_model::Stamp;
use std::collections::VecDeque;

/// Sample sent, with its true times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SentSample {
    /// Message counter.
    pub counter: u16,
    /// Time of measurement (host clock).
    pub measured: Stamp,
    /// Time of its last bit on the line.
    pub sent: Stamp,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum State {
    /// Ignores requests until then, when it sends WakeUp.
    Booting {
        until: Stamp,
    },
    /// Waits for WakeUpAck until then.
    Waking {
        until: Stamp,
    },
    Config,
    /// The next message is number `next` since `since`.
    Measuring {
        since: Stamp,
        next: u64,
    },
}

/// Simulated IMU.
pub struct SimulatedImu {
    pub(super) config: SimulatedImuConfig,
    pub(super) state: State,
    parser: FrameParser,
    source: Source,
    pub(super) wire: Wire,
    pub(super) counter: u16,
    /// Pending replies: due time and bytes.
    replies: VecDeque<(Stamp, Vec<u8>)>,
    /// Time at which GoToConfig is acknowledged; data are sent until then.
    pub(super) config_at: Option<Stamp>,
    /// The newest samples sent, with their true times.
    sent: VecDeque<SentSample>,
    pub(super) flash_writes: u32,
}

impl SimulatedImu {
    /// Creates a device that is powered up at `now`.
    pub fn new(config: SimulatedImuConfig, source: Source, now: Stamp) -> Self {
        let state = if config.already_measuring {
            State::Measuring { since: now, next: 0 }
        } else {
            State::Booting { until: now.plus_seconds(config.boot) }
        };
        Self {
            wire: Wire::new(config.baud, now),
            counter: config.first_counter,
            state,
            parser: FrameParser::new(),
            source,
            replies: VecDeque::new(),
            config_at: None,
            sent: VecDeque::new(),
            flash_writes: 0,
            config,
        }
    }

    /// Processes bytes from the host.
    pub fn handle(&mut self, bytes: &[u8], line: Line, now: Stamp) {
        self.advance(now);
        let one_stop_bit = self.config.needs_two_stop_bits && !line.two_stop_bits;
        if line.baud != self.wire.baud
            || one_stop_bit
            || matches!(self.state, State::Booting { .. })
        {
            // Framing errors, or no power.
            return;
        }
        let mut requests = Vec::new();
        self.parser.parse(bytes, |f| requests.push((f.message, f.data.to_vec())));
        for (message, data) in requests {
            if self.config.ignored_requests > 0 {
                self.config.ignored_requests -= 1;
            } else {
                self.answer(message, &data, now);
            }
        }
    }

    /// Returns the next bytes that have reached the host by `now`; corrupted at another baud rate.
    pub fn poll(&mut self, line: Line, now: Stamp) -> Option<Vec<u8>> {
        self.advance(now);
        self.wire.receive(line, now)
    }

    /// Time of the next output of [`SimulatedImu::poll`] or change of state.
    pub fn next_deadline(&self) -> Option<Stamp> {
        let by_reply = self.replies.front().map(|(at, _)| *at);
        let by_state = match self.state {
            State::Booting { until } | State::Waking { until } => Some(until),
            State::Config => None,
            State::Measuring { since, next } => Some(self.sample_time(since, next)),
        };
        [by_state, by_reply, self.wire.next_arrival()].into_iter().flatten().min()
    }

    /// Switches the device off and on: the settings in flash take effect, the counter restarts.
    pub fn power_cycle(&mut self, now: Stamp) {
        self.wire.arrivals.clear();
        self.replies.clear();
        self.config_at = None;
        self.parser.reset();
        self.wire.baud = self.config.baud;
        self.counter = self.config.first_counter;
        self.wire.free = now;
        self.state = State::Booting { until: now.plus_seconds(self.config.boot) };
    }

    /// Reports that the host has opened its port: it receives the end of a message only.
    pub fn opened(&mut self, now: Stamp) {
        self.advance(now);
        self.wire.opened(now);
    }

    /// Breaks or repairs the wire to the host.
    pub fn set_mute(&mut self, mute: bool) {
        self.wire.mute = mute;
    }

    /// Transmits arbitrary bytes.
    pub fn inject(&mut self, bytes: &[u8], now: Stamp) {
        self.transmit(bytes.to_vec(), now);
    }

    /// Returns the samples sent since the last call.
    pub fn take_sent(&mut self) -> Vec<SentSample> {
        self.sent.drain(..).collect()
    }

    /// Number of settings written to flash.
    pub fn flash_writes(&self) -> u32 {
        self.flash_writes
    }

    /// Configuration, including the settings in flash.
    pub fn config(&self) -> &SimulatedImuConfig {
        &self.config
    }

    fn sample_time(&self, since: Stamp, n: u64) -> Stamp {
        let Some(ticks) = self.config.ticks_per_message() else {
            // On request only.
            return Stamp::from_nanos(i64::MAX);
        };
        let seconds = n as f64 * ticks / TICKS_PER_SECOND;
        since.plus_seconds(seconds / (1.0 + self.config.clock_ppm * 1e-6))
    }

    fn advance(&mut self, now: Stamp) {
        loop {
            self.advance_state(self.replies.front().map_or(now, |(at, _)| now.min(*at)));
            match self.replies.front() {
                Some((at, _)) if *at <= now => {
                    if let Some((at, bytes)) = self.replies.pop_front() {
                        self.transmit(bytes, at);
                    }
                }
                _ => return,
            }
        }
    }

    fn advance_state(&mut self, now: Stamp) {
        loop {
            match self.state {
                State::Booting { until } if until <= now => {
                    self.transmit(frame(MessageId::WAKE_UP, &[]), until);
                    self.state = State::Waking { until: until.plus_seconds(0.5) };
                }
                State::Waking { until } if until <= now => {
                    self.state = State::Measuring { since: until, next: 0 };
                }
                State::Measuring { since, next } => {
                    let at = self.sample_time(since, next);
                    if let Some(stop) = self.config_at.filter(|stop| *stop <= at.min(now)) {
                        self.config_at = None;
                        self.state = State::Config;
                        self.wire.free = self.wire.free.max(stop);
                        return;
                    }
                    if at > now {
                        return;
                    }
                    self.measure(at);
                    self.state = State::Measuring { since, next: next + 1 };
                }
                _ => return,
            }
        }
    }

    fn measure(&mut self, at: Stamp) {
        let sample = (self.source)(at);
        let measurement = self.measurement(&sample, at);
        let mut data = Vec::with_capacity(256);
        let message = if let Some(outputs) = self.config.mtdata2() {
            let bits = outputs.iter().map(|o| o.id).find(|id| *id >= 0x2000).unwrap_or(0);
            let format = NumberFormat::from_bits(u32::from(bits));
            mtdata2::encode(&measurement, format, &mut data);
            MessageId::MT_DATA2
        } else {
            self.config.format.encode(&measurement, &mut data);
            MessageId::MT_DATA
        };
        let sent = self.transmit(frame(message, &data), at);
        if self.sent.len() >= 1 << 20 {
            self.sent.pop_front();
        }
        self.sent.push_back(SentSample { counter: self.counter, measured: at, sent });
        self.counter = self.counter.wrapping_add(1);
    }

    fn measurement(&self, s: &SimulatedSample, at: Stamp) -> Measurement {
        let outputs = self.config.mtdata2();
        let sends =
            |id: u16| outputs.is_none_or(|outputs| outputs.iter().any(|o| o.id & 0xFFF0 == id));
        let settings = self.config.format.settings;
        let (frame, form) = match outputs {
            Some(_) => (GlobalFrame::EastNorthUp, Some(Attitude::Quaternion([1.0, 0.0, 0.0, 0.0]))),
            None => (settings.global_frame(), settings.identity()),
        };
        let q = enu_from_global(frame).inverse() * s.enu_from_imu;
        let orientation = form
            .filter(|_| sends(xdi::QUATERNION))
            .map(|form| Orientation { attitude: attitude(form, &q), frame });
        let ticks = (at.as_nanos() as f64 * (1.0 + self.config.clock_ppm * 1e-6) / 1e5).round();
        Measurement {
            counter: sends(xdi::COUNTER).then_some(self.counter),
            sample_time_fine: sends(xdi::SAMPLE_TIME_FINE)
                .then_some((ticks as i64).rem_euclid(1 << 32) as u32),
            acceleration: sends(xdi::ACCELERATION).then_some(s.specific_force.into()),
            angular_velocity: sends(xdi::ANGULAR_VELOCITY).then_some(s.angular_velocity.into()),
            magnetic_field: sends(xdi::MAGNETIC_FIELD).then_some(s.magnetic_field.into()),
            temperature: sends(xdi::TEMPERATURE).then_some(s.temperature),
            orientations: [orientation, None, None],
            status: sends(xdi::STATUS_WORD)
                .then_some(Status::SELF_TEST_PASSED | Status::FILTER_VALID),
            ..Measurement::default()
        }
    }

    /// Queues a reply; replies keep their order.
    pub(super) fn reply(&mut self, message: MessageId, data: &[u8], due: Stamp) {
        let due = self.replies.back().map_or(due, |(last, _)| due.max(*last));
        self.replies.push_back((due, frame(message, data)));
    }

    fn transmit(&mut self, bytes: Vec<u8>, at: Stamp) -> Stamp {
        self.wire.transmit(bytes, at, &self.config)
    }

    /// Whether the baud rate is sufficient for the configured data.
    pub(super) fn line_carries_stream(&self) -> bool {
        let data = match self.config.mtdata2() {
            Some(outputs) => mtdata2::data_length(outputs),
            None => self.config.format.data_length(),
        };
        let time = (data + 5) as f64 * 10.0 / f64::from(self.wire.baud);
        self.config.ticks_per_message().is_none_or(|ticks| time <= ticks / TICKS_PER_SECOND)
    }
}

/// Attitude in the form of another one.
fn attitude(form: Attitude, q: &UnitQuaternion<f64>) -> Attitude {
    match form {
        Attitude::Quaternion(_) => Attitude::Quaternion([q.w, q.i, q.j, q.k]),
        Attitude::Euler(_) => {
            let (roll, pitch, yaw) = q.euler_angles();
            Attitude::Euler([roll, pitch, yaw].map(f64::to_degrees))
        }
        Attitude::Matrix(_) => {
            let m = q.to_rotation_matrix();
            let mut columns = [0.0; 9];
            columns.copy_from_slice(m.matrix().as_slice());
            Attitude::Matrix(columns)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::{OutputEntry, OutputSettings};

    #[test]
    fn the_form_of_legacy_settings_does_not_apply_to_mtdata2() {
        let outputs = Some(vec![OutputEntry { id: xdi::QUATERNION, rate: 100 }]);
        let mut config = SimulatedImuConfig { outputs, ..SimulatedImuConfig::default() };
        // Euler angles.
        config.format.settings = OutputSettings::from_bits_retain(1 << 2);
        let sample = SimulatedSample::stationary();
        let imu = SimulatedImu::new(config, Box::new(move |_| sample), Stamp::default());
        let orientation = imu.measurement(&sample, Stamp::default()).orientations[0];
        let attitude = orientation.map(|orientation| orientation.attitude);
        assert!(matches!(attitude, Some(Attitude::Quaternion(_))), "{attitude:?}");
    }
}
