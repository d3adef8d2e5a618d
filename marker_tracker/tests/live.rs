//! The node over DDS, in one process with a camera.

#![cfg(feature = "node")]
#![allow(clippy::unwrap_used)] // clippy does not recognize helpers of tests

use marker_tracker::node::MarkerTrackerNode;
use node_kit::{
    NodeContext, NodeError, Process, QosPreset, RosArguments, convert, environment::Network,
};
use rig_model::{CameraModel, Distortion, topics};
use std::{
    sync::{Arc, mpsc},
    time::Duration,
};
use volant_msgs::{
    diagnostic_msgs::msg::{DiagnosticArray, DiagnosticStatus},
    sensor_msgs::msg::Image,
};

const DOMAIN: u16 = 163;
const WIDTH: u32 = 320;
const HEIGHT: u32 = 240;

enum Event {
    Beat,
    Statuses(Arc<DiagnosticArray>),
}

/// Starts a node that sends gray images of an empty floor, and collects the tracker's status.
fn start_camera(
    process: &mut Process,
    statuses: mpsc::SyncSender<DiagnosticStatus>,
) -> Result<(), NodeError> {
    process.start_closure("camera", move |context: &mut NodeContext<Event>| {
        context.timer(Duration::from_millis(50), || Event::Beat);
        let diagnostics = topics::absolute::DIAGNOSTICS;
        context.subscribe(diagnostics, QosPreset::State, |m| Some(Event::Statuses(m)))?;
        let images = context.advertise(topics::IMAGE, QosPreset::Image)?;
        let infos = context.advertise(topics::CAMERA_INFO, QosPreset::CameraInfo)?;
        let (statuses, mut sent) = (statuses.clone(), 0_usize);
        Ok(move |context: &mut NodeContext<Event>, event: Event| match event {
            Event::Beat => {
                let (stamp, frame) = (context.now(), topics::frames::CAMERA);
                let f = 300.0;
                let lens = Distortion::PlumbBob([0.0; 5]);
                let camera = CameraModel::new(WIDTH, HEIGHT, [f, f, 159.5, 119.5], lens).unwrap();
                infos.publish(convert::camera_message(frame, stamp, &camera));
                let size = (3 * WIDTH * HEIGHT) as usize;
                images.publish(Image {
                    header: convert::header(frame, stamp),
                    height: HEIGHT,
                    width: WIDTH,
                    encoding: "rgb8".to_owned(),
                    is_bigendian: 0,
                    step: 3 * WIDTH,
                    data: (0..size).map(|i| 90 + ((i / 3 * 7 + sent * 13) % 17) as u8).collect(),
                });
                sent += 1;
            }
            Event::Statuses(array) => {
                let tracking = array.status.iter().find(|s| s.name == "marker_tracker: tracking");
                if let Some(status) = tracking {
                    let _ = statuses.try_send(status.clone());
                }
            }
        })
    })
}

fn value<'a>(status: &'a DiagnosticStatus, key: &str) -> &'a str {
    &status.values.iter().find(|v| v.key == key).unwrap().value
}

#[test]
fn no_debug_image_is_drawn_while_nobody_subscribes_to_it() {
    let (sender, statuses) = mpsc::sync_channel(100);
    let mut process = Process::new(Network { domain_id: DOMAIN, ..Network::default() }).unwrap();
    let mut arguments = RosArguments::default();
    let rig = concat!(env!("CARGO_MANIFEST_DIR"), "/../launch_config/config/rig.yaml");
    arguments.add_file(rig.into()).unwrap();
    process.start::<MarkerTrackerNode>(&arguments).unwrap();
    start_camera(&mut process, sender).unwrap();
    // The images show no marker, so that their brightness is measured.
    let status = loop {
        let status = statuses.recv_timeout(Duration::from_secs(20)).unwrap();
        if status.message.starts_with("no marker in view: nothing has the color of red, green") {
            break status;
        }
    };
    assert_eq!(value(&status, "drawing, ms"), "0.000 (max 0.000)", "{status:?}");
}
