//! A camera that sends JPEGs with hundreds of scans, over DDS to a live marker_tracker.
#![allow(clippy::disallowed_methods, reason = "a test that waits")]
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "a test")]

use node_kit::{NodeContext, NodeError, Process, QosPreset, convert, environment::Network};
use rig_model::{Stamp, topics};
use std::{
    collections::HashSet,
    sync::{Arc, mpsc},
    time::{Duration, Instant},
};
use volant_msgs::{
    diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus},
    msg::MarkerObservations,
    sensor_msgs::msg::CompressedImage,
};
use volant_test::live::processes::Node;

const DOMAIN: u16 = 69;
const WIDTH: u16 = 640;
const HEIGHT: u16 = 480;
/// Images that are sent after the first answer; every second one is hostile.
const IMAGES: usize = 60;

/// An image with other noise for each `number`.
fn jpeg(number: usize, scans: u8) -> Vec<u8> {
    let size = usize::from(WIDTH) * usize::from(HEIGHT) * 3;
    let data: Vec<u8> = (0..size).map(|i| 90 + ((i * 7 + number * 13) % 17) as u8).collect();
    let mut jpeg = Vec::new();
    let mut encoder = jpeg_encoder::Encoder::new(&mut jpeg, 80);
    if scans > 1 {
        encoder.set_progressive_scans(scans);
    }
    encoder.encode(&data, WIDTH, HEIGHT, jpeg_encoder::ColorType::Rgb).unwrap();
    jpeg
}

/// A progressive image whose last scan is repeated 500 times: 200 ms of decoding or more, each.
fn bomb(number: usize) -> Vec<u8> {
    let jpeg = jpeg(number, 4);
    let last = jpeg.windows(2).rposition(|pair| pair == [0xff, 0xda]).unwrap();
    let scan = &jpeg[last..jpeg.len() - 2];
    [&jpeg[..last], &scan.repeat(500), &[0xff, 0xd9]].concat()
}

enum Event {
    Beat,
    Markers(Arc<MarkerObservations>),
    Statuses(Arc<DiagnosticArray>),
}

/// What the camera sent and received.
enum Report {
    Sent { stamp: Stamp, hostile: bool },
    Answered(Stamp),
    Tracking(String),
}

fn start_camera(process: &mut Process, reports: mpsc::SyncSender<Report>) -> Result<(), NodeError> {
    process.start_closure("camera", move |context: &mut NodeContext<Event>| {
        context.timer(Duration::from_millis(100), || Event::Beat);
        context.subscribe(topics::MARKERS, QosPreset::Measurement, |m| Some(Event::Markers(m)))?;
        let diagnostics = topics::absolute::DIAGNOSTICS;
        context.subscribe(diagnostics, QosPreset::State, |m| Some(Event::Statuses(m)))?;
        let images = context.advertise(topics::COMPRESSED_IMAGE, QosPreset::Image)?;
        let (reports, mut sent, mut answered) = (reports.clone(), 0, false);
        Ok(move |context: &mut NodeContext<Event>, event: Event| {
            let report = match event {
                Event::Beat => {
                    // Hostile ones only after the tracker has been discovered.
                    let hostile = answered && sent % 2 == 1;
                    let data = if hostile { bomb(sent) } else { jpeg(sent, 1) };
                    let stamp = context.now();
                    let header = convert::header(topics::frames::CAMERA, stamp);
                    images.publish(CompressedImage { header, format: "jpeg".to_owned(), data });
                    sent += 1;
                    Report::Sent { stamp, hostile }
                }
                Event::Markers(message) => {
                    answered = true;
                    Report::Answered(convert::stamp(&message.header.stamp))
                }
                Event::Statuses(array) => {
                    let of_tracker = |s: &&DiagnosticStatus| s.name == "marker_tracker: tracking";
                    let Some(status) = array.status.iter().find(of_tracker) else { return };
                    Report::Tracking(status.message.clone())
                }
            };
            let _ = reports.try_send(report);
        })
    })
}

#[test]
fn a_jpeg_with_hundreds_of_scans_is_refused_and_the_tracker_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let rig = concat!(env!("CARGO_MANIFEST_DIR"), "/../launch_config/config/rig.yaml");
    let words = ["--rig", rig, "--image_transport", "compressed"];
    let environment = [("ROS_DOMAIN_ID".to_owned(), DOMAIN.to_string())];
    let mut tracker =
        Node::start(None, "marker_tracker", &words, &environment, folder.path()).unwrap();

    let (sender, reports) = mpsc::sync_channel(10_000);
    let mut process = Process::new(Network { domain_id: DOMAIN, ..Network::default() }).unwrap();
    start_camera(&mut process, sender).unwrap();

    let deadline = Instant::now() + Duration::from_secs(60);
    let (mut good, mut hostile) = (HashSet::new(), HashSet::new());
    let (mut answered, mut counted) = (HashSet::new(), false);
    while good.len() + hostile.len() < IMAGES && Instant::now() < deadline {
        match reports.recv_timeout(Duration::from_secs(20)).unwrap() {
            // Before the first answer nothing is certain to arrive.
            Report::Sent { .. } if answered.is_empty() => {}
            Report::Sent { stamp, hostile: true } => drop(hostile.insert(stamp)),
            Report::Sent { stamp, hostile: false } => drop(good.insert(stamp)),
            Report::Answered(stamp) => drop(answered.insert(stamp)),
            Report::Tracking(text) => {
                counted |= text.contains("images of the last second were rejected");
            }
        }
    }
    // The last ones are still on their way.
    std::thread::sleep(Duration::from_millis(500));
    answered.extend(reports.try_iter().filter_map(|report| match report {
        Report::Answered(stamp) => Some(stamp),
        _ => None,
    }));
    assert!(hostile.len() >= IMAGES / 2 - 2, "{} hostile images", hostile.len());
    assert!(answered.is_disjoint(&hostile), "a hostile image was decoded");
    let share = good.intersection(&answered).count() as f64 / good.len() as f64;
    assert!(share > 0.9, "{:.0} % of the good images were answered", share * 100.0);
    assert!(counted, "the diagnostics do not count them");
    assert!(tracker.ended().is_none(), "the tracker ended");
    let log = std::fs::read_to_string(&tracker.log).unwrap();
    let line = log.lines().find(|l| l.contains("scans and is rejected")).expect(&log);
    assert!(line.contains("set the camera to baseline JPEG"), "{line}");
}
