//! Data of the simulated hardware as ROS messages.

use super::scenario::Scenario;
use nalgebra::Matrix6;
use node_kit::convert;
use rig_model::Stamp;
use rig_simulator::random::Random;
use volant_msgs::{
    nav_msgs::msg::Odometry,
    sensor_msgs::msg::{CompressedImage, JointState},
};

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
    JointState {
        header: convert::header("", stamp),
        name: ["rail_x", "rail_y", "turn"].map(str::to_owned).to_vec(),
        position: scenario.simulated_sensors().encoders(seconds, random).to_vec(),
        ..JointState::default()
    }
}

/// The truth, as bags hold it.
pub fn truth(scenario: &Scenario, seconds: f64, stamp: Stamp) -> Odometry {
    let (pose, velocity, rate) = scenario.truth(seconds);
    let (frames, none) = (&scenario.rig.frames, Matrix6::zeros());
    let (world, volant) = (&frames.world, &frames.volant);
    convert::odometry_message(world, volant, stamp, &pose, &none, &velocity, &rate, &none)
}
