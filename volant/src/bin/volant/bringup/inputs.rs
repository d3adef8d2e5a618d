//! Topics of a recording: those with the rig's names, or else those that the operator chooses.

use super::{Walk, dialog};
use crate::{calibrate::colors::camera_info, settings::BagTopics};
use anyhow::{Error, Result};
use bag::BagReader;
use rig_model::topics;
use std::path::Path;
use volant::replay::TopicNames;
use volant_msgs::{
    Message,
    geometry_msgs::msg::TransformStamped,
    msg::MarkerObservations,
    sensor_msgs::msg::{CameraInfo, CompressedImage, Image, Imu, JointState},
};

/// What a step reads, the part of the rig that publishes it, and its topics by relative name and
/// type, the preferred one first.
type Input = (&'static str, &'static str, &'static [(&'static str, &'static str)]);

const IMAGES: Input = (
    "Images",
    "camera",
    &[(topics::IMAGE, Image::TYPE_NAME), (topics::COMPRESSED_IMAGE, CompressedImage::TYPE_NAME)],
);
/// Read where there are no images.
const MARKERS: Input =
    ("Markers", "marker_tracker", &[(topics::MARKERS, MarkerObservations::TYPE_NAME)]);
const INFO: Input = ("camera_info", "camera", &[(topics::CAMERA_INFO, CameraInfo::TYPE_NAME)]);
const JOINTS: Input = ("Joint states", "climber", &[(topics::JOINT_STATES, JointState::TYPE_NAME)]);
const CLIMBER: Input = (
    "Transforms and joint states",
    "climber",
    &[
        (topics::CLIMBER_TRANSFORM, TransformStamped::TYPE_NAME),
        (topics::JOINT_STATES, JointState::TYPE_NAME),
    ],
);
pub const IMU: Input = ("IMU samples", "imu_driver", &[(topics::IMU, Imu::TYPE_NAME)]);
pub const CAMERA: &[Input] = &[IMAGES, MARKERS, INFO];
pub const JOG: &[Input] = &[IMAGES, MARKERS, INFO, JOINTS];
pub const MOTION: &[Input] = &[IMAGES, MARKERS, INFO, CLIMBER, IMU];

impl Walk {
    /// Finds the topics of a recording. The operator chooses where several could serve and none has
    /// the rig's name; the choice holds in the other steps too.
    pub fn topics(&mut self, bag: &Path, inputs: &[Input]) -> Result<BagTopics> {
        let summary = BagReader::summary(bag)?;
        let (names, mut renamed) = (TopicNames::default(), BagTopics::default());
        let mut images: Option<String> = None;
        for input in inputs {
            let (what, part, alternatives) = *input;
            if *input == MARKERS && images.is_some() {
                continue;
            }
            let all: Vec<&str> =
                alternatives.iter().flat_map(|(_, kind)| summary.topics_of(kind)).collect();
            let beside = images.as_deref().map(camera_info).filter(|_| *input == INFO);
            let topic = match (beside, names.choose(&summary, alternatives)) {
                (Some(beside), _) if all.contains(&beside.as_str()) => beside,
                (_, Ok(None)) => continue,
                (_, Ok(Some((_, topic)))) => topic,
                (_, Err(_)) => self.chosen(what, part, &all)?,
            };
            let serves =
                |(_, kind): &&(&str, &str)| summary.topics_of(kind).contains(&topic.as_str());
            let Some((name, _)) = alternatives.iter().find(serves) else { continue };
            // A replay reads no topic of another name than the rig's, not even the only one.
            if names.resolve(name) != topic {
                renamed.remap.push(format!("{name}:={topic}").parse().map_err(Error::msg)?);
            }
            if *input == IMAGES {
                images = Some(topic);
            }
        }
        Ok(renamed)
    }

    /// Which of `all` is the rig's: the answer that another step got, or a new one.
    fn chosen(&mut self, what: &str, part: &str, all: &[&str]) -> Result<String> {
        let topics = &mut self.state.topics;
        let known = |topic: &&&str| topics.get(**topic).is_some_and(|step| *step != self.step);
        if let Some(known) = all.iter().find(known) {
            return Ok((*known).to_owned());
        }
        let question = format!("  {what} on {}. The topic of the rig's {part}", all.join(", "));
        let topic = dialog::choose(&question, all)?;
        topics.retain(|topic, _| !all.contains(&topic.as_str()));
        topics.insert(topic.clone(), self.step.clone());
        Ok(topic)
    }
}
