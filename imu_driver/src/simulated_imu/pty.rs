//! Simulated IMU on a pseudo-terminal in real time, which a driver opens as a serial port.

use super::{Line, SentSample, SimulatedImu, SimulatedImuConfig, Source};
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

type Action = Box<dyn FnOnce(&mut SimulatedImu, Stamp) + Send>;

enum Command {
    Unplug,
    Replug,
    With(Action),
    Stop,
}

/// Simulated IMU on a pseudo-terminal with a thread of its own, which ends on drop.
///
/// The driver opens [`PtyImu::path`], a symbolic link to the current pseudo-terminal: unplugging
/// removes it, plugging in creates another one, as with a USB adapter.
pub struct PtyImu {
    link: PathBuf,
    commands: SyncSender<Command>,
    thread: Option<JoinHandle<()>>,
}

impl PtyImu {
    /// Starts a simulated IMU whose port is the symbolic link `link`, which is replaced if it
    /// exists.
    ///
    /// `source` is called on the thread of the IMU once per sample with the time of measurement
    /// (system clock).
    ///
    /// # Errors
    /// The pseudo-terminal, the link or the thread cannot be created.
    pub fn start(
        config: SimulatedImuConfig,
        link: impl Into<PathBuf>,
        source: Source,
    ) -> io::Result<Self> {
        let link = link.into();
        let port = open_port(&link)?;
        let (commands, received) = sync_channel(64);
        let thread = std::thread::Builder::new().name("simulated-imu".into()).spawn({
            let link = link.clone();
            move || run(SimulatedImu::new(config, source, now()), port, &link, &received)
        })?;
        Ok(Self { link, commands, thread: Some(thread) })
    }

    /// Path of the port.
    pub fn path(&self) -> &Path {
        &self.link
    }

    /// Unplugs the adapter: the port disappears, the IMU continues.
    pub fn unplug(&self) {
        let _ = self.commands.send(Command::Unplug);
    }

    /// Plugs the adapter in again.
    pub fn replug(&self) {
        let _ = self.commands.send(Command::Replug);
    }

    /// Calls `f` on the thread of the IMU and returns its result; `None` if the thread has ended.
    pub fn with<T: Send + 'static>(
        &self,
        f: impl FnOnce(&mut SimulatedImu, Stamp) -> T + Send + 'static,
    ) -> Option<T> {
        let (reply, result) = sync_channel(1);
        let command = Command::With(Box::new(move |imu, now| {
            let _ = reply.send(f(imu, now));
        }));
        self.commands.send(command).ok()?;
        result.recv().ok()
    }

    /// Samples sent since the last call.
    pub fn take_sent(&self) -> Vec<SentSample> {
        self.with(|imu, _| imu.take_sent()).unwrap_or_default()
    }
}

impl Drop for PtyImu {
    fn drop(&mut self) {
        let _ = self.commands.send(Command::Stop);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        let _ = std::fs::remove_file(&self.link);
    }
}

/// Opens a pseudo-terminal whose other end is the symbolic link `link`.
fn open_port(link: &Path) -> io::Result<OwnedFd> {
    // Not inherited by child processes, whose copy would keep an unplugged port open.
    let port = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&port)?;
    unlockpt(&port)?;
    // Raw before it is opened; otherwise it would echo the bytes of the IMU.
    let mut termios = tcgetattr(&port)?;
    termios.make_raw();
    tcsetattr(&port, OptionalActions::Now, &termios)?;
    let flags = rustix::fs::fcntl_getfl(&port)?;
    rustix::fs::fcntl_setfl(&port, flags | OFlags::NONBLOCK)?;
    let name = ptsname(&port, Vec::new())?;
    let target = PathBuf::from(String::from_utf8_lossy(name.as_bytes()).into_owned());
    let _ = std::fs::remove_file(link);
    std::os::unix::fs::symlink(target, link)?;
    Ok(port)
}

/// Line settings of the host, which both ends of a pseudo-terminal share.
fn line_of(port: &OwnedFd) -> Line {
    tcgetattr(port).map_or(Line::CLOSED, |termios| Line {
        baud: termios.output_speed(),
        two_stop_bits: termios.control_modes.contains(ControlModes::CSTOPB),
    })
}

/// Size of the kernel's buffers of a serial port, bytes (a pseudo-terminal has 4 KiB only); bytes
/// beyond are lost, as on a line without flow control.
const BACKLOG: usize = 64 << 10;

fn write_out(port: &OwnedFd, backlog: &mut Vec<u8>) {
    while !backlog.is_empty() {
        match rustix::io::write(port, backlog) {
            Ok(n) if n > 0 => drop(backlog.drain(..n.min(backlog.len()))),
            _ => return,
        }
    }
}

fn run(mut imu: SimulatedImu, port: OwnedFd, link: &Path, commands: &Receiver<Command>) {
    let mut port = Some(port);
    let mut buffer = [0_u8; 4096];
    let mut backlog = Vec::new();
    let mut was_open = false;
    loop {
        while let Ok(command) = commands.try_recv() {
            match command {
                Command::Unplug => {
                    let _ = std::fs::remove_file(link);
                    port = None;
                }
                Command::Replug => port = open_port(link).ok(),
                Command::With(f) => f(&mut imu, now()),
                Command::Stop => return,
            }
        }
        let Some(open) = &port else {
            backlog.clear();
            while imu.poll(Line::CLOSED, now()).is_some() {}
            std::thread::sleep(Duration::from_millis(2));
            continue;
        };
        let line = line_of(open);
        let mut open_by_host = true;
        loop {
            match rustix::io::read(open, &mut buffer) {
                Ok(n) if n > 0 => imu.handle(buffer.get(..n).unwrap_or_default(), line, now()),
                Err(rustix::io::Errno::IO) => {
                    // The port is not open.
                    open_by_host = false;
                    break;
                }
                _ => break,
            }
        }
        if open_by_host && !was_open {
            imu.opened(now());
        }
        was_open = open_by_host;
        while let Some(bytes) = imu.poll(line, now()) {
            if open_by_host && backlog.len() < BACKLOG {
                backlog.extend_from_slice(&bytes);
            }
            write_out(open, &mut backlog);
        }
        if open_by_host {
            write_out(open, &mut backlog);
        } else {
            backlog.clear();
        }
        let wait = imu.next_deadline().map_or(0.01, |at| at.seconds_since(now())).clamp(0.0, 0.01);
        if open_by_host {
            let timeout = Timespec { tv_sec: 0, tv_nsec: (wait * 1e9) as _ };
            let _ = poll(&mut [PollFd::new(open, PollFlags::IN)], Some(&timeout));
        } else {
            std::thread::sleep(Duration::from_secs_f64(wait));
        }
    }
}

/// The system clock.
#[allow(
    clippy::disallowed_methods,
    reason = "the pseudo-terminal is a device: it lives in real time"
)]
pub fn now() -> Stamp {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Stamp::from_nanos(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
}
