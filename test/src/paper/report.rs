//! The page that shows what was made.

use super::Made;
use volant::report::{Block, Page, Section, Table};

pub const TITLE: &str = "Published figures and tables, reproduced";

/// The text of `report.html`, with every figure and table in it.
pub fn render(facts: Vec<(String, String)>, made: &[Made], missing: &[(&str, String)]) -> String {
    let mut sections = Vec::new();
    for m in made {
        let mut blocks =
            vec![Block::labelled("What it shows.", &m.shows), Block::Figure(m.svg.clone())];
        blocks.extend(m.table.clone().map(Block::Table));
        let rows = m.values.iter().map(|v| [&v.what, &v.published, &v.here].map(String::clone));
        blocks.push(Block::Table(Table::new("quantity | published | here", rows)));
        blocks.push(Block::labelled("Against the published one.", &m.published));
        blocks.push(Block::Note(format!(
            "Numbers: `{0}.csv`. Image: `{0}.svg`. Alone: `volant reproduce {0} --out DIR`.",
            m.name
        )));
        sections.push(Section { id: m.name.to_owned(), title: m.title.to_owned(), blocks });
    }
    if !missing.is_empty() {
        let blocks = missing
            .iter()
            .map(|(name, why)| Block::labelled(&format!("{name}:"), why.as_str()))
            .collect();
        sections.push(Section {
            id: "missing".into(),
            title: "Not made in this run".into(),
            blocks,
        });
    }
    let page = Page {
        title: TITLE.into(),
        lead: "N. Kyriakoulis and A. Gasteratos, “Color-Based Monocular Visuoinertial 3-D Pose \
               Estimation of a Volant Robot”, IEEE Transactions on Instrumentation and Measurement \
               59(10), 2010. Each figure and table below was made in one run by the cores of this \
               program's nodes on a simulated bench with exact truth, the peers beside it on the \
               same footprint and under the same light. Where a peer is better, it is named. A \
               dash stands where nothing is published, or only as an image without numbers."
            .into(),
        facts,
        sections,
    };
    page.render()
}
