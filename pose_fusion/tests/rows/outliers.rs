//! Outliers, a noisy climber, rest, and the other estimators.

use super::*;

#[test]
fn false_markers_are_rejected_with_a_reason() {
    for seed in [1, 2] {
        let clean = follow(MotionConfig::nominal(seed), &SensorConfig::nominal(seed)).score;
        let sensors = SensorConfig { false_markers: 0.2, ..SensorConfig::nominal(seed) };
        let o = follow(MotionConfig::nominal(seed), &sensors);
        println!("clean {clean}\nfalse {}  rejected {}", o.score, o.status.counts.gated_markers);
        assert!(o.score.position_rmse() < 1.2 * clean.position_rmse(), "{}", o.score);
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

#[test]
fn rest_and_departure_are_tracked() {
    for seed in [0, 1] {
        let rest = follow(MotionConfig::rest(seed), &SensorConfig::nominal(seed));
        let off = follow(
            MotionConfig { still_until: 5.0, ..MotionConfig::nominal(seed) },
            &SensorConfig::nominal(seed),
        );
        println!("rest {}\noff  {}", rest.score, off.score);
        assert!(rest.score.position_rmse() < 1.0 && off.score.position_rmse() < 1.5);
        assert_eq!(off.status.counts.resets.recoveries, 0);
    }
}

#[test]
fn the_tight_filter_beats_the_published_one_and_vision_alone() {
    let o = follow(MotionConfig::nominal(1), &SensorConfig::nominal(1));
    let run = simulated::run(MotionConfig::nominal(1), &SensorConfig::nominal(1));
    let mut visual = Score::default();
    for p in &o.outputs.visual {
        if let Some(truth) = scoring::pose_at(&run.truth, p.stamp) {
            visual.add(&p.pose, &p.covariance, &truth);
        }
    }
    let paper = |velocity_from_fused| {
        let mut config = FusionConfig { model: Model::Paper, ..FusionConfig::default() };
        config.paper.velocity_from_fused = velocity_from_fused;
        follow_from(MotionConfig::nominal(1), &SensorConfig::nominal(1), config, 1.0).score
    };
    let (published, aided) = (paper(false), paper(true));
    println!(
        "tight          {}\nvisual alone   {visual}\npaper          {published}\npaper, v fused \
         {aided}",
        o.score
    );
    assert!(
        o.score.position_rmse() < visual.position_rmse()
            && visual.position_rmse() < published.position_rmse()
    );
    assert!(
        o.score.rotation_rmse() < visual.rotation_rmse()
            && aided.rotation_rmse() < visual.rotation_rmse()
    );
    assert!((1.0..6.0).contains(&visual.nees().0), "{visual}");
}
