//! Names, definition texts and hashes compared with those of ROS 2 Jazzy.

use volant_msgs::{
    MESSAGES, Message, SERVICES, geometry_msgs::msg::Quaternion, msg, nav_msgs, rcl_interfaces,
};

const JAZZY: &str = include_str!("jazzy_type_hashes.txt");

#[test]
fn every_hash_equals_that_of_ros_2_jazzy() {
    let mut compared = 0;
    for line in JAZZY.lines().filter(|l| !l.starts_with('#')) {
        let (name, expected) = line.split_once(' ').unwrap();
        let ours = MESSAGES
            .iter()
            .map(|m| (m.type_name, m.rihs01_hash))
            .chain(SERVICES.iter().copied())
            .find(|(n, _)| *n == name);
        assert_eq!(ours, Some((name, expected)));
        compared += 1;
    }
    let own = MESSAGES.iter().filter(|m| m.type_name.starts_with("volant_msgs/")).count();
    assert_eq!(own, 6);
    assert_eq!(compared, MESSAGES.len() - own + SERVICES.len(), "each standard type is compared");
}

#[test]
fn names_and_definitions_equal_those_of_a_bag() {
    assert_eq!(Quaternion::TYPE_NAME, "geometry_msgs/msg/Quaternion");
    let blocks: Vec<&str> = nav_msgs::msg::Odometry::DEFINITION
        .split(&("=".repeat(80) + "\n"))
        .map(|block| block.lines().next().unwrap())
        .collect();
    assert_eq!(blocks[0], "std_msgs/Header header");
    for name in [
        "std_msgs/Header",
        "builtin_interfaces/Time",
        "geometry_msgs/PoseWithCovariance",
        "geometry_msgs/Pose",
    ] {
        assert_eq!(
            blocks.iter().filter(|b| **b == format!("MSG: {name}")).count(),
            1,
            "{name} in {blocks:?}"
        );
    }
    assert!(
        msg::MarkerObservations::DEFINITION
            .contains("always in the order red, green, blue, yellow")
    );
}

#[test]
fn defaults_and_constants_equal_those_of_the_definition() {
    assert_eq!(Quaternion::default(), Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 });
    assert_eq!(rcl_interfaces::msg::Log::WARN, 30);
    assert_eq!(msg::MarkerObservation::YELLOW, 3);
    assert_eq!(msg::MarkerObservation::LOST, 2);
    let request =
        volant_msgs::type_description_interfaces::srv::GetTypeDescriptionRequest::default();
    assert!(request.include_type_sources);
}
