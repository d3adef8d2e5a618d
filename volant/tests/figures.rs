//! Measurements that need a quiet minute:
//! `cargo test --release -p volant --test figures -- --ignored --nocapture`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, clippy::disallowed_methods)]

use bag::recording::map_messages;
use std::{path::Path, time::Duration};
use tempfile::TempDir;
use test_support::process::{Running, example, in_domain};
use volant_msgs::{
    Message,
    sensor_msgs::msg::{Image, Imu},
};

const LONG: Duration = Duration::from_secs(20);

/// The numbers in the frame ids of a topic.
fn numbers<M: Message>(bag: &Path, topic: &str, frame: impl Fn(M) -> String) -> Vec<u64> {
    map_messages(bag, topic, |_, message| frame(message).parse().unwrap()).unwrap()
}

#[test]
#[ignore = "takes a minute on a quiet machine"]
fn a_minute_of_raw_images_and_samples_is_recorded_without_loss() {
    let (domain, seconds) = (85, 60);
    let dir = TempDir::new().unwrap();
    let bag = dir.path().join("bag");
    let mut recorder = Running::start(in_domain(domain, env!("CARGO_BIN_EXE_volant")).args([
        "record",
        "/image_raw",
        "/imu",
        "-o",
        bag.to_str().unwrap(),
    ]));
    std::thread::sleep(Duration::from_secs(1));
    let camera = ["--samples", "false"];
    let unit = ["--images", "false", "--ros-args", "-r", "__node:=unit"];
    let mut sources = [&camera[..], &unit[..]].map(|arguments| {
        Running::start(in_domain(domain, example("camera_and_unit")).args(arguments))
    });
    // The recorder discovers the topics.
    std::thread::sleep(Duration::from_secs(2));
    let before = recorder.processor_time();
    std::thread::sleep(Duration::from_secs(seconds));
    let used = (recorder.processor_time() - before).as_secs_f64() / seconds as f64;
    recorder.signal("INT");
    assert!(recorder.wait(LONG).success());
    for source in &mut sources {
        source.signal("INT");
        source.wait(LONG);
    }

    let images = numbers::<Image>(&bag, "/image_raw", |m| m.header.frame_id);
    let samples = numbers::<Imu>(&bag, "/imu", |m| m.header.frame_id);
    let lost = |numbers: &[u64]| numbers[numbers.len() - 1] - numbers[0] + 1 - numbers.len() as u64;
    eprintln!(
        "raw 640×480 for {seconds} s: {} images, {} lost; {} samples, {} lost; \
         the recorder used {:.1} % of a core",
        images.len(),
        lost(&images),
        samples.len(),
        lost(&samples),
        used * 100.0
    );
    assert!(images.len() as u64 >= 29 * seconds && samples.len() as u64 >= 390 * seconds);
    assert_eq!((lost(&images), lost(&samples)), (0, 0));
    assert!(used < 0.25, "{used}");
}
