//! Parser of `.msg` text: lines `type name`, `type name default`, `type NAME=value`, `# comment`.

use std::fmt;

/// `package/kind/Name`, such as `std_msgs/msg/Header`.
#[derive(Clone, Debug, PartialEq)]
pub struct Name {
    /// ROS package.
    pub package: String,
    /// `msg` or `srv`.
    pub kind: String,
    /// Type name without package.
    pub name: String,
}

impl Name {
    /// Name from package, kind (`msg` or `srv`) and type.
    pub fn new(package: &str, kind: &str, name: &str) -> Self {
        Self { package: package.into(), kind: kind.into(), name: name.into() }
    }
}

impl fmt::Display for Name {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.package, self.kind, self.name)
    }
}

/// Element type of a field.
#[derive(Clone, Debug, PartialEq)]
pub enum Base {
    /// A number, `bool`, `byte` or `char`.
    Primitive(&'static Primitive),
    /// `string`, with its bound if it has one.
    String(Option<u64>),
    /// Another message.
    Nested(Name),
}

/// A primitive type.
#[derive(Debug, PartialEq)]
pub struct Primitive {
    ros: &'static str,
    /// The Rust type.
    pub rust: &'static str,
    /// `type_id` of `type_description_interfaces/msg/FieldType`.
    pub type_id: u32,
}

impl Primitive {
    /// Returns whether it is `float32` or `float64`.
    pub fn is_float(&self) -> bool {
        matches!(self.rust, "f32" | "f64")
    }
}

const fn primitive(ros: &'static str, rust: &'static str, type_id: u32) -> Primitive {
    Primitive { ros, rust, type_id }
}

static PRIMITIVES: [Primitive; 13] = [
    primitive("bool", "bool", 15),
    primitive("byte", "u8", 16),
    // ROS 2 defines `char` as uint8.
    primitive("char", "u8", 3),
    primitive("int8", "i8", 2),
    primitive("uint8", "u8", 3),
    primitive("int16", "i16", 4),
    primitive("uint16", "u16", 5),
    primitive("int32", "i32", 6),
    primitive("uint32", "u32", 7),
    primitive("int64", "i64", 8),
    primitive("uint64", "u64", 9),
    primitive("float32", "f32", 10),
    primitive("float64", "f64", 11),
];

/// Number of elements of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Count {
    /// One.
    One,
    /// `[n]`.
    Fixed(u64),
    /// `[<=n]`.
    Bounded(u64),
    /// `[]`.
    Unbounded,
}

/// A field.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// The type as written, for the documentation.
    pub written: String,
    /// Element type.
    pub base: Base,
    /// Element count.
    pub count: Count,
    /// Field name.
    pub name: String,
    /// Default value as written.
    pub default: Option<String>,
    /// Comment on the same line.
    pub comment: String,
}

/// A constant.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant {
    /// Type of the value.
    pub base: Base,
    /// Constant name.
    pub name: String,
    /// Value as written.
    pub value: String,
    /// Comment on the same line.
    pub comment: String,
}

/// One message.
#[derive(Clone, Debug, PartialEq)]
pub struct Interface {
    /// Full name.
    pub name: Name,
    /// Text of the file.
    pub text: String,
    /// Comment lines before the first field.
    pub comment: Vec<String>,
    /// Fields in order.
    pub fields: Vec<Field>,
    /// Constants in order.
    pub constants: Vec<Constant>,
}

impl Interface {
    /// Parses the text of a message, or of one half of a service; an error has line and reason.
    pub fn parse(name: Name, text: &str) -> Result<Self, String> {
        let mut message = Self {
            name,
            text: text.to_owned(),
            comment: vec![],
            fields: vec![],
            constants: vec![],
        };
        for (i, line) in text.lines().enumerate() {
            message.line(line).map_err(|e| format!("line {}: {e}", i + 1))?;
        }
        if message.fields.is_empty() {
            // C has no empty structs; ROS 2 adds this member, on the wire as well.
            let member = "uint8 structure_needs_at_least_one_member";
            message.line(&format!("{member} # added by ROS 2 to a message without fields"))?;
        }
        Ok(message)
    }

    fn line(&mut self, line: &str) -> Result<(), String> {
        let (code, comment) = split_comment(line);
        let code = code.trim();
        if code.is_empty() {
            if self.fields.is_empty() && self.constants.is_empty() && !comment.is_empty() {
                self.comment.push(comment.to_owned());
            }
            return Ok(());
        }
        let comment = comment.to_owned();
        let (written, rest) =
            code.split_once(char::is_whitespace).ok_or("a type without a name")?;
        let rest = rest.trim();
        let (base, count) = self.field_type(written)?;
        let name_end =
            rest.find(|c: char| !(c.is_ascii_alphanumeric() || c == '_')).unwrap_or(rest.len());
        let (name, after) = rest.split_at(name_end);
        if !name.starts_with(|c: char| c.is_ascii_alphabetic()) {
            return Err(format!("`{rest}` does not start with a name"));
        }
        let name = name.to_owned();
        let after = after.trim();
        if let Some(value) = after.strip_prefix('=') {
            if count != Count::One || matches!(base, Base::Nested(_)) {
                return Err(format!("constant `{name}` is neither a number, a bool nor a string"));
            }
            let value = unquoted(value.trim()).to_owned();
            self.constants.push(Constant { base, name, value, comment });
        } else {
            let default = (!after.is_empty()).then(|| unquoted(after).to_owned());
            if default.is_some() && count != Count::One {
                return Err(format!("`{name}`: a default for a list is not supported"));
            }
            self.fields.push(Field {
                written: written.into(),
                base,
                count,
                name,
                default,
                comment,
            });
        }
        Ok(())
    }

    fn field_type(&self, written: &str) -> Result<(Base, Count), String> {
        let bad = || format!("`{written}` is not a type");
        let (base, count) = match written.strip_suffix(']') {
            None => (written, Count::One),
            Some(open) => {
                let (base, count) = open.rsplit_once('[').ok_or_else(bad)?;
                let count = match (count, count.strip_prefix("<=")) {
                    ("", _) => Count::Unbounded,
                    (_, Some(n)) => Count::Bounded(n.parse().map_err(|_| bad())?),
                    (n, None) => Count::Fixed(n.parse().map_err(|_| bad())?),
                };
                (base, count)
            }
        };
        let base = if let Some(primitive) = PRIMITIVES.iter().find(|p| p.ros == base) {
            Base::Primitive(primitive)
        } else if base == "string" {
            Base::String(None)
        } else if let Some(bound) = base.strip_prefix("string<=") {
            Base::String(Some(bound.parse().map_err(|_| bad())?))
        } else {
            let mut parts = base.split('/');
            let name = match (parts.next(), parts.next(), parts.next(), parts.next()) {
                (Some(name), None, None, None) => Name::new(&self.name.package, "msg", name),
                (Some(package), Some(name), None, None) => Name::new(package, "msg", name),
                (Some(package), Some(kind), Some(name), None) => Name::new(package, kind, name),
                _ => return Err(bad()),
            };
            if !name.name.starts_with(|c: char| c.is_ascii_uppercase()) {
                return Err(bad());
            }
            Base::Nested(name)
        };
        Ok((base, count))
    }
}

/// Splits a line at the first `#` outside quotes into code and comment.
fn split_comment(line: &str) -> (&str, &str) {
    let mut quote = None;
    for (i, c) in line.char_indices() {
        match (quote, c) {
            (None, '#') => return (&line[..i], line[i + 1..].trim()),
            (None, '"' | '\'') => quote = Some(c),
            (Some(q), c) if c == q => quote = None,
            _ => {}
        }
    }
    (line, "")
}

fn unquoted(value: &str) -> &str {
    for quote in ['"', '\''] {
        if let Some(inner) = value.strip_prefix(quote).and_then(|v| v.strip_suffix(quote)) {
            return inner;
        }
    }
    value
}
