//! Nodes inside a larger program: a camera of the program's own feeds `marker_tracker`, and `pose_fusion` gives the pose,
//! all in one process. Images pass as the same `Arc`, and nothing is serialised where nobody outside listens.
//!
//! `cargo run --release -p launch_config --example embedded_nodes -- together|apart RUN.mcap rig.yaml` plays the bag's
//! images as raw ones at their own pace and measures from each image's publication to its `volant/visual_pose`.
//! `together` is one process; `apart` gives each node a DDS participant of its own, so that everything passes over loopback.
#![allow(clippy::print_stdout, reason = "an example")]
#![allow(clippy::disallowed_methods, reason = "it measures on the wall clock")]

use anyhow::Context;
use launch_config::bag::BagReader;
use marker_tracker::{decode_compressed, node::MarkerTrackerNode};
use node_kit::{Kit, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments};
use pose_fusion::node::FusionNode;
use std::{
    collections::HashMap,
    path::Path,
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};
use volant_msgs::{
    cdr,
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    sensor_msgs::msg::{CameraInfo, CompressedImage, Image, Imu},
};

/// When each image was published, by its stamp, and how long its pose took.
static PUBLISHED: Mutex<Option<HashMap<(i32, u32), Instant>>> = Mutex::new(None);
static TOOK: Mutex<Vec<Duration>> = Mutex::new(Vec::new());

enum Message {
    Image(Image),
    Camera(CameraInfo),
    Imu(Imu),
    Climber(TransformStamped),
    End,
}

/// The program's own source; here it reads a bag that `main` names in the environment.
struct Source {
    image: Publisher<Image>,
    camera: Publisher<CameraInfo>,
    imu: Publisher<Imu>,
    climber: Publisher<TransformStamped>,
}

impl NodeShell for Source {
    const NAME: &'static str = "source";
    type Parameters = ();
    type Input = Message;

    fn start(kit: &mut Kit<Message>, (): ()) -> Result<Self, NodeError> {
        let sender = kit.device_sender("bag", 100);
        kit.spawn("bag", move || {
            let played = play(|message| sender.send(message));
            if let Err(error) = played {
                println!("{error:#}");
            }
            sender.send(Message::End);
        })?;
        Ok(Self {
            image: kit.advertise("climber/camera/image_raw", QosPreset::Image)?,
            camera: kit.advertise("climber/camera/camera_info", QosPreset::Image)?,
            imu: kit.advertise("volant/imu/data", QosPreset::Sensor)?,
            climber: kit.advertise("climber/transform", QosPreset::State)?,
        })
    }

    fn handle(&mut self, kit: &mut Kit<Message>, message: Message) {
        match message {
            Message::Image(image) => {
                let stamp = (image.header.stamp.sec, image.header.stamp.nanosec);
                let mut published = PUBLISHED.lock().unwrap_or_else(PoisonError::into_inner);
                published.get_or_insert_default().insert(stamp, Instant::now());
                drop(published);
                self.image.publish(image);
            }
            Message::Camera(camera) => self.camera.publish(camera),
            Message::Imu(imu) => self.imu.publish(imu),
            Message::Climber(climber) => self.climber.publish(climber),
            Message::End => kit.finish(),
        }
    }
}

/// The bag's messages at the pace of their log times.
fn play(mut send: impl FnMut(Message) -> bool) -> anyhow::Result<()> {
    let path = std::env::args().nth(2).context("no bag")?;
    let mut bag = BagReader::open(Path::new(&path))?;
    // Subscriptions find each other meanwhile.
    std::thread::sleep(Duration::from_secs(2));
    let (mut first, start) = (None, Instant::now());
    while let Some(message) = bag.next_message()? {
        let playable = match &*message.topic.name {
            "/climber/camera/camera_info" => Message::Camera(cdr::from_bytes(&message.data)?),
            "/climber/camera/image_raw/compressed" => {
                let compressed: CompressedImage = cdr::from_bytes(&message.data)?;
                let pixels = decode_compressed(&compressed.format, &compressed.data)?;
                let view = pixels.view(Default::default());
                Message::Image(Image {
                    header: compressed.header,
                    width: u32::try_from(view.width)?,
                    height: u32::try_from(view.height)?,
                    step: u32::try_from(view.step)?,
                    encoding: "rgb8".into(),
                    data: view.data.to_vec(),
                    ..Image::default()
                })
            }
            "/climber/transform" => Message::Climber(cdr::from_bytes(&message.data)?),
            "/volant/imu/data" => Message::Imu(cdr::from_bytes(&message.data)?),
            _ => continue,
        };
        let first = *first.get_or_insert(message.log_time);
        let due = start + Duration::from_nanos(message.log_time - first);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        if !send(playable) {
            break;
        }
    }
    std::thread::sleep(Duration::from_millis(300));
    Ok(())
}

/// What the larger program does with the pose.
struct User;

impl NodeShell for User {
    const NAME: &'static str = "user";
    type Parameters = ();
    type Input = Arc<PoseWithCovarianceStamped>;

    fn start(kit: &mut Kit<Self::Input>, (): ()) -> Result<Self, NodeError> {
        kit.subscribe("volant/visual_pose", QosPreset::State, Some)?;
        Ok(Self)
    }

    fn handle(&mut self, _: &mut Kit<Self::Input>, pose: Self::Input) {
        let now = Instant::now();
        let stamp = (pose.header.stamp.sec, pose.header.stamp.nanosec);
        let published = PUBLISHED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = published.as_ref().and_then(|p| p.get(&stamp)) {
            TOOK.lock().unwrap_or_else(PoisonError::into_inner).push(now.duration_since(*at));
        }
    }
}

/// Where the next node goes.
fn place<'a>(
    apart: bool,
    first: &'a mut Process,
    others: &'a mut Vec<Process>,
) -> Result<&'a mut Process, NodeError> {
    if apart {
        others.push(Process::from_environment()?);
    }
    Ok(others.last_mut().unwrap_or(first))
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [mode, _, rig] = arguments.as_slice() else {
        anyhow::bail!("usage: embedded_nodes together|apart RUN.mcap rig.yaml")
    };
    // The same that a command line says; `RosArguments::set` and `remap` do it one by one.
    let mut ros = RosArguments::default();
    ros.add_file(rig.into())?;
    let mut first = Process::from_environment()?;
    first.stop_on_signals()?;
    let mut others = vec![];
    let apart = mode == "apart";
    place(apart, &mut first, &mut others)?.start::<User>(&RosArguments::default())?;
    place(apart, &mut first, &mut others)?.start::<FusionNode>(&ros)?;
    place(apart, &mut first, &mut others)?.start::<MarkerTrackerNode>(&ros)?;
    // The source ends the process when the bag has ended.
    first.start::<Source>(&RosArguments::default())?;
    first.wait()?;
    drop(others);

    let mut took = std::mem::take(&mut *TOOK.lock().unwrap_or_else(PoisonError::into_inner));
    took.sort_unstable();
    let images = PUBLISHED.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map_or(0, HashMap::len);
    anyhow::ensure!(!took.is_empty(), "no pose came of {images} images");
    let at = |q: f64| took[((took.len() - 1) as f64 * q) as usize].as_secs_f64() * 1e3;
    println!(
        "{mode}: image to visual pose, {} poses of {images} images: median {:.2} ms, p90 {:.2} ms, p99 {:.2} ms",
        took.len(),
        at(0.5),
        at(0.9),
        at(0.99)
    );
    Ok(())
}
