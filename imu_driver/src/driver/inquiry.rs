//! From the acknowledgement of GoToConfig to measuring: identity, configuration, settings that
//! differ, read-back.
//!
//! One request is pending at a time. Its reply is distinguished from data messages and from late
//! replies to earlier requests by its message identifier.

use super::{Driver, Event, Identity, Phase};
use crate::protocol::{
    Configuration, DeviceError, DeviceId, Frame, MessageId, OutputEntry,
    configuration::{
        firmware_from_data, output_configuration_from_data, output_configuration_to_data,
        period_and_skip, text_from_data,
    },
};
use rig_model::Stamp;
use std::collections::VecDeque;

/// Time until a request is repeated, s.
const REPLY_TIMEOUT: f64 = 0.5;
/// Number of times that a request is sent.
const ATTEMPTS: u32 = 6;
/// The same for a request without which the device is usable.
const ATTEMPTS_IF_OPTIONAL: u32 = 3;
/// Time after which a request is no longer expected to be answered, s.
const EXPIRY: f64 = 5.0;

#[derive(Clone, Copy, Debug, Default)]
enum Stage {
    /// Identity and configuration.
    #[default]
    Reading,
    /// Settings that differ.
    Writing,
    /// Configuration with the settings that were written.
    ReadingBack,
}

#[derive(Debug, Default)]
pub(super) struct Inquiry {
    stage: Stage,
    /// Pending request.
    request: Request,
    sent_at: f64,
    attempts: u32,
    /// Further requests of the stage.
    queue: VecDeque<Request>,
    /// Unanswered requests, oldest first. The device answers in order, so that late replies and
    /// errors (which do not identify their request) are assigned to the right one.
    in_flight: VecDeque<InFlight>,
    /// Number of the pending request.
    number: u32,
    /// At least one setting was written.
    changed: bool,
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
        self.in_flight.retain(|r| now - r.sent_at < EXPIRY);
        self.in_flight.push_back(InFlight {
            message: self.request.message,
            number: self.number,
            sent_at: now,
        });
    }

    /// Whether an acknowledgement answers the pending request.
    fn is_current(&mut self, ack: MessageId) -> bool {
        let Some(position) = self.in_flight.iter().position(|r| r.message.ack() == ack) else {
            return false;
        };
        // Earlier requests were lost.
        self.in_flight.drain(..position);
        self.in_flight.pop_front().is_some_and(|r| r.number == self.number)
    }

    /// Whether an error answers the pending request.
    fn is_current_error(&mut self) -> bool {
        self.in_flight.pop_front().is_some_and(|r| r.number == self.number)
    }
}

#[derive(Clone, Debug, Default, PartialEq)]
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

    /// Whether the device is usable without an answer.
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

/// Setting with its value as wanted and as read from the device.
struct Setting {
    message: MessageId,
    /// Data that set the wanted value.
    data: Vec<u8>,
    wanted: String,
    found: String,
}

impl Driver {
    pub(super) fn begin_inquiry(&mut self) {
        self.connection.found();
        self.identity.baud = self.connection.baud();
        let requests = [
            MessageId::REQ_DEVICE_ID,
            MessageId::REQ_PRODUCT_CODE,
            MessageId::REQ_FIRMWARE,
            MessageId::REQ_CONFIGURATION,
            MessageId::OUTPUT_CONFIGURATION,
        ];
        let queue = requests.map(Request::ask).into();
        self.phase = Phase::Asking(Inquiry { queue, ..Inquiry::default() });
        self.proceed();
    }

    pub(super) fn tick_inquiry(&mut self) {
        let now = self.time.now;
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
            self.proceed();
        } else {
            self.event(Event::Unanswered(request.message));
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
                self.rejected(&request, error);
            }
        } else if inquiry.is_current(frame.message) {
            self.accept(&request, frame.data);
        } else if frame.message == MessageId::REQ_PRODUCT_CODE.ack() {
            // A late reply.
            self.identity.product_code = text_from_data(frame.data);
        } else if frame.message.is_data() && request.message == MessageId::GO_TO_MEASUREMENT {
            // No data in the config state: the acknowledgement was lost and the device measures.
            self.begin_measuring();
            self.data(frame, arrival);
        }
        // Everything else is a data message or a late reply.
    }

    fn rejected(&mut self, request: &Request, error: DeviceError) {
        if request.message == MessageId::OUTPUT_CONFIGURATION && !request.is_setting() {
            // A legacy device does not support the message, which distinguishes the two kinds.
            self.identity.outputs = None;
            return self.proceed();
        }
        self.event(Event::Rejected { what: request.message, error });
        if request.message == MessageId::GO_TO_MEASUREMENT {
            self.call_after_pause();
        } else {
            self.proceed();
        }
    }

    fn accept(&mut self, request: &Request, data: &[u8]) {
        match request.message {
            MessageId::REQ_DEVICE_ID => {
                let device_id = DeviceId::from_data(data).unwrap_or_default();
                // Another device on the same port.
                if device_id != self.identity.device_id || self.identity.device_id.0 == 0 {
                    self.identity = Identity { device_id, ..Identity::default() };
                }
                self.identity.baud = self.connection.baud();
                if self.is_identified() {
                    // Its product code and firmware do not change.
                    let requests = self.configuration_requests();
                    if let Phase::Asking(inquiry) = &mut self.phase {
                        inquiry.queue = requests;
                    }
                }
            }
            MessageId::REQ_PRODUCT_CODE => self.identity.product_code = text_from_data(data),
            MessageId::REQ_FIRMWARE => {
                self.identity.firmware = firmware_from_data(data).unwrap_or_default();
            }
            MessageId::REQ_CONFIGURATION => match Configuration::from_data(data) {
                Ok(configuration) => self.identity.configuration = Some(configuration),
                Err(error) => self.event(Event::Unreadable(error.to_string())),
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
                // Effective after a reset.
                self.write(MessageId::RESET, &[]);
            }
            self.event(Event::Set(request.message));
            if let Phase::Asking(inquiry) = &mut self.phase {
                inquiry.changed = true;
            }
        }
        self.proceed();
    }

    /// Whether the configuration of the device was read before.
    fn is_identified(&self) -> bool {
        self.identity.configuration.is_some() || self.identity.outputs.is_some()
    }

    /// Requests of the configuration of a device whose kind is known.
    fn configuration_requests(&self) -> VecDeque<Request> {
        let outputs = self.identity.outputs.as_ref().map(|_| MessageId::OUTPUT_CONFIGURATION);
        std::iter::once(MessageId::REQ_CONFIGURATION).chain(outputs).map(Request::ask).collect()
    }

    /// Sends the next request of the stage; after the last one, begins the next stage.
    fn proceed(&mut self) {
        loop {
            let Phase::Asking(inquiry) = &mut self.phase else {
                return;
            };
            if let Some(next) = inquiry.queue.pop_front() {
                return self.send_request(next);
            }
            let (stage, queue) = match (inquiry.stage, inquiry.changed) {
                (Stage::Reading, _) => {
                    let settings = self.differences();
                    let mtdata2 = self.identity.outputs.is_some();
                    let checked = self.config.check_line(self.connection.baud(), mtdata2);
                    if let (false, Err(error)) = (settings.is_empty(), checked) {
                        return self.line_too_slow(error);
                    }
                    self.event(Event::Found(self.identity.clone()));
                    (Stage::Writing, settings)
                }
                (Stage::Writing, true) => (Stage::ReadingBack, self.configuration_requests()),
                (Stage::Writing, false) => return self.request_measurement(),
                (Stage::ReadingBack, _) => {
                    self.compare_read_back();
                    return self.request_measurement();
                }
            };
            if let Phase::Asking(inquiry) = &mut self.phase {
                (inquiry.stage, inquiry.queue) = (stage, queue);
            }
        }
    }

    fn request_measurement(&mut self) {
        if self.is_identified() {
            return self.send_request(Request::ask(MessageId::GO_TO_MEASUREMENT));
        }
        self.event(Event::Unanswered(MessageId::REQ_CONFIGURATION));
        self.call_after_pause();
    }

    fn send_request(&mut self, request: Request) {
        let now = self.time.now;
        if let Phase::Asking(inquiry) = &mut self.phase {
            inquiry.request = request.clone();
            inquiry.number += 1;
            inquiry.attempts = 1;
            inquiry.send(now);
            self.write(request.message, &request.data);
        }
    }

    /// Settings of the configuration, as wanted and as read from the device.
    fn settings(&self) -> Vec<Setting> {
        if let Some(found) = &self.identity.outputs {
            let wanted = self.config.outputs();
            let message = MessageId::OUTPUT_CONFIGURATION;
            let data = output_configuration_to_data(&wanted);
            return vec![Setting { message, data, wanted: listed(&wanted), found: listed(found) }];
        }
        let period_and_skip = period_and_skip(self.config.rate);
        let Some((found, (period, skip))) = self.identity.configuration.zip(period_and_skip) else {
            return Vec::new();
        };
        let wanted = Configuration { period, skip, format: self.config.legacy_format(), ..found };
        let setting = |message, data: &[u8], text: fn(&Configuration) -> String| Setting {
            message,
            data: data.to_vec(),
            wanted: text(&wanted),
            found: text(&found),
        };
        let (mode, settings) = (wanted.format.mode.bits(), wanted.format.settings.bits());
        vec![
            setting(MessageId::PERIOD, &period.to_be_bytes(), |c| c.period.to_string()),
            setting(MessageId::OUTPUT_SKIP_FACTOR, &skip.to_be_bytes(), |c| c.skip.to_string()),
            setting(MessageId::OUTPUT_MODE, &mode.to_be_bytes(), |c| {
                format!("{:04X}", c.format.mode.bits())
            }),
            setting(MessageId::OUTPUT_SETTINGS, &settings.to_be_bytes(), |c| {
                format!("{:08X}", c.format.settings.bits())
            }),
        ]
    }

    /// Settings to write: only those that differ, because each write wears the flash.
    fn differences(&self) -> VecDeque<Request> {
        if let Some(code) = self.config.set_baud {
            return [Request { message: MessageId::BAUD_RATE, data: vec![code] }].into();
        }
        let settled = self.settled.as_ref().is_some_and(|(written, found)| {
            *written == self.config.outputs() && self.identity.outputs.as_ref() == Some(found)
        });
        if self.config.leave_settings || settled {
            return VecDeque::new();
        }
        let differing = self.settings().into_iter().filter(|s| s.wanted != s.found);
        differing.map(|s| Request { message: s.message, data: s.data }).collect()
    }

    fn compare_read_back(&mut self) {
        for Setting { message: what, wanted, found, .. } in self.settings() {
            if wanted != found {
                self.event(Event::NotApplied { what, wanted, found });
            }
        }
        if let Some(found) = &self.identity.outputs {
            self.settled = Some((self.config.outputs(), found.clone()));
        }
    }

    pub(super) fn begin_measuring(&mut self) {
        self.connection.restart();
        self.stream.begin(&self.identity, self.time.now);
        self.phase = Phase::Measuring;
        self.event(Event::Measuring(self.identity.clone()));
        if self.stream.on_request {
            self.event(Event::OnRequestOnly);
        }
    }
}

fn listed(outputs: &[OutputEntry]) -> String {
    outputs.iter().map(|o| format!("{:04X}@{}", o.id, o.rate)).collect::<Vec<_>>().join(" ")
}
