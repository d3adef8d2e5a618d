//! Questions and answers in the terminal, or in a script on standard input.

use anyhow::Result;
use node_kit::{out, outln};
use std::{io::BufRead, path::Path};
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
    if std::io::stdin().lock().read_line(&mut line)? == 0 {
        outln!("")?;
        return Err(Paused.into());
    }
    match line.trim() {
        "q" => Err(Paused.into()),
        "" => Ok(default.to_owned()),
        text => Ok(text.to_owned()),
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
        let found: Vec<f64> =
            words.filter_map(|w| w.parse().ok()).filter(|x: &f64| x.is_finite()).collect();
        match <[f64; N]>::try_from(found) {
            Ok(numbers) => match check(&numbers) {
                Ok(()) => return Ok(numbers),
                Err(wrong) => outln!("  {wrong}")?,
            },
            Err(_) => outln!("  write {N} numbers, such as {shown}")?,
        }
    }
}

/// Asks for an existing file, or one of the other answers.
///
/// # Errors
/// As [`ask`].
pub fn file_or(question: &str, default: &str, others: &[&str]) -> Result<String> {
    loop {
        let answer = ask(question, default)?;
        let first = answer.split(' ').next().unwrap_or_default();
        if others.contains(&first) || Path::new(&answer).exists() {
            return Ok(answer);
        }
        outln!("  {answer}: no such file")?;
    }
}
