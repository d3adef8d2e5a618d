//! Declaration of one parameter: type, default, constraints.

use crate::ParameterValue;
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

    /// Name, as `ros2 param describe` prints it.
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

/// Why a parameter's value is rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ParameterError {
    /// An unknown name, a value that the declaration forbids, or inconsistent values: the flat
    /// name, what is wrong, and the remedy.
    #[error("{0}")]
    Invalid(String),
    /// A required parameter that was not given.
    #[error(
        "the parameter `{name}` must be given. {description} Set it in a file (--params-file) or \
         with -p {name}:=…"
    )]
    Missing {
        /// The flat name.
        name: String,
        /// Its description.
        description: String,
    },
    /// A value that was given at the start.
    #[error("{message} ({origin})")]
    Given {
        /// What is wrong with it.
        message: String,
        /// The file, or `-p`.
        origin: String,
    },
}

/// One declared parameter.
#[derive(Clone, Debug, PartialEq)]
pub struct Descriptor {
    /// Flat name, `sub.leaf`.
    pub name: String,
    /// Its type.
    pub kind: ParameterKind,
    /// The default; `None` if it must be given.
    pub default: Option<ParameterValue>,
    /// Description, one sentence.
    pub description: String,
    /// Unit, or empty.
    pub unit: &'static str,
    /// Smallest and largest value (of each entry, for a list).
    pub range: Option<(f64, f64)>,
    /// Allowed texts; empty for any.
    pub choices: &'static [&'static str],
    /// Whether it may change while the node runs.
    pub live: bool,
}

impl Descriptor {
    /// Creates a read-only parameter without unit and range.
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

    /// Sets another name than the field's, such as `sub.leaf`.
    #[must_use]
    pub fn name(mut self, name: impl Into<String>) -> Self {
        self.name = name.into();
        self
    }

    /// Removes the default: the parameter must be given.
    #[must_use]
    pub fn required(mut self) -> Self {
        self.default = None;
        self
    }

    /// Sets the unit.
    #[must_use]
    pub fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// Sets the smallest and the largest value.
    #[must_use]
    pub fn range<T: Into<f64>>(mut self, range: RangeInclusive<T>) -> Self {
        let (low, high) = range.into_inner();
        self.range = Some((low.into(), high.into()));
        self
    }

    /// Sets the allowed texts.
    #[must_use]
    pub fn one_of(mut self, choices: &'static [&'static str]) -> Self {
        self.choices = choices;
        self
    }

    /// Allows changes while the node runs.
    #[must_use]
    pub fn live(mut self) -> Self {
        self.live = true;
        self
    }

    /// The constraint as text: `0 … 1`, `a | b`, or empty.
    pub fn constraint(&self) -> String {
        match (self.range, self.choices) {
            (Some((low, high)), _) => format!("{low} … {high}"),
            (None, []) => String::new(),
            (None, choices) => choices.join(" | "),
        }
    }

    /// Validates a value and converts whole numbers to declared doubles, and `yes` or `off` to
    /// declared booleans.
    ///
    /// # Errors
    /// [`ParameterError`] for another type, a NaN, a value out of range or not among the choices.
    pub fn accept(&self, value: &ParameterValue) -> Result<ParameterValue, ParameterError> {
        let value = self.convert(value)?;
        let wrong = |requirement: &str| Err(self.forbids(&value, requirement));
        let number = value.as_f64().map(|x| vec![x]);
        let numbers = number.or_else(|| value.as_f64_array()).unwrap_or_default();
        if numbers.iter().any(|x| x.is_nan()) {
            return wrong("it must be a number");
        }
        if let Some((low, high)) = self.range
            && numbers.iter().any(|x| !(low..=high).contains(x))
        {
            let unit = if self.unit.is_empty() { String::new() } else { format!(" {}", self.unit) };
            return wrong(&format!("it must lie between {low} and {high}{unit}"));
        }
        if !self.choices.is_empty() {
            let texts: &[String] = match &value {
                ParameterValue::String(s) => std::slice::from_ref(s),
                ParameterValue::StringArray(list) => list,
                _ => &[],
            };
            if texts.iter().any(|t| !self.choices.contains(&t.as_str())) {
                return wrong(&format!("it must be one of {}", self.choices.join(", ")));
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
            (ParameterKind::Double, ParameterValue::Integer(_)) => {
                value.as_f64().map(ParameterValue::Double)
            }
            (ParameterKind::DoubleArray, ParameterValue::IntegerArray(_)) => {
                value.as_f64_array().map(ParameterValue::DoubleArray)
            }
            (ParameterKind::Bool, ParameterValue::String(text)) => {
                yaml_boolean(text).map(ParameterValue::Bool)
            }
            // `-p name:=5` and `-p name:=true` are texts if a text is declared (a serial number).
            (ParameterKind::String, ParameterValue::Integer(_) | ParameterValue::Bool(_)) => {
                Some(ParameterValue::String(value.to_string()))
            }
            _ => None,
        };
        converted.ok_or_else(|| {
            let (name, expected, found) = (&self.name, self.kind.name(), found.name());
            let text = format!("the parameter `{name}` is a {expected}, but {value} is a {found}");
            ParameterError::Invalid(text)
        })
    }

    /// The error of a value that violates a requirement.
    pub(crate) fn forbids(&self, value: &ParameterValue, requirement: &str) -> ParameterError {
        let name = &self.name;
        ParameterError::Invalid(format!("the parameter `{name}` is {value}, but {requirement}"))
    }
}

/// A boolean of YAML 1.1 that YAML 1.2 reads as text, in the three capitalizations that rcl knows.
fn yaml_boolean(text: &str) -> Option<bool> {
    match text {
        "y" | "Y" | "yes" | "Yes" | "YES" | "on" | "On" | "ON" => Some(true),
        "n" | "N" | "no" | "No" | "NO" | "off" | "Off" | "OFF" => Some(false),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_of_yaml_1_1_are_declared_booleans() {
        let flag = Descriptor::new("f", ParameterKind::Bool, None, "");
        for (text, value) in [("yes", Some(true)), ("OFF", Some(false)), ("oFF", None)] {
            let accepted = flag.accept(&crate::parse_value("f", text).unwrap());
            assert_eq!(accepted.ok(), value.map(ParameterValue::Bool), "{text}");
        }
        let text = Descriptor::new("t", ParameterKind::String, None, "");
        let no = ParameterValue::String("no".into());
        assert_eq!(text.accept(&no), Ok(no));
    }

    #[test]
    fn values_are_converted_only_without_loss() {
        let number = Descriptor::new("x", ParameterKind::Double, None, "");
        assert_eq!(number.accept(&ParameterValue::Integer(3)), Ok(ParameterValue::Double(3.0)));
        assert!(number.accept(&ParameterValue::String("3".into())).is_err());
        assert!(number.accept(&ParameterValue::Double(f64::NAN)).is_err());
        let whole = Descriptor::new("n", ParameterKind::Integer, None, "").range(0..=5);
        assert!(whole.accept(&ParameterValue::Double(3.0)).is_err());
        assert!(whole.accept(&ParameterValue::Integer(6)).is_err());
        let text =
            Descriptor::new("t", ParameterKind::String, None, "").one_of(&["tight", "paper"]);
        assert!(text.accept(&ParameterValue::String("papr".into())).is_err());
    }
}
