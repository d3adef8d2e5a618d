//! Recordings with ground truth as inputs of the estimator.

use nalgebra::{Isometry3, Matrix2, Vector2};
use node_kit::convert;
use pose_fusion::Input;
use rig_model::{CameraModel, MarkerObservation, MarkerObservations, MarkerState, PerColor, Rig, Stamp};
use std::{collections::HashMap, fs, path::Path};
use volant_msgs::{cdr, geometry_msgs, msg, nav_msgs, sensor_msgs};

/// Recording of one run.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Name of its folder.
    pub name: String,
    /// Rig file.
    pub rig: Rig,
    /// Inputs with their times of arrival, in the order of arrival.
    pub inputs: Vec<(Stamp, Input)>,
    /// True poses `world_from_volant` in the order of time.
    pub truth: Vec<(Stamp, Isometry3<f64>)>,
}

impl Recording {
    /// Reads a folder with `in.mcap`, `rig.yaml`, `truth.mcap` and `truth_markers.csv`.
    ///
    /// Markers are those on `climber/markers` of the bag `markers` (a replay's output) or of the recording itself; without any
    /// they are the true centroids with 0.1 px of noise.
    ///
    /// # Errors
    /// A file that is missing or cannot be read, with its name.
    pub fn read(folder: &Path, markers: Option<&Path>) -> Result<Self, String> {
        let file = |name: &str| {
            let path = folder.join(name);
            fs::read(&path).map_err(|e| format!("{}: {e}", path.display()))
        };
        let text = |name: &str| String::from_utf8(file(name)?).map_err(|e| format!("{name}: {e}"));
        let rig = Rig::from_yaml(&text("rig.yaml")?).map_err(|e| format!("rig.yaml: {e}"))?;
        let mut images = match markers {
            Some(path) => tracked(&fs::read(path).map_err(|e| format!("{}: {e}", path.display()))?)?,
            None => HashMap::new(),
        };
        if images.is_empty() {
            images = true_centroids(&text("truth_markers.csv")?, 0.1);
        }
        let mut inputs = Vec::new();
        let bytes = file("in.mcap")?;
        let tracked_inside = !tracked(&bytes)?.is_empty();
        for message in mcap::MessageStream::new(&bytes).map_err(|e| e.to_string())? {
            let message = message.map_err(|e| e.to_string())?;
            let at = Stamp::from_nanos(message.log_time as i64);
            let data = &message.data;
            let input = match message.channel.topic.trim_start_matches('/') {
                "volant/imu/data" => Input::Imu(convert::imu_sample(&decode::<sensor_msgs::msg::Imu>(data)?)),
                "climber/transform" => {
                    let m = decode::<geometry_msgs::msg::TransformStamped>(data)?;
                    Input::Climber(convert::climber_sample(&m, &rig.frames).map_err(|e| e.to_string())?)
                }
                "climber/camera/camera_info" => {
                    let m = decode::<sensor_msgs::msg::CameraInfo>(data)?;
                    Input::Camera(convert::camera_model(&m).map_err(|e| e.to_string())?)
                }
                "climber/markers" => {
                    let m = decode::<msg::MarkerObservations>(data)?;
                    Input::Markers(convert::marker_observations(&m).map_err(|e| e.to_string())?)
                }
                "climber/camera/image_raw/compressed" if !tracked_inside => {
                    let m = decode::<sensor_msgs::msg::CompressedImage>(data)?;
                    match images.get(&convert::stamp(&m.header.stamp).as_nanos()) {
                        Some(markers) => Input::Markers(markers.clone()),
                        None => continue,
                    }
                }
                _ => continue,
            };
            inputs.push((at, input));
        }
        let bytes = file("truth.mcap")?;
        let mut truth = Vec::new();
        for message in mcap::MessageStream::new(&bytes).map_err(|e| e.to_string())? {
            let m = decode::<nav_msgs::msg::Odometry>(&message.map_err(|e| e.to_string())?.data)?;
            let pose = convert::pose(&m.pose.pose, "truth").map_err(|e| e.to_string())?;
            truth.push((convert::stamp(&m.header.stamp), pose));
        }
        let name = folder.file_name().map_or(String::new(), |n| n.to_string_lossy().into_owned());
        Ok(Self { name, rig, inputs, truth })
    }

    /// Returns the stamp of the first truth.
    pub fn start(&self) -> Stamp {
        self.truth.first().map_or(Stamp::default(), |(stamp, _)| *stamp)
    }

    /// Returns the true pose at an instant, interpolated.
    pub fn pose_at(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        let after = self.truth.partition_point(|(at, _)| *at < stamp);
        let (a, b) = (self.truth.get(after.checked_sub(1)?)?, self.truth.get(after)?);
        let share = stamp.seconds_since(a.0) / b.0.seconds_since(a.0);
        Some(a.1.lerp_slerp(&b.1, share))
    }

    /// Returns by how much the climber moves the platform at most, m/s: its speed, and its turn by the platform's distance.
    pub fn climber_speed(&self) -> f64 {
        /// Number of readings over which a speed is taken: encoders count in steps.
        const SPAN: usize = 5;
        let poses: Vec<(Stamp, Isometry3<f64>)> = self
            .inputs
            .iter()
            .filter_map(|(_, input)| match input {
                Input::Climber(c) => Some((c.stamp, c.world_from_climber)),
                _ => None,
            })
            .collect();
        let moved = |a: &(Stamp, Isometry3<f64>), b: &(Stamp, Isometry3<f64>)| {
            let truth = self.pose_at(b.0)?.translation.vector;
            let arm = (truth - b.1.translation.vector).xy().norm();
            let way = (b.1.translation.vector - a.1.translation.vector).norm();
            Some((way + arm * a.1.rotation.angle_to(&b.1.rotation)) / b.0.seconds_since(a.0))
        };
        let speeds = poses.iter().zip(poses.iter().skip(SPAN)).filter_map(|(a, b)| moved(a, b));
        speeds.filter(|speed| speed.is_finite()).fold(0.0, f64::max)
    }

    /// Returns the camera's calibration.
    pub fn camera(&self) -> Option<&CameraModel> {
        self.inputs.iter().find_map(|(_, input)| match input {
            Input::Camera(camera) => Some(camera),
            _ => None,
        })
    }
}

fn decode<T: cdr::Cdr>(data: &[u8]) -> Result<T, String> {
    cdr::from_bytes(data).map_err(|e| e.to_string())
}

/// Marker observations of a bag, by their stamp.
fn tracked(bytes: &[u8]) -> Result<HashMap<i64, MarkerObservations>, String> {
    let mut images = HashMap::new();
    for message in mcap::MessageStream::new(bytes).map_err(|e| e.to_string())? {
        let message = message.map_err(|e| e.to_string())?;
        if message.channel.topic.trim_start_matches('/') == "climber/markers" {
            let m = decode::<msg::MarkerObservations>(&message.data)?;
            let m = convert::marker_observations(&m).map_err(|e| e.to_string())?;
            images.insert(m.stamp.as_nanos(), m);
        }
    }
    Ok(images)
}

/// True centroids with white noise of `sigma` px; markers that are shown less than 99 % are lost.
fn true_centroids(table: &str, sigma: f64) -> HashMap<i64, MarkerObservations> {
    let mut random = crate::rig::random::Random::fork(1, "pixels");
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let mut images = HashMap::new();
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let field = |name: &str| names.iter().position(|n| *n == name).and_then(|i| fields.get(i)).copied();
        let number = |name: &str| field(name).and_then(|f| f.parse::<f64>().ok()).unwrap_or(f64::NAN);
        let Some(stamp) = field("stamp_ns").and_then(|f| f.parse::<i64>().ok()) else { continue };
        let markers = PerColor::from_fn(|color| {
            let noise = Vector2::new(random.normal(), random.normal()) * sigma;
            if number(&format!("{color}_shown")).is_nan() || number(&format!("{color}_shown")) < 0.99 {
                return MarkerObservation::lost(1);
            }
            MarkerObservation {
                state: MarkerState::Detected,
                occluded_frames: 0,
                centroid: Vector2::new(number(&format!("{color}_cx")), number(&format!("{color}_cy")))
                    + noise,
                covariance: Matrix2::identity() * sigma * sigma,
                area: 1000.0,
            }
        });
        images.insert(stamp, MarkerObservations { stamp: Stamp::from_nanos(stamp), markers });
    }
    images
}
