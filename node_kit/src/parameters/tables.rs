//! Descriptors as text: Markdown table, YAML file, terminal help.

use super::Descriptor;
use std::fmt::Write;

/// Markdown table, one row for each parameter.
pub fn markdown_table(descriptors: &[Descriptor]) -> String {
    let mut text = String::from(
        "| parameter | type | default | unit | allowed | changes | what it is |\n\
         |---|---|---|---|---|---|---|\n",
    );
    for d in descriptors {
        let default = d.default.as_ref().map_or("(must be given)".to_owned(), |v| format!("`{v}`"));
        let _ = writeln!(
            text,
            "| `{}` | {} | {default} | {} | {} | {} | {} |",
            d.name,
            d.kind.name(),
            d.unit,
            d.constraint().replace('|', "\\|"),
            if d.live { "live" } else { "at start" },
            d.description.replace('|', "\\|"),
        );
    }
    text
}

/// Parameter file with every default and each description as a comment. Required parameters are
/// commented out.
pub fn yaml_file(selector: &str, descriptors: &[Descriptor]) -> String {
    let mut text = format!("{selector}:\n  ros__parameters:\n");
    for d in descriptors {
        let unit = enclosed(" [", d.unit, "]");
        let constraint = enclosed(" (", &d.constraint(), ")");
        let _ = writeln!(text, "    # {}{unit}{constraint}", d.description);
        let _ = match &d.default {
            Some(value) => writeln!(text, "    {}: {}", d.name, value.to_yaml()),
            None => writeln!(text, "    # {}:", d.name),
        };
    }
    text
}

/// Lines for a terminal: name, description, type, default, unit, constraint.
pub fn help_table(descriptors: &[Descriptor]) -> String {
    let width = descriptors.iter().map(|d| d.name.len()).max().unwrap_or(0);
    let mut text = String::new();
    for d in descriptors {
        let default =
            d.default.as_ref().map_or("must be given".to_owned(), |v| format!("default {v}"));
        let unit = enclosed(" ", d.unit, "");
        let constraint = enclosed(", ", &d.constraint(), "");
        let live = if d.live { ", live" } else { "" };
        let _ = writeln!(
            text,
            "  {:width$}  {} ({}, {default}{unit}{constraint}{live})",
            d.name,
            d.description,
            d.kind.name()
        );
    }
    text
}

/// A text between two others; nothing where it is empty.
fn enclosed(before: &str, text: &str, after: &str) -> String {
    if text.is_empty() { String::new() } else { format!("{before}{text}{after}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::{ParameterKind, common_descriptors};
    use ros_parameters::{ParameterFile, ParameterValue};

    #[test]
    fn the_yaml_file_reads_back_as_the_defaults() {
        use ParameterValue as V;
        let mut all = common_descriptors();
        for (name, default) in [
            ("text.word", V::String("info".into())),
            ("text.number", V::String("1e3".into())),
            ("text.quotes", V::String("a \"b\" \\ #\n".into())),
            ("text.list", V::StringArray(vec!["inf".into(), "-".into()])),
            ("double.infinite", V::Double(f64::NEG_INFINITY)),
            ("double.list", V::DoubleArray(vec![f64::INFINITY, 1e-9])),
        ] {
            all.push(Descriptor::new(name, ParameterKind::of(&default), Some(default), ""));
        }
        let map = ParameterFile::parse(&yaml_file("/**", &all)).unwrap().for_node("/x");
        for d in &all {
            assert_eq!(
                map.get(&d.name).map(|v| d.accept(v).unwrap()),
                d.default.clone(),
                "{}",
                d.name
            );
        }
    }
}
