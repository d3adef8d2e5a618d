//! The unit's states and its stream.

use super::{FakeSample, FakeUnitConfig, Source};
use crate::{
    orientation::enu_from_global,
    protocol::{
        Attitude, FrameParser, GlobalFrame, Measurement, MessageId, Orientation, OrientationForm, Status,
        configuration::TICKS_PER_SECOND,
        frame::write_frame,
        measurement::RawInertial,
        message::{baud_code, baud_from_code},
        mtdata2,
    },
};
use nalgebra::UnitQuaternion;
use rig_model::Stamp;
use std::collections::VecDeque;

/// How the host's side of the line is set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Baud rate.
    pub baud: u32,
    /// Two stop bits.
    pub two_stop_bits: bool,
}

/// A sample that was sent: the truth for tests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SentSample {
    /// Its counter.
    pub counter: u16,
    /// When it was measured (host clock).
    pub measured: Stamp,
    /// When its last bit was on the line.
    pub sent: Stamp,
    /// When it was really handed to the host, where somebody said so ([`FakeUnit::note_written`]).
    pub written: Option<Stamp>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum State {
    /// Deaf until then; then it says WakeUp.
    Booting {
        until: Stamp,
    },
    /// Waits for WakeUpAck until then.
    Waking {
        until: Stamp,
    },
    Config,
    /// The next message is its `next`-th, counted from `since`.
    Measuring {
        since: Stamp,
        next: u64,
    },
}

/// The unit.
pub struct FakeUnit {
    pub(super) config: FakeUnitConfig,
    pub(super) state: State,
    parser: FrameParser,
    source: Source,
    /// The rate that is in force; the one in flash comes into force by a reset.
    pub(super) baud: u32,
    pub(super) counter: u16,
    line_free: Stamp,
    /// Replies that are being thought about: due, bytes.
    replies: VecDeque<(Stamp, Vec<u8>)>,
    /// The unit streams on until it has acknowledged GoToConfig.
    pub(super) config_at: Option<Stamp>,
    /// When it arrives, what, and of which sample it is.
    outgoing: VecDeque<(Stamp, Vec<u8>, Option<u64>)>,
    /// Samples taken so far, and the one that was handed over last.
    samples: u64,
    handed_over: Option<u64>,
    next_burst: Option<Stamp>,
    dither: u64,
    sent: VecDeque<SentSample>,
    pub(super) flash_writes: u32,
    pub(super) deaf_to: u32,
    mute: bool,
    just_opened: bool,
}

impl std::fmt::Debug for FakeUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("FakeUnit").field("state", &self.state).field("counter", &self.counter).finish()
    }
}

impl FakeUnit {
    /// A unit that gets power at `now`.
    pub fn new(config: FakeUnitConfig, source: Source, now: Stamp) -> Self {
        let state = if config.already_measuring {
            State::Measuring { since: now, next: 0 }
        } else {
            State::Booting { until: now.plus_seconds(config.boot) }
        };
        Self {
            baud: config.baud,
            counter: config.first_counter,
            deaf_to: config.deaf_to,
            state,
            parser: FrameParser::new(),
            source,
            line_free: now,
            replies: VecDeque::new(),
            config_at: None,
            outgoing: VecDeque::new(),
            samples: 0,
            handed_over: None,
            next_burst: None,
            dither: 0x9E37_79B9_7F4A_7C15,
            sent: VecDeque::new(),
            flash_writes: 0,
            mute: false,
            just_opened: false,
            config,
        }
    }

    /// Bytes from the host.
    pub fn handle(&mut self, bytes: &[u8], line: Line, now: Stamp) {
        self.advance(now);
        if line.baud != self.baud || (self.config.needs_two_stop_bits && !line.two_stop_bits) {
            // Framing errors: nothing of it makes sense to the unit.
            return;
        }
        if matches!(self.state, State::Booting { .. }) {
            return;
        }
        let mut requests = Vec::new();
        self.parser.parse(bytes, |f| requests.push((f.bus_id, f.message, f.data.to_vec())));
        for (bus_id, message, data) in requests {
            if self.deaf_to > 0 {
                self.deaf_to -= 1;
                continue;
            }
            self.answer(bus_id, message, &data, now);
        }
    }

    /// The next bytes that have reached the host by `now`. On a host whose baud rate is another one they are garbage.
    pub fn poll(&mut self, line: Line, now: Stamp) -> Option<Vec<u8>> {
        self.advance(now);
        if self.outgoing.front()?.0 > now {
            return None;
        }
        let (_, mut bytes, sample) = self.outgoing.pop_front()?;
        self.handed_over = sample;
        if std::mem::take(&mut self.just_opened) {
            bytes.drain(..bytes.len() * 2 / 3);
        }
        if self.mute {
            return Some(Vec::new());
        }
        if line.baud != self.baud {
            for byte in &mut bytes {
                *byte = byte.rotate_left(3) ^ 0xA5;
            }
        }
        Some(bytes)
    }

    /// When [`FakeUnit::poll`] will next have something, or the state change by itself.
    pub fn next_deadline(&self) -> Option<Stamp> {
        let by_reply = self.replies.front().map(|(at, _)| *at);
        let by_state = match self.state {
            State::Booting { until } | State::Waking { until } => Some(until),
            State::Config => None,
            State::Measuring { since, next } => Some(self.sample_instant(since, next)),
        };
        [by_state, by_reply, self.outgoing.front().map(|(at, ..)| *at)].into_iter().flatten().min()
    }

    /// Off and on again: what stands in flash is in force, the counter starts anew.
    pub fn power_cycle(&mut self, now: Stamp) {
        self.outgoing.clear();
        self.replies.clear();
        self.config_at = None;
        self.parser.reset();
        self.baud = self.config.baud;
        self.counter = self.config.first_counter;
        self.line_free = now;
        self.state = State::Booting { until: now.plus_seconds(self.config.boot) };
    }

    /// The host has opened its port: of the message that is on the wire it gets the end only.
    pub fn opened(&mut self, now: Stamp) {
        self.advance(now);
        self.just_opened = self.line_free > now && !self.outgoing.is_empty();
    }

    /// Says nothing any more (a broken wire), or again.
    pub fn set_mute(&mut self, mute: bool) {
        self.mute = mute;
    }

    /// Puts bytes on the line that no unit sends.
    pub fn inject(&mut self, bytes: &[u8], now: Stamp) {
        self.transmit(bytes.to_vec(), now, None);
    }

    /// Samples sent since the last call: counter and true instants.
    pub fn take_sent(&mut self) -> Vec<SentSample> {
        self.sent.drain(..).collect()
    }

    /// What [`FakeUnit::poll`] gave last was handed to the host at this instant.
    pub fn note_written(&mut self, now: Stamp) {
        let Some(number) = self.handed_over else {
            return;
        };
        let first = self.samples - self.sent.len() as u64;
        let index = number.checked_sub(first).and_then(|i| usize::try_from(i).ok());
        if let Some(sample) = index.and_then(|i| self.sent.get_mut(i)) {
            sample.written = Some(now);
        }
    }

    /// How often a setting was written to flash.
    pub fn flash_writes(&self) -> u32 {
        self.flash_writes
    }

    /// What stands in flash.
    pub fn config(&self) -> &FakeUnitConfig {
        &self.config
    }

    /// Changes what the unit is, e.g. how slowly it answers.
    pub fn config_mut(&mut self) -> &mut FakeUnitConfig {
        &mut self.config
    }

    fn sample_instant(&self, since: Stamp, n: u64) -> Stamp {
        let ticks = self.config.configuration().ticks_per_message().unwrap_or(u32::MAX);
        let seconds = n as f64 * f64::from(ticks) / TICKS_PER_SECOND;
        since.plus_seconds(seconds / (1.0 + self.config.clock_ppm * 1e-6))
    }

    fn advance(&mut self, now: Stamp) {
        loop {
            self.advance_state(self.replies.front().map_or(now, |(at, _)| now.min(*at)));
            match self.replies.front() {
                Some((at, _)) if *at <= now => {
                    if let Some((at, bytes)) = self.replies.pop_front() {
                        self.transmit(bytes, at, None);
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
                    self.send(0xFF, MessageId::WAKE_UP, &[], until);
                    self.state = State::Waking { until: until.plus_seconds(0.5) };
                }
                State::Waking { until } if until <= now => {
                    self.state = State::Measuring { since: until, next: 0 };
                }
                State::Measuring { since, next } => {
                    let at = self.sample_instant(since, next);
                    if let Some(stop) = self.config_at.filter(|stop| *stop <= at.min(now)) {
                        self.config_at = None;
                        self.state = State::Config;
                        self.line_free = self.line_free.max(stop);
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
        let message = if let Some(outputs) = &self.config.outputs {
            let bits = outputs.iter().map(|o| o.id).find(|id| *id >= 0x2000).unwrap_or(0);
            let format = crate::protocol::NumberFormat::from_bits(u32::from(bits));
            mtdata2::encode(&measurement, format, &mut data);
            MessageId::MT_DATA2
        } else {
            self.config.format.encode(&measurement, &mut data);
            MessageId::MT_DATA
        };
        let mut bytes = Vec::with_capacity(data.len() + 7);
        write_frame(0xFF, message, &data, &mut bytes);
        let sent = self.transmit(bytes, at.plus_seconds(self.config.processing), Some(self.samples));
        self.samples += 1;
        if self.sent.len() >= 1 << 20 {
            self.sent.pop_front();
        }
        self.sent.push_back(SentSample { counter: self.counter, measured: at, sent, written: None });
        self.counter = self.counter.wrapping_add(1);
    }

    fn measurement(&self, s: &FakeSample, at: Stamp) -> Measurement {
        let sends = |xdi: u16| match &self.config.outputs {
            Some(outputs) => outputs.iter().any(|o| o.id & 0xFFF0 == xdi),
            None => true,
        };
        let frame = if self.config.outputs.is_some() {
            GlobalFrame::EastNorthUp
        } else {
            self.config.format.settings.global_frame()
        };
        let q = enu_from_global(frame).inverse() * s.enu_from_imu;
        let form = match self.config.outputs {
            Some(_) => Some(OrientationForm::Quaternion),
            None => self.config.format.settings.orientation_form(),
        };
        let ticks = (at.as_nanos() as f64 * (1.0 + self.config.clock_ppm * 1e-6) / 1e5).round();
        let raw = |v: [f64; 3], scale: f64| v.map(|x| (32_768.0 + x * scale).clamp(0.0, 65_535.0) as u16);
        Measurement {
            counter: sends(mtdata2::xdi::COUNTER).then_some(self.counter),
            sample_time_fine: sends(mtdata2::xdi::SAMPLE_TIME_FINE)
                .then_some((ticks as i64).rem_euclid(1 << 32) as u32),
            acceleration: sends(mtdata2::xdi::ACCELERATION).then_some(s.specific_force.into()),
            angular_velocity: sends(mtdata2::xdi::ANGULAR_VELOCITY).then_some(s.angular_velocity.into()),
            magnetic_field: sends(mtdata2::xdi::MAGNETIC_FIELD).then_some(s.magnetic_field.into()),
            temperature: sends(mtdata2::xdi::TEMPERATURE).then_some(s.temperature),
            orientation: if sends(mtdata2::xdi::QUATERNION) {
                form.map(|form| Orientation { attitude: attitude(form, &q), frame })
            } else {
                None
            },
            status: sends(mtdata2::xdi::STATUS_WORD).then_some(Status(3)),
            raw: Some(RawInertial {
                acceleration: raw(s.specific_force.into(), 1000.0),
                angular_velocity: raw(s.angular_velocity.into(), 5000.0),
                magnetic_field: raw(s.magnetic_field.into(), 10_000.0),
                temperature: (s.temperature * 256.0).clamp(0.0, 65_535.0) as u16,
            }),
            ..Measurement::default()
        }
    }

    pub(super) fn send(&mut self, bus_id: u8, message: MessageId, data: &[u8], at: Stamp) {
        let mut bytes = Vec::with_capacity(data.len() + 7);
        write_frame(bus_id, message, data, &mut bytes);
        self.transmit(bytes, at, None);
    }

    /// Sends a reply once it is due; replies keep their order.
    pub(super) fn reply(&mut self, bus_id: u8, message: MessageId, data: &[u8], due: Stamp) {
        let mut bytes = Vec::with_capacity(data.len() + 7);
        write_frame(bus_id, message, data, &mut bytes);
        let due = self.replies.back().map_or(due, |(last, _)| due.max(*last));
        self.replies.push_back((due, bytes));
    }

    /// Puts bytes on the line as soon as it is free after `at`; the instant of the last bit.
    fn transmit(&mut self, bytes: Vec<u8>, at: Stamp, sample: Option<u64>) -> Stamp {
        let start = at.max(self.line_free);
        let sent = start.plus_seconds(bytes.len() as f64 * 10.0 / f64::from(self.baud));
        self.line_free = sent;
        match self.config.burst {
            Some(period) if period > 0.0 => self.collect(bytes, start, period, sample),
            _ => self.hand_over(sent, bytes, sample),
        }
        sent
    }

    /// An adapter keeps the order.
    fn hand_over(&mut self, arrival: Stamp, bytes: Vec<u8>, sample: Option<u64>) {
        let arrival = self.outgoing.back().map_or(arrival, |(last, ..)| arrival.max(*last));
        self.outgoing.push_back((arrival, bytes, sample));
    }

    /// The adapter hands over what bytes it has at the end of each of its periods, be they half a message.
    fn collect(&mut self, mut bytes: Vec<u8>, start: Stamp, period: f64, sample: Option<u64>) {
        let byte_time = 10.0 / f64::from(self.baud);
        let mut before = 0;
        while !bytes.is_empty() {
            let burst = self.burst_after(start.plus_seconds((before + 1) as f64 * byte_time), period);
            let there = (burst.seconds_since(start) / byte_time + 1e-6) as usize;
            let count = there.saturating_sub(before).clamp(1, bytes.len());
            let rest = bytes.split_off(count);
            before += count;
            self.hand_over(burst, bytes, sample.filter(|_| rest.is_empty()));
            bytes = rest;
        }
    }

    fn burst_after(&mut self, sent: Stamp, period: f64) -> Stamp {
        let mut burst = self.next_burst.unwrap_or(sent);
        while burst < sent {
            // xorshift: the model has no clock and no random source of its own.
            self.dither ^= self.dither << 13;
            self.dither ^= self.dither >> 7;
            self.dither ^= self.dither << 17;
            let jitter = (self.dither >> 11) as f64 / (1_u64 << 53) as f64 * self.config.burst_jitter;
            burst = burst.plus_seconds(period + jitter);
        }
        self.next_burst = Some(burst);
        burst
    }

    /// Whether the line can carry the stream that is configured.
    pub(super) fn line_carries_stream(&self) -> bool {
        let rate = self.config.configuration().rate().unwrap_or(0.0);
        let bytes = (self.config.format.data_length() + 5) as f64;
        self.config.outputs.is_some() || bytes * 10.0 * rate <= f64::from(self.baud)
    }

    pub(super) fn set_baud_code(&mut self, code: u8) -> bool {
        let Some(baud) = baud_from_code(code) else {
            return false;
        };
        self.config.baud = baud;
        true
    }

    pub(super) fn baud_code(&self) -> u8 {
        baud_code(self.config.baud).unwrap_or(2)
    }
}

fn attitude(form: OrientationForm, q: &UnitQuaternion<f64>) -> Attitude {
    match form {
        OrientationForm::Quaternion => Attitude::Quaternion([q.w, q.i, q.j, q.k]),
        OrientationForm::Euler => {
            let (roll, pitch, yaw) = q.euler_angles();
            Attitude::Euler([roll, pitch, yaw].map(f64::to_degrees))
        }
        OrientationForm::Matrix => {
            let m = q.to_rotation_matrix();
            let mut columns = [0.0; 9];
            columns.copy_from_slice(m.matrix().as_slice());
            Attitude::Matrix(columns)
        }
    }
}
