//! Measurements that need a quiet minute:
//! `cargo test --release -p volant --test figures -- --ignored --nocapture`.
#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, clippy::disallowed_methods)]

use bag::recording::map_messages;
use std::{
    path::Path,
    process::{Child, Command, Stdio},
    time::Duration,
};
use tempfile::TempDir;
use volant_msgs::{
    Message,
    sensor_msgs::msg::{Image, Imu},
};

fn in_domain(domain: u8, program: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .env("ROS_DOMAIN_ID", domain.to_string())
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        .stdin(Stdio::null())
        .stdout(Stdio::null());
    command
}

fn example(name: &str) -> std::path::PathBuf {
    let test = std::env::current_exe().unwrap();
    test.parent().and_then(Path::parent).unwrap().join("examples").join(name)
}

/// CPU time of all threads.
fn processor_time(child: &Child) -> Duration {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", child.id())).unwrap();
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap().split_whitespace().collect();
    Duration::from_millis(
        (fields[11].parse::<u64>().unwrap() + fields[12].parse::<u64>().unwrap()) * 10,
    )
}

fn signal(child: &Child, name: &str) {
    assert!(
        Command::new("kill")
            .args(["-s", name, &child.id().to_string()])
            .status()
            .unwrap()
            .success()
    );
}

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
    let mut recorder = in_domain(domain, Path::new(env!("CARGO_BIN_EXE_volant")))
        .args(["record", "/image_raw", "/imu", "-o", bag.to_str().unwrap()])
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(Duration::from_secs(1));
    let camera = ["--samples", "false"];
    let unit = ["--images", "false", "--ros-args", "-r", "__node:=unit"];
    let mut sources = [&camera[..], &unit[..]].map(|arguments| {
        in_domain(domain, &example("camera_and_unit"))
            .args(arguments)
            .stderr(Stdio::null())
            .spawn()
            .unwrap()
    });
    // The recorder discovers the topics.
    std::thread::sleep(Duration::from_secs(2));
    let before = processor_time(&recorder);
    std::thread::sleep(Duration::from_secs(seconds));
    let used = (processor_time(&recorder) - before).as_secs_f64() / seconds as f64;
    signal(&recorder, "INT");
    assert!(recorder.wait().unwrap().success());
    for source in &mut sources {
        signal(source, "INT");
        source.wait().unwrap();
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
