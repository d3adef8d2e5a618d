//! Measurement state: data messages → samples with stamps, and statistics.

use super::{Driver, Event, Identity, Output, Phase, Sample, sample_of};
use crate::{
    clock_fit::ClockFit,
    device_time::DeviceTime,
    protocol::{
        Decoder, DeviceError, Frame, MessageId, ParserCounts, Status, configuration::message_rate,
        mtdata2::xdi,
    },
};
use rig_model::Stamp;
use std::collections::VecDeque;

/// Consecutive undecodable messages after which the configuration is read again.
const UNREADABLE_LIMIT: u32 = 5;
/// Consecutive messages without acceleration or angular velocity after which they are reported.
const INERTIAL_MISSING_LIMIT: u32 = 100;
/// Time without data after which the device counts as silent, s; at least five message periods.
const SILENCE: f64 = 0.5;
/// Interval at which a drift beyond the limit is reported, s.
const DRIFT_INTERVAL: f64 = 10.0;

/// Counts since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Statistics {
    /// Samples output.
    pub samples: u64,
    /// Missing messages, according to the counter, or to the time if there is none.
    pub lost: u64,
    /// Messages received twice.
    pub repeated: u64,
    /// Valid frames that could not be decoded.
    pub unreadable: u64,
    /// Number of times that the measurement state was entered.
    pub connections: u64,
    /// Counts of the frame parser.
    pub parser: ParserCounts,
    /// The newest status bits.
    pub status: Option<Status>,
    /// Drift of the device's clock, ppm, positive if it is slow; `None` until it is known.
    pub drift_ppm: Option<f64>,
    /// The drift exceeds the largest one of the clock fit: stamps are wrong.
    pub drift_exceeded: bool,
    /// Configured message rate, Hz.
    pub rate: f64,
}

#[derive(Debug)]
pub(super) struct Stream {
    decoder: Decoder,
    time: DeviceTime,
    /// Periods of the increments of velocity and orientation, s.
    increments: [f64; 2],
    clock: ClockFit,
    /// Device time (ns) and sample, until the clock fit has settled.
    waiting: VecDeque<(i64, Sample)>,
    last_data: f64,
    /// The device sends on request only, which the driver never makes: silence is no fault of the
    /// connection.
    pub on_request: bool,
    unreadable_in_a_row: u32,
    inertial_missing: u32,
    drift_reported_at: f64,
    statistics: Statistics,
}

impl Stream {
    pub(super) fn new(step_patience: f64) -> Self {
        Self {
            decoder: Decoder::default(),
            time: DeviceTime::new(1152, 115_200),
            increments: [0.01; 2],
            clock: ClockFit::new(step_patience),
            waiting: VecDeque::new(),
            last_data: 0.0,
            on_request: false,
            unreadable_in_a_row: 0,
            inertial_missing: 0,
            drift_reported_at: f64::NEG_INFINITY,
            statistics: Statistics::default(),
        }
    }

    pub(super) fn begin(&mut self, identity: &Identity, now: f64) {
        // Without outputs an MTi-10 or 100 sends legacy messages, at the rate of its Configuration.
        // A rate of zero or FFFF is that of every message.
        let ticks = identity.configuration.and_then(|c| c.ticks_per_message());
        self.time = match identity.outputs.as_deref().and_then(message_rate) {
            Some(rate) => DeviceTime::new(1, u32::from(rate)),
            None => DeviceTime::new(ticks.unwrap_or(1152), 115_200),
        };
        self.increments = [xdi::DELTA_VELOCITY, xdi::DELTA_ORIENTATION].map(|id| {
            let own = identity.outputs.iter().flatten().find(|o| o.id & 0xFFF0 == id);
            let rate = own.and_then(|output| message_rate(&[*output]));
            rate.map_or(self.time.period(), |rate| 1.0 / f64::from(rate))
        });
        let legacy = identity.outputs.as_ref().is_none_or(Vec::is_empty);
        self.on_request = legacy && identity.configuration.is_some_and(|c| c.is_on_request());
        self.decoder.format = identity.configuration.map(|c| c.format);
        self.clock.restart();
        self.last_data = now;
        self.unreadable_in_a_row = 0;
        self.inertial_missing = 0;
        self.statistics.connections += 1;
        self.statistics.rate = 1.0 / self.time.period();
    }

    pub(super) fn statistics(&self, parser: ParserCounts) -> Statistics {
        Statistics {
            parser,
            drift_ppm: self.clock.drift().map(|d| d * 1e6),
            drift_exceeded: self.clock.drift_exceeded(),
            ..self.statistics
        }
    }

    /// Time without data, s, if it exceeds the limit.
    pub(super) fn silent_for(&self, now: f64) -> Option<f64> {
        let silent = now - self.last_data;
        (!self.on_request && silent > SILENCE.max(5.0 * self.time.period())).then_some(silent)
    }
}

impl Driver {
    pub(super) fn data(&mut self, frame: &Frame<'_>, arrival: Stamp) {
        if frame.message == MessageId::ERROR {
            let error = DeviceError(frame.data.first().copied().unwrap_or_default());
            return self.event(Event::DeviceFault(error));
        }
        // The device sends one stop bit, even if it requires two.
        let byte_time = 10.0 / f64::from(self.connection.baud());
        let on_the_wire = frame.wire_length as f64 * byte_time;
        let begun = self.arrivals.begun(frame.offset, frame.wire_length, byte_time);
        let stream = &mut self.stream;
        let m = match stream.decoder.decode(frame) {
            Ok(Some(m)) => m,
            // A late acknowledgement.
            Ok(None) => return,
            Err(error) => {
                stream.statistics.unreadable += 1;
                stream.unreadable_in_a_row += 1;
                if stream.unreadable_in_a_row >= UNREADABLE_LIMIT {
                    self.event(Event::Unreadable(error.to_string()));
                    self.call(0.0);
                }
                return;
            }
        };
        stream.unreadable_in_a_row = 0;
        stream.last_data = self.time.now;
        if !m.is_inertial() {
            return stream.time.pass(&m);
        }
        // With a delay below the transmission time, the begin of the message is not known.
        let given = self.config.transmission_delay;
        let delay = if given < 0.0 { on_the_wire } else { given };
        let ready = match begun {
            Some(begun) if delay >= on_the_wire => begun.plus_seconds(on_the_wire - delay),
            _ => arrival.plus_seconds(-delay),
        };
        let placed = stream.time.place(&m, arrival);
        if placed.repeated {
            stream.statistics.repeated += 1;
            return;
        }
        let stepped = if placed.restarted { None } else { stream.clock.jump(placed.device, ready) };
        if placed.restarted || stepped.is_some() {
            // Samples of the previous clock.
            self.release();
        }
        let stream = &mut self.stream;
        match stepped {
            Some(jump) => stream.clock.step(jump, ready),
            None if placed.restarted => stream.clock.restart(),
            None => {}
        }
        stream.clock.observe(placed.device, ready);
        let sample = sample_of(&m, ready, stream.increments);
        let statistics = &mut stream.statistics;
        statistics.lost += placed.lost;
        statistics.status = sample.status.or(statistics.status);
        if sample.imu.is_some() {
            statistics.samples += 1;
            stream.inertial_missing = 0;
        } else {
            stream.inertial_missing += 1;
        }
        if placed.restarted {
            self.event(Event::DeviceRestarted);
        }
        if placed.lost > 0 {
            self.event(Event::Lost(placed.lost));
        }
        if let Some(seconds) = stepped {
            self.event(Event::ClockStepped(seconds));
        }
        if self.stream.inertial_missing == INERTIAL_MISSING_LIMIT {
            self.event(Event::NoInertialData);
        }
        let (now, stream) = (self.time.now, &mut self.stream);
        if stream.clock.drift_exceeded() && now - stream.drift_reported_at >= DRIFT_INTERVAL {
            stream.drift_reported_at = now;
            self.event(Event::DriftExceeded);
        }
        self.stream.waiting.push_back((placed.device, sample));
        if self.stream.clock.is_settled() {
            self.release();
        }
        debug_assert!(matches!(self.phase, Phase::Measuring));
    }

    /// Outputs the waiting samples with the current clock fit.
    pub(super) fn release(&mut self) {
        while let Some((device, sample)) = self.stream.waiting.pop_front() {
            let stamp = self.time.on_host_clock(self.stream.clock.stamp(device));
            self.outputs.push_back(Output::Sample(sample.stamped(stamp)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::OutputEntry;

    #[test]
    fn increments_have_the_period_of_their_own_output() {
        let outputs = [(0x4020, 400), (0x4012, 100), (0x8030, u16::MAX)];
        let outputs = outputs.map(|(id, rate)| OutputEntry { id, rate }).to_vec();
        let mut stream = Stream::new(1.0);
        stream.begin(&Identity { outputs: Some(outputs), ..Identity::default() }, 0.0);
        let [velocity, orientation] = stream.increments;
        assert!((velocity - 0.01).abs() < 1e-12 && (orientation - 0.0025).abs() < 1e-12);
    }
}
