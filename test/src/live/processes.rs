//! The four nodes as processes, started from the command line and ended by SIGINT.

use anyhow::{Result, anyhow, bail, ensure};
pub use rustix::process::Signal;
use rustix::process::{Pid, kill_process};
use std::{
    collections::BTreeSet,
    fs::File,
    io,
    path::{Path, PathBuf},
    process::{Child, Command, ExitStatus, Stdio},
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};
use test_support::process;

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

/// Process ids of all nodes that were started and not waited for.
static RUNNING: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

fn running() -> MutexGuard<'static, BTreeSet<u32>> {
    RUNNING.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Kills all nodes that run, before this process ends without their [`Drop`].
pub fn kill_all() {
    for id in running().iter().filter_map(|id| Pid::from_raw(i32::try_from(*id).ok()?)) {
        // One that has ended is a zombie until it is waited for: its id belongs to no other.
        let _ = kill_process(id, Signal::KILL);
    }
}

#[derive(Debug)]
pub struct Node {
    /// Its executable's name.
    pub name: String,
    /// Log file: standard output and standard error.
    pub log: PathBuf,
    child: Child,
    arguments: Vec<String>,
    environment: Vec<(String, String)>,
    place: Option<String>,
    status: Option<ExitStatus>,
}

impl Node {
    /// Starts the executable `name` with `arguments` in the network namespace `place`, `None` for
    /// this process's; its output is appended to `folder`/`name`.log.
    pub fn start(
        place: Option<&str>,
        name: &str,
        arguments: &[String],
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
        let io = |error: io::Error| anyhow!("{name}: {error}");
        let log = folder.join(format!("{name}.log"));
        let out = File::options().create(true).append(true).open(&log).map_err(io)?;
        // `ip netns exec` becomes the node: the process id is the node's.
        let mut command = match place {
            None => Command::new(path),
            Some(place) => {
                let mut command = Command::new("ip");
                command.args(["netns", "exec", place]).arg(path);
                command
            }
        };
        let child = command
            .args(arguments)
            .envs(environment.iter().map(|(k, v)| (k, v)))
            .stdin(Stdio::null())
            .stdout(out.try_clone().map_err(io)?)
            .stderr(out)
            .spawn()
            .map_err(io)?;
        running().insert(child.id());
        Ok(Self {
            name: name.into(),
            log,
            child,
            arguments: arguments.to_vec(),
            environment: environment.to_vec(),
            place: place.map(str::to_owned),
            status: None,
        })
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Sends a signal by a system call, not by a `kill` process: a signal that arrives while a
    /// process is spawned (such as SIGCHLD) can interrupt RustDDS's threads in this process, which
    /// ends them.
    pub fn signal(&self, signal: Signal) -> Result<()> {
        let id = i32::try_from(self.id()).ok().and_then(Pid::from_raw);
        id.map_or(Ok(()), |id| kill_process(id, signal))
            .map_err(|error| anyhow!("{}: {error}", self.name))
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

    /// Restarts it with the same arguments after it ended.
    pub fn restart(&mut self) -> Result<()> {
        let folder = self.log.parent().unwrap_or(Path::new(".")).to_owned();
        let next = Self::start(
            self.place.as_deref(),
            &self.name,
            &self.arguments,
            &self.environment,
            &folder,
        )?;
        *self = next;
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
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        let _ = self.kill();
    }
}

#[derive(Debug, Default)]
pub struct Nodes(Vec<Node>);

/// A node that was asked to end is given this time, s.
const GRACE: u64 = 5;

impl Nodes {
    pub fn push(&mut self, node: Node) {
        self.0.push(node);
    }

    pub fn get(&mut self, name: &str) -> Option<&mut Node> {
        self.0.iter_mut().find(|n| n.name == name)
    }

    pub fn iter(&self) -> impl Iterator<Item = &Node> {
        self.0.iter()
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
