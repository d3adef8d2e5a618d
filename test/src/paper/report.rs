//! One page that shows what was made: self-contained, light and dark, no network.

use super::{Made, PaperError, write};
use std::{fmt::Write, path::Path};

const STYLE: &str = "
:root { color-scheme: light dark; --ink: #1c1d1f; --paper: #fbfaf7; --line: #d9d6ce; --soft: #6a675f; }
@media (prefers-color-scheme: dark) { :root { --ink: #e9e7e2; --paper: #17181a; --line: #3a3b3e; --soft: #a5a29a; } }
body { margin: 0 auto; max-width: 72rem; padding: 2.5rem 1.5rem 5rem; background: var(--paper); color: var(--ink);
  font: 17px/1.55 system-ui, sans-serif; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 .4rem; } h2 { font-size: 1.25rem; margin: 3rem 0 .6rem; }
p { max-width: 46rem; } .soft { color: var(--soft); font-size: .92rem; }
figure { margin: 1rem 0; background: #fff; border: 1px solid var(--line); border-radius: 6px; padding: .5rem; overflow-x: auto; }
figure svg { width: 100%; height: auto; display: block; min-width: 36rem; }
table { border-collapse: collapse; margin: 1rem 0; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .9rem; text-align: right; border-bottom: 1px solid var(--line); } th:first-child, td:first-child { text-align: left; }
code { font-size: .9em; } nav a { margin-right: 1rem; color: inherit; }";

/// Writes `report.html` with every figure and table in it.
///
/// # Errors
/// A figure that cannot be read, or a place that cannot be written to.
pub fn write_report(
    folder: &Path,
    command: &str,
    machine: &str,
    made: &[Made],
    missing: &[(&str, String)],
) -> Result<(), PaperError> {
    let mut page = format!(
        "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Volant: the paper's experiments, made anew</title><style>{STYLE}</style></head><body>\n\
         <h1>The paper's experiments, made anew</h1>\n<p class=\"soft\">Kyriakoulis and Gasteratos, “Color-Based Monocular \
         Visuoinertial 3-D Pose Estimation of a Volant Robot”, 2010, on a simulated bench by this program's own nodes. \
         Command: <code>{}</code>. Machine: {}.</p>\n<nav>",
        escape(command),
        escape(machine)
    );
    for m in made {
        let _ = write!(page, "<a href=\"#{0}\">{0}</a>", m.name);
    }
    page.push_str("</nav>\n");
    for m in made {
        let _ = write!(page, "<h2 id=\"{}\">{}</h2>\n<p>{}</p>\n", m.name, escape(m.title), escape(&m.words));
        match &m.svg {
            Some(path) => {
                let svg = read(path)?;
                let start = svg.find("<svg").unwrap_or(0);
                let sized = with_view_box(&svg[start..]);
                let _ = writeln!(page, "<figure>{sized}</figure>");
            }
            None => page.push_str(&table(&read(&m.csv)?)),
        }
        let file = m.csv.file_name().map(|f| f.to_string_lossy().into_owned()).unwrap_or_default();
        let _ = writeln!(page, "<p class=\"soft\">Numbers: <code>{}</code></p>", escape(&file));
    }
    if !missing.is_empty() {
        page.push_str("<h2>Not made in this run</h2>\n<ul>");
        for (name, reason) in missing {
            let _ = write!(page, "<li><code>{}</code>: {}</li>", escape(name), escape(reason));
        }
        page.push_str("</ul>\n");
    }
    page.push_str("</body></html>\n");
    write(&folder.join("report.html"), &page)
}

/// A picture that scales needs a view box where it has only a size.
fn with_view_box(svg: &str) -> String {
    let attribute = |name: &str| {
        let start = svg.find(&format!("{name}=\""))? + name.len() + 2;
        svg[start..].split('"').next()?.parse::<f64>().ok()
    };
    let head_end = svg.find('>').unwrap_or(0);
    if svg[..head_end].contains("viewBox") {
        return svg.to_owned();
    }
    match (attribute("width"), attribute("height")) {
        (Some(w), Some(h)) => svg.replacen("<svg", &format!("<svg viewBox=\"0 0 {w} {h}\""), 1),
        _ => svg.to_owned(),
    }
}

fn read(path: &Path) -> Result<String, PaperError> {
    std::fs::read_to_string(path).map_err(|source| PaperError::Io { path: path.to_owned(), source })
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// A small CSV as a table, numbers to three digits.
fn table(csv: &str) -> String {
    let mut text = String::from("<table>");
    for (i, line) in csv.lines().enumerate() {
        let tag = if i == 0 { "th" } else { "td" };
        text.push_str("<tr>");
        for cell in line.split(',') {
            let shown = match (i, cell.parse::<f64>()) {
                (1.., Ok(v)) => format!("{v:.3}"),
                _ => cell.to_owned(),
            };
            let _ = write!(text, "<{tag}>{}</{tag}>", escape(&shown));
        }
        text.push_str("</tr>");
    }
    text.push_str("</table>\n");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_escaped_sized_and_without_a_network() {
        assert_eq!(escape("a<b & \"c\""), "a&lt;b &amp; &quot;c&quot;");
        assert!(
            with_view_box("<svg width=\"90\" height=\"40\" xmlns=\"x\">").contains("viewBox=\"0 0 90 40\"")
        );
        assert_eq!(
            table("axis,a\nx,0.12345\n"),
            "<table><tr><th>axis</th><th>a</th></tr><tr><td>x</td><td>0.123</td></tr></table>\n"
        );
        assert!(!STYLE.contains("http") && !STYLE.contains("@import"));
    }
}
