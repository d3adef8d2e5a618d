//! The ROS graph beyond this process: which node has which publisher, and what is in conflict.
//!
//! RustDDS reports publishers by GUID. Their nodes are in `ros_discovery_info`, in which every
//! rmw announces them (`rmw_dds_common/msg/ParticipantEntitiesInfo`).

use super::{
    endpoints::{policies, with_type_hash},
    intra_process::TopicState,
};
use crate::{inbox::now, names::NodeName, qos::Qos};
use parking_lot::RwLock;
use ros2_client::Gid;
use rustdds::{
    CDRDeserializerAdapter, DomainParticipant, GUID, ReadCondition, TopicKind,
    discovery::DiscoveredWriterData, no_key::DataReader,
};
use serde::Deserialize;
use std::{
    collections::{BTreeMap, BTreeSet},
    net::SocketAddr,
    time::Duration,
};

/// The start of a GUID, which all endpoints of a participant share.
type Prefix = [u8; 12];

/// A publisher that was received from within this time is sending: three periods of a joint state
/// at 1 Hz.
const SENDING: Duration = Duration::from_secs(3);
/// Participants whose announcements are kept.
const MOST_PARTICIPANTS: usize = 1024;
/// Topics with many publishers by design, in every namespace.
const SHARED: [&str; 5] = ["tf", "tf_static", "diagnostics", "rosout", "parameter_events"];

#[derive(Clone, Debug, Deserialize)]
struct ParticipantInfo {
    gid: [u8; 16],
    nodes: Vec<NodeInfo>,
}

#[derive(Clone, Debug, Deserialize)]
struct NodeInfo {
    namespace: String,
    name: String,
    #[allow(dead_code, reason = "part of the message")]
    readers: Vec<[u8; 16]>,
    writers: Vec<[u8; 16]>,
}

impl NodeInfo {
    fn full_name(&self) -> String {
        format!("{}/{}", self.namespace.trim_end_matches('/'), self.name)
    }
}

/// Nodes and hosts of the participants in the domain.
#[derive(Default)]
pub(crate) struct Graph {
    nodes: RwLock<BTreeMap<Prefix, Vec<NodeInfo>>>,
    /// Addresses of each participant that has a publisher.
    hosts: RwLock<BTreeMap<Prefix, String>>,
}

/// RIHS01 hash of `rmw_dds_common/msg/ParticipantEntitiesInfo`.
const ANNOUNCEMENT_HASH: &str =
    "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e";

/// Subscription of `ros_discovery_info`.
pub(crate) struct Announcements(
    DataReader<ParticipantInfo, CDRDeserializerAdapter<ParticipantInfo>>,
);

impl Announcements {
    /// Subscribes; `None` where DDS refuses it, for instance because a security enclave does not
    /// permit the topic. Publishers have GUIDs without names then.
    pub fn subscribe(participant: &DomainParticipant) -> Option<Self> {
        let qos = policies(&Qos {
            reliable: true,
            transient_local: true,
            depth: MOST_PARTICIPANTS,
            max_samples: MOST_PARTICIPANTS,
        });
        let qos = with_type_hash(qos, ANNOUNCEMENT_HASH);
        let type_name = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_".to_owned();
        let name = "ros_discovery_info".to_owned();
        let topic = participant.create_topic(name, type_name, &qos, TopicKind::NoKey).ok()?;
        let subscriber = participant.create_subscriber(&qos).ok()?;
        subscriber.create_datareader_no_key(&topic, Some(qos)).ok().map(Self)
    }
}

impl Graph {
    /// Reads what was announced since the last call.
    pub fn read(&self, announcements: &mut Announcements) {
        // One that cannot be decoded is consumed and skipped.
        for _ in 0..MOST_PARTICIPANTS {
            match announcements.0.take(MOST_PARTICIPANTS, ReadCondition::not_read()) {
                Ok(samples) if samples.is_empty() => return,
                Ok(samples) => {
                    let mut nodes = self.nodes.write();
                    for info in samples.into_iter().map(|sample| sample.into_value()) {
                        let prefix = prefix(&info.gid);
                        if nodes.len() < MOST_PARTICIPANTS || nodes.contains_key(&prefix) {
                            nodes.insert(prefix, info.nodes);
                        }
                    }
                }
                Err(_) => {}
            }
        }
    }

    /// Keeps the participants that have a publisher among `writers`, and this process's own.
    pub fn keep(&self, own: GUID, writers: &[DiscoveredWriterData]) {
        let mut hosts = BTreeMap::<Prefix, BTreeSet<String>>::new();
        for writer in writers {
            let hosts =
                hosts.entry(prefix(&writer.publication_topic_data.key.to_bytes())).or_default();
            for locator in &writer.writer_proxy.unicast_locator_list {
                let address = SocketAddr::from(*locator).ip();
                if !address.is_unspecified() {
                    hosts.insert(address.to_string());
                }
            }
        }
        let own = prefix(&own.to_bytes());
        self.nodes.write().retain(|prefix, _| *prefix == own || hosts.contains_key(prefix));
        let joined = |all: BTreeSet<String>| match all.len() {
            0 => "an unknown address".to_owned(),
            _ => all.into_iter().collect::<Vec<_>>().join(" and "),
        };
        let mut hosts: BTreeMap<_, _> =
            hosts.into_iter().map(|(p, all)| (p, joined(all))).collect();
        hosts.insert(own, format!("this computer, process {}", std::process::id()));
        *self.hosts.write() = hosts;
    }

    /// Describes every conflict that concerns a node that subscribes to these topics; each with
    /// whether messages are expected on it all the time.
    pub fn conflicts(
        &self,
        node: &NodeName,
        topics: &[(String, &TopicState, bool)],
    ) -> Vec<String> {
        let mut all: Vec<String> = self.names(node).into_iter().collect();
        all.extend(topics.iter().filter_map(|(name, state, expected)| {
            let base = name.rsplit('/').next().unwrap_or_default();
            (!SHARED.contains(&base)).then(|| self.publishers(name, state, *expected)).flatten()
        }));
        all
    }

    /// Reports further nodes with this node's name, or a second rig in its namespace.
    fn names(&self, node: &NodeName) -> Option<String> {
        let (nodes, hosts) = (self.nodes.read(), self.hosts.read());
        let mut places = BTreeMap::<String, Vec<String>>::new();
        for (prefix, info) in nodes.iter().flat_map(|(p, all)| all.iter().map(move |n| (p, n))) {
            if info.namespace == node.namespace() {
                let host = hosts.get(prefix).map_or("an unknown address", String::as_str);
                let place = format!("at {host} (participant {})", dotted(prefix));
                places.entry(info.full_name()).or_default().push(place);
            }
        }
        places.retain(|_, places| places.len() > 1);
        let own = node.fully_qualified();
        let here = places.get(&own)?.join(", ");
        let killed = "one that was killed is listed for up to 50 s";
        Some(if places.len() > 1 {
            let names: Vec<&str> = places.keys().map(String::as_str).collect();
            format!(
                "two rigs in the namespace {}: {} run more than once, {own} {here}; start each \
                 rig in a namespace of its own (-r __ns:=/rig1) or another ROS_DOMAIN_ID ({killed})",
                node.namespace(),
                names.join(", ")
            )
        } else {
            format!(
                "{} nodes are named {own}: {here}; end one, or rename it with -r __node:=NAME \
                 ({killed})",
                places.get(&own).map_or(0, Vec::len)
            )
        })
    }

    /// Reports several publishers that send on one topic, or, where messages are expected, several
    /// of which none sends. Beside one that sends, silent ones are a standby, or were killed and
    /// are still listed. This process's own counts as sending.
    fn publishers(&self, topic: &str, state: &TopicState, expected: bool) -> Option<String> {
        let mut writers: Vec<(Gid, bool)> =
            state.own_writers.read().iter().map(|gid| (*gid, true)).collect();
        let heard = state.heard.lock();
        writers.extend(state.remote_writers.read().iter().map(|gid| {
            (*gid, heard.get(gid).is_some_and(|at| now().duration_since(*at) < SENDING))
        }));
        let sending = writers.iter().filter(|(_, sending)| *sending).count();
        if writers.len() < 2 || sending == 1 || (sending == 0 && !expected) {
            return None;
        }
        writers.retain(|(_, sends)| *sends || sending == 0);
        writers.sort();
        let named: Vec<String> = writers.iter().map(|(gid, _)| self.describe(*gid)).collect();
        Some(format!(
            "{} publishers on {topic}: {}; end one, or remap its topic with -r FROM:=TO",
            named.len(),
            named.join(", ")
        ))
    }

    /// Node, host and GID of a publisher; the GID as `ros2 topic info -v` prints it.
    fn describe(&self, gid: Gid) -> String {
        let bytes = gid.to_bytes16();
        let prefix = prefix(&bytes);
        let nodes = self.nodes.read();
        // A participant announces a publisher after it is discovered; of one node it is that
        // node's.
        let name = nodes.get(&prefix).and_then(|all| {
            let only = all.first().filter(|_| all.len() == 1);
            all.iter().find(|n| n.writers.contains(&bytes)).or(only).map(NodeInfo::full_name)
        });
        let hosts = self.hosts.read();
        let host = hosts.get(&prefix).map_or("an unknown address", String::as_str);
        let name = name.unwrap_or_else(|| "a publisher without a node name".to_owned());
        format!("{name} at {host} (GID {})", dotted(&bytes))
    }
}

/// Describes a graph without conflicts; each topic with whether messages are expected on it.
pub(crate) fn without_conflicts(topics: &[(String, &TopicState, bool)]) -> String {
    let is_silent = |state: &TopicState| {
        state.own_writers.read().is_empty() && state.remote_writers.read().is_empty()
    };
    let silent: Vec<&str> = topics
        .iter()
        .filter(|(_, state, expected)| *expected && is_silent(state))
        .map(|(name, ..)| name.as_str())
        .collect();
    if silent.is_empty() {
        "no other node has its name, and each topic that it receives has one publisher".to_owned()
    } else {
        format!("no other node has its name; no publisher on {}", silent.join(", "))
    }
}

fn prefix(gid: &[u8; 16]) -> Prefix {
    std::array::from_fn(|i| gid[i])
}

fn dotted(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect::<Vec<_>>().join(".")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    fn gid(participant: u8, endpoint: u8) -> [u8; 16] {
        std::array::from_fn(|i| if i < 12 { participant } else { endpoint })
    }

    fn node(name: &str, writers: &[[u8; 16]]) -> NodeInfo {
        NodeInfo {
            namespace: "/".to_owned(),
            name: name.to_owned(),
            readers: vec![],
            writers: writers.to_vec(),
        }
    }

    /// A topic with remote publishers, and when each was heard.
    fn topic(writers: &[([u8; 16], Option<Instant>)]) -> TopicState {
        let state = TopicState::default();
        for (bytes, at) in writers {
            let gid = Gid::from(*bytes);
            state.remote_writers.write().push(gid);
            state.heard.lock().extend(at.map(|at| (gid, at)));
        }
        state
    }

    #[test]
    fn publishers_that_send_are_a_conflict_and_silent_ones_beside_them_are_not() {
        let graph = Graph::default();
        graph.nodes.write().insert([1; 12], vec![node("camera", &[gid(1, 1)])]);
        graph.hosts.write().insert([1; 12], "10.0.0.1".to_owned());
        let (sending, before) = (now(), now() - 2 * SENDING);
        let [a, b, c] = [gid(1, 1), gid(2, 1), gid(3, 1)];
        for (writers, expected, count) in [
            (vec![(a, Some(sending))], true, None),
            (vec![(a, Some(sending)), (b, None)], true, None),
            (vec![(a, Some(sending)), (b, Some(before))], true, None),
            (vec![(a, Some(sending)), (b, Some(sending)), (c, None)], true, Some(2)),
            (vec![(a, Some(sending)), (b, Some(sending))], false, Some(2)),
            (vec![(a, None), (b, Some(before)), (c, None)], true, Some(3)),
            (vec![(a, None), (b, None)], false, None),
        ] {
            let text = graph.publishers("/image", &topic(&writers), expected);
            let starts =
                count.map(|n| format!("{n} publishers on /image: /camera at 10.0.0.1 (GID"));
            assert_eq!(text.is_some(), count.is_some(), "{writers:?}: {text:?}");
            assert!(starts.is_none_or(|starts| text.unwrap().starts_with(&starts)), "{writers:?}");
        }
    }

    #[test]
    fn a_topic_without_a_publisher_is_named() {
        let (with, without) = (topic(&[(gid(1, 1), None)]), topic(&[]));
        let of = |name: &str, state, expected| (name.to_owned(), state, expected);
        let imu = of("/imu", &with, true);
        let text = without_conflicts(&[imu.clone(), of("/image", &without, true)]);
        assert_eq!(text, "no other node has its name; no publisher on /image");
        let text = without_conflicts(&[imu, of("/clock", &without, false)]);
        assert!(text.ends_with("each topic that it receives has one publisher"), "{text}");
    }

    #[test]
    fn own_publishers_count_as_sending_and_shared_topics_do_not_count() {
        let graph = Graph::default();
        let state = topic(&[(gid(1, 1), Some(now()))]);
        state.own_writers.write().insert(Gid::from(gid(9, 1)));
        let name = NodeName::new("/rig1", "pose_fusion").unwrap();
        let of = |topic: &str| graph.conflicts(&name, &[(topic.to_owned(), &state, true)]);
        assert_eq!(of("/rig1/climber/markers").len(), 1);
        assert_eq!(of("/rig1/tf").len() + of("/diagnostics").len(), 0);
    }

    #[test]
    fn a_second_node_differs_from_a_second_rig() {
        let graph = Graph::default();
        let own = NodeName::new("/", "pose_fusion").unwrap();
        let (fusion, driver) = (node("pose_fusion", &[]), node("imu_driver", &[]));
        graph.nodes.write().insert([1; 12], vec![fusion.clone(), driver.clone()]);
        assert_eq!(graph.names(&own), None);
        // Twice another node: its own diagnostics say so.
        graph.nodes.write().insert([2; 12], vec![driver.clone()]);
        assert_eq!(graph.names(&own), None);
        graph.nodes.write().insert([2; 12], vec![fusion.clone()]);
        let text = graph.names(&own).unwrap();
        assert!(text.starts_with("2 nodes are named /pose_fusion: at "), "{text}");
        graph.nodes.write().insert([2; 12], vec![fusion, driver]);
        let text = graph.names(&own).unwrap();
        assert!(text.contains("two rigs in the namespace /: /imu_driver, /pose_fusion"), "{text}");
        assert_eq!(graph.names(&NodeName::new("/rig2", "pose_fusion").unwrap()), None);
    }
}
