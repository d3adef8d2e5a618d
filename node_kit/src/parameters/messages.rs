//! Parameters as messages of `rcl_interfaces`.

use super::{Descriptor, ParameterKind};
use ros_parameters::ParameterValue;
use volant_msgs::rcl_interfaces::msg;

/// Message of a value; `None` is "not set".
pub fn value_message(value: Option<&ParameterValue>) -> msg::ParameterValue {
    let mut message = msg::ParameterValue::default();
    let Some(value) = value else { return message };
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
    use ParameterValue as V;
    use msg::ParameterType as T;
    let m = message.clone();
    Some(match m.r#type {
        T::PARAMETER_BOOL => V::Bool(m.bool_value),
        T::PARAMETER_INTEGER => V::Integer(m.integer_value),
        T::PARAMETER_DOUBLE => V::Double(m.double_value),
        T::PARAMETER_STRING => V::String(m.string_value),
        T::PARAMETER_BOOL_ARRAY => V::BoolArray(m.bool_array_value),
        T::PARAMETER_INTEGER_ARRAY => V::IntegerArray(m.integer_array_value),
        T::PARAMETER_DOUBLE_ARRAY => V::DoubleArray(m.double_array_value),
        T::PARAMETER_STRING_ARRAY => V::StringArray(m.string_array_value),
        _ => return None,
    })
}

/// Message of a declaration; `None` for an undeclared `name`.
pub fn descriptor_message(name: &str, descriptor: Option<&Descriptor>) -> msg::ParameterDescriptor {
    let mut message = msg::ParameterDescriptor { name: name.to_owned(), ..Default::default() };
    let Some(d) = descriptor else { return message };
    message.r#type = d.kind as u8;
    message.description.clone_from(&d.description);
    if !d.unit.is_empty() {
        message.description += &format!(" [{}]", d.unit);
    }
    if !d.choices.is_empty() {
        message.additional_constraints = format!("one of {}", d.choices.join(", "));
    }
    message.read_only = !d.live;
    match (d.range, d.kind) {
        (None, _) => {}
        (Some((low, high)), ParameterKind::Integer | ParameterKind::IntegerArray) => {
            // The declaration has whole numbers here.
            let (from_value, to_value) = (low as i64, high as i64);
            message.integer_range = vec![msg::IntegerRange { from_value, to_value, step: 0 }];
        }
        (Some((from_value, to_value)), _) => {
            message.floating_point_range =
                vec![msg::FloatingPointRange { from_value, to_value, step: 0.0 }];
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
