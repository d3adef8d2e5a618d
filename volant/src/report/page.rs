//! HTML page without external resources: text, figures and tables, with a light and a dark scheme.

use super::palette;
use std::fmt::Write;

const STYLE: &str = "\
:root{color-scheme:light dark;--ink:#1d1e20;--soft:#5d5b55;--paper:#f7f6f2;--card:#fff;\
    --line:#dedbd3;--accent:#8f2430;--good:#1f6b4f}
@media (prefers-color-scheme:dark){:root{--ink:#eceae5;--soft:#b0ada5;--paper:#131416;\
    --card:#1d1e21;--line:#34363a;--accent:#ff9aa0;--good:#66d3a8}}
*{box-sizing:border-box}
html{scroll-behavior:smooth}
@media (prefers-reduced-motion:reduce){html{scroll-behavior:auto}}
body{margin:0;background:var(--paper);color:var(--ink);font:17px/1.6 \
    system-ui,-apple-system,'Segoe UI',Roboto,'DejaVu Sans',sans-serif}
main{max-width:74rem;margin:0 auto;padding:3.2rem 1.4rem 6rem}
header{border-bottom:1px solid var(--line);padding-bottom:1.6rem}
.over{color:var(--accent);font-weight:600;font-size:.86rem;letter-spacing:.04em;margin:0 0 .5rem}
h1{font-size:2.15rem;line-height:1.18;letter-spacing:-.015em;margin:0 0 .8rem;max-width:48rem}
h2{font-size:1.35rem;line-height:1.3;letter-spacing:-.01em;margin:0 0 .7rem}
h3{font-size:1rem;margin:1.6rem 0 .3rem}
p{max-width:47rem;margin:.5rem 0}
.lead{font-size:1.08rem}
dl{display:grid;grid-template-columns:max-content 1fr;gap:.25rem 1.4rem;margin:1.2rem 0 \
    0;font-size:.92rem}
dt{color:var(--soft)}dd{margin:0;overflow-wrap:anywhere}
nav ol{columns:2 22rem;column-gap:2.4rem;list-style:none;padding:0;margin:1.5rem 0 \
    0;font-size:.95rem}
nav li{break-inside:avoid;padding:.22rem 0}
a{color:inherit;text-decoration-color:var(--accent);text-underline-offset:.18em}
a:hover{color:var(--accent)}
section{margin-top:3.4rem;scroll-margin-top:1rem}
.label{color:var(--soft);font-weight:600}
.soft{color:var(--soft);font-size:.9rem}
figure{margin:1.2rem 0 .6rem;background:var(--card);border:1px solid \
    var(--line);border-radius:8px;padding:.6rem;overflow-x:auto}
figure svg{display:block;width:100%;height:auto;min-width:58rem}
.table{overflow-x:auto;margin:1.2rem 0 .6rem}
table{border-collapse:collapse;font-variant-numeric:tabular-nums;font-size:.95rem;\
    background:var(--card);border:1px solid var(--line)}
th,td{padding:.42rem 1rem;text-align:right;border-bottom:1px solid var(--line)}
tr:last-child td{border-bottom:0}
th{font-weight:600;color:var(--soft)}
th:first-child,td:first-child{text-align:left}
td.best{font-weight:700;color:var(--good)}
code{font:.92em ui-monospace,'DejaVu Sans Mono',Menlo,monospace;overflow-wrap:anywhere}
@media print{body{background:#fff}section{break-inside:avoid}}
";

/// Block of a section.
#[derive(Clone, Debug)]
pub enum Block {
    /// Paragraph with an optional highlighted label.
    Text {
        /// Label, such as “Published.”; may be empty.
        label: String,
        /// Text.
        text: String,
    },
    /// Small note, such as the source of the numbers.
    Note(String),
    /// SVG, such as those of [`super::panels`] and [`super::Drawing`].
    Figure(String),
    /// Table.
    Table(Table),
}

impl Block {
    /// Creates a paragraph.
    pub fn text(text: impl Into<String>) -> Self {
        Self::Text { label: String::new(), text: text.into() }
    }

    /// Creates a paragraph with a label.
    pub fn labelled(label: &str, text: impl Into<String>) -> Self {
        Self::Text { label: label.into(), text: text.into() }
    }
}

/// Table of text.
#[derive(Clone, Debug, Default)]
pub struct Table {
    /// Column titles.
    pub head: Vec<String>,
    /// Rows; `true` marks the best cell of a row.
    pub rows: Vec<Vec<(String, bool)>>,
}

impl Table {
    /// Creates a table without best cells; the titles in `head` are separated by ` | `.
    pub fn new<R: Into<Vec<String>>>(head: &str, rows: impl IntoIterator<Item = R>) -> Self {
        let mut table = Self { head: head.split(" | ").map(str::to_owned).collect(), rows: vec![] };
        rows.into_iter().for_each(|row| table.push(row.into()));
        table
    }

    /// Converts CSV; numbers are rounded to `digits` decimals. `best` marks the smallest number of
    /// each row.
    pub fn from_csv(csv: &str, digits: usize, best: bool) -> Self {
        let mut lines = csv.lines();
        let head = lines.next().map(cells).unwrap_or_default();
        let rows = lines
            .map(|line| {
                let row = cells(line);
                let numbers: Vec<Option<f64>> =
                    row.iter().skip(1).map(|c| c.parse().ok()).collect();
                let least = numbers.iter().flatten().copied().fold(f64::INFINITY, f64::min);
                row.into_iter()
                    .enumerate()
                    .map(|(i, cell)| match i.checked_sub(1).and_then(|i| numbers[i]) {
                        Some(v) => (format!("{v:.digits$}"), best && v == least),
                        None => (cell, false),
                    })
                    .collect()
            })
            .collect();
        Self { head, rows }
    }

    /// Adds a row without a best cell.
    pub fn push(&mut self, cells: Vec<String>) {
        self.rows.push(cells.into_iter().map(|cell| (cell, false)).collect());
    }

    /// Formats the table as text with aligned columns: the first to the left, the others to the
    /// right.
    pub fn to_text(&self) -> String {
        let rows = self.rows.iter().map(|row| row.iter().map(|(cell, _)| cell).collect());
        let rows: Vec<Vec<&String>> =
            std::iter::once(self.head.iter().collect()).chain(rows).collect();
        let width = |i: usize| rows.iter().filter_map(|r| r.get(i)).map(|c| c.len()).max();
        let widths: Vec<usize> = (0..self.head.len()).map_while(width).collect();
        let mut text = String::new();
        for row in &rows {
            for (i, (cell, w)) in row.iter().zip(&widths).enumerate() {
                let _ = if i == 0 {
                    write!(text, "{cell:<w$}  ")
                } else {
                    write!(text, "{cell:>w$}  ")
                };
            }
            text.truncate(text.trim_end_matches(' ').len());
            text.push('\n');
        }
        text
    }

    /// Formats the table as Markdown.
    pub fn to_markdown(&self) -> String {
        let line = |cells: Vec<&str>| format!("| {} |\n", cells.join(" | "));
        let head = [self.head.iter().map(String::as_str).collect(), vec!["---"; self.head.len()]];
        let rows = self.rows.iter().map(|row| row.iter().map(|(cell, _)| cell.as_str()).collect());
        head.into_iter().chain(rows).map(line).collect()
    }
}

/// Splits a line of CSV into cells; quoted cells may hold commas.
pub fn cells(line: &str) -> Vec<String> {
    let (mut cells, mut cell, mut quoted) = (Vec::new(), String::new(), false);
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            ',' if !quoted => cells.push(std::mem::take(&mut cell)),
            c => cell.push(c),
        }
    }
    cells.push(cell);
    cells
}

/// Section of a page.
#[derive(Clone, Debug)]
pub struct Section {
    /// Anchor: letters, digits and hyphens.
    pub id: String,
    /// Headline.
    pub title: String,
    /// Blocks.
    pub blocks: Vec<Block>,
}

/// Page.
#[derive(Clone, Debug, Default)]
pub struct Page {
    /// Title.
    pub title: String,
    /// Paragraph below the title.
    pub lead: String,
    /// Facts needed to reproduce the page, beside the version: name and value.
    pub facts: Vec<(String, String)>,
    /// Sections.
    pub sections: Vec<Section>,
}

impl Page {
    /// Formats the page as HTML.
    pub fn render(&self) -> String {
        let mut html = format!(
            "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n<meta \
             name=\"viewport\" \
             content=\"width=device-width,initial-scale=1\">\n<meta name=\"color-scheme\" \
             content=\"light dark\">\n\
             <link rel=\"icon\" \
             href=\"data:,\">\n<title>{0}</title>\n<style>\n{STYLE}{1}\n</style>\n</head>\n\
             <body>\n<main>\n\
             <header>\n<p class=\"over\">Volant: pose of a robot that hangs from a ceiling \
             crane</p>\n<h1>{0}</h1>\n<p class=\"lead\">{2}</p>\n\
             <dl>\n<dt>Made by</dt><dd>volant {3}</dd>\n",
            escape(&self.title),
            palette::style(),
            escape(&self.lead),
            env!("CARGO_PKG_VERSION"),
        );
        for (name, value) in &self.facts {
            let _ = writeln!(html, "<dt>{}</dt><dd>{}</dd>", escape(name), marked(value));
        }
        html.push_str("</dl>\n");
        if self.sections.len() > 1 {
            html.push_str("<nav aria-label=\"Contents\"><ol>\n");
            for s in &self.sections {
                let _ = writeln!(html, "<li><a href=\"#{}\">{}</a></li>", s.id, escape(&s.title));
            }
            html.push_str("</ol></nav>\n");
        }
        html.push_str("</header>\n");
        for s in &self.sections {
            let _ = writeln!(html, "<section id=\"{}\">\n<h2>{}</h2>", s.id, escape(&s.title));
            for block in &s.blocks {
                html.push_str(&block_html(block));
            }
            html.push_str("</section>\n");
        }
        html.push_str("</main>\n</body>\n</html>\n");
        html
    }
}

fn block_html(block: &Block) -> String {
    match block {
        Block::Text { label, text } if label.is_empty() => format!("<p>{}</p>\n", marked(text)),
        Block::Text { label, text } => {
            format!("<p><span class=\"label\">{}</span> {}</p>\n", escape(label), marked(text))
        }
        Block::Note(text) => format!("<p class=\"soft\">{}</p>\n", marked(text)),
        // The page has a common style sheet.
        Block::Figure(svg) => format!(
            "<figure>{}</figure>\n",
            svg.replacen(&format!("<style>{}</style>", palette::style()), "", 1)
        ),
        Block::Table(table) => {
            let mut html = String::from("<div class=\"table\"><table>\n<thead><tr>");
            for cell in &table.head {
                let _ = write!(html, "<th scope=\"col\">{}</th>", escape(cell));
            }
            html.push_str("</tr></thead>\n<tbody>\n");
            for row in &table.rows {
                html.push_str("<tr>");
                for (cell, best) in row {
                    let class = if *best { " class=\"best\"" } else { "" };
                    let _ = write!(html, "<td{class}>{}</td>", escape(cell));
                }
                html.push_str("</tr>\n");
            }
            html.push_str("</tbody></table></div>\n");
            html
        }
    }
}

/// Escapes text, and formats `code` between backquotes.
fn marked(text: &str) -> String {
    let mut html = String::new();
    for (i, part) in text.split('`').enumerate() {
        if i % 2 == 1 {
            let _ = write!(html, "<code>{}</code>", escape(part));
        } else {
            html.push_str(&escape(part));
        }
    }
    html
}

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_written_is_escaped_and_nothing_is_fetched() {
        let table = Table::from_csv("axis,a,b\nx,0.12345,2\n\"y, z\",,1\n", 2, true);
        assert_eq!(
            table.rows[0],
            [("x".into(), false), ("0.12".into(), true), ("2.00".into(), false)]
        );
        assert_eq!(table.rows[1][0].0, "y, z");
        assert_eq!(table.rows[1][1], (String::new(), false));
        assert_eq!(
            Table::new("axis | a", [["x".to_owned(), "0.12".to_owned()]]).to_markdown(),
            "| axis | a |\n| --- | --- |\n| x | 0.12 |\n"
        );
        let svg = palette::finished(
            "<svg width=\"9\" height=\"4\" xmlns=\"http://www.w3.org/2000/svg\"><g/></svg>",
            "n",
        );
        let page = Page {
            title: "a < b & \"c\"".into(),
            facts: vec![("command".into(), "run `volant <x>`".into())],
            sections: vec![
                Section {
                    id: "one".into(),
                    title: "One".into(),
                    blocks: vec![Block::Figure(svg), Block::Table(table)],
                },
                Section {
                    id: "two".into(),
                    title: "Two".into(),
                    blocks: vec![Block::labelled("Why.", "so")],
                },
            ],
            ..Page::default()
        };
        let html = page.render();
        assert!(
            html.contains("<h1>a &lt; b &amp; &quot;c&quot;</h1>")
                && html.contains("<code>volant &lt;x&gt;</code>")
        );
        assert!(
            html.contains("<a href=\"#two\">Two</a>")
                && html.contains("<td class=\"best\">0.12</td>")
        );
        assert_eq!(
            html.matches("@media (prefers-color-scheme:dark){svg").count(),
            1,
            "one style sheet for all figures"
        );
        for outside in ["src=", "@import", "url("] {
            assert!(!html.contains(outside), "{outside}");
        }
        assert_eq!(html.matches("http").count(), 1, "only the name of SVG's vocabulary");
    }
}
