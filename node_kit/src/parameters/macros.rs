//! The declaration.

/// Declares the parameters of a node: a struct, its defaults, its descriptors and its validation.
///
/// Each row is a doc comment (the sentence), `field: type = default`, and any of `unit("m")`, `range(0.0..=1.0)`,
/// `one_of(&["a", "b"])`, `name("sub.leaf")` (else the field's name), `live` (else read-only). Types: `bool`, `f64`,
/// whole numbers, `String`, `Vec` of `bool`, `i64`, `f64`, `String`. An optional `check` at the end sees the whole
/// struct and refuses values that do not go together.
///
/// ```
/// node_kit::parameters! {
///     /// Parameters of a driver.
///     #[derive(PartialEq)]
///     pub struct DriverParameters {
///         /// Serial port that the unit is on.
///         port: String = "/dev/ttyUSB0";
///         /// Samples per second.
///         rate: f64 = 100.0, unit("Hz"), range(1.0..=512.0), name("sampling.rate");
///         /// Say it after so many lost samples.
///         loss_limit: u32 = 3, range(1..=1000), live;
///     }
///     check(p) {
///         if p.rate * f64::from(p.loss_limit) > 5000.0 { Err("rate times loss_limit exceeds 5000".to_owned()) } else { Ok(()) }
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
                $field:ident : $type:ty = $default:expr $(, $attribute:ident $(( $($argument:tt)* ))? )* ;
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
                    $( $field: <$type as $crate::parameters::ParameterType>::from_literal($default), )*
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
                        && let Some(value) = map.get(&descriptor.name)
                    {
                        set.$field = descriptor.read(value)?;
                    }
                )*
                let _ = &mut descriptors;
                $(
                    let $this = &set;
                    let checked: Result<(), String> = $check;
                    checked.map_err(|requirement| $crate::parameters::ParameterError::Rule { requirement })?;
                )?
                Ok(set)
            }
        }
    };
}

impl super::Descriptor {
    /// [`super::Descriptor::accept`], then as the field's type.
    ///
    /// # Errors
    /// What `accept` refuses, and whole numbers that the type cannot hold.
    #[doc(hidden)]
    pub fn read<T: super::ParameterType>(
        &self,
        value: &super::ParameterValue,
    ) -> Result<T, super::ParameterError> {
        let accepted = self.accept(value)?;
        T::from_value(&accepted).ok_or_else(|| super::ParameterError::Value {
            name: self.name.clone(),
            value: value.to_string(),
            requirement: "it is too large, or negative where it cannot be".to_owned(),
        })
    }
}
