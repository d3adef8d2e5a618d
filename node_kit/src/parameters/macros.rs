//! Declaration of parameters.

use super::{
    descriptor::{Descriptor, ParameterError},
    set::ParameterType,
};
use ros_parameters::{ParameterMap, ParameterValue};

/// Declares the parameters of a node: a struct, its defaults, its descriptors and its validation.
///
/// Each row is a doc comment (the description), `field: type = default`, and any of `unit("m")`,
/// `range(0.0..=1.0)`, `one_of(&["a", "b"])`, `name("sub.leaf")` (else the field's name), `live`
/// (else read-only), `required` (else the default holds where the parameter is not given). Types: `bool`, `f64`, whole numbers, `String`, `Vec` of `bool`, `i64`, `f64`,
/// `String`. An optional `check` at the end validates the whole struct.
///
/// ```
/// node_kit::parameters! {
///     /// Parameters of a driver.
///     #[derive(PartialEq)]
///     pub struct DriverParameters {
///         /// Serial port of the IMU.
///         port: String = "/dev/ttyUSB0";
///         /// Samples per second.
///         rate: f64 = 100.0, unit("Hz"), range(1.0..=512.0), name("sampling.rate");
///         /// Lost samples that cause a warning.
///         loss_limit: u32 = 3, range(1..=1000), live;
///     }
///     check(p) {
///         if p.rate * f64::from(p.loss_limit) > 5000.0 {
///             Err("rate times loss_limit exceeds 5000".to_owned())
///         } else {
///             Ok(())
///         }
///     }
/// }
/// use node_kit::parameters::{ParameterMap, ParameterSet, ParameterValue};
/// assert_eq!(DriverParameters::default().rate, 100.0);
/// let map = ParameterMap::from([("sampling.rate".to_owned(), ParameterValue::Integer(400))]);
/// assert_eq!(DriverParameters::from_map(&map).unwrap().rate, 400.0);
/// let map = ParameterMap::from([("sampling.rate".to_owned(), ParameterValue::Integer(4000))]);
/// assert!(DriverParameters::from_map(&map).is_err());
/// ```
#[macro_export]
macro_rules! parameters {
    (
        $(#[$meta:meta])*
        $vis:vis struct $Name:ident {
            $(
                $(#[doc = $doc:literal])+
                $field:ident : $type:ty = $default:expr
                    $(, $attribute:ident $(( $($argument:tt)* ))? )* ;
            )*
        }
        $( check($this:ident) $check:block )?
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug)]
        $vis struct $Name {
            $( $(#[doc = $doc])+ pub $field: $type, )*
        }

        impl Default for $Name {
            fn default() -> Self {
                Self {
                    $(
                        $field:
                            <$type as $crate::parameters::ParameterType>::from_literal($default),
                    )*
                }
            }
        }

        impl $crate::parameters::ParameterSet for $Name {
            fn descriptors() -> Vec<$crate::parameters::Descriptor> {
                #[allow(unused_imports)]
                use $crate::parameters::ParameterType as _;
                #[allow(unused_variables)]
                let defaults = Self::default();
                vec![$(
                    $crate::parameters::Descriptor::new(
                        stringify!($field),
                        <$type as $crate::parameters::ParameterType>::KIND,
                        Some(defaults.$field.to_value()),
                        [$($doc),+].map(str::trim).join(" "),
                    )
                    $( .$attribute($($($argument)*)?) )*,
                )*]
            }

            fn from_map(
                map: &$crate::parameters::ParameterMap,
            ) -> Result<Self, $crate::parameters::ParameterError> {
                #[allow(unused_mut)]
                let mut set = Self::default();
                let mut descriptors = Self::descriptors().into_iter();
                $(
                    if let Some(descriptor) = descriptors.next()
                        && let Some(value) = descriptor.given(map)?
                    {
                        set.$field = descriptor.read(value)?;
                    }
                )*
                let _ = &mut descriptors;
                $(
                    let $this = &set;
                    let checked: Result<(), String> = $check;
                    checked.map_err(|requirement| {
                        $crate::parameters::ParameterError::Rule { requirement }
                    })?;
                )?
                Ok(set)
            }
        }
    };
}

impl Descriptor {
    /// Returns the parameter's value, if it is given.
    ///
    /// # Errors
    /// [`ParameterError::Missing`] if it is not, and must be.
    pub fn given<'m>(
        &self,
        map: &'m ParameterMap,
    ) -> Result<Option<&'m ParameterValue>, ParameterError> {
        match (map.get(&self.name), &self.default) {
            (None, None) => Err(ParameterError::Missing {
                name: self.name.clone(),
                description: self.description.clone(),
            }),
            (value, _) => Ok(value),
        }
    }

    /// Validates a value ([`Descriptor::accept`]) and converts it to the field's type.
    ///
    /// # Errors
    /// As `accept`, and for whole numbers out of the range of the type.
    #[doc(hidden)]
    pub fn read<T: ParameterType>(&self, value: &ParameterValue) -> Result<T, ParameterError> {
        let accepted = self.accept(value)?;
        T::from_value(&accepted).ok_or_else(|| ParameterError::Value {
            name: self.name.clone(),
            value: value.to_string(),
            requirement: "it is too large, or negative".to_owned(),
        })
    }
}
