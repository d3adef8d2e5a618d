//! Recordings of the rig with ground truth, as the types of the cores.
//!
//! A folder holds `in.mcap` (what the nodes received), `rig.yaml`, `truth.mcap` and, where the bag
//! has images, `truth_markers.csv` (the true centroids in them).

use crate::{BagError, BagMessage, BagReader};
use nalgebra::{Matrix2, Vector2, Vector3};
use node_kit::convert::{self, ConvertError};
use rig_model::{
    MarkerObservation, MarkerObservations, PerColor, Rig, Sample, Stamp,
    score::{Truth, TruthSample},
    topics::absolute as topics,
};
use std::{collections::HashMap, path::Path};
use volant_msgs::{Message, cdr, geometry_msgs, msg, nav_msgs::msg::Odometry, sensor_msgs};

/// Marker observations of images, by their stamps.
pub type Markers = HashMap<Stamp, MarkerObservations>;

/// Samples with their times of arrival, in the order of arrival.
pub type Samples = Vec<(Stamp, Sample)>;

/// Reads a folder: rig file, samples and true motion.
///
/// A bag without `climber/markers` gets for each of its compressed images the observations that
/// `markers` holds.
///
/// # Errors
/// A missing or unreadable file, or an undecodable message, with its path.
pub fn read(folder: &Path, markers: &Markers) -> Result<(Rig, Samples, Truth), BagError> {
    let path = folder.join("rig.yaml");
    let rig = Rig::from_yaml(&text(&path)?).map_err(|e| BagError::unusable(&path, e))?;
    let path = folder.join("in.mcap");
    let observed = BagReader::summary(&path)?.count(topics::MARKERS) > 0;
    let mut samples = Vec::new();
    let mut bag = BagReader::open(&path)?;
    while let Some(message) = bag.next_message()? {
        let wrong = |e: ConvertError| BagError::unusable(&path, e);
        let data = &message.data;
        let sample = match message.topic.name.as_str() {
            topics::IMU => {
                Sample::Imu(convert::imu_sample(&decode::<sensor_msgs::msg::Imu>(&path, data)?))
            }
            topics::CLIMBER_TRANSFORM => {
                let m = decode::<geometry_msgs::msg::TransformStamped>(&path, data)?;
                Sample::Climber(convert::climber_sample(&m, &rig.frames).map_err(wrong)?)
            }
            topics::CAMERA_INFO => {
                let m = decode::<sensor_msgs::msg::CameraInfo>(&path, data)?;
                let camera = convert::camera_model(&m);
                Sample::Camera(camera.map_err(|e| BagError::unusable(&path, e))?)
            }
            topics::MARKERS => {
                let m = decode::<msg::MarkerObservations>(&path, data)?;
                Sample::Markers(convert::marker_observations(&m).map_err(wrong)?)
            }
            topics::COMPRESSED_IMAGE if !observed => {
                let m = decode::<sensor_msgs::msg::CompressedImage>(&path, data)?;
                match markers.get(&convert::stamp(&m.header.stamp)) {
                    Some(markers) => Sample::Markers(markers.clone()),
                    None => continue,
                }
            }
            _ => continue,
        };
        let arrival = i64::try_from(message.log_time).unwrap_or(i64::MAX);
        samples.push((Stamp::from_nanos(arrival), sample));
    }
    let truth = read_truth(&folder.join("truth.mcap"), topics::GROUND_TRUTH, &mut vec![])?;
    Ok((rig, samples, truth))
}

/// Reads the messages on a topic; `map` gets the log time, ns, and the message of each.
///
/// # Errors
/// An unreadable bag, or an undecodable message.
pub fn map_messages<M: Message, T>(
    path: &Path,
    topic: &str,
    mut map: impl FnMut(u64, M) -> T,
) -> Result<Vec<T>, BagError> {
    let mut mapped = vec![];
    for_each(path, topic, |message| {
        mapped.push(cdr::from_bytes(&message.data).map(|decoded| map(message.log_time, decoded)));
    })?;
    let mapped: Result<_, cdr::CdrError> = mapped.into_iter().collect();
    mapped.map_err(|e| BagError::unusable(path, format!("a message on {topic}: {e}")))
}

/// Reads the decodable messages on a topic; what the bag lost, and the number of the other
/// messages, is appended to `losses`. `map` gets the log time, ns, and the message of each.
///
/// # Errors
/// An unreadable bag.
pub fn read_messages<M: Message, T>(
    path: &Path,
    topic: &str,
    losses: &mut Vec<String>,
    mut map: impl FnMut(u64, M) -> T,
) -> Result<Vec<T>, BagError> {
    let (mut mapped, mut undecodable) = (vec![], vec![]);
    let lost = for_each(path, topic, |message| match cdr::from_bytes(&message.data) {
        Ok(decoded) => mapped.push(map(message.log_time, decoded)),
        Err(error) => undecodable.push(error),
    })?;
    losses.extend(lost);
    if let Some(first) = undecodable.first() {
        let count = undecodable.len();
        losses
            .push(format!("{}: {count} messages on {topic} are ignored: {first}", path.display()));
    }
    Ok(mapped)
}

/// Calls `take` with each message on a topic; returns what the bag lost.
fn for_each(
    path: &Path,
    topic: &str,
    mut take: impl FnMut(BagMessage),
) -> Result<Vec<String>, BagError> {
    let mut bag = BagReader::open(path)?;
    while let Some(message) = bag.next_message()? {
        if message.topic.name == topic {
            take(message);
        }
    }
    Ok(bag.losses().to_vec())
}

/// Reads the marker observations of a bag.
///
/// # Errors
/// An unreadable bag, or an undecodable message.
pub fn read_markers(path: &Path) -> Result<Markers, BagError> {
    let observed = map_messages(path, topics::MARKERS, |_, m| convert::marker_observations(&m))?;
    let by_stamp = observed.into_iter().map(|m| m.map(|m| (m.stamp, m)));
    by_stamp.collect::<Result<_, _>>().map_err(|e| BagError::unusable(path, e))
}

/// Reads the true centroids from a folder's `truth_markers.csv`, with noise of `sigma` px.
///
/// `normal` yields numbers of mean 0 and standard deviation 1. Markers that are shown less than 99
/// % are lost.
///
/// # Errors
/// A missing or unreadable file.
pub fn true_centroids(
    folder: &Path,
    sigma: f64,
    mut normal: impl FnMut() -> f64,
) -> Result<Markers, BagError> {
    let table = text(&folder.join("truth_markers.csv"))?;
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let mut images = Markers::new();
    for line in lines {
        let fields: Vec<&str> = line.split(',').collect();
        let field =
            |name: &str| names.iter().position(|n| *n == name).and_then(|i| fields.get(i)).copied();
        let number =
            |name: &str| field(name).and_then(|f| f.parse::<f64>().ok()).unwrap_or(f64::NAN);
        let Some(stamp) = field("stamp_ns").and_then(|f| f.parse().ok()) else { continue };
        let stamp = Stamp::from_nanos(stamp);
        let markers = PerColor::from_fn(|color| {
            let noise = Vector2::new(normal(), normal()) * sigma;
            let of = |what: &str| number(&format!("{color}_{what}"));
            let shown = of("shown");
            if shown.is_nan() || shown < 0.99 {
                return MarkerObservation::lost(1);
            }
            let centroid = Vector2::new(of("cx"), of("cy")) + noise;
            MarkerObservation::detected(centroid, Matrix2::identity() * sigma * sigma, 1000.0)
        });
        images.insert(stamp, MarkerObservations { stamp, markers });
    }
    Ok(images)
}

/// Reads the true motion from the odometry on a topic; what the bag lost is appended to `losses`.
///
/// Undecodable messages are skipped.
///
/// # Errors
/// An unreadable bag.
pub fn read_truth(path: &Path, topic: &str, losses: &mut Vec<String>) -> Result<Truth, BagError> {
    let mut samples = vec![];
    let lost = for_each(path, topic, |message| {
        if message.topic.type_name != Odometry::TYPE_NAME {
            return;
        }
        let Ok(m) = cdr::from_bytes::<Odometry>(&message.data) else { return };
        let Ok(pose) = convert::pose(&m.pose.pose, "odometry") else { return };
        let (v, w) = (&m.twist.twist.linear, &m.twist.twist.angular);
        samples.push(TruthSample {
            stamp: convert::stamp(&m.header.stamp),
            world_from_volant: pose,
            linear_velocity: Vector3::new(v.x, v.y, v.z),
            angular_velocity: Vector3::new(w.x, w.y, w.z),
        });
    })?;
    losses.extend(lost);
    Ok(Truth::new(samples))
}

fn text(path: &Path) -> Result<String, BagError> {
    node_kit::files::read_text(path).map_err(|e| BagError::unusable(path, e))
}

fn decode<T: Message>(path: &Path, data: &[u8]) -> Result<T, BagError> {
    cdr::from_bytes(data).map_err(|e| BagError::unusable(path, e))
}
