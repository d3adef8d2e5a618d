//! The project's own tracker, as a node drives it, and the pose by Gauss–Newton from the previous
//! one.

use super::{About, Carrier, Estimate, Method, gauss_newton, pose_from_centroids};
use crate::clock::Clock;
use crate::scene::{Frame, Pinhole};
use anyhow::Result;
use marker_tracker::{ImageView, Input, Output, PixelFormat, Tracker, TrackerConfig};
use nalgebra::Isometry3;
use rig_model::{CameraModel, MarkerLayout, MarkerObservations, MarkerState, Stamp};
use std::time::Duration;

/// Tracker and pose.
pub struct Ours {
    layout: MarkerLayout,
    camera: CameraModel,
    tracker: Tracker,
    pose: Option<Isometry3<f64>>,
    stamp: i64,
    /// Result for the last frame.
    pub observed: Option<MarkerObservations>,
}

impl Ours {
    pub fn new(camera: &Pinhole, layout: MarkerLayout) -> Self {
        let mut ours = Self {
            tracker: Tracker::new(layout.clone(), TrackerConfig::default()),
            camera: camera.model(),
            layout,
            pose: None,
            stamp: 1_000_000_000,
            observed: None,
        };
        ours.forget();
        ours
    }

    /// Pose of what was observed, from the previous one where it helps.
    fn solve(&self, observed: &MarkerObservations) -> Option<Isometry3<f64>> {
        let (layout, camera) = (&self.layout, &self.camera);
        let prior = self.pose.as_ref();
        prior
            .and_then(|prior| gauss_newton(layout, camera, observed, prior))
            .or_else(|| pose_from_centroids(layout, camera, observed))
    }

    /// The tracker alone: time from pixels to the finished observations, 30 images a second.
    pub fn track(&mut self, frame: &Frame) -> Duration {
        self.stamp += 33_333_333;
        let view = ImageView {
            stamp: Stamp::from_nanos(self.stamp),
            width: frame.width,
            height: frame.height,
            step: 3 * frame.width,
            format: PixelFormat::Rgb8,
            data: &frame.rgb,
        };
        self.observed = None;
        let start = Clock::start();
        self.tracker.handle(Input::Image(view));
        let mut time = start.elapsed();
        while let Some(output) = self.tracker.poll() {
            if let Output::Observations(o) = output {
                time = start.elapsed();
                self.observed = Some(o);
            }
        }
        time
    }
}

impl Method for Ours {
    fn about(&self) -> About {
        About {
            name: "volant: all criteria, and pose",
            carrier: Carrier::Markers,
            stages: &["tracker", "extrinsics"],
        }
    }

    fn estimate(&mut self, frame: &Frame) -> Result<Estimate> {
        let tracked = self.track(frame);
        let Some(observed) = &self.observed else {
            return Ok(Estimate { stages: vec![tracked], ..Estimate::default() });
        };
        let start = Clock::start();
        let pose = self.solve(observed);
        let extrinsics = start.elapsed();
        self.pose = pose;
        let points = observed
            .markers
            .iter()
            .filter(|(_, m)| m.state == MarkerState::Detected)
            .map(|(c, m)| (c.index(), m.centroid))
            .collect();
        Ok(Estimate { camera_from_volant: pose, points, stages: vec![tracked, extrinsics] })
    }

    fn forget(&mut self) {
        self.tracker = Tracker::new(self.layout.clone(), TrackerConfig::default());
        self.tracker.handle(Input::Camera(self.camera.clone()));
        while self.tracker.poll().is_some() {}
        self.pose = None;
    }
}
