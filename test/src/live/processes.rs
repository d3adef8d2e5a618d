//! The four nodes as processes, started from the command line and ended by SIGINT.

use anyhow::{Result, anyhow, bail, ensure};
pub use rustix::process::Signal;
use rustix::process::{Pid, WaitOptions, kill_process, waitpid};
use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs::File,
    io,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use test_support::process;
pub use test_support::process::executables;

/// All processes that were started and not waited for, with their time to end by SIGINT.
static RUNNING: Mutex<BTreeMap<u32, Duration>> = Mutex::new(BTreeMap::new());
/// How often the end of a process is looked for.
const STEP: Duration = Duration::from_millis(10);

fn running() -> MutexGuard<'static, BTreeMap<u32, Duration>> {
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

fn send(id: u32, signal: Signal) -> io::Result<()> {
    // One that has ended is a zombie until it is waited for: its id belongs to no other.
    let id = Pid::from_raw(id.cast_signed());
    id.map_or(Ok(()), |id| kill_process(id, signal).map_err(io::Error::from))
}

/// Ends all processes that run, before this one ends without their [`Drop`].
pub fn end_all() {
    let all = {
        // Held while the signals are sent: meanwhile no other thread waits for one of them, after
        // which its id could be that of another process.
        let running = running();
        for (id, grace) in running.iter() {
            let _ = send(*id, if grace.is_zero() { Signal::KILL } else { Signal::INT });
        }
        running.clone()
    };
    for (id, grace) in all {
        let mut left = grace;
        while !left.is_zero()
            && matches!(waitpid(Pid::from_raw(id.cast_signed()), WaitOptions::NOHANG), Ok(None))
        {
            std::thread::sleep(STEP);
            left = left.saturating_sub(STEP);
        }
    }
}

/// A node, or another program, as a process. It ends when this drops.
#[derive(Debug)]
pub struct Node {
    pub name: String,
    /// Log file: standard output and standard error.
    pub log: PathBuf,
    command: Command,
    child: Child,
    /// Time to end by SIGINT when this drops; zero: it is killed at once.
    grace: Duration,
    status: Option<ExitStatus>,
}

impl Node {
    /// Starts the executable `name` with `arguments` in the network namespace `place`, `None` for
    /// this process's; its output is appended to `folder`/`name`.log.
    pub fn start(
        place: Option<&str>,
        name: &str,
        arguments: &[impl AsRef<OsStr>],
        environment: &[(String, String)],
        folder: &Path,
    ) -> Result<Self> {
        let path = executables().join(name);
        ensure!(
            path.is_file(),
            "{name}: no executable at {}; build it with `cargo build --release --workspace \
             --bins`, or name its folder in VOLANT_BIN",
            path.display()
        );
        // `ip netns exec` becomes the node: the process id is the node's.
        let mut command = match place {
            None => Command::new(path),
            Some(place) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", place]).arg(path);
                command
            }
        };
        command.args(arguments).envs(environment.iter().map(|(k, v)| (k, v)));
        Self::spawn(name, command, folder, Duration::ZERO)
    }

    /// Starts a command; its output is appended to `folder`/`name`.log. When this drops, it is
    /// interrupted and killed after `grace`.
    pub fn spawn(name: &str, mut command: Command, folder: &Path, grace: Duration) -> Result<Self> {
        let io = |error: io::Error| anyhow!("{name}: {error}");
        let log = folder.join(format!("{name}.log"));
        let out = File::options().create(true).append(true).open(&log).map_err(io)?;
        command.stdin(Stdio::null()).stdout(out.try_clone().map_err(io)?).stderr(out);
        let child = command.spawn().map_err(io)?;
        running().insert(child.id(), grace);
        Ok(Self { name: name.into(), log, command, child, grace, status: None })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal by a system call, not by a `kill` process: a signal that arrives while a
    /// process is spawned (such as SIGCHLD) can interrupt RustDDS's threads in this process, which
    /// ends them.
    pub fn signal(&self, signal: Signal) -> Result<()> {
        send(self.id(), signal).map_err(|error| anyhow!("{}: {error}", self.name))
    }

    /// How it ended, if it did.
    pub fn ended(&mut self) -> Option<ExitStatus> {
        if self.status.is_none() {
            let mut running = running();
            self.status = self.child.try_wait().ok().flatten();
            if self.status.is_some() {
                running.remove(&self.child.id());
            }
        }
        self.status
    }

    /// Kills it, as `kill -9` does.
    pub fn kill(&mut self) -> Result<()> {
        if self.ended().is_none() {
            let io = |error: io::Error| anyhow!("{}: {error}", self.name);
            self.child.kill().map_err(io)?;
            let mut running = running();
            self.status = Some(self.child.wait().map_err(io)?);
            running.remove(&self.child.id());
        }
        Ok(())
    }

    /// Restarts it with the same arguments; kills it before where it has not ended.
    pub fn restart(&mut self) -> Result<()> {
        self.kill()?;
        self.child = self.command.spawn().map_err(|error| anyhow!("{}: {error}", self.name))?;
        running().insert(self.child.id(), self.grace);
        self.status = None;
        Ok(())
    }

    /// Resident memory, bytes; 0 if it is unknown.
    pub fn resident_bytes(&self) -> u64 {
        process::memory(self.id()).unwrap_or(0) * 1024
    }

    /// Number of threads; 0 if it is unknown.
    pub fn threads(&self) -> usize {
        process::threads(self.id()).unwrap_or(0)
    }

    #[allow(clippy::disallowed_methods)] // a shell: it waits for a process
    fn wait_until(&mut self, deadline: Instant) -> Option<ExitStatus> {
        loop {
            if let Some(status) = self.ended() {
                return Some(status);
            }
            if Instant::now() >= deadline {
                return None;
            }
            std::thread::sleep(STEP);
        }
    }
}

impl Drop for Node {
    #[allow(clippy::disallowed_methods)] // a shell: it waits for a process
    fn drop(&mut self) {
        if !self.grace.is_zero() && self.ended().is_none() {
            let _ = self.signal(Signal::INT);
            self.wait_until(Instant::now() + self.grace);
        }
        let _ = self.kill();
    }
}

#[derive(Debug, Default)]
pub struct Nodes(pub Vec<Node>);

/// A node that was asked to end is given this time, s.
const GRACE: u64 = 5;

impl Nodes {
    pub fn get(&mut self, name: &str) -> Option<&mut Node> {
        self.0.iter_mut().find(|n| n.name == name)
    }

    /// Fails with the first one that has ended.
    pub fn check(&mut self) -> Result<()> {
        for node in &mut self.0 {
            if let Some(status) = node.ended() {
                let (name, log) = (&node.name, node.log.display());
                bail!("{name} ended with {status} in mid-run; its last words are in {log}");
            }
        }
        Ok(())
    }

    /// Ends all of them by SIGINT and returns the exit status of each; where one hangs, the others
    /// are ended all the same.
    #[allow(clippy::disallowed_methods)] // a shell: it waits for processes
    pub fn stop(mut self) -> Result<Vec<(String, ExitStatus)>> {
        for node in &self.0 {
            node.signal(Signal::INT)?;
        }
        let deadline = Instant::now() + Duration::from_secs(GRACE);
        let mut ends = Vec::new();
        let mut hanging = None;
        for node in &mut self.0 {
            match node.wait_until(deadline) {
                Some(status) => ends.push((node.name.clone(), status)),
                None => {
                    hanging = Some(anyhow!(
                        "{} did not end within {GRACE} s of SIGINT and was killed; see {}",
                        node.name,
                        node.log.display()
                    ));
                }
            }
        }
        hanging.map_or(Ok(ends), Err)
    }
}
