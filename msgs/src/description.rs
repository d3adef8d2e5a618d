//! Descriptions of the built-in types as messages: what `~/get_type_description` answers
//! (REP-2016).

use crate::type_description_interfaces::msg::{
    self as messages, FieldType, IndividualTypeDescription, TypeDescription, TypeSource,
};

/// A type with its fields and its `.msg` or `.srv` text.
pub(crate) struct Type {
    pub name: &'static str,
    pub fields: &'static [Field],
    /// Names of the types nested in it, at any depth, sorted.
    pub nested: &'static [&'static str],
    pub encoding: &'static str,
    pub text: &'static str,
}

/// A field of a [`Type`].
pub(crate) struct Field {
    pub name: &'static str,
    pub type_id: u8,
    pub capacity: u64,
    pub string_capacity: u64,
    pub nested: &'static str,
    pub default: &'static str,
}

impl Type {
    fn of(name: &str) -> Option<&'static Self> {
        let types = crate::TYPES;
        types.binary_search_by(|t| t.name.cmp(name)).ok().and_then(|i| types.get(i))
    }

    fn description(&self) -> IndividualTypeDescription {
        let field = |f: &Field| messages::Field {
            name: f.name.to_owned(),
            r#type: FieldType {
                type_id: f.type_id,
                capacity: f.capacity,
                string_capacity: f.string_capacity,
                nested_type_name: f.nested.to_owned(),
            },
            default_value: f.default.to_owned(),
        };
        IndividualTypeDescription {
            type_name: self.name.to_owned(),
            fields: self.fields.iter().map(field).collect(),
        }
    }

    fn source(&self) -> TypeSource {
        TypeSource {
            type_name: self.name.to_owned(),
            encoding: self.encoding.to_owned(),
            raw_file_contents: self.text.to_owned(),
        }
    }
}

/// Description of the built-in message or service with this name (`package/msg/Type`,
/// `package/srv/Type`), and the texts of it and of the types nested in it; `None` for an unknown
/// name.
pub fn describe(type_name: &str) -> Option<(TypeDescription, Vec<TypeSource>)> {
    let main = Type::of(type_name)?;
    let nested: Vec<&Type> = main.nested.iter().copied().filter_map(Type::of).collect();
    let description = TypeDescription {
        type_description: main.description(),
        referenced_type_descriptions: nested.iter().map(|t| t.description()).collect(),
    };
    let sources = std::iter::once(main).chain(nested).map(Type::source).collect();
    Some((description, sources))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn a_message_is_described_with_all_that_is_nested_in_it() {
        let (description, sources) = describe("nav_msgs/msg/Odometry").unwrap();
        let names: Vec<&str> =
            description.referenced_type_descriptions.iter().map(|t| t.type_name.as_str()).collect();
        assert!(names.is_sorted());
        assert!(names.contains(&"builtin_interfaces/msg/Time"), "{names:?}");
        let quaternion = description
            .referenced_type_descriptions
            .iter()
            .find(|t| t.type_name == "geometry_msgs/msg/Quaternion")
            .unwrap();
        assert_eq!(quaternion.fields[3].default_value, "1.0");
        assert_eq!(sources.len(), names.len() + 1);
        assert!(sources.iter().all(|s| s.encoding == "msg" && !s.raw_file_contents.is_empty()));
    }

    #[test]
    fn a_service_is_described_with_its_event() {
        let (description, sources) = describe("std_srvs/srv/Trigger").unwrap();
        assert_eq!(description.type_description.fields[2].name, "event_message");
        let encodings: BTreeSet<_> =
            sources.iter().map(|s| (s.type_name.as_str(), s.encoding.as_str())).collect();
        assert!(encodings.contains(&("std_srvs/srv/Trigger", "srv")));
        assert!(encodings.contains(&("std_srvs/srv/Trigger_Event", "implicit")));
        assert!(sources[0].raw_file_contents.contains("---\nbool success"));
        assert_eq!(describe("std_srvs/srv/Nothing"), None);
    }
}
