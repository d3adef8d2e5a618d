//! Opening the port and calling the device until it acknowledges GoToConfig.

use super::{Driver, DriverConfig, Event, Output, Phase};
use crate::protocol::MessageId;

/// Bytes received within this time after opening belong to the previous stream, s.
const SETTLING: f64 = 0.1;
/// Interval of GoToConfig, s: acknowledged within 0.2 s, and within 1.5 s after power-up (manual).
const CALL_INTERVAL: f64 = 0.25;
/// Time at one baud rate of a search without a valid frame, s.
const SCAN_DWELL: f64 = 0.6;
/// Time until a Reset, with a single baud rate or after a valid frame, s.
const PATIENCE: f64 = 1.8;
/// Interval of GoToConfig after a Reset, s.
const RESET_INTERVAL: f64 = 0.1;
/// Time after a Reset until the device counts as not answering, s.
const RESET_PATIENCE: f64 = 2.5;
/// First pause between two attempts, s.
const FIRST_PAUSE: f64 = 0.1;

/// Baud rates to try, pause between attempts, and events reported so far.
#[derive(Debug, Default)]
pub(super) struct Connection {
    bauds: Vec<u32>,
    index: usize,
    pause: f64,
    longest_pause: f64,
    reported_missing: Option<String>,
    reported_no_answer: bool,
    reported_too_slow: bool,
    /// Baud rate of this search at which valid frames were received, but no answer.
    heard_at: Option<u32>,
}

impl Connection {
    pub(super) fn new(config: &DriverConfig) -> Self {
        Self {
            bauds: config.bauds(),
            pause: FIRST_PAUSE,
            longest_pause: config.longest_pause.max(FIRST_PAUSE),
            ..Self::default()
        }
    }

    pub(super) fn baud(&self) -> u32 {
        self.bauds.get(self.index).copied().unwrap_or(115_200)
    }

    /// Returns the next pause between two attempts, s; it grows up to `longest_pause`.
    pub(super) fn grow_pause(&mut self) -> f64 {
        let pause = self.pause;
        self.pause = (self.pause * 1.6).min(self.longest_pause);
        pause
    }

    /// Starts later searches at the current baud rate, where the device has answered.
    pub(super) fn found(&mut self) {
        let baud = self.bauds.remove(self.index.min(self.bauds.len() - 1));
        self.bauds.insert(0, baud);
        self.index = 0;
        self.reported_no_answer = false;
        self.heard_at = None;
    }

    /// Resets the pauses and what was reported: the device measures, or the port was lost.
    pub(super) fn restart(&mut self) {
        self.pause = FIRST_PAUSE;
        self.reported_no_answer = false;
        self.reported_too_slow = false;
    }
}

/// State of calling the device.
#[derive(Clone, Copy, Debug)]
pub(super) struct Calling {
    since: f64,
    next_call: f64,
    /// A valid frame was received.
    frame_seen: bool,
    /// Bytes skipped before, from the first tick on: a call may come while the parser is moved out.
    pub(super) skipped_before: Option<u64>,
    reset_at: Option<f64>,
}

impl Calling {
    /// A valid frame shows that the device is there: shortens the wait for the next call.
    pub(super) fn frame_received(&mut self, now: f64) {
        self.frame_seen = true;
        if self.reset_at.is_none() {
            self.next_call = self.next_call.min(now + CALL_INTERVAL);
        }
    }
}

impl Driver {
    pub(super) fn opened(&mut self) {
        self.connection.reported_missing = None;
        self.parser.reset();
        self.arrivals.clear();
        self.incomplete_since = None;
        if !self.connection.reported_no_answer {
            self.event(Event::PortOpened(self.connection.baud()));
        }
        self.phase = Phase::Settling { until: self.time.now + SETTLING };
    }

    pub(super) fn open_failed(&mut self, reason: &str) {
        let pause = self.connection.grow_pause();
        if self.connection.reported_missing.as_deref() != Some(reason) {
            self.connection.reported_missing = Some(reason.to_owned());
            self.event(Event::PortMissing { reason: reason.to_owned(), pause });
        }
        self.phase = Phase::Closed { retry_at: self.time.now + pause };
    }

    pub(super) fn lost(&mut self, reason: &str) {
        self.release();
        self.parser.reset();
        self.incomplete_since = None;
        self.connection.restart();
        self.event(Event::PortLost(reason.to_owned()));
        self.phase = Phase::Closed { retry_at: self.time.now + FIRST_PAUSE };
    }

    /// Calls the device, the first time after `delay` seconds.
    pub(super) fn call(&mut self, delay: f64) {
        self.release();
        let first_call = self.time.now + delay;
        self.phase = Phase::Calling(Calling {
            since: first_call,
            next_call: first_call,
            frame_seen: false,
            skipped_before: None,
            reset_at: None,
        });
    }

    /// Reports that the line is too slow for the settings, which are not written, and calls the
    /// device again after a pause.
    pub(super) fn line_too_slow(&mut self, reason: String) {
        if !std::mem::replace(&mut self.connection.reported_too_slow, true) {
            self.event(Event::Found(self.identity.clone()));
            self.event(Event::LineTooSlow(reason));
        }
        self.call_after_pause();
    }

    /// Calls the device after a pause, which grows from one attempt to the next.
    pub(super) fn call_after_pause(&mut self) {
        let pause = self.connection.grow_pause();
        self.call(pause);
    }

    pub(super) fn tick_calling(&mut self, mut calling: Calling) {
        let now = self.time.now;
        let waited = now - calling.since;
        let patience = match calling.reset_at {
            Some(at) => at - calling.since + RESET_PATIENCE,
            None if self.connection.bauds.len() > 1 && !calling.frame_seen => SCAN_DWELL,
            None => PATIENCE,
        };
        if waited > patience {
            if calling.frame_seen && calling.reset_at.is_none() {
                // The device sends, but does not respond to GoToConfig.
                self.write(MessageId::RESET, &[]);
                calling.reset_at = Some(now);
                calling.next_call = now + RESET_INTERVAL;
                self.phase = Phase::Calling(calling);
            } else {
                self.no_answer(calling);
            }
            return;
        }
        if now >= calling.next_call {
            let interval = if calling.reset_at.is_some() { RESET_INTERVAL } else { CALL_INTERVAL };
            calling.next_call = now + interval;
            self.phase = Phase::Calling(calling);
            self.write(MessageId::GO_TO_CONFIG, &[]);
        }
    }

    /// Tries the next baud rate; after the last one, closes the port and pauses.
    fn no_answer(&mut self, calling: Calling) {
        let connection = &mut self.connection;
        if calling.frame_seen {
            connection.heard_at = Some(connection.baud());
        }
        connection.index = (connection.index + 1) % connection.bauds.len().max(1);
        if connection.index > 0 {
            self.outputs.push_back(Output::SetBaud(connection.baud()));
            self.parser.reset();
            return self.call(0.02);
        }
        let heard_at = connection.heard_at.take();
        if !connection.reported_no_answer {
            connection.reported_no_answer = true;
            let bauds = connection.bauds.clone();
            let skipped = self.parser.counts().skipped_bytes;
            let garbage = calling.skipped_before.is_some_and(|before| skipped > before);
            self.event(Event::NoAnswer { bauds, heard_at, garbage });
        }
        // Closed, because the adapter may have been replaced by another one with the same name.
        self.outputs.push_back(Output::Close);
        let pause = self.connection.grow_pause();
        self.phase = Phase::Closed { retry_at: self.time.now + pause };
    }
}
