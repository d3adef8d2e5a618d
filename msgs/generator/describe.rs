//! Type description: the definition text of a bag's `ros2msg` schema, the fields that
//! `~/get_type_description` reports, and the RIHS01 hash.
//!
//! REP-2016 defines the hash as SHA-256 over the JSON of
//! `type_description_interfaces/msg/TypeDescription` without default values.

use super::{
    Interfaces,
    parse::{Base, Count, Interface, Name},
};
use sha2::{Digest, Sha256};
use std::{collections::BTreeMap, fmt::Write};

/// Adds the names of all types nested in a type to `found`, depth first.
fn find_nested<'t>(types: &'t Types, name: &str, found: &mut Vec<&'t str>) -> Result<(), String> {
    for Field { nested, .. } in fields(types, name)? {
        if !nested.is_empty() && !found.contains(&nested.as_str()) {
            found.push(nested);
            find_nested(types, nested, found)?;
        }
    }
    Ok(())
}

/// Names of all types nested in a type, sorted.
pub fn nested<'t>(types: &'t Types, name: &str) -> Result<Vec<&'t str>, String> {
    let mut found = vec![];
    find_nested(types, name, &mut found)?;
    found.sort_unstable();
    Ok(found)
}

/// Definition text: the message, then each nested message after a line of 80 `=` and a line
/// `MSG: package/Name`.
pub fn definition(set: &Interfaces, types: &Types, message: &Interface) -> Result<String, String> {
    let mut text = message.text.trim_end().to_owned() + "\n";
    let mut nested = vec![];
    find_nested(types, &message.name.to_string(), &mut nested)?;
    for Interface { name, text: own, .. } in nested.iter().filter_map(|n| set.messages.get(*n)) {
        let rule = "=".repeat(80);
        text += &format!("{rule}\nMSG: {}/{}\n{}\n", name.package, name.name, own.trim_end());
    }
    Ok(text)
}

/// A field as `type_description_interfaces/msg/Field` describes it.
#[derive(Debug)]
pub struct Field {
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

impl Field {
    fn nested(name: &str, type_id: u32, capacity: u64, nested: &str) -> Self {
        let (name, nested) = (name.to_owned(), nested.to_owned());
        Self { name, type_id, capacity, string_capacity: 0, nested, default: String::new() }
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

/// Fields of every type by full name: of messages, services and the events of services.
pub type Types = BTreeMap<String, Vec<Field>>;

/// Describes all types.
pub fn types(set: &Interfaces) -> Types {
    let messages = set.messages.iter();
    let mut all: Types = messages.map(|(n, m)| (n.clone(), message_fields(m))).collect();
    for service in &set.services {
        let [request, response, event] = service_parts(service).map(|name| name.to_string());
        let one = |name: &str, nested: &str| Field::nested(name, NESTED, 0, nested);
        let optional = |name: &str, nested: &str| Field::nested(name, NESTED + BOUNDED, 1, nested);
        all.insert(
            service.to_string(),
            vec![
                one("request_message", &request),
                one("response_message", &response),
                one("event_message", &event),
            ],
        );
        all.insert(
            event,
            vec![
                one("info", "service_msgs/msg/ServiceEventInfo"),
                optional("request", &request),
                optional("response", &response),
            ],
        );
    }
    all
}

fn message_fields(message: &Interface) -> Vec<Field> {
    message
        .fields
        .iter()
        .map(|field| {
            let (type_id, string_capacity, nested) = match &field.base {
                Base::Primitive(p) => (p.type_id, 0, String::new()),
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
            Field {
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
        Base::Primitive(p) if p.rust == "bool" => {
            let yes = ["true", "True", "1"].contains(&written);
            if yes { "True" } else { "False" }.to_owned()
        }
        Base::Primitive(p) if p.is_float() => {
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

/// RIHS01 hash of a message or service, `RIHS01_` and 64 hexadecimal digits.
pub fn hash(types: &Types, name: &str) -> Result<String, String> {
    let description = |name: &str| -> Result<String, String> {
        let fields: Vec<String> = fields(types, name)?.iter().map(Field::json).collect();
        Ok(format!(r#"{{"type_name": "{name}", "fields": [{}]}}"#, fields.join(", ")))
    };
    let referenced: Result<Vec<String>, String> =
        nested(types, name)?.into_iter().map(&description).collect();
    let json = format!(
        r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
        description(name)?,
        referenced?.join(", ")
    );
    let mut text = String::from("RIHS01_");
    for byte in Sha256::digest(json.as_bytes()) {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    Ok(text)
}

fn fields<'t>(types: &'t Types, name: &str) -> Result<&'t [Field], String> {
    let unknown = || format!("{name}: is used by another interface, but there is no file for it");
    types.get(name).map(Vec::as_slice).ok_or_else(unknown)
}
