//! State of the monitor: samples in, [`Snapshot`]s out. No clock, thread or terminal.

use super::snapshot::{Flow, InputLine, PoseState, RigState, Snapshot, TopicLine};
use crate::live::tap::{Offer, Sample};
use bag::Topic;
use node_kit::convert;
use rig_model::topics::absolute;
use std::collections::{BTreeMap, VecDeque};
use volant_msgs::{
    Message, cdr,
    diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus},
    geometry_msgs::msg::{PoseWithCovarianceStamped, Vector3},
    msg::{MarkerObservations, PoseStatus},
    nav_msgs::msg::Odometry,
};

/// Time over which rates and delays are computed, ns.
const WINDOW: u64 = 5_000_000_000;
/// Arrivals kept per topic: 5 s of 1 kHz.
const ARRIVALS: usize = 5000;
/// Time without a message after which a topic is silent, ns.
const SILENT: u64 = 2_000_000_000;
/// Age beyond which a stamp belongs to another clock (a bag, a simulation), s.
const OTHER_CLOCK: f64 = 600.0;
/// Limit of diagnostics; a rig has about ten.
const MOST_STATUSES: usize = 512;

/// Everything received.
#[derive(Debug, Default)]
pub struct Monitor {
    topics: BTreeMap<String, TopicState>,
    rigs: BTreeMap<String, RigState>,
    statuses: BTreeMap<(String, String), (u64, DiagnosticStatus)>,
}

#[derive(Debug, Default)]
struct TopicState {
    publishers: usize,
    subscribed: bool,
    /// Its messages are kept for late subscribers, and not periodic.
    latched: bool,
    count: u64,
    lost: u64,
    /// Time of each arrival, ns, and the age of its stamp, s.
    arrivals: VecDeque<(u64, Option<f64>)>,
}

impl Monitor {
    /// Sets a topic's QoS and number of publishers, and whether the monitor subscribes.
    pub fn discover(&mut self, offer: &Offer, subscribed: bool) {
        let topic = self.topics.entry(offer.topic.name.clone()).or_default();
        (topic.publishers, topic.subscribed) = (offer.publishers, subscribed);
        topic.latched = offer.qos.transient_local;
    }

    /// Clears the publishers of all topics for which `published` returns false.
    pub fn retain_published(&mut self, published: impl Fn(&str) -> bool) {
        for (name, topic) in &mut self.topics {
            if !published(name) {
                topic.publishers = 0;
            }
        }
    }

    /// Adds a sample of a topic.
    pub fn add(&mut self, topic: &Topic, sample: &Sample) {
        let state = self.topics.entry(topic.name.clone()).or_default();
        state.count += 1;
        state.lost += sample.lost;
        if state.arrivals.len() == ARRIVALS {
            state.arrivals.pop_front();
        }
        state.arrivals.push_back((sample.log_time, age(topic, sample)));
        let at = sample.log_time;
        match &*topic.type_name {
            Odometry::TYPE_NAME => {
                if let Some((rig, m)) = self.rig::<Odometry>(topic, absolute::ODOMETRY, sample) {
                    let norm = |v: &Vector3| v.x.hypot(v.y).hypot(v.z);
                    let twist = &m.twist.twist;
                    let speed = [norm(&twist.linear), norm(&twist.angular).to_degrees()];
                    let pose = convert::pose(&m.pose.pose, "odometry").ok();
                    rig.odometry =
                        pose.map(|p| PoseState::new(at, &p, &m.pose.covariance, Some(speed)));
                }
            }
            PoseWithCovarianceStamped::TYPE_NAME => {
                let received = self.rig(topic, absolute::VISUAL_POSE, sample);
                if let Some((rig, PoseWithCovarianceStamped { pose: m, .. })) = received {
                    let pose = convert::pose(&m.pose, "visual_pose").ok();
                    rig.visual = pose.map(|p| PoseState::new(at, &p, &m.covariance, None));
                }
            }
            MarkerObservations::TYPE_NAME => {
                let received = self.rig(topic, absolute::MARKERS, sample);
                if let Some((rig, MarkerObservations { markers, .. })) = received {
                    (rig.markers, rig.markers_at) = (markers, at);
                }
            }
            PoseStatus::TYPE_NAME => {
                if let Some((rig, status)) = self.rig(topic, absolute::STATUS, sample) {
                    rig.status = Some((at, status));
                }
            }
            DiagnosticArray::TYPE_NAME => {
                for status in
                    cdr::from_bytes::<DiagnosticArray>(&sample.data).unwrap_or_default().status
                {
                    let key = (status.hardware_id.clone(), status.name.clone());
                    if self.statuses.len() < MOST_STATUSES || self.statuses.contains_key(&key) {
                        self.statuses.insert(key, (at, status));
                    }
                }
            }
            _ => {}
        }
    }

    /// The rig whose topic of this relative name is `topic`, and the message; `None` for another
    /// topic or an undecodable message.
    fn rig<M: Message>(
        &mut self,
        topic: &Topic,
        name: &str,
        sample: &Sample,
    ) -> Option<(&mut RigState, M)> {
        let namespace = topic.name.strip_suffix(name)?.to_owned();
        let message = cdr::from_bytes(&sample.data).ok()?;
        Some((self.rigs.entry(namespace).or_default(), message))
    }

    /// Summarizes what was received; `now` in ns of the samples' clock.
    pub fn snapshot(&self, now: u64) -> Snapshot {
        let topics = self.topics.iter().map(|(name, t)| TopicLine {
            name: name.clone(),
            publishers: t.publishers,
            flow: (t.subscribed || t.count > 0).then(|| t.flow(now)),
        });
        let statuses = self.statuses.values().map(|(at, status)| {
            let silent = now.saturating_sub(*at) > 5 * 1_000_000_000;
            DiagnosticStatus {
                level: if silent { DiagnosticStatus::STALE } else { status.level },
                // `<node>: <name>`; the node is in a field of its own.
                name: status.name.split_once(": ").map_or(&*status.name, |(_, n)| n).to_owned(),
                message: if silent {
                    format!("no message for 5 s; the last was: {}", status.message)
                } else {
                    status.message.clone()
                },
                hardware_id: status.hardware_id.clone(),
                values: vec![],
            }
        });
        let mut statuses: Vec<DiagnosticStatus> = statuses.collect();
        statuses.sort_by(|a, b| {
            let of_a = (&a.hardware_id, &a.name);
            b.level.cmp(&a.level).then_with(|| of_a.cmp(&(&b.hardware_id, &b.name)))
        });
        Snapshot {
            rigs: self.rigs.iter().map(|(name, rig)| (name.clone(), rig.clone())).collect(),
            topics: topics.collect(),
            inputs: self.statuses.values().flat_map(|(_, status)| inputs(status)).collect(),
            statuses,
            now,
            place: String::new(),
        }
    }
}

impl TopicState {
    fn flow(&self, now: u64) -> Flow {
        let recent: Vec<&(u64, Option<f64>)> =
            self.arrivals.iter().filter(|(at, _)| now.saturating_sub(*at) <= WINDOW).collect();
        let rate = match (recent.first(), recent.last()) {
            (Some((first, _)), Some((last, _)))
                if now.saturating_sub(*last) <= SILENT && last > first =>
            {
                (recent.len() - 1) as f64 / ((last - first) as f64 * 1e-9)
            }
            _ => 0.0,
        };
        let rate = (!self.latched).then_some(rate);
        let ages: Vec<f64> = recent.iter().filter_map(|(_, age)| *age).collect();
        let delay = (!ages.is_empty()).then(|| {
            (
                ages.iter().sum::<f64>() / ages.len() as f64,
                ages.iter().copied().fold(f64::MIN, f64::max),
            )
        });
        Flow { rate, delay, count: self.count, lost: self.lost }
    }
}

/// Time from the stamp in the header to the arrival, s.
fn age(topic: &Topic, sample: &Sample) -> Option<f64> {
    let first =
        topic.definition.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#'))?;
    let stamped = first.starts_with("std_msgs/Header header");
    // Little-endian CDR, whose first field after the header of four bytes is the stamp.
    if !stamped || sample.data.get(..2) != Some(&[0, 1]) {
        return None;
    }
    let sec = i32::from_le_bytes(sample.data.get(4..8)?.try_into().ok()?);
    let nanosec = u32::from_le_bytes(sample.data.get(8..12)?.try_into().ok()?);
    let stamp = i128::from(sec) * 1_000_000_000 + i128::from(nanosec);
    let age = (i128::from(sample.log_time) - stamp) as f64 * 1e-9;
    (age.abs() < OTHER_CLOCK).then_some(age)
}

/// The rows `<input> rate [Hz]`, `dropped`, … that every node has in its diagnostics.
fn inputs(status: &DiagnosticStatus) -> Vec<InputLine> {
    let mut lines: BTreeMap<&str, InputLine> = BTreeMap::new();
    if !status.name.ends_with(": inputs") {
        return vec![];
    }
    for pair in &status.values {
        let Some((input, what)) = ["rate [Hz]", "dropped", "rejected", "lost in transport"]
            .into_iter()
            .find_map(|what| Some((pair.key.strip_suffix(what)?.strip_suffix(' ')?, what)))
        else {
            continue;
        };
        let line = lines.entry(input).or_insert_with(|| InputLine {
            node: status.hardware_id.clone(),
            input: input.to_owned(),
            ..InputLine::default()
        });
        let count = || pair.value.parse().unwrap_or(0);
        match what {
            "rate [Hz]" => line.rate = pair.value.parse().unwrap_or(0.0),
            "dropped" => line.dropped = count(),
            "rejected" => line.rejected = count(),
            "lost in transport" => line.lost = count(),
            _ => {}
        }
    }
    lines.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bag::Qos;
    use volant_msgs::{diagnostic_msgs::msg::KeyValue, tf2_msgs::msg::TFMessage};

    const SECOND: u64 = 1_000_000_000;

    fn sample<M: Message>(at: u64, lost: u64, message: &M) -> Sample {
        Sample {
            log_time: at,
            publish_time: at,
            writer: [0; 16],
            lost,
            data: cdr::to_bytes(message),
        }
    }

    #[test]
    fn rates_delays_and_losses_are_those_of_the_last_seconds() {
        let topic = Topic::of::<Odometry>("/rig1/volant/odometry", &Qos::RELIABLE);
        let mut monitor = Monitor::default();
        let offer = |topic: &Topic, qos| Offer { topic: topic.clone(), qos, publishers: 1 };
        monitor.discover(&offer(&topic, Qos::RELIABLE), true);
        let mut message = Odometry::default();
        message.pose.pose.position.z = -1.5;
        message.pose.covariance[14] = 4e-6;
        message.twist.twist.linear.x = 0.3;
        for i in 0..1000u64 {
            let at = 100 * SECOND + i * 10_000_000;
            (message.header.stamp.sec, message.header.stamp.nanosec) =
                ((at / SECOND) as i32, (at % SECOND) as u32);
            monitor.add(&topic, &sample(at + 2_000_000, u64::from(i == 7), &message));
        }
        let now = 110 * SECOND;
        let snapshot = monitor.snapshot(now);
        let flow = snapshot.topics[0].flow.unwrap();
        assert!((flow.rate.unwrap() - 100.0).abs() < 0.01, "{flow:?}");
        assert_eq!((flow.count, flow.lost), (1000, 1));
        let (mean, max) = flow.delay.unwrap();
        assert!((mean - 0.002).abs() < 1e-9 && (max - 0.002).abs() < 1e-9);
        let (name, rig) = &snapshot.rigs[0];
        let pose = rig.odometry.unwrap();
        assert_eq!((name.as_str(), pose.position.z), ("/rig1", -1.5));
        assert!((pose.position_sigma[2] - 0.002).abs() < 1e-12 && pose.speed == Some([0.3, 0.0]));
        // Three seconds later it is silent.
        assert_eq!(monitor.snapshot(now + 3 * SECOND).topics[0].flow.unwrap().rate, Some(0.0));
        // Two latched messages have no rate.
        let latched = Topic::of::<TFMessage>(absolute::TF_STATIC, &Qos::LATCHED);
        monitor.discover(&offer(&latched, Qos::LATCHED), true);
        for at in [now, now + 30_000] {
            monitor.add(&latched, &sample(at, 0, &TFMessage::default()));
        }
        let flow = |s: Snapshot| s.topics.iter().find(|t| t.name == "/tf_static").unwrap().flow;
        assert_eq!(
            flow(monitor.snapshot(now + SECOND)).map(|f| (f.rate, f.count)),
            Some((None, 2))
        );
        monitor.retain_published(|_| false);
        assert_eq!(monitor.snapshot(now).topics[0].publishers, 0);
    }

    #[test]
    fn a_stamp_of_another_clock_is_no_delay() {
        let topic = Topic::of::<Odometry>(absolute::ODOMETRY, &Qos::RELIABLE);
        let mut monitor = Monitor::default();
        monitor.add(&topic, &sample(100_000 * SECOND, 0, &Odometry::default()));
        assert_eq!(monitor.snapshot(100_000 * SECOND).topics[0].flow.unwrap().delay, None);
    }

    #[test]
    fn diagnostics_are_sorted_and_go_stale() {
        let topic = Topic::of::<DiagnosticArray>(absolute::DIAGNOSTICS, &Qos::RELIABLE);
        let pair = |key: &str, value: &str| KeyValue { key: key.into(), value: value.into() };
        let status = |name: &str, level| DiagnosticStatus {
            level,
            name: format!("tracker: {name}"),
            message: format!("about {name}"),
            hardware_id: "/tracker".into(),
            values: vec![
                pair("/image rate [Hz]", "29.9"),
                pair("/image dropped", "4"),
                pair("/image rejected", "1"),
                pair("/image lost in transport", "2"),
            ],
        };
        let array = DiagnosticArray {
            status: vec![status("inputs", 0), status("markers", 1)],
            ..DiagnosticArray::default()
        };
        let mut monitor = Monitor::default();
        monitor.add(&topic, &sample(10 * SECOND, 0, &array));
        let snapshot = monitor.snapshot(11 * SECOND);
        let lines: Vec<_> =
            snapshot.statuses.iter().map(|s| (s.level, &*s.hardware_id, &*s.name)).collect();
        assert_eq!(lines, [(1, "/tracker", "markers"), (0, "/tracker", "inputs")]);
        assert_eq!(
            snapshot.inputs,
            [InputLine {
                node: "/tracker".into(),
                input: "/image".into(),
                rate: 29.9,
                dropped: 4,
                rejected: 1,
                lost: 2
            }]
        );
        let stale = monitor.snapshot(20 * SECOND);
        assert!(
            stale.statuses.iter().all(|s| s.level == 3 && s.message.starts_with("no message for"))
        );
    }

    #[test]
    fn undecodable_messages_are_only_counted() {
        let topic = Topic::of::<MarkerObservations>(absolute::MARKERS, &Qos::RELIABLE);
        let mut monitor = Monitor::default();
        for data in
            [vec![], vec![0, 1, 0, 0], vec![0, 1, 0, 0, 255, 255, 255, 255, 255], vec![0xff; 40]]
        {
            monitor.add(
                &topic,
                &Sample { log_time: 1, publish_time: 1, writer: [0; 16], lost: 0, data },
            );
        }
        let snapshot = monitor.snapshot(2);
        assert_eq!(snapshot.topics[0].flow.unwrap().count, 4);
        assert!(snapshot.rigs.is_empty());
    }
}
