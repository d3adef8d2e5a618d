//! Plays a bag to live topics, at the pace of its log times.

use super::{
    raw::{Raw, RawAdapter, ros_type_name},
    thread_ended,
};
use crate::{
    command_line::{number, seconds},
    replay::{Remap, TopicNames, empty},
    stopwatch::Stopwatch,
};
use anyhow::{Result, anyhow};
use bag::{BagReader, Qos, Topic, qos_from_yaml};
use node_kit::node::{
    NodeContext, NodeHandle, Process, ros_topic, unlimited_policies, with_type_hash,
};
use rig_model::topics;
use rustdds::{DomainParticipant, RTPSEntity, no_key::DataWriter};
use std::{
    collections::BTreeMap,
    convert::Infallible,
    path::PathBuf,
    sync::{
        atomic::{AtomicBool, Ordering},
        mpsc::sync_channel,
    },
    time::Duration,
};
use volant_msgs::{Message, builtin_interfaces::msg::Time, cdr, rosgraph_msgs::msg::Clock};

/// Longest sleep between two checks of the controls, and shortest time of a repetition.
const SLICE: Duration = Duration::from_millis(20);

/// How long a player waits at its end for acknowledgments of reliable subscribers. (One that was
/// killed never acknowledges.)
const LAST_WAIT: Duration = Duration::from_secs(5);

/// The same for a player that was stopped.
const STOPPED_WAIT: Duration = Duration::from_millis(500);

/// How long it stays after that. A subscriber may have acknowledged samples that its program has
/// not read yet, and RustDDS 0.15.1 as published drops unread samples when their publisher leaves
/// (`forks/patches/rustdds-4-gone-writer.patch`).
const LINGER: Duration = Duration::from_millis(500);

/// Options of a playback.
#[derive(Clone, Debug, clap::Args)]
pub struct PlayOptions {
    /// Bag: an .mcap file or a rosbag2 folder
    pub input: PathBuf,
    /// Playback rate; 2 is twice as fast as recorded
    #[arg(short, long, default_value_t = 1.0, value_parser = number(1e-3..=1e3))]
    pub rate: f64,
    /// Restart at the end
    #[arg(short = 'l', long = "loop")]
    pub repeat: bool,
    /// Time to skip at the start, s
    #[arg(long, value_name = "SECONDS", default_value = "0", value_parser = seconds(0.0..=1e9))]
    pub start_offset: Duration,
    /// Time to wait for subscribers before the first message, s
    #[arg(
        short,
        long,
        value_name = "SECONDS",
        default_value = "0.5",
        value_parser = seconds(0.0..=3600.0)
    )]
    pub delay: Duration,
    /// Start paused; the space bar and SIGUSR1 resume and pause
    #[arg(short, long)]
    pub paused: bool,
    /// Publish /clock at this rate, Hz [without a value: 40]
    #[arg(
        long,
        value_name = "HZ",
        num_args = 0..=1,
        default_missing_value = "40",
        value_parser = number(1e-3..=1e3)
    )]
    pub clock: Option<f64>,
    /// Play only these topics
    #[arg(long, value_name = "TOPIC", num_args = 1.., value_parser = absolute)]
    pub topics: Vec<String>,
    /// Remap a topic, FROM:=TO; repeatable
    #[arg(short = 'm', long, value_name = "FROM:=TO", num_args = 1..)]
    pub remap: Vec<Remap>,
}

/// Absolute name of a topic in the bag.
fn absolute(name: &str) -> Result<String, Infallible> {
    Ok(TopicNames::default().resolve(name))
}

/// Result of a playback.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlayReport {
    /// Number of published messages.
    pub messages: u64,
    /// Number of messages that were not published: the middleware rejected them (a reliable
    /// subscriber did not keep up), or they are not little-endian CDR.
    pub rejected: u64,
    /// Losses in the bag, one sentence each.
    pub losses: Vec<String>,
}

struct Writer {
    writer: DataWriter<Raw, RawAdapter>,
    latched: bool,
}

/// Plays a bag as the node `rosbag2_player`, until `stop` is set; its time stops while `paused` is
/// set, which is [`PlayOptions::paused`] at the start. `progress` is called with the bag's time and
/// its span, ns. Topics that the bag lacks are left out.
///
/// # Errors
/// The bag is unreadable, holds nothing to play or lacks a remapped topic; a topic is remapped to
/// one of another type; DDS creates no node or publisher.
pub fn play(
    options: &PlayOptions,
    stop: &AtomicBool,
    paused: &AtomicBool,
    mut progress: impl FnMut(u64, (u64, u64)),
) -> Result<PlayReport> {
    let summary = BagReader::summary(&options.input)?;
    let names = TopicNames::new("", &options.remap);
    let nothing = |why: String| anyhow!("{}: nothing to play{why}", options.input.display());
    let Some((first, last)) = summary.span else {
        return Err(nothing(empty(&summary).map_or_else(String::new, |why| format!(": {why}"))));
    };
    let offset = u64::try_from(options.start_offset.as_nanos()).unwrap_or(u64::MAX);
    let start = first.saturating_add(offset);
    if start > last {
        return Err(nothing(format!(": it is {:.3} s long", (last - first) as f64 * 1e-9)));
    }
    let known = summary.topics.iter().map(|(t, _)| t.name.as_str()).collect::<Vec<_>>();
    let holds = |name: &str| name == topics::absolute::CLOCK || known.contains(&name);
    let absent = |topics: &str| nothing(format!(" on {topics}; it holds {}", known.join(", ")));
    if let Some(name) = names.remapped().find(|name| !holds(name)) {
        return Err(absent(name));
    }
    if !options.topics.is_empty() && !options.topics.iter().any(|name| holds(name)) {
        return Err(absent(&options.topics.join(", ")));
    }
    let mut chosen = BTreeMap::new();
    for (topic, count) in &summary.topics {
        let selected = options.topics.is_empty() || options.topics.contains(&topic.name);
        let clock = options.clock.is_some() && topic.type_name == Clock::TYPE_NAME;
        if *count > 0 && selected && !clock {
            let published = Topic { name: names.resolve(&topic.name), ..topic.clone() };
            chosen.entry(topic.name.clone()).or_insert(published);
        }
    }
    if chosen.is_empty() {
        return Err(nothing(format!(" on {}: they are empty", options.topics.join(", "))));
    }
    let moved = chosen.iter().filter(|(name, topic)| **name != topic.name);
    let moved: Vec<Topic> = moved.map(|(_, topic)| topic.clone()).collect();
    for topic in &moved {
        let mut there = chosen.values().filter(|other| other.name == topic.name);
        if let Some(other) = there.find(|other| other.type_name != topic.type_name) {
            return Err(two_types(topic, &other.type_name));
        }
    }
    let clock = options.clock.map(|hz| {
        let name = names.resolve(topics::absolute::CLOCK);
        (Topic::of::<Clock>(&name, &Qos::SENSOR), 1.0 / hz)
    });
    let (_node, (writers, clock, participant)) = start_player(move |node| {
        let mut writers = BTreeMap::new();
        for (name, topic) in chosen {
            writers.insert(name, advertise(&topic, node)?);
        }
        let clock = match clock {
            Some((topic, period)) => Some((advertise(&topic, node)?, period)),
            None => None,
        };
        Ok((writers, clock, node.participant()))
    })?;
    let mut report = PlayReport::default();
    let mut pace = Pace {
        clock,
        clock_due: 0.0,
        watch: Stopwatch::start(),
        stop,
        paused,
        rate: options.rate,
        origin: first,
        position: 0.0,
        seen: 0.0,
    };
    pace.hold(options.delay);
    'bag: loop {
        check_types(&participant, &moved)?;
        let mut bag = BagReader::open(&options.input)?;
        let pass = Stopwatch::start();
        pace.leap(start);
        while let Some(message) = bag.next_message()? {
            let Some(writer) = writers.get(&message.topic.name) else { continue };
            // Latched messages before the start are published at once.
            if message.log_time < start {
                if !writer.latched {
                    continue;
                }
            } else if pace.until(message.log_time) {
                progress(message.log_time, (first, last));
            } else {
                report.losses = bag.losses().to_vec();
                break 'bag;
            }
            let little_endian = message.data.get(..2) == Some(&[0, 1]);
            if little_endian && writer.writer.write(Raw(message.data), None).is_ok() {
                report.messages += 1;
            } else {
                report.rejected += 1;
            }
        }
        report.losses = bag.losses().to_vec();
        if !options.repeat || pace.is_stopped() {
            break;
        }
        // A bag whose messages have one time is not repeated as fast as possible.
        pace.hold(SLICE.saturating_sub(pass.elapsed()));
    }
    // DDS repeats what reliable subscribers miss while this waits.
    let watch = Stopwatch::start();
    let in_time = || watch.elapsed() < if pace.is_stopped() { STOPPED_WAIT } else { LAST_WAIT };
    for writer in writers.values() {
        while in_time() && matches!(writer.writer.wait_for_acknowledgments(SLICE), Ok(false)) {}
    }
    pace.hold(LINGER);
    if !pace.is_stopped() {
        check_types(&participant, &moved)?;
    }
    Ok(report)
}

/// Checks the remapped topics against the publishers and subscribers discovered so far.
///
/// # Errors
/// One of them has another type, so that its subscribers do not receive the messages.
fn check_types(participant: &DomainParticipant, remapped: &[Topic]) -> Result<()> {
    if remapped.is_empty() {
        return Ok(());
    }
    let writers = participant.discovered_writers().into_iter().map(|writer| {
        let data = writer.publication_topic_data;
        (data.topic_name, data.type_name)
    });
    let readers = participant.discovered_readers().into_iter().map(|reader| {
        let data = reader.subscription_topic_data;
        (data.topic_name.clone(), data.type_name().clone())
    });
    for (name, type_name) in writers.chain(readers) {
        let (name, type_name) = (name.strip_prefix("rt"), ros_type_name(&type_name));
        let Some(type_name) = type_name else { continue };
        let is_other = |t: &&Topic| name == Some(t.name.as_str()) && t.type_name != type_name;
        if let Some(topic) = remapped.iter().find(is_other) {
            return Err(two_types(topic, &type_name));
        }
    }
    Ok(())
}

fn two_types(topic: &Topic, other: &str) -> anyhow::Error {
    anyhow!(
        "{}: the topic has the type {other}, and messages of {} are remapped to it; give another \
         name to --remap",
        topic.name,
        topic.type_name
    )
}

/// Starts a node with rosbag2's name, which owns in the graph what `publish` creates on it.
/// Dropping the returned process ends it.
fn start_player<T: Send + 'static>(
    publish: impl FnOnce(&mut NodeHandle) -> Result<T> + Send + 'static,
) -> Result<(Process, T)> {
    let mut process = Process::from_environment()?;
    let (made, publishers) = sync_channel(1);
    let mut publish = Some(publish);
    process.start_closure("rosbag2_player", move |context: &mut NodeContext<()>| {
        // Once: the publishers stay when the node is configured again.
        if let Some(publish) = publish.take() {
            // The receiver is there until this has returned.
            let _ = made.send(publish(context));
        }
        Ok(|_: &mut NodeContext<()>, ()| ())
    })?;
    let publishers = publishers.recv().map_err(|_| thread_ended("the player's node"))??;
    Ok((process, publishers))
}

/// Creates the publisher of a topic, with the QoS that its publishers offered.
fn advertise(topic: &Topic, node: &mut NodeHandle) -> Result<Writer> {
    let qos = qos_from_yaml(&topic.offered_qos_profiles);
    // A slow subscriber delays the player for a moment only.
    let policies = unlimited_policies(&qos, rustdds::Duration::from_millis(100)).build();
    let policies = with_type_hash(policies, &topic.type_hash);
    let participant = node.participant();
    let dds_topic = ros_topic(&participant, &topic.name, &topic.type_name, &policies)?;
    let writer = participant
        .create_publisher(&policies)
        .and_then(|publisher| publisher.create_datawriter_no_key(&dds_topic, Some(policies)))
        .map_err(|e| anyhow!("the publisher of {}: {e}", topic.name))?;
    node.announce_writer(writer.guid());
    Ok(Writer { writer, latched: qos.transient_local })
}

struct Pace<'a> {
    clock: Option<(Writer, f64)>,
    clock_due: f64,
    watch: Stopwatch,
    stop: &'a AtomicBool,
    paused: &'a AtomicBool,
    rate: f64,
    /// Time in the bag, ns.
    origin: u64,
    /// Position in the bag, s since the origin, and when it was updated, s of the stopwatch.
    position: f64,
    seen: f64,
}

impl Pace<'_> {
    fn now(&self) -> f64 {
        self.watch.elapsed().as_secs_f64()
    }

    fn is_stopped(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    fn hold(&self, time: Duration) {
        let end = self.now() + time.as_secs_f64();
        while !self.is_stopped() && self.now() < end {
            std::thread::sleep(SLICE.min(Duration::from_secs_f64((end - self.now()).max(0.0))));
        }
    }

    fn since_origin(&self, time: u64) -> f64 {
        (i128::from(time) - i128::from(self.origin)) as f64 * 1e-9
    }

    /// Continues at a time of the bag, ns.
    fn leap(&mut self, time: u64) {
        (self.position, self.seen) = (self.since_origin(time), self.now());
    }

    /// Waits until the bag's time, and publishes the clock meanwhile; false where the player is
    /// stopped. Time stops while paused.
    fn until(&mut self, log_time: u64) -> bool {
        let due = self.since_origin(log_time);
        while !self.is_stopped() {
            let (paused, now) = (self.paused.load(Ordering::Acquire), self.now());
            if !paused {
                self.position += (now - self.seen) * self.rate;
            }
            self.seen = now;
            let clock_left = self.tick(now);
            let left = if paused { f64::INFINITY } else { (due - self.position) / self.rate };
            if left <= 0.0 {
                return true;
            }
            let slice = left.min(clock_left).min(SLICE.as_secs_f64());
            std::thread::sleep(Duration::from_secs_f64(slice.max(0.0)));
        }
        false
    }

    /// Publishes the clock if it is due; returns the time until it is due again, s.
    fn tick(&mut self, now: f64) -> f64 {
        let Some((writer, period)) = &self.clock else {
            return f64::INFINITY;
        };
        if now >= self.clock_due {
            let bag = self.origin.saturating_add_signed((self.position * 1e9) as i64);
            let clock = Clock {
                clock: Time {
                    sec: i32::try_from(bag / 1_000_000_000).unwrap_or(i32::MAX),
                    nanosec: (bag % 1_000_000_000) as u32,
                },
            };
            // Best effort: the next one follows soon.
            let _ = writer.writer.write(Raw(cdr::to_bytes(&clock)), None);
            self.clock_due = now + period;
        }
        (self.clock_due - now).max(0.0)
    }
}
