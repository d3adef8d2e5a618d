//! SIGINT and SIGTERM end a command in order, SIGUSR1 pauses one.

use signal_hook::{
    consts::{SIGINT, SIGTERM, SIGUSR1},
    iterator::Signals,
};
use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// Calls on SIGINT and SIGTERM.
pub fn on_stop(call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    on(&[SIGINT, SIGTERM], call)
}

/// Calls on SIGUSR1.
pub fn on_usr1(call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    on(&[SIGUSR1], call)
}

/// Set on SIGINT and SIGTERM.
pub fn stop_flag() -> std::io::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let set = flag.clone();
    on_stop(move || set.store(true, Ordering::Release))?;
    Ok(flag)
}

fn on(signals: &[i32], call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    let mut signals = Signals::new(signals)?;
    std::thread::spawn(move || signals.forever().for_each(|_| call()));
    Ok(())
}
