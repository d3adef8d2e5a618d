//! systemd's notification protocol and the scheduling options on real processes.
#![allow(clippy::disallowed_methods, reason = "a test that waits")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{minimal, start, timed};
use node_kit::{NodeContext, Process, environment::Network, scheduling::Scheduling};
use std::{
    os::{
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr, UnixDatagram},
    },
    path::{Path, PathBuf},
    time::{Duration, Instant},
};
use tempfile::TempDir;
use test_support::process::example;

/// Watchdog period of the tests, µs: a beat at least every 200 ms.
const PERIOD: &str = "400000";
const LONG: Duration = Duration::from_secs(20);

/// A service manager's socket.
struct Manager {
    socket: UnixDatagram,
    path: PathBuf,
}

impl Manager {
    fn new(folder: &TempDir) -> Self {
        let path = folder.path().join("notify");
        Self { socket: UnixDatagram::bind(&path).unwrap(), path }
    }

    /// The next signal, within `time`.
    fn signal(&self, time: Duration) -> Option<String> {
        self.socket.set_read_timeout(Some(time)).unwrap();
        let mut bytes = [0; 256];
        let length = self.socket.recv(&mut bytes).ok()?;
        Some(String::from_utf8_lossy(&bytes[..length]).into_owned())
    }

    /// Waits for a signal.
    fn wait_for(&self, signal: &str) {
        let deadline = Instant::now() + LONG;
        while self.signal(LONG).as_deref() != Some(signal) {
            assert!(Instant::now() < deadline, "no {signal}");
        }
    }

    /// Number of beats within `time`.
    fn beats(&self, time: Duration) -> usize {
        let deadline = Instant::now() + time;
        let mut beats = 0;
        while Instant::now() < deadline {
            let left = deadline.saturating_duration_since(Instant::now());
            let signal = self.signal(left.max(Duration::from_millis(1)));
            beats += usize::from(signal.as_deref() == Some("WATCHDOG=1"));
        }
        beats
    }
}

#[test]
fn a_node_reports_its_start_its_beats_and_its_end() {
    let folder = tempfile::tempdir().unwrap();
    let manager = Manager::new(&folder);
    let socket = manager.path.to_str().unwrap();
    let mut node = minimal(51, &[], &[("NOTIFY_SOCKET", socket), ("WATCHDOG_USEC", PERIOD)]);
    manager.wait_for("READY=1");
    let beats = manager.beats(Duration::from_secs(2));
    // 20 at most: four per period.
    assert!((8..=21).contains(&beats), "{beats}");
    node.signal("TERM");
    manager.wait_for("STOPPING=1");
    assert!(node.wait(Duration::from_secs(5)).success());
}

#[test]
fn an_abstract_socket_is_reached_and_without_a_watchdog_there_is_no_beat() {
    let name = format!("volant-abstract-{}", std::process::id());
    let address = SocketAddr::from_abstract_name(&name).unwrap();
    let manager =
        Manager { socket: UnixDatagram::bind_addr(&address).unwrap(), path: "/nowhere".into() };
    let socket = format!("@{name}");
    let environment = [("NOTIFY_SOCKET", &*socket), ("WATCHDOG_USEC", PERIOD)];
    let _node = minimal(52, &[], &environment[..1]);
    manager.wait_for("READY=1");
    assert_eq!(manager.beats(Duration::from_secs(1)), 0);
    // The watchdog of another process, such as a shell that started this one.
    let of_another = [environment[0], environment[1], ("WATCHDOG_PID", "1")];
    let _other = minimal(52, &[], &of_another);
    manager.wait_for("READY=1");
    assert_eq!(manager.beats(Duration::from_secs(1)), 0);
}

#[test]
fn a_socket_that_is_gone_is_reported_and_the_node_runs() {
    let node = minimal(53, &[], &[("NOTIFY_SOCKET", "/no/such/socket")]);
    let line = node.line_with("NOTIFY_SOCKET=/no/such/socket", LONG);
    assert!(line.contains("[WARN]"), "{line}");
}

/// File while which the node `hanging` hangs in its handler; names the process of the test below.
const HANGS: &str = "VOLANT_TEST_HANGS";

/// Two nodes, of which one hangs while the file exists.
fn process_with_a_node_that_hangs(file: PathBuf) {
    let network = Network { domain_id: 54, ..Network::default() };
    let mut process = Process::new(network).unwrap();
    let period = Duration::from_millis(20);
    timed(&mut process, "well", period, |_| Ok(|_: &mut NodeContext<()>| {}));
    timed(&mut process, "hanging", period, move |_| {
        let file = file.clone();
        Ok(move |_: &mut NodeContext<()>| {
            while file.exists() {
                std::thread::sleep(Duration::from_millis(10));
            }
        })
    });
    process.wait().unwrap();
}

#[test]
fn one_hanging_event_loop_stops_the_beat_of_its_process() {
    if let Some(file) = std::env::var_os(HANGS) {
        return process_with_a_node_that_hangs(file.into());
    }
    let folder = tempfile::tempdir().unwrap();
    let manager = Manager::new(&folder);
    let (socket, hangs) = (manager.path.to_str().unwrap(), folder.path().join("hangs"));
    let environment =
        [("NOTIFY_SOCKET", socket), ("WATCHDOG_USEC", PERIOD), (HANGS, hangs.to_str().unwrap())];
    let this = ["--exact", "one_hanging_event_loop_stops_the_beat_of_its_process"];
    let _process = start(54, &std::env::current_exe().unwrap(), &this, &environment);
    manager.wait_for("READY=1");
    let beats = manager.beats(Duration::from_secs(2));
    assert!(beats >= 8, "{beats}");
    std::fs::write(&hangs, "").unwrap();
    // The other node's loop runs on.
    std::thread::sleep(Duration::from_secs(1));
    while manager.signal(Duration::from_millis(1)).is_some() {}
    assert_eq!(manager.beats(Duration::from_secs(2)), 0);
    std::fs::remove_file(&hangs).unwrap();
    manager.wait_for("WATCHDOG=1");
}

/// Scheduling policy of each thread of a process (`man 5 proc`: field 41 of `stat`; 1 is FIFO).
fn policies(id: u32) -> Vec<String> {
    let tasks = std::fs::read_dir(Path::new("/proc").join(id.to_string()).join("task")).unwrap();
    // A thread may end between the listing and the reading.
    let stats =
        tasks.filter_map(|task| std::fs::read_to_string(task.ok()?.path().join("stat")).ok());
    stats
        .map(|stat| {
            let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
            format!("{} {}", fields[38], fields[37])
        })
        .collect()
}

#[test]
fn priority_affinity_and_memory_lock_hold_for_every_thread() {
    let scheduling = Scheduling { priority: Some(7), cpus: vec![0], lock_memory: true };
    // In a container root may lack CAP_SYS_NICE or processor 0: the system decides, not the user.
    if let Err(error) = std::thread::spawn(move || scheduling.apply()).join().unwrap() {
        test_support::skip(format!("not permitted here: {error}"));
        return;
    }
    let options = ["--realtime-priority", "7", "--cpus", "0", "--lock-memory"];
    let folder = tempfile::tempdir().unwrap();
    let manager = Manager::new(&folder);
    let node = minimal(55, &options, &[("NOTIFY_SOCKET", manager.path.to_str().unwrap())]);
    manager.wait_for("READY=1");
    let policies = policies(node.id());
    assert!(policies.len() >= 5 && policies.iter().all(|policy| policy == "1 7"), "{policies:?}");
    let status = std::fs::read_to_string(format!("/proc/{}/status", node.id())).unwrap();
    let value =
        |key| status.lines().find(|l| l.starts_with(key)).unwrap().split_whitespace().nth(1);
    assert_eq!(value("Cpus_allowed_list:"), Some("0"));
    assert!(value("VmLck:").unwrap().parse::<u64>().unwrap() > 1000, "{status}");
}

#[test]
fn what_the_system_does_not_permit_is_named_with_its_remedy() {
    if !rustix::process::geteuid().is_root() {
        test_support::skip("dropping privileges needs root");
        return;
    }
    let node = example("minimal_node");
    for (option, remedy) in
        [(&["--realtime-priority", "7"][..], "LimitRTPRIO=7"), (&["--lock-memory"], "LimitMEMLOCK")]
    {
        let mut words = vec!["--reuid=65534", "--regid=65534", "--clear-groups", "--"];
        words.push(node.to_str().unwrap());
        words.extend(option);
        let (status, lines) = start(56, Path::new("setpriv"), &words, &[]).finish(LONG);
        assert_eq!(status.code(), Some(1), "{lines:?}");
        assert!(lines.len() == 1 && lines[0].contains(remedy), "{lines:?}");
    }
}
