//! Names of topics after namespace and remapping.

use anyhow::bail;
use bag::{BagReader, BagSummary};
use node_kit::NodeName;
use rig_model::topics;
use std::{collections::BTreeMap, fmt, path::Path, str::FromStr};

/// A namespace and remapping rules.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicNames {
    namespace: String,
    remaps: BTreeMap<String, String>,
}

/// A remapping rule, `from:=to`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    from: String,
    to: String,
}

impl FromStr for Remap {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once(":=").filter(|(from, to)| !from.is_empty() && !to.is_empty());
        let (from, to) =
            parts.ok_or("write it as from:=to, such as climber/transform:=/crane/pose")?;
        let node = NodeName::new("/", "volant").map_err(|error| error.to_string())?;
        let expanded = node.expand(to).map_err(|error| error.to_string())?;
        // `~` and `{node}` name a node's topics.
        if expanded.trim_start_matches('/') != to.trim_start_matches('/') {
            return Err(format!("`{to}` depends on a node; write its name, such as /crane/pose"));
        }
        Ok(Self { from: from.to_owned(), to: to.to_owned() })
    }
}

impl Remap {
    /// Returns the name that is remapped.
    pub fn from(&self) -> &str {
        &self.from
    }
}

impl fmt::Display for Remap {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:={}", self.from, self.to)
    }
}

impl TopicNames {
    /// Creates the names of a namespace (empty or `/`: none) and rules.
    pub fn new(namespace: &str, remaps: &[Remap]) -> Self {
        let namespace = namespace.trim_matches('/').to_owned();
        let mut names = Self { namespace, remaps: BTreeMap::new() };
        for Remap { from, to } in remaps {
            names.remaps.insert(names.absolute(from), names.absolute(to));
        }
        names
    }

    /// Returns the absolute name of a relative topic.
    pub fn resolve(&self, name: &str) -> String {
        let absolute = self.absolute(name);
        self.remaps.get(&absolute).cloned().unwrap_or(absolute)
    }

    /// Returns the absolute names that are remapped.
    pub fn remapped(&self) -> impl Iterator<Item = &str> {
        self.remaps.keys().map(String::as_str)
    }

    /// Returns which of a bag's topics with messages serves as one of `alternatives`, given by
    /// relative name and type: the first that has its name, or else the only one of the first type
    /// of which there are any. With it, the place of the alternative. Where the user gave a
    /// namespace, or another name for the topic, no other topic serves.
    ///
    /// # Errors
    /// Several topics of that type, and none has a name of `alternatives`.
    pub fn choose(
        &self,
        bag: &BagSummary,
        alternatives: &[(&'static str, &'static str)],
    ) -> anyhow::Result<Option<(usize, String)>> {
        for (place, (name, kind)) in alternatives.iter().enumerate() {
            let resolved = self.resolve(name);
            if bag.topics_of(kind).contains(&resolved.as_str()) {
                return Ok(Some((place, resolved)));
            }
        }
        for (place, &(name, kind)) in alternatives.iter().enumerate() {
            if !self.namespace.is_empty() || self.remaps.contains_key(&self.absolute(name)) {
                continue;
            }
            // What the tracker draws is no camera's image.
            let mut found = bag.topics_of(kind);
            found.retain(|topic| !topic.ends_with(topics::MARKERS_DEBUG_IMAGE));
            match found.as_slice() {
                [] => {}
                [only] => return Ok(Some((place, (*only).to_owned()))),
                found => bail!(
                    "several topics of {kind}: {}, and none is {}; choose one with --namespace or \
                     --remap {name}:=TOPIC",
                    found.join(", "),
                    self.resolve(name)
                ),
            }
        }
        Ok(None)
    }

    /// Lists topics by absolute name and type, where all or one of them are missing.
    pub(super) fn list(&self, wanted: &[(&'static str, &'static str)]) -> String {
        let all: Vec<String> =
            wanted.iter().map(|(name, kind)| format!("{} ({kind})", self.resolve(name))).collect();
        all.join(" or ")
    }

    /// Returns what to do where a bag has none of the topics `wanted`, by relative name and type:
    /// give the namespace in which it has one, rename a topic of that type, or record it.
    pub(super) fn remedy(
        &self,
        bag: &BagSummary,
        wanted: &[(&'static str, &'static str)],
    ) -> String {
        if let Some(reason) = empty(bag) {
            return reason;
        }
        let namespaces = wanted.iter().flat_map(|(name, kind)| {
            let suffix = format!("/{name}");
            bag.topics_of(kind)
                .into_iter()
                .filter_map(move |topic| Some((topic, topic.strip_suffix(&suffix)?.to_owned())))
        });
        if let Some((topic, namespace)) = namespaces.into_iter().next() {
            let namespace = if namespace.is_empty() { "/" } else { &namespace };
            return format!("the bag has {topic}: give --namespace {namespace}");
        }
        let renamed = wanted.iter().find_map(|(name, kind)| {
            let found = bag.topics_of(kind);
            (!found.is_empty()).then(|| {
                let found = found.join(", ");
                format!("the bag has {found}: name the right topic with --remap {name}:=TOPIC")
            })
        });
        renamed.unwrap_or_else(|| match wanted.len() {
            1 => "record it".to_owned(),
            _ => "record one of them".to_owned(),
        })
    }

    fn absolute(&self, name: &str) -> String {
        if name.starts_with('/') {
            name.to_owned()
        } else if self.namespace.is_empty() {
            format!("/{name}")
        } else {
            format!("/{}/{name}", self.namespace)
        }
    }
}

/// What is wrong with a bag without a readable message, and the remedy; `None` for another bag.
pub fn empty(bag: &BagSummary) -> Option<String> {
    let why = if bag.complete { "" } else { ", because it is cut off or damaged" };
    (bag.messages() == 0)
        .then(|| format!("the bag holds no readable message{why}; record it again"))
}

/// Summarizes a bag that holds a message; what it lost is appended to `losses`.
///
/// # Errors
/// An unreadable bag, or one without a readable message.
pub fn summarize(path: &Path, losses: &mut Vec<String>) -> anyhow::Result<BagSummary> {
    let summary = BagReader::summary(path)?;
    if let Some(reason) = empty(&summary) {
        bail!("{}: {reason}", path.display());
    }
    losses.extend_from_slice(&summary.losses);
    Ok(summary)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bag::{Qos, Topic};
    use volant_msgs::std_msgs::msg::String as Text;

    fn topic(name: &str, kind: &str) -> Topic {
        Topic { type_name: kind.to_owned(), ..Topic::of::<Text>(name, &Qos::RELIABLE) }
    }

    #[test]
    fn namespaces_and_remaps_move_relative_names_only() {
        let names = TopicNames::new("/rig1/", &["climber/transform:=/crane".parse().unwrap()]);
        assert_eq!(names.resolve("volant/odometry"), "/rig1/volant/odometry");
        assert_eq!(names.resolve("/tf"), "/tf");
        assert_eq!(names.resolve("climber/transform"), "/crane");
        assert_eq!(TopicNames::default().resolve("volant/odometry"), "/volant/odometry");
        for wrong in ["a=b", ":=b", "a:=", "a:=b c", "a:=/b//c", "a:=/b/", "a:=1b", "a:=~/b"] {
            assert!(wrong.parse::<Remap>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn the_remedy_names_the_namespace_or_the_remap() {
        let wanted = [("camera/image_raw", "Image"), ("climber/markers", "Markers")];
        let remedy = |topics: &[(&str, &str)]| {
            let topics = topics.iter().map(|(name, kind)| (topic(name, kind), 9)).collect();
            let bag = BagSummary { topics, ..BagSummary::default() };
            TopicNames::default().remedy(&bag, &wanted)
        };
        assert_eq!(
            remedy(&[("/other", "Image"), ("/rig1/climber/markers", "Markers")]),
            "the bag has /rig1/climber/markers: give --namespace /rig1"
        );
        assert_eq!(
            remedy(&[("/spots", "Markers"), ("/tf", "Tf")]),
            "the bag has /spots: name the right topic with --remap climber/markers:=TOPIC"
        );
        assert_eq!(remedy(&[("/tf", "Tf")]), "record one of them");
        assert!(
            remedy(&[]).contains("no readable message, because it is cut off"),
            "{}",
            remedy(&[])
        );
        assert_eq!(
            TopicNames::default().list(&wanted),
            "/camera/image_raw (Image) or /climber/markers (Markers)"
        );
    }

    #[test]
    fn a_topic_of_another_name_is_chosen_only_where_there_is_one() {
        let bag = |topics: &[(&str, &str, u64)]| BagSummary {
            topics: topics.iter().map(|(name, kind, count)| (topic(name, kind), *count)).collect(),
            ..BagSummary::default()
        };
        let alternatives = [("camera/image_raw", "Image"), ("camera/compressed", "Compressed")];
        let choose = |names: &TopicNames, topics: &[(&str, &str, u64)]| {
            names.choose(&bag(topics), &alternatives).map_err(|error| error.to_string())
        };
        let names = TopicNames::default();
        let rig1 = TopicNames::new("rig1", &[]);
        let two = [("/rig1/camera/image_raw", "Image", 9), ("/rig2/camera/image_raw", "Image", 9)];
        assert_eq!(choose(&names, &[("/camera/image_raw", "Image", 0)]), Ok(None));
        assert_eq!(choose(&names, &two[1..]), Ok(Some((0, two[1].0.to_owned()))));
        assert_eq!(choose(&rig1, &two), Ok(Some((0, two[0].0.to_owned()))));
        let drawn = ("/rig1/climber/markers/debug_image", "Image", 9);
        assert_eq!(choose(&names, &[drawn]), Ok(None));
        assert_eq!(choose(&names, &[drawn, two[1]]), Ok(Some((0, two[1].0.to_owned()))));
        // What the user named is not replaced by another rig's.
        let renamed = TopicNames::new("", &["camera/image_raw:=/front/image_raw".parse().unwrap()]);
        for names in [&rig1, &renamed] {
            assert_eq!(choose(names, &two[1..]), Ok(None), "{names:?}");
        }
        // One topic with two channels is no choice.
        let twice = [two[0], two[0]];
        assert_eq!(choose(&names, &twice), Ok(Some((0, two[0].0.to_owned()))));
        let error = choose(&names, &two).unwrap_err();
        assert!(error.contains("/rig1/camera/image_raw, /rig2/camera/image_raw"), "{error}");
        assert!(error.contains("--remap camera/image_raw:=TOPIC"), "{error}");
        // The rig's own compressed images count before another's raw ones.
        let other = [("/other", "Image", 9), ("/camera/compressed", "Compressed", 9)];
        assert_eq!(choose(&names, &other), Ok(Some((1, other[1].0.to_owned()))));
    }
}
