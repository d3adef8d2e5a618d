//! ROS messages of the outputs, for the live node and for replay.

use crate::{MarkerOutcome, MarkerUpdateRecord, Odometry, PoseEstimate, PoseStatus, Swing};
use node_kit::convert;
use rig_model::{Frames, MarkerColor};
use std::sync::Arc;
use volant_msgs::{
    geometry_msgs::msg::{PoseWithCovarianceStamped, TransformStamped},
    msg::{self, MarkerUpdate, MarkerUpdates},
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

/// `volant/fused_pose`: the inverse pose, stamped in the volant frame.
pub fn fused_pose(o: &Odometry, frames: &Frames) -> PoseWithCovarianceStamped {
    let p = o.fused_pose();
    convert::pose_with_covariance_message(&frames.volant, p.stamp, &p.pose, &p.covariance)
}

/// `volant/visual_pose`.
pub fn visual_pose(p: &PoseEstimate, frames: &Frames) -> PoseWithCovarianceStamped {
    convert::pose_with_covariance_message(&frames.world, p.stamp, &p.pose, &p.covariance)
}

/// `volant/pose`: the pose of the odometry, `world_from_volant`.
pub fn pose(o: &Odometry, frames: &Frames) -> PoseWithCovarianceStamped {
    convert::pose_with_covariance_message(
        &frames.world,
        o.stamp,
        &o.world_from_volant,
        &o.pose_covariance,
    )
}

/// `volant/status`.
pub fn status(s: &PoseStatus, frames: &Frames) -> msg::PoseStatus {
    msg::PoseStatus {
        header: convert::header(&frames.world, s.stamp),
        state: s.state as u8,
        valid: s.valid,
        position_sigma: s.position_sigma,
        rotation_sigma: s.rotation_sigma,
        image_age: s.image_age,
        imu_age: s.imu_age,
        climber_age: s.climber_age,
        markers_used: s.markers_used,
        camera_time_offset: s.time_offset,
        reason: s.reason.clone(),
    }
}

/// `volant/swing`.
pub fn swing(s: &Swing, frames: &Frames) -> msg::Swing {
    msg::Swing {
        header: convert::header(&frames.climber, s.stamp),
        rope_length: s.rope_length,
        angle_x: s.angles[0],
        angle_y: s.angles[1],
        rope_rate: s.rope_rate,
        rate_x: s.rates[0],
        rate_y: s.rates[1],
        covariance: convert::covariance6_message(&s.covariance),
        pose: convert::pose_message(&s.climber_from_volant),
        twist: convert::twist_message(&s.linear_velocity, &s.angular_velocity),
    }
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
            MarkerOutcome::NotInitialized => MarkerUpdate::NOT_INITIALISED,
            MarkerOutcome::Rejected => MarkerUpdate::REFUSED,
            MarkerOutcome::Frozen => MarkerUpdate::FROZEN,
        },
        innovation: [r.innovation.x, r.innovation.y],
        covariance: convert::covariance2_message(&r.covariance),
        nis: r.nis,
    }
}

/// Gathers the records of one image, which come marker by marker.
#[derive(Debug, Default)]
pub struct Gathered(Vec<MarkerUpdateRecord>);

impl Gathered {
    /// Adds a record and returns the message with the fourth.
    pub fn add(
        &mut self,
        record: MarkerUpdateRecord,
        frames: &Frames,
    ) -> Option<Arc<MarkerUpdates>> {
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
