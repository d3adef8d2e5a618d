//! From GoToConfig's acknowledgement to measuring: identity, configuration, what differs, read-back.
//!
//! One request is under way at a time. A reply is told from data that still stream, and from the late reply to an
//! earlier request, by its message identifier.

use super::{Driver, Event, Identity, Phase};
use crate::protocol::{
    Configuration, DeviceError, DeviceId, Frame, MessageId, OutputEntry,
    configuration::{
        firmware_from_data, output_configuration_from_data, output_configuration_to_data, text_from_data,
    },
};
use rig_model::Stamp;
use std::collections::VecDeque;

const REPLY_TIMEOUT: f64 = 0.5;
const ATTEMPTS: u32 = 6;
const ATTEMPTS_IF_OPTIONAL: u32 = 3;
/// A request that was not answered by now is not answered any more, s.
const FORGOTTEN: f64 = 5.0;

#[derive(Debug)]
pub(super) struct Inquiry {
    request: Request,
    sent_at: f64,
    attempts: u32,
    /// Settings still to be written.
    to_set: VecDeque<Request>,
    read_back: bool,
    /// What was sent and not answered yet, oldest first: a unit answers in order. So a late reply, and above all an
    /// error, which does not say what it is about, is told from the one that is waited for.
    in_flight: VecDeque<InFlight>,
    /// Number of the request.
    number: u32,
    /// Wrote at least one setting.
    changed: bool,
    /// The unit is the one from before: what cannot have changed is not asked again.
    known: bool,
}

#[derive(Clone, Copy, Debug)]
struct InFlight {
    message: MessageId,
    number: u32,
    sent_at: f64,
}

impl Inquiry {
    fn send(&mut self, now: f64) {
        self.sent_at = now;
        self.in_flight.retain(|r| now - r.sent_at < FORGOTTEN);
        self.in_flight.push_back(InFlight {
            message: self.request.message,
            number: self.number,
            sent_at: now,
        });
    }

    /// Whether an acknowledgement answers the request that is waited for.
    fn is_current(&mut self, ack: MessageId) -> bool {
        let Some(position) = self.in_flight.iter().position(|r| r.message.ack() == ack) else {
            return false;
        };
        // What was sent before it was swallowed.
        self.in_flight.drain(..position);
        self.in_flight.pop_front().is_some_and(|r| r.number == self.number)
    }

    /// Whether an error answers it.
    fn is_current_error(&mut self) -> bool {
        self.in_flight.pop_front().is_some_and(|r| r.number == self.number)
    }
}

#[derive(Clone, Debug, PartialEq)]
struct Request {
    message: MessageId,
    data: Vec<u8>,
}

impl Request {
    fn ask(message: MessageId) -> Self {
        Self { message, data: Vec::new() }
    }

    fn is_setting(&self) -> bool {
        !self.data.is_empty()
    }

    /// A unit that does not answer this one can be used all the same.
    fn is_optional(&self) -> bool {
        !self.is_setting()
            && matches!(
                self.message,
                MessageId::REQ_DEVICE_ID
                    | MessageId::REQ_PRODUCT_CODE
                    | MessageId::REQ_FIRMWARE
                    | MessageId::OUTPUT_CONFIGURATION
            )
    }
}

impl Driver {
    pub(super) fn begin_inquiry(&mut self) {
        self.found();
        self.identity.baud = self.baud();
        let request = Request::ask(MessageId::REQ_DEVICE_ID);
        self.phase = Phase::Asking(Inquiry {
            request: request.clone(),
            sent_at: self.now,
            attempts: 0,
            to_set: VecDeque::new(),
            read_back: false,
            in_flight: VecDeque::new(),
            number: 0,
            changed: false,
            known: false,
        });
        self.send_request(request);
    }

    pub(super) fn tick_inquiry(&mut self) {
        let now = self.now;
        let Phase::Asking(inquiry) = &mut self.phase else {
            return;
        };
        if now - inquiry.sent_at < REPLY_TIMEOUT {
            return;
        }
        let limit = if inquiry.request.is_optional() { ATTEMPTS_IF_OPTIONAL } else { ATTEMPTS };
        let request = inquiry.request.clone();
        if inquiry.attempts < limit {
            inquiry.attempts += 1;
            inquiry.send(now);
            self.write(request.message, &request.data);
        } else if request.is_optional() {
            self.proceed(&request);
        } else {
            self.event(Event::Unanswered { what: request.message });
            self.call(0.0);
        }
    }

    pub(super) fn reply(&mut self, frame: &Frame<'_>, arrival: Stamp) {
        let Phase::Asking(inquiry) = &mut self.phase else {
            return;
        };
        let request = inquiry.request.clone();
        if frame.message == MessageId::ERROR {
            if inquiry.is_current_error() {
                let error = DeviceError(frame.data.first().copied().unwrap_or_default());
                self.refused(&request, error);
            }
        } else if inquiry.is_current(frame.message) {
            self.accept(&request, frame.data);
        } else if frame.message == MessageId::REQ_PRODUCT_CODE.ack() {
            // Late, but as good as ever.
            self.identity.product_code = text_from_data(frame.data);
        } else if frame.message.is_data() && request.message == MessageId::GO_TO_MEASUREMENT {
            // In the config state nothing streams: the acknowledgement was lost, the unit measures.
            self.begin_measuring();
            self.data(frame, arrival);
        }
        // Everything else is data that still stream, or a late reply: not the one that is waited for.
    }

    fn refused(&mut self, request: &Request, error: DeviceError) {
        if request.message == MessageId::OUTPUT_CONFIGURATION && !request.is_setting() {
            // A legacy unit does not know the message: that is how it is told from a newer one.
            self.identity.outputs = None;
            return self.proceed(request);
        }
        self.event(Event::Refused { what: request.message, error });
        if request.message == MessageId::GO_TO_MEASUREMENT {
            let pause = self.grow_pause();
            self.call(pause);
        } else {
            self.proceed(request);
        }
    }

    fn accept(&mut self, request: &Request, data: &[u8]) {
        match request.message {
            MessageId::REQ_DEVICE_ID => {
                let device_id = DeviceId::from_data(data).unwrap_or_default();
                // Another unit on the same port: what is known of the old one is void.
                if device_id != self.identity.device_id || self.identity.device_id.0 == 0 {
                    self.identity = Identity { device_id, ..Identity::default() };
                }
                self.identity.baud = self.baud();
                let known = self.identity.configuration.is_some() || self.identity.outputs.is_some();
                if let Phase::Asking(inquiry) = &mut self.phase {
                    inquiry.known = known;
                }
            }
            MessageId::REQ_PRODUCT_CODE => self.identity.product_code = text_from_data(data),
            MessageId::REQ_FIRMWARE => {
                self.identity.firmware = firmware_from_data(data).unwrap_or_default();
            }
            MessageId::REQ_CONFIGURATION => match Configuration::from_data(data) {
                Ok(configuration) => self.identity.configuration = Some(configuration),
                Err(error) => self.event(Event::Unreadable { reason: error.to_string() }),
            },
            MessageId::OUTPUT_CONFIGURATION => {
                if let Ok(outputs) = output_configuration_from_data(data) {
                    self.identity.outputs = Some(outputs);
                }
            }
            MessageId::GO_TO_MEASUREMENT => return self.begin_measuring(),
            _ => {}
        }
        if request.is_setting() {
            if request.message == MessageId::BAUD_RATE {
                // In force only after it.
                self.write(MessageId::RESET, &[]);
            }
            self.event(Event::Set { what: request.message });
            if let Phase::Asking(inquiry) = &mut self.phase {
                inquiry.changed = true;
            }
        }
        self.proceed(request);
    }

    /// The request is done, one way or the other: the next one.
    fn proceed(&mut self, done: &Request) {
        let Phase::Asking(inquiry) = &mut self.phase else {
            return;
        };
        let known = inquiry.known;
        let next = if inquiry.read_back {
            match done.message {
                MessageId::REQ_CONFIGURATION if self.identity.outputs.is_some() => {
                    Some(Request::ask(MessageId::OUTPUT_CONFIGURATION))
                }
                _ => None,
            }
        } else {
            match done.message {
                MessageId::REQ_DEVICE_ID if known => Some(Request::ask(MessageId::REQ_CONFIGURATION)),
                MessageId::REQ_DEVICE_ID => Some(Request::ask(MessageId::REQ_PRODUCT_CODE)),
                MessageId::REQ_PRODUCT_CODE => Some(Request::ask(MessageId::REQ_FIRMWARE)),
                MessageId::REQ_FIRMWARE => Some(Request::ask(MessageId::REQ_CONFIGURATION)),
                MessageId::REQ_CONFIGURATION if !known || self.identity.outputs.is_some() => {
                    Some(Request::ask(MessageId::OUTPUT_CONFIGURATION))
                }
                _ => None,
            }
        };
        if let Some(next) = next {
            return self.send_request(next);
        }
        if !inquiry.read_back && inquiry.to_set.is_empty() && !inquiry.changed && !done.is_setting() {
            // All is read: what differs?
            let settings = self.differences();
            self.event(Event::Found(self.identity.clone()));
            if let Phase::Asking(inquiry) = &mut self.phase {
                inquiry.to_set = settings.into();
            }
        }
        let Phase::Asking(inquiry) = &mut self.phase else {
            return;
        };
        if let Some(setting) = inquiry.to_set.pop_front() {
            return self.send_request(setting);
        }
        if done.is_setting() && inquiry.changed {
            inquiry.read_back = true;
            return self.send_request(Request::ask(MessageId::REQ_CONFIGURATION));
        }
        if inquiry.read_back {
            self.compare_read_back();
        }
        if self.identity.configuration.is_none() && self.identity.outputs.is_none() {
            self.event(Event::Unanswered { what: MessageId::REQ_CONFIGURATION });
            let pause = self.grow_pause();
            return self.call(pause);
        }
        self.send_request(Request::ask(MessageId::GO_TO_MEASUREMENT));
    }

    fn send_request(&mut self, request: Request) {
        let now = self.now;
        if let Phase::Asking(inquiry) = &mut self.phase {
            inquiry.request = request.clone();
            inquiry.number += 1;
            inquiry.attempts = 1;
            inquiry.send(now);
            self.write(request.message, &request.data);
        }
    }

    /// The settings that must be written: settings go to flash, so only those that differ.
    fn differences(&self) -> Vec<Request> {
        if let Some(code) = self.config.set_baud {
            return vec![Request { message: MessageId::BAUD_RATE, data: vec![code] }];
        }
        if self.config.leave_settings {
            return Vec::new();
        }
        if let Some(found) = &self.identity.outputs {
            let wanted = self.config.outputs();
            let settled = self.stream.settled_outputs(&wanted) == Some(found);
            if *found == wanted || settled {
                return Vec::new();
            }
            let data = output_configuration_to_data(&wanted);
            return vec![Request { message: MessageId::OUTPUT_CONFIGURATION, data }];
        }
        let Some(found) = self.identity.configuration else {
            return Vec::new();
        };
        let (period, skip) = self.config.period_and_skip();
        let format = self.config.legacy_format();
        let mut settings = Vec::new();
        let mut set = |message, differs: bool, data: &[u8]| {
            if differs {
                settings.push(Request { message, data: data.to_vec() });
            }
        };
        set(MessageId::PERIOD, found.period != period, &period.to_be_bytes());
        set(MessageId::OUTPUT_SKIP_FACTOR, found.skip != skip, &skip.to_be_bytes());
        set(MessageId::OUTPUT_MODE, found.format.mode != format.mode, &format.mode.0.to_be_bytes());
        let settings_bytes = format.settings.0.to_be_bytes();
        set(MessageId::OUTPUT_SETTINGS, found.format.settings != format.settings, &settings_bytes);
        settings
    }

    fn compare_read_back(&mut self) {
        let mut not_taken = |what, wanted: String, found: String| {
            if wanted != found {
                self.outputs.push_back(super::Output::Event(Event::NotTaken { what, wanted, found }));
            }
        };
        if let Some(found) = &self.identity.outputs {
            let wanted = self.config.outputs();
            not_taken(MessageId::OUTPUT_CONFIGURATION, listed(&wanted), listed(found));
            self.stream.settle_outputs(wanted, found.clone());
            return;
        }
        let Some(found) = self.identity.configuration else {
            return;
        };
        let (period, skip) = self.config.period_and_skip();
        let format = self.config.legacy_format();
        not_taken(MessageId::PERIOD, period.to_string(), found.period.to_string());
        not_taken(MessageId::OUTPUT_SKIP_FACTOR, skip.to_string(), found.skip.to_string());
        let hex = |mode: u16| format!("{mode:04X}");
        not_taken(MessageId::OUTPUT_MODE, hex(format.mode.0), hex(found.format.mode.0));
        let hex = |settings: u32| format!("{settings:08X}");
        not_taken(MessageId::OUTPUT_SETTINGS, hex(format.settings.0), hex(found.format.settings.0));
    }

    pub(super) fn begin_measuring(&mut self) {
        self.stream.begin(&self.identity, self.now);
        self.phase = Phase::Measuring;
        self.event(Event::Measuring(self.identity.clone()));
    }
}

fn listed(outputs: &[OutputEntry]) -> String {
    outputs.iter().map(|o| format!("{:04X}@{}", o.id, o.rate)).collect::<Vec<_>>().join(" ")
}
