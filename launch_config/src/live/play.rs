//! A bag onto live topics, at the pace of its log times.

use super::{
    LiveError, join,
    raw::{Raw, RawAdapter, dds_type_name, policies},
};
use crate::{
    bag::{BagReader, Durability, QosProfile},
    replay::TopicNames,
    stopwatch::Stopwatch,
};
use rustdds::{Publisher, TopicKind, no_key::DataWriter};
use std::{
    collections::BTreeMap,
    path::PathBuf,
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};
use volant_msgs::{Message, builtin_interfaces::msg::Time, cdr, rosgraph_msgs::msg::Clock};

/// The longest that anything is slept without a look at the keys.
const SLICE: Duration = Duration::from_millis(20);

/// What is played, and how.
#[derive(Clone, Debug)]
pub struct PlayOptions {
    /// The bag.
    pub input: PathBuf,
    /// 2: twice as fast as it was recorded.
    pub rate: f64,
    /// From its beginning again at its end.
    pub repeat: bool,
    /// What is left out of the beginning.
    pub start_offset: Duration,
    /// What is waited at first, for subscribers to find the topics.
    pub delay: Duration,
    /// Publishes `/clock` so often a second.
    pub clock_hz: Option<f64>,
    /// Names in the bag; empty: all.
    pub topics: Vec<String>,
    /// Remaps of names in the bag.
    pub names: TopicNames,
}

/// Asked from outside while it plays.
#[derive(Debug, Default)]
pub struct PlayControl {
    /// Ends it.
    pub stop: AtomicBool,
    /// Holds it while set.
    pub paused: AtomicBool,
}

/// What was played.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlayReport {
    /// Messages published.
    pub messages: u64,
    /// Messages that were not: the middleware refused them (a reliable subscriber did not keep up), or they are not
    /// little-endian CDR.
    pub refused: u64,
    /// What the bag lost, one sentence each.
    pub losses: Vec<String>,
}

struct Writer {
    writer: DataWriter<Raw, RawAdapter>,
    latched: bool,
}

/// Plays. `progress` is told the bag's time, ns, and its span.
///
/// # Errors
/// The bag cannot be read or holds nothing to play, or DDS refuses.
pub fn play(
    options: &PlayOptions,
    control: &PlayControl,
    mut progress: impl FnMut(u64, (u64, u64)),
) -> Result<PlayReport, LiveError> {
    let summary = BagReader::summary(&options.input)?;
    let nothing = |why: String| LiveError::Nothing { path: options.input.display().to_string(), why };
    let Some((first, last)) = summary.span else {
        return Err(nothing(": it holds no message".into()));
    };
    let offset = u64::try_from(options.start_offset.as_nanos()).unwrap_or(u64::MAX);
    let start = first.saturating_add(offset);
    if start > last {
        return Err(nothing(format!(": it is {:.3} s long", (last - first) as f64 * 1e-9)));
    }
    let participant = join()?;
    let failed = |what: &str, reason: String| LiveError::Middleware { what: what.to_owned(), reason };
    let publisher = participant
        .create_publisher(&policies(&QosProfile::RELIABLE, rustdds::Duration::ZERO))
        .map_err(|e| failed("a publisher", e.to_string()))?;
    let mut writers = BTreeMap::new();
    for (topic, count) in &summary.topics {
        let asked = options.topics.is_empty() || options.topics.contains(&topic.name);
        let clock = options.clock_hz.is_some() && topic.type_name == Clock::TYPE_NAME;
        if *count == 0 || !asked || clock || writers.contains_key(&topic.name) {
            continue;
        }
        let qos = QosProfile::from_yaml(&topic.offered_qos_profiles);
        let name = options.names.resolve(&topic.name);
        let writer = writer(&participant, &publisher, &name, &topic.type_name, &qos)?;
        writers.insert(topic.name.clone(), writer);
    }
    if writers.is_empty() {
        let known: Vec<&str> = summary.topics.iter().map(|(t, _)| t.name.as_str()).collect();
        return Err(nothing(format!(" on {}; it holds {}", options.topics.join(", "), known.join(", "))));
    }
    let clock = match options.clock_hz {
        Some(hz) => {
            let name = options.names.resolve("/clock");
            let qos = QosProfile::SENSOR;
            Some((writer(&participant, &publisher, &name, Clock::TYPE_NAME, &qos)?, 1.0 / hz))
        }
        None => None,
    };
    let mut report = PlayReport::default();
    let mut pace = Pace { clock, clock_due: 0.0, watch: Stopwatch::start(), control };
    pace.hold(options.delay);
    loop {
        let mut bag = BagReader::open(&options.input)?;
        let mut played = Position { bag: start, wall: pace.now() };
        while let Some(message) = bag.next_message()? {
            if control.stop.load(Ordering::Acquire) {
                break;
            }
            let Some(writer) = writers.get(&message.topic.name) else { continue };
            // What is latched counts from the beginning, however late one starts.
            let early = message.log_time < start;
            if early && !writer.latched {
                continue;
            }
            if !early {
                pace.until(&mut played, message.log_time, options.rate);
                progress(message.log_time, (first, last));
            }
            let little_endian = message.data.get(..2) == Some(&[0, 1]);
            if little_endian && writer.writer.write(Raw(message.data), None).is_ok() {
                report.messages += 1;
            } else {
                report.refused += 1;
            }
        }
        report.losses = bag.losses().to_vec();
        if !options.repeat || control.stop.load(Ordering::Acquire) {
            break;
        }
    }
    // What a reliable subscriber still misses is sent again while this waits.
    for writer in writers.values() {
        let _ = writer.writer.wait_for_acknowledgments(Duration::from_millis(500));
    }
    Ok(report)
}

fn writer(
    participant: &rustdds::DomainParticipant,
    publisher: &Publisher,
    name: &str,
    type_name: &str,
    qos: &QosProfile,
) -> Result<Writer, LiveError> {
    let failed = |reason: String| LiveError::Middleware { what: format!("the publisher of {name}"), reason };
    let latched = qos.durability == Durability::TransientLocal;
    // A subscriber that is behind holds the player up for a moment, not for good.
    let policies = policies(qos, rustdds::Duration::from_millis(100));
    let topic = participant
        .create_topic(format!("rt{name}"), dds_type_name(type_name), &policies, TopicKind::NoKey)
        .map_err(|e| failed(e.to_string()))?;
    let writer =
        publisher.create_datawriter_no_key(&topic, Some(policies)).map_err(|e| failed(e.to_string()))?;
    Ok(Writer { writer, latched })
}

/// A moment of the bag and when it was played.
struct Position {
    /// ns.
    bag: u64,
    /// s since the start.
    wall: f64,
}

struct Pace<'a> {
    clock: Option<(Writer, f64)>,
    clock_due: f64,
    watch: Stopwatch,
    control: &'a PlayControl,
}

impl Pace<'_> {
    fn now(&self) -> f64 {
        self.watch.elapsed().as_secs_f64()
    }

    fn stopped(&self) -> bool {
        self.control.stop.load(Ordering::Acquire)
    }

    fn hold(&self, time: Duration) {
        let end = self.now() + time.as_secs_f64();
        while !self.stopped() && self.now() < end {
            std::thread::sleep(SLICE.min(Duration::from_secs_f64((end - self.now()).max(0.0))));
        }
    }

    /// Waits until the bag's time has come, publishing the clock meanwhile; a pause shifts what comes after it.
    fn until(&mut self, played: &mut Position, log_time: u64, rate: f64) {
        loop {
            let now = self.now();
            if self.stopped() {
                return;
            }
            if self.control.paused.load(Ordering::Acquire) {
                std::thread::sleep(SLICE);
                played.wall += self.now() - now;
                continue;
            }
            let left = (log_time.saturating_sub(played.bag)) as f64 * 1e-9 / rate - (now - played.wall);
            let clock_left = self.tick(played, now, rate);
            if left <= 0.0 {
                return;
            }
            let slice = left.min(clock_left).min(SLICE.as_secs_f64());
            std::thread::sleep(Duration::from_secs_f64(slice.max(0.0)));
        }
    }

    /// Publishes the clock where it is due; how long until it is again, s.
    fn tick(&mut self, played: &Position, now: f64, rate: f64) -> f64 {
        let Some((writer, period)) = &self.clock else {
            return f64::INFINITY;
        };
        if now >= self.clock_due {
            let bag = played.bag + ((now - played.wall).max(0.0) * rate * 1e9) as u64;
            let clock = Clock {
                clock: Time {
                    sec: i32::try_from(bag / 1_000_000_000).unwrap_or(i32::MAX),
                    nanosec: (bag % 1_000_000_000) as u32,
                },
            };
            // Best effort: the next one comes soon.
            let _ = writer.writer.write(Raw(cdr::to_bytes(&clock)), None);
            self.clock_due = now + period;
        }
        (self.clock_due - now).max(0.0)
    }
}
