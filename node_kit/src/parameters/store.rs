//! A node's parameters at run time: declarations and current values.

use super::{Descriptor, ParameterError};
use crate::args::Override;
use rig_model::rig::did_you_mean;
use ros_parameters::{ParameterMap, ParameterValue};
use std::collections::BTreeMap;

/// Prefix of a topic's QoS overrides, which are declared with the topic.
const QOS_OVERRIDES: &str = "qos_overrides.";

/// Names and values of new or changed parameters.
pub type Changes = Vec<(String, ParameterValue)>;

/// All parameters of one node.
#[derive(Clone, Debug, Default)]
pub struct ParameterStore {
    declared: BTreeMap<String, Descriptor>,
    values: ParameterMap,
    /// Overrides given at the start for topics that do not exist yet.
    pending: BTreeMap<String, Override>,
    /// Names and origins of values for all nodes that this node does not have.
    ignored: Vec<(String, String)>,
}

impl ParameterStore {
    /// Declares parameters and applies the values given at the start.
    ///
    /// # Errors
    /// [`ParameterError`] of the first unknown or invalid value, in the order of the names. An
    /// unknown one of a file that several nodes share is ignored ([`Self::ignored`]).
    pub fn new(
        descriptors: Vec<Descriptor>,
        overrides: BTreeMap<String, Override>,
    ) -> Result<Self, ParameterError> {
        let mut store = Self::default();
        for descriptor in descriptors {
            if let Some(default) = &descriptor.default {
                store.values.insert(descriptor.name.clone(), default.clone());
            }
            store.declared.insert(descriptor.name.clone(), descriptor);
        }
        for (name, given) in overrides {
            if let Some(descriptor) = store.declared.get(&name) {
                store.values.insert(name, accept(descriptor, &given)?);
            } else if name.starts_with(QOS_OVERRIDES) {
                store.pending.insert(name, given);
            } else if given.shared {
                store.ignored.push((name, given.origin));
            } else {
                return Err(given_in(store.unknown(&name), &given.origin));
            }
        }
        Ok(store)
    }

    /// Describes the values for all nodes that this node does not have: another node's, which rcl
    /// ignores too.
    pub fn ignored(&self) -> impl Iterator<Item = String> {
        self.ignored.iter().map(|(name, origin)| {
            let hint = self.hint(name);
            let what = if hint.is_empty() { "it is ignored" } else { "correct its spelling" };
            format!(
                "{origin}: `{name}` is given for all nodes, and none here has such a \
                 parameter{hint}; {what}"
            )
        })
    }

    /// ` (did you mean …?)` for an unknown name, or nothing.
    pub fn hint(&self, name: &str) -> String {
        did_you_mean(name, self.declared.keys().map(String::as_str))
    }

    fn unknown(&self, name: &str) -> ParameterError {
        let hint = self.hint(name);
        ParameterError::Invalid(format!(
            "the parameter `{name}` is not known{hint}; remove it or correct its spelling"
        ))
    }

    /// Declares a parameter if a value was given for it at the start, and returns that value.
    /// Without one it is not listed: a node would have four such parameters for each of its topics.
    ///
    /// # Errors
    /// [`ParameterError`] if the value is invalid.
    pub fn declare_if_given(
        &mut self,
        descriptor: Descriptor,
    ) -> Result<Option<ParameterValue>, ParameterError> {
        if let Some(given) = self.pending.remove(&descriptor.name) {
            let value = accept(&descriptor, &given)?;
            self.values.insert(descriptor.name.clone(), value);
            self.declared.insert(descriptor.name.clone(), descriptor.clone());
        }
        Ok(self.values.get(&descriptor.name).cloned())
    }

    /// Overrides given at the start for topics that the node does not have: typing mistakes.
    pub fn left_over(&self) -> Vec<ParameterError> {
        let unknown =
            |(name, given): (&String, &Override)| given_in(self.unknown(name), &given.origin);
        self.pending.iter().map(unknown).collect()
    }

    /// All current values.
    pub fn values(&self) -> &ParameterMap {
        &self.values
    }

    /// The current value of a parameter.
    pub fn get(&self, name: &str) -> Option<&ParameterValue> {
        self.values.get(name)
    }

    /// The declaration of a parameter.
    pub fn descriptor(&self, name: &str) -> Option<&Descriptor> {
        self.declared.get(name)
    }

    /// Values after applying all of `changes` at once, and the changes as stored. Nothing is stored
    /// before [`ParameterStore::commit`], so that the node can validate the whole.
    ///
    /// # Errors
    /// [`ParameterError`] of the first unknown, read-only or invalid change.
    pub fn propose(
        &self,
        changes: &[(String, ParameterValue)],
    ) -> Result<(ParameterMap, Changes), ParameterError> {
        let mut values = self.values.clone();
        let mut made = Vec::new();
        for (name, value) in changes {
            let descriptor = self.declared.get(name).ok_or_else(|| self.unknown(name))?;
            let value = descriptor.accept(value)?;
            if !descriptor.live && values.get(name) != Some(&value) {
                return Err(ParameterError::Invalid(format!(
                    "the parameter `{name}` cannot change while the node runs; set it at the start \
                     (-p {name}:=… or --params-file)"
                )));
            }
            values.insert(name.clone(), value.clone());
            made.push((name.clone(), value));
        }
        Ok((values, made))
    }

    /// Stores proposed values.
    pub fn commit(&mut self, values: ParameterMap) {
        self.values = values;
    }

    /// Names below any of `prefixes` (all if empty), at most `depth` dots deeper than the prefix
    /// (0: any depth), and their own prefixes: the reply of `list_parameters`.
    pub fn list(&self, prefixes: &[String], depth: u64) -> (Vec<String>, Vec<String>) {
        let within = |rest: &str| depth == 0 || (rest.matches('.').count() as u64) < depth;
        let is_listed = |name: &&String| {
            let is_below = |prefix: &String| {
                let rest = name.strip_prefix(prefix.as_str());
                rest == Some("") || rest.and_then(|r| r.strip_prefix('.')).is_some_and(within)
            };
            if prefixes.is_empty() { within(name) } else { prefixes.iter().any(is_below) }
        };
        let names: Vec<String> = self.declared.keys().filter(is_listed).cloned().collect();
        let mut parents: Vec<String> = names
            .iter()
            .filter_map(|n| n.rsplit_once('.').map(|(parent, _)| parent.to_owned()))
            .collect();
        parents.sort();
        parents.dedup();
        (names, parents)
    }
}

fn accept(descriptor: &Descriptor, given: &Override) -> Result<ParameterValue, ParameterError> {
    descriptor.accept(&given.value).map_err(|error| given_in(error, &given.origin))
}

fn given_in(error: ParameterError, origin: &str) -> ParameterError {
    ParameterError::Given { message: error.to_string(), origin: origin.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::{ParameterKind, common_descriptors};

    fn given(name: &str, value: ParameterValue) -> (String, Override) {
        (name.to_owned(), Override { value, origin: "rig.yaml".into(), shared: false })
    }

    fn store() -> ParameterStore {
        let mut all = common_descriptors();
        all.push(
            Descriptor::new("a.gain", ParameterKind::Double, Some(ParameterValue::Double(1.0)), "")
                .range(0.0..=2.0)
                .live(),
        );
        ParameterStore::new(all, BTreeMap::new()).unwrap()
    }

    #[test]
    fn an_unknown_name_is_ignored_only_in_a_shared_file() {
        let shared = |name: &str| {
            let value = ParameterValue::Double(0.1);
            (name.to_owned(), Override { value, origin: "robot.yaml".into(), shared: true })
        };
        let of = |name| ParameterStore::new(common_descriptors(), [shared(name)].into());
        let store = of("robot_description").unwrap();
        let ignored: Vec<String> = store.ignored().collect();
        assert!(ignored.len() == 1 && ignored[0].starts_with("robot.yaml: `robot_description`"));
        assert_eq!(store.get("robot_description"), None);
        // Nearly one of ours, and that of another node all the same.
        let store = of("frames.base").unwrap();
        assert_eq!(store.ignored().count(), 1);
        assert!(of("markers.sise").unwrap().hint("markers.sise").contains("markers.size"));
        let own = given("markers.sise", ParameterValue::Double(0.1));
        let error = ParameterStore::new(common_descriptors(), [own].into()).unwrap_err();
        assert!(error.to_string().contains("markers.size"), "{error}");
    }

    #[test]
    fn changes_are_validated_as_a_whole() {
        let mut store = store();
        let live = ("a.gain".to_owned(), ParameterValue::Integer(2));
        let fixed = ("markers.size".to_owned(), ParameterValue::Double(0.1));
        let error = store.propose(&[live.clone(), fixed]).unwrap_err().to_string();
        assert!(error.contains("`markers.size` cannot change"), "{error}");
        assert!(store.propose(&[("a.gain".to_owned(), ParameterValue::Integer(3))]).is_err());
        assert!(store.propose(&[("gain".to_owned(), ParameterValue::Integer(1))]).is_err());
        let (values, made) = store.propose(&[live]).unwrap();
        assert_eq!(store.get("a.gain"), Some(&ParameterValue::Double(1.0)));
        store.commit(values);
        assert_eq!(store.get("a.gain"), Some(&ParameterValue::Double(2.0)));
        assert_eq!(made.len(), 1);
    }

    #[test]
    fn qos_overrides_wait_for_their_topic() {
        let name = |topic: &str| format!("qos_overrides./{topic}.publisher.depth");
        let three = ParameterValue::Integer(3);
        let overrides = ["a", "b"].map(|topic| given(&name(topic), three.clone()));
        let mut store = ParameterStore::new(vec![], overrides.into()).unwrap();
        let depth = |topic| Descriptor::new(name(topic), ParameterKind::Integer, None, "");
        assert_eq!(store.declare_if_given(depth("a")), Ok(Some(three)));
        assert_eq!(store.left_over().len(), 1);
        assert_eq!(store.declare_if_given(depth("c")), Ok(None));
        assert_eq!(store.declared.len(), 1);
    }

    #[test]
    fn listing_honors_prefixes_and_depth() {
        let store = store();
        let (names, prefixes) = store.list(&["markers".to_owned()], 1);
        assert_eq!(names.len(), 5);
        assert_eq!(prefixes, ["markers"]);
        let (top, _) = store.list(&[], 1);
        assert_eq!(top, ["autostart", "start_type_description_service", "use_sim_time"]);
    }
}
