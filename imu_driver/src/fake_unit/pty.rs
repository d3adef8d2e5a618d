//! The fake unit behind a pseudo-terminal, in real time: to a driver it is a serial port.

use super::{FakeUnit, FakeUnitConfig, Line, SentSample, Source};
use rig_model::Stamp;
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    fs::OFlags,
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr},
};
use std::{
    io,
    os::fd::OwnedFd,
    path::{Path, PathBuf},
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::JoinHandle,
    time::{Duration, SystemTime, UNIX_EPOCH},
};

type Action = Box<dyn FnOnce(&mut FakeUnit, Stamp) + Send>;

enum Command {
    Unplug,
    Replug,
    With(Action),
    Stop,
}

/// A fake unit on a pseudo-terminal, on its own thread. It ends when dropped.
///
/// The driver opens [`PtyUnit::path`], a symbolic link that points to the pseudo-terminal of the day: unplugging
/// removes it, plugging in makes a new one, as an adapter's does.
pub struct PtyUnit {
    link: PathBuf,
    commands: SyncSender<Command>,
    thread: Option<JoinHandle<()>>,
}

impl std::fmt::Debug for PtyUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("PtyUnit").field("link", &self.link).finish()
    }
}

impl PtyUnit {
    /// Starts a unit whose port appears as the symbolic link `link` (replaced where it is there). `source` is called on
    /// the unit's thread once per sample with the instant of measurement (system clock, ns since the Unix epoch).
    ///
    /// # Errors
    /// Where no pseudo-terminal can be had or the link cannot be made.
    pub fn start(config: FakeUnitConfig, link: impl Into<PathBuf>, source: Source) -> io::Result<Self> {
        let link = link.into();
        let port = Port::open(&link)?;
        let (commands, received) = sync_channel(64);
        let thread = std::thread::Builder::new().name("fake-imu".into()).spawn({
            let link = link.clone();
            move || run(FakeUnit::new(config, source, now()), Some(port), &link, &received)
        })?;
        Ok(Self { link, commands, thread: Some(thread) })
    }

    /// The port to open.
    pub fn path(&self) -> &Path {
        &self.link
    }

    /// Pulls the plug of the adapter: the port is gone, the unit runs on.
    pub fn unplug(&self) {
        let _ = self.commands.send(Command::Unplug);
    }

    /// Puts it in again.
    pub fn replug(&self) {
        let _ = self.commands.send(Command::Replug);
    }

    /// Runs something on the unit (on its thread) and returns what it gives; `None` if the thread is gone.
    pub fn with<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut FakeUnit, Stamp) -> T + Send + 'static,
    ) -> Option<T> {
        let (reply, result) = sync_channel(1);
        let command = Command::With(Box::new(move |unit, now| {
            let _ = reply.send(f(unit, now));
        }));
        self.commands.send(command).ok()?;
        result.recv().ok()
    }

    /// Samples sent since the last call.
    pub fn take_sent(&self) -> Vec<SentSample> {
        self.with(|unit, _| unit.take_sent()).unwrap_or_default()
    }
}

impl Drop for PtyUnit {
    fn drop(&mut self) {
        let _ = self.commands.send(Command::Stop);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(&self.link);
    }
}

struct Port {
    master: OwnedFd,
}

impl Port {
    fn open(link: &Path) -> io::Result<Self> {
        // Not inherited by a driver that is started from here: its copy would keep an unplugged port alive.
        let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&master)?;
        unlockpt(&master)?;
        // Raw before anybody opens it, or it would echo the unit's own bytes back.
        let mut termios = tcgetattr(&master)?;
        termios.make_raw();
        tcsetattr(&master, OptionalActions::Now, &termios)?;
        let flags = rustix::fs::fcntl_getfl(&master)?;
        rustix::fs::fcntl_setfl(&master, flags | OFlags::NONBLOCK)?;
        let name = ptsname(&master, Vec::new())?;
        let target = PathBuf::from(String::from_utf8_lossy(name.as_bytes()).into_owned());
        let _ = std::fs::remove_file(link);
        std::os::unix::fs::symlink(target, link)?;
        Ok(Self { master })
    }

    /// How the host has set the line: both ends of a pseudo-terminal share it.
    fn line(&self) -> Line {
        match tcgetattr(&self.master) {
            Ok(t) => {
                Line { baud: t.output_speed(), two_stop_bits: t.control_modes.contains(ControlModes::CSTOPB) }
            }
            Err(_) => Line { baud: 0, two_stop_bits: false },
        }
    }
}

/// What the kernel's buffers of a serial port hold while the host sleeps; a pseudo-terminal's hold 4 KiB only. What is
/// beyond is lost, as on a wire without flow control.
const BACKLOG: usize = 64 << 10;

fn write_out(port: &Port, backlog: &mut Vec<u8>) {
    while !backlog.is_empty() {
        match rustix::io::write(&port.master, backlog) {
            Ok(n) if n > 0 => drop(backlog.drain(..n.min(backlog.len()))),
            _ => return,
        }
    }
}

fn run(mut unit: FakeUnit, mut port: Option<Port>, link: &Path, commands: &Receiver<Command>) {
    let mut buffer = [0_u8; 4096];
    let mut backlog = Vec::new();
    let mut heard_before = false;
    loop {
        while let Ok(command) = commands.try_recv() {
            match command {
                Command::Unplug => {
                    let _ = std::fs::remove_file(link);
                    port = None;
                }
                Command::Replug => port = Port::open(link).ok(),
                Command::With(f) => f(&mut unit, now()),
                Command::Stop => return,
            }
        }
        let Some(open) = &port else {
            backlog.clear();
            let unheard = Line { baud: 0, two_stop_bits: false };
            while unit.poll(unheard, now()).is_some() {}
            std::thread::sleep(Duration::from_millis(2));
            continue;
        };
        let line = open.line();
        let mut heard = true;
        loop {
            match rustix::io::read(&open.master, &mut buffer) {
                Ok(n) if n > 0 => unit.handle(buffer.get(..n).unwrap_or_default(), line, now()),
                Err(rustix::io::Errno::IO) => {
                    // Nobody has the port open.
                    heard = false;
                    break;
                }
                _ => break,
            }
        }
        if heard && !heard_before {
            unit.opened(now());
        }
        heard_before = heard;
        while let Some(bytes) = unit.poll(line, now()) {
            if heard && backlog.len() < BACKLOG {
                backlog.extend_from_slice(&bytes);
            }
            write_out(open, &mut backlog);
            unit.note_written(now());
        }
        if heard {
            write_out(open, &mut backlog);
        } else {
            backlog.clear();
        }
        let wait = unit.next_deadline().map_or(0.01, |at| at.seconds_since(now())).clamp(0.0, 0.01);
        if heard {
            let timeout = Timespec { tv_sec: 0, tv_nsec: (wait * 1e9) as _ };
            let _ = poll(&mut [PollFd::new(&open.master, PollFlags::IN)], Some(&timeout));
        } else {
            std::thread::sleep(Duration::from_secs_f64(wait));
        }
    }
}

/// The system clock.
#[allow(clippy::disallowed_methods, reason = "the pseudo-terminal is a device: it lives in real time")]
pub fn now() -> Stamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
