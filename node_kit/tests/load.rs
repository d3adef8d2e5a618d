//! Resources of an idle node, and of a publisher whose subscriber is killed.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "tests")]

mod common;

use common::{Running, example, python};
use std::time::Duration;

const LONG: Duration = Duration::from_secs(20);

#[test]
fn an_idle_node_needs_little() {
    let node = Running::start(11, &example("minimal_node"), &["--beat", "0.1"], &[]);
    std::thread::sleep(Duration::from_secs(2));
    let before = node.processor_time();
    std::thread::sleep(Duration::from_secs(4));
    let used = node.processor_time() - before;
    let memory = node.memory();
    eprintln!("idle: {:.2} % of a core, {} MB", used.as_secs_f64() / 4.0 * 100.0, memory / 1024);
    assert!(used <= Duration::from_millis(40), "{used:?} in 4 s");
    assert!(memory < 40 * 1024, "{memory} kB");
}

#[test]
fn a_subscriber_killed_while_images_flow_costs_neither_memory_nor_time() {
    let Some(python) = python() else { return };
    for (domain, reliability) in [(12, "best_effort"), (13, "reliable")] {
        let setting = format!("qos_overrides./image.publisher.reliability:={reliability}");
        let source =
            Running::start(domain, &example("image_source"), &["--ros-args", "-p", &setting], &[]);
        let watcher = Running::peer(domain, &python, &["watch", "/image", "image", reliability]);
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
        let (longest, published, held_up) =
            (most("longest_us="), most("published="), most("held_up="));
        eprintln!(
            "{reliability}: {before} kB before, {after} kB after, longest publication {longest} \
             us, {held_up} of {published} blocked for more than 1 ms"
        );
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
