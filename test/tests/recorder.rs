//! Interruptions of a recorder: the system's clock is set back, its process is stopped and
//! continued. RustDDS receives nothing after either; the recording continues.
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test")]

use bag::{BagWriter, Qos, Topic, WriteOptions, recording::map_messages};
use rig_model::topics;
use std::{path::Path, process::Command, time::Duration};
use test_support::process::{Running, in_domain};
use volant_msgs::sensor_msgs::msg::Imu;
use volant_test::live::{SettableClock, processes::executables};

const RATE: u64 = 50;
const SECONDS: u64 = 7;
const LONG: Duration = Duration::from_secs(60);
const TOPIC: &str = topics::absolute::IMU;

/// Samples that carry their number.
fn bag(path: &Path) {
    let mut bag = BagWriter::create(path, WriteOptions::default()).unwrap();
    let topic = bag.add_topic(Topic::of::<Imu>(TOPIC, &Qos::RELIABLE));
    for i in 0..RATE * SECONDS {
        let mut sample = Imu::default();
        sample.linear_acceleration.z = i as f64;
        bag.write_message(topic, 1_760_000_000_000_000_000 + i * (1_000_000_000 / RATE), &sample)
            .unwrap();
    }
    bag.finish().unwrap();
}

fn numbers(path: &Path) -> Vec<u64> {
    let number = |_, sample: Imu| sample.linear_acceleration.z as u64;
    let mut numbers = map_messages(path, TOPIC, number).unwrap();
    // A bag is read by the time of receipt, and that was set back.
    numbers.sort_unstable();
    numbers
}

fn volant(domain: u16, arguments: &[&str]) -> Command {
    let mut command = in_domain(domain, executables().join("volant"));
    command.args(arguments);
    command
}

/// Records what is played for seven seconds, with an interruption after about three of them.
/// Returns the recorded numbers and what the recorder printed.
fn recorded(
    domain: u16,
    clock: Option<&SettableClock>,
    interrupt: impl FnOnce(&Running),
) -> (Vec<u64>, String) {
    let folder = tempfile::tempdir().unwrap();
    let (original, copy) = (folder.path().join("original.mcap"), folder.path().join("copy.mcap"));
    bag(&original);
    let mut recorder = volant(domain, &["record", TOPIC, "-o", copy.to_str().unwrap()]);
    recorder.envs(clock.iter().flat_map(|clock| clock.environment()));
    let recorder = Running::start(&mut recorder);
    let mut player =
        Running::start(&mut volant(domain, &["play", original.to_str().unwrap(), "--delay", "2"]));
    std::thread::sleep(Duration::from_secs(5));
    interrupt(&recorder);
    assert!(player.wait(LONG).success());
    std::thread::sleep(Duration::from_millis(300));
    recorder.signal("INT");
    let (status, lines) = recorder.finish(LONG);
    let stderr = lines.join("\n");
    assert!(status.success(), "{stderr}");
    (numbers(&copy), stderr)
}

/// From the first to the last, but for what was published until the recorder was back.
fn check(numbers: &[u64], stderr: &str, words: &str) {
    let missing = RATE * SECONDS - numbers.len() as u64;
    assert_eq!(
        (numbers.first(), numbers.last()),
        (Some(&0), Some(&(RATE * SECONDS - 1))),
        "{stderr}"
    );
    assert!(numbers.windows(2).all(|w| w[0] < w[1]), "one came twice");
    assert!(missing < 2 * RATE, "{missing}");
    assert!(stderr.contains(words), "{stderr}");
}

#[test]
fn a_clock_that_is_set_back_does_not_end_a_recording() {
    let folder = tempfile::tempdir().unwrap();
    let clock = match SettableClock::new(folder.path()) {
        Ok(clock) => clock,
        Err(reason) => return test_support::skip(reason),
    };
    let (numbers, stderr) = recorded(93, Some(&clock), |_| clock.set(-3600.0).unwrap());
    check(&numbers, &stderr, "the system's clock was set back by 3600");
}

#[test]
fn a_stopped_and_continued_recorder_goes_on() {
    let (numbers, stderr) = recorded(94, None, |recorder| {
        recorder.signal("STOP");
        std::thread::sleep(Duration::from_millis(300));
        recorder.signal("CONT");
    });
    // It is not always that RustDDS notices; where it does not, nothing is missing.
    let words = if numbers.len() as u64 == RATE * SECONDS { "" } else { "joined again" };
    check(&numbers, &stderr, words);
}
