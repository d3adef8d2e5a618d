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

/// Invalid parameter file, or one that is not editable in place: the block or the parameter, what
/// is wrong with it, and the remedy.
#[derive(Debug, Error)]
#[error("{0}")]
pub struct ParameterFileError(pub(crate) String);

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
        let foreign = || {
            let text = "the file is not a ROS 2 parameter file: expected `/**:` (or a node's \
                        name), below it `ros__parameters:`";
            ParameterFileError(text.to_owned())
        };
        let Value::Mapping(root) = parse_yaml(text)? else { return Err(foreign()) };
        let mut blocks = Vec::new();
        for (key, value) in &root {
            let Value::String(key) = key else { return Err(foreign()) };
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
    let block = format!("the block `{selector}`");
    let no_parameters =
        || ParameterFileError(format!("{block} has no `ros__parameters:` below it"));
    let Value::Mapping(mapping) = value else { return Err(no_parameters()) };
    let mut any = false;
    for (key, value) in mapping {
        let Value::String(key) = key else { return Err(no_parameters()) };
        any = true;
        if key == "ros__parameters" {
            if selector.split('/').any(|part| part.contains('*') && part != "*" && part != "**") {
                return Err(ParameterFileError(format!(
                    "{block}: a wildcard is a whole part of a name, `*` for one part or `**` for \
                     any number of them"
                )));
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
            _ => return Err(not_a_value(prefix, "a map with a key that is not a string")),
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
    match parse_yaml(text)? {
        Value::Null => Ok(ParameterValue::String(text.to_owned())),
        value => scalar_or_array(name, &value),
    }
}

/// Parses any YAML.
pub(crate) fn parse_yaml(text: &str) -> Result<Value, ParameterFileError> {
    yaml::parse(text).map_err(|e| ParameterFileError(format!("not a YAML file: {e}")))
}

fn not_a_value(name: &str, what: &str) -> ParameterFileError {
    ParameterFileError(format!(
        "the parameter `{name}` is {what}; a parameter is a boolean, a number, a text or a list \
         of one of these"
    ))
}

fn scalar_or_array(name: &str, value: &Value) -> Result<ParameterValue, ParameterFileError> {
    let wrong = |what| Err(not_a_value(name, what));
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
            match array(&items) {
                Some(array) => array,
                None => return wrong("a list of different kinds"),
            }
        }
        Value::Null => return wrong("empty"),
        Value::Mapping(_) => return wrong("a map inside a list"),
        Value::Tagged(_) => return wrong("a tagged value"),
    })
}

fn array(items: &[ParameterValue]) -> Option<ParameterValue> {
    use ParameterValue as P;
    fn all<T>(items: &[P], of: impl Fn(&P) -> Option<T>) -> Option<Vec<T>> {
        items.iter().map(of).collect()
    }
    let boolean = |item: &P| if let P::Bool(b) = item { Some(*b) } else { None };
    let text = |item: &P| if let P::String(s) = item { Some(s.clone()) } else { None };
    let integer = |item: &P| if let P::Integer(i) = item { Some(*i) } else { None };
    match items.first() {
        None => Some(P::DoubleArray(Vec::new())),
        Some(P::Bool(_)) => all(items, boolean).map(P::BoolArray),
        Some(P::String(_)) => all(items, text).map(P::StringArray),
        // [0, 0.5] is accepted as a list of doubles: rcl rejects it, but people write it.
        Some(P::Integer(_) | P::Double(_)) => all(items, integer)
            .map(P::IntegerArray)
            .or_else(|| all(items, P::as_f64).map(P::DoubleArray)),
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
