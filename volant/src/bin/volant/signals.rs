//! Signals: SIGINT, SIGTERM and SIGHUP stop a command, SIGUSR1 pauses one.

use node_kit::console::stop_signals;
use signal_hook::{consts::SIGUSR1, iterator::Signals};

/// Calls `call` on each of [`stop_signals`].
pub fn on_stop(call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    on(&stop_signals(), call)
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
