//! The shell: images (from a topic, a camera device or a video file) and `climber/camera/camera_info` in,
//! `climber/markers` out. Images of a device or a file are published on, with their camera_info.

mod parameters;
mod stages;

pub use parameters::MarkerTrackerParameters;

use crate::{
    ImageError, ImageView, Input, Output, OwnedImage, Tracker, Warning, decode_compressed_into, from_encoding,
};
use node_kit::{Health, Kit, Level, NodeError, NodeShell, Publisher, QosPreset, convert};
use rig_model::{CameraModel, CameraModelError, MarkerState};
use stages::Stages;
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
}

/// The node.
pub struct MarkerTrackerNode {
    tracker: Tracker,
    frame: String,
    markers: Publisher<MarkerObservations>,
    decoded: OwnedImage,
    stages: Stages,
    camera: Option<CameraModel>,
}

impl NodeShell for MarkerTrackerNode {
    const NAME: &'static str = "marker_tracker";
    const ABOUT: &'static str = "camera images in, the pixel coordinates of the four coloured markers out";
    type Parameters = MarkerTrackerParameters;
    type Input = Arrival;

    fn start(kit: &mut Kit<Arrival>, parameters: MarkerTrackerParameters) -> Result<Self, NodeError> {
        let rig = kit.rig()?;
        let tracker = Tracker::new(rig.markers.clone(), parameters.config());
        let markers = kit.advertise("climber/markers", QosPreset::State)?;
        kit.subscribe("climber/camera/camera_info", QosPreset::Image, |message: Arc<CameraInfo>| {
            convert::camera_model(&message).map(Arrival::Camera).map_err(|e: CameraModelError| e.to_string())
        })?;
        if parameters.image_transport == "compressed" {
            kit.subscribe("climber/camera/image_raw/compressed", QosPreset::Image, |message| {
                Some(Arrival::Compressed(message))
            })?;
        } else {
            kit.subscribe("climber/camera/image_raw", QosPreset::Image, |message| {
                Some(Arrival::Image(message))
            })?;
        }
        Ok(Self {
            tracker,
            frame: rig.frames.camera,
            markers,
            decoded: OwnedImage::default(),
            stages: Stages::default(),
            camera: None,
        })
    }

    fn handle(&mut self, kit: &mut Kit<Arrival>, arrival: Arrival) {
        match arrival {
            Arrival::Camera(camera) => {
                if self.camera.as_ref() != Some(&camera) {
                    self.camera = Some(camera.clone());
                    self.tracker.handle(Input::Camera(camera));
                }
            }
            Arrival::Image(message) => {
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
            Arrival::Compressed(message) => {
                let mut scratch = std::mem::take(&mut self.decoded);
                let clock = self.stages.start();
                let decoded = decode_compressed_into(&message.format, &message.data, &mut scratch);
                self.stages.converted(clock);
                let stamp = convert::stamp(&message.header.stamp);
                self.take(kit, decoded.map(|()| scratch.view(stamp)));
                self.decoded = scratch;
            }
        }
        self.publish(kit);
    }

    fn tick(&mut self, kit: &mut Kit<Arrival>) {
        let report = self.stages.report();
        let (health, message) = if report.images == 0 {
            (Health::Error, "no image came in the last second".to_owned())
        } else if report.taken == 0 {
            (Health::Error, "every image of the last second was refused; the log says why".to_owned())
        } else if self.camera.is_none() {
            (Health::Warn, "no camera_info yet: geometry is checked coarsely only".to_owned())
        } else if report.detected[0] == 0 {
            (Health::Warn, "no marker in view".to_owned())
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
        self.tracker.set_config(parameters.config());
        Ok(())
    }
}

impl MarkerTrackerNode {
    fn take(&mut self, kit: &mut Kit<Arrival>, view: Result<ImageView<'_>, ImageError>) {
        match view {
            Ok(view) => {
                let clock = self.stages.start();
                self.tracker.handle(Input::Image(view));
                self.stages.tracked(clock);
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
                    if matches!(warning, Warning::Image(_) | Warning::StampFromThePast { .. }) {
                        self.stages.refused();
                    }
                    kit.log_throttled(Level::Warn, warning.kind(), warning.to_string());
                }
            }
        }
    }
}
