//! Names of all topics and frames.
//!
//! A relative name is moved by a namespace or a remap; [`absolute`] holds the same names below `/`,
//! as they are in a recording without either.

macro_rules! topics {
    ($($(#[$doc:meta])* $name:ident = $text:literal;)*) => {
        $($(#[$doc])* pub const $name: &str = $text;)*

        /// All of them.
        pub const ALL: &[&str] = &[$($name),*];

        /// The names below the root namespace.
        pub mod absolute {
            $($(#[$doc])* pub const $name: &str = concat!("/", $text);)*
        }
    };
}

topics! {
    /// Raw camera images, `sensor_msgs/Image`.
    IMAGE = "climber/camera/image_raw";
    /// JPEG or PNG camera images, `sensor_msgs/CompressedImage`.
    COMPRESSED_IMAGE = "climber/camera/image_raw/compressed";
    /// Intrinsics of the camera, `sensor_msgs/CameraInfo`.
    CAMERA_INFO = "climber/camera/camera_info";
    /// Encoder readings of the climber unit, `sensor_msgs/JointState`.
    JOINT_STATES = "climber/joint_states";
    /// `world_from_climber`, `geometry_msgs/TransformStamped`.
    CLIMBER_TRANSFORM = "climber/transform";
    /// Marker observations, `volant_msgs/MarkerObservations`.
    MARKERS = "climber/markers";
    /// Camera images with the markers drawn in, `sensor_msgs/CompressedImage`.
    MARKERS_DEBUG_IMAGE = "climber/markers/debug_image";
    /// IMU samples, `sensor_msgs/Imu`.
    IMU = "volant/imu/data";
    /// Fused `world_from_volant` with its twist, `nav_msgs/Odometry`.
    ODOMETRY = "volant/odometry";
    /// Fused `volant_from_world`, `geometry_msgs/PoseWithCovarianceStamped`.
    FUSED_POSE = "volant/fused_pose";
    /// Fused `world_from_volant`, `geometry_msgs/PoseWithCovarianceStamped`.
    POSE = "volant/pose";
    /// `world_from_volant` from one image, `geometry_msgs/PoseWithCovarianceStamped`.
    VISUAL_POSE = "volant/visual_pose";
    /// State of the estimate, `volant_msgs/PoseStatus`.
    STATUS = "volant/status";
    /// Odometry ahead by the prediction horizon, `nav_msgs/Odometry`.
    PREDICTED_ODOMETRY = "volant/predicted_odometry";
    /// Rope length and swing relative to the climber, `volant_msgs/Swing`.
    SWING = "volant/swing";
    /// Smoothed odometry of a replay, `nav_msgs/Odometry`.
    SMOOTHED_ODOMETRY = "volant/smoothed_odometry";
    /// Innovations of the marker measurements, `volant_msgs/MarkerUpdates`.
    MARKER_UPDATES = "volant/marker_updates";
    /// Pose set by the operator, `geometry_msgs/PoseWithCovarianceStamped`.
    SET_POSE = "volant/set_pose";
    /// True `world_from_volant` of a recording, `nav_msgs/Odometry`.
    GROUND_TRUTH = "ground_truth/odometry";
    /// Moving transforms, `tf2_msgs/TFMessage`.
    TF = "tf";
    /// Fixed transforms, `tf2_msgs/TFMessage`.
    TF_STATIC = "tf_static";
    /// Health of the nodes, `diagnostic_msgs/DiagnosticArray`.
    DIAGNOSTICS = "diagnostics";
    /// Simulated time, `rosgraph_msgs/Clock`.
    CLOCK = "clock";
    /// Log messages, `rcl_interfaces/Log`.
    ROSOUT = "rosout";
    /// Changes of parameters, `rcl_interfaces/ParameterEvent`.
    PARAMETER_EVENTS = "parameter_events";
}

/// Default frame ids.
pub mod frames {
    /// Initial point, z up.
    pub const WORLD: &str = "world";
    /// Climber unit on the ceiling.
    pub const CLIMBER: &str = "climber";
    /// Camera, z along the viewing direction.
    pub const CAMERA: &str = "camera_optical";
    /// Axes of the IMU.
    pub const IMU: &str = "imu";
    /// Platform.
    pub const VOLANT: &str = "volant";
}
