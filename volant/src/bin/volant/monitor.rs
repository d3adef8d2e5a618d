//! `volant monitor`.

use crate::signals;
use node_kit::console::{stop_flag, stop_signals};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use std::{
    io::{IsTerminal, Write},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};
use volant::{
    command_line::{namespace, seconds},
    live::monitor::{Snapshot, TopicLine, Watch, plain, screen},
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Show only the topics of this namespace
    #[arg(short, long, default_value = "", value_name = "NAMESPACE", value_parser = namespace)]
    namespace: String,
    /// Subscribe to images too, to measure their rate and delay (adds network load)
    #[arg(long)]
    images: bool,
    /// Print one snapshot as text and exit
    #[arg(long)]
    once: bool,
    /// Print snapshots as text instead of a screen (the default into a pipe)
    #[arg(long, conflicts_with = "once")]
    plain: bool,
    /// Time before the first snapshot and between two, s
    #[arg(long, value_name = "SECONDS", default_value = "3", value_parser = seconds(0.1..=3600.0))]
    interval: Duration,
}

/// Period of discovery.
const DISCOVERY: Duration = Duration::from_millis(50);
/// Period of the screen.
const FRAME: Duration = Duration::from_millis(250);
/// Time in which the screen's loop ends after a signal.
const LAST_FRAME: Duration = Duration::from_secs(1);

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let mut watch = Watch::start(&arguments.namespace, arguments.images)?;
    let stop = stop_flag()?;
    if !arguments.once && !arguments.plain && std::io::stdout().is_terminal() {
        end_after(stop.clone())?;
        return on_screen(&mut watch, &stop);
    }
    loop {
        listen(&mut watch, &stop, arguments.interval);
        let snapshot = watch.snapshot();
        // Topics of the whole graph, such as /diagnostics, are no sign of the namespace's rig.
        let within = format!("/{}/", arguments.namespace).replace("//", "/");
        let is_within = |topic: &TopicLine| topic.name.starts_with(&within);
        anyhow::ensure!(
            !arguments.once || snapshot.topics.iter().any(is_within),
            plain::nothing(&snapshot)
        );
        // A closed pipe ends it.
        let written = write!(
            std::io::stdout(),
            "{}{}",
            plain::text(&snapshot),
            if arguments.once { "" } else { "\n" }
        );
        if arguments.once || written.is_err() || stop.load(Ordering::Acquire) {
            return Ok(());
        }
    }
}

fn listen(watch: &mut Watch, stop: &AtomicBool, time: Duration) {
    let polls = time.div_duration_f64(DISCOVERY) as u32;
    for _ in 0..polls.max(1) {
        if stop.load(Ordering::Acquire) {
            break;
        }
        watch.poll();
        std::thread::sleep(DISCOVERY);
    }
}

/// Ends the process on a signal where the screen's loop does not: crossterm polls a terminal that
/// was closed forever.
#[allow(clippy::disallowed_methods, reason = "the main thread hangs")]
fn end_after(stop: Arc<AtomicBool>) -> std::io::Result<()> {
    signals::on(&stop_signals(), move || {
        stop.store(true, Ordering::Release);
        std::thread::sleep(LAST_FRAME);
        // The terminal may be gone.
        let _ = ratatui::try_restore();
        std::process::exit(0);
    })
}

fn on_screen(watch: &mut Watch, stop: &AtomicBool) -> anyhow::Result<()> {
    let failed = |source: std::io::Error| {
        anyhow::anyhow!("the terminal: {source}; `--once` or a pipe writes plain text")
    };
    // Its panic hook restores the terminal too.
    let terminal = ratatui::try_init().map_err(failed)?;
    // Dropped, it shows the cursor, and panics where the terminal was closed.
    let mut terminal = std::mem::ManuallyDrop::new(terminal);
    let mut chosen = 0;
    let result = loop {
        watch.poll();
        let snapshot = watch.snapshot();
        if let Err(source) = terminal.draw(|frame| screen::draw(frame, &snapshot, chosen)) {
            break Err(failed(source));
        }
        match keys(&snapshot, &mut chosen) {
            Ok(true) => {}
            Ok(false) => break Ok(()),
            Err(source) => break Err(failed(source)),
        }
        if stop.load(Ordering::Acquire) {
            break Ok(());
        }
    };
    // Both fail where the terminal was closed.
    let _ = terminal.show_cursor();
    let _ = ratatui::try_restore();
    result
}

/// Handles keys until the next frame; `false`: quit.
fn keys(snapshot: &Snapshot, chosen: &mut usize) -> std::io::Result<bool> {
    if !event::poll(FRAME)? {
        return Ok(true);
    }
    if let Event::Key(key) = event::read()?
        && key.kind == KeyEventKind::Press
    {
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return Ok(false),
            // In raw mode the terminal sends no signal.
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => {
                return Ok(false);
            }
            KeyCode::Tab => *chosen = (*chosen + 1) % snapshot.rigs.len().max(1),
            _ => {}
        }
    }
    Ok(true)
}
