//! Parameters as messages of `rcl_interfaces`.

use super::{Descriptor, ParameterKind};
use ros_parameters::ParameterValue;
use volant_msgs::rcl_interfaces::msg;

/// `rcl_interfaces/ParameterType`'s "not set".
const NOT_SET: u8 = 0;

/// Message of a value; `None` is "not set".
pub fn value_message(value: Option<&ParameterValue>) -> msg::ParameterValue {
    let mut message = msg::ParameterValue::default();
    let Some(value) = value else {
        message.r#type = NOT_SET;
        return message;
    };
    message.r#type = ParameterKind::of(value) as u8;
    match value {
        ParameterValue::Bool(x) => message.bool_value = *x,
        ParameterValue::Integer(x) => message.integer_value = *x,
        ParameterValue::Double(x) => message.double_value = *x,
        ParameterValue::String(x) => message.string_value.clone_from(x),
        ParameterValue::BoolArray(x) => message.bool_array_value.clone_from(x),
        ParameterValue::IntegerArray(x) => message.integer_array_value.clone_from(x),
        ParameterValue::DoubleArray(x) => message.double_array_value.clone_from(x),
        ParameterValue::StringArray(x) => message.string_array_value.clone_from(x),
    }
    message
}

/// Value of a message; `None` for "not set", and for byte arrays, which no parameter here has.
pub fn value(message: &msg::ParameterValue) -> Option<ParameterValue> {
    use ParameterKind as K;
    let is = |kind: K| message.r#type == kind as u8;
    Some(match () {
        () if is(K::Bool) => ParameterValue::Bool(message.bool_value),
        () if is(K::Integer) => ParameterValue::Integer(message.integer_value),
        () if is(K::Double) => ParameterValue::Double(message.double_value),
        () if is(K::String) => ParameterValue::String(message.string_value.clone()),
        () if is(K::BoolArray) => ParameterValue::BoolArray(message.bool_array_value.clone()),
        () if is(K::IntegerArray) => {
            ParameterValue::IntegerArray(message.integer_array_value.clone())
        }
        () if is(K::DoubleArray) => ParameterValue::DoubleArray(message.double_array_value.clone()),
        () if is(K::StringArray) => ParameterValue::StringArray(message.string_array_value.clone()),
        () => return None,
    })
}

/// Message of a declaration; `None` for an undeclared `name`.
pub fn descriptor_message(name: &str, descriptor: Option<&Descriptor>) -> msg::ParameterDescriptor {
    let Some(d) = descriptor else {
        return msg::ParameterDescriptor {
            name: name.to_owned(),
            ..msg::ParameterDescriptor::default()
        };
    };
    let mut message = msg::ParameterDescriptor {
        name: d.name.clone(),
        r#type: d.kind as u8,
        description: if d.unit.is_empty() {
            d.description.clone()
        } else {
            format!("{} [{}]", d.description, d.unit)
        },
        additional_constraints: match d.choices {
            [] => String::new(),
            choices => format!("one of {}", choices.join(", ")),
        },
        read_only: !d.live,
        ..msg::ParameterDescriptor::default()
    };
    if let Some((low, high)) = d.range {
        match d.kind {
            ParameterKind::Integer | ParameterKind::IntegerArray => {
                message.integer_range = vec![msg::IntegerRange {
                    // The declaration has whole numbers here.
                    from_value: low as i64,
                    to_value: high as i64,
                    step: 0,
                }];
            }
            _ => {
                message.floating_point_range =
                    vec![msg::FloatingPointRange { from_value: low, to_value: high, step: 0.0 }];
            }
        }
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_of_value_round_trips() {
        for v in [
            ParameterValue::Bool(true),
            ParameterValue::Integer(-3),
            ParameterValue::Double(0.5),
            ParameterValue::String("x".into()),
            ParameterValue::BoolArray(vec![true, false]),
            ParameterValue::IntegerArray(vec![1, 2]),
            ParameterValue::DoubleArray(vec![1.5]),
            ParameterValue::StringArray(vec!["a".into()]),
        ] {
            assert_eq!(value(&value_message(Some(&v))), Some(v));
        }
        assert_eq!(value(&value_message(None)), None);
    }

    #[test]
    fn a_descriptor_has_unit_range_and_read_only() {
        let d = Descriptor::new("rate", ParameterKind::Double, None, "Samples per second.")
            .unit("Hz")
            .range(1.0..=400.0);
        let message = descriptor_message("rate", Some(&d));
        assert_eq!(message.description, "Samples per second. [Hz]");
        assert_eq!(message.floating_point_range[0].to_value, 400.0);
        assert!(message.read_only);
        assert!(!descriptor_message("rate", Some(&d.live())).read_only);
        assert_eq!(descriptor_message("no", None).r#type, 0);
    }
}
