//! Processes of tests: read line by line, measured, and killed when the test ends.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "tests use it")]
#![allow(clippy::disallowed_methods, reason = "tests use it")]

use std::{
    ffi::OsStr,
    io::{BufRead, BufReader, Read, Write},
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    str::FromStr,
    sync::mpsc::{Receiver, channel},
    time::{Duration, Instant},
};

/// An example of the tested crate; cargo builds them with the tests.
pub fn example(name: &str) -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let folder = test.parent().and_then(Path::parent).unwrap();
    folder.join("examples").join(name)
}

/// Folder of the executables: `VOLANT_BIN`, else where this executable is (for a test, one above).
pub fn executables() -> PathBuf {
    if let Some(folder) = std::env::var_os("VOLANT_BIN") {
        return folder.into();
    }
    let own = std::env::current_exe().unwrap_or_default();
    let mut folder = own.parent().unwrap_or(Path::new(".")).to_owned();
    if folder.ends_with("deps") || folder.ends_with("examples") {
        folder.pop();
    }
    folder
}

/// A program in a DDS domain of this computer, without what the test's own environment sets.
pub fn in_domain(domain: u16, program: impl AsRef<OsStr>) -> Command {
    let mut command = Command::new(program);
    command
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .env_remove("ROS_LOCALHOST_ONLY")
        .env_remove("RMW_IMPLEMENTATION")
        .stdin(Stdio::null());
    command
}

/// Waits until `done`, for at most `within`; returns whether it was reached.
pub fn wait_until(within: Duration, mut done: impl FnMut() -> bool) -> bool {
    let deadline = Instant::now() + within;
    while !done() {
        if Instant::now() >= deadline {
            return false;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
    true
}

/// Resident memory of a process, kB; `None` if it has ended.
pub fn memory(id: u32) -> Option<u64> {
    status(id, "VmRSS:")
}

/// Number of threads of a process; `None` if it has ended.
pub fn threads(id: u32) -> Option<usize> {
    status(id, "Threads:")
}

/// The number in a line of `/proc/PID/status`.
fn status<T: FromStr>(id: u32, key: &str) -> Option<T> {
    let status = std::fs::read_to_string(format!("/proc/{id}/status")).ok()?;
    let line = status.lines().find(|l| l.starts_with(key))?;
    line.split_whitespace().nth(1)?.parse().ok()
}

/// Processor time of all threads of a process; `None` if it has ended.
fn processor_time(id: u32) -> Option<Duration> {
    let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).ok()?;
    let fields: Vec<&str> = stat.rsplit(')').next()?.split_whitespace().collect();
    let ticks = |i: usize| fields.get(i)?.parse::<u64>().ok();
    // utime and stime are fields 14 and 15 of the line, in ticks of 1/100 s on every Linux.
    Some(Duration::from_millis((ticks(11)? + ticks(12)?) * 10))
}

/// A process whose outputs are read line by line; killed with SIGKILL on drop.
pub struct Running {
    child: Child,
    lines: Receiver<String>,
}

impl Running {
    /// Starts a command.
    pub fn start(command: &mut Command) -> Self {
        let mut child = command
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap_or_else(|e| panic!("{}: {e}", command.get_program().display()));
        let (sender, lines) = channel();
        let outputs: [Box<dyn Read + Send>; 2] =
            [Box::new(child.stdout.take().unwrap()), Box::new(child.stderr.take().unwrap())];
        for output in outputs {
            let sender = sender.clone();
            std::thread::spawn(move || {
                for line in BufReader::new(output).lines().map_while(Result::ok) {
                    if sender.send(line).is_err() {
                        return;
                    }
                }
            });
        }
        Self { child, lines }
    }

    /// Writes a line to its standard input, which the command must have piped.
    pub fn write_line(&mut self, line: &str) {
        writeln!(self.child.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// The next line that contains `text`.
    pub fn line_with(&self, text: &str, within: Duration) -> String {
        self.line_with_all(&[text], within)
    }

    /// The next line that contains each of `texts`.
    pub fn line_with_all(&self, texts: &[&str], within: Duration) -> String {
        let deadline = Instant::now() + within;
        let mut before = Vec::new();
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            match self.lines.recv_timeout(left) {
                Ok(line) if texts.iter().all(|text| line.contains(text)) => return line,
                Ok(line) => before.push(line),
                Err(_) => panic!("no line with {texts:?} within {within:?}; there was {before:?}"),
            }
        }
    }

    /// Lines received so far.
    pub fn lines_so_far(&self) -> Vec<String> {
        self.lines.try_iter().collect()
    }

    /// Waits for its end, and returns its status and the lines that were not read yet.
    pub fn finish(mut self, within: Duration) -> (ExitStatus, Vec<String>) {
        let status = self.wait(within);
        // The channel closes when the readers have read everything.
        (status, self.lines.iter().collect())
    }

    /// Waits for its end; panics where it still runs after `within`.
    pub fn wait(&mut self, within: Duration) -> ExitStatus {
        let deadline = Instant::now() + within;
        loop {
            if let Some(status) = self.child.try_wait().unwrap() {
                return status;
            }
            assert!(Instant::now() < deadline, "it still runs after {within:?}");
            std::thread::sleep(Duration::from_millis(2));
        }
    }

    /// Waits until a signal ends it in order: the handler's thread runs.
    pub fn wait_for_signal_handler(&self) {
        let threads = format!("/proc/{}/task", self.id());
        let name = |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("comm")).ok();
        let handles = || {
            let mut tasks = std::fs::read_dir(&threads).unwrap();
            tasks.any(|task| task.ok().and_then(name).is_some_and(|name| name.trim() == "signals"))
        };
        assert!(wait_until(Duration::from_secs(20), handles), "it handles no signals");
    }

    /// Its process id.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends it a signal, such as `INT`.
    pub fn signal(&self, name: &str) {
        let pid = self.child.id().to_string();
        assert!(Command::new("kill").args(["-s", name, &pid]).status().unwrap().success());
    }

    /// Resident memory, kB.
    pub fn memory(&self) -> u64 {
        memory(self.id()).unwrap()
    }

    /// Number of threads.
    pub fn threads(&self) -> usize {
        threads(self.id()).unwrap()
    }

    /// Processor time of all threads.
    pub fn processor_time(&self) -> Duration {
        processor_time(self.id()).unwrap()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
        if std::thread::panicking() {
            self.lines_so_far().iter().for_each(|line| eprintln!("{line}"));
        }
    }
}
