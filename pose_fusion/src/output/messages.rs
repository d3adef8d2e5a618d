//! ROS messages of the outputs, for the live node and for replay.

use crate::{Odometry, PoseEstimate, PoseStatus, Swing, measurements::Innovation};
use node_kit::convert;
use rig_model::{Frames, MarkerColor};
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
pub fn marker_updates(u: &crate::MarkerUpdates, frames: &Frames) -> MarkerUpdates {
    let marker = |(color, m): (MarkerColor, &Innovation<2>)| MarkerUpdate {
        color: color as u8,
        outcome: m.outcome as u8,
        innovation: [m.residual.x, m.residual.y],
        covariance: convert::covariance2_message(&m.covariance),
        nis: m.nis,
    };
    MarkerUpdates {
        header: convert::header(&frames.camera, u.stamp),
        markers: u.markers.iter().map(marker).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Outcome;

    #[test]
    fn outcomes_have_the_numbers_of_the_message() {
        for (ours, theirs) in [
            (Outcome::Used, MarkerUpdate::USED),
            (Outcome::NotDetected, MarkerUpdate::NOT_DETECTED),
            (Outcome::Gated, MarkerUpdate::GATED),
            (Outcome::Inconsistent, MarkerUpdate::INCONSISTENT),
            (Outcome::NotPredictable, MarkerUpdate::NOT_PREDICTABLE),
            (Outcome::NotInitialized, MarkerUpdate::NOT_INITIALIZED),
            (Outcome::Rejected, MarkerUpdate::REJECTED),
            (Outcome::Frozen, MarkerUpdate::FROZEN),
        ] {
            assert_eq!(ours as u8, theirs, "{ours:?}");
        }
    }
}
