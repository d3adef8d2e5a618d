//! Driver of one IMU as a state machine without I/O: port events, bytes and time in; port commands,
//! samples and events out.
//!
//! ```text
//! Closed ──Open──▶ Settling ──▶ Calling ──GoToConfig ack──▶ Asking ──▶ Measuring ──▶ samples
//!   ▲  pause grows     ▲           ▲  baud scan, Reset           │          │
//!   └── port lost ─────┴───────────┴─ no reply, silence, WakeUp, unreadable ┘
//! ```
//!
//! Time enters with the inputs and is that of the host's clock. [`Driver::clock_set`] reports that
//! this clock was set: stamps follow at once, timers and the clock fit are not affected. Timers
//! count the sum of small steps, so that an unreported step of the clock neither blocks nor
//! triggers them.

mod arrivals;
pub mod config;
mod connection;
pub mod event;
mod inquiry;
pub mod sample;
mod stream;

pub use config::DriverConfig;
pub use event::{Event, Identity, Severity};
pub use sample::{Sample, sample_of};
pub use stream::Statistics;

use crate::protocol::{Frame, FrameParser, MessageId, OutputEntry, frame};
use arrivals::Arrivals;
use connection::{Calling, Connection};
use inquiry::Inquiry;
use rig_model::Stamp;
use std::collections::VecDeque;
use stream::Stream;

/// Input of the driver.
#[derive(Clone, Copy, Debug)]
pub enum Input<'a> {
    /// The port was opened as requested by [`Output::Open`].
    Opened,
    /// The port could not be opened, for this reason, which names the port.
    OpenFailed(&'a str),
    /// These bytes were received.
    Bytes(&'a [u8]),
    /// Reading or writing failed for this reason, and the port was closed.
    Lost(&'a str),
    /// Time has passed; required at least ten times per second.
    Tick,
}

/// Output of the driver.
#[derive(Clone, Debug, PartialEq)]
pub enum Output {
    /// Open the port and report [`Input::Opened`] or [`Input::OpenFailed`].
    Open {
        /// Baud rate.
        baud: u32,
        /// Two stop bits instead of one.
        two_stop_bits: bool,
    },
    /// Close the port.
    Close,
    /// Change the baud rate of the open port and discard its buffers.
    SetBaud(u32),
    /// Write these bytes.
    Write(Vec<u8>),
    /// A sample.
    Sample(Sample),
    /// An event for the log and the diagnostics.
    Event(Event),
}

/// Longest step of time, s: a longer one means that the host slept, not that the device was silent.
const LONGEST_STEP: f64 = 0.25;

#[derive(Debug)]
enum Phase {
    Closed {
        retry_at: f64,
    },
    Opening,
    /// Bytes received until then belong to the previous stream.
    Settling {
        until: f64,
    },
    Calling(Calling),
    Asking(Inquiry),
    Measuring,
}

/// Time of the host without the steps of its clock.
#[derive(Debug, Default)]
struct HostTime {
    /// Sum of the steps between inputs, s.
    now: f64,
    last_input: Option<Stamp>,
    /// Sum of all reported steps of the clock, ns.
    set_by: i64,
}

impl HostTime {
    /// Advances to an input at `at` and returns its time on a clock that was never set.
    fn advance(&mut self, at: Stamp) -> Stamp {
        let at = Stamp::from_nanos(at.as_nanos().saturating_sub(self.set_by));
        let step = self.last_input.map_or(0.0, |last| at.seconds_since(last));
        self.now += step.clamp(0.0, LONGEST_STEP);
        self.last_input = Some(at);
        at
    }

    /// Time on the host's clock as it is set now.
    fn on_host_clock(&self, at: Stamp) -> Stamp {
        Stamp::from_nanos(at.as_nanos().saturating_add(self.set_by))
    }
}

/// Driver of one IMU.
#[derive(Debug)]
pub struct Driver {
    config: DriverConfig,
    connection: Connection,
    phase: Phase,
    time: HostTime,
    parser: FrameParser,
    arrivals: Arrivals,
    /// Since when an incomplete frame is buffered, s.
    incomplete_since: Option<f64>,
    identity: Identity,
    /// Output configuration as written and as read back; writing it again would wear the flash.
    settled: Option<(Vec<OutputEntry>, Vec<OutputEntry>)>,
    stream: Stream,
    outputs: VecDeque<Output>,
}

impl Driver {
    /// Creates a driver whose first output is [`Output::Open`].
    ///
    /// # Errors
    /// As [`DriverConfig::check`].
    pub fn new(config: DriverConfig) -> Result<Self, String> {
        config.check()?;
        Ok(Self {
            connection: Connection::new(&config),
            phase: Phase::Closed { retry_at: 0.0 },
            time: HostTime::default(),
            parser: FrameParser::new(),
            arrivals: Arrivals::new(),
            incomplete_since: None,
            identity: Identity::default(),
            settled: None,
            stream: Stream::new(config.step_patience),
            outputs: VecDeque::new(),
            config,
        })
    }

    /// Processes one input; `at` is the current time, or that at which the bytes were read.
    pub fn handle(&mut self, input: Input<'_>, at: Stamp) {
        let at = self.time.advance(at);
        match input {
            Input::Opened => self.opened(),
            Input::OpenFailed(reason) => self.open_failed(reason),
            Input::Bytes(bytes) => self.bytes(bytes, at),
            Input::Lost(reason) => self.lost(reason),
            Input::Tick => {}
        }
        self.tick();
    }

    /// Reports that the host's clock was set by `by` ns (new minus old).
    pub fn clock_set(&mut self, by: i64) {
        // Waiting samples are stamped on the new clock.
        self.time.set_by = self.time.set_by.saturating_add(by);
        self.event(Event::ClockSet(by as f64 * 1e-9));
    }

    /// Ends the stream: releases the samples that wait for the clock fit.
    pub fn finish(&mut self) {
        self.release();
    }

    /// Returns the next output.
    pub fn poll(&mut self) -> Option<Output> {
        self.outputs.pop_front()
    }

    /// Identity and configuration of the device, as far as known.
    pub fn identity(&self) -> &Identity {
        &self.identity
    }

    /// Counts since the start.
    pub fn statistics(&self) -> Statistics {
        self.stream.statistics(self.parser.counts())
    }

    /// Whether the device is in the measurement state.
    pub fn is_measuring(&self) -> bool {
        matches!(self.phase, Phase::Measuring)
    }

    /// Description of the current phase.
    pub fn state(&self) -> &'static str {
        match self.phase {
            Phase::Closed { .. } | Phase::Opening => "waiting for the port",
            Phase::Settling { .. } | Phase::Calling(_) => "querying the IMU",
            Phase::Asking(_) => "configuring the IMU",
            Phase::Measuring => "measuring",
        }
    }

    fn event(&mut self, event: Event) {
        self.outputs.push_back(Output::Event(event));
    }

    fn write(&mut self, message: MessageId, data: &[u8]) {
        self.outputs.push_back(Output::Write(frame(message, data)));
    }

    fn bytes(&mut self, bytes: &[u8], arrival: Stamp) {
        if matches!(self.phase, Phase::Closed { .. } | Phase::Opening | Phase::Settling { .. }) {
            // Remains of the previous stream.
            return;
        }
        // Moved out, because its frames borrow it while they are handled.
        let mut parser = std::mem::take(&mut self.parser);
        self.arrivals.received(parser.pushed() + bytes.len() as u64, arrival);
        let mut any = false;
        parser.parse(bytes, |frame| {
            any = true;
            self.frame(&frame, arrival);
        });
        if any || parser.pending() == 0 {
            self.incomplete_since = None;
        }
        // An invalid header with a large length must not block the frames after it.
        let longest = 0.1 + 2100.0 * 10.0 / f64::from(self.connection.baud());
        if parser.pending() > 0 {
            let since = *self.incomplete_since.get_or_insert(self.time.now);
            if self.time.now - since > longest {
                parser.give_up_candidate();
                parser.parse(&[], |frame| self.frame(&frame, arrival));
                self.incomplete_since = None;
            }
        }
        self.parser = parser;
    }

    fn frame(&mut self, frame: &Frame<'_>, arrival: Stamp) {
        if frame.message == MessageId::WAKE_UP {
            self.write(MessageId::WAKE_UP_ACK, &[]);
            self.event(Event::WokeUp);
            // The device enters the config state; another GoToConfig is acknowledged at once.
            return self.call(0.01);
        }
        match &mut self.phase {
            Phase::Calling(_) if frame.message == MessageId::GO_TO_CONFIG.ack() => {
                self.begin_inquiry();
            }
            Phase::Calling(calling) => calling.frame_received(self.time.now),
            Phase::Asking(_) => self.reply(frame, arrival),
            Phase::Measuring => self.data(frame, arrival),
            Phase::Closed { .. } | Phase::Opening | Phase::Settling { .. } => {}
        }
    }

    fn tick(&mut self) {
        let now = self.time.now;
        match &mut self.phase {
            Phase::Closed { retry_at } if now >= *retry_at => {
                self.phase = Phase::Opening;
                self.outputs.push_back(Output::Open {
                    baud: self.connection.baud(),
                    two_stop_bits: self.config.two_stop_bits,
                });
            }
            Phase::Settling { until } if now >= *until => self.call(0.0),
            Phase::Calling(calling) => {
                calling.skipped_before.get_or_insert(self.parser.counts().skipped_bytes);
                let calling = *calling;
                self.tick_calling(calling);
            }
            Phase::Asking(_) => self.tick_inquiry(),
            Phase::Measuring => {
                if let Some(seconds) = self.stream.silent_for(now) {
                    self.event(Event::Silent(seconds));
                    self.call(0.0);
                }
            }
            _ => {}
        }
    }
}
