//! A node's parameters as plain data.

use crate::{Descriptor, ParameterError, ParameterKind, ParameterMap, ParameterValue};

/// A plain struct whose fields are parameters, declared with [`parameters!`](crate::parameters!).
pub trait ParameterSet: Clone + Send + 'static {
    /// Descriptors, one for each field.
    fn descriptors() -> Vec<Descriptor>;

    /// Creates the struct from flat values; a missing one has its default.
    ///
    /// # Errors
    /// [`ParameterError`] for a value of another type or out of its range, or inconsistent values.
    fn from_map(map: &ParameterMap) -> Result<Self, ParameterError>;
}

/// A node without parameters of its own.
impl ParameterSet for () {
    fn descriptors() -> Vec<Descriptor> {
        Vec::new()
    }

    fn from_map(_: &ParameterMap) -> Result<Self, ParameterError> {
        Ok(())
    }
}

/// Type of a field of a [`ParameterSet`].
pub trait ParameterType: Sized {
    /// Type of the default in the declaration: `1.5`, `"text"`.
    type Literal: Into<Self>;
    /// The ROS type.
    const KIND: ParameterKind;
    /// Allowed texts; empty for any.
    const CHOICES: &'static [&'static str] = &[];
    /// What is wrong with a value of that ROS type that is none of this type.
    const REQUIREMENT: &'static str = "it is too large, or negative";

    /// Converts the default of the declaration.
    fn from_literal(literal: Self::Literal) -> Self {
        literal.into()
    }
    /// Converts a value that the descriptor has accepted; `None` if it is none of this type.
    fn from_value(value: &ParameterValue) -> Option<Self>;
    /// Converts to a value.
    fn to_value(&self) -> ParameterValue;
}

macro_rules! plain {
    ($type:ty, $literal:ty, $kind:ident) => {
        impl ParameterType for $type {
            type Literal = $literal;
            const KIND: ParameterKind = ParameterKind::$kind;

            fn from_value(value: &ParameterValue) -> Option<Self> {
                if let ParameterValue::$kind(x) = value { Some(x.clone()) } else { None }
            }

            fn to_value(&self) -> ParameterValue {
                ParameterValue::$kind(self.clone())
            }
        }
    };
}

plain!(bool, bool, Bool);
plain!(f64, f64, Double);
plain!(String, &'static str, String);

macro_rules! integer {
    ($($type:ty),*) => {$(
        impl ParameterType for $type {
            type Literal = $type;
            const KIND: ParameterKind = ParameterKind::Integer;

            fn from_value(value: &ParameterValue) -> Option<Self> {
                let ParameterValue::Integer(x) = value else { return None };
                <$type>::try_from(*x).ok()
            }

            fn to_value(&self) -> ParameterValue {
                ParameterValue::Integer(i64::try_from(*self).unwrap_or(i64::MAX))
            }
        }
    )*};
}

integer!(i64, i32, u32, u16, u8, usize);

/// A vector: x, y, z.
impl ParameterType for [f64; 3] {
    type Literal = Self;
    const KIND: ParameterKind = ParameterKind::DoubleArray;
    const REQUIREMENT: &'static str = "it must have three numbers: x, y, z";

    fn from_value(value: &ParameterValue) -> Option<Self> {
        let ParameterValue::DoubleArray(numbers) = value else { return None };
        numbers.as_slice().try_into().ok()
    }

    fn to_value(&self) -> ParameterValue {
        ParameterValue::DoubleArray(self.to_vec())
    }
}
