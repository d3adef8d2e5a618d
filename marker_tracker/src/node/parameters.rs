//! Parameters of the node.

#[cfg(feature = "opencv")]
use crate::config::BinaryThreshold;
use crate::config::{Method, TrackerConfig};
use rig_model::{Rig, topics};

node_kit::parameters! {
    /// Parameters of the node: those of the core, and what only the node needs.
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
        /// Tracking method: outline (outlines of the squares, checked against the layout) or paper
        /// (the published tracker on OpenCV, without layout and camera model).
        method: String = "outline", one_of(&["outline", "paper"]);
        /// Threshold of the binary images, as a share of the range (method paper).
        paper_threshold: f64 = 0.75, range(0.05..=0.99), live, name("paper.threshold");
        /// The range is the maximum of a color layer; false: 255 as printed, which finds only
        /// saturated colors (method paper).
        paper_threshold_of_maximum: bool = true, live, name("paper.threshold_of_maximum");
        groups {
            /// Configuration of the core, without the method.
            core: TrackerConfig;
        }
    }
    check(p) {
        check_method(&p.method, cfg!(feature = "opencv"))
    }
}

/// Whether a build with or without OpenCV has a method.
fn check_method(method: &str, has_opencv: bool) -> Result<(), String> {
    if method != "paper" || has_opencv {
        return Ok(());
    }
    Err("the parameter `method` is paper, which runs on OpenCV, but this build omits OpenCV; build \
         marker_tracker with feature `opencv`, or set `method` to outline"
        .to_owned())
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

    fn method(&self) -> Method {
        #[cfg(feature = "opencv")]
        if self.method == "paper" {
            return Method::Paper(BinaryThreshold {
                share: self.paper_threshold,
                of_maximum: self.paper_threshold_of_maximum,
            });
        }
        Method::Outline
    }

    /// Settings of the core, with the calibrated colors of the rig file.
    pub fn config(&self, rig: &Rig) -> TrackerConfig {
        TrackerConfig { method: self.method(), start_colors: rig.colors, ..self.core.clone() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use node_kit::{
        ParameterSet,
        parameters::{ParameterMap, ParameterValue},
    };

    #[test]
    fn the_published_method_is_rejected_by_a_build_without_opencv() {
        assert_eq!(check_method("outline", false), Ok(()));
        assert_eq!(check_method("paper", true), Ok(()));
        let reason = check_method("paper", false).unwrap_err();
        assert!(reason.contains("`method`") && reason.contains("`opencv`"), "{reason}");
        let map = |value: &str| {
            ParameterMap::from([("method".to_owned(), ParameterValue::String(value.to_owned()))])
        };
        let paper = MarkerTrackerParameters::from_map(&map("paper"));
        assert_eq!(paper.is_ok(), cfg!(feature = "opencv"));
        #[cfg(feature = "opencv")]
        assert_eq!(paper.unwrap().method(), Method::Paper(BinaryThreshold::default()));
        assert!(MarkerTrackerParameters::from_map(&map("papers")).is_err());
        assert_eq!(MarkerTrackerParameters::default().method(), Method::Outline);
    }
}
