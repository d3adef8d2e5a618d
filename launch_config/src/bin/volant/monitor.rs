//! `volant monitor`.

use crate::signals;
use launch_config::live::{
    LiveError,
    monitor::{Snapshot, Watch, WatchOptions, plain, screen},
};
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use std::{
    io::{IsTerminal, Write},
    sync::atomic::{AtomicBool, Ordering},
    time::Duration,
};

#[derive(clap::Args)]
pub struct Arguments {
    /// Only the topics of this namespace
    #[arg(short, long, default_value = "", value_name = "NAMESPACE")]
    namespace: String,
    /// Takes images too, to measure their rate and delay; they are then sent here
    #[arg(long)]
    images: bool,
    /// Writes what there is as text, once, and ends
    #[arg(long)]
    once: bool,
    /// Writes text again and again instead of a screen, as it does into a pipe
    #[arg(long, conflicts_with = "once")]
    plain: bool,
    /// How long is listened before the text, and between two, s
    #[arg(long, value_name = "SECONDS", default_value_t = 3.0, value_parser = seconds)]
    interval: f64,
}

fn seconds(text: &str) -> Result<f64, String> {
    text.parse()
        .ok()
        .filter(|x| (0.1..=3600.0).contains(x))
        .ok_or("it must be a number from 0.1 to 3600".into())
}

/// How often new topics are looked for.
const LOOK: Duration = Duration::from_millis(50);
/// How often the screen is drawn.
const DRAW: Duration = Duration::from_millis(250);

pub fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let options = WatchOptions { namespace: arguments.namespace.clone(), images: arguments.images };
    let mut watch = Watch::start(options)?;
    let stop = signals::stop_flag()?;
    if !arguments.once && !arguments.plain && std::io::stdout().is_terminal() {
        return Ok(on_screen(&mut watch, &stop)?);
    }
    loop {
        listen(&mut watch, &stop, Duration::from_secs_f64(arguments.interval))?;
        let snapshot = watch.snapshot();
        anyhow::ensure!(
            !arguments.once || !snapshot.topics.is_empty(),
            "nobody publishes anything{}; are the nodes running, with the same ROS_DOMAIN_ID?",
            if arguments.namespace.is_empty() { "" } else { " in this namespace" }
        );
        // A reader that has gone ends it.
        let written =
            write!(std::io::stdout(), "{}{}", plain::text(&snapshot), if arguments.once { "" } else { "\n" });
        if arguments.once || written.is_err() || stop.load(Ordering::Acquire) {
            return Ok(());
        }
    }
}

fn listen(watch: &mut Watch, stop: &AtomicBool, time: Duration) -> Result<(), LiveError> {
    let looks = time.div_duration_f64(LOOK) as u32;
    for _ in 0..looks.max(1) {
        if stop.load(Ordering::Acquire) {
            break;
        }
        watch.look()?;
        std::thread::sleep(LOOK);
    }
    Ok(())
}

fn on_screen(watch: &mut Watch, stop: &AtomicBool) -> Result<(), LiveError> {
    let failed = |source| LiveError::Terminal { source };
    // Its panic hook gives the terminal back too.
    let mut terminal = ratatui::try_init().map_err(failed)?;
    let mut chosen = 0;
    let result = loop {
        if let Err(error) = watch.look() {
            break Err(error);
        }
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
    ratatui::restore();
    result
}

/// Waits for keys until the next drawing; `false`: the user has seen enough.
fn keys(snapshot: &Snapshot, chosen: &mut usize) -> std::io::Result<bool> {
    if !event::poll(DRAW)? {
        return Ok(true);
    }
    if let Event::Key(key) = event::read()?
        && key.kind == KeyEventKind::Press
    {
        match key.code {
            KeyCode::Char('q') | KeyCode::Esc => return Ok(false),
            // The terminal does not make a signal of it any more.
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Ok(false),
            KeyCode::Tab => *chosen = (*chosen + 1) % snapshot.rigs.len().max(1),
            _ => {}
        }
    }
    Ok(true)
}
