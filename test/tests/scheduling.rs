//! Latency from an image's stamp to the odometry that contains it, beside processes that use all
//! processors: the nodes with and without real-time scheduling, in turns.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stdout, reason = "a test")]

use node_kit::environment::Network;
use std::{
    process::{Child, Command, Stdio},
    sync::Arc,
};
use volant_test::live::{ImageSequence, Run, Scenario, Site, quantile};

const DOMAIN: u16 = 86;
const SECONDS: f64 = 15.0;
const PAIRS: usize = 3;
const REAL_TIME: [&str; 3] = ["--realtime-priority", "20", "--lock-memory"];

/// Processes that use all processors, two for each, with the nice value 0 of the nodes.
struct Burners(Vec<Child>);

impl Burners {
    fn start() -> Self {
        let processors = std::thread::available_parallelism().map_or(1, usize::from);
        let burner = |_| {
            // Of this process they would inherit its real-time priority, and nothing else would
            // run; they end by themselves where this process is killed.
            let words = ["--other", "0", "timeout", "60", "sh", "-c", "while :; do :; done"];
            Command::new("chrt").args(words).stdin(Stdio::null()).spawn().unwrap()
        };
        Self((0..2 * processors).map(burner).collect())
    }
}

impl Drop for Burners {
    fn drop(&mut self) {
        for child in &mut self.0 {
            // `timeout` passes it on to the shell.
            let _ = Command::new("kill").arg(child.id().to_string()).status();
            let _ = child.wait();
        }
    }
}

/// Gives every thread of this process (camera, IMU and encoders of the simulated rig) a real-time
/// priority, after the nodes have started: a real camera does not compete for the processor.
fn hardware_first() -> bool {
    let id = std::process::id().to_string();
    let status = Command::new("chrt").args(["--all-tasks", "--fifo", "--pid", "40", &id]).status();
    status.is_ok_and(|status| status.success())
}

/// Latencies of one run, s.
fn latencies(scenario: &Scenario, images: &Arc<ImageSequence>, options: &[&str]) -> Vec<f64> {
    let network = Network { domain_id: DOMAIN, ..Network::default() };
    let node_options = options.iter().map(|&word| word.to_owned()).collect();
    let site = Site { node_options, ..Site::here(&network) };
    let folder = tempfile::tempdir().unwrap();
    let mut run = Run::start(scenario, Arc::clone(images), &site, folder.path()).unwrap();
    assert!(hardware_first());
    run.wait_for_pose(60.0).unwrap();
    let burners = Burners::start();
    let epoch = run.begin();
    run.play_until(SECONDS + 0.3, |_, _| {}).unwrap();
    drop(burners);
    let ended = run.finish().unwrap();
    let all = ended.received.latencies(epoch.plus_seconds(1.0), epoch.plus_seconds(SECONDS));
    // Back to the usual policy, which the next nodes inherit.
    let id = std::process::id().to_string();
    let status = Command::new("chrt").args(["--all-tasks", "--other", "--pid", "0", &id]).status();
    assert!(status.unwrap().success());
    all
}

#[test]
#[ignore = "minutes, on a machine without other work"]
fn real_time_priority_bounds_the_latency_under_load() {
    if !hardware_first() {
        test_support::skip("real-time priority needs root or CAP_SYS_NICE, and chrt");
        return;
    }
    let id = std::process::id().to_string();
    let status = Command::new("chrt").args(["--all-tasks", "--other", "--pid", "0", &id]).status();
    assert!(status.unwrap().success());
    let scenario = Scenario::swing(5, SECONDS).unwrap();
    let images = Arc::new(ImageSequence::render(&scenario, 2, |_, _| {}).unwrap());
    let (mut usual, mut real_time) = (Vec::new(), Vec::new());
    for pair in 0..PAIRS {
        for (name, options, all) in
            [("usual", &[][..], &mut usual), ("real-time", &REAL_TIME[..], &mut real_time)]
        {
            let these = latencies(&scenario, &images, options);
            println!("pair {pair}, {name}: {}", line(&these));
            all.extend(these);
        }
    }
    println!("all, usual:     {}", line(&usual));
    println!("all, real-time: {}", line(&real_time));
    assert!(quantile(&real_time, 0.999) < quantile(&usual, 0.999));
}

fn line(latencies: &[f64]) -> String {
    let [median, p99, p999] = [0.5, 0.99, 0.999].map(|share| 1e3 * quantile(latencies, share));
    let images = latencies.len();
    format!("{images} images, median {median:.1} ms, p99 {p99:.1} ms, p99.9 {p999:.1} ms")
}
