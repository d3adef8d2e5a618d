//! ROS 2 parameter files: YAML text in, flat `name.sub.leaf → value` maps for one node out.
//!
//! The form is rcl's: node selectors (`/**`, `/ns/*`, `node`, `/ns/node`), below each
//! `ros__parameters`, nested maps flattened with dots. Later files and later, more specific blocks
//! override earlier ones.

use crate::yaml;
use serde_yaml_ng::Value;
use std::{collections::BTreeMap, fmt};
use thiserror::Error;

/// A parameter's value, as `rcl_interfaces/ParameterValue` has it.
#[derive(Clone, Debug, PartialEq)]
pub enum ParameterValue {
    /// Boolean.
    Bool(bool),
    /// Integer.
    Integer(i64),
    /// Floating-point number.
    Double(f64),
    /// Text.
    String(String),
    /// Booleans.
    BoolArray(Vec<bool>),
    /// Integers.
    IntegerArray(Vec<i64>),
    /// Floating-point numbers.
    DoubleArray(Vec<f64>),
    /// Texts.
    StringArray(Vec<String>),
}

impl ParameterValue {
    /// The number, whether it was written with a decimal point or not.
    pub fn as_f64(&self) -> Option<f64> {
        match self {
            Self::Double(x) => Some(*x),
            Self::Integer(i) => Some(*i as f64),
            _ => None,
        }
    }

    /// The numbers, whether they were written with decimal points or not.
    pub fn as_f64_array(&self) -> Option<Vec<f64>> {
        match self {
            Self::DoubleArray(a) => Some(a.clone()),
            Self::IntegerArray(a) => Some(a.iter().map(|&i| i as f64).collect()),
            _ => None,
        }
    }
}

impl fmt::Display for ParameterValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bool(x) => write!(f, "{x}"),
            Self::Integer(x) => write!(f, "{x}"),
            Self::Double(x) => write!(f, "{x:?}"),
            Self::String(x) => write!(f, "{x:?}"),
            Self::BoolArray(x) => write!(f, "{x:?}"),
            Self::IntegerArray(x) => write!(f, "{x:?}"),
            Self::DoubleArray(x) => write!(f, "{x:?}"),
            Self::StringArray(x) => write!(f, "{x:?}"),
        }
    }
}

/// Parameters of one node, by flat name.
pub type ParameterMap = BTreeMap<String, ParameterValue>;

/// Why a text is not a parameter file.
#[derive(Debug, Error)]
pub enum ParameterFileError {
    /// The text is not YAML.
    #[error("not a YAML file: {0}")]
    Yaml(#[from] serde_yaml_ng::Error),
    /// The outermost level must map node names to their blocks.
    #[error(
        "the file is not a ROS 2 parameter file: expected `/**:` (or a node's name), below it \
         `ros__parameters:`"
    )]
    NotAParameterFile,
    /// A node's block lacks `ros__parameters`.
    #[error("the block `{selector}` has no `ros__parameters:` below it")]
    NoRosParameters {
        /// The node selector.
        selector: String,
    },
    /// A wildcard within a name, which rcl rejects too.
    #[error(
        "the block `{selector}`: a wildcard is a whole part of a name, `*` for one part or `**` for \
         any number of them"
    )]
    Wildcard {
        /// The node selector.
        selector: String,
    },
    /// A value that no ROS parameter can hold.
    #[error(
        "the parameter `{name}` is {what}; a parameter is a boolean, a number, a text or a list \
         of one of these"
    )]
    Value {
        /// The flat name.
        name: String,
        /// What the value is.
        what: &'static str,
    },
}

/// A parsed parameter file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ParameterFile {
    pub(crate) blocks: Vec<(String, ParameterMap)>,
}

impl ParameterFile {
    /// Parses the text of a parameter file.
    ///
    /// # Errors
    /// Text that is not YAML, a missing `ros__parameters`, or a value that no parameter can hold.
    pub fn parse(text: &str) -> Result<Self, ParameterFileError> {
        let root = yaml::parse(text)?;
        let Value::Mapping(root) = root else { return Err(ParameterFileError::NotAParameterFile) };
        let mut blocks = Vec::new();
        for (key, value) in &root {
            let Value::String(key) = key else { return Err(ParameterFileError::NotAParameterFile) };
            collect_blocks(key, value, &mut blocks)?;
        }
        Ok(Self { blocks })
    }

    /// The node selectors of the blocks, in the order of the file.
    pub fn selectors(&self) -> impl Iterator<Item = &str> {
        self.blocks.iter().map(|(selector, _)| selector.as_str())
    }

    /// Collects the parameters of a node by its fully qualified name (`/ns/node`); more specific
    /// blocks override wildcards. The name `/**/node` means that node whatever its namespace: the
    /// parameters that it has without one.
    pub fn for_node(&self, fully_qualified_name: &str) -> ParameterMap {
        let mut map = ParameterMap::new();
        for (_, block) in self.matching(fully_qualified_name) {
            map.extend(block.clone());
        }
        map
    }

    /// Returns whether a node's parameter comes from a block for all nodes of a namespace (`/**`,
    /// `/ns/*`).
    pub fn is_for_all(&self, fully_qualified_name: &str, parameter: &str) -> bool {
        let blocks = self.matching(fully_qualified_name);
        let last = blocks.iter().rev().find(|(_, block)| block.contains_key(parameter));
        last.is_some_and(|(selector, _)| selector.ends_with('*'))
    }

    /// The blocks that match a node, the most specific last.
    pub(crate) fn matching(&self, fully_qualified_name: &str) -> Vec<&(String, ParameterMap)> {
        let of_any = fully_qualified_name.strip_prefix("/**").filter(|node| !node.is_empty());
        let fully_qualified_name = of_any.unwrap_or(fully_qualified_name);
        let mut matching: Vec<_> = self
            .blocks
            .iter()
            .filter(|(selector, _)| selector_matches(selector, fully_qualified_name))
            .collect();
        matching.sort_by_key(|(selector, _)| !selector.contains('*'));
        matching
    }
}

fn collect_blocks(
    selector: &str,
    value: &Value,
    blocks: &mut Vec<(String, ParameterMap)>,
) -> Result<(), ParameterFileError> {
    let no_parameters = || ParameterFileError::NoRosParameters { selector: selector.to_owned() };
    let Value::Mapping(mapping) = value else { return Err(no_parameters()) };
    let mut any = false;
    for (key, value) in mapping {
        let Value::String(key) = key else { return Err(no_parameters()) };
        any = true;
        if key == "ros__parameters" {
            if selector.split('/').any(|part| part.contains('*') && part != "*" && part != "**") {
                return Err(ParameterFileError::Wildcard { selector: selector.to_owned() });
            }
            let mut map = ParameterMap::new();
            if !value.is_null() {
                flatten("", value, &mut map)?;
            }
            blocks.push((selector.to_owned(), map));
        } else {
            // rcl allows `namespace: {node: {ros__parameters: …}}`.
            collect_blocks(&format!("{}/{}", selector.trim_end_matches('/'), key), value, blocks)?;
        }
    }
    if any { Ok(()) } else { Err(no_parameters()) }
}

fn flatten(prefix: &str, value: &Value, map: &mut ParameterMap) -> Result<(), ParameterFileError> {
    let Value::Mapping(mapping) = value else {
        map.insert(prefix.to_owned(), scalar_or_array(prefix, value)?);
        return Ok(());
    };
    for (key, value) in mapping {
        let key = match key {
            Value::String(s) => s.clone(),
            Value::Number(n) => n.to_string(),
            Value::Bool(b) => b.to_string(),
            _ => {
                return Err(ParameterFileError::Value {
                    name: prefix.to_owned(),
                    what: "a map with a key that is not a string",
                });
            }
        };
        let name = if prefix.is_empty() { key } else { format!("{prefix}.{key}") };
        flatten(&name, value, map)?;
    }
    Ok(())
}

/// Parses one value as rcl does for `-p name:=value`.
///
/// # Errors
/// Text that is not YAML, or YAML that no parameter can hold.
pub fn parse_value(name: &str, text: &str) -> Result<ParameterValue, ParameterFileError> {
    match yaml::parse(text)? {
        Value::Null => Ok(ParameterValue::String(text.to_owned())),
        value => scalar_or_array(name, &value),
    }
}

fn scalar_or_array(name: &str, value: &Value) -> Result<ParameterValue, ParameterFileError> {
    let wrong = |what| Err(ParameterFileError::Value { name: name.to_owned(), what });
    Ok(match value {
        Value::Bool(b) => ParameterValue::Bool(*b),
        Value::Number(n) => match n.as_i64() {
            Some(i) => ParameterValue::Integer(i),
            None => match n.as_f64() {
                Some(x) => ParameterValue::Double(x),
                None => return wrong("a number that is too large"),
            },
        },
        Value::String(s) => ParameterValue::String(s.clone()),
        Value::Sequence(items) => {
            let items = items
                .iter()
                .map(|item| scalar_or_array(name, item))
                .collect::<Result<Vec<_>, _>>()?;
            match array(items) {
                Some(array) => array,
                None => return wrong("a list of different kinds"),
            }
        }
        Value::Null => return wrong("empty"),
        Value::Mapping(_) => return wrong("a map inside a list"),
        Value::Tagged(_) => return wrong("a tagged value"),
    })
}

fn array(items: Vec<ParameterValue>) -> Option<ParameterValue> {
    use ParameterValue as P;
    let all_integers = items.iter().all(|i| matches!(i, P::Integer(_)));
    match items.first() {
        None => Some(P::DoubleArray(Vec::new())),
        Some(P::Bool(_)) => items
            .iter()
            .map(|i| if let P::Bool(b) = i { Some(*b) } else { None })
            .collect::<Option<_>>()
            .map(P::BoolArray),
        Some(P::String(_)) => items
            .into_iter()
            .map(|i| if let P::String(s) = i { Some(s) } else { None })
            .collect::<Option<_>>()
            .map(P::StringArray),
        Some(P::Integer(_)) if all_integers => items
            .iter()
            .map(|i| if let P::Integer(i) = i { Some(*i) } else { None })
            .collect::<Option<_>>()
            .map(P::IntegerArray),
        // [0, 0.5] is accepted as a list of doubles: rcl rejects it, but people write it.
        Some(P::Integer(_) | P::Double(_)) => {
            items.iter().map(ParameterValue::as_f64).collect::<Option<_>>().map(P::DoubleArray)
        }
        Some(_) => None,
    }
}

/// Whether `selector` (`/**`, `/*`, `/ns/**`, `node`, `/ns/node`) matches this node.
fn selector_matches(selector: &str, fully_qualified_name: &str) -> bool {
    let name: Vec<&str> = fully_qualified_name.trim_matches('/').split('/').collect();
    // matched[n]: the selector so far matches the name's first n segments. Linear in the selector,
    // however many wildcards it has.
    let mut matched = vec![false; name.len() + 1];
    matched[0] = true;
    for segment in selector.trim_matches('/').split('/') {
        if segment == "**" {
            let mut any = false;
            for m in &mut matched {
                any |= *m;
                *m = any;
            }
        } else {
            for n in (1..matched.len()).rev() {
                matched[n] = matched[n - 1] && (segment == "*" || segment == name[n - 1]);
            }
            matched[0] = false;
        }
    }
    matched[name.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn selectors_match_as_in_rcl() {
        for (selector, name, matches) in [
            ("/**", "/pose_fusion", true),
            ("/**", "/rig1/pose_fusion", true),
            ("/*", "/pose_fusion", true),
            ("/*", "/rig1/pose_fusion", false),
            ("pose_fusion", "/pose_fusion", true),
            ("/rig1/pose_fusion", "/rig1/pose_fusion", true),
            ("/rig1/**", "/rig1/a/pose_fusion", true),
            ("/**/pose_fusion", "/rig1/pose_fusion", true),
            ("/**/pose_fusion", "/rig1/imu_driver", false),
        ] {
            assert_eq!(selector_matches(selector, name), matches, "{selector} {name}");
        }
    }

    #[test]
    fn a_selector_of_a_hundred_thousand_wildcards_is_only_slow_to_type() {
        assert!(selector_matches(&"/**".repeat(100_000), "/rig1/a/pose_fusion"));
        assert!(!selector_matches(&format!("{}/x", "/**".repeat(100_000)), "/rig1/a/pose_fusion"));
    }

    #[test]
    fn nested_maps_become_dotted_names_and_specific_blocks_win() {
        let file = ParameterFile::parse(
            "est: {ros__parameters: {a: {b: 2}}}\n/**: {ros__parameters: {a: {b: 1, c: [0, 0.5]}, \
             d: hello}}\nrig1: {est: {ros__parameters: {d: x}}}",
        )
        .unwrap();
        let map = file.for_node("/est");
        assert_eq!(map["a.b"], ParameterValue::Integer(2));
        assert_eq!(map["a.c"], ParameterValue::DoubleArray(vec![0.0, 0.5]));
        assert_eq!(map["d"], ParameterValue::String("hello".into()));
        assert_eq!(file.for_node("/rig1/est")["d"], ParameterValue::String("x".into()));
    }

    #[test]
    fn invalid_parameter_files_are_rejected() {
        for text in
            ["[1, 2]", "a: 1", "/**: {}", "/**: {ros__parameters: {a: [1, x]}}", "a: {b: {", ""]
        {
            assert!(ParameterFile::parse(text).is_err(), "{text}");
        }
    }
}
