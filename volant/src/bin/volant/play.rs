//! `volant play`.

use crate::{signals, terminal};
use bag::BagReader;
use node_kit::outln;
use rig_model::topics::absolute::CLOCK;
use signal_hook::consts::SIGUSR1;
use std::{
    io::Read,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
};
use volant::live::play::{PlayOptions, play};

pub fn run(options: &PlayOptions) -> anyhow::Result<()> {
    let known = BagReader::summary(&options.input)?.topics;
    let (present, absent): (Vec<_>, Vec<_>) =
        options.topics.iter().partition(|name| known.iter().any(|(t, _)| t.name == **name));
    // Without any of them, playing fails.
    for name in absent.iter().filter(|name| !present.is_empty() && **name != CLOCK) {
        let bag = options.input.display();
        terminal::warn(format!("{bag}: no topic {name}; see `volant bag info {bag}`"));
    }
    let stop = node_kit::console::stop_flag()?;
    let paused = Arc::new(AtomicBool::new(options.paused));
    signals::on(&[SIGUSR1], toggle(Arc::clone(&paused)))?;
    let keys = Keys::listen(toggle(Arc::clone(&paused)));
    let bar = terminal::spinner();
    let result = play(options, &stop, &paused, |time, (first, last)| {
        let at = |t: u64| t.saturating_sub(first) as f64 * 1e-9;
        let hint = if keys.is_some() { "; space pauses" } else { "" };
        bar.set_message(format!("playing {:.1} of {:.1} s{hint}", at(time), at(last)));
    });
    bar.finish_and_clear();
    drop(keys);
    let report = result?;
    report.losses.iter().for_each(terminal::warn);
    if report.rejected > 0 {
        terminal::warn(format!(
            "{} messages were not published: a reliable subscriber did not keep up, or \
             they are no little-endian CDR",
            report.rejected
        ));
    }
    outln!("{} messages of {}", report.messages, options.input.display())?;
    Ok(())
}

/// Pauses the playback, or resumes it.
fn toggle(paused: Arc<AtomicBool>) -> impl Fn() + Send + 'static {
    move || {
        paused.fetch_xor(true, Ordering::AcqRel);
    }
}

/// Pauses on the space bar; the terminal is in non-canonical mode until this is dropped.
struct Keys(rustix::termios::Termios);

impl Keys {
    fn listen(toggle: impl Fn() + Send + 'static) -> Option<Self> {
        use rustix::{
            process::getpgrp,
            termios::{LocalModes, OptionalActions, tcgetattr, tcgetpgrp, tcsetattr},
        };
        let stdin = std::io::stdin();
        // A terminal stops a process of its background that reads or changes it.
        tcgetpgrp(&stdin).ok().filter(|group| *group == getpgrp())?;
        let before = tcgetattr(&stdin).ok()?;
        let mut keys = before.clone();
        keys.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        tcsetattr(&stdin, OptionalActions::Now, &keys).ok()?;
        // A blocking read has no cancellation; the thread ends with the process.
        std::thread::spawn(move || {
            for key in std::io::stdin().lock().bytes().map_while(Result::ok) {
                if key == b' ' {
                    toggle();
                }
            }
        });
        Some(Self(before))
    }
}

impl Drop for Keys {
    fn drop(&mut self) {
        let _ = rustix::termios::tcsetattr(
            std::io::stdin(),
            rustix::termios::OptionalActions::Now,
            &self.0,
        );
    }
}
