//! Declaration of parameters.

use crate::{Descriptor, ParameterError, ParameterMap, ParameterType, ParameterValue};

/// Declares parameters: a struct, its defaults, its descriptors and its validation.
///
/// Each row is a doc comment (the description), `field: type = default`, and any of `unit("m")`,
/// `range(0.0..=1.0)`, `one_of(&["a", "b"])`, `name("sub.leaf")` (else the field's name), `live`
/// (else read-only), `required` (else the default holds where the parameter is not given). Types:
/// `bool`, `f64`, whole numbers, `String`, `[f64; 3]`, and enums declared with
/// [`choices!`](crate::choices!). `groups` are fields that are such structs themselves, `plain`
/// fields that are no parameters; a `check` validates the whole struct. The documentation of a
/// field shows its attributes.
///
/// ```
/// ros_parameters::choices! {
///     /// What the driver sends.
///     pub enum Output {
///         /// All samples.
///         All = "all",
///         /// Every second sample.
///         Half = "half",
///     }
/// }
/// ros_parameters::parameters! {
///     /// Parameters of a driver.
///     pub struct DriverParameters {
///         /// Samples per second.
///         rate: f64 = 100.0, unit("Hz"), range(1.0..=512.0), name("sampling.rate");
///         /// What is sent.
///         output: Output = Output::All, live;
///     }
///     check(p) {
///         if p.output == Output::Half && p.rate < 2.0 {
///             Err("half of the samples of sampling.rate are fewer than one per second".to_owned())
///         } else {
///             Ok(())
///         }
///     }
/// }
/// use ros_parameters::{ParameterMap, ParameterSet, ParameterValue};
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
            $( groups { $( $(#[doc = $group_doc:literal])+ $group:ident : $Group:ty ; )+ } )?
            $( plain {
                $( $(#[doc = $plain_doc:literal])+ $plain:ident : $Plain:ty = $value:expr ; )+
            } )?
        }
        $( check($this:ident) $check:block )?
    ) => {
        $(#[$meta])*
        #[derive(Clone, Debug)]
        $vis struct $Name {
            $(
                $(#[doc = $doc])+
                $( #[doc = concat!(
                    "- `", stringify!($attribute), $( "(", $(stringify!($argument),)* ")", )? "`"
                )] )*
                pub $field: $type,
            )*
            $($( $(#[doc = $group_doc])+ pub $group: $Group, )+)?
            $($( $(#[doc = $plain_doc])+ pub $plain: $Plain, )+)?
        }

        impl Default for $Name {
            fn default() -> Self {
                Self {
                    $(
                        $field:
                            <$type as $crate::ParameterType>::from_literal($default),
                    )*
                    $($( $group: <$Group>::default(), )+)?
                    $($( $plain: $value, )+)?
                }
            }
        }

        impl $crate::ParameterSet for $Name {
            fn descriptors() -> Vec<$crate::Descriptor> {
                #[allow(unused_imports)]
                use $crate::ParameterType as _;
                #[allow(unused_variables)]
                let defaults = Self::default();
                #[allow(unused_mut)]
                let mut all = vec![$(
                    $crate::Descriptor::new(
                        stringify!($field),
                        <$type as $crate::ParameterType>::KIND,
                        Some(defaults.$field.to_value()),
                        [$($doc),+].map(str::trim).join(" "),
                    )
                    .one_of(<$type as $crate::ParameterType>::CHOICES)
                    $( .$attribute($($($argument)*)?) )*,
                )*];
                $($( all.extend(<$Group as $crate::ParameterSet>::descriptors()); )+)?
                all
            }

            fn from_map(
                map: &$crate::ParameterMap,
            ) -> Result<Self, $crate::ParameterError> {
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
                $($( set.$group = <$Group as $crate::ParameterSet>::from_map(map)?; )+)?
                $(
                    let $this = &set;
                    let checked: Result<(), String> = $check;
                    checked.map_err($crate::ParameterError::Invalid)?;
                )?
                Ok(set)
            }
        }
    };
}

/// Declares an enum whose variants are the allowed texts of a parameter.
#[macro_export]
macro_rules! choices {
    (
        $(#[$meta:meta])*
        $vis:vis enum $Name:ident {
            $( $(#[doc = $doc:literal])+ $Variant:ident = $text:literal, )+
        }
    ) => {
        $(#[$meta])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        $vis enum $Name {
            $( $(#[doc = $doc])+ $Variant, )+
        }

        impl $crate::ParameterType for $Name {
            type Literal = Self;
            const KIND: $crate::ParameterKind = $crate::ParameterKind::String;
            const CHOICES: &'static [&'static str] = &[$($text),+];

            fn from_value(value: &$crate::ParameterValue) -> Option<Self> {
                let $crate::ParameterValue::String(text) = value else { return None };
                match text.as_str() {
                    $( $text => Some(Self::$Variant), )+
                    _ => None,
                }
            }

            fn to_value(&self) -> $crate::ParameterValue {
                let text = match self {
                    $( Self::$Variant => $text, )+
                };
                $crate::ParameterValue::String(text.to_owned())
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
    /// As `accept`, and for values that the field's type cannot hold.
    #[doc(hidden)]
    pub fn read<T: ParameterType>(&self, value: &ParameterValue) -> Result<T, ParameterError> {
        let accepted = self.accept(value)?;
        T::from_value(&accepted).ok_or_else(|| self.forbids(value, T::REQUIREMENT))
    }
}
