//! The cores before the filter: images and messages of a bag in, samples out.

use super::{
    feed::{Fed, ImageTopic},
    pipeline::{Counts, kind_of},
};
use bag::BagMessage;
use climber_driver::Climber;
use marker_tracker::{Input, Output, Tracker, TrackerConfig};
use node_kit::convert;
use rig_model::{CameraModel, Rig, Sample, Stamp, topics};
use volant_msgs::{
    Message, cdr, geometry_msgs::msg::TransformStamped, msg::MarkerObservations, sensor_msgs::msg,
    tf2_msgs::msg::TFMessage,
};

/// The topics of a bag that are read, by their names in it.
#[derive(Debug, Default)]
pub(crate) struct Roles {
    pub images: Option<ImageTopic>,
    pub markers: Option<String>,
    pub imu: Option<String>,
    pub transforms: Option<String>,
    /// Encoder readings, which the climber driver converts.
    pub joints: Option<String>,
    pub camera: Option<String>,
    pub tf_static: Option<String>,
}

impl Roles {
    /// Names of all but the images.
    pub fn messages(&self) -> Vec<String> {
        let climber = [&self.transforms, &self.joints];
        let others = [&self.markers, &self.imu, &self.camera, &self.tf_static];
        climber.into_iter().chain(others).flatten().cloned().collect()
    }
}

/// Marker tracker and climber driver, with what they have counted.
#[derive(Debug)]
pub(crate) struct FrontEnd {
    rig: Rig,
    roles: Roles,
    tracker: Tracker,
    /// Driver from which the climber's samples come, where the bag has none.
    pub climber: Option<Climber>,
    /// Camera of the last `camera_info`.
    pub camera: Option<CameraModel>,
    /// Why climber transforms were rejected.
    pub rejected: Vec<String>,
    /// Images, and warnings.
    pub counts: Counts,
}

impl FrontEnd {
    /// Creates the cores; `climber` is the driver for [`Roles::joints`].
    pub fn new(rig: &Rig, roles: Roles, tracker: &TrackerConfig, climber: Option<Climber>) -> Self {
        Self {
            rig: rig.clone(),
            roles,
            tracker: Tracker::new(rig.markers.clone(), tracker.clone()),
            climber,
            camera: None,
            rejected: vec![],
            counts: Counts::default(),
        }
    }

    /// Why the last image shows no marker, where none of the images does.
    pub fn why_no_marker(&self) -> Option<String> {
        self.tracker.why_not_found().filter(|_| self.counts.detected == 0)
    }

    /// Converts the next item of a bag.
    pub fn handle(&mut self, fed: Fed) -> Vec<Sample> {
        match fed {
            Fed::Image(Ok((stamp, image))) => {
                self.tracker.handle(Input::Image(image.view(stamp)));
                self.counts.images += 1;
                self.tracked()
            }
            Fed::Image(Err(reason)) => {
                self.counts.warn("image", || format!("an image is ignored: {reason}"));
                vec![]
            }
            Fed::Message(message) => self.message(&message),
        }
    }

    fn tracked(&mut self) -> Vec<Sample> {
        let mut samples = vec![];
        while let Some(output) = self.tracker.poll() {
            match output {
                Output::Observations(observations) => samples.push(Sample::Markers(observations)),
                Output::Warning(warning) => {
                    let kind = kind_of("tracker", &warning);
                    self.counts.warn(&kind, || format!("tracker: {warning}"));
                }
            }
        }
        samples
    }

    fn message(&mut self, message: &BagMessage) -> Vec<Sample> {
        let is = |role: &Option<String>| role.as_ref() == Some(&message.topic.name);
        let sample = if is(&self.roles.imu) {
            self.read(message).map(|m: msg::Imu| Sample::Imu(convert::imu_sample(&m)))
        } else if is(&self.roles.transforms) {
            self.read(message).and_then(|m| self.transform(&m))
        } else if is(&self.roles.joints) {
            return self.read(message).map_or(vec![], |m| self.joints(&m, message.log_time));
        } else if is(&self.roles.camera) {
            self.read(message).and_then(|m| self.camera_info(&m))
        } else if is(&self.roles.markers) {
            self.read(message).and_then(|m| self.markers(&m))
        } else {
            if is(&self.roles.tf_static)
                && let Some(m) = self.read::<TFMessage>(message)
            {
                self.compare(&m);
            }
            None
        };
        sample.into_iter().collect()
    }

    /// Decodes a message, or counts it with the warnings.
    fn read<M: Message>(&mut self, message: &BagMessage) -> Option<M> {
        let topic = &message.topic.name;
        let warn = |error: cdr::CdrError| {
            self.counts.warn(topic, || format!("{topic}: a message is ignored: {error}"));
        };
        cdr::from_bytes(&message.data).map_err(warn).ok()
    }

    fn transform(&mut self, message: &TransformStamped) -> Option<Sample> {
        match convert::climber_sample(message, &self.rig.frames) {
            Ok(sample) => Some(Sample::Climber(sample)),
            Err(error) => {
                self.rejected.push(error.to_string());
                None
            }
        }
    }

    /// Converts encoder readings as the driver does that receives them when the bag logged them.
    fn joints(&mut self, message: &msg::JointState, log_time: u64) -> Vec<Sample> {
        let mut samples = vec![];
        let Some(climber) = &mut self.climber else { return samples };
        let received = Stamp::from_nanos(i64::try_from(log_time).unwrap_or(0));
        climber.handle(&convert::joint_reading(message), received);
        while let Some(output) = climber.poll() {
            match output {
                climber_driver::Output::Sample(sample) => samples.push(Sample::Climber(sample)),
                climber_driver::Output::Warning(warning) => {
                    let kind = format!("climber {}", warning.kind());
                    self.counts.warn(&kind, || format!("climber: {warning}"));
                }
            }
        }
        samples
    }

    fn camera_info(&mut self, message: &msg::CameraInfo) -> Option<Sample> {
        match convert::camera_model(message) {
            Ok(model) if self.camera.as_ref() == Some(&model) => None,
            Ok(model) => {
                self.camera = Some(model.clone());
                self.tracker.handle(Input::Camera(model.clone()));
                Some(Sample::Camera(model))
            }
            Err(error) => {
                self.counts.warn("camera_info", || error.to_string());
                None
            }
        }
    }

    fn markers(&mut self, message: &MarkerObservations) -> Option<Sample> {
        match convert::marker_observations(message) {
            Ok(observations) => Some(Sample::Markers(observations)),
            Err(error) => {
                self.counts.warn(topics::MARKERS, || format!("{error}; such messages are ignored"));
                None
            }
        }
    }

    /// Compares `/tf_static` with the rig file, which takes precedence, and warns of differences.
    fn compare(&mut self, message: &TFMessage) {
        for ours in convert::static_transforms(&self.rig, Stamp::default()).transforms {
            let (parent, child) = (&ours.header.frame_id, &ours.child_frame_id);
            let theirs = message
                .transforms
                .iter()
                .find(|t| t.header.frame_id == *parent && t.child_frame_id == *child);
            let (Some(theirs), Ok(ours)) = (theirs, convert::isometry(&ours.transform, "rig"))
            else {
                continue;
            };
            let sentence = match convert::isometry(&theirs.transform, topics::absolute::TF_STATIC) {
                Err(error) => error.to_string(),
                Ok(theirs) => {
                    let meters = (theirs.translation.vector - ours.translation.vector).norm();
                    let degrees = theirs.rotation.angle_to(&ours.rotation).to_degrees();
                    // Rounding to eight digits in a file.
                    if meters <= 1e-4 && degrees <= 0.01 {
                        continue;
                    }
                    format!(
                        "/tf_static has {child} in {parent} {:.1} mm and {degrees:.2} deg from \
                         the rig file's; \
                         the rig file counts",
                        meters * 1e3
                    )
                }
            };
            self.counts.warn(&format!("/tf_static {parent} {child}"), || sentence);
        }
    }
}
