//! `/diagnostics`, once a second: missing topics, rates, what was dropped, and the node's own
//! statuses.

use super::{
    endpoints::Endpoints, error::NodeError, graph::without_conflicts, handle::NodeHandle,
    intra_process::TopicState, publisher::Publisher,
};
use crate::{
    convert,
    inbox::{SourceCount, SourceKind, now},
    level::Level,
    lifecycle::LifecycleState,
    names::NodeName,
    qos::Qos,
};
use rig_model::{Stamp, topics};
use std::{
    collections::{BTreeMap, HashMap},
    sync::Weak,
    time::{Duration, Instant},
};
use volant_msgs::diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus, KeyValue};

/// A topic on which nothing arrived for this long is missing.
const MISSING_AFTER: Duration = Duration::from_secs(2);
/// Lateness of the second's tick from which the node counts as held up.
const HELD_UP_AFTER: Duration = Duration::from_secs(1);
/// How long a restart of the node is reported.
const RESTART_REPORTED_FOR: Duration = Duration::from_secs(5);
/// Publications with the time 0 after which a node waits for `/clock`: discovery takes a second.
const WITHOUT_CLOCK: u32 = 3;
const DIAGNOSTICS: Qos = Qos { max_samples: 100, ..Qos::RELIABLE };

/// Level of a status, with the numbers of `diagnostic_msgs/DiagnosticStatus`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Health {
    /// Works as expected.
    Ok = DiagnosticStatus::OK,
    /// Needs attention.
    Warn = DiagnosticStatus::WARN,
    /// Does not work.
    Error = DiagnosticStatus::ERROR,
}

/// Statuses of one node.
pub(crate) struct Diagnostics {
    publisher: Publisher<DiagnosticArray>,
    /// Set by the shell.
    statuses: BTreeMap<String, DiagnosticStatus>,
    /// Counts of the last publication.
    previous: HashMap<String, u64>,
    /// Time of the last publication.
    published: Instant,
    /// Time from the one before to that, s.
    interval: f64,
    /// How late this second's tick is, where that is long.
    held_up: Option<Duration>,
    /// Conflicts that were logged.
    conflicts: String,
    /// Publications in a row with the time 0, which only a simulated clock has.
    without_clock: u32,
}

fn pair(key: impl Into<String>, value: impl ToString) -> KeyValue {
    KeyValue { key: key.into(), value: value.to_string() }
}

fn status(
    node: &NodeName,
    name: &str,
    health: Health,
    message: impl Into<String>,
    values: Vec<KeyValue>,
) -> DiagnosticStatus {
    DiagnosticStatus {
        level: health as u8,
        name: format!("{}: {name}", node.base()),
        message: message.into(),
        hardware_id: node.fully_qualified(),
        values,
    }
}

impl NodeHandle {
    /// Sets one of the node's own statuses in `/diagnostics`, published as `<node>: <name>` until
    /// it is set again.
    pub fn diagnose(
        &mut self,
        name: &str,
        health: Health,
        message: &str,
        values: &[(&str, String)],
    ) {
        let values = values.iter().map(|(key, value)| pair(*key, value)).collect();
        let status = status(&self.endpoints.name, name, health, message, values);
        self.diagnostics.statuses.insert(name.to_owned(), status);
    }
}

impl Diagnostics {
    /// Advertises `/diagnostics`.
    pub fn new(endpoints: &mut Endpoints) -> Result<Self, NodeError> {
        Ok(Self {
            publisher: endpoints.advertise_always(topics::absolute::DIAGNOSTICS, DIAGNOSTICS)?,
            statuses: BTreeMap::new(),
            previous: HashMap::new(),
            published: now(),
            interval: 0.0,
            held_up: None,
            conflicts: String::new(),
            without_clock: 0,
        })
    }

    /// Removes the shell's statuses.
    pub fn clear(&mut self) {
        self.statuses.clear();
    }

    /// Notes how late this second's tick is.
    pub fn ticked(&mut self, late: Duration) {
        self.held_up = (late > HELD_UP_AFTER).then_some(late);
    }

    /// Publishes all statuses.
    pub fn publish(&mut self, endpoints: &mut Endpoints, state: LifecycleState, stamp: Stamp) {
        let before = std::mem::replace(&mut self.published, now());
        self.interval = self.published.duration_since(before).as_secs_f64();
        let is_zero = stamp == Stamp::default();
        self.without_clock = if is_zero { self.without_clock.saturating_add(1) } else { 0 };
        if self.without_clock == WITHOUT_CLOCK {
            let text = "use_sim_time is set, and there is no time on /clock yet: timers wait for \
                        it, and with them periodic topics; start the simulator or `volant play \
                        --clock`, or set use_sim_time to false";
            endpoints.logger.log(Level::Warn, text);
        }
        let mut all =
            vec![self.inputs(endpoints, state), self.outputs(endpoints), self.graph(endpoints)];
        all.extend(self.statuses.values().cloned());
        self.publisher.publish(DiagnosticArray { header: convert::header("", stamp), status: all });
    }

    /// Rate of the messages on a topic, `in` or `out`, since the last publication.
    fn rate(&mut self, name: &str, way: &str, count: u64) -> KeyValue {
        let rate = self.gain(format!("{name} {way}"), count) as f64 / self.interval;
        pair(format!("{name} rate [Hz]"), format!("{rate:.1}"))
    }

    /// Increase of a count since the last publication.
    fn gain(&mut self, key: String, count: u64) -> u64 {
        count.saturating_sub(self.previous.insert(key, count).unwrap_or(0))
    }

    fn inputs(&mut self, endpoints: &Endpoints, state: LifecycleState) -> DiagnosticStatus {
        let sources = endpoints.sources.counts();
        let now_steady = now();
        let is_missing = |s: &SourceCount| {
            let silent = |at| now_steady.duration_since(at) > MISSING_AFTER;
            s.kind == SourceKind::Expected && s.latest.is_none_or(silent)
        };
        let missing: Vec<String> =
            sources.iter().filter(|s| is_missing(s)).map(|s| s.name.clone()).collect();
        let mut values = Vec::new();
        let mut trouble = Vec::new();
        for SourceCount { name, received, dropped, refused, lost, kind, .. } in sources {
            // Monitors show these rows as topics and devices.
            let is_shown = kind != SourceKind::Service;
            if is_shown {
                values.push(self.rate(&name, "in", received));
                values.push(pair(format!("{name} received"), received));
            }
            for (what, count) in
                [("dropped", dropped), ("rejected", refused), ("lost in transport", lost)]
            {
                let key = format!("{name} {what}");
                if is_shown {
                    values.push(pair(&key, count));
                }
                let more = self.gain(key, count);
                if more > 0 {
                    trouble.push(format!("{more} {what} on {name}"));
                }
            }
        }
        let restart = endpoints.domain.took_over.map(|(at, loss)| (now().duration_since(at), loss));
        let (health, message) = if let Some((since, loss)) =
            restart.filter(|(since, _)| *since < RESTART_REPORTED_FOR)
        {
            let seconds = since.as_secs_f64();
            (Health::Warn, format!("the node restarted {seconds:.0} s ago: {loss}"))
        } else if let Some(time) = self.held_up {
            let seconds = time.as_secs_f64();
            let why = "its process was stopped or is slow, or the computer is overloaded";
            (Health::Warn, format!("the node stalled for {seconds:.1} s: {why}"))
        } else if state != LifecycleState::Active {
            (Health::Ok, format!("the node is {}", state.label()))
        } else if !missing.is_empty() {
            (Health::Warn, format!("no messages on {}", missing.join(", ")))
        } else if !trouble.is_empty() {
            (Health::Warn, trouble.join(", "))
        } else {
            (Health::Ok, "all inputs are received".to_owned())
        };
        status(&endpoints.name, "inputs", health, message, values)
    }

    /// Other nodes with this name, and topics with several publishers; a new conflict is logged.
    fn graph(&mut self, endpoints: &Endpoints) -> DiagnosticStatus {
        let sources = endpoints.sources.counts();
        let topics = endpoints.domain.transport.topics();
        let topics: Vec<(String, &TopicState, bool)> = topics
            .iter()
            .filter_map(|(name, _, state)| {
                let source = sources.iter().find(|source| source.name == *name)?;
                Some((name.clone(), &**state, source.kind == SourceKind::Expected))
            })
            .collect();
        let conflicts = endpoints.domain.graph.conflicts(&endpoints.name, &topics).join("; ");
        if conflicts != self.conflicts && !conflicts.is_empty() {
            endpoints.logger.log(Level::Warn, &conflicts);
        }
        self.conflicts.clone_from(&conflicts);
        let (health, message) = if conflicts.is_empty() {
            (Health::Ok, without_conflicts(&topics))
        } else {
            (Health::Warn, conflicts)
        };
        status(&endpoints.name, "graph", health, message, Vec::new())
    }

    fn outputs(&mut self, endpoints: &mut Endpoints) -> DiagnosticStatus {
        let mut values = Vec::new();
        let mut trouble = Vec::new();
        endpoints.publishers.retain(|p| p.strong_count() > 0);
        for publisher in endpoints.publishers.iter().filter_map(Weak::upgrade) {
            publisher.retry();
            let name = publisher.topic();
            values.push(self.rate(name, "out", publisher.published()));
            let refused = self.gain(format!("{name} not sent"), publisher.refused());
            if refused > 0 {
                trouble.push(format!(
                    "{refused} not sent on {name}: a reliable reader does not answer"
                ));
            }
        }
        let (health, message) = if trouble.is_empty() {
            (Health::Ok, "all outputs are sent".to_owned())
        } else {
            (Health::Warn, trouble.join(", "))
        };
        status(&endpoints.name, "outputs", health, message, values)
    }
}
