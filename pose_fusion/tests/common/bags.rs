//! The developer bags (folder in the environment variable VOLANT_SHARED) with the true marker centroids plus noise in
//! place of a tracker.

use super::rig::random::Random;
use super::scoring::Truth;
use nalgebra::{Matrix2, Vector2};
use node_kit::convert;
use pose_fusion::Input;
use rig_model::{MarkerObservation, MarkerObservations, MarkerState, PerColor, Rig, Stamp};
use std::{collections::HashMap, path::PathBuf};
use volant_msgs::{cdr, geometry_msgs, nav_msgs, sensor_msgs};

/// A bag as the filter gets it, and its truth.
pub struct Bag {
    pub rig: Rig,
    /// In order of arrival.
    pub inputs: Vec<(Stamp, Input)>,
    pub truth: Vec<Truth>,
}

/// The folder of the bags, where there is one; says so where there is none.
pub fn folder() -> Option<PathBuf> {
    let folder = std::env::var_os("VOLANT_SHARED").map(|f| PathBuf::from(f).join("bags"));
    if folder.is_none() {
        println!("skipped: VOLANT_SHARED is not set");
    }
    folder
}

/// Reads a bag; markers are the true centroids with `sigma` px of noise, those shown less than 99 % are lost.
pub fn read(name: &str, sigma: f64, seed: u64) -> Option<Bag> {
    let folder = folder()?.join(name);
    let rig = Rig::from_yaml(&std::fs::read_to_string(folder.join("rig.yaml")).unwrap()).unwrap();
    let mut random = Random::fork(seed, "pixels");
    let table = std::fs::read_to_string(folder.join("truth_markers.csv")).unwrap();
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let column = |name: &str| names.iter().position(|n| *n == name).unwrap();
    let mut images: HashMap<i64, MarkerObservations> = HashMap::new();
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let number = |name: &str| fields[column(name)].parse::<f64>().unwrap_or(f64::NAN);
        let stamp: i64 = fields[column("stamp_ns")].parse().unwrap();
        let markers = PerColor::from_fn(|color| {
            let noise = Vector2::new(random.normal(), random.normal()) * sigma;
            if number(&format!("{color}_shown")) < 0.99 {
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
    let bytes = std::fs::read(folder.join("in.mcap")).unwrap();
    let mut inputs = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let at = Stamp::from_nanos(message.log_time as i64);
        let topic = message.channel.topic.trim_start_matches('/');
        let data = &message.data;
        let input = match topic {
            "volant/imu/data" => {
                Input::Imu(convert::imu_sample(&cdr::from_bytes::<sensor_msgs::msg::Imu>(data).unwrap()))
            }
            "climber/transform" => {
                let m = cdr::from_bytes::<geometry_msgs::msg::TransformStamped>(data).unwrap();
                Input::Climber(convert::climber_sample(&m, &rig.frames).unwrap())
            }
            "climber/camera/camera_info" => {
                let m = cdr::from_bytes::<sensor_msgs::msg::CameraInfo>(data).unwrap();
                Input::Camera(convert::camera_model(&m).unwrap())
            }
            "climber/camera/image_raw/compressed" => {
                let m = cdr::from_bytes::<sensor_msgs::msg::CompressedImage>(data).unwrap();
                let stamp = convert::stamp(&m.header.stamp);
                match images.get(&stamp.as_nanos()) {
                    Some(markers) => Input::Markers(markers.clone()),
                    None => continue,
                }
            }
            _ => continue,
        };
        inputs.push((at, input));
    }
    let bytes = std::fs::read(folder.join("truth.mcap")).unwrap();
    let truth = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| {
            let m = cdr::from_bytes::<nav_msgs::msg::Odometry>(&message.unwrap().data).unwrap();
            let v = &m.twist.twist.linear;
            Truth {
                stamp: convert::stamp(&m.header.stamp),
                pose: convert::pose(&m.pose.pose, "truth").unwrap(),
                velocity: nalgebra::Vector3::new(v.x, v.y, v.z),
            }
        })
        .collect();
    Some(Bag { rig, inputs, truth })
}
