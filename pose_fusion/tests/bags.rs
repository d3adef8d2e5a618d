//! The filter on the recordings with true centroids + 0.1 px, and beside other estimators on every
//! scenario.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::print_stdout, clippy::panic)]
mod common;

use common::{
    bags,
    scoring::{self, Score},
    simulated,
};
use pose_fusion::{Fusion, FusionConfig, Input, Model};
use rig_model::MarkerColor;
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig, recording::Recording};

#[test]
fn bags_give_millimeters_and_a_consistent_covariance() {
    for (name, position, rotation) in [
        ("nominal", 1.0, 0.15),
        ("occlude_two", 1.5, 0.2),
        ("clutter", 1.0, 0.15),
        ("fast_swing", 1.5, 0.2),
    ] {
        let Some(bag) = bags::read(name, 0.1, 1) else { return };
        let mut fusion = Fusion::new(bag.rig.clone(), FusionConfig::default());
        let outputs = scoring::run(&mut fusion, bag.inputs());
        let score = scoring::score(&outputs.odometry, &bag.truth, 1.0);
        let (np, nr) = score.nees();
        assert!(
            score.position_rmse() < position && score.rotation_rmse() < rotation,
            "{name} {score}"
        );
        assert!((1.0..6.0).contains(&np) && (1.0..6.0).contains(&nr), "{name} {score}");
    }
}

/// Real IMU samples; in `real_tapping` the IMU is struck, harder than its range.
#[test]
fn real_imu_samples_are_tracked_and_blows_are_followed() {
    for (name, position, largest) in
        [("real_slow", 0.65, 4.0), ("real_fast", 0.8, 4.0), ("real_tapping", 1.3, 14.0)]
    {
        let Some(bag) = bags::read(name, 0.1, 1) else { return };
        let mut fusion = Fusion::new(bag.rig.clone(), FusionConfig::default());
        let outputs = scoring::run(&mut fusion, bag.inputs());
        let score = scoring::score(&outputs.odometry, &bag.truth, 1.0);
        let (np, nr) = score.nees();
        assert!(score.position_rmse() < position, "{name} {score}");
        assert!(score.position_max() < largest, "{name} {score}");
        assert!((1.0..6.0).contains(&np) && (1.0..6.0).contains(&nr), "{name} {score}");
    }
}

/// The IMU of these recordings outputs no attitude. As published, nothing corrects the velocity of
/// the double integration, so the position drifts.
#[test]
fn the_published_filter_runs_on_real_imu_samples() {
    for name in ["real_slow", "real_fast", "real_tapping"] {
        let Some(bag) = bags::read(name, 0.1, 1) else { return };
        for velocity_from_fused in [false, true] {
            let mut config = FusionConfig { model: Model::Paper, ..FusionConfig::default() };
            config.paper.velocity_from_fused = velocity_from_fused;
            let mut fusion = Fusion::new(bag.rig.clone(), config);
            let outputs = scoring::run(&mut fusion, bag.inputs());
            let score = scoring::score(&outputs.odometry, &bag.truth, 1.0);
            assert!(fusion.computes_attitude());
            let bound = if velocity_from_fused { 20.0 } else { 2000.0 };
            assert!(score.position_rmse() < bound, "{name} {score}");
            assert!(score.rotation_rmse() < 0.5, "{name} {score}");
        }
    }
}

/// What one estimator has of a scenario.
struct Row {
    score: Score,
    /// Share of the images (visual) for which there is a pose.
    share: f64,
}

fn fused(
    run: &Recording,
    config: FusionConfig,
    from: f64,
    inputs: impl Iterator<Item = Input>,
) -> Row {
    let mut fusion = Fusion::new(run.rig.clone(), config);
    let outputs = scoring::run(&mut fusion, inputs);
    Row { score: scoring::score(&outputs.odometry, &run.truth, from), share: 1.0 }
}

/// tight; paper; paper with the velocity from the fused poses; visual alone; IMU alone.
fn rows(run: &Recording) -> [Row; 5] {
    let paper = |velocity_from_fused| {
        let mut config = FusionConfig { model: Model::Paper, ..FusionConfig::default() };
        config.paper.velocity_from_fused = velocity_from_fused;
        fused(run, config, 1.0, run.inputs())
    };
    let mut fusion = Fusion::new(run.rig.clone(), FusionConfig::default());
    let outputs = scoring::run(&mut fusion, run.inputs());
    let mut visual = Row { score: Score::default(), share: 0.0 };
    for p in &outputs.visual {
        let late = p.stamp.seconds_since(run.start()) >= 1.0;
        if let (true, Some(truth)) = (late, run.pose_at(p.stamp)) {
            visual.score.add(&p.pose, &p.covariance, &truth);
        }
    }
    let images = run.inputs().filter(|i| matches!(i, Input::Markers(_))).count();
    visual.share = outputs.visual.len() as f64 / images as f64;
    let tight = Row { score: scoring::score(&outputs.odometry, &run.truth, 1.0), share: 1.0 };
    // The IMU alone: no marker after the first three seconds.
    let blind = run.start().plus_seconds(3.0);
    let without = run.inputs().filter(|i| !matches!(i, Input::Markers(m) if m.stamp > blind));
    let inertial = fused(run, FusionConfig::default(), 3.0, without);
    [tight, paper(false), paper(true), visual, inertial]
}

#[test]
fn table_of_the_filter_beside_the_published_one_visual_and_inertial_alone() {
    let mut scenarios: Vec<Recording> = ["nominal", "occlude_two", "clutter", "fast_swing"]
        .into_iter()
        .filter_map(|name| bags::read(name, 0.1, 1))
        .collect();
    let nominal = || MotionConfig { duration: 20.0, ..MotionConfig::nominal(1) };
    let plain = SensorConfig::nominal(1);
    let hidden = |markers: &[MarkerColor]| SensorConfig {
        hidden: markers.iter().map(|m| (*m, 5.0, 15.0)).collect(),
        ..SensorConfig::nominal(1)
    };
    use MarkerColor::{Blue, Red};
    for (name, motion, sensors) in [
        ("nominal", nominal(), plain.clone()),
        (
            "fast swing",
            MotionConfig { duration: 20.0, ..MotionConfig::fast_swing(1) },
            plain.clone(),
        ),
        ("stationary", MotionConfig { duration: 20.0, ..MotionConfig::rest(1) }, plain.clone()),
        ("one hidden 10 s", nominal(), hidden(&[Red])),
        ("two hidden 10 s", nominal(), hidden(&[Red, Blue])),
        ("20 % false markers", nominal(), SensorConfig { false_markers: 0.2, ..plain.clone() }),
        (
            "images 0 to 300 ms late",
            nominal(),
            SensorConfig { image_delay: [0.0, 0.3], ..plain.clone() },
        ),
        (
            "ten times the inertial noise",
            nominal(),
            SensorConfig { imu_noise_factor: 10.0, ..plain },
        ),
    ] {
        let name = format!("simulated: {name}");
        scenarios.push(Recording { name, ..simulated::run(motion, &sensors).recording });
    }
    println!(
        "RMSE of position (mm) and rotation (deg), from 1 s on (IMU alone: from 3 s on, blind \
         from there)"
    );
    println!(
        "| scenario | tight | paper | paper, velocity from the fused | visual alone (share of \
         images) | IMU alone |"
    );
    println!("| --- | --- | --- | --- | --- | --- |");
    for scenario in &scenarios {
        let rows = rows(scenario);
        let cell = |row: &Row| {
            format!("{:.2} / {:.3}", row.score.position_rmse(), row.score.rotation_rmse())
        };
        let [tight, paper, aided, visual, inertial] = &rows;
        println!(
            "| {} | {} | {} | {} | {} ({:.0} %) | {} |",
            scenario.name,
            cell(tight),
            cell(paper),
            cell(aided),
            cell(visual),
            100.0 * visual.share,
            cell(inertial),
        );
        // With so noisy an IMU the estimate of now is worse than an image's pose of
        // itself, which comes 25 to 45 ms later.
        let noisy = scenario.name.ends_with("inertial noise");
        let peers =
            if noisy { vec![paper, inertial] } else { vec![paper, aided, visual, inertial] };
        for other in peers {
            assert!(tight.score.position_rmse() < other.score.position_rmse(), "{}", scenario.name);
        }
        if scenario.name == "simulated: nominal" {
            assert!((1.0..6.0).contains(&visual.score.nees().0), "{}", visual.score);
        }
        // The published filter uses the IMU's own rotation, which has no gyroscope noise here.
        assert!(tight.score.rotation_rmse() < visual.score.rotation_rmse(), "{}", scenario.name);
    }
}
