//! ROS 2 names: resolves relative, absolute and private (`~`) names to absolute ones, with remaps.
//!
//! ros2-client 0.12.1 turns a relative topic in the namespace `/` into `rt//name` and supports
//! neither `~` nor remaps, so it gets absolute names only.

use thiserror::Error;

/// An invalid ROS 2 name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{name}` is not a ROS 2 name: {reason}")]
pub struct NameError {
    /// The name as given.
    pub name: String,
    /// What is wrong with it.
    pub reason: &'static str,
}

/// Name and namespace of a node.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct NodeName {
    namespace: String,
    name: String,
}

impl NodeName {
    /// Creates a name from a namespace (`/`, `/rig1`, or `rig1` for `/rig1`) and a base name.
    ///
    /// # Errors
    /// [`NameError`] for characters or slashes that ROS 2 does not allow.
    pub fn new(namespace: &str, name: &str) -> Result<Self, NameError> {
        let namespace =
            if namespace.starts_with('/') { namespace.to_owned() } else { format!("/{namespace}") };
        if namespace != "/" {
            check_absolute(&namespace)?;
        }
        check_token(name, name)?;
        Ok(Self { namespace, name: name.to_owned() })
    }

    /// The namespace: `/` or `/rig1`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The base name: `pose_fusion`.
    pub fn base(&self) -> &str {
        &self.name
    }

    /// The full name: `/rig1/pose_fusion`.
    pub fn fully_qualified(&self) -> String {
        join(&self.namespace, &self.name)
    }

    /// Absolute name of this node's topic or service `name`, before remaps.
    ///
    /// # Errors
    /// [`NameError`] if `name` is invalid.
    pub fn expand(&self, name: &str) -> Result<String, NameError> {
        let wrong = |reason| NameError { name: name.to_owned(), reason };
        if name.is_empty() {
            return Err(wrong("it is empty"));
        }
        // As rcl's `rcl_expand_topic_name`: the namespace with its slash.
        let name = name.replace("{node}", &self.name);
        let name = name.replace("{ns}", &self.namespace).replace("{namespace}", &self.namespace);
        let absolute = if let Some(private) = name.strip_prefix('~') {
            match private.strip_prefix('/') {
                Some(rest) => join(&self.fully_qualified(), rest),
                None if private.is_empty() => self.fully_qualified(),
                None => return Err(wrong("after `~` comes `/`")),
            }
        } else if name.starts_with('/') {
            name
        } else {
            join(&self.namespace, &name)
        };
        check_absolute(&absolute)?;
        Ok(absolute)
    }
}

fn join(namespace: &str, name: &str) -> String {
    if namespace == "/" { format!("/{name}") } else { format!("{namespace}/{name}") }
}

fn check_token(whole: &str, token: &str) -> Result<(), NameError> {
    let wrong = |reason| Err(NameError { name: whole.to_owned(), reason });
    if token.is_empty() {
        return wrong("a part of it is empty");
    }
    if token.starts_with(|c: char| c.is_ascii_digit()) {
        return wrong("a part of it begins with a digit");
    }
    if !token.chars().all(|c| c.is_ascii_alphanumeric() || c == '_') {
        return wrong("only letters, digits, `_` and `/` may be in it");
    }
    Ok(())
}

/// Checks the parts of a name that begins with a slash.
fn check_absolute(name: &str) -> Result<(), NameError> {
    name.split('/').skip(1).try_for_each(|token| check_token(name, token))
}

/// Remap rule `from:=to`, for one node or all.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// Base name of the node; `None` for every node of the process.
    pub node: Option<String>,
    /// The name in the code: relative, absolute or private.
    pub from: String,
    /// The name in the graph.
    pub to: String,
}

/// What a name is of: a rule whose name begins with `rostopic://` or `rosservice://` is for one
/// kind only, as in rcl.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NameKind {
    /// A topic.
    Topic,
    /// A service.
    Service,
}

/// Absolute name of a topic or service: [`NodeName::expand`], then the first matching rule.
///
/// # Errors
/// [`NameError`] if `name` or the target of the matching rule is invalid.
pub fn resolve(
    node: &NodeName,
    remaps: &[Remap],
    kind: NameKind,
    name: &str,
) -> Result<String, NameError> {
    let expanded = node.expand(name)?;
    for rule in remaps {
        if rule.node.as_deref().is_some_and(|only| only != node.base()) {
            continue;
        }
        let scheme = match kind {
            NameKind::Topic => "rostopic://",
            NameKind::Service => "rosservice://",
        };
        // A name with the other scheme is none, so that it equals no other.
        let from = rule.from.strip_prefix(scheme).unwrap_or(&rule.from);
        if node.expand(from).is_ok_and(|from| from == expanded) {
            return node.expand(&rule.to);
        }
    }
    Ok(expanded)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_absolute_in_their_namespace() {
        let root = NodeName::new("/", "imu").unwrap();
        let rig = NodeName::new("/rig1", "imu").unwrap();
        for (node, name, expected) in [
            (&root, "volant/imu/data", "/volant/imu/data"),
            (&rig, "volant/imu/data", "/rig1/volant/imu/data"),
            (&rig, "/tf", "/tf"),
            (&rig, "~", "/rig1/imu"),
            (&rig, "~/get_parameters", "/rig1/imu/get_parameters"),
            (&root, "~/x", "/imu/x"),
            (&rig, "{ns}/{node}", "/rig1/imu"),
            (&rig, "{namespace}/x", "/rig1/x"),
            (&rig, "a__b", "/rig1/a__b"),
        ] {
            assert_eq!(node.expand(name).unwrap(), expected, "{name}");
        }
        assert_eq!(NodeName::new("rig1", "imu").unwrap(), rig);
        assert_eq!(
            NodeName::new("/rig__1", "my__imu").unwrap().fully_qualified(),
            "/rig__1/my__imu"
        );
    }

    #[test]
    fn invalid_names_are_rejected() {
        let node = NodeName::new("/", "imu").unwrap();
        for name in ["", "/", "a//b", "a/", "1a", "a b", "{ns}/a", "~x", "ä"] {
            assert!(node.expand(name).is_err(), "{name}");
        }
        assert!(NodeName::new("/a/", "x").is_err());
        assert!(NodeName::new("/", "a/b").is_err());
    }

    #[test]
    fn the_first_matching_rule_applies_and_rules_of_other_nodes_do_not() {
        let node = NodeName::new("/rig1", "fusion").unwrap();
        let rule = |node: Option<&str>, from: &str, to: &str| Remap {
            node: node.map(str::to_owned),
            from: from.into(),
            to: to.into(),
        };
        let rules = [
            rule(Some("tracker"), "pose", "elsewhere"),
            rule(None, "/imu", "/sensors/imu"),
            rule(None, "pose", "~/pose"),
            rule(None, "pose", "never"),
            rule(None, "~/state", "state"),
        ];
        for (name, expected) in [
            ("/imu", "/sensors/imu"),
            ("imu", "/rig1/imu"),
            ("pose", "/rig1/fusion/pose"),
            ("/rig1/pose", "/rig1/fusion/pose"),
            ("~/state", "/rig1/state"),
        ] {
            assert_eq!(resolve(&node, &rules, NameKind::Topic, name).unwrap(), expected, "{name}");
        }
        let rules = [rule(None, "rosservice://reset", "one"), rule(None, "rostopic://imu", "two")];
        for (kind, name, expected) in [
            (NameKind::Topic, "reset", "/rig1/reset"),
            (NameKind::Service, "reset", "/rig1/one"),
            (NameKind::Topic, "imu", "/rig1/two"),
            (NameKind::Service, "imu", "/rig1/imu"),
        ] {
            assert_eq!(resolve(&node, &rules, kind, name).unwrap(), expected, "{kind:?} {name}");
        }
    }
}
