//! The published filter as an estimator: inputs in, odometry and status out.

use super::{paper::Paper, single_image::Visual};
use crate::{
    config::FusionConfig,
    health::{
        pose_status::{PoseState, PoseStatus},
        status::{Counts, InputCounts, Status, TimeOffsetStatus},
    },
    output::{Output, largest_sigma},
    timeline::{arrival::Source, dropout::GAP},
};
use rig_model::{Rig, Sample, Stamp};

/// Without images the status is reported this often, s.
const STATUS_PERIOD: f64 = 0.1;

/// Published filter with its status. The time offsets of camera and climber are those configured:
/// the paper estimates none. Its time is that of the IMU.
#[derive(Debug)]
pub struct PublishedFilter {
    /// The filter itself.
    pub filter: Paper,
    inputs: InputCounts,
    last_status: Option<Stamp>,
}

impl PublishedFilter {
    /// Creates a filter without an estimate.
    pub fn new(rig: &Rig, config: &FusionConfig) -> Self {
        Self { filter: Paper::new(rig, config), inputs: InputCounts::default(), last_status: None }
    }

    /// Takes in one input with its visual pose, if it is an image that has one, and returns what
    /// follows: of an image odometry and status.
    pub fn handle(&mut self, input: &Sample, visual: Option<&Visual>) -> Vec<Output> {
        match input {
            Sample::Imu(sample) => self.filter.imu(sample),
            Sample::Markers(markers) => {
                self.inputs.images += 1;
                let at = markers.stamp.plus_seconds(self.camera_offset());
                if let Some(odometry) = self.filter.image(at, visual) {
                    self.last_status = Some(at);
                    let status = self.pose_status(at);
                    return vec![Output::Odometry(odometry), Output::Status(status)];
                }
            }
            Sample::Climber(_) | Sample::Camera(_) => {}
        }
        Vec::new()
    }

    /// Returns the status at 10 Hz while no image gives a pose, at an input's stamp.
    pub fn silence(&mut self, from: Source, stamp: Stamp) -> Option<Output> {
        let (camera, config) = (self.camera_offset(), &self.filter.config);
        let now = match from {
            Source::Imu => stamp,
            Source::Image => stamp.plus_seconds(camera),
            Source::Encoders => stamp.plus_seconds(config.tight.clock.climber_offset + camera),
        };
        let since = |last: Option<Stamp>| last.map_or(f64::INFINITY, |l| now.seconds_since(l));
        let silent = since(self.filter.stamp());
        let due = !(0.0..STATUS_PERIOD).contains(&since(self.last_status));
        if silent <= config.status.max_image_age || !due {
            return None;
        }
        self.last_status = Some(now);
        let mut status = self.pose_status(now);
        if self.filter.stamp().is_some() {
            (status.state, status.valid) = (PoseState::Lost, false);
            status.reason = format!(
                "no climber/markers for {silent:.1} s: the published filter outputs a pose with \
                 images only"
            );
        }
        Some(Output::Status(status))
    }

    /// Returns counters and insights for diagnostics.
    pub fn status(&self) -> Status {
        let camera_offset = self.camera_offset();
        Status {
            initialized: self.filter.stamp().is_some(),
            newest_imu: self.filter.newest_imu(),
            position_sigma: self.sigma(0),
            time_offset: TimeOffsetStatus {
                offset: camera_offset,
                configured: camera_offset,
                sigma: f64::NAN,
                searching: false,
            },
            counts: Counts { inputs: self.inputs, ..Counts::default() },
            ..Status::default()
        }
    }

    fn pose_status(&self, now: Stamp) -> PoseStatus {
        if self.filter.stamp().is_none() {
            let missing = self.filter.missing().to_owned();
            return PoseStatus::initializing(now, self.camera_offset(), missing);
        }
        let since =
            |stamp: Option<Stamp>| stamp.map_or(f64::INFINITY, |s| now.seconds_since(s).max(0.0));
        let (last_visual, limits) = (self.filter.last_visual, &self.filter.config.status);
        let image_age = since(last_visual.map(|(stamp, _)| stamp));
        let imu_age = since(self.filter.newest_imu());
        // A visual pose rests on an encoder reading of its instant.
        let ages = [image_age, imu_age, image_age];
        let mut status = PoseStatus {
            position_sigma: self.sigma(0),
            rotation_sigma: self.sigma(3),
            markers_used: last_visual.map_or(0, |(_, markers)| markers),
            ..PoseStatus::lost(now, ages, self.camera_offset(), String::new())
        }
        .judged(limits, imu_age > GAP, None);
        if status.state == PoseState::Coasting {
            // The published covariance does not contain what an acceleration's error becomes.
            let acceleration_sigma = self.filter.config.tight.imu.accelerometer_bias;
            let drift = acceleration_sigma * image_age * image_age / 2.0;
            status.valid &= drift <= limits.max_position_sigma;
            status.reason = format!(
                "two or more markers hidden, or no climber/transform: {}; the doubly integrated \
                 accelerations carry the pose and may be off by {drift:.2} m",
                status.reason
            );
        }
        status
    }

    /// Image time + this = IMU time, s.
    fn camera_offset(&self) -> f64 {
        self.filter.config.tight.clock.camera_offset
    }

    /// Largest sigma of the position (`first` 0, m) or of roll, pitch and yaw (3, rad).
    fn sigma(&self, first: usize) -> f64 {
        let state = self.filter.state.as_ref();
        state.map_or(f64::INFINITY, |state| largest_sigma(&state.covariance, first))
    }
}
