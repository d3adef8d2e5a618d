//! Type description: the definition text of a bag's `ros2msg` schema, the fields that
//! `~/get_type_description` reports, and the RIHS01 hash.
//!
//! REP-2016 defines the hash as SHA-256 over the JSON of
//! `type_description_interfaces/msg/TypeDescription` without default values.

use super::{
    GenerateError, Interfaces,
    parse::{Base, Count, Interface, Name, Primitive},
};
use sha2::{Digest, Sha256};
use std::{collections::BTreeMap, fmt::Write};

/// Names of all messages nested in `message`, depth first, without itself.
fn used(set: &Interfaces, message: &Interface) -> Result<Vec<Name>, GenerateError> {
    fn visit(
        set: &Interfaces,
        message: &Interface,
        found: &mut Vec<Name>,
    ) -> Result<(), GenerateError> {
        for field in &message.fields {
            if let Base::Nested(name) = &field.base
                && !found.contains(name)
            {
                found.push(name.clone());
                visit(set, set.get(name)?, found)?;
            }
        }
        Ok(())
    }
    let mut found = vec![];
    visit(set, message, &mut found)?;
    Ok(found)
}

/// Definition text: the message, then each nested message after a line of 80 `=` and a line
/// `MSG: package/Name`.
///
/// # Errors
/// A nested type has no file.
pub fn definition(set: &Interfaces, message: &Interface) -> Result<String, GenerateError> {
    let mut text = message.text.trim_end().to_owned() + "\n";
    for name in used(set, message)? {
        let rule = "=".repeat(80);
        text += &format!("{rule}\nMSG: {}/{}\n", name.package, name.name);
        text += set.get(&name)?.text.trim_end();
        text += "\n";
    }
    Ok(text)
}

/// A field as `type_description_interfaces/msg/Field` describes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Described {
    /// Field name.
    pub name: String,
    /// One of `FieldType`'s constants.
    pub type_id: u32,
    /// Elements of an array, or the most of a bounded one; 0 without a bound.
    pub capacity: u64,
    /// The most characters of a string; 0 without a bound.
    pub string_capacity: u64,
    /// Name of a nested type, or empty.
    pub nested: String,
    /// Default value as rosidl prints it (`1.0`, `True`, text without quotes), or empty.
    pub default: String,
}

impl Described {
    fn nested(name: &str, type_id: u32, capacity: u64, of: &Name) -> Self {
        let nested = of.to_string();
        let (name, default) = (name.to_owned(), String::new());
        Self { name, type_id, capacity, string_capacity: 0, nested, default }
    }

    // The hash covers these exact bytes: one space after each comma and colon, keys in this order.
    fn json(&self) -> String {
        let Self { name, type_id, capacity, string_capacity, nested, .. } = self;
        let capacities = format!(r#""capacity": {capacity}, "string_capacity": {string_capacity}"#);
        format!(r#"{{"name": "{name}", "type": {{"type_id": {type_id}, {capacities}, "#)
            + &format!(r#""nested_type_name": "{nested}"}}}}"#)
    }
}

const NESTED: u32 = 1;
const FIXED: u32 = 48;
const BOUNDED: u32 = 96;
const UNBOUNDED: u32 = 144;

/// Fields of a message.
pub fn message_fields(message: &Interface) -> Vec<Described> {
    message
        .fields
        .iter()
        .map(|field| {
            let (type_id, string_capacity, nested) = match &field.base {
                Base::Primitive(p) => (p.type_id(), 0, String::new()),
                Base::String(None) => (17, 0, String::new()),
                Base::String(Some(bound)) => (21, *bound, String::new()),
                Base::Nested(name) => (NESTED, 0, name.to_string()),
            };
            let (offset, capacity) = match field.count {
                Count::One => (0, 0),
                Count::Fixed(n) => (FIXED, n),
                Count::Bounded(n) => (BOUNDED, n),
                Count::Unbounded => (UNBOUNDED, 0),
            };
            let default = field.default.as_deref().map(|text| default_text(&field.base, text));
            Described {
                name: field.name.clone(),
                type_id: type_id + offset,
                capacity,
                string_capacity,
                nested,
                default: default.unwrap_or_default(),
            }
        })
        .collect()
}

fn default_text(base: &Base, written: &str) -> String {
    match base {
        Base::Primitive(Primitive::Bool) => {
            let yes = ["true", "True", "1"].contains(&written);
            if yes { "True" } else { "False" }.to_owned()
        }
        Base::Primitive(Primitive::Float32 | Primitive::Float64) => {
            written.parse::<f64>().map_or_else(|_| written.to_owned(), |x| format!("{x:?}"))
        }
        _ => written.trim_matches(['"', '\'']).to_owned(),
    }
}

/// Names of a service's request, response and event.
pub fn service_parts(service: &Name) -> [Name; 3] {
    ["_Request", "_Response", "_Event"]
        .map(|suffix| Name::new(&service.package, "srv", &format!("{}{suffix}", service.name)))
}

/// Fields of a service.
pub fn service_fields(service: &Name) -> Vec<Described> {
    let [request, response, event] = service_parts(service);
    vec![
        Described::nested("request_message", NESTED, 0, &request),
        Described::nested("response_message", NESTED, 0, &response),
        Described::nested("event_message", NESTED, 0, &event),
    ]
}

/// Fields of the event of service introspection.
pub fn event_fields(service: &Name) -> Vec<Described> {
    let [request, response, _] = service_parts(service);
    vec![
        Described::nested("info", NESTED, 0, &event_info()),
        Described::nested("request", NESTED + BOUNDED, 1, &request),
        Described::nested("response", NESTED + BOUNDED, 1, &response),
    ]
}

fn event_info() -> Name {
    Name::new("service_msgs", "msg", "ServiceEventInfo")
}

/// RIHS01 hash of a message, `RIHS01_` and 64 hexadecimal digits.
///
/// # Errors
/// A nested type has no file.
pub fn message_hash(set: &Interfaces, message: &Interface) -> Result<String, GenerateError> {
    let mut referenced = BTreeMap::new();
    for name in used(set, message)? {
        referenced.insert(name.to_string(), message_fields(set.get(&name)?));
    }
    Ok(hash(&message.name, &message_fields(message), &referenced))
}

/// RIHS01 hash of a service: request, response and the event of service introspection.
///
/// # Errors
/// A nested type has no file.
pub fn service_hash(set: &Interfaces, service: &Name) -> Result<String, GenerateError> {
    let [request, response, event] = service_parts(service);
    let mut referenced = BTreeMap::from([(event.to_string(), event_fields(service))]);
    for root in [request, response, event_info()] {
        let message = set.get(&root)?;
        referenced.insert(root.to_string(), message_fields(message));
        for name in used(set, message)? {
            referenced.insert(name.to_string(), message_fields(set.get(&name)?));
        }
    }
    Ok(hash(service, &service_fields(service), &referenced))
}

fn hash(
    name: &Name,
    fields: &[Described],
    referenced: &BTreeMap<String, Vec<Described>>,
) -> String {
    let description = |name: &str, fields: &[Described]| {
        let fields: Vec<String> = fields.iter().map(Described::json).collect();
        format!(r#"{{"type_name": "{name}", "fields": [{}]}}"#, fields.join(", "))
    };
    let referenced: Vec<String> = referenced.iter().map(|(n, f)| description(n, f)).collect();
    let json = format!(
        r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
        description(&name.to_string(), fields),
        referenced.join(", ")
    );
    let mut text = String::from("RIHS01_");
    for byte in Sha256::digest(json.as_bytes()) {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}
