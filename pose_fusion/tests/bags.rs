//! The filter on the developer bags with the true centroids + 0.1 px.
mod common;

use common::{bags, scoring};
use pose_fusion::{Fusion, FusionConfig};

#[test]
fn the_bags_are_followed_to_a_millimetre_and_the_covariance_knows() {
    for (name, position, rotation) in
        [("nominal", 1.0, 0.15), ("occlude_two", 1.5, 0.2), ("clutter", 1.0, 0.15), ("fast_swing", 1.5, 0.2)]
    {
        let Some(bag) = bags::read(name, 0.1, 1) else { return };
        let mut fusion = Fusion::new(bag.rig.clone(), FusionConfig::default());
        let said = scoring::run(&mut fusion, bag.inputs.iter().map(|(_, i)| i.clone()));
        let score = scoring::score(&said.odometry, &bag.truth, 1.0);
        println!("{name:12} {score}");
        let s = fusion.status();
        println!(
            "   camera clock {:+.2} ± {:.2} ms, climber {:+.2} ± {:.2} ms, acc {:?} gyro {:?} pix {:.2} rejected {} recov {}",
            s.camera_clock_offset * 1e3,
            s.camera_clock_sigma * 1e3,
            s.climber_clock_offset * 1e3,
            s.climber_clock_sigma * 1e3,
            s.accelerometer_bias.as_slice(),
            s.gyroscope_bias.as_slice(),
            s.pixel_noise_factor,
            s.rejected_markers,
            s.recoveries,
        );
        println!("   {:?}", &said.warnings[..said.warnings.len().min(5)]);
        let (np, nr) = score.nees();
        assert!(score.position_rmse() < position && score.rotation_rmse() < rotation, "{name} {score}");
        assert!((1.0..6.0).contains(&np) && (1.0..6.0).contains(&nr), "{name} {score}");
    }
}
