//! The nodes' cores over a scenario, without middleware and clock: images through the tracker, its
//! observations, the IMU samples and the encoders through the filter, in order of arrival.

use crate::{
    accuracy::Track,
    live::{ImageSequence, Scenario},
};
use anyhow::{Context, Result, ensure};
use marker_tracker::{Tracker, TrackerConfig};
use pose_fusion::{Fusion, FusionConfig, Input, Model, Output};
use rig_model::MarkerObservations;
use rig_simulator::random::Random;

/// Tracks the images' markers.
pub fn track(
    scenario: &Scenario,
    images: &ImageSequence,
    config: TrackerConfig,
) -> Result<Vec<MarkerObservations>> {
    let mut tracker = Tracker::new(scenario.rig.markers.clone(), config);
    tracker.handle(marker_tracker::Input::Camera(scenario.camera.clone()));
    let mut observations = Vec::with_capacity(images.frames.len());
    for frame in &images.frames {
        let image = marker_tracker::decode_compressed("jpeg", &frame.jpeg).context("an image")?;
        tracker.handle(marker_tracker::Input::Image(
            image.view(scenario.sensors.epoch.plus_seconds(frame.seconds)),
        ));
        while let Some(output) = tracker.poll() {
            if let marker_tracker::Output::Observations(o) = output {
                observations.push(o);
            }
        }
    }
    Ok(observations)
}

/// All that arrives at the filter during a scenario with these markers, in order of arrival.
pub fn record(scenario: &Scenario, observed: Vec<MarkerObservations>) -> Vec<Input> {
    let sensors = scenario.simulated_sensors();
    let mut inputs = sensors.imu();
    inputs.extend(sensors.climber());
    let mut random = Random::fork(scenario.sensors.seed, "image delay");
    let [shortest, longest] = scenario.sensors.image_delay;
    for observations in observed {
        let arrival = observations.stamp.plus_seconds(random.within(shortest, longest));
        inputs.push((arrival, Input::Markers(observations)));
    }
    inputs.sort_by_key(|(arrival, _)| *arrival);
    inputs.into_iter().map(|(_, input)| input).collect()
}

/// The filter's poses, and those from one image each.
pub struct Poses {
    pub fused: Track,
    pub visual: Track,
}

/// Defaults of a filter, with the gravity of the scenario.
pub fn filter(scenario: &Scenario, model: Model) -> FusionConfig {
    let mut config = FusionConfig { model, ..FusionConfig::default() };
    config.tight.gravity = scenario.sensors.gravity;
    config
}

pub fn fuse(scenario: &Scenario, inputs: &[Input], config: FusionConfig) -> Result<Poses> {
    let model = config.model;
    let mut fusion = Fusion::new(scenario.rig.clone(), config);
    fusion.handle(Input::Camera(scenario.camera.clone()));
    let mut poses = Poses { fused: Track::new(), visual: Track::new() };
    let mut warnings = Vec::new();
    for input in inputs {
        fusion.handle(input.clone());
        while let Some(output) = fusion.poll() {
            match output {
                Output::Odometry(o) => poses.fused.push((o.stamp, o.world_from_volant)),
                Output::VisualPose(p) => poses.visual.push((p.stamp, p.pose)),
                Output::Warning(w) if warnings.len() < 3 => warnings.push(w.to_string()),
                _ => {}
            }
        }
    }
    ensure!(
        !poses.fused.is_empty(),
        "the model {model:?} gave no pose; its warnings: {}",
        warnings.join("; ")
    );
    Ok(poses)
}
