//! systemd's notification protocol (sd_notify): `READY=1` after the start, `WATCHDOG=1` while every
//! event loop of the process runs, `STOPPING=1` at the end.
//!
//! The beat is sent by the event loops themselves, not by a thread of its own: a node that hangs in
//! its handler stops the beat, and systemd restarts the process after `WatchdogSec`.

use super::logger::Logger;
use crate::{inbox::now, level::Level};
use parking_lot::Mutex;
use std::{
    collections::BTreeMap,
    io,
    os::{
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr, UnixDatagram},
    },
    sync::Arc,
    time::{Duration, Instant},
};

/// Beats per watchdog period; systemd asks for at least two.
const BEATS: u32 = 4;

/// The service manager of this process, if there is one.
pub(crate) struct Supervisor {
    socket: Option<UnixDatagram>,
    /// Longest time between the passes of an event loop; `None` without a watchdog.
    interval: Option<Duration>,
    loops: Mutex<Loops>,
}

struct Loops {
    last_beat: Instant,
    /// Whether each event loop ran since the last beat, by its number.
    ran: BTreeMap<u64, bool>,
    next: u64,
}

impl Supervisor {
    /// Connects to the service manager that the environment names: `NOTIFY_SOCKET`,
    /// `WATCHDOG_USEC` and `WATCHDOG_PID`. A socket that cannot be reached is logged and ignored.
    pub fn from_environment(log: &Logger) -> Arc<Self> {
        let variable = |name| std::env::var(name).ok().filter(|text| !text.is_empty());
        let socket = variable("NOTIFY_SOCKET").and_then(|name| match connect(&name) {
            Ok(socket) => Some(socket),
            Err(error) => {
                log.log(
                    Level::Warn,
                    format!("NOTIFY_SOCKET={name}: {error}; the service manager gets no signals"),
                );
                None
            }
        });
        let of_another =
            variable("WATCHDOG_PID").is_some_and(|pid| pid.parse() != Ok(std::process::id()));
        let period = variable("WATCHDOG_USEC")
            .and_then(|text| text.parse().ok())
            .filter(|us| *us > 0 && socket.is_some() && !of_another)
            .map(Duration::from_micros);
        Arc::new(Self {
            socket,
            interval: period.map(|period| period / BEATS),
            loops: Mutex::new(Loops { last_beat: now(), ran: BTreeMap::new(), next: 0 }),
        })
    }

    /// Adds an event loop, which must pass for every beat until its handle drops.
    pub fn add_loop(self: &Arc<Self>) -> EventLoop {
        let mut loops = self.loops.lock();
        let number = loops.next;
        loops.next += 1;
        loops.ran.insert(number, false);
        EventLoop { supervisor: Arc::clone(self), number }
    }

    /// Sends a notification to the service manager.
    pub fn send(&self, text: &str) {
        if let Some(socket) = &self.socket {
            // The manager may be gone or busy; a missing beat is what it watches for.
            let _ = socket.send(text.as_bytes());
        }
    }
}

/// An event loop under the watchdog.
pub(crate) struct EventLoop {
    supervisor: Arc<Supervisor>,
    number: u64,
}

impl EventLoop {
    /// Longest time that the loop may wait; `None` without a watchdog.
    pub fn interval(&self) -> Option<Duration> {
        self.supervisor.interval
    }

    /// Notes a pass of the loop. The last loop to pass sends the beat.
    pub fn passed(&self) {
        let Some(interval) = self.supervisor.interval else { return };
        let mut loops = self.supervisor.loops.lock();
        loops.ran.insert(self.number, true);
        let now = now();
        if now.duration_since(loops.last_beat) >= interval && loops.ran.values().all(|ran| *ran) {
            loops.last_beat = now;
            loops.ran.values_mut().for_each(|ran| *ran = false);
            self.supervisor.send("WATCHDOG=1");
        }
    }
}

impl Drop for EventLoop {
    fn drop(&mut self) {
        self.supervisor.loops.lock().ran.remove(&self.number);
    }
}

/// Connects to a socket by its path, or by its abstract name after an `@`.
fn connect(name: &str) -> io::Result<UnixDatagram> {
    let socket = UnixDatagram::unbound()?;
    match name.strip_prefix('@') {
        Some(name) => socket.connect_addr(&SocketAddr::from_abstract_name(name)?)?,
        None => socket.connect(name)?,
    }
    // The event loop never waits for the manager.
    socket.set_nonblocking(true)?;
    Ok(socket)
}
