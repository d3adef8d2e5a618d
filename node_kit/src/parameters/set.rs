//! What a node's parameters are as plain data.

use super::{Descriptor, ParameterError, ParameterKind, ParameterMap, ParameterValue};

/// A plain struct whose fields are parameters. Made by [`parameters!`](crate::parameters!), not by hand.
pub trait ParameterSet: Clone + Send + 'static {
    /// One for each field.
    fn descriptors() -> Vec<Descriptor>;

    /// From flat values; what is not in the map has its default.
    ///
    /// # Errors
    /// A value of another type or out of its range, or values that do not go together.
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

/// A type that a field of a [`ParameterSet`] can have.
pub trait ParameterType: Sized {
    /// How its default is written in the declaration: `1.5`, `"text"`, `&[1.0, 2.0]`.
    type Literal;
    /// The ROS type.
    const KIND: ParameterKind;

    /// From the default in the declaration.
    fn from_literal(literal: Self::Literal) -> Self;
    /// From a value that the descriptor has accepted; `None` where this type cannot hold it.
    fn from_value(value: &ParameterValue) -> Option<Self>;
    /// As a value.
    fn to_value(&self) -> ParameterValue;
}

macro_rules! plain {
    ($type:ty, $literal:ty, $kind:ident, $from:expr) => {
        impl ParameterType for $type {
            type Literal = $literal;
            const KIND: ParameterKind = ParameterKind::$kind;

            fn from_literal(literal: $literal) -> Self {
                ($from)(literal)
            }

            fn from_value(value: &ParameterValue) -> Option<Self> {
                if let ParameterValue::$kind(x) = value { Some(x.clone()) } else { None }
            }

            fn to_value(&self) -> ParameterValue {
                ParameterValue::$kind(self.clone())
            }
        }
    };
}

plain!(bool, bool, Bool, |x| x);
plain!(f64, f64, Double, |x| x);
plain!(String, &'static str, String, str::to_owned);
plain!(Vec<bool>, &'static [bool], BoolArray, |x: &[bool]| x.to_vec());
plain!(Vec<i64>, &'static [i64], IntegerArray, |x: &[i64]| x.to_vec());
plain!(Vec<f64>, &'static [f64], DoubleArray, |x: &[f64]| x.to_vec());
plain!(Vec<String>, &'static [&'static str], StringArray, |x: &[&str]| x
    .iter()
    .map(|s| (*s).to_owned())
    .collect());

macro_rules! integer {
    ($($type:ty),*) => {$(
        impl ParameterType for $type {
            type Literal = $type;
            const KIND: ParameterKind = ParameterKind::Integer;

            fn from_literal(literal: $type) -> Self {
                literal
            }

            fn from_value(value: &ParameterValue) -> Option<Self> {
                if let ParameterValue::Integer(x) = value { <$type>::try_from(*x).ok() } else { None }
            }

            fn to_value(&self) -> ParameterValue {
                ParameterValue::Integer(i64::try_from(*self).unwrap_or(i64::MAX))
            }
        }
    )*};
}

integer!(i64, i32, u32, u16, u8, usize);
