//! The driver as a state machine without I/O: it says what to open, write and publish, and is told what arrived.
//!
//! ```text
//! Closed ──Open──▶ Settling ──▶ Calling ──GoToConfig's ack──▶ Asking ──▶ Measuring ──▶ samples
//!   ▲  pause grows     ▲           ▲  baud scan, Reset            │            │
//!   └── port lost ─────┴───────────┴── unanswered, silent, woke up, unreadable ┘
//! ```
//!
//! Time enters with the inputs, as the host's clock shows it. Where the shell tells that somebody set that clock
//! ([`Input::ClockSet`]), the stamps follow at once and nothing else does: inside all runs on as if nobody had. Timers run on the
//! sum of small steps, so that a clock that is set unsaid neither hangs nor hurries the driver.

mod arrivals;
pub mod config;
pub mod event;
mod inquiry;
pub mod sample;
mod stream;

pub use config::{ConfigError, DriverConfig};
pub use event::{Event, Identity, Severity};
pub use sample::{Sample, sample_of};
pub use stream::Statistics;

use crate::protocol::{FrameParser, MessageId, frame::frame};
use arrivals::Arrivals;
use inquiry::Inquiry;
use rig_model::Stamp;
use std::collections::VecDeque;
use stream::Stream;

/// What the driver is told.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// The port that was asked for is open.
    Opened {
        /// Now.
        at: Stamp,
    },
    /// It could not be opened.
    OpenFailed {
        /// Now.
        at: Stamp,
        /// Why.
        reason: &'a str,
    },
    /// Bytes came.
    Bytes {
        /// They.
        bytes: &'a [u8],
        /// When they were read.
        arrival: Stamp,
    },
    /// Reading or writing failed; the port is closed.
    Lost {
        /// Now.
        at: Stamp,
        /// Why.
        reason: &'a str,
    },
    /// Nothing came. At least ten a second are needed.
    Tick {
        /// Now.
        at: Stamp,
    },
    /// The host's clock was set: what follows comes by that much later (negative: earlier) than it would have.
    ClockSet {
        /// ns.
        by: i64,
    },
}

/// What the driver says.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Open the port and report [`Input::Opened`] or [`Input::OpenFailed`].
    Open {
        /// At this rate.
        baud: u32,
        /// With two stop bits.
        two_stop_bits: bool,
    },
    /// Close the port.
    Close,
    /// Set the open port to another rate and throw away what it has buffered.
    SetBaud(u32),
    /// Write these bytes.
    Write(Vec<u8>),
    /// A sample.
    Sample(Sample),
    /// Something to tell.
    Event(Event),
}

/// Frames are looked for from here on, bytes before are the old stream's, s.
const SETTLING: f64 = 0.1;
/// GoToConfig is answered within 0.2 s, and up to 1.5 s after power-up.
const CALL_INTERVAL: f64 = 0.25;
/// A rate at which nothing sensible is heard is left after this, s.
const SCAN_DWELL: f64 = 0.6;
/// With one rate only, or where the unit is heard: until it is reset, s.
const PATIENCE: f64 = 1.8;
/// After the Reset, GoToConfig is sent at this interval (s) …
const RESET_INTERVAL: f64 = 0.1;
/// … for so long, s.
const RESET_PATIENCE: f64 = 2.5;
const FIRST_PAUSE: f64 = 0.1;
/// A step of time that is longer is taken for this long: the host slept, the unit did not fall silent, s.
const LONGEST_STEP: f64 = 0.25;

#[derive(Debug)]
enum Phase {
    Closed { retry_at: f64 },
    Opening,
    Settling { until: f64 },
    Calling(Calling),
    Asking(Inquiry),
    Measuring,
}

#[derive(Clone, Copy, Debug)]
struct Calling {
    since: f64,
    next_call: f64,
    heard: bool,
    skipped_before: u64,
    reset_at: Option<f64>,
}

/// The driver of one unit.
#[derive(Debug)]
pub struct Driver {
    config: DriverConfig,
    bauds: Vec<u32>,
    baud_index: usize,
    phase: Phase,
    now: f64,
    /// As if the host's clock had never been set.
    last_input: Option<Stamp>,
    /// By how much it was, in all, ns.
    clock_set_by: i64,
    pause: f64,
    said_missing: Option<String>,
    said_no_answer: bool,
    parser: FrameParser,
    arrivals: Arrivals,
    candidate_since: Option<f64>,
    identity: Identity,
    stream: Stream,
    outputs: VecDeque<Output>,
}

impl Driver {
    /// A driver that will open the port at once.
    ///
    /// # Errors
    /// [`ConfigError`] for a configuration that cannot be.
    pub fn new(config: DriverConfig) -> Result<Self, ConfigError> {
        config.check()?;
        Ok(Self {
            bauds: config.bauds(),
            baud_index: 0,
            phase: Phase::Closed { retry_at: 0.0 },
            now: 0.0,
            last_input: None,
            clock_set_by: 0,
            pause: FIRST_PAUSE,
            said_missing: None,
            said_no_answer: false,
            parser: FrameParser::new(),
            arrivals: Arrivals::new(),
            candidate_since: None,
            identity: Identity::default(),
            stream: Stream::new(config.clock),
            outputs: VecDeque::new(),
            config,
        })
    }

    /// Takes in what happened.
    pub fn handle(&mut self, input: Input<'_>) {
        let at = match input {
            Input::Opened { at }
            | Input::OpenFailed { at, .. }
            | Input::Bytes { arrival: at, .. }
            | Input::Lost { at, .. }
            | Input::Tick { at } => at,
            Input::ClockSet { by } => return self.clock_set(by),
        };
        let at = Stamp::from_nanos(at.as_nanos().saturating_sub(self.clock_set_by));
        let step = self.last_input.map_or(0.0, |last| at.seconds_since(last));
        self.now += step.clamp(0.0, LONGEST_STEP);
        self.last_input = Some(at);
        match input {
            Input::Opened { .. } => self.opened(),
            Input::OpenFailed { reason, .. } => self.open_failed(reason),
            Input::Bytes { bytes, .. } => self.bytes(bytes, at),
            Input::Lost { reason, .. } => self.lost(reason),
            Input::Tick { .. } | Input::ClockSet { .. } => {}
        }
        self.tick();
    }

    fn clock_set(&mut self, by: i64) {
        // Samples that still wait are stamped on the clock that is told from now on.
        self.clock_set_by = self.clock_set_by.saturating_add(by);
        self.event(Event::ClockSet { seconds: by as f64 * 1e-9 });
    }

    /// Nothing more comes (a log has ended): the samples that still wait for the clocks' offset are given as they are.
    pub fn finish(&mut self) {
        self.release();
    }

    /// The next thing to do.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Which unit it is, as far as it is known.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Counts for diagnostics.
    pub fn statistics(&self) -> Statistics {
        self.stream.statistics(self.parser.counts())
    }

    /// Whether samples are coming.
    pub fn is_measuring(&self) -> bool {
        matches!(self.phase, Phase::Measuring)
    }

    /// What it is doing, for people.
    pub fn state(&self) -> &'static str {
        match self.phase {
            Phase::Closed { .. } | Phase::Opening => "waiting for the port",
            Phase::Settling { .. } | Phase::Calling(_) => "calling the unit",
            Phase::Asking(_) => "configuring the unit",
            Phase::Measuring => "measuring",
        }
    }

    fn baud(&self) -> u32 {
        self.bauds.get(self.baud_index).copied().unwrap_or(115_200)
    }

    fn event(&mut self, event: Event) {
        self.outputs.push_back(Output::Event(event));
    }

    fn write(&mut self, message: MessageId, data: &[u8]) {
        self.outputs.push_back(Output::Write(frame(message, data)));
    }

    fn opened(&mut self) {
        self.said_missing = None;
        self.parser.reset();
        self.arrivals.clear();
        self.candidate_since = None;
        if !self.said_no_answer {
            self.event(Event::PortOpened { baud: self.baud() });
        }
        self.phase = Phase::Settling { until: self.now + SETTLING };
    }

    fn open_failed(&mut self, reason: &str) {
        let pause = self.grow_pause();
        if self.said_missing.as_deref() != Some(reason) {
            self.said_missing = Some(reason.to_owned());
            self.event(Event::PortMissing { reason: reason.to_owned(), pause });
        }
        self.phase = Phase::Closed { retry_at: self.now + pause };
    }

    fn lost(&mut self, reason: &str) {
        self.release();
        self.parser.reset();
        self.candidate_since = None;
        self.pause = FIRST_PAUSE;
        self.said_no_answer = false;
        self.event(Event::PortLost { reason: reason.to_owned() });
        self.phase = Phase::Closed { retry_at: self.now + FIRST_PAUSE };
    }

    fn grow_pause(&mut self) -> f64 {
        let pause = self.pause;
        self.pause = (self.pause * 1.6).min(self.config.longest_pause.max(FIRST_PAUSE));
        pause
    }

    fn call(&mut self, delay: f64) {
        self.release();
        self.phase = Phase::Calling(Calling {
            since: self.now,
            next_call: self.now + delay,
            heard: false,
            skipped_before: self.parser.counts().skipped_bytes,
            reset_at: None,
        });
    }

    fn bytes(&mut self, bytes: &[u8], arrival: Stamp) {
        if matches!(self.phase, Phase::Closed { .. } | Phase::Opening | Phase::Settling { .. }) {
            // What the old stream left in some buffer.
            return;
        }
        // The parser is taken out so that its frames can be handled while they borrow it.
        let mut parser = std::mem::take(&mut self.parser);
        self.arrivals.came(parser.pushed() + bytes.len() as u64, arrival);
        let mut rest = bytes;
        let mut any = false;
        while !rest.is_empty() {
            let taken = parser.push(rest);
            rest = rest.get(taken..).unwrap_or_default();
            any |= self.frames(&mut parser, arrival);
        }
        // A false preamble with a great length must not hold back what follows it.
        let longest = 0.1 + 2100.0 * 10.0 / f64::from(self.baud());
        if any || parser.pending() == 0 {
            self.candidate_since = None;
        }
        if parser.pending() > 0 {
            let since = *self.candidate_since.get_or_insert(self.now);
            if self.now - since > longest {
                parser.give_up_candidate();
                self.frames(&mut parser, arrival);
                self.candidate_since = None;
            }
        }
        self.parser = parser;
    }

    fn frames(&mut self, parser: &mut FrameParser, arrival: Stamp) -> bool {
        let mut any = false;
        while let Some(frame) = parser.next_frame() {
            any = true;
            if frame.message == MessageId::WAKE_UP {
                self.woke_up();
                continue;
            }
            match &mut self.phase {
                Phase::Calling(calling) => {
                    calling.heard = true;
                    if frame.message == MessageId::GO_TO_CONFIG.ack() {
                        self.begin_inquiry();
                    } else if calling.reset_at.is_none() {
                        // Somebody is there: no need to wait for the next call.
                        calling.next_call = calling.next_call.min(self.now + CALL_INTERVAL);
                    }
                }
                Phase::Asking(_) => self.reply(&frame, arrival),
                Phase::Measuring => {
                    self.data(&frame, arrival);
                }
                _ => {}
            }
        }
        any
    }

    fn woke_up(&mut self) {
        self.write(MessageId::WAKE_UP_ACK, &[]);
        self.event(Event::WokeUp);
        // It is in the config state now; asking for it once more is answered at once and does no harm.
        self.call(0.01);
    }

    fn tick(&mut self) {
        match &mut self.phase {
            Phase::Closed { retry_at } if self.now >= *retry_at => {
                self.phase = Phase::Opening;
                let open = Output::Open { baud: self.baud(), two_stop_bits: self.config.two_stop_bits };
                self.outputs.push_back(open);
            }
            Phase::Settling { until } if self.now >= *until => self.call(0.0),
            Phase::Calling(calling) => {
                let calling = *calling;
                self.tick_calling(calling);
            }
            Phase::Asking(_) => self.tick_inquiry(),
            Phase::Measuring => {
                if let Some(seconds) = self.stream.silent_for(self.now) {
                    self.event(Event::Silent { seconds });
                    self.call(0.0);
                }
            }
            _ => {}
        }
    }

    fn tick_calling(&mut self, mut calling: Calling) {
        let waited = self.now - calling.since;
        let patience = match calling.reset_at {
            Some(at) => at - calling.since + RESET_PATIENCE,
            None if self.bauds.len() > 1 && !calling.heard => SCAN_DWELL,
            None => PATIENCE,
        };
        if waited > patience {
            if calling.heard && calling.reset_at.is_none() {
                // It talks, but is deaf to GoToConfig.
                self.write(MessageId::RESET, &[]);
                calling.reset_at = Some(self.now);
                calling.next_call = self.now + RESET_INTERVAL;
                self.phase = Phase::Calling(calling);
            } else {
                self.not_here(calling);
            }
            return;
        }
        if self.now >= calling.next_call {
            let interval = if calling.reset_at.is_some() { RESET_INTERVAL } else { CALL_INTERVAL };
            calling.next_call = self.now + interval;
            self.phase = Phase::Calling(calling);
            self.write(MessageId::GO_TO_CONFIG, &[]);
        }
    }

    fn not_here(&mut self, calling: Calling) {
        self.baud_index = (self.baud_index + 1) % self.bauds.len().max(1);
        if self.baud_index > 0 {
            self.outputs.push_back(Output::SetBaud(self.baud()));
            self.parser.reset();
            return self.call(0.02);
        }
        if !self.said_no_answer {
            self.said_no_answer = true;
            let garbage = self.parser.counts().skipped_bytes > calling.skipped_before;
            self.event(Event::NoAnswer { bauds: self.bauds.clone(), garbage });
        }
        // Opened anew: the adapter may have been replaced by another one of the same name.
        self.outputs.push_back(Output::Close);
        let pause = self.grow_pause();
        self.phase = Phase::Closed { retry_at: self.now + pause };
    }

    /// The unit has answered: later attempts start where it was found.
    fn found(&mut self) {
        if self.baud_index > 0 {
            let baud = self.bauds.remove(self.baud_index);
            self.bauds.insert(0, baud);
            self.baud_index = 0;
        }
        self.pause = FIRST_PAUSE;
        self.said_no_answer = false;
    }
}
