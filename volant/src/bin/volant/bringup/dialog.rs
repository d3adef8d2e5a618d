//! Questions and answers in the terminal, or in a script on standard input.

use anyhow::{Context, Result};
use node_kit::{out, outln};
use std::{
    io::BufRead,
    path::{Path, PathBuf},
};
use thiserror::Error;

/// The operator quits, or standard input ends.
#[derive(Debug, Error)]
#[error("paused; the same command goes on with this step")]
pub struct Paused;

/// Asks for one line.
///
/// # Errors
/// [`Paused`] for `q` and at the end of the input.
pub fn ask(question: &str, default: &str) -> Result<String> {
    if default.is_empty() {
        out!("{question}: ")?;
    } else {
        out!("{question} [{default}]: ")?;
    }
    let mut line = String::new();
    let read = std::io::stdin().lock().read_line(&mut line);
    if read.with_context(|| format!("the answer to `{}`", question.trim()))? == 0 {
        outln!("")?;
        return Err(Paused.into());
    }
    match line.trim() {
        "q" => Err(Paused.into()),
        "" => Ok(default.to_owned()),
        text => Ok(text.to_owned()),
    }
}

/// Asks until the answer is one of `answers`; the empty one is Enter alone.
///
/// # Errors
/// As [`ask`].
pub fn choose(question: &str, answers: &[&str]) -> Result<String> {
    loop {
        let answer = ask(question, "")?;
        if answers.contains(&answer.as_str()) {
            return Ok(answer);
        }
        outln!("  `{answer}` is not one of the answers")?;
    }
}

/// Asks for numbers, separated by spaces or commas, until the answer is valid: `check` returns what
/// is wrong with it, and the remedy.
///
/// # Errors
/// As [`ask`].
pub fn numbers<const N: usize>(
    question: &str,
    default: [f64; N],
    check: impl Fn(&[f64; N]) -> Result<(), String>,
) -> Result<[f64; N]> {
    let shown = default.map(|x| format!("{}", (x * 1e4).round() / 1e4)).join(" ");
    loop {
        let answer = ask(question, &shown)?;
        if answer == shown {
            return Ok(default);
        }
        let words = answer.split([' ', ',']).filter(|w| !w.is_empty());
        let found: Vec<f64> = words.map(|w| w.parse().unwrap_or(f64::NAN)).collect();
        match <[f64; N]>::try_from(found) {
            Ok(numbers) if numbers.iter().all(|x| x.is_finite()) => match check(&numbers) {
                Ok(()) => return Ok(numbers),
                Err(wrong) => outln!("  {wrong}")?,
            },
            _ if N == 1 => outln!("  write a number, such as {shown}")?,
            _ => outln!("  write {N} numbers, such as {shown}")?,
        }
    }
}

/// Messages of a step: recorded now, or in a bag.
pub enum Source {
    /// Seconds to record.
    Live(f64),
    Bag(PathBuf),
}

/// Longest live recording, s.
const LONGEST: f64 = 86_400.0;

impl Source {
    /// Parses the name of a bag, `live`, or `live 60` (`live 60s`).
    fn parse(answer: &str, seconds: f64) -> Result<Self, String> {
        let remedy = format!("`live {seconds:.0}` records {seconds:.0} s");
        match answer.split_once(' ').unwrap_or((answer, "")) {
            _ if Path::new(answer).exists() => Ok(Self::Bag(answer.into())),
            ("live", "") => Ok(Self::Live(seconds)),
            ("live", time) => {
                let number = time.trim().trim_end_matches('s').trim_end().parse().ok();
                let valid = number.filter(|s| (0.1..=LONGEST).contains(s));
                valid.map(Self::Live).ok_or_else(|| format!("`{time}` is no duration: {remedy}"))
            }
            _ => Err(format!("{answer}: no such file; {remedy}")),
        }
    }
}

/// Asks for a bag, or for the seconds to record; `known` is the default.
///
/// # Errors
/// As [`ask`].
pub fn source(known: Option<&Path>, seconds: f64) -> Result<Source> {
    let question = format!("  Bag, or `live SECONDS` to record (about {seconds:.0})");
    let default =
        known.map_or_else(|| format!("live {seconds:.0}"), |path| path.display().to_string());
    loop {
        match Source::parse(&ask(&question, &default)?, seconds) {
            Ok(source) => return Ok(source),
            Err(wrong) => outln!("  {wrong}")?,
        }
    }
}
