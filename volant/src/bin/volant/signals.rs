//! Signals: SIGINT and SIGTERM stop a command, SIGUSR1 pauses one.

use signal_hook::{
    consts::{SIGINT, SIGTERM, SIGUSR1},
    iterator::Signals,
};

/// Calls `call` on SIGINT and SIGTERM.
pub fn on_stop(call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    on(&[SIGINT, SIGTERM], call)
}

/// Calls `call` on SIGUSR1.
pub fn on_usr1(call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    on(&[SIGUSR1], call)
}

fn on(signals: &[i32], call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    let mut signals = Signals::new(signals)?;
    std::thread::spawn(move || signals.forever().for_each(|_| call()));
    Ok(())
}
