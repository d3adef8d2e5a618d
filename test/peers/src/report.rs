//! Tables as text and as CSV, and figures beside their targets.

use anyhow::{Context, Result};
use std::{fs, path::Path};

/// A number with `digits` decimals; empty if it is not finite.
pub fn number(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { String::new() }
}

#[derive(Clone, Debug)]
pub struct Csv(String);

impl Csv {
    pub fn new(header: &str) -> Self {
        Self(format!("{header}\n"))
    }

    /// One row; a cell with a comma is quoted.
    pub fn row(&mut self, cells: impl IntoIterator<Item = String>) {
        let quote = |c: String| if c.contains(',') { format!("\"{c}\"") } else { c };
        let quoted: Vec<String> = cells.into_iter().map(quote).collect();
        self.0.push_str(&quoted.join(","));
        self.0.push('\n');
    }

    pub fn write(&self, path: &Path) -> Result<()> {
        fs::write(path, &self.0).with_context(|| format!("writing {}", path.display()))
    }
}

/// Figures beside what they must reach.
#[derive(Clone, Debug, Default)]
pub struct Targets(Vec<(String, f64, String, bool)>);

impl Targets {
    pub fn at_most(&mut self, what: &str, value: f64, limit: f64) {
        self.0.push((what.into(), value, format!("<= {limit:.4}"), value <= limit));
    }

    pub fn at_least(&mut self, what: &str, value: f64, limit: f64) {
        self.0.push((what.into(), value, format!(">= {limit:.4}"), value >= limit));
    }

    pub fn within(&mut self, what: &str, value: f64, low: f64, high: f64) {
        self.0.push((
            what.into(),
            value,
            format!("{low} to {high}"),
            (low..=high).contains(&value),
        ));
    }

    /// Every row, and how many failed.
    pub fn print(&self) -> usize {
        println!("\n{:<52} {:>12} {:>14}", "figure", "value", "target");
        for (what, value, target, reached) in &self.0 {
            println!(
                "{what:<52} {value:>12.5} {target:>14}  {}",
                if *reached { "pass" } else { "FAIL" }
            );
        }
        self.0.iter().filter(|t| !t.3).count()
    }
}
