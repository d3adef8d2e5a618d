//! Type description: the definition text of a bag's `ros2msg` schema, and the RIHS01 hash.
//!
//! REP-2016 defines the hash as SHA-256 over the JSON of
//! `type_description_interfaces/msg/TypeDescription` without default values.

use super::{
    GenerateError, Interfaces,
    parse::{Base, Count, Interface, Name},
};
use sha2::{Digest, Sha256};
use std::{collections::BTreeSet, fmt::Write};

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

/// RIHS01 hash of a message, `RIHS01_` and 64 hexadecimal digits.
///
/// # Errors
/// A nested type has no file.
pub fn message_hash(set: &Interfaces, message: &Interface) -> Result<String, GenerateError> {
    let fields = message_fields(message);
    let mut referenced = BTreeSet::new();
    for name in used(set, message)? {
        referenced.insert((name.to_string(), message_fields(set.get(&name)?)));
    }
    Ok(hash(&message.name.to_string(), &fields, &referenced))
}

/// RIHS01 hash of a service: request, response and the event of service introspection.
///
/// # Errors
/// A nested type has no file.
pub fn service_hash(set: &Interfaces, service: &Name) -> Result<String, GenerateError> {
    let part =
        |suffix: &str| Name::new(&service.package, "srv", &format!("{}{suffix}", service.name));
    let (request, response, event) = (part("_Request"), part("_Response"), part("_Event"));
    let info = Name::new("service_msgs", "msg", "ServiceEventInfo");
    let nested = |name: &str, type_id: u32, capacity: u32, of: &Name| {
        field_json(name, type_id, capacity, 0, &of.to_string())
    };
    let fields = [
        nested("request_message", 1, 0, &request),
        nested("response_message", 1, 0, &response),
        nested("event_message", 1, 0, &event),
    ]
    .join(", ");
    let event_fields = [
        nested("info", 1, 0, &info),
        nested("request", BOUNDED + 1, 1, &request),
        nested("response", BOUNDED + 1, 1, &response),
    ]
    .join(", ");
    let mut referenced = BTreeSet::from([(event.to_string(), event_fields)]);
    for root in [request, response, info] {
        let message = set.get(&root)?;
        referenced.insert((root.to_string(), message_fields(message)));
        for name in used(set, message)? {
            referenced.insert((name.to_string(), message_fields(set.get(&name)?)));
        }
    }
    Ok(hash(&service.to_string(), &fields, &referenced))
}

const FIXED: u32 = 48;
const BOUNDED: u32 = 96;
const UNBOUNDED: u32 = 144;

fn message_fields(message: &Interface) -> String {
    let fields: Vec<String> = message
        .fields
        .iter()
        .map(|field| {
            let (type_id, string_capacity, nested) = match &field.base {
                Base::Primitive(p) => (p.type_id(), 0, String::new()),
                Base::String(None) => (17, 0, String::new()),
                Base::String(Some(bound)) => (21, *bound, String::new()),
                Base::Nested(name) => (1, 0, name.to_string()),
            };
            let (offset, capacity) = match field.count {
                Count::One => (0, 0),
                Count::Fixed(n) => (FIXED, n),
                Count::Bounded(n) => (BOUNDED, n),
                Count::Unbounded => (UNBOUNDED, 0),
            };
            field_json(
                &field.name,
                type_id + offset,
                capacity as u32,
                string_capacity as u32,
                &nested,
            )
        })
        .collect();
    fields.join(", ")
}

// The hash covers these exact bytes: one space after each comma and colon, keys in this order.
fn field_json(
    name: &str,
    type_id: u32,
    capacity: u32,
    string_capacity: u32,
    nested: &str,
) -> String {
    let field_type = format!(
        r#"{{"type_id": {type_id}, "capacity": {capacity}, "string_capacity": {string_capacity}, "#
    ) + &format!(r#""nested_type_name": "{nested}"}}"#);
    format!(r#"{{"name": "{name}", "type": {field_type}}}"#)
}

fn hash(name: &str, fields: &str, referenced: &BTreeSet<(String, String)>) -> String {
    let description =
        |name: &str, fields: &str| format!(r#"{{"type_name": "{name}", "fields": [{fields}]}}"#);
    let referenced: Vec<String> = referenced.iter().map(|(n, f)| description(n, f)).collect();
    let json = format!(
        r#"{{"type_description": {}, "referenced_type_descriptions": [{}]}}"#,
        description(name, fields),
        referenced.join(", ")
    );
    let mut text = String::from("RIHS01_");
    for byte in Sha256::digest(json.as_bytes()) {
        // Writing to a string cannot fail.
        let _ = write!(text, "{byte:02x}");
    }
    text
}
