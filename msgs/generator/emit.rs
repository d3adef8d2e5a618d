//! Generates the Rust source: one module per package, one struct per message, with its CDR
//! implementation and type description.

use super::{
    Interfaces, OWN_PACKAGE,
    describe::{self, Types},
    parse::{Base, Constant, Count, Field, Interface, Name},
};
use std::collections::{BTreeMap, BTreeSet};

/// Source of all types, to be included at the crate root.
///
/// # Errors
/// An interface uses an unknown type, or a constant or default does not fit its type.
pub fn rust_source(set: &Interfaces) -> Result<String, String> {
    let types = describe::types(set);
    let mut out = String::new();
    let packages: BTreeSet<&str> = set.messages.values().map(|m| &*m.name.package).collect();
    for package in packages {
        let own = package == OWN_PACKAGE;
        if !own {
            doc(&mut out, &format!("Types of the ROS package `{package}`."));
            out += &format!("pub mod {package} {{\n");
        }
        for (kind, what) in [("msg", "Messages"), ("srv", "Services")] {
            let is_here = |name: &Name| name.package == package && name.kind == kind;
            let mut messages = set.messages.values().filter(|m| is_here(&m.name)).peekable();
            if messages.peek().is_none() {
                continue;
            }
            doc(&mut out, &format!("{what} of the ROS package `{package}`."));
            out += &format!("pub mod {kind} {{\n");
            for message in messages {
                emit_message(&mut out, set, &types, message)?;
            }
            for service in set.services.iter().filter(|&s| is_here(s)) {
                emit_service(&mut out, service, &describe::hash(&types, &service.to_string())?);
            }
            out += "}\n";
        }
        if !own {
            out += "}\n";
        }
    }
    emit_registry(&mut out, set);
    emit_descriptions(&mut out, set, &types)?;
    Ok(out)
}

fn doc(out: &mut String, text: &str) {
    *out += &format!("#[doc = {text:?}]\n");
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

fn field_type(field: &Field) -> String {
    let element = match &field.base {
        Base::Primitive(p) => p.rust.to_owned(),
        Base::String(_) => "::std::string::String".to_owned(),
        Base::Nested(name) => rust_path(name),
    };
    match field.count {
        Count::One => element,
        Count::Fixed(n) => format!("[{element}; {n}]"),
        Count::Bounded(_) | Count::Unbounded => format!("::std::vec::Vec<{element}>"),
    }
}

fn serde_attribute(field: &Field) -> String {
    let bytes = matches!(&field.base, Base::Primitive(p) if p.rust == "u8");
    match field.count {
        // Same bytes on the wire; serializing element by element is 100 times slower.
        Count::Bounded(_) | Count::Unbounded if bytes => {
            "#[serde(with = \"serde_bytes\")]".to_owned()
        }
        Count::Bounded(n) => {
            format!("#[serde(deserialize_with = \"crate::cdr::bounded::<_, _, {n}>\")]")
        }
        // Serde implements arrays up to 32 elements.
        Count::Fixed(n) if n > 32 => "#[serde(with = \"serde_big_array::BigArray\")]".to_owned(),
        _ => String::new(),
    }
}

fn literal(base: &Base, value: &str, place: &Name) -> Result<String, String> {
    let wrong = || format!("{place}: `{value}` does not fit the type of its field or constant");
    Ok(match base {
        Base::Nested(_) => return Err(wrong()),
        Base::String(_) => format!("{value:?}"),
        Base::Primitive(p) if p.rust == "bool" => match value {
            "true" | "True" | "1" => "true".into(),
            "false" | "False" | "0" => "false".into(),
            _ => return Err(wrong()),
        },
        Base::Primitive(p) if p.is_float() => {
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

fn default_value(field: &Field, place: &Name) -> Result<String, String> {
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
    types: &Types,
    message: &Interface,
) -> Result<(), String> {
    let ros = &message.name;
    let name = rust_name(ros);
    doc(out, &format!("`{ros}`"));
    if !message.comment.is_empty() {
        doc(out, "");
        message.comment.iter().for_each(|l| doc(out, l));
    }
    *out += "#[derive(Clone, Debug, PartialEq, ::serde::Serialize, ::serde::Deserialize)]\n";
    *out += &format!("pub struct {name} {{\n");
    let mut defaults = String::new();
    for field in &message.fields {
        let about =
            if field.comment.is_empty() { String::new() } else { format!(": {}", field.comment) };
        doc(out, &format!("`{}`{about}", field.written));
        let (attribute, name) = (serde_attribute(field), field_name(&field.name));
        *out += &format!("{attribute} pub {name}: {},\n", field_type(field));
        defaults += &format!("{name}: {}, ", default_value(field, ros)?);
    }
    *out += "}\n";
    emit_constants(out, message, &name)?;
    let definition = describe::definition(set, types, message)?;
    let hash = describe::hash(types, &ros.to_string())?;
    // Not derived: a derive supports neither the defaults of the definition nor arrays beyond 32.
    *out += &format!(
        "#[allow(clippy::derivable_impls)]
impl ::std::default::Default for {name} {{
    fn default() -> Self {{ Self {{ {defaults} }} }}
}}
impl crate::Message for {name} {{
    const TYPE_NAME: &'static str = \"{ros}\";
    const DEFINITION: &'static str = {definition:?};
    const RIHS01_HASH: &'static str = \"{hash}\";
}}
"
    );
    Ok(())
}

fn emit_constants(out: &mut String, message: &Interface, name: &str) -> Result<(), String> {
    if message.constants.is_empty() {
        return Ok(());
    }
    *out += &format!("impl {name} {{\n");
    for Constant { base, name, value, comment } in &message.constants {
        let rust = match base {
            Base::Primitive(p) => p.rust,
            _ => "&'static str",
        };
        doc(out, if comment.is_empty() { "A constant of the message." } else { comment });
        let value = literal(base, value, &message.name)?;
        *out += &format!("pub const {name}: {rust} = {value};\n");
    }
    *out += "}\n";
    Ok(())
}

fn emit_service(out: &mut String, service: &Name, hash: &str) {
    let name = rust_name(service);
    *out += &format!(
        "#[doc = \"`{service}`\"]
#[derive(Clone, Copy, Debug)]
pub struct {name};
impl crate::Service for {name} {{
    type Request = {name}Request;
    type Response = {name}Response;
    const TYPE_NAME: &'static str = \"{service}\";
    const RIHS01_HASH: &'static str = \"{hash}\";
}}
"
    );
}

fn emit_registry(out: &mut String, set: &Interfaces) {
    let names = set.messages.values().map(|m| &m.name);
    let messages = names.clone().filter(|n| n.kind == "msg");
    let messages: String =
        messages.map(|n| format!("crate::MessageInfo::of::<{}>(), ", rust_path(n))).collect();
    let types = names.map(|n| rust_path(n).replacen("crate::", "$crate::", 1) + ", ");
    let types: String = types.collect();
    let constants = |path: String| {
        let service = format!("<{path} as crate::Service>");
        format!("({service}::TYPE_NAME, {service}::RIHS01_HASH), ")
    };
    let services: String = set.services.iter().map(|n| constants(rust_path(n))).collect();
    *out += &format!(
        "#[doc = \"All built-in messages, sorted by name.\"]
pub static MESSAGES: &[crate::MessageInfo] = &[{messages}];
#[doc = \"Calls a macro with the paths of all types, requests and responses included.\"]
#[macro_export]
macro_rules! for_each_type {{ ($call:ident) => {{ $call! {{ {types} }} }} }}
#[doc = \"Name and RIHS01 hash of all built-in services, sorted by name.\"]
pub static SERVICES: &[(&str, &str)] = &[{services}];
"
    );
}

/// The fields, nested types and text of every type, sorted by name.
fn emit_descriptions(out: &mut String, set: &Interfaces, types: &Types) -> Result<(), String> {
    let messages = set.messages.iter().filter(|(_, m)| m.name.kind == "msg");
    let mut sources: BTreeMap<String, (&str, String)> =
        messages.map(|(name, m)| (name.clone(), ("msg", m.text.clone()))).collect();
    for service in &set.services {
        let [request, response, _] = describe::service_parts(service);
        let half =
            |name: &Name| set.messages.get(&name.to_string()).map_or("", |m| m.text.as_str());
        let text = format!("{}---\n{}", half(&request), half(&response));
        sources.insert(service.to_string(), ("srv", text));
    }
    doc(out, "Fields, nested types and text of all built-in types, sorted by name.");
    *out += "pub(crate) static TYPES: &[crate::description::Type] = &[\n";
    for (name, fields) in types {
        // Requests, responses and events have no file; rosidl describes them so.
        let implicit = ("implicit", String::new());
        let (encoding, text) = sources.remove(name).unwrap_or(implicit);
        *out += &format!("crate::description::Type {{ name: {name:?}, fields: &[\n");
        for field in fields {
            let describe::Field { name, type_id, capacity, string_capacity, nested, default } =
                field;
            *out += &format!(
                "crate::description::Field {{ name: {name:?}, type_id: {type_id}, capacity: \
                 {capacity}, string_capacity: {string_capacity}, nested: {nested:?}, default: \
                 {default:?} }},\n"
            );
        }
        let nested = describe::nested(types, name)?;
        *out += &format!("], nested: &{nested:?}, encoding: {encoding:?}, text: {text:?} }},\n");
    }
    *out += "];\n";
    Ok(())
}
