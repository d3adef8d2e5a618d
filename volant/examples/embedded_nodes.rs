//! Nodes inside a larger program: a camera of the program's own feeds `marker_tracker`, and
//! `pose_fusion` gives the pose, all in one process. Images pass as the same `Arc`, and nothing is
//! serialized without an external subscriber.
//!
//! `cargo run --release -p volant --example embedded_nodes -- RUN.mcap rig.yaml` plays the bag's
//! images as raw ones at their own pace and prints the pose of each.
#![allow(clippy::print_stdout, reason = "an example")]
#![allow(clippy::disallowed_methods, reason = "it plays at the pace of the wall clock")]

use anyhow::Context;
use bag::BagReader;
use marker_tracker::{decode_compressed, node::MarkerTrackerNode};
use node_kit::{
    NodeContext, NodeError, NodeShell, Process, Publisher, QosPreset, RosArguments, convert,
};
use pose_fusion::node::FusionNode;
use rig_model::topics;
use std::{
    path::Path,
    sync::Arc,
    time::{Duration, Instant},
};
use volant_msgs::{
    cdr,
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    sensor_msgs::msg::{CameraInfo, CompressedImage, Image, Imu},
};

enum Message {
    Image(Image),
    Camera(CameraInfo),
    Imu(Imu),
    Climber(TransformStamped),
    End,
}

/// The program's own source; here it reads the bag of the command line.
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

    fn start(context: &mut NodeContext<Message>, (): ()) -> Result<Self, NodeError> {
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
        })
    }

    fn handle(&mut self, context: &mut NodeContext<Message>, message: Message) {
        match message {
            Message::Image(image) => self.image.publish(image),
            Message::Camera(camera) => self.camera.publish(camera),
            Message::Imu(imu) => self.imu.publish(imu),
            Message::Climber(climber) => self.climber.publish(climber),
            Message::End => context.finish(),
        }
    }
}

/// The bag's messages at the pace of their log times.
fn play(mut send: impl FnMut(Message) -> bool) -> anyhow::Result<()> {
    let path = std::env::args().nth(1).context("no bag")?;
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
struct User;

impl NodeShell for User {
    const NAME: &'static str = "user";
    type Parameters = ();
    type Input = Arc<PoseWithCovarianceStamped>;

    fn start(context: &mut NodeContext<Self::Input>, (): ()) -> Result<Self, NodeError> {
        context.subscribe(topics::VISUAL_POSE, QosPreset::State, Some)?;
        Ok(Self)
    }

    fn handle(&mut self, _: &mut NodeContext<Self::Input>, pose: Self::Input) {
        let (at, p) = (convert::stamp(&pose.header.stamp), &pose.pose.pose.position);
        println!("{at}: {:.4} {:.4} {:.4} m in {}", p.x, p.y, p.z, pose.header.frame_id);
    }
}

fn main() -> anyhow::Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [_, rig] = arguments.as_slice() else {
        anyhow::bail!("usage: embedded_nodes RUN.mcap rig.yaml")
    };
    // The same that a command line says; `RosArguments::set` and `remap` do it one by one.
    let mut ros = RosArguments::default();
    ros.add_file(rig.into())?;
    let mut process = Process::from_environment()?;
    process.stop_on_signals()?;
    process.start::<User>(&RosArguments::default())?;
    process.start::<FusionNode>(&ros)?;
    process.start::<MarkerTrackerNode>(&ros)?;
    // The source ends the process when the bag has ended.
    process.start::<Source>(&RosArguments::default())?;
    process.wait()?;
    Ok(())
}
