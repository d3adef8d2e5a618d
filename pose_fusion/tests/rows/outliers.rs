//! Outliers, a noisy climber, rest.

use super::*;
use nalgebra::Vector2;
use rig_model::{MarkerObservation, PerColor};
use std::{collections::HashMap, f64::consts::TAU};

#[test]
fn false_markers_are_rejected_with_a_reason() {
    for seed in [1, 2] {
        let clean = follow(MotionConfig::nominal(seed), &SensorConfig::nominal(seed)).score;
        let sensors = SensorConfig { false_markers: 0.2, ..SensorConfig::nominal(seed) };
        let o = follow(MotionConfig::nominal(seed), &sensors);
        let near = o.score.position_rmse() < 1.2 * clean.position_rmse();
        assert!(near, "clean {clean}\nfalse {}", o.score);
        assert_eq!(o.status.counts.resets.recoveries, 0);
        let rejected = o.outputs.records().filter(|r| {
            matches!(r.outcome, pose_fusion::Outcome::Gated | pose_fusion::Outcome::Inconsistent)
                && r.nis.is_finite()
        });
        assert_eq!(rejected.count() as u64, o.status.counts.gated_markers);
        assert!(
            o.outputs.records().count() as u64
                >= 4 * (o.status.counts.inputs.images - o.status.counts.inputs.duplicates) - 8
        );
    }
}

/// A swing whose markers go through `change` with their time, s; the score is from 4 s on.
fn with_markers(
    seed: u64,
    mut change: impl FnMut(f64, &mut PerColor<MarkerObservation>),
) -> Outcome {
    with_inputs(seed, |t, input| {
        if let Input::Markers(image) = input {
            change(t, &mut image.markers);
        }
    })
}

/// The same with all inputs.
fn with_inputs(seed: u64, change: impl FnMut(f64, &mut Input)) -> Outcome {
    with_inputs_and(seed, simulated::config(), 4.0, change)
}

/// The same with a configuration, scored from `since` on, s.
fn with_inputs_and(
    seed: u64,
    config: pose_fusion::FusionConfig,
    since: f64,
    change: impl FnMut(f64, &mut Input),
) -> Outcome {
    let run = simulated::run(MotionConfig::nominal(seed), &SensorConfig::nominal(seed));
    let (fusion, outputs) = scoring::follow(config, run.changed(change));
    let score = scoring::score(&outputs.odometry, &run.truth, since);
    Outcome { score, outputs, status: fusion.status() }
}

/// One reading of the encoders is off by as much as a climber that is jerked would just reach,
/// while two markers are hidden: the readings after it say that it was wrong.
#[test]
fn one_encoder_reading_a_few_centimeters_off_is_no_jerk_of_the_climber() {
    for (seed, off) in (1..=4).flat_map(|seed| [0.024, 0.028, 0.03, 0.033].map(|off| (seed, off))) {
        let mut wrong = false;
        let o = with_inputs(seed, |t, input| match input {
            Input::Climber(c) if t > 5.0 && !wrong => {
                wrong = true;
                c.world_from_climber.translation.vector.x += off;
            }
            Input::Markers(image) if (4.5..7.0).contains(&t) => {
                for marker in &mut image.markers.0[..2] {
                    *marker = MarkerObservation::lost(1);
                }
            }
            _ => {}
        });
        let near = o.score.position_rmse() < 1.5 && o.score.position_max() < 10.0;
        assert!(near && consistent(&o.score, 0.2, 5.0), "seed {seed}, {off} m: {}", o.score);
    }
}

/// Centroids that are far noisier than they claim for a while, from the first image on or in the
/// middle: the noise is no error of the layout and no shock, and leaves nothing behind. Before, the
/// pose stayed off by 13 mm and 1.3° with a NEES of 44 where the first images were noisy.
#[test]
fn noise_that_passes_is_not_learned_as_an_error_of_the_layout() {
    let span = |first: f64, last: f64, sigma: f64| (first, last, sigma);
    for (seed, (first, last, sigma)) in (1..=4).flat_map(|s| {
        [span(0.0, 0.2, 0.7), span(0.0, 1.0, 0.7), span(5.0, 7.0, 0.5)].map(|n| (s, n))
    }) {
        let mut random = rig_simulator::random::Random::new(seed);
        let o =
            with_inputs_and(seed, pose_fusion::FusionConfig::default(), last + 2.0, |t, input| {
                match input {
                    Input::Markers(image) if (first..last).contains(&t) => {
                        for marker in &mut image.markers.0 {
                            let mut noise = || random.normal() * sigma;
                            marker.centroid += Vector2::new(noise(), noise());
                        }
                    }
                    _ => {}
                }
            });
        let near = o.score.position_rmse() < 1.5 && o.score.position_max() < 6.0;
        assert!(
            near && consistent(&o.score, 0.0, 6.0),
            "seed {seed}, {sigma} px from {first} s to {last} s: {}",
            o.score
        );
    }
}

/// All markers of an image off together, px by time: noise of the images, and neither shocks nor a
/// wrong rig file. At least this share of the poses is valid.
fn shaken(seed: u64, valid: f64, mut off: impl FnMut(f64) -> Vector2<f64>) {
    let o = with_markers(seed, |t, markers| {
        let off = off(t);
        markers.0.iter_mut().for_each(|marker| marker.centroid += off);
    });
    let statuses: Vec<_> = o.outputs.status.iter().skip(400).collect();
    let count = statuses.iter().filter(|status| status.valid).count();
    assert!(o.score.position_rmse() < 2.0 && o.score.position_max() < 15.0, "{}", o.score);
    assert!(o.score.nees().0 < 6.0 && o.score.nees().1 < 6.0, "{}", o.score);
    assert!(count as f64 > statuses.len() as f64 * valid, "valid {count} of {}", statuses.len());
}

/// The camera shakes, from the beginning or for a while. Before, the pose was LOST most of the
/// time.
#[test]
fn a_camera_that_shakes_costs_accuracy_and_not_the_pose() {
    for (seed, sigma, from, to) in [(1, 0.3, 0.0, 20.0), (2, 0.5, 5.0, 8.0), (3, 0.2, 0.0, 20.0)] {
        let mut random = rig_simulator::random::Random::new(seed);
        shaken(seed, 0.95, |t| {
            let off = Vector2::from_fn(|_, _| sigma * random.normal());
            if (from..to).contains(&t) { off } else { Vector2::zeros() }
        });
    }
}

/// The mount vibrates. Before, vibrations slower than 0.28 of the image rate were not found.
#[test]
fn a_camera_mount_that_vibrates_costs_accuracy_and_not_the_pose() {
    for (seed, amplitude, frequency) in [
        (1, 0.2, 9.0),
        (2, 0.5, 9.0),
        (3, 2.0, 9.0),
        (1, 0.5, 7.0),
        (2, 1.0, 7.0),
        (3, 0.5, 5.0),
        (4, 0.6, 4.0),
    ] {
        shaken(seed, 0.9, |t| {
            let angle = TAU * frequency * t;
            Vector2::new(angle.sin(), angle.cos()) * amplitude
        });
    }
}

/// The carriage rocks by 0.1° for half a second, every three seconds: too slow for a vibration.
#[test]
fn a_carriage_that_rocks_is_covered_with_the_declared_tilt_of_the_camera() {
    let rocks = |seed: u64, declared: f64| {
        let mut config = simulated::config();
        config.tight.markers.camera_tilt = declared;
        with_inputs_and(seed, config, 4.0, |t, input| {
            let (angle, since) = (TAU * 1.6 * t, t % 3.0);
            if let (Input::Markers(image), true) = (input, since < 0.5) {
                let size = (TAU * since).sin();
                for marker in &mut image.markers.0 {
                    marker.centroid += Vector2::new(angle.sin(), angle.cos()) * size;
                }
            }
        })
    };
    for seed in [1, 2, 3, 4] {
        let (known, unknown) = (rocks(seed, 0.0035), rocks(seed, 0.0));
        let about = format!("seed {seed}: {} (undeclared {})", known.score, unknown.score);
        assert!(known.score.nees().0 < 4.0 && known.score.nees().1 < 4.0, "{about}");
        assert!(unknown.score.nees().0 > 6.0, "{about}");
        assert!(known.outputs.status.iter().skip(100).all(|s| s.valid), "{about}");
    }
}

/// A marker a pixel beside its place for two seconds is rejected, and is no shock.
#[test]
fn a_marker_beside_its_place_is_rejected_and_no_shock() {
    for (seed, color, offset) in [
        (1, MarkerColor::Red, Vector2::new(1.0, 0.0)),
        (2, MarkerColor::Blue, Vector2::new(0.0, 2.0)),
        (3, MarkerColor::Yellow, Vector2::new(-0.8, 0.8)),
    ] {
        let Outcome { score, outputs, status } = with_markers(seed, |t, markers| {
            if (5.0..7.0).contains(&t) {
                markers[color].centroid += offset;
            }
        });
        assert!(score.position_rmse() < 2.0, "{color}: {score}");
        assert_eq!(status.counts.resets.shocks, 0, "{color}");
        assert!(outputs.status.iter().skip(500).all(|s| s.valid), "{color}");
    }
}

/// Two markers are exchanged for half a second while a third is hidden, so that no fourth one
/// contradicts them: the pose moves by no more than a shock may. Before, 0.6 m and 59°.
#[test]
fn exchanged_markers_that_no_fourth_one_contradicts_move_the_pose_within_its_sigma() {
    for seed in [1, 2, 3] {
        let Outcome { score, outputs, .. } = with_markers(seed, |t, markers| {
            if (6.0..8.0).contains(&t) {
                markers[MarkerColor::Red] = MarkerObservation::lost(1);
            }
            if (6.5..7.0).contains(&t) {
                markers.0.swap(1, 2);
            }
        });
        let invalid = outputs.status.iter().skip(500).filter(|s| !s.valid).count();
        assert!(score.position_max() < 400.0 && score.rotation_max() < 5.7, "{score}");
        assert!(invalid < 60, "{invalid}");
        let (position, rotation) = score.nees();
        assert!(position < 4.0 && rotation < 4.0, "{score}");
    }
}

/// The same with a gyroscope that saturates: the attitude is hardly known, and two of the three
/// markers alone fit another one. Before, up to 2.6 m and 90°, called valid.
#[test]
fn exchanged_markers_with_an_attitude_that_is_hardly_known_are_not_followed() {
    for phase in 0..10 {
        let from = 6.5 + 0.05 * f64::from(phase);
        let Outcome { score, .. } = with_inputs(1, |t, input| match input {
            Input::Imu(sample) => {
                sample.angular_velocity = sample.angular_velocity.map(|w| w.clamp(-0.5, 0.5));
            }
            Input::Markers(image) if (from..from + 0.5).contains(&t) => {
                image.markers[MarkerColor::Red] = MarkerObservation::lost(1);
                image.markers.0.swap(1, 2);
            }
            _ => {}
        });
        assert!(score.position_max() < 500.0 && score.rotation_max() < 11.4, "{from}: {score}");
        let (position, rotation) = score.nees();
        assert!(position < 4.0 && rotation < 4.0, "{from}: {score}");
    }
}

/// A gyroscope's axis that repeats one value contradicts the images, with the encoders and without
/// them: they are not what is wrong. Before, the pose left with a climber that nothing measured, by
/// 4 m on a real recording. A turn encoder that stands may still be blamed, for
/// `climber.step_timeout`.
#[test]
fn a_stuck_axis_of_the_gyroscope_is_not_the_encoders_fault() {
    for seed in [1, 2, 3, 4] {
        let mut stuck = None;
        let Outcome { outputs, .. } = with_inputs(seed, |t, input| match input {
            Input::Imu(sample) if (6.0..8.0).contains(&t) => {
                sample.angular_velocity.z = *stuck.get_or_insert(sample.angular_velocity.z);
            }
            _ => {}
        });
        let run = simulated::run(MotionConfig::nominal(seed), &SensorConfig::nominal(seed));
        let begin = run.start();
        let (mut worst, mut recovered) = (0.0_f64, 0.0_f64);
        let valid: HashMap<_, _> = outputs.status.iter().map(|s| (s.stamp, s.valid)).collect();
        for odometry in &outputs.odometry {
            let t = odometry.stamp.seconds_since(begin);
            let Some(truth) = run.pose_at(odometry.stamp) else { continue };
            let position = odometry.world_from_volant.translation.vector;
            let error = (position - truth.translation.vector).norm();
            if valid[&odometry.stamp] && t > 2.0 {
                worst = worst.max(error);
            }
            if error > 0.005 {
                recovered = t;
            }
        }
        assert!(worst < 0.05 && recovered < 11.3, "seed {seed}: {worst} m, {recovered} s");
    }
}

/// Centroids four times as noisy as claimed: found, and not much worse than one image.
#[test]
fn noise_beyond_the_claimed_covariance_is_found() {
    for seed in [1, 2, 3, 4] {
        let mut random = rig_simulator::random::Random::new(seed);
        let Outcome { score, status, .. } = with_markers(seed, |_, markers| {
            for marker in &mut markers.0 {
                marker.centroid += Vector2::from_fn(|_, _| 0.35 * random.normal());
            }
        });
        assert!(score.position_rmse() < 10.0, "seed {seed}: {score}");
        assert!(status.pixel_noise_factor > 2.0, "{status:?}");
    }
}

#[test]
fn rest_and_departure_are_tracked() {
    for seed in [0, 1] {
        let rest = follow(MotionConfig::rest(seed), &SensorConfig::nominal(seed));
        let off = follow(
            MotionConfig { still_until: 5.0, ..MotionConfig::nominal(seed) },
            &SensorConfig::nominal(seed),
        );
        assert!(rest.score.position_rmse() < 1.0, "seed {seed}: {}", rest.score);
        assert!(off.score.position_rmse() < 1.5, "seed {seed}: {}", off.score);
        assert_eq!(off.status.counts.resets.recoveries, 0);
    }
}

/// What no pose explains of four markers is in the covariance of the image's pose, though not that
/// it may be the other tilt. Before, its NEES was in the tens of thousands.
#[test]
fn the_pose_of_one_image_with_a_false_marker_is_uncertain() {
    let run = simulated::run(MotionConfig::nominal(1), &SensorConfig::nominal(1));
    let inputs = run.changed(|_, input| {
        if let Input::Markers(image) = input {
            image.markers.0[0].centroid.x += 6.0;
        }
    });
    let (_, outputs) = scoring::follow(simulated::config(), inputs);
    let mut score = rig_model::score::Score::default();
    for visual in &outputs.visual {
        if let Some(truth) = run.pose_at(visual.stamp) {
            score.add(&visual.pose, &visual.covariance, &truth);
        }
    }
    assert!(score.count() > 100 && score.nees().0 < 100.0 && score.nees().1 < 300.0, "{score}");
}
