//! Parameters, declared once: one row of [`parameters!`](crate::parameters!) yields the field of a plain struct, its
//! validation, the ROS descriptor, the line of the YAML file and the row of the documentation's table.

mod macros;
pub mod messages;
mod set;
mod store;
mod tables;

pub use rig_model::parameters::{ParameterMap, ParameterValue};
pub use set::{ParameterSet, ParameterType};
pub use store::{Change, ParameterStore};
pub use tables::{help_table, markdown_table, yaml_file};

use rig_model::rig::rig_keys;
use std::ops::RangeInclusive;
use thiserror::Error;

/// The type of a parameter, with the numbers of `rcl_interfaces/ParameterType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum ParameterKind {
    /// true or false.
    Bool = 1,
    /// A whole number.
    Integer = 2,
    /// A number.
    Double = 3,
    /// Text.
    String = 4,
    /// A list of true or false.
    BoolArray = 6,
    /// A list of whole numbers.
    IntegerArray = 7,
    /// A list of numbers.
    DoubleArray = 8,
    /// A list of texts.
    StringArray = 9,
}

impl ParameterKind {
    /// The kind of a value.
    pub const fn of(value: &ParameterValue) -> Self {
        match value {
            ParameterValue::Bool(_) => Self::Bool,
            ParameterValue::Integer(_) => Self::Integer,
            ParameterValue::Double(_) => Self::Double,
            ParameterValue::String(_) => Self::String,
            ParameterValue::BoolArray(_) => Self::BoolArray,
            ParameterValue::IntegerArray(_) => Self::IntegerArray,
            ParameterValue::DoubleArray(_) => Self::DoubleArray,
            ParameterValue::StringArray(_) => Self::StringArray,
        }
    }

    /// As `ros2 param describe` says it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Bool => "boolean",
            Self::Integer => "integer",
            Self::Double => "double",
            Self::String => "string",
            Self::BoolArray => "boolean array",
            Self::IntegerArray => "integer array",
            Self::DoubleArray => "double array",
            Self::StringArray => "string array",
        }
    }
}

/// Why a value is not taken.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ParameterError {
    /// Nobody declared it.
    #[error("the parameter `{name}` is not known{hint}; remove it or correct its spelling ({origin})")]
    Unknown {
        /// The flat name.
        name: String,
        /// ` (did you mean …?)` or nothing.
        hint: String,
        /// Where it was given.
        origin: String,
    },
    /// A value of another type.
    #[error("the parameter `{name}` is a {expected}, but {value} is a {found}")]
    Type {
        /// The flat name.
        name: String,
        /// The declared type.
        expected: &'static str,
        /// The value as given.
        value: String,
        /// Its type.
        found: &'static str,
    },
    /// A value that the declaration forbids.
    #[error("the parameter `{name}` is {value}, but {requirement}")]
    Value {
        /// The flat name.
        name: String,
        /// The value as given.
        value: String,
        /// What holds for it.
        requirement: String,
    },
    /// It cannot change while the node runs.
    #[error(
        "the parameter `{name}` cannot change while the node runs; set it at the start (-p {name}:=… or --params-file)"
    )]
    ReadOnly {
        /// The flat name.
        name: String,
    },
    /// It must be given and was not.
    #[error(
        "the parameter `{name}` must be given ({description}); most likely `--params-file rig.yaml` is missing"
    )]
    Missing {
        /// The flat name.
        name: String,
        /// What it holds.
        description: String,
    },
    /// Values that do not go together.
    #[error("{requirement}")]
    Rule {
        /// What must hold, with the names of the parameters.
        requirement: String,
    },
}

/// One declared parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Descriptor {
    /// Flat name, `sub.leaf`.
    pub name: String,
    /// Its type.
    pub kind: ParameterKind,
    /// The default; `None` where it must be given.
    pub default: Option<ParameterValue>,
    /// A sentence.
    pub description: String,
    /// Unit, or empty.
    pub unit: &'static str,
    /// Smallest and largest value (of each entry, for a list).
    pub range: Option<(f64, f64)>,
    /// The texts that it can be; empty for any.
    pub choices: &'static [&'static str],
    /// May it change while the node runs?
    pub live: bool,
}

impl Descriptor {
    /// A parameter without unit and range, read-only.
    pub fn new(
        name: impl Into<String>,
        kind: ParameterKind,
        default: Option<ParameterValue>,
        description: impl Into<String>,
    ) -> Self {
        Self {
            name: name.into(),
            kind,
            default,
            description: description.into(),
            unit: "",
            range: None,
            choices: &[],
            live: false,
        }
    }

    /// With another name than the field's, such as `sub.leaf`.
    #[must_use]
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }

    /// With a unit.
    #[must_use]
    pub fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// With a smallest and a largest value.
    #[must_use]
    pub fn range<T: Into<f64>>(mut self, range: RangeInclusive<T>) -> Self {
        let (low, high) = range.into_inner();
        self.range = Some((low.into(), high.into()));
        self
    }

    /// One of these texts.
    #[must_use]
    pub fn one_of(mut self, choices: &'static [&'static str]) -> Self {
        self.choices = choices;
        self
    }

    /// It may change while the node runs.
    #[must_use]
    pub fn live(mut self) -> Self {
        self.live = true;
        self
    }

    /// `[0, 1]`, `a | b`, or empty.
    pub fn constraint(&self) -> String {
        match (self.range, self.choices) {
            (Some((low, high)), _) => format!("{low} … {high}"),
            (None, []) => String::new(),
            (None, choices) => choices.join(" | "),
        }
    }

    /// The value as this parameter holds it: whole numbers become doubles where doubles are declared.
    ///
    /// # Errors
    /// Another type, a NaN, a value out of range or none of the choices.
    pub fn accept(&self, value: &ParameterValue) -> Result<ParameterValue, ParameterError> {
        let value = self.convert(value)?;
        let wrong = |requirement: String| {
            Err(ParameterError::Value { name: self.name.clone(), value: value.to_string(), requirement })
        };
        let numbers: Vec<f64> = match &value {
            ParameterValue::Double(_) | ParameterValue::Integer(_) => value.as_f64().into_iter().collect(),
            _ => value.as_f64_array().unwrap_or_default(),
        };
        if numbers.iter().any(|x| x.is_nan()) {
            return wrong("it must be a number".to_owned());
        }
        if let Some((low, high)) = self.range
            && numbers.iter().any(|x| !(low..=high).contains(x))
        {
            let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
            return wrong(format!("it must lie between {low} and {high}{unit}"));
        }
        if !self.choices.is_empty() {
            let texts: &[String] = match &value {
                ParameterValue::String(s) => std::slice::from_ref(s),
                ParameterValue::StringArray(list) => list,
                _ => &[],
            };
            if texts.iter().any(|t| !self.choices.contains(&t.as_str())) {
                return wrong(format!("it must be one of {}", self.choices.join(", ")));
            }
        }
        Ok(value)
    }

    fn convert(&self, value: &ParameterValue) -> Result<ParameterValue, ParameterError> {
        let found = ParameterKind::of(value);
        if found == self.kind {
            return Ok(value.clone());
        }
        let converted = match (self.kind, value) {
            (ParameterKind::Double, ParameterValue::Integer(_)) => value.as_f64().map(ParameterValue::Double),
            (ParameterKind::DoubleArray, ParameterValue::IntegerArray(_)) => {
                value.as_f64_array().map(ParameterValue::DoubleArray)
            }
            // `[]` has no type of its own.
            (ParameterKind::BoolArray, ParameterValue::DoubleArray(a)) if a.is_empty() => {
                Some(ParameterValue::BoolArray(Vec::new()))
            }
            (ParameterKind::IntegerArray, ParameterValue::DoubleArray(a)) if a.is_empty() => {
                Some(ParameterValue::IntegerArray(Vec::new()))
            }
            (ParameterKind::StringArray, ParameterValue::DoubleArray(a)) if a.is_empty() => {
                Some(ParameterValue::StringArray(Vec::new()))
            }
            // `-p name:=5` and `-p name:=true` are texts where a text is declared (a serial number, a folder).
            (ParameterKind::String, ParameterValue::Integer(_) | ParameterValue::Bool(_)) => {
                Some(ParameterValue::String(value.to_string()))
            }
            _ => None,
        };
        converted.ok_or_else(|| ParameterError::Type {
            name: self.name.clone(),
            expected: self.kind.name(),
            value: value.to_string(),
            found: found.name(),
        })
    }
}

/// What every node declares besides its own: `use_sim_time`, `autostart` and the keys of the rig file.
pub fn common_descriptors() -> Vec<Descriptor> {
    let mut all = vec![
        Descriptor::new(
            "use_sim_time",
            ParameterKind::Bool,
            Some(ParameterValue::Bool(false)),
            "Take the time from /clock instead of the system.",
        )
        .live(),
        Descriptor::new(
            "autostart",
            ParameterKind::Bool,
            Some(ParameterValue::Bool(true)),
            "Start active; false waits for the lifecycle services.",
        ),
    ];
    all.extend(rig_keys().into_iter().map(|key| {
        let kind = match &key.default {
            Some(value) => ParameterKind::of(value),
            None if key.name == "markers.size" => ParameterKind::Double,
            None => ParameterKind::DoubleArray,
        };
        Descriptor::new(key.name, kind, key.default, format!("Rig file: {}.", key.description))
    }));
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_are_converted_only_where_nothing_is_lost() {
        let number = Descriptor::new("x", ParameterKind::Double, None, "");
        assert_eq!(number.accept(&ParameterValue::Integer(3)), Ok(ParameterValue::Double(3.0)));
        assert!(number.accept(&ParameterValue::String("3".into())).is_err());
        assert!(number.accept(&ParameterValue::Double(f64::NAN)).is_err());
        let whole = Descriptor::new("n", ParameterKind::Integer, None, "").range(0..=5);
        assert!(whole.accept(&ParameterValue::Double(3.0)).is_err());
        assert!(whole.accept(&ParameterValue::Integer(6)).is_err());
        let text = Descriptor::new("t", ParameterKind::String, None, "").one_of(&["tight", "paper"]);
        assert!(text.accept(&ParameterValue::String("papr".into())).is_err());
        let list = Descriptor::new("l", ParameterKind::StringArray, None, "");
        assert_eq!(
            list.accept(&ParameterValue::DoubleArray(vec![])),
            Ok(ParameterValue::StringArray(vec![]))
        );
    }

    #[test]
    fn every_default_of_the_common_ones_is_acceptable_to_itself() {
        for descriptor in common_descriptors() {
            if let Some(default) = &descriptor.default {
                assert_eq!(descriptor.accept(default).as_ref(), Ok(default), "{}", descriptor.name);
            }
        }
    }
}
