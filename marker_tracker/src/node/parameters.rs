//! Parameters of the node.

use crate::config::TrackerConfig;
use rig_model::{Rig, topics};

node_kit::parameters! {
    /// Parameters of the marker tracker: one field per ROS parameter, whatever their number.
    pub struct MarkerTrackerParameters {
        /// Where images come from: a topic, a V4L2 camera device or a video file.
        source: String = "topic", one_of(&["topic", "device", "file"]);
        /// Image topic of the camera: image_raw or image_raw/compressed.
        image_transport: String = "raw", one_of(&["raw", "compressed"]);
        /// Calibration file of the device's or file's camera (file:///path or a path; YAML as
        /// written by camera_calibration), published as climber/camera/camera_info. Empty: none.
        camera_info_url: String = "";
        /// Camera device.
        device_path: String = "/dev/video0", name("device.path");
        /// Requested image width; the camera may use another.
        device_width: u32 = 640, unit("px"), range(16..=16384), name("device.width");
        /// Requested image height; the camera may use another.
        device_height: u32 = 480, unit("px"), range(16..=16384), name("device.height");
        /// Requested image rate.
        device_rate: f64 = 30.0, unit("Hz"), range(1.0..=1000.0), name("device.rate");
        /// V4L2 code of the pixel format (YUYV, MJPG, …); empty: the first that works.
        device_format: String = "", name("device.format");
        /// Offset from the driver's stamp to the middle of the exposure.
        device_stamp_offset: f64 = 0.0, unit("s"), range(-1.0..=1.0), name("device.stamp_offset");
        /// Video file (needs ffmpeg).
        file_path: String = "", name("file.path");
        /// Use the optical flow, the paper's first criterion.
        use_flow: bool = true, live;
        /// Use the hue histogram, the paper's second criterion.
        use_hue: bool = true, live;
        /// Number of consecutive images for which a hidden marker is predicted before it is lost.
        max_predicted: u16 = 6, range(0..=100), live;
        /// Move a hidden marker with the platform's rigid motion; false: with the others' mean flow
        /// (eq. 3).
        rigid_prediction: bool = true, live;
        /// Largest standard deviation of a measured centroid.
        max_centroid_sigma: f64 = 0.5, unit("px"), range(0.01..=10.0), live;
    }
}

impl MarkerTrackerParameters {
    /// Topic, device or file that the images come from.
    pub fn source_name(&self) -> &str {
        match (self.source.as_str(), self.image_transport.as_str()) {
            ("device", _) => &self.device_path,
            ("file", _) => &self.file_path,
            (_, "compressed") => topics::COMPRESSED_IMAGE,
            _ => topics::IMAGE,
        }
    }

    /// Settings of the core, with the calibrated colors of the rig file.
    pub fn config(&self, rig: &Rig) -> TrackerConfig {
        TrackerConfig {
            use_flow: self.use_flow,
            use_hue: self.use_hue,
            max_predicted: self.max_predicted,
            rigid_prediction: self.rigid_prediction,
            max_centroid_sigma: self.max_centroid_sigma,
            start_colors: rig.colors,
        }
    }
}
