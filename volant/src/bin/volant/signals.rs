//! Signals that a command handles itself.

use signal_hook::iterator::Signals;

/// Calls `call` on each of some signals.
pub fn on(signals: &[i32], call: impl Fn() + Send + 'static) -> std::io::Result<()> {
    let mut signals = Signals::new(signals)?;
    std::thread::spawn(move || signals.forever().for_each(|_| call()));
    Ok(())
}
