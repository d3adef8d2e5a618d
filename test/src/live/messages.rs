//! Data of the simulated hardware as ROS messages.

use super::scenario::Scenario;
use nalgebra::Vector3;
use node_kit::convert;
use rig_model::Stamp;
use rig_simulator::random::Random;
use volant_msgs::{
    geometry_msgs::msg::{PoseWithCovariance, Twist, TwistWithCovariance},
    nav_msgs::msg::Odometry,
    sensor_msgs::msg::{CompressedImage, JointState},
};

/// A JPEG image.
pub fn compressed_image(stamp: Stamp, frame_id: &str, jpeg: Vec<u8>) -> CompressedImage {
    CompressedImage {
        header: convert::header(frame_id, stamp),
        format: "rgb8; jpeg compressed bgr8".to_owned(),
        data: jpeg,
    }
}

/// The encoders as the control stack publishes them, read at `seconds` of the scenario.
pub fn joint_state(
    scenario: &Scenario,
    random: &mut Random,
    seconds: f64,
    stamp: Stamp,
) -> JointState {
    let c = &scenario.sensors;
    let mut position = scenario.motion.climber(seconds).to_vec();
    for (i, value) in position.iter_mut().enumerate() {
        let kind = usize::from(i == 2);
        *value += c.climber_noise[kind] * random.normal();
        if c.climber_quantum[kind] > 0.0 {
            *value = (*value / c.climber_quantum[kind]).round() * c.climber_quantum[kind];
        }
    }
    JointState {
        header: convert::header("", stamp),
        name: ["rail_x", "rail_y", "turn"].map(str::to_owned).to_vec(),
        position,
        ..JointState::default()
    }
}

/// The truth, as bags hold it.
pub fn truth(scenario: &Scenario, seconds: f64, stamp: Stamp) -> Odometry {
    let (pose, velocity, rate) = scenario.truth(seconds);
    let vector =
        |v: Vector3<f64>| volant_msgs::geometry_msgs::msg::Vector3 { x: v.x, y: v.y, z: v.z };
    Odometry {
        header: convert::header(&scenario.rig.frames.world, stamp),
        child_frame_id: scenario.rig.frames.volant.clone(),
        pose: PoseWithCovariance { pose: convert::pose_message(&pose), covariance: [0.0; 36] },
        twist: TwistWithCovariance {
            twist: Twist { linear: vector(velocity), angular: vector(rate) },
            covariance: [0.0; 36],
        },
    }
}
