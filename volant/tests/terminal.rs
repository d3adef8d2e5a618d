//! Commands on a terminal that is closed, and in the background of one.
#![allow(clippy::unwrap_used, clippy::panic, clippy::disallowed_methods)]

use bag::{BagWriter, Qos, Topic, WriteOptions};
use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    pty::{OpenptFlags, grantpt, ioctl_tiocgptpeer, openpt, unlockpt},
    termios::{Winsize, tcsetwinsize},
};
use std::{
    fs::File,
    io::Read,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};
use test_support::process::in_domain;
use volant_msgs::std_msgs::msg::String as Text;

const VOLANT: &str = env!("CARGO_BIN_EXE_volant");

/// A pseudo-terminal, and a program on it that leads its session; killed on drop.
struct Terminal {
    master: Option<File>,
    child: Child,
}

impl Terminal {
    fn start(command: &[&str]) -> Self {
        let flags = OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC;
        let master = openpt(flags).unwrap();
        grantpt(&master).unwrap();
        unlockpt(&master).unwrap();
        let size = Winsize { ws_row: 30, ws_col: 110, ws_xpixel: 0, ws_ypixel: 0 };
        tcsetwinsize(&master, size).unwrap();
        let slave = ioctl_tiocgptpeer(&master, flags).unwrap();
        let end = || Stdio::from(slave.try_clone().unwrap());
        let child = in_domain(98, "setsid")
            // The tests may run under nohup.
            .args(["--ctty", "env", "--default-signal=HUP"])
            .args(command)
            .stdin(end())
            .stdout(end())
            .stderr(end())
            .spawn()
            .unwrap();
        Self { master: Some(File::from(master)), child }
    }

    /// Waits until the program has written `text`.
    fn wait_for(&mut self, text: &str) {
        let deadline = Instant::now() + Duration::from_secs(20);
        let master = self.master.as_mut().unwrap();
        let (mut written, mut bytes) = (String::new(), [0; 4096]);
        while !written.contains(text) {
            assert!(Instant::now() < deadline, "no {text} in {written}");
            let second = Timespec { tv_sec: 1, tv_nsec: 0 };
            let mut readable = [PollFd::new(&*master, PollFlags::IN)];
            if poll(&mut readable, Some(&second)).unwrap() > 0 {
                let count = master.read(&mut bytes).unwrap();
                written += &String::from_utf8_lossy(&bytes[..count]);
            }
        }
    }

    /// Waits for the program's end; returns its exit status.
    fn status(&mut self) -> Option<i32> {
        let deadline = Instant::now() + Duration::from_secs(10);
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status.code();
            }
            assert!(Instant::now() < deadline, "it still runs");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn the_monitor_ends_when_its_terminal_is_closed_and_on_sigterm() {
    // Before, one in five was aborted by a panic.
    for _ in 0..10 {
        let mut closed = Terminal::start(&[VOLANT, "monitor"]);
        closed.wait_for("diagnostics");
        closed.master = None;
        // The signal ends it, or the error of its next frame.
        let status = closed.status();
        assert!(matches!(status, Some(0 | 1)), "{status:?}");
    }
    let mut ended = Terminal::start(&[VOLANT, "monitor"]);
    ended.wait_for("diagnostics");
    let id = ended.child.id().to_string();
    assert!(Command::new("kill").args(["-TERM", &id]).status().unwrap().success());
    assert_eq!(ended.status(), Some(0));
}

#[test]
fn a_player_in_the_background_is_not_stopped() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("run.mcap");
    let mut bag = BagWriter::create(&path, WriteOptions::default()).unwrap();
    let topic = bag.add_topic(Topic::of::<Text>("/text", &Qos::RELIABLE));
    bag.write_message(topic, 1, &Text::default()).unwrap();
    bag.finish().unwrap();
    let script = format!("{VOLANT} play {} & wait $!; echo ended: $?", path.display());
    // Job control: the command has a process group of its own.
    let mut shell = Terminal::start(&["sh", "-m", "-c", &script]);
    shell.wait_for("ended: 0");
}
