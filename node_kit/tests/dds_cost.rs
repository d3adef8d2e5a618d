//! Processor time of a rig's topics between two processes, compared in one run with Cyclone DDS's C
//! library: `make bench`. Needs Debian's cyclonedds-dev and cyclonedds-tools.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a measurement")]

mod common;

use common::start;
use std::{path::Path, process::Command, time::Duration};
use test_support::process::{Running, example};

const LONG: Duration = Duration::from_secs(20);
const SPAN: Duration = Duration::from_secs(10);

/// Rate, Hz; bytes; reliable: what crosses between the processes of a rig with 640×480 JPEG images.
const TOPICS: [(u32, u32, u8); 9] = [
    (30, 24_000, 0), // image
    (30, 1_100, 1),  // climber/markers
    (100, 330, 1),   // volant/imu/data
    (50, 150, 1),    // climber/joint_states
    (50, 160, 1),    // climber/transform
    (100, 720, 1),   // volant/odometry
    (100, 380, 1),   // volant/fused_pose
    (150, 130, 1),   // tf
    (10, 300, 1),    // volant/status
];

/// Builds `tests/cyclone/load.c`; a skip without the library.
fn cyclone(folder: &Path) -> Option<()> {
    let sources = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cyclone");
    let run = |program: &str, arguments: &[&str]| {
        Command::new(program).args(arguments).current_dir(folder).output().map(|o| {
            assert!(o.status.success(), "{program}: {}", String::from_utf8_lossy(&o.stderr));
        })
    };
    let idl = sources.join("load.idl");
    if run("idlc", &[idl.to_str().unwrap()]).is_err() {
        test_support::skip("no idlc: apt install cyclonedds-dev cyclonedds-tools");
        return None;
    }
    std::fs::rename(folder.join("load.c"), folder.join("types.c")).unwrap();
    let main = sources.join("load.c");
    run("cc", &["-O2", "-I.", main.to_str().unwrap(), "types.c", "-lddsc", "-o", "load"]).unwrap();
    Some(())
}

/// Share of a processor that source and sink take, and the share of the messages that arrive.
fn measure(source: &Running, sink: &Running) -> ([f64; 2], f64) {
    let received = || {
        let line = sink.line_with("received=", LONG);
        let number = line.split("received=").nth(1).unwrap().split_whitespace().next().unwrap();
        number.parse::<f64>().unwrap()
    };
    while received() == 0.0 {}
    let processes = [source, sink];
    let before = (received(), processes.map(Running::processor_time));
    let lines = SPAN.as_secs();
    let mut last = 0.0;
    for _ in 0..lines {
        last = received();
    }
    let after = processes.map(Running::processor_time);
    let due: u32 = TOPICS.iter().map(|t| t.0).sum();
    let used = [0, 1].map(|i| (after[i] - before.1[i]).as_secs_f64() / SPAN.as_secs_f64());
    (used, (last - before.0) / (f64::from(due) * SPAN.as_secs_f64()))
}

#[test]
#[ignore = "a measurement of a minute for a quiet machine: make bench"]
fn a_rigs_topics_beside_cyclone_dds() {
    let folder = tempfile::tempdir().unwrap();
    if cyclone(folder.path()).is_none() {
        return;
    }
    let own = example("dds_load");
    let list: Vec<String> = TOPICS
        .iter()
        .map(|(rate, size, reliable)| format!("{rate}.0, {size}.0, {reliable}.0"))
        .collect();
    let topics = format!("topics:=[{}]", list.join(", "));
    let theirs = folder.path().join("load");
    let words: Vec<String> =
        TOPICS.iter().flat_map(|t| [t.0.to_string(), t.1.to_string(), t.2.to_string()]).collect();
    let mut totals = [[0.0; 2]; 2];
    for turn in 0..2u16 {
        for (which, total) in totals.iter_mut().enumerate() {
            let domain = 160 + 2 * turn + which as u16;
            let role = |role: &str| {
                if which == 0 {
                    let source = format!("source:={}", role == "source");
                    let node = format!("__node:={role}");
                    let all = ["--ros-args", "-r", &node, "-p", &source, "-p", &topics];
                    return start(domain, &own, &all, &[]);
                }
                let mut all = vec![role];
                all.extend(words.iter().map(String::as_str));
                let uri = format!("<CycloneDDS><Domain Id=\"{domain}\"/></CycloneDDS>");
                start(domain, &theirs, &all, &[("CYCLONEDDS_URI", &uri)])
            };
            let (sink, source) = (role("sink"), role("source"));
            let (used, arrived) = measure(&source, &sink);
            println!(
                "{}: source {:.1} %, sink {:.1} % of a processor, {:.1} % of the messages arrive",
                ["RustDDS and node_kit", "Cyclone DDS in C"][which],
                used[0] * 1e2,
                used[1] * 1e2,
                arrived * 1e2
            );
            assert!((0.97..1.03).contains(&arrived), "{arrived}");
            for (total, used) in total.iter_mut().zip(used) {
                *total += used;
            }
        }
    }
    let [own, theirs] = totals.map(|t| t[0] + t[1]);
    println!("RustDDS and node_kit take {:.2} times the time of Cyclone DDS in C", own / theirs);
}
