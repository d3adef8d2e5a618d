//! Names of topics after namespace and remapping.

use std::collections::BTreeMap;
use thiserror::Error;

/// A namespace and remapping rules.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicNames {
    namespace: String,
    remaps: BTreeMap<String, String>,
}

/// Why a remapping rule is invalid.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum TopicNameError {
    /// Not `from:=to`.
    #[error(
        "`{text}` is not a remap; write it as from:=to, such as climber/transform:=/crane/pose"
    )]
    Remap {
        /// The rule as given.
        text: String,
    },
}

impl TopicNames {
    /// Parses a namespace (empty or `/`: none) and rules `from:=to`.
    ///
    /// # Errors
    /// A rule without `:=`.
    pub fn new(namespace: &str, remaps: &[String]) -> Result<Self, TopicNameError> {
        let mut names =
            Self { namespace: namespace.trim_matches('/').to_owned(), remaps: BTreeMap::new() };
        for text in remaps {
            let (from, to) = text
                .split_once(":=")
                .filter(|(from, to)| !from.is_empty() && !to.is_empty())
                .ok_or_else(|| TopicNameError::Remap { text: text.clone() })?;
            let (from, to) = (names.absolute(from), names.absolute(to));
            names.remaps.insert(from, to);
        }
        Ok(names)
    }

    /// Returns the absolute name of a relative topic.
    pub fn resolve(&self, name: &str) -> String {
        let absolute = self.absolute(name);
        self.remaps.get(&absolute).cloned().unwrap_or(absolute)
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn namespaces_and_remaps_move_relative_names_only() {
        let names = TopicNames::new("/rig1/", &["climber/transform:=/crane".into()]).unwrap();
        assert_eq!(names.resolve("volant/odometry"), "/rig1/volant/odometry");
        assert_eq!(names.resolve("/tf"), "/tf");
        assert_eq!(names.resolve("climber/transform"), "/crane");
        assert_eq!(TopicNames::default().resolve("volant/odometry"), "/volant/odometry");
        assert!(TopicNames::new("", &["a=b".into()]).is_err());
    }
}
