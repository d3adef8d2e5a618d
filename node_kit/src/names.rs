//! ROS 2 names: relative, absolute and private (`~`) names in, absolute names out, and remap rules over them.
//!
//! Everything is resolved here, before the middleware sees a name: ros2-client turns a relative topic in the
//! namespace `/` into `rt//name`, and knows neither `~` nor remaps.

use thiserror::Error;

/// Why a name is no ROS 2 name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{name}` is not a ROS 2 name: {reason}")]
pub struct NameError {
    /// The name as it was given.
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
    /// From a namespace (`/`, `/rig1`, or `rig1` for `/rig1`) and a base name.
    ///
    /// # Errors
    /// Characters or slashes that a ROS 2 name cannot have.
    pub fn new(namespace: &str, name: &str) -> Result<Self, NameError> {
        let namespace =
            if namespace.starts_with('/') { namespace.to_owned() } else { format!("/{namespace}") };
        if namespace != "/" {
            check_absolute(&namespace)?;
        }
        check_token(name, name)?;
        Ok(Self { namespace, name: name.to_owned() })
    }

    /// `/` or `/rig1`.
    pub fn namespace(&self) -> &str {
        &self.namespace
    }

    /// The base name.
    pub fn base(&self) -> &str {
        &self.name
    }

    /// `/rig1/pose_fusion`.
    pub fn fully_qualified(&self) -> String {
        join(&self.namespace, &self.name)
    }

    /// The absolute name that a topic, service or parameter topic `name` has for this node, before remaps.
    ///
    /// # Errors
    /// A name that cannot be.
    pub fn expand(&self, name: &str) -> Result<String, NameError> {
        let wrong = |reason| NameError { name: name.to_owned(), reason };
        if name.is_empty() {
            return Err(wrong("it is empty"));
        }
        let name = name.replace("{node}", &self.name);
        let name = name.replace("{ns}", self.namespace.trim_start_matches('/'));
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
    if token.contains("__") {
        return wrong("two `_` in a row are reserved");
    }
    Ok(())
}

fn check_absolute(name: &str) -> Result<(), NameError> {
    let Some(rest) = name.strip_prefix('/') else {
        return Err(NameError { name: name.to_owned(), reason: "an absolute name begins with `/`" });
    };
    rest.split('/').try_for_each(|token| check_token(name, token))
}

/// `from:=to`, where asked for only for the node of one name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Remap {
    /// Base name of the node that the rule is for; `None` for every node of the process.
    pub node: Option<String>,
    /// The name in the code: relative, absolute or private.
    pub from: String,
    /// The name on the wire.
    pub to: String,
}

/// The absolute name on the wire: [`NodeName::expand`], then the first rule that fits.
///
/// # Errors
/// A name, or the target of the rule that fits, that cannot be.
pub fn resolve(node: &NodeName, remaps: &[Remap], name: &str) -> Result<String, NameError> {
    let expanded = node.expand(name)?;
    for rule in remaps {
        if rule.node.as_deref().is_some_and(|only| only != node.base()) {
            continue;
        }
        let from = rule.from.strip_prefix("rostopic://").or_else(|| rule.from.strip_prefix("rosservice://"));
        if node.expand(from.unwrap_or(&rule.from)).is_ok_and(|from| from == expanded) {
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
            (&rig, "{ns}/{node}", "/rig1/rig1/imu"),
        ] {
            assert_eq!(node.expand(name).unwrap(), expected, "{name}");
        }
        assert_eq!(NodeName::new("rig1", "imu").unwrap(), rig);
    }

    #[test]
    fn what_is_no_name_is_refused_with_a_reason() {
        let node = NodeName::new("/", "imu").unwrap();
        for name in ["", "/", "a//b", "a/", "1a", "a b", "a__b", "~x", "ä"] {
            assert!(node.expand(name).is_err(), "{name}");
        }
        assert!(NodeName::new("/a/", "x").is_err());
        assert!(NodeName::new("/", "a/b").is_err());
    }

    #[test]
    fn the_first_rule_that_fits_counts_and_rules_of_other_nodes_do_not() {
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
            assert_eq!(resolve(&node, &rules, name).unwrap(), expected, "{name}");
        }
    }
}
