//! Serial line and adapter between the simulated IMU and the host.

use super::SimulatedImuConfig;
use rig_model::Stamp;
use std::collections::VecDeque;

/// Line settings of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Line {
    /// Baud rate.
    pub baud: u32,
    /// Two stop bits instead of one.
    pub two_stop_bits: bool,
}

impl Line {
    /// Settings of a port that is not open.
    pub const CLOSED: Self = Self { baud: 0, two_stop_bits: false };
}

/// Transmission from the IMU to the host.
#[derive(Default)]
pub(super) struct Wire {
    /// Baud rate in effect; that in flash takes effect on a reset.
    pub baud: u32,
    /// Time at which the line is free.
    pub free: Stamp,
    /// A broken wire: nothing arrives.
    pub mute: bool,
    /// Bytes on their way to the host, with their time of arrival.
    pub arrivals: VecDeque<(Stamp, Vec<u8>)>,
    next_burst: Option<Stamp>,
    /// State of a xorshift generator: the model has no clock or random source.
    random: u64,
    just_opened: bool,
}

impl Wire {
    pub(super) fn new(baud: u32, now: Stamp) -> Self {
        Self { baud, free: now, random: 0x9E37_79B9_7F4A_7C15, ..Self::default() }
    }

    /// The host has opened the port: of a message in transmission it receives the end only.
    pub(super) fn opened(&mut self, now: Stamp) {
        self.just_opened = self.free > now && !self.arrivals.is_empty();
    }

    /// Time of the next arrival.
    pub(super) fn next_arrival(&self) -> Option<Stamp> {
        self.arrivals.front().map(|(at, _)| *at)
    }

    /// Next bytes that have arrived by `now`, corrupted if the baud rates differ.
    pub(super) fn receive(&mut self, line: Line, now: Stamp) -> Option<Vec<u8>> {
        self.next_arrival().filter(|at| *at <= now)?;
        let (_, mut bytes) = self.arrivals.pop_front()?;
        if std::mem::take(&mut self.just_opened) {
            bytes.drain(..bytes.len() * 2 / 3);
        }
        if self.mute {
            bytes.clear();
        }
        if line.baud != self.baud {
            for byte in &mut bytes {
                *byte = byte.rotate_left(3) ^ 0xA5;
            }
        }
        Some(bytes)
    }

    /// Transmits bytes as soon as the line is free after `at`; returns the time of the last bit.
    pub(super) fn transmit(
        &mut self,
        mut bytes: Vec<u8>,
        at: Stamp,
        config: &SimulatedImuConfig,
    ) -> Stamp {
        let start = at.max(self.free);
        let byte_time = 10.0 / f64::from(self.baud);
        let sent = start.plus_seconds(bytes.len() as f64 * byte_time);
        self.free = sent;
        let Some(period) = config.burst.filter(|period| *period > 0.0) else {
            self.arrive(sent, bytes);
            return sent;
        };
        // The adapter forwards the bytes that it has at the end of each period, also parts of
        // messages.
        let mut before = 0;
        while !bytes.is_empty() {
            let next_byte = start.plus_seconds((before + 1) as f64 * byte_time);
            let burst = self.burst_after(next_byte, period, config.burst_jitter);
            let received = (burst.seconds_since(start) / byte_time + 1e-6) as usize;
            let count = received.saturating_sub(before).clamp(1, bytes.len());
            let rest = bytes.split_off(count);
            before += count;
            self.arrive(burst, bytes);
            bytes = rest;
        }
        sent
    }

    /// Queues an arrival; an adapter preserves the order.
    fn arrive(&mut self, at: Stamp, bytes: Vec<u8>) {
        let at = self.arrivals.back().map_or(at, |(last, _)| at.max(*last));
        self.arrivals.push_back((at, bytes));
    }

    fn burst_after(&mut self, sent: Stamp, period: f64, jitter: f64) -> Stamp {
        let mut burst = self.next_burst.unwrap_or(sent);
        while burst < sent {
            self.random ^= self.random << 13;
            self.random ^= self.random >> 7;
            self.random ^= self.random << 17;
            let share = (self.random >> 11) as f64 / (1_u64 << 53) as f64;
            burst = burst.plus_seconds(period + share * jitter);
        }
        self.next_burst = Some(burst);
        burst
    }
}
