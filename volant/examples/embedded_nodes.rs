//! Nodes inside a larger program: a camera of the program's own feeds `marker_tracker`, and
//! `pose_fusion` gives the pose, all in one process. Images pass as the same `Arc`, and nothing is
//! serialized without an external subscriber.
//!
//! `cargo run --release -p volant --example embedded_nodes -- together|apart RUN.mcap rig.yaml`
//! plays the bag's images as raw ones at their own pace and measures from each image's publication
//! to its `volant/visual_pose`. `together` is one process; `apart` gives each node a DDS
//! participant of its own, so that everything passes over loopback.
#![allow(clippy::print_stdout, reason = "an example")]
#![allow(clippy::disallowed_methods, reason = "it measures on the wall clock")]

use anyhow::Context;
use bag::BagReader;
use marker_tracker::{decode_compressed, node::MarkerTrackerNode};
use node_kit::{NodeContext, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments};
use pose_fusion::node::FusionNode;
use rig_model::topics;
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

/// Latency from image to pose.
#[derive(Default)]
struct Latency {
    /// When each image was published, by its stamp (s, ns).
    published: HashMap<(i32, u32), Instant>,
    durations: Vec<Duration>,
}

/// Shared by the program's nodes and `main`.
type SharedLatency = Arc<Mutex<Latency>>;

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
    latency: SharedLatency,
}

impl Source {
    fn new(context: &mut NodeContext<Message>, latency: SharedLatency) -> Result<Self, NodeError> {
        let sender = context.device_sender("bag", 100);
        context.spawn("bag", move || {
            let played = play(|message| sender.send(message));
            if let Err(error) = played {
                println!("{error:#}");
            }
            sender.send(Message::End);
        })?;
        Ok(Self {
            image: context.advertise(topics::IMAGE, QosPreset::Image)?,
            camera: context.advertise(topics::CAMERA_INFO, QosPreset::CameraInfo)?,
            imu: context.advertise(topics::IMU, QosPreset::Sensor)?,
            climber: context.advertise(topics::CLIMBER_TRANSFORM, QosPreset::State)?,
            latency,
        })
    }
}

impl NodeShell for Source {
    const NAME: &'static str = "source";
    type Parameters = ();
    type Input = Message;

    fn handle(&mut self, context: &mut NodeContext<Message>, message: Message) {
        match message {
            Message::Image(image) => {
                let stamp = (image.header.stamp.sec, image.header.stamp.nanosec);
                let mut latency = self.latency.lock().unwrap_or_else(PoisonError::into_inner);
                latency.published.insert(stamp, Instant::now());
                drop(latency);
                self.image.publish(image);
            }
            Message::Camera(camera) => self.camera.publish(camera),
            Message::Imu(imu) => self.imu.publish(imu),
            Message::Climber(climber) => self.climber.publish(climber),
            Message::End => context.finish(),
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
            topics::absolute::CAMERA_INFO => Message::Camera(cdr::from_bytes(&message.data)?),
            topics::absolute::COMPRESSED_IMAGE => {
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
            topics::absolute::CLIMBER_TRANSFORM => {
                Message::Climber(cdr::from_bytes(&message.data)?)
            }
            topics::absolute::IMU => Message::Imu(cdr::from_bytes(&message.data)?),
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
struct User(SharedLatency);

impl NodeShell for User {
    const NAME: &'static str = "user";
    type Parameters = ();
    type Input = Arc<PoseWithCovarianceStamped>;

    fn handle(&mut self, _: &mut NodeContext<Self::Input>, pose: Self::Input) {
        let now = Instant::now();
        let stamp = (pose.header.stamp.sec, pose.header.stamp.nanosec);
        let mut latency = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = latency.published.get(&stamp).copied() {
            latency.durations.push(now.duration_since(at));
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
    let latency = SharedLatency::default();
    let shared = Arc::clone(&latency);
    place(apart, &mut first, &mut others)?.start_with(
        &RosArguments::default(),
        move |context, ()| {
            context.subscribe(topics::VISUAL_POSE, QosPreset::State, Some)?;
            Ok(User(Arc::clone(&shared)))
        },
    )?;
    place(apart, &mut first, &mut others)?.start::<FusionNode>(&ros)?;
    place(apart, &mut first, &mut others)?.start::<MarkerTrackerNode>(&ros)?;
    // The source ends the process when the bag has ended.
    let shared = Arc::clone(&latency);
    first.start_with(&RosArguments::default(), move |context, ()| {
        Source::new(context, Arc::clone(&shared))
    })?;
    first.wait()?;
    drop(others);

    let mut latency = latency.lock().unwrap_or_else(PoisonError::into_inner);
    let images = latency.published.len();
    let took = &mut latency.durations;
    took.sort_unstable();
    anyhow::ensure!(!took.is_empty(), "no pose came of {images} images");
    let at = |q: f64| took[((took.len() - 1) as f64 * q) as usize].as_secs_f64() * 1e3;
    println!(
        "{mode}: image to visual pose, {} poses of {images} images: median {:.2} ms, p90 {:.2} \
         ms, p99 {:.2} ms",
        took.len(),
        at(0.5),
        at(0.9),
        at(0.99)
    );
    Ok(())
}
