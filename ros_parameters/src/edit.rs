//! Changes single values in the text of a parameter file; every other byte stays as it is.
//!
//! A value is replaced where it is written, in the style (flow or block) of the file. A missing key
//! is added below the deepest block of its name that exists. Each edit is checked: the new text
//! must parse to the old parameters with that one changed.

use crate::file::{ParameterFile, ParameterFileError, ParameterMap, ParameterValue, parse_yaml};
use saphyr_parser::{Event, Parser, Span};
use serde_yaml_ng::{Mapping, Value};
use std::ops::Range;

/// Sets the parameter `name` (`camera.position`) of a node (`/climber_driver`) to `value`.
///
/// The value is replaced in the block from which the node takes it, else added to the most specific
/// block that matches the node, else to a new block `node` at the end of the file. The name `/**`
/// means every node, and `/**/node` that node whatever its namespace. A text without any block is a
/// valid start.
///
/// # Errors
/// The text is not a parameter file, or its form does not allow an edit that changes nothing else.
pub fn set(
    text: &str,
    node: &str,
    name: &str,
    value: &ParameterValue,
) -> Result<String, ParameterFileError> {
    let root = parse(text)?;
    let before = match &root {
        Some(root) if !root.is_null() => ParameterFile::parse(text)?,
        _ => ParameterFile::default(),
    };
    let written = value.to_yaml();
    let form = || not_editable(name, &written);
    let selector = before.selector_of(node, name).unwrap_or_else(|| node.to_owned());
    let edit = Edit { text, newline: if text.contains("\r\n") { "\r\n" } else { "\n" } };
    let path = format!("{selector}\nros__parameters\n{name}");
    let known = before.selectors().any(|known| known == selector);
    let edited = match &root {
        Some(root) if !root.is_null() => match &root.content {
            // Not below the block `/**`, whose name begins as that of `/**/node`.
            Content::Mapping(blocks) if !known && selector.contains('*') => {
                edit.added(root, blocks, &path, &written)
            }
            _ => edit.set(root, &path, &written),
        }
        .ok_or_else(form)?,
        _ => edit.with_lines(text.len(), 0, &path, &written),
    };
    let mut expected = before;
    expected.insert(&selector, name, value.clone());
    // As text: NaN is not equal to itself.
    let same = |after: ParameterFile| format!("{after:?}") == format!("{expected:?}");
    if ParameterFile::parse(&edited).is_ok_and(same) { Ok(edited) } else { Err(form()) }
}

/// Sets an entry of any YAML file, by the keys that lead to it: `camera_matrix`, `data`.
///
/// # Errors
/// As [`set`].
pub fn set_entry(
    text: &str,
    keys: &[&str],
    value: &ParameterValue,
) -> Result<String, ParameterFileError> {
    let written = value.to_yaml();
    let form = || not_editable(&keys.join("."), &written);
    let edit = Edit { text, newline: if text.contains("\r\n") { "\r\n" } else { "\n" } };
    let root = parse(text)?.ok_or_else(form)?;
    let edited = edit.set(&root, &keys.join("\n"), &written).ok_or_else(form)?;
    let mut expected = parse_yaml(text)?;
    let mut entry = &mut expected;
    for key in keys {
        let Some(mapping) = entry.as_mapping_mut() else { return Err(form()) };
        entry = mapping.entry((*key).into()).or_insert(Value::Mapping(Mapping::new()));
    }
    *entry = parse_yaml(&written)?;
    if parse_yaml(&edited).is_ok_and(|t| t == expected) { Ok(edited) } else { Err(form()) }
}

fn not_editable(key: &str, value: &str) -> ParameterFileError {
    ParameterFileError(format!(
        "`{key}` is written in a form that cannot be edited in place (an alias, an anchor or a \
         scalar in place of a block); enter `{key}: {value}` by hand"
    ))
}

impl ParameterFile {
    /// Selector of the block from which a node takes a parameter, or of the one to add it to: the
    /// node's own, not one of all nodes, unless `node` means all.
    fn selector_of(&self, node: &str, name: &str) -> Option<String> {
        let blocks = self.matching(node);
        let own = |selector: &str| !selector.ends_with('*') || node.ends_with('*');
        let holder = blocks.iter().rfind(|(_, map)| map.contains_key(name));
        let block = holder.or_else(|| blocks.iter().rfind(|(selector, _)| own(selector)))?;
        Some(block.0.clone())
    }

    fn insert(&mut self, selector: &str, name: &str, value: ParameterValue) {
        match self.blocks.iter_mut().find(|(s, _)| s == selector) {
            Some((_, map)) => drop(map.insert(name.to_owned(), value)),
            None => self
                .blocks
                .push((selector.to_owned(), ParameterMap::from([(name.to_owned(), value)]))),
        }
    }
}

impl ParameterValue {
    /// Formats the value as flow-style YAML; a text is quoted where YAML could misread it.
    pub fn to_yaml(&self) -> String {
        let double = |x: f64| match x {
            _ if x.is_nan() => ".nan".to_owned(),
            _ if x.is_infinite() => format!("{}.inf", if x < 0.0 { "-" } else { "" }),
            _ => format!("{x:?}"),
        };
        // JSON's escapes are a part of YAML's.
        let quoted = |s: &String| {
            let escaped = s.chars().map(|c| match c {
                '"' | '\\' => format!("\\{c}"),
                c if c.is_control() => format!("\\u{:04x}", u32::from(c)),
                c => c.to_string(),
            });
            format!("\"{}\"", escaped.collect::<String>())
        };
        let list = |items: Vec<String>| format!("[{}]", items.join(", "));
        match self {
            Self::Bool(x) => x.to_string(),
            Self::Integer(x) => x.to_string(),
            Self::Double(x) => double(*x),
            Self::String(s) => {
                let plain = s.starts_with(|c: char| c.is_ascii_alphabetic())
                    && s.chars().all(|c| c.is_ascii_alphanumeric() || "_-/.".contains(c))
                    && crate::parse_value("", s).is_ok_and(|v| v == *self);
                if plain { s.clone() } else { quoted(s) }
            }
            Self::BoolArray(a) => list(a.iter().map(bool::to_string).collect()),
            Self::IntegerArray(a) => list(a.iter().map(i64::to_string).collect()),
            Self::DoubleArray(a) => list(a.iter().copied().map(double).collect()),
            Self::StringArray(a) => list(a.iter().map(quoted).collect()),
        }
    }
}

/// A node of the YAML tree with its place in the text, bytes.
#[derive(Debug)]
struct Node {
    place: Range<usize>,
    content: Content,
}

#[derive(Debug)]
enum Content {
    Scalar(String),
    Alias,
    Sequence(Vec<Node>),
    Mapping(Vec<(Node, Node)>),
}

impl Node {
    fn is_null(&self) -> bool {
        matches!(&self.content, Content::Scalar(s) if s.is_empty() && self.place.is_empty())
    }

    /// End of the node's last character; `before`, the end of its key, where it has none.
    fn end(&self, text: &str, before: usize) -> usize {
        match &self.content {
            _ if self.is_null() => before,
            _ if is_flow(text, self) => self.place.end,
            Content::Sequence(items) => items.last().map_or(before, |i| i.end(text, before)),
            Content::Mapping(entries) => {
                entries.last().map_or(before, |(k, v)| v.end(text, k.place.end))
            }
            _ => self.place.end,
        }
    }
}

fn is_flow(text: &str, node: &Node) -> bool {
    text[node.place.start..].starts_with(['{', '['])
}

/// Tree of the first document; `None` for an empty text.
fn parse(text: &str) -> Result<Option<Node>, ParameterFileError> {
    // The parser counts characters.
    let bytes: Vec<usize> = text.char_indices().map(|(i, _)| i).chain([text.len()]).collect();
    let place = |span: Span| {
        let at = |i: usize| bytes.get(i).copied().unwrap_or(text.len());
        at(span.start.index())..at(span.end.index())
    };
    let mut open: Vec<Node> = vec![];
    let mut root = None;
    for event in Parser::new_from_str(text) {
        let (event, span) =
            event.map_err(|e| ParameterFileError(format!("not a YAML file: {e}")))?;
        let place = place(span);
        let node = |content| Node { place: place.clone(), content };
        let done = match event {
            Event::Scalar(value, ..) => node(Content::Scalar(value.into_owned())),
            Event::Alias(_) => node(Content::Alias),
            Event::SequenceStart(..) | Event::MappingStart(..) => {
                open.push(node(Content::Sequence(vec![])));
                continue;
            }
            Event::SequenceEnd | Event::MappingEnd => {
                let Some(mut node) = open.pop() else { continue };
                node.place.end = place.end.max(node.place.start);
                if event == Event::MappingEnd
                    && let Content::Sequence(items) = node.content
                {
                    let mut items = items.into_iter();
                    let pairs = std::iter::from_fn(|| Some((items.next()?, items.next()?)));
                    node.content = Content::Mapping(pairs.collect());
                }
                node
            }
            _ => continue,
        };
        match open.last_mut() {
            Some(Node { content: Content::Sequence(items), .. }) => items.push(done),
            _ => root = root.or(Some(done)),
        }
    }
    Ok(root)
}

/// The rest of a path below a key. A path is `selector\nros__parameters\nname`, and a key may hold
/// several segments of the selector (`/`) or of the name (`.`).
fn below<'p>(key: &Node, path: &'p str) -> Option<&'p str> {
    let Content::Scalar(key) = &key.content else { return None };
    let rest = path.strip_prefix(key.as_str())?;
    if rest.is_empty() { Some(rest) } else { rest.strip_prefix(['\n', '/', '.']) }
}

/// The keys, outermost first, that a new entry at a path is written with.
fn keys(path: &str) -> impl DoubleEndedIterator<Item = &str> {
    let (outer, name) = path.rsplit_once('\n').unwrap_or(("", path));
    outer.split('\n').filter(|key| !key.is_empty()).chain(name.split('.'))
}

struct Edit<'a> {
    text: &'a str,
    newline: &'static str,
}

impl Edit<'_> {
    /// Sets the value at `path` below a node; `None` where the form does not allow it.
    fn set(&self, node: &Node, path: &str, value: &str) -> Option<String> {
        let Content::Mapping(entries) = &node.content else { return None };
        let longest = entries
            .iter()
            .filter_map(|(key, value)| Some((below(key, path)?, key, value)))
            .min_by_key(|(rest, ..)| rest.len());
        match longest {
            Some(("", key, found)) => self.replaced(key, found, value),
            Some((rest, key, found)) if found.is_null() => {
                let line = self.line_after(self.colon(key)?);
                Some(self.with_lines(line, self.column(key.place.start) + 2, rest, value))
            }
            Some((rest, _, found)) => self.set(found, rest, value),
            None => self.added(node, entries, path, value),
        }
    }

    /// Adds an entry to a mapping that has none of its name.
    fn added(
        &self,
        node: &Node,
        entries: &[(Node, Node)],
        path: &str,
        value: &str,
    ) -> Option<String> {
        if !is_flow(self.text, node) {
            let (key, last) = entries.last()?;
            let line = self.line_after(last.end(self.text, self.colon(key)?));
            return Some(self.with_lines(line, self.column(entries[0].0.place.start), path, value));
        }
        let mut keys = keys(path).rev();
        let innermost = format!("{}: {value}", keys.next()?);
        let entry = keys.fold(innermost, |inner, key| format!("{key}: {{{inner}}}"));
        Some(match entries.last() {
            Some((key, last)) => {
                let end = last.end(self.text, key.place.end);
                self.spliced(end..end, &format!(", {entry}"))
            }
            None => {
                let start = node.place.start + 1;
                self.spliced(start..start, &entry)
            }
        })
    }

    /// Replaces a value; a list by one of the same length item by item.
    fn replaced(&self, key: &Node, found: &Node, value: &str) -> Option<String> {
        if found.is_null() {
            let colon = self.colon(key)?;
            return Some(self.spliced(colon..colon, &format!(" {value}")));
        }
        if let Content::Sequence(items) = &found.content {
            let inside = value.strip_prefix('[').and_then(|v| v.strip_suffix(']'));
            let values: Vec<&str> = inside.into_iter().flat_map(|v| v.split(", ")).collect();
            if values.len() == items.len() {
                let mut text = self.text.to_owned();
                for (item, value) in items.iter().zip(values).rev() {
                    text.replace_range(item.place.clone(), value);
                }
                return Some(text);
            }
            // A block list may hold comments.
            is_flow(self.text, found).then_some(())?;
        }
        Some(self.spliced(found.place.clone(), value))
    }

    /// The text with the lines of a new entry at `at`, the start of a line.
    fn with_lines(&self, at: usize, column: usize, path: &str, value: &str) -> String {
        let unfinished = at > 0 && !self.text[..at].ends_with('\n');
        let mut lines = String::from(if unfinished { self.newline } else { "" });
        for (depth, key) in keys(path).enumerate() {
            let line_break = if depth == 0 { "" } else { self.newline };
            lines += &format!("{line_break}{}{key}:", " ".repeat(column + 2 * depth));
        }
        lines += &format!(" {value}{}", self.newline);
        self.spliced(at..at, &lines)
    }

    fn spliced(&self, range: Range<usize>, new: &str) -> String {
        let mut text = self.text.to_owned();
        text.replace_range(range, new);
        text
    }

    /// Just behind the colon that follows a key.
    fn colon(&self, key: &Node) -> Option<usize> {
        Some(key.place.end + self.text[key.place.end..].find(':')? + 1)
    }

    fn column(&self, at: usize) -> usize {
        let start = self.text[..at].rfind('\n').map_or(0, |i| i + 1);
        self.text[start..at].chars().count()
    }

    /// Start of the line after `at`.
    fn line_after(&self, at: usize) -> usize {
        self.text[at..].find('\n').map_or(self.text.len(), |i| at + i + 1)
    }
}
