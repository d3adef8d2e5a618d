//! The published filter: its measurements, and what its status reports of missing inputs.

use super::{
    Outcome,
    common::{scoring, simulated},
    follow_from,
};
use pose_fusion::{FusionConfig, Input, Model, PaperMeasurement, PoseState, PoseStatus};
use rig_model::MarkerColor;
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig};

fn config(measurement: PaperMeasurement) -> FusionConfig {
    let mut config = FusionConfig { model: Model::Paper, ..simulated::config() };
    config.paper.measurement = measurement;
    config.paper.velocity_from_fused = true;
    config
}

fn run(measurement: PaperMeasurement, sensors: &SensorConfig) -> Outcome {
    let motion = MotionConfig { duration: 10.0, ..MotionConfig::nominal(1) };
    follow_from(motion, sensors, config(measurement), 2.0)
}

#[test]
fn poses_and_marker_coordinates_correct_the_published_filter() {
    for measurement in [PaperMeasurement::Pose, PaperMeasurement::Markers] {
        let o = run(measurement, &SensorConfig::nominal(1));
        let near = o.score.position_rmse() < 60.0 && o.score.rotation_rmse() < 1.5;
        assert!(near, "{measurement:?}: {}", o.score);
    }
}

#[test]
fn an_imu_without_attitude_serves_the_published_filter() {
    let motion = MotionConfig { duration: 10.0, ..MotionConfig::nominal(1) };
    let run = simulated::run(motion, &SensorConfig::nominal(1));
    let inputs = run.changed(|_, input| {
        if let Input::Imu(sample) = input {
            sample.orientation = None;
        }
    });
    let (fusion, o) = scoring::follow(config(PaperMeasurement::Pose), inputs);
    let score = scoring::score(&o.odometry, &run.truth, 2.0);
    assert!(fusion.computes_attitude());
    assert!(score.position_rmse() < 60.0 && score.rotation_rmse() < 1.5, "{score}");
}

/// Statuses from 1 s after the inputs that `keep` selects from 4 s on.
fn statuses(keep: impl Fn(&Input) -> bool) -> Vec<PoseStatus> {
    let sensors = SensorConfig::nominal(1);
    let motion = MotionConfig { duration: 6.0, ..MotionConfig::nominal(1) };
    let run = simulated::run(motion, &sensors);
    let inputs = run.timed().into_iter().filter(|(at, input)| *at < 4.0 || keep(input));
    let (_, mut outputs) =
        scoring::follow(config(PaperMeasurement::Pose), inputs.map(|(_, input)| input));
    outputs.status.retain(|status| status.stamp.seconds_since(sensors.epoch) > 5.0);
    let statuses = outputs.status;
    assert!(statuses.len() >= 9, "at 10 Hz at least: {}", statuses.len());
    statuses
}

#[test]
fn the_status_of_the_published_filter_names_what_is_missing() {
    for status in statuses(|_| true) {
        assert!(status.state == PoseState::Tracking && status.valid, "{status:?}");
        assert!(status.image_age < 0.05 && status.markers_used == 4, "{status:?}");
    }
    for status in statuses(|input| !matches!(input, Input::Markers(_))) {
        assert!(status.state == PoseState::Lost && !status.valid, "{status:?}");
        assert!(status.reason.starts_with("no climber/markers for "), "{}", status.reason);
        assert!(status.image_age > 0.9, "{status:?}");
    }
    for status in statuses(|input| !matches!(input, Input::Imu(_))) {
        assert_eq!(status.state, PoseState::VisionOnly, "{status:?}");
        assert!(status.reason.starts_with("no usable IMU sample for "), "{}", status.reason);
    }
    for status in statuses(|input| !matches!(input, Input::Climber(_))) {
        assert_eq!(status.state, PoseState::Coasting, "{status:?}");
        assert!(status.image_age < 1.01 || !status.valid, "{status:?}");
        assert!(status.reason.contains("no climber/transform"), "{}", status.reason);
    }
}

#[test]
fn a_configured_camera_offset_counts_in_the_published_filter() {
    let sensors = SensorConfig::nominal(1);
    let odometry = |offset: f64| {
        let motion = MotionConfig { duration: 4.0, ..MotionConfig::nominal(1) };
        let inputs = simulated::run(motion, &sensors).changed(|_, input| {
            let is_imu = matches!(input, Input::Imu(_));
            if let Some(stamp) = simulated::stamp_of(input).filter(|_| !is_imu) {
                *stamp = stamp.plus_seconds(-offset);
            }
        });
        let mut config = config(PaperMeasurement::Pose);
        config.tight.clock.camera_offset = offset;
        let (_, outputs) = scoring::follow(config, inputs);
        assert_eq!(outputs.status.last().map(|s| s.time_offset), Some(offset));
        outputs.odometry
    };
    let (expected, found) = (odometry(0.0), odometry(0.1));
    assert!(!found.is_empty() && found.len() == expected.len());
    for (found, expected) in found.iter().zip(&expected) {
        let step = found.world_from_volant.translation.vector
            - expected.world_from_volant.translation.vector;
        assert!(found.stamp == expected.stamp && step.norm() < 1e-6, "{step}");
    }
}

#[test]
fn an_image_stamped_far_ahead_does_not_end_the_published_filter() {
    let sensors = SensorConfig::nominal(1);
    let motion = MotionConfig { duration: 5.0, ..MotionConfig::nominal(1) };
    let mut run = simulated::run(motion, &sensors);
    let is_image = |input: &Input| matches!(input, Input::Markers(_));
    let after = sensors.epoch.plus_seconds(3.0);
    let place = run.inputs.iter().position(|(at, input)| *at > after && is_image(input)).unwrap();
    if let Input::Markers(markers) = &mut run.inputs[place].1 {
        markers.stamp = markers.stamp.plus_seconds(100.0);
    }
    let (_, outputs) = scoring::follow(config(PaperMeasurement::Pose), run.inputs());
    let last = outputs.status.last().unwrap();
    assert!(last.state == PoseState::Tracking && last.valid, "{last:?}");
}

#[test]
fn two_hidden_markers_leave_the_published_filter_coasting() {
    let hidden = [MarkerColor::Red, MarkerColor::Blue].map(|m| (m, 4.0, 6.0)).to_vec();
    let o = run(PaperMeasurement::Pose, &SensorConfig { hidden, ..SensorConfig::nominal(1) });
    let epoch = SensorConfig::nominal(1).epoch;
    let within = |s: &&PoseStatus| (4.4..5.9).contains(&s.stamp.seconds_since(epoch));
    let coasting: Vec<&PoseStatus> = o.outputs.status.iter().filter(within).collect();
    assert!(coasting.len() > 30);
    for status in coasting {
        assert_eq!(status.state, PoseState::Coasting, "{status:?}");
        assert!(status.reason.contains("two or more markers hidden"), "{}", status.reason);
    }
    assert_eq!(o.outputs.status.last().map(|s| s.state), Some(PoseState::Tracking));
}

#[test]
fn before_its_first_pose_the_published_filter_reports_what_it_waits_for() {
    let sensors = SensorConfig::nominal(1);
    let run = simulated::run(MotionConfig { duration: 1.0, ..MotionConfig::nominal(1) }, &sensors);
    let without = run.inputs().filter(|i| !matches!(i, Input::Climber(_)));
    let (fusion, outputs) = super::scoring::follow(config(PaperMeasurement::Pose), without);
    assert!(outputs.odometry.is_empty() && outputs.status.len() >= 9);
    let last = outputs.status.last().unwrap();
    assert_eq!(last.state, PoseState::Initializing);
    assert!(last.reason.contains("climber/transform"), "{}", last.reason);
    assert_eq!(fusion.missing(), last.reason);
}
