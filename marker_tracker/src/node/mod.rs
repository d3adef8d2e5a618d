//! ROS node: images (from a topic, a camera device or a video file) and
//! `climber/camera/camera_info` in, `climber/markers` out. Images of a device or a file are also
//! published, with their camera_info.

mod camera_info;
#[cfg(feature = "opencv")]
mod debug_image;
mod device;
mod health;
mod images;
mod incomplete;
mod parameters;
mod source;
mod stages;
pub mod video;

pub use parameters::MarkerTrackerParameters;
pub use source::Frame;

use crate::{
    decode::Decoder,
    image::OwnedImage,
    tracker::{Input, Tracker},
};
use incomplete::{SharedCounts, resident};
use node_kit::{
    Level, NodeContext, NodeError, NodeShell, Publisher, QosPreset,
    node::{CameraChanges, IfChanged},
};
use rig_model::{CameraModel, CameraModelError, Rig, topics};
use stages::Stages;
use std::sync::Arc;
use volant_msgs::{
    msg::MarkerObservations,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Image},
};

/// Input of the node.
pub enum Arrival {
    /// A raw image from the topic.
    Image(Arc<Image>),
    /// A compressed image from the topic.
    Compressed(Arc<CompressedImage>),
    /// The camera model.
    Camera(CameraModel),
    /// Incomplete images occupy too much memory.
    Incomplete,
    /// A frame from the device or the file.
    Frame(Box<Frame>),
    /// The end of the file, or the reason why it cannot be read on.
    Ended(Result<(), String>),
}

/// Publishers of a device's or a file's images.
struct Republished {
    raw: Publisher<Image>,
    compressed: Publisher<CompressedImage>,
    info: Publisher<CameraInfo>,
    /// The driver's last sequence number.
    sequence: Option<u32>,
}

/// The marker tracker node.
pub struct MarkerTrackerNode {
    tracker: Tracker,
    rig: Rig,
    markers: Publisher<MarkerObservations>,
    converted: OwnedImage,
    decoder: Decoder,
    stages: Stages,
    camera: Option<CameraModel>,
    republished: Option<Republished>,
    /// Topic or file that the images come from, for messages.
    source: String,
    incomplete: SharedCounts,
    /// An image in another frame than the rig file's was logged.
    is_frame_logged: bool,
    #[cfg(feature = "opencv")]
    debug: Publisher<CompressedImage>,
}

fn subscribe_raw(
    context: &mut NodeContext<Arrival>,
    counts: SharedCounts,
) -> Result<(), NodeError> {
    context.subscribe(topics::IMAGE, QosPreset::Image, move |message| image_input(&counts, message))
}

fn image_input(counts: &SharedCounts, message: Arc<Image>) -> Option<Arrival> {
    counts.lock().count_received();
    Some(Arrival::Image(message))
}

/// Input of a camera_info, which announces an image even if its model is unusable. Incomplete raw
/// images are counted.
fn camera_info_input(
    counts: &SharedCounts,
    is_raw: bool,
    changes: &CameraChanges,
    message: Arc<CameraInfo>,
) -> IfChanged<Result<Arrival, CameraModelError>> {
    let size = (message.width, message.height);
    if is_raw && counts.lock().is_full_after(size, resident) {
        return IfChanged(Some(Ok(Arrival::Incomplete)));
    }
    let model = changes.model(message);
    if let Some(model) = &model {
        counts.lock().is_info_rejected = model.is_err();
    }
    IfChanged(model.map(|model| model.map(Arrival::Camera)))
}

impl NodeShell for MarkerTrackerNode {
    const NAME: &'static str = "marker_tracker";
    const ABOUT: &'static str =
        "camera images in, the pixel coordinates of the four colored markers out";
    type Parameters = MarkerTrackerParameters;
    type Input = Arrival;

    fn start(
        context: &mut NodeContext<Arrival>,
        parameters: MarkerTrackerParameters,
    ) -> Result<Self, NodeError> {
        let rig = context.rig()?;
        let tracker = Tracker::new(rig.markers.clone(), parameters.config(&rig));
        let markers = context.advertise(topics::MARKERS, QosPreset::Measurement)?;
        #[cfg(feature = "opencv")]
        let debug = context.advertise(topics::MARKERS_DEBUG_IMAGE, QosPreset::Image)?;
        let mut node = Self {
            tracker,
            rig,
            markers,
            converted: OwnedImage::default(),
            decoder: Decoder::default(),
            stages: Stages::default(),
            camera: None,
            republished: None,
            source: parameters.source_name().to_owned(),
            incomplete: SharedCounts::default(),
            is_frame_logged: false,
            #[cfg(feature = "opencv")]
            debug,
        };
        if parameters.source == "topic" {
            node.subscribe(context, &parameters)?;
        } else {
            node.open(context, parameters)?;
        }
        Ok(node)
    }

    fn handle(&mut self, context: &mut NodeContext<Arrival>, arrival: Arrival) {
        match arrival {
            Arrival::Camera(camera) => {
                if self.camera.as_ref() != Some(&camera) {
                    self.camera = Some(camera.clone());
                    self.tracker.handle(Input::Camera(camera));
                }
            }
            Arrival::Incomplete => self.renew_raw(context),
            Arrival::Image(message) => self.raw(context, &message),
            Arrival::Compressed(message) => self.compressed(context, &message),
            Arrival::Frame(frame) => self.frame(context, *frame),
            Arrival::Ended(Ok(())) => {
                context.log(Level::Info, "the video file has ended");
                context.finish();
            }
            Arrival::Ended(Err(reason)) => context.fail(NodeError::shell(reason)),
        }
    }

    fn tick(&mut self, context: &mut NodeContext<Arrival>) {
        let stages = std::mem::take(&mut self.stages);
        let mut incomplete = self.incomplete.lock();
        let uses_camera = self.tracker.uses_camera();
        let why = self.tracker.why_not_found();
        let (health, message) =
            health::assess(&stages, self.camera.as_ref(), uses_camera, &incomplete, why);
        let mut values = stages.values();
        values.push(("incomplete images dropped", incomplete.dropped.to_string()));
        incomplete.recent = 0;
        drop(incomplete);
        let views = self.tracker.views();
        values.extend(views.iter().map(|(c, view)| (c.name(), view.outcome.as_str().to_owned())));
        context.diagnose("tracking", health, &message, &values);
    }

    fn parameters_changed(
        &mut self,
        _context: &mut NodeContext<Arrival>,
        parameters: &MarkerTrackerParameters,
    ) -> Result<(), String> {
        self.tracker.set_config(parameters.config(&self.rig));
        Ok(())
    }
}

impl MarkerTrackerNode {
    /// Subscribes to the camera.
    fn subscribe(
        &self,
        context: &mut NodeContext<Arrival>,
        parameters: &MarkerTrackerParameters,
    ) -> Result<(), NodeError> {
        let is_compressed = parameters.image_transport == "compressed";
        let (counts, changes) = (self.incomplete.clone(), CameraChanges::default());
        context.subscribe(topics::CAMERA_INFO, QosPreset::CameraInfo, move |message| {
            camera_info_input(&counts, !is_compressed, &changes, message)
        })?;
        if is_compressed {
            context.subscribe(topics::COMPRESSED_IMAGE, QosPreset::Image, |message| {
                Some(Arrival::Compressed(message))
            })
        } else {
            subscribe_raw(context, self.incomplete.clone())
        }
    }

    /// Renews the subscription to raw images, which frees the buffers of incomplete ones.
    fn renew_raw(&mut self, context: &mut NodeContext<Arrival>) {
        context.unsubscribe(topics::IMAGE);
        context.log_throttled(Level::Warn, "incomplete", self.incomplete.lock().why_dropped());
        if let Err(error) = subscribe_raw(context, self.incomplete.clone()) {
            context.fail(error);
        }
    }

    /// Opens the device or the file.
    fn open(
        &mut self,
        context: &mut NodeContext<Arrival>,
        parameters: MarkerTrackerParameters,
    ) -> Result<(), NodeError> {
        if !parameters.camera_info_url.is_empty() {
            let camera =
                camera_info::read(&parameters.camera_info_url).map_err(NodeError::shell)?;
            self.tracker.handle(Input::Camera(camera.clone()));
            self.camera = Some(camera);
        }
        self.republished = Some(Republished {
            raw: context.advertise(topics::IMAGE, QosPreset::Image)?,
            compressed: context.advertise(topics::COMPRESSED_IMAGE, QosPreset::Image)?,
            info: context.advertise(topics::CAMERA_INFO, QosPreset::CameraInfo)?,
            sequence: None,
        });
        let sender = context.device_sender(&parameters.source, 4);
        let (clock, log) = (context.clock(), context.logger());
        if parameters.source == "device" {
            let found = device::check(&parameters).map_err(NodeError::shell)?;
            context.log(Level::Info, found);
            context.spawn("camera", move || device::run(&parameters, &sender, &clock, &log))
        } else {
            let video = video::probe(&parameters.file_path).map_err(NodeError::shell)?;
            context.spawn("video", move || video::run(&parameters, video, &sender, &clock))
        }
    }
}
