//! The page with the result of every step.

use super::{
    Step,
    state::{Outcome, State},
};
use clap::ValueEnum;
use std::path::Path;
use volant::report::{Block, Page, Section, Table};

/// Lays out the page.
pub fn page(rig: &Path, state: &State) -> Page {
    let sections = Step::value_variants().iter().enumerate().map(|(i, step)| {
        let name = step.name();
        let record = state.steps.get(&name);
        let outcome = record.map_or("not done", |r| r.outcome.word());
        let mut blocks = vec![];
        if let Some(record) = record {
            let rows = record
                .items
                .iter()
                .map(|item| [item.verdict.word().to_owned(), item.name.clone(), item.text.clone()]);
            if !record.items.is_empty() {
                blocks.push(Block::Table(Table::new(" | item | result", rows)));
            }
            for wrote in &record.wrote {
                blocks.push(Block::labelled("Written:", wrote.clone()));
            }
        }
        Section { title: format!("{}. {name}: {outcome}", i + 1), id: name, blocks }
    });
    let recordings = state.recordings.iter();
    let mut facts = vec![("Rig file".to_owned(), rig.display().to_string())];
    facts.extend(
        recordings.map(|(name, path)| (format!("Recording {name}"), path.display().to_string())),
    );
    let failed = state.steps.values().any(|r| r.outcome == Outcome::Failed);
    let accepted = state.steps.get(&Step::Acceptance.name());
    let accepted = accepted.is_some_and(|r| r.outcome == Outcome::Done) && !failed;
    Page {
        title: format!("Bring-up: {}", if accepted { "accepted" } else { "not accepted" }),
        lead: "Each step with what it checked and what it wrote.".into(),
        facts,
        sections: sections.collect(),
    }
}
