//! The shell: images (from a topic, a camera device or a video file) and `climber/camera/camera_info` in,
//! `climber/markers` out. Images of a device or a file are published on, with their camera_info.

mod camera_info;
mod device;
mod parameters;
mod source;
mod stages;
mod video;

pub use parameters::MarkerTrackerParameters;
pub use source::Frame;

use crate::{
    ImageError, ImageView, Input, Output, OwnedImage, Tracker, Warning, decode_compressed_into, from_encoding,
};
use node_kit::{Health, Kit, Level, NodeError, NodeShell, Publisher, QosPreset, convert};
use rig_model::{CameraModel, CameraModelError, MarkerState, Rig};
use stages::{Report, Stages};
use std::sync::Arc;
use volant_msgs::{
    msg::MarkerObservations,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Image},
};

/// What comes into the node.
pub enum Arrival {
    /// A raw image of the topic.
    Image(Arc<Image>),
    /// A compressed image of the topic.
    Compressed(Arc<CompressedImage>),
    /// The camera's model.
    Camera(CameraModel),
    /// A frame of the device or the file.
    Frame(Box<Frame>),
    /// The file has ended, or why it cannot go on.
    Ended(Result<(), String>),
}

/// Images of a mean value below show nothing, nor do those above.
const NEARLY_BLACK: f64 = 12.0;
const NEARLY_WHITE: f64 = 243.0;

/// Where a device's or a file's images go on to.
struct Onward {
    raw: Publisher<Image>,
    compressed: Publisher<CompressedImage>,
    info: Publisher<CameraInfo>,
    /// The driver's last number, and how many it left out.
    sequence: Option<u32>,
    lost: u64,
}

/// The node.
pub struct MarkerTrackerNode {
    tracker: Tracker,
    rig: Rig,
    frame: String,
    markers: Publisher<MarkerObservations>,
    decoded: OwnedImage,
    stages: Stages,
    camera: Option<CameraModel>,
    onward: Option<Onward>,
    #[cfg(feature = "opencv")]
    debug: Publisher<CompressedImage>,
}

impl NodeShell for MarkerTrackerNode {
    const NAME: &'static str = "marker_tracker";
    const ABOUT: &'static str = "camera images in, the pixel coordinates of the four coloured markers out";
    type Parameters = MarkerTrackerParameters;
    type Input = Arrival;

    fn start(kit: &mut Kit<Arrival>, parameters: MarkerTrackerParameters) -> Result<Self, NodeError> {
        let rig = kit.rig()?;
        let tracker = Tracker::new(rig.markers.clone(), parameters.config(&rig));
        let markers = kit.advertise("climber/markers", QosPreset::Measurement)?;
        #[cfg(feature = "opencv")]
        let debug = kit.advertise("climber/markers/debug_image", QosPreset::Image)?;
        let mut node = Self {
            tracker,
            frame: rig.frames.camera.clone(),
            rig,
            markers,
            decoded: OwnedImage::default(),
            stages: Stages::default(),
            camera: None,
            onward: None,
            #[cfg(feature = "opencv")]
            debug,
        };
        if parameters.source == "topic" {
            node.subscribe(kit, &parameters)?;
        } else {
            node.open(kit, parameters)?;
        }
        Ok(node)
    }

    fn handle(&mut self, kit: &mut Kit<Arrival>, arrival: Arrival) {
        match arrival {
            Arrival::Camera(camera) => {
                if self.camera.as_ref() != Some(&camera) {
                    self.camera = Some(camera.clone());
                    self.tracker.handle(Input::Camera(camera));
                }
            }
            Arrival::Image(message) => self.raw(kit, &message),
            Arrival::Compressed(message) => self.compressed(kit, &message),
            Arrival::Frame(frame) => self.frame(kit, *frame),
            Arrival::Ended(Ok(())) => {
                kit.log(Level::Info, "the video file has ended");
                kit.finish();
            }
            Arrival::Ended(Err(reason)) => kit.fail(NodeError::shell(reason)),
        }
    }

    fn tick(&mut self, kit: &mut Kit<Arrival>) {
        let report = self.stages.report();
        let (health, message) = if report.images == 0 {
            (Health::Error, "no image came in the last second".to_owned())
        } else if report.taken == 0 {
            (Health::Error, "every image of the last second was refused; the log says why".to_owned())
        } else if report.repeated == report.taken {
            let message = "every image of the last second is byte for byte the one before: the camera or its driver stands still";
            (Health::Error, message.to_owned())
        } else if report.refused > 0 {
            (
                Health::Warn,
                format!("{} images of the last second were refused; the log says why", report.refused),
            )
        } else if self.camera.is_none() {
            (Health::Warn, "no camera_info yet: geometry is checked coarsely only".to_owned())
        } else if report.detected[0] == 0 {
            (Health::Warn, self.why_none(&report))
        } else {
            (Health::Ok, "markers flow".to_owned())
        };
        let mut values = report.values;
        values.extend(
            self.tracker.reasons().iter().map(|(color, reason)| (color.name(), (*reason).to_owned())),
        );
        kit.diagnose("tracking", health, &message, &values);
    }

    fn parameters_changed(
        &mut self,
        _kit: &mut Kit<Arrival>,
        parameters: &MarkerTrackerParameters,
    ) -> Result<(), String> {
        self.tracker.set_config(parameters.config(&self.rig));
        Ok(())
    }
}

impl MarkerTrackerNode {
    /// No marker was seen for a second: what the images are like that may explain it.
    fn why_none(&self, report: &Report) -> String {
        let mean = report.brightness;
        let (width, height) = report.size;
        let other_size = self
            .camera
            .as_ref()
            .map(CameraModel::size)
            .filter(|size| (usize::try_from(size.0), usize::try_from(size.1)) != (Ok(width), Ok(height)));
        if let Some((w, h)) = other_size {
            format!("no marker in view: the images are {width}x{height}, camera_info is for {w}x{h}")
        } else if mean < NEARLY_BLACK {
            let why = "look at the light, the lens cap and the exposure";
            format!("no marker in view: the images are nearly black (mean {mean:.0} of 255); {why}")
        } else if mean > NEARLY_WHITE {
            format!("no marker in view: the images are nearly white (mean {mean:.0} of 255); expose less")
        } else {
            "no marker in view".to_owned()
        }
    }

    fn subscribe(
        &self,
        kit: &mut Kit<Arrival>,
        parameters: &MarkerTrackerParameters,
    ) -> Result<(), NodeError> {
        kit.subscribe("climber/camera/camera_info", QosPreset::Image, |message: Arc<CameraInfo>| {
            convert::camera_model(&message).map(Arrival::Camera).map_err(|e: CameraModelError| e.to_string())
        })?;
        if parameters.image_transport == "compressed" {
            kit.subscribe("climber/camera/image_raw/compressed", QosPreset::Image, |message| {
                Some(Arrival::Compressed(message))
            })
        } else {
            kit.subscribe("climber/camera/image_raw", QosPreset::Image, |message| {
                Some(Arrival::Image(message))
            })
        }
    }

    fn open(&mut self, kit: &mut Kit<Arrival>, parameters: MarkerTrackerParameters) -> Result<(), NodeError> {
        if !parameters.camera_info_url.is_empty() {
            let camera = camera_info::read(&parameters.camera_info_url).map_err(NodeError::shell)?;
            self.tracker.handle(Input::Camera(camera.clone()));
            self.camera = Some(camera);
        }
        self.onward = Some(Onward {
            raw: kit.advertise("climber/camera/image_raw", QosPreset::Image)?,
            compressed: kit.advertise("climber/camera/image_raw/compressed", QosPreset::Image)?,
            info: kit.advertise("climber/camera/camera_info", QosPreset::Image)?,
            sequence: None,
            lost: 0,
        });
        let sender = kit.device_sender(&parameters.source, 4);
        let (clock, log) = (kit.clock(), kit.logger());
        if parameters.source == "device" {
            let found = device::check(&parameters).map_err(NodeError::shell)?;
            kit.log(Level::Info, found);
            kit.spawn("camera", move || device::run(&parameters, &sender, &clock, &log))
        } else {
            let video = video::probe(&parameters.file_path).map_err(NodeError::shell)?;
            kit.spawn("video", move || video::run(&parameters, video, &sender, &clock))
        }
    }

    fn frame(&mut self, kit: &mut Kit<Arrival>, frame: Frame) {
        if let Some(onward) = &mut self.onward {
            if let (Some(now), Some(before)) = (frame.sequence, onward.sequence) {
                let skipped = now.wrapping_sub(before).wrapping_sub(1);
                // A number that goes back is a camera that was opened anew.
                if skipped > 0 && skipped < 1000 {
                    onward.lost += u64::from(skipped);
                    kit.log_throttled(
                        Level::Warn,
                        "lost",
                        format!("the camera lost {skipped} images before number {now}"),
                    );
                }
            }
            onward.sequence = frame.sequence;
            if let Some(camera) = &self.camera {
                onward.info.publish(convert::camera_message(&self.frame, frame.stamp, camera));
            }
        }
        match frame.into_message(&self.frame) {
            source::Picture::Raw(message) => {
                if let Some(onward) = &self.onward {
                    onward.raw.publish_shared(Arc::clone(&message));
                }
                self.raw(kit, &message);
            }
            source::Picture::Compressed(message) => {
                if let Some(onward) = &self.onward {
                    onward.compressed.publish_shared(Arc::clone(&message));
                }
                self.compressed(kit, &message);
            }
        }
    }

    fn raw(&mut self, kit: &mut Kit<Arrival>, message: &Image) {
        let mut scratch = std::mem::take(&mut self.decoded);
        let clock = self.stages.start();
        let view = from_encoding(
            convert::stamp(&message.header.stamp),
            message.width as usize,
            message.height as usize,
            &message.encoding,
            message.is_bigendian != 0,
            message.step as usize,
            &message.data,
            &mut scratch,
        );
        self.stages.converted(clock);
        self.take(kit, view);
        self.decoded = scratch;
    }

    fn compressed(&mut self, kit: &mut Kit<Arrival>, message: &CompressedImage) {
        let mut scratch = std::mem::take(&mut self.decoded);
        let clock = self.stages.start();
        let decoded = decode_compressed_into(&message.format, &message.data, &mut scratch);
        self.stages.converted(clock);
        let stamp = convert::stamp(&message.header.stamp);
        self.take(kit, decoded.map(|()| scratch.view(stamp)));
        self.decoded = scratch;
    }

    fn take(&mut self, kit: &mut Kit<Arrival>, view: Result<ImageView<'_>, ImageError>) {
        match view {
            Ok(view) => {
                let clock = self.stages.start();
                self.tracker.handle(Input::Image(view));
                self.stages.tracked(clock);
                let unseen = self.stages.unseen();
                self.publish(kit);
                self.stages.looked_at(&view, unseen);
                #[cfg(feature = "opencv")]
                self.draw(kit, &view);
            }
            Err(error) => {
                self.stages.refused();
                kit.log_throttled(Level::Warn, "image", error.to_string());
            }
        }
    }

    fn publish(&mut self, kit: &mut Kit<Arrival>) {
        while let Some(output) = self.tracker.poll() {
            match output {
                Output::Observations(observations) => {
                    self.markers.publish(convert::markers_message(&self.frame, &observations));
                    let detected =
                        observations.markers.0.iter().filter(|m| m.state == MarkerState::Detected).count();
                    self.stages.finished(detected);
                }
                Output::Warning(warning) => {
                    match warning {
                        Warning::Image(_) | Warning::StampFromThePast { .. } => self.stages.refused(),
                        Warning::Repeated { .. } => self.stages.repeated(),
                        Warning::CameraSize { .. } => {}
                    }
                    kit.log_throttled(Level::Warn, warning.kind(), warning.to_string());
                }
            }
        }
    }

    /// The picture to look at, when somebody does.
    #[cfg(feature = "opencv")]
    fn draw(&mut self, kit: &mut Kit<Arrival>, view: &ImageView<'_>) {
        if self.debug.subscribers() == 0 {
            return;
        }
        let clock = self.stages.start();
        let jpeg = crate::draw(view, &self.tracker.marks()).and_then(|picture| {
            let mut data = Vec::new();
            let (width, height) = (u16::try_from(picture.width), u16::try_from(picture.height));
            let (Ok(width), Ok(height)) = (width, height) else {
                return Err("the image is too large".to_owned());
            };
            jpeg_encoder::Encoder::new(&mut data, 80)
                .encode(&picture.data, width, height, jpeg_encoder::ColorType::Rgb)
                .map_err(|e| e.to_string())?;
            Ok(data)
        });
        self.stages.drawn(clock);
        match jpeg {
            Ok(data) => self.debug.publish(CompressedImage {
                header: convert::header(&self.frame, view.stamp),
                format: "rgb8; jpeg compressed rgb8".to_owned(),
                data,
            }),
            Err(reason) => kit.log_throttled(Level::Warn, "debug image", format!("no debug image: {reason}")),
        }
    }
}
