//! What a bag says about the rig: marker observations, inertial samples, the climber's places, the camera.

use anyhow::{Context, Result, ensure};
use launch_config::bag::BagReader;
use marker_tracker::{Input, Output, Tracker, TrackerConfig, decode_compressed, from_encoding};
use nalgebra::{Isometry3, Matrix2, Translation3, UnitQuaternion, Vector2, Vector3};
use node_kit::convert;
use rig_model::{CameraModel, ImuSample, MarkerObservations, MarkerState, Rig, Stamp};
use std::path::Path;
use volant_msgs::{Message, cdr, geometry_msgs, msg::MarkerObservations as MarkersMessage, sensor_msgs::msg};

/// One image in which all four markers were measured.
#[derive(Clone, Debug)]
pub struct Shot {
    /// s since the recording's first stamp, by the camera's clock.
    pub time: f64,
    /// Centroids, px.
    pub pixels: [Vector2<f64>; 4],
    /// Their covariances, px².
    pub covariances: [Matrix2<f64>; 4],
}

/// A recording in plain numbers.
pub struct Recording {
    /// The camera.
    pub camera: CameraModel,
    /// Images with all four markers, in order of time.
    pub shots: Vec<Shot>,
    /// Inertial samples: s since the first stamp, specific force (m/s²), angular velocity (rad/s).
    pub imu: Vec<(f64, Vector3<f64>, Vector3<f64>)>,
    /// Climber: s since the first stamp, position (m) and turn about the vertical (rad, without jumps).
    pub climber: Vec<(f64, Vector3<f64>, f64)>,
}

/// Half width of the window in which the climber's samples are fitted by a line, s: the encoders' steps average out.
const CLIMBER_WINDOW: f64 = 0.055;

impl Recording {
    /// Reads a bag. Where it holds images, the markers are found anew.
    ///
    /// # Errors
    /// A topic that is missing or too short, or a bag that cannot be read.
    pub fn read(path: &Path, rig: &Rig) -> Result<Self> {
        let shown = path.display();
        let summary = BagReader::summary(path)?;
        let has_images = summary.topics.iter().any(|(t, n)| {
            *n > 0 && [msg::CompressedImage::TYPE_NAME, msg::Image::TYPE_NAME].contains(&t.type_name.as_str())
        });
        let mut bag = BagReader::open(path)?;
        let mut tracker = Tracker::new(rig.markers.clone(), TrackerConfig::default());
        let (mut camera, mut observed) = (None, Vec::<MarkerObservations>::new());
        let (mut imu, mut climber) = (Vec::<ImuSample>::new(), Vec::new());
        while let Some(message) = bag.next_message()? {
            let name = message.topic.name.as_str();
            let what = || format!("{shown}: a message on {name}");
            let kind = message.topic.type_name.as_str();
            if kind == msg::CameraInfo::TYPE_NAME {
                let model = convert::camera_model(&cdr::from_bytes(&message.data).with_context(what)?)
                    .with_context(what)?;
                tracker.handle(Input::Camera(model.clone()));
                camera = Some(model);
            } else if kind == msg::CompressedImage::TYPE_NAME {
                let image: msg::CompressedImage = cdr::from_bytes(&message.data).with_context(what)?;
                if let Ok(owned) = decode_compressed(&image.format, &image.data) {
                    tracker.handle(Input::Image(owned.view(convert::stamp(&image.header.stamp))));
                }
            } else if kind == msg::Image::TYPE_NAME {
                let image: msg::Image = cdr::from_bytes(&message.data).with_context(what)?;
                let mut scratch = marker_tracker::OwnedImage::default();
                let view = from_encoding(
                    convert::stamp(&image.header.stamp),
                    image.width as usize,
                    image.height as usize,
                    &image.encoding,
                    image.is_bigendian != 0,
                    image.step as usize,
                    &image.data,
                    &mut scratch,
                )
                .with_context(what)?;
                tracker.handle(Input::Image(view));
            } else if kind == MarkersMessage::TYPE_NAME && !has_images {
                let markers: MarkersMessage = cdr::from_bytes(&message.data).with_context(what)?;
                observed.push(convert::marker_observations(&markers).with_context(what)?);
            } else if kind == msg::Imu::TYPE_NAME {
                imu.push(convert::imu_sample(&cdr::from_bytes(&message.data).with_context(what)?));
            } else if kind == geometry_msgs::msg::TransformStamped::TYPE_NAME {
                let transform = cdr::from_bytes(&message.data).with_context(what)?;
                if let Ok(sample) = convert::climber_sample(&transform, &rig.frames) {
                    climber.push(sample);
                }
            }
            while let Some(output) = tracker.poll() {
                if let Output::Observations(observations) = output {
                    observed.push(observations);
                }
            }
        }
        let camera = camera.with_context(|| {
            format!("{shown}: no camera_info in it; record climber/camera/camera_info too")
        })?;
        for (count, topic) in [(imu.len(), "volant/imu/data"), (climber.len(), "climber/transform")] {
            ensure!(
                count >= 100,
                "{shown}: {count} messages of {topic}; record it too, for ten seconds at least"
            );
        }
        let start = imu[0].stamp;
        Self::from_parts(camera, &observed, &imu, &climber_line(&climber, start), start)
            .with_context(|| format!("{shown}"))
    }

    fn from_parts(
        camera: CameraModel,
        observed: &[MarkerObservations],
        imu: &[ImuSample],
        climber: &[(f64, Vector3<f64>, f64)],
        start: Stamp,
    ) -> Result<Self> {
        let imu: Vec<_> = imu
            .iter()
            .map(|s| (s.stamp.seconds_since(start), s.specific_force, s.angular_velocity))
            .collect();
        let end = imu[imu.len() - 1].0;
        let mut shots: Vec<Shot> = observed
            .iter()
            .filter(|o| o.markers.0.iter().all(|m| m.state == MarkerState::Detected))
            .map(|o| Shot {
                time: o.stamp.seconds_since(start),
                pixels: o.markers.0.map(|m| m.centroid),
                covariances: o.markers.0.map(|m| m.covariance),
            })
            // The inertial samples must reach beyond both ends, also with the clocks apart.
            .filter(|s| s.time > 0.2 && s.time < end - 0.2)
            .collect();
        shots.sort_by(|a, b| a.time.total_cmp(&b.time));
        shots.dedup_by(|a, b| a.time - b.time < 1e-4);
        ensure!(
            shots.len() >= 60,
            "only {} images show all four markers; record the platform in free sight for ten seconds at least",
            shots.len()
        );
        Ok(Self { camera, shots, imu, climber: climber.to_vec() })
    }

    /// `world_from_climber` at a time of the climber's own clock, by a line through the samples around it.
    pub fn world_from_climber(&self, time: f64) -> Isometry3<f64> {
        let first = self.climber.partition_point(|c| c.0 < time - CLIMBER_WINDOW);
        let last = self.climber.partition_point(|c| c.0 <= time + CLIMBER_WINDOW);
        let (first, last) = if last - first >= 2 {
            (first, last)
        } else {
            let middle = first.clamp(1, self.climber.len() - 1);
            (middle - 1, middle + 1)
        };
        let samples = &self.climber[first..last];
        let n = samples.len() as f64;
        let mean = samples.iter().map(|c| c.0).sum::<f64>() / n;
        let spread = samples.iter().map(|c| (c.0 - mean).powi(2)).sum::<f64>().max(1e-12);
        let position = samples.iter().map(|c| c.1).sum::<Vector3<f64>>() / n;
        let velocity = samples.iter().map(|c| c.1 * (c.0 - mean)).sum::<Vector3<f64>>() / spread;
        let turn = samples.iter().map(|c| c.2).sum::<f64>() / n;
        let rate = samples.iter().map(|c| c.2 * (c.0 - mean)).sum::<f64>() / spread;
        let ahead = time - mean;
        Isometry3::from_parts(
            Translation3::from(position + velocity * ahead),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn + rate * ahead),
        )
    }
}

fn climber_line(samples: &[rig_model::ClimberSample], start: Stamp) -> Vec<(f64, Vector3<f64>, f64)> {
    let mut line: Vec<(f64, Vector3<f64>, f64)> = Vec::with_capacity(samples.len());
    for sample in samples {
        let pose = &sample.world_from_climber;
        let along = pose.rotation * Vector3::x();
        let mut turn = along.y.atan2(along.x);
        let time = sample.stamp.seconds_since(start);
        if let Some(last) = line.last() {
            if time <= last.0 {
                continue;
            }
            turn += ((last.2 - turn) / std::f64::consts::TAU).round() * std::f64::consts::TAU;
        }
        line.push((time, pose.translation.vector, turn));
    }
    line
}
