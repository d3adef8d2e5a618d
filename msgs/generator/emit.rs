//! Generates the Rust source: one module per package, one struct per message, with its CDR
//! implementation and type description.

use super::{
    GenerateError, Interfaces, OWN_PACKAGE, describe,
    parse::{Base, Constant, Count, Field, Interface, Name, Primitive},
};
use std::collections::{BTreeMap, BTreeSet};

/// Source of all types, to be included at the crate root.
///
/// # Errors
/// An interface uses an unknown type, or a constant or default does not fit its type.
pub fn rust_source(set: &Interfaces) -> Result<String, GenerateError> {
    let mut out = String::new();
    let packages: BTreeSet<&str> = set.messages.keys().map(|n| n.package.as_str()).collect();
    for package in packages {
        let own = package == OWN_PACKAGE;
        if !own {
            line(&mut out, format!("#[doc = \"Types of the ROS package `{package}`.\"]"));
            line(&mut out, format!("pub mod {package} {{"));
        }
        for kind in ["msg", "srv"] {
            let messages: Vec<&Interface> = set
                .messages
                .values()
                .filter(|m| m.name.package == package && m.name.kind == kind)
                .collect();
            if messages.is_empty() {
                continue;
            }
            let what = if kind == "msg" { "Messages" } else { "Services" };
            line(&mut out, format!("#[doc = \"{what} of the ROS package `{package}`.\"]"));
            line(&mut out, format!("pub mod {kind} {{"));
            for message in messages {
                emit_message(&mut out, set, message)?;
            }
            for service in set.services.iter().filter(|s| kind == "srv" && s.package == package) {
                emit_service(&mut out, set, service)?;
            }
            line(&mut out, "}");
        }
        if !own {
            line(&mut out, "}");
        }
    }
    emit_registry(&mut out, set);
    Ok(out)
}

fn line(out: &mut String, text: impl AsRef<str>) {
    out.push_str(text.as_ref());
    out.push('\n');
}

fn doc(out: &mut String, text: &str) {
    line(out, format!("#[doc = {text:?}]"));
}

/// `GetParameters_Request` → `GetParametersRequest`.
fn rust_name(name: &Name) -> String {
    name.name.replace('_', "")
}

fn rust_path(name: &Name) -> String {
    if name.package == OWN_PACKAGE {
        format!("crate::{}::{}", name.kind, rust_name(name))
    } else {
        format!("crate::{}::{}::{}", name.package, name.kind, rust_name(name))
    }
}

fn field_name(name: &str) -> String {
    const KEYWORDS: [&str; 12] =
        ["type", "ref", "match", "move", "fn", "in", "loop", "use", "mod", "where", "impl", "dyn"];
    if KEYWORDS.contains(&name) { format!("r#{name}") } else { name.to_owned() }
}

fn element_type(base: &Base) -> String {
    match base {
        Base::Primitive(p) => p.rust().to_owned(),
        Base::String(_) => "::std::string::String".to_owned(),
        Base::Nested(name) => rust_path(name),
    }
}

fn field_type(field: &Field) -> String {
    let element = element_type(&field.base);
    match field.count {
        Count::One => element,
        Count::Fixed(n) => format!("[{element}; {n}]"),
        Count::Bounded(_) | Count::Unbounded => format!("::std::vec::Vec<{element}>"),
    }
}

fn serde_attribute(field: &Field) -> Option<String> {
    let bytes = matches!(&field.base, Base::Primitive(p) if p.rust() == "u8");
    match field.count {
        // Same bytes on the wire; serializing element by element is 100 times slower.
        Count::Bounded(_) | Count::Unbounded if bytes => {
            Some("#[serde(with = \"serde_bytes\")]".to_owned())
        }
        Count::Bounded(n) => {
            Some(format!("#[serde(deserialize_with = \"crate::cdr::bounded::<_, _, {n}>\")]"))
        }
        // Serde implements arrays up to 32 elements.
        Count::Fixed(n) if n > 32 => {
            Some("#[serde(with = \"serde_big_array::BigArray\")]".to_owned())
        }
        _ => None,
    }
}

fn literal(base: &Base, value: &str, place: &Name) -> Result<String, GenerateError> {
    let wrong = || GenerateError {
        place: place.to_string(),
        message: format!("`{value}` does not fit the type of its field or constant"),
    };
    Ok(match base {
        Base::Nested(_) => return Err(wrong()),
        Base::String(_) => format!("{value:?}"),
        Base::Primitive(Primitive::Bool) => match value {
            "true" | "True" | "1" => "true".into(),
            "false" | "False" | "0" => "false".into(),
            _ => return Err(wrong()),
        },
        Base::Primitive(Primitive::Float32 | Primitive::Float64) => {
            let number: f64 = value.parse().map_err(|_| wrong())?;
            format!("{number:?}")
        }
        Base::Primitive(_) => {
            let number: i128 = match value.strip_prefix("0x") {
                Some(hex) => i128::from_str_radix(hex, 16).map_err(|_| wrong())?,
                None => value.parse().map_err(|_| wrong())?,
            };
            number.to_string()
        }
    })
}

fn default_value(field: &Field, place: &Name) -> Result<String, GenerateError> {
    Ok(match (&field.default, field.count, &field.base) {
        (Some(value), _, Base::String(_)) => {
            format!("{}.into()", literal(&field.base, value, place)?)
        }
        (Some(value), _, base) => literal(base, value, place)?,
        (None, Count::Fixed(_), _) => {
            "::std::array::from_fn(|_| ::std::default::Default::default())".into()
        }
        (None, _, _) => "::std::default::Default::default()".into(),
    })
}

fn emit_message(
    out: &mut String,
    set: &Interfaces,
    message: &Interface,
) -> Result<(), GenerateError> {
    let name = rust_name(&message.name);
    doc(out, &format!("`{}`", message.name));
    if !message.comment.is_empty() {
        doc(out, "");
        message.comment.iter().for_each(|l| doc(out, l));
    }
    line(out, "#[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]");
    line(out, format!("pub struct {name} {{"));
    for field in &message.fields {
        let about =
            if field.comment.is_empty() { String::new() } else { format!(": {}", field.comment) };
        doc(out, &format!("`{}`{about}", field.written));
        if let Some(attribute) = serde_attribute(field) {
            line(out, attribute);
        }
        line(out, format!("pub {}: {},", field_name(&field.name), field_type(field)));
    }
    line(out, "}");
    emit_constants(out, message, &name)?;

    // Not derived: a derive supports neither the defaults of the definition nor arrays beyond 32.
    line(out, "#[allow(clippy::derivable_impls)]");
    line(
        out,
        format!("impl ::std::default::Default for {name} {{ fn default() -> Self {{ Self {{"),
    );
    for field in &message.fields {
        line(
            out,
            format!("{}: {},", field_name(&field.name), default_value(field, &message.name)?),
        );
    }
    line(out, "} } }");

    let ros = &message.name;
    line(out, format!("impl crate::Message for {name} {{"));
    line(out, format!("const TYPE_NAME: &'static str = \"{ros}\";"));
    line(
        out,
        format!("const DEFINITION: &'static str = {:?};", describe::definition(set, message)?),
    );
    line(
        out,
        format!("const RIHS01_HASH: &'static str = {:?};", describe::message_hash(set, message)?),
    );
    line(out, "}");
    Ok(())
}

fn emit_constants(out: &mut String, message: &Interface, name: &str) -> Result<(), GenerateError> {
    if message.constants.is_empty() {
        return Ok(());
    }
    line(out, format!("impl {name} {{"));
    for Constant { base, name, value, comment } in &message.constants {
        let rust = match base {
            Base::Primitive(p) => p.rust(),
            _ => "&'static str",
        };
        doc(out, if comment.is_empty() { "A constant of the message." } else { comment });
        line(out, format!("pub const {name}: {rust} = {};", literal(base, value, &message.name)?));
    }
    line(out, "}");
    Ok(())
}

fn emit_service(out: &mut String, set: &Interfaces, service: &Name) -> Result<(), GenerateError> {
    let name = rust_name(service);
    doc(out, &format!("`{service}`"));
    line(out, "#[derive(Clone, Copy, Debug)]");
    line(out, format!("pub struct {name};"));
    line(out, format!("impl crate::Service for {name} {{"));
    line(out, format!("type Request = {name}Request;"));
    line(out, format!("type Response = {name}Response;"));
    line(out, format!("const TYPE_NAME: &'static str = \"{service}\";"));
    line(
        out,
        format!("const RIHS01_HASH: &'static str = {:?};", describe::service_hash(set, service)?),
    );
    line(out, "}");
    Ok(())
}

fn emit_registry(out: &mut String, set: &Interfaces) {
    let messages: Vec<&Name> = set.messages.keys().filter(|n| n.kind == "msg").collect();
    doc(out, "All built-in messages, sorted by name.");
    line(out, "pub static MESSAGES: &[crate::MessageInfo] = &[");
    for name in messages {
        line(out, format!("crate::MessageInfo::of::<{}>(),", rust_path(name)));
    }
    line(out, "];");
    doc(out, "Calls a macro with the paths of all types, requests and responses included.");
    line(out, "#[macro_export]");
    line(out, "macro_rules! for_each_type { ($call:ident) => { $call! {");
    for name in set.messages.keys() {
        line(out, format!("{},", rust_path(name).replacen("crate::", "$crate::", 1)));
    }
    line(out, "} } }");
    doc(out, "Name and RIHS01 hash of all built-in services, sorted by name.");
    line(out, "pub static SERVICES: &[(&str, &str)] = &[");
    for name in &set.services {
        let path = rust_path(name);
        line(
            out,
            format!(
                "(<{path} as crate::Service>::TYPE_NAME, <{path} as crate::Service>::RIHS01_HASH),"
            ),
        );
    }
    line(out, "];");
    emit_descriptions(out, set);
}

/// The fields and text of every type, sorted by name.
fn emit_descriptions(out: &mut String, set: &Interfaces) {
    let mut all = BTreeMap::new();
    for (name, message) in &set.messages {
        // The two halves of a service have no file of their own.
        let source = if name.kind == "msg" { ("msg", message.text.clone()) } else { IMPLICIT };
        all.insert(name.to_string(), (describe::message_fields(message), source));
    }
    for service in &set.services {
        let [request, response, event] = describe::service_parts(service);
        let half = |name| set.messages.get(name).map_or("", |m| m.text.as_str());
        let text = format!("{}---\n{}", half(&request), half(&response));
        all.insert(service.to_string(), (describe::service_fields(service), ("srv", text)));
        all.insert(event.to_string(), (describe::event_fields(service), IMPLICIT));
    }
    doc(out, "Fields and text of all built-in types, sorted by name.");
    line(out, "pub(crate) static TYPES: &[crate::description::Type] = &[");
    for (name, (fields, (encoding, text))) in all {
        line(out, format!("crate::description::Type {{ name: {name:?}, fields: &["));
        for field in fields {
            line(
                out,
                format!(
                    "crate::description::Field {{ name: {:?}, type_id: {}, capacity: {}, \
                     string_capacity: {}, nested: {:?}, default: {:?} }},",
                    field.name,
                    field.type_id,
                    field.capacity,
                    field.string_capacity,
                    field.nested,
                    field.default
                ),
            );
        }
        line(out, format!("], encoding: {encoding:?}, text: {text:?} }},"));
    }
    line(out, "];");
}

/// Encoding and text of a type without a file, as rosidl has it.
const IMPLICIT: (&str, String) = ("implicit", String::new());
