//! Messages of the outputs: what the live node publishes and a replay writes.

use crate::{MarkerOutcome, MarkerUpdateRecord, Odometry, PoseEstimate};
use node_kit::convert;
use rig_model::{Frames, MarkerColor};
use std::sync::Arc;
use volant_msgs::{
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    msg::{MarkerUpdate, MarkerUpdates},
    nav_msgs,
};

/// `volant/odometry`.
pub fn odometry(o: &Odometry, frames: &Frames) -> nav_msgs::msg::Odometry {
    convert::odometry_message(
        &frames.world,
        &frames.volant,
        o.stamp,
        &o.world_from_volant,
        &o.pose_covariance,
        &o.linear_velocity,
        &o.angular_velocity,
        &o.twist_covariance,
    )
}

/// `volant/fused_pose`: the same estimate stamped in the volant frame.
pub fn fused_pose(o: &Odometry, frames: &Frames) -> PoseWithCovarianceStamped {
    let p = o.fused_pose();
    convert::pose_with_covariance_message(&frames.volant, p.stamp, &p.pose, &p.covariance)
}

/// `volant/visual_pose`.
pub fn visual_pose(p: &PoseEstimate, frames: &Frames) -> PoseWithCovarianceStamped {
    convert::pose_with_covariance_message(&frames.world, p.stamp, &p.pose, &p.covariance)
}

/// `/tf`: world → volant.
pub fn transform(o: &Odometry, frames: &Frames) -> TransformStamped {
    convert::transform_message(&frames.world, &frames.volant, o.stamp, &o.world_from_volant)
}

/// `volant/marker_updates`: the records of one image.
pub fn marker_updates(records: &[MarkerUpdateRecord], frames: &Frames) -> Option<MarkerUpdates> {
    let stamp = records.first()?.stamp;
    Some(MarkerUpdates {
        header: convert::header(&frames.camera, stamp),
        markers: records.iter().map(marker_update).collect(),
    })
}

fn marker_update(r: &MarkerUpdateRecord) -> MarkerUpdate {
    MarkerUpdate {
        color: r.color as u8,
        outcome: match r.outcome {
            MarkerOutcome::Used => MarkerUpdate::USED,
            MarkerOutcome::NotDetected => MarkerUpdate::NOT_DETECTED,
            MarkerOutcome::Gated => MarkerUpdate::GATED,
            MarkerOutcome::Inconsistent => MarkerUpdate::INCONSISTENT,
            MarkerOutcome::NotPredictable => MarkerUpdate::NOT_PREDICTABLE,
            MarkerOutcome::NotInitialised => MarkerUpdate::NOT_INITIALISED,
            MarkerOutcome::Refused => MarkerUpdate::REFUSED,
            MarkerOutcome::Frozen => MarkerUpdate::FROZEN,
        },
        innovation: [r.innovation.x, r.innovation.y],
        covariance: convert::covariance2_message(&r.covariance),
        nis: r.nis,
    }
}

/// Records come marker by marker: gathers those of one image.
#[derive(Debug, Default)]
pub struct Gathered(Vec<MarkerUpdateRecord>);

impl Gathered {
    /// Adds a record; with the fourth the message is complete.
    pub fn add(&mut self, record: MarkerUpdateRecord, frames: &Frames) -> Option<Arc<MarkerUpdates>> {
        if self.0.first().is_some_and(|f| f.stamp != record.stamp) {
            self.0.clear();
        }
        self.0.push(record);
        if self.0.len() < MarkerColor::ALL.len() {
            return None;
        }
        let message = marker_updates(&self.0, frames).map(Arc::new);
        self.0.clear();
        message
    }
}
