//! `/diagnostics`, once a second: which input topics are missing, how fast each one comes, what was dropped, and what the
//! node itself has to say.

use super::{
    NodeError,
    handle::NodeHandle,
    publisher::{Publisher, Rate},
};
use crate::{
    inbox::{SourceCount, now},
    lifecycle::LifecycleState,
    qos::Qos,
};
use std::{
    collections::{BTreeMap, HashMap},
    sync::atomic::Ordering,
    time::Duration,
};
use volant_msgs::{
    builtin_interfaces::msg::Time,
    diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue},
    std_msgs::msg::Header,
};

/// A topic on which nothing came for this long is missing.
const MISSING_AFTER: Duration = Duration::from_secs(2);
/// A round that is later than this was held up.
const HELD_UP_AFTER: Duration = Duration::from_secs(1);
/// That the node started anew is told for so long.
const TOLD_FOR: Duration = Duration::from_secs(5);
const DIAGNOSTICS: Qos = Qos { reliable: true, transient_local: false, depth: 10, max_samples: 100 };

/// How well something is, with the numbers of `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Health {
    /// As it should be.
    Ok = DiagnosticStatus::OK,
    /// Somebody should look.
    Warn = DiagnosticStatus::WARN,
    /// It does not work.
    Error = DiagnosticStatus::ERROR,
    /// Nothing is known any more.
    Stale = DiagnosticStatus::STALE,
}

#[derive(Default)]
pub(crate) struct Diagnostics {
    publisher: Option<Publisher<DiagnosticArray>>,
    statuses: BTreeMap<String, DiagnosticStatus>,
    rates: HashMap<String, Rate>,
    /// Counts of the round before, to tell what is new.
    before: HashMap<String, (u64, u64, u64)>,
    /// How long the node did nothing before this round, where that was long.
    held_up: Option<Duration>,
}

impl Diagnostics {
    /// Forgets what the shell had to say.
    pub(crate) fn forget_shell(&mut self) {
        self.statuses.clear();
    }
}

fn pair(key: impl Into<String>, value: impl ToString) -> KeyValue {
    KeyValue { key: key.into(), value: value.to_string() }
}

impl NodeHandle {
    /// Sets one of the node's own lines in `/diagnostics`; it stays until it is set again. It appears as
    /// `<node>: <name>`.
    pub fn diagnose(&mut self, name: &str, health: Health, message: &str, values: &[(&str, String)]) {
        let status = DiagnosticStatus {
            level: health as u8,
            name: format!("{}: {name}", self.name().base()),
            message: message.to_owned(),
            hardware_id: self.name().fully_qualified(),
            values: values.iter().map(|(key, value)| pair(*key, value)).collect(),
        };
        self.diagnostics.statuses.insert(name.to_owned(), status);
    }

    pub(crate) fn connect_diagnostics(&mut self) -> Result<(), NodeError> {
        self.diagnostics.publisher = Some(self.advertise_always("/diagnostics", DIAGNOSTICS)?);
        Ok(())
    }

    /// The round of once a second.
    pub(crate) fn publish_diagnostics(&mut self) {
        let (inputs, outputs) = (self.input_status(), self.output_status());
        let (sec, nanosec) = self.now().to_sec_nanosec();
        let mut status = vec![inputs, outputs];
        status.extend(self.diagnostics.statuses.values().cloned());
        if let Some(publisher) = &self.diagnostics.publisher {
            publisher.publish(DiagnosticArray {
                header: Header { stamp: Time { sec, nanosec }, ..Header::default() },
                status,
            });
        }
    }

    /// Notes that the round of once a second is so late.
    pub(crate) fn stood_still(&mut self, late: Duration) {
        self.diagnostics.held_up = (late > HELD_UP_AFTER).then_some(late);
    }

    /// Topics that the node waits for and on which nothing comes.
    pub fn missing_topics(&self) -> Vec<String> {
        let now = now();
        self.sources
            .counts()
            .into_iter()
            .filter(|s| s.expected && s.latest.is_none_or(|at| now.duration_since(at) > MISSING_AFTER))
            .map(|s| s.name)
            .collect()
    }

    fn input_status(&mut self) -> DiagnosticStatus {
        let missing = self.missing_topics();
        let mut values = Vec::new();
        let mut trouble = Vec::new();
        for SourceCount { name, received, dropped, refused, lost, .. } in self.sources.counts() {
            let rate = self.diagnostics.rates.entry(name.clone()).or_insert_with(Rate::new).update(received);
            values.push(pair(format!("{name} rate [Hz]"), format!("{rate:.1}")));
            values.push(pair(format!("{name} received"), received));
            values.push(pair(format!("{name} dropped"), dropped));
            values.push(pair(format!("{name} refused"), refused));
            values.push(pair(format!("{name} lost on the way"), lost));
            let counts = (dropped, refused, lost);
            let before = self.diagnostics.before.insert(name.clone(), counts).unwrap_or_default();
            for (what, now, before) in
                [("dropped", dropped, before.0), ("refused", refused, before.1), ("lost", lost, before.2)]
            {
                if now > before {
                    trouble.push(format!("{} {what} on {name}", now - before));
                }
            }
        }
        let state = self.lifecycle.get();
        let anew = self.domain.took_over.map(|(at, loss)| (now().duration_since(at), loss));
        let (health, message) = if let Some((since, loss)) = anew.filter(|(since, _)| *since < TOLD_FOR) {
            let seconds = since.as_secs_f64();
            (Health::Warn, format!("the node started anew {seconds:.0} s ago: {loss}"))
        } else if let Some(time) = self.diagnostics.held_up {
            let seconds = time.as_secs_f64();
            let why = "its process was stopped or is slow, or the computer is overloaded";
            (Health::Warn, format!("the node stood still for {seconds:.1} s: {why}"))
        } else if state != LifecycleState::Active {
            (Health::Ok, format!("the node is {}", state.label()))
        } else if !missing.is_empty() {
            (Health::Warn, format!("nothing comes on {}", missing.join(", ")))
        } else if !trouble.is_empty() {
            (Health::Warn, trouble.join(", "))
        } else {
            (Health::Ok, "all inputs come".to_owned())
        };
        self.status("inputs", health, message, values)
    }

    fn output_status(&mut self) -> DiagnosticStatus {
        let mut values = Vec::new();
        let mut trouble = Vec::new();
        self.publishers.retain(|p| p.strong_count() > 0);
        for publisher in self.publishers.iter().filter_map(std::sync::Weak::upgrade) {
            publisher.retry();
            let name = publisher.topic();
            let published = publisher.counts().published.load(Ordering::Relaxed);
            let refused = publisher.counts().refused.load(Ordering::Relaxed);
            let key = format!("{name} (out)");
            let rate = self.diagnostics.rates.entry(key.clone()).or_insert_with(Rate::new).update(published);
            values.push(pair(format!("{name} rate [Hz]"), format!("{rate:.1}")));
            let before = self.diagnostics.before.insert(key, (refused, 0, 0)).unwrap_or_default().0;
            if refused > before {
                trouble.push(format!(
                    "{} not sent on {name}: a reliable reader does not answer",
                    refused - before
                ));
            }
        }
        let (health, message) = if trouble.is_empty() {
            (Health::Ok, "all outputs go out".to_owned())
        } else {
            (Health::Warn, trouble.join(", "))
        };
        self.status("outputs", health, message, values)
    }

    fn status(&self, name: &str, health: Health, message: String, values: Vec<KeyValue>) -> DiagnosticStatus {
        DiagnosticStatus {
            level: health as u8,
            name: format!("{}: {name}", self.name().base()),
            message,
            hardware_id: self.name().fully_qualified(),
            values,
        }
    }
}
