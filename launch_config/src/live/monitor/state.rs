//! What the monitor knows: fed with samples, asked for a [`Snapshot`]. No clock, thread or terminal.

use crate::{bag::Topic, live::tap::Sample};
use nalgebra::{Isometry3, Vector3};
use node_kit::convert;
use rig_model::MarkerColor;
use std::collections::{BTreeMap, VecDeque};
use volant_msgs::{
    Message, cdr,
    diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus},
    geometry_msgs::msg::PoseWithCovarianceStamped,
    msg::{MarkerObservation, MarkerObservations},
    nav_msgs::msg::Odometry,
};

/// Rates and delays are those of the last 5 s, ns.
const WINDOW: u64 = 5_000_000_000;
/// Arrivals kept for that, per topic: enough for 1 kHz.
const ARRIVALS: usize = 5000;
/// A topic on which nothing came for this long is silent, ns.
const SILENT: u64 = 2_000_000_000;
/// A stamp that is further away than this is of another clock (a bag, a simulation), s.
const OTHER_CLOCK: f64 = 600.0;
/// Lines of diagnostics that are kept; a graph has some ten.
const MOST_STATUSES: usize = 512;

/// All that has come.
#[derive(Debug, Default)]
pub struct Monitor {
    topics: BTreeMap<String, TopicState>,
    rigs: BTreeMap<String, RigState>,
    statuses: BTreeMap<(String, String), (u64, DiagnosticStatus)>,
}

#[derive(Debug, Default)]
struct TopicState {
    type_name: String,
    publishers: usize,
    taken: bool,
    count: u64,
    lost: u64,
    /// When each came, ns, and the age of its stamp then, s.
    arrivals: VecDeque<(u64, Option<f64>)>,
}

/// The estimates and measurements of one rig.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigState {
    /// `volant/odometry`: `world_from_volant` and its twist in the volant frame.
    pub odometry: Option<PoseState>,
    /// `volant/visual_pose`: `world_from_volant` from one image alone.
    pub visual: Option<PoseState>,
    /// `climber/markers`.
    pub markers: Vec<MarkerState>,
    /// When the markers came, ns.
    pub markers_at: u64,
}

/// A pose with its standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseState {
    /// When it came, ns.
    pub at: u64,
    /// m.
    pub position: Vector3<f64>,
    /// Roll, pitch, yaw (fixed axes x, y, z), degrees.
    pub angles: [f64; 3],
    /// Of the position, m.
    pub position_sigma: [f64; 3],
    /// Of the rotation about the axes, degrees.
    pub angle_sigma: [f64; 3],
    /// m/s and degrees/s, where the message has a twist.
    pub speed: Option<[f64; 2]>,
}

/// A marker in the latest image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MarkerState {
    /// Which.
    pub color: MarkerColor,
    /// `DETECTED`, `PREDICTED`, `LOST`, or `?`.
    pub state: &'static str,
    /// px; NaN where it is lost.
    pub position: [f64; 2],
    /// px.
    pub sigma: [f64; 2],
    /// Images since it was last detected; `None` if it never was.
    pub hidden_for: Option<u16>,
}

/// What is shown at a moment.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// By namespace, such as `/rig1`; empty for the root.
    pub rigs: Vec<(String, RigState)>,
    /// By name.
    pub topics: Vec<TopicLine>,
    /// What the nodes say of their own inputs.
    pub inputs: Vec<InputLine>,
    /// Worst first.
    pub statuses: Vec<StatusLine>,
    /// When, ns.
    pub now: u64,
}

/// A topic as it comes here.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicLine {
    /// Absolute name.
    pub name: String,
    /// `package/msg/Type`.
    pub type_name: String,
    /// How many publish it.
    pub publishers: usize,
    /// `None`: the monitor does not take it.
    pub flow: Option<Flow>,
}

/// How a topic flows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Hz, over the last seconds; 0 where it is silent.
    pub rate: f64,
    /// Mean and largest time from the stamp to the arrival here, s.
    pub delay: Option<(f64, f64)>,
    /// Messages since the start.
    pub count: u64,
    /// Messages that were lost on the way here.
    pub lost: u64,
}

/// A node's own count of one of its inputs.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InputLine {
    /// Fully qualified name of the node.
    pub node: String,
    /// The topic or device.
    pub input: String,
    /// Hz.
    pub rate: f64,
    /// Messages that it did not get to, could not use, and that never came.
    pub dropped: u64,
    /// See `dropped`.
    pub refused: u64,
    /// See `dropped`.
    pub lost: u64,
}

/// A line of `/diagnostics`.
#[derive(Clone, Debug, PartialEq)]
pub struct StatusLine {
    /// 0 ok, 1 warning, 2 error, 3 stale.
    pub level: u8,
    /// Fully qualified name of the node.
    pub node: String,
    /// What it is about.
    pub name: String,
    /// What it says.
    pub message: String,
}

impl Monitor {
    /// Says who publishes what now; `taken` where the monitor subscribes.
    pub fn offered(&mut self, name: &str, type_name: &str, publishers: usize, taken: bool) {
        let topic = self.topics.entry(name.to_owned()).or_default();
        type_name.clone_into(&mut topic.type_name);
        (topic.publishers, topic.taken) = (publishers, taken);
    }

    /// Says that none of these topics has a publisher any more.
    pub fn gone(&mut self, still_there: impl Fn(&str) -> bool) {
        for (name, topic) in &mut self.topics {
            if !still_there(name) {
                topic.publishers = 0;
            }
        }
    }

    /// Takes a sample.
    pub fn take(&mut self, topic: &Topic, sample: &Sample) {
        let state = self.topics.entry(topic.name.clone()).or_default();
        state.count += 1;
        state.lost += sample.lost;
        if state.arrivals.len() == ARRIVALS {
            state.arrivals.pop_front();
        }
        state.arrivals.push_back((sample.log_time, age(topic, sample)));
        let rig = |suffix: &str| topic.name.strip_suffix(suffix).map(str::to_owned);
        match &*topic.type_name {
            Odometry::TYPE_NAME => {
                if let (Some(rig), Ok(m)) =
                    (rig("/volant/odometry"), cdr::from_bytes::<Odometry>(&sample.data))
                {
                    let twist = &m.twist.twist;
                    let norm = |v: &volant_msgs::geometry_msgs::msg::Vector3| v.x.hypot(v.y).hypot(v.z);
                    let speed = [norm(&twist.linear), norm(&twist.angular).to_degrees()];
                    let pose = convert::pose(&m.pose.pose, "odometry").ok();
                    self.rigs.entry(rig).or_default().odometry =
                        pose.map(|p| PoseState::new(sample.log_time, &p, &m.pose.covariance, Some(speed)));
                }
            }
            PoseWithCovarianceStamped::TYPE_NAME => {
                if let (Some(rig), Ok(m)) =
                    (rig("/volant/visual_pose"), cdr::from_bytes::<PoseWithCovarianceStamped>(&sample.data))
                {
                    let pose = convert::pose(&m.pose.pose, "visual_pose").ok();
                    self.rigs.entry(rig).or_default().visual =
                        pose.map(|p| PoseState::new(sample.log_time, &p, &m.pose.covariance, None));
                }
            }
            MarkerObservations::TYPE_NAME => {
                if let (Some(rig), Ok(m)) =
                    (rig("/climber/markers"), cdr::from_bytes::<MarkerObservations>(&sample.data))
                {
                    let rig = self.rigs.entry(rig).or_default();
                    rig.markers = m.markers.iter().filter_map(MarkerState::new).collect();
                    rig.markers_at = sample.log_time;
                }
            }
            DiagnosticArray::TYPE_NAME => {
                for status in cdr::from_bytes::<DiagnosticArray>(&sample.data).unwrap_or_default().status {
                    let key = (status.hardware_id.clone(), status.name.clone());
                    if self.statuses.len() < MOST_STATUSES || self.statuses.contains_key(&key) {
                        self.statuses.insert(key, (sample.log_time, status));
                    }
                }
            }
            _ => {}
        }
    }

    /// What there is to show; `now` in ns of the samples' clock.
    pub fn snapshot(&self, now: u64) -> Snapshot {
        let topics = self.topics.iter().map(|(name, t)| TopicLine {
            name: name.clone(),
            type_name: t.type_name.clone(),
            publishers: t.publishers,
            flow: (t.taken || t.count > 0).then(|| t.flow(now)),
        });
        let mut statuses: Vec<StatusLine> = self
            .statuses
            .iter()
            .map(|((node, name), (at, status))| {
                let silent = now.saturating_sub(*at) > 5 * 1_000_000_000;
                StatusLine {
                    level: if silent { DiagnosticStatus::STALE } else { status.level },
                    node: node.clone(),
                    // `<node>: <name>`; the node stands beside it.
                    name: status.name.split_once(": ").map_or(name.as_str(), |(_, n)| n).to_owned(),
                    message: if silent {
                        format!("nothing more was heard; the last was: {}", status.message)
                    } else {
                        status.message.clone()
                    },
                }
            })
            .collect();
        statuses
            .sort_by(|a, b| b.level.cmp(&a.level).then_with(|| (&a.node, &a.name).cmp(&(&b.node, &b.name))));
        Snapshot {
            rigs: self.rigs.iter().map(|(name, rig)| (name.clone(), rig.clone())).collect(),
            topics: topics.collect(),
            inputs: self.statuses.values().flat_map(|(_, status)| inputs(status)).collect(),
            statuses,
            now,
        }
    }
}

impl TopicState {
    fn flow(&self, now: u64) -> Flow {
        let recent: Vec<&(u64, Option<f64>)> =
            self.arrivals.iter().filter(|(at, _)| now.saturating_sub(*at) <= WINDOW).collect();
        let rate = match (recent.first(), recent.last()) {
            (Some((first, _)), Some((last, _))) if now.saturating_sub(*last) <= SILENT && last > first => {
                (recent.len() - 1) as f64 / ((last - first) as f64 * 1e-9)
            }
            _ => 0.0,
        };
        let ages: Vec<f64> = recent.iter().filter_map(|(_, age)| *age).collect();
        let delay = (!ages.is_empty()).then(|| {
            (ages.iter().sum::<f64>() / ages.len() as f64, ages.iter().copied().fold(f64::MIN, f64::max))
        });
        Flow { rate, delay, count: self.count, lost: self.lost }
    }
}

impl PoseState {
    fn new(at: u64, pose: &Isometry3<f64>, covariance: &[f64; 36], speed: Option<[f64; 2]>) -> Self {
        let (roll, pitch, yaw) = pose.rotation.euler_angles();
        let sigma = |i: usize| covariance[i * 7].max(0.0).sqrt();
        Self {
            at,
            position: pose.translation.vector,
            angles: [roll, pitch, yaw].map(f64::to_degrees),
            position_sigma: [sigma(0), sigma(1), sigma(2)],
            angle_sigma: [sigma(3), sigma(4), sigma(5)].map(f64::to_degrees),
            speed,
        }
    }
}

impl MarkerState {
    fn new(m: &MarkerObservation) -> Option<Self> {
        let color = MarkerColor::ALL.into_iter().nth(usize::from(m.color))?;
        Some(Self {
            color,
            state: match m.state {
                MarkerObservation::DETECTED => "DETECTED",
                MarkerObservation::PREDICTED => "PREDICTED",
                MarkerObservation::LOST => "LOST",
                _ => "?",
            },
            position: [m.x, m.y],
            sigma: [m.covariance[0].max(0.0).sqrt(), m.covariance[3].max(0.0).sqrt()],
            hidden_for: (m.occluded_frames != u16::MAX).then_some(m.occluded_frames),
        })
    }
}

/// From the stamp in the header to the arrival, s.
fn age(topic: &Topic, sample: &Sample) -> Option<f64> {
    let first = topic.definition.lines().map(str::trim).find(|l| !l.is_empty() && !l.starts_with('#'))?;
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

/// The rows `<input> rate [Hz]`, `dropped`, … that every node of this kit has in its diagnostics.
fn inputs(status: &DiagnosticStatus) -> Vec<InputLine> {
    let mut lines: BTreeMap<&str, InputLine> = BTreeMap::new();
    if !status.name.ends_with(": inputs") {
        return vec![];
    }
    for pair in &status.values {
        let Some((input, what)) = ["rate [Hz]", "dropped", "refused", "lost on the way"]
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
            "refused" => line.refused = count(),
            "lost on the way" => line.lost = count(),
            _ => {}
        }
    }
    lines.into_values().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bag::QosProfile;
    use volant_msgs::diagnostic_msgs::msg::KeyValue;

    const SECOND: u64 = 1_000_000_000;

    fn sample<M: Message>(at: u64, lost: u64, message: &M) -> Sample {
        Sample { log_time: at, publish_time: at, writer: [0; 16], lost, data: cdr::to_bytes(message) }
    }

    #[test]
    fn rates_delays_and_losses_are_those_of_the_last_seconds() {
        let topic = Topic::of::<Odometry>("/rig1/volant/odometry", &QosProfile::RELIABLE);
        let mut monitor = Monitor::default();
        monitor.offered(&topic.name, &topic.type_name, 1, true);
        let mut message = Odometry::default();
        message.pose.pose.position.z = -1.5;
        message.pose.covariance[14] = 4e-6;
        message.twist.twist.linear.x = 0.3;
        for i in 0..1000u64 {
            let at = 100 * SECOND + i * 10_000_000;
            (message.header.stamp.sec, message.header.stamp.nanosec) =
                ((at / SECOND) as i32, (at % SECOND) as u32);
            monitor.take(&topic, &sample(at + 2_000_000, u64::from(i == 7), &message));
        }
        let now = 110 * SECOND;
        let snapshot = monitor.snapshot(now);
        let flow = snapshot.topics[0].flow.unwrap();
        assert!((flow.rate - 100.0).abs() < 0.01, "{flow:?}");
        assert_eq!((flow.count, flow.lost), (1000, 1));
        let (mean, max) = flow.delay.unwrap();
        assert!((mean - 0.002).abs() < 1e-9 && (max - 0.002).abs() < 1e-9);
        let (name, rig) = &snapshot.rigs[0];
        let pose = rig.odometry.unwrap();
        assert_eq!((name.as_str(), pose.position.z), ("/rig1", -1.5));
        assert!((pose.position_sigma[2] - 0.002).abs() < 1e-12 && pose.speed == Some([0.3, 0.0]));
        // Three seconds later it is silent.
        assert_eq!(monitor.snapshot(now + 3 * SECOND).topics[0].flow.unwrap().rate, 0.0);
        monitor.gone(|_| false);
        assert_eq!(monitor.snapshot(now).topics[0].publishers, 0);
    }

    #[test]
    fn a_stamp_of_another_clock_is_no_delay() {
        let topic = Topic::of::<Odometry>("/volant/odometry", &QosProfile::RELIABLE);
        let mut monitor = Monitor::default();
        monitor.take(&topic, &sample(100_000 * SECOND, 0, &Odometry::default()));
        assert_eq!(monitor.snapshot(100_000 * SECOND).topics[0].flow.unwrap().delay, None);
    }

    #[test]
    fn diagnostics_are_sorted_and_go_stale() {
        let topic = Topic::of::<DiagnosticArray>("/diagnostics", &QosProfile::RELIABLE);
        let pair = |key: &str, value: &str| KeyValue { key: key.into(), value: value.into() };
        let status = |name: &str, level| DiagnosticStatus {
            level,
            name: format!("tracker: {name}"),
            message: format!("about {name}"),
            hardware_id: "/tracker".into(),
            values: vec![
                pair("/image rate [Hz]", "29.9"),
                pair("/image dropped", "4"),
                pair("/image refused", "1"),
                pair("/image lost on the way", "2"),
            ],
        };
        let array = DiagnosticArray {
            status: vec![status("inputs", 0), status("markers", 1)],
            ..DiagnosticArray::default()
        };
        let mut monitor = Monitor::default();
        monitor.take(&topic, &sample(10 * SECOND, 0, &array));
        let snapshot = monitor.snapshot(11 * SECOND);
        let lines: Vec<_> = snapshot.statuses.iter().map(|s| (s.level, &*s.node, &*s.name)).collect();
        assert_eq!(lines, [(1, "/tracker", "markers"), (0, "/tracker", "inputs")]);
        assert_eq!(
            snapshot.inputs,
            [InputLine {
                node: "/tracker".into(),
                input: "/image".into(),
                rate: 29.9,
                dropped: 4,
                refused: 1,
                lost: 2
            }]
        );
        let stale = monitor.snapshot(20 * SECOND);
        assert!(stale.statuses.iter().all(|s| s.level == 3 && s.message.starts_with("nothing more")));
    }

    #[test]
    fn bytes_that_are_no_message_are_counted_and_nothing_else() {
        let topic = Topic::of::<MarkerObservations>("/climber/markers", &QosProfile::RELIABLE);
        let mut monitor = Monitor::default();
        for data in [vec![], vec![0, 1, 0, 0], vec![0, 1, 0, 0, 255, 255, 255, 255, 255], vec![0xff; 40]] {
            monitor.take(&topic, &Sample { log_time: 1, publish_time: 1, writer: [0; 16], lost: 0, data });
        }
        let snapshot = monitor.snapshot(2);
        assert_eq!(snapshot.topics[0].flow.unwrap().count, 4);
        assert!(snapshot.rigs.is_empty());
    }
}
