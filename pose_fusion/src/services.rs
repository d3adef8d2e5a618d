//! Requests of an operator over ROS: services `~/reset`, `~/freeze`, `~/save_checkpoint`,
//! `~/load_checkpoint`, and the topic `volant/set_pose`, whose covariance must be positive
//! definite.

use crate::{Checkpoint, Fusion, PoseEstimate, node::Event};
use node_kit::{
    convert,
    node::{NodeContext, NodeError, Responder},
    qos::QosPreset,
};
use rig_model::{Frames, topics};
use std::{fs, path::Path, sync::Arc};
use volant_msgs::{
    geometry_msgs::msg::PoseWithCovarianceStamped,
    std_srvs::srv::{SetBool, SetBoolResponse, Trigger, TriggerResponse},
};

/// Request of an operator.
pub enum Request {
    /// Discard the estimate; the next image initializes it.
    Reset(Responder<Trigger>),
    /// Stop or resume using markers.
    Freeze(bool, Responder<SetBool>),
    /// Write a checkpoint to its file.
    Save(Responder<Trigger>),
    /// Read it back.
    Load(Responder<Trigger>),
    /// Put the platform at a pose.
    SetPose(Box<PoseEstimate>),
}

/// Offers the services and subscribes to the topic.
pub(crate) fn offer(context: &mut NodeContext<Event>, frames: &Frames) -> Result<(), NodeError> {
    context.serve::<Trigger>("~/reset", |_, answer| Event::Request(Request::Reset(answer)))?;
    context.serve::<SetBool>("~/freeze", |ask, answer| {
        Event::Request(Request::Freeze(ask.data, answer))
    })?;
    context
        .serve::<Trigger>("~/save_checkpoint", |_, answer| Event::Request(Request::Save(answer)))?;
    context
        .serve::<Trigger>("~/load_checkpoint", |_, answer| Event::Request(Request::Load(answer)))?;
    let world = frames.world.clone();
    context.subscribe_optional(
        topics::SET_POSE,
        QosPreset::State,
        move |m: Arc<PoseWithCovarianceStamped>| {
            Some(match pose_estimate(&m, &world) {
                Ok(pose) => Event::Request(Request::SetPose(Box::new(pose))),
                Err(why) => {
                    Event::Rejected(topics::SET_POSE, format!("{}: {why}", topics::SET_POSE))
                }
            })
        },
    )
}

fn pose_estimate(m: &PoseWithCovarianceStamped, world: &str) -> Result<PoseEstimate, String> {
    if m.header.frame_id != world {
        return Err(format!("the pose is in frame '{}', expected '{world}'", m.header.frame_id));
    }
    let stamp = convert::stamp(&m.header.stamp);
    if stamp.is_unset() {
        return Err("the stamp is zero; its publisher must set header.stamp".to_owned());
    }
    Ok(PoseEstimate {
        stamp,
        pose: convert::pose(&m.pose.pose, "the pose").map_err(|e| e.to_string())?,
        covariance: convert::covariance6(&m.pose.covariance),
    })
}

/// Carries out a request and answers it; a topic has no answer, so why not is returned.
pub(crate) fn answer(fusion: &mut Fusion, request: Request, file: &str) -> Result<(), String> {
    let reply = |result: Result<String, String>| match result {
        Ok(message) => TriggerResponse { success: true, message },
        Err(message) => TriggerResponse { success: false, message },
    };
    match request {
        Request::Reset(answer) => {
            fusion.reset();
            answer.respond(reply(Ok("the next image initializes the filter".to_owned())));
        }
        Request::Freeze(frozen, answer) => {
            let result = fusion.freeze(frozen).map(|()| {
                if !frozen {
                    "markers are used"
                } else if fusion.missing().is_empty() {
                    "markers are compared and not used"
                } else {
                    "markers are not used: no image initializes the pose while frozen"
                }
            });
            let success = result.is_ok();
            let message = result.map_or_else(|refusal| refusal.to_string(), str::to_owned);
            answer.respond(SetBoolResponse { success, message });
        }
        Request::Save(answer) => answer.respond(reply(save(fusion, file))),
        Request::Load(answer) => answer.respond(reply(load(fusion, file))),
        Request::SetPose(pose) => {
            return fusion.set_pose(&pose).map_err(|refusal| format!("volant/set_pose: {refusal}"));
        }
    }
    Ok(())
}

fn path(file: &str) -> Result<&Path, String> {
    if file.is_empty() {
        return Err("the parameter checkpoint_file is empty: set it to a path".to_owned());
    }
    Ok(Path::new(file))
}

fn save(fusion: &Fusion, file: &str) -> Result<String, String> {
    let path = path(file)?;
    let checkpoint = fusion.checkpoint().map_err(|refusal| refusal.to_string())?;
    let text = serde_json::to_string(&checkpoint).map_err(|e| e.to_string())?;
    node_kit::files::write(path, text.as_bytes(), true).map_err(|e| e.to_string())?;
    Ok(format!("written to {}", path.display()))
}

const SAVE: &str = "write one with ~/save_checkpoint of this version";

fn load(fusion: &mut Fusion, file: &str) -> Result<String, String> {
    let path = path(file)?;
    let text =
        fs::read_to_string(path).map_err(|e| format!("{}: cannot be read: {e}", path.display()))?;
    let checkpoint: Checkpoint = serde_json::from_str(&text)
        .map_err(|e| format!("{}: not a checkpoint: {e}; {SAVE}", path.display()))?;
    fusion
        .restore(&checkpoint)
        .map_err(|refusal| format!("{}: {refusal}; {SAVE}", path.display()))?;
    Ok(format!("restored from {}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_file_or_a_state_the_answer_names_what_is_missing() {
        let rig = rig_model::Rig::from_yaml(rig_simulator::RIG_YAML).unwrap();
        let mut fusion = Fusion::new(rig, crate::FusionConfig::default());
        assert!(save(&fusion, "").unwrap_err().contains("checkpoint_file"));
        assert!(save(&fusion, "/no/such/file").unwrap_err().contains("not initialized"));
        assert!(load(&mut fusion, "/no/such/file").unwrap_err().contains("cannot be read"));
    }

    #[test]
    fn a_pose_in_another_frame_or_without_a_stamp_is_rejected() {
        let mut m = PoseWithCovarianceStamped::default();
        m.header.frame_id = "map".to_owned();
        assert!(pose_estimate(&m, "world").unwrap_err().contains("'map'"));
        m.header.frame_id = "world".to_owned();
        assert!(pose_estimate(&m, "world").unwrap_err().contains("stamp"));
    }
}
