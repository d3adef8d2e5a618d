//! The node's parameters, declared once.

use crate::TrackerConfig;
use rig_model::Rig;

node_kit::parameters! {
    /// Parameters of the marker tracker.
    pub struct MarkerTrackerParameters {
        /// Where images come from: a topic, a V4L2 camera device or a video file.
        source: String = "topic", one_of(&["topic", "device", "file"]);
        /// Which of the camera's image topics is read: image_raw or image_raw/compressed.
        image_transport: String = "raw", one_of(&["raw", "compressed"]);
        /// File with the calibration of the device's or file's camera (file:///path or a path; YAML as camera_calibration
        /// writes it); it is published as climber/camera/camera_info. Empty: none.
        camera_info_url: String = "";
        /// The camera device.
        device_path: String = "/dev/video0", name("device.path");
        /// Width that the camera is asked for; it may give another.
        device_width: u32 = 640, unit("px"), range(16..=16384), name("device.width");
        /// Height that the camera is asked for; it may give another.
        device_height: u32 = 480, unit("px"), range(16..=16384), name("device.height");
        /// Images per second that the camera is asked for.
        device_rate: f64 = 30.0, unit("Hz"), range(1.0..=1000.0), name("device.rate");
        /// V4L2's four letters of the pixel format (YUYV, MJPG, …); empty takes the first that works.
        device_format: String = "", name("device.format");
        /// Added to the driver's stamp to get the middle of the exposure.
        device_stamp_offset: f64 = 0.0, unit("s"), range(-1.0..=1.0), name("device.stamp_offset");
        /// The video file (needs ffmpeg).
        file_path: String = "", name("file.path");
        /// Use the optical flow, the paper's first criterion.
        use_flow: bool = true, live;
        /// Use the hue histogram, the paper's second criterion.
        use_hue: bool = true, live;
        /// Images in a row for which an occluded marker is predicted before it is lost.
        max_predicted: u16 = 6, range(0..=100), live;
        /// Move an occluded marker with the others' flow as a rigid motion; false takes their mean flow (eq. 3).
        rigid_prediction: bool = true, live;
        /// Largest standard deviation of a centroid that still counts as measured.
        max_centroid_sigma: f64 = 0.5, unit("px"), range(0.01..=10.0), live;
    }
}

impl MarkerTrackerParameters {
    /// As the core wants them, with the colours of the rig file.
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
