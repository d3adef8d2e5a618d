//! Resources of an idle node, of a reliable topic, and of a publisher whose subscriber is killed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{listen, minimal, peer, python, start, timed};
use node_kit::{NodeContext, Process, QosPreset, environment::Network};
use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};
use test_support::process::example;
use volant_msgs::std_msgs::msg::Header;

const LONG: Duration = Duration::from_secs(20);

#[test]
#[ignore = "measures time: make long"]
fn an_idle_node_needs_little() {
    let node = minimal(11, &["--beat", "0.1"], &[]);
    std::thread::sleep(Duration::from_secs(2));
    let before = node.processor_time();
    std::thread::sleep(Duration::from_secs(4));
    let used = node.processor_time() - before;
    let memory = node.memory();
    assert!(used <= Duration::from_millis(40), "{used:?} in 4 s");
    assert!(memory < 40 * 1024, "{memory} kB");
}

#[test]
#[ignore = "measures time: make long"]
fn a_subscriber_killed_while_images_flow_costs_neither_memory_nor_time() {
    let Some(python) = python() else { return };
    for (domain, reliability) in [(12, "best_effort"), (13, "reliable")] {
        let setting = format!("qos_overrides./image.publisher.reliability:={reliability}");
        let source = start(domain, &example("image_source"), &["--ros-args", "-p", &setting], &[]);
        let watcher = peer(domain, &python, &["watch", "/image", "image", reliability]);
        watcher.line_with("first", LONG);
        source.line_with("subscribers=1", LONG);
        std::thread::sleep(Duration::from_millis(500));
        let before = source.memory();
        // Kills with SIGKILL.
        drop(watcher);
        std::thread::sleep(Duration::from_secs(4));
        let after = source.memory();
        let lines = source.lines_so_far();
        let number = |line: &str, name: &str| {
            line.split(name).nth(1)?.split(' ').next()?.parse::<u64>().ok()
        };
        let most = |name| lines.iter().filter_map(|l| number(l, name)).max().unwrap();
        let (published, held_up) = (most("published="), most("held_up="));
        assert!(after < before + 50 * 1024, "{reliability}: {before} -> {after} kB");
        // A publisher that waited for the killed subscriber would be blocked by each of the hundred
        // images since. Time ready to run does not count as blocked; a lock whose holder is
        // preempted does, so a few may be held up.
        assert!(
            published > 100 && held_up * 20 <= published,
            "{reliability}: {held_up} of {published} blocked"
        );
    }
}

/// Wake-ups of the middleware's event loops of this process.
fn wake_ups() -> u64 {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap().filter_map(Result::ok);
    tasks
        .filter_map(|task| {
            let name = std::fs::read_to_string(task.path().join("comm")).ok()?;
            let status = std::fs::read_to_string(task.path().join("status")).ok()?;
            let count = status.lines().find_map(|l| l.strip_prefix("voluntary_ctxt_switches:"))?;
            name.starts_with("RustDDS Partici").then(|| count.trim().parse::<u64>().ok())?
        })
        .sum()
}

#[test]
fn a_reliable_message_wakes_each_event_loop_about_once() {
    let network = || Network { domain_id: 14, ..Network::default() };
    let (sent, received) = (Arc::<AtomicU64>::default(), Arc::<AtomicU64>::default());
    let mut listener = Process::new(network()).unwrap();
    let count = Arc::clone(&received);
    listen::<Header, _>(&mut listener, "listener", "talk", QosPreset::Measurement, move || {
        let count = Arc::clone(&count);
        move |_: Arc<Header>| {
            count.fetch_add(1, Ordering::Relaxed);
        }
    });
    let mut talker = Process::new(network()).unwrap();
    let count = Arc::clone(&sent);
    // 200 messages per second on a reliable topic.
    timed(&mut talker, "talker", Duration::from_millis(5), move |context| {
        let talk = context.advertise::<Header>("talk", QosPreset::Measurement)?;
        let count = Arc::clone(&count);
        Ok(move |_: &mut NodeContext<()>| {
            talk.publish(Header::default());
            count.fetch_add(1, Ordering::Relaxed);
            assert_eq!(talk.refused(), 0);
        })
    });
    std::thread::sleep(Duration::from_secs(3));
    let counts = || [&sent, &received].map(|c| c.load(Ordering::Relaxed));
    let (before, woken) = (counts(), wake_ups());
    std::thread::sleep(Duration::from_secs(3));
    let (after, woken) = (counts(), wake_ups() - woken);
    let [sent, received] = [0, 1].map(|i| after[i] - before[i]);
    let per_message = woken as f64 / sent as f64;
    assert!(sent > 200 && sent.abs_diff(received) < 50, "{received} of {sent}");
    // One to send and one to receive, and some for discovery. With an ACKNACK to each message it
    // is twice as many, and with the loops waking themselves more.
    assert!(per_message < 3.0, "{per_message}");
}
