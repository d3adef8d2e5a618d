mod common;
use common::{bags, scoring};
use pose_fusion::{Fusion, FusionConfig};
#[test]
fn dev() {
    for (cam, cl) in [(0.0, 0.0), (0.0, 0.01), (0.05, 0.0)] {
        for name in ["nominal", "occlude_two", "clutter", "fast_swing"] {
            let Some(bag) = bags::read(name, 0.1, 1) else { return };
            let mut c = FusionConfig::default();
            c.tight.camera_clock = cam;
            c.tight.climber_clock = cl;
            let mut fusion = Fusion::new(bag.rig.clone(), c);
            let said = scoring::run(&mut fusion, bag.inputs.iter().map(|(_, i)| i.clone()));
            let score = scoring::score(&said.odometry, &bag.truth, 1.0);
            let s = fusion.status();
            println!(
                "{cam} {cl} {name:12} {score} clocks {:+.2}±{:.2} {:+.2}±{:.2} rej {} rec {}",
                s.camera_clock_offset * 1e3,
                s.camera_clock_sigma * 1e3,
                s.climber_clock_offset * 1e3,
                s.climber_clock_sigma * 1e3,
                s.rejected_markers,
                s.recoveries
            );
        }
    }
}
use common::{
    rig::{inertial::SensorConfig, motion::MotionConfig},
    simulated,
};
#[test]
fn starts() {
    let mut c = FusionConfig::default();
    c.tight.camera_clock = std::env::var("CAM").map_or(0.05, |s| s.parse().unwrap());
    let off: f64 = std::env::var("OFF").map_or(0.0, |s| s.parse().unwrap());
    for fast in [false, true] {
        for seed in 0..10 {
            let mut sc = SensorConfig::nominal(seed);
            sc.camera_clock_ahead = off;
            sc.climber_clock_ahead = off;
            let run = simulated::run(
                if fast { MotionConfig::fast_swing(seed) } else { MotionConfig::nominal(seed) },
                &sc,
            );
            let mut fusion = Fusion::new(simulated::rig(), c.clone());
            let said = scoring::run(&mut fusion, run.inputs.iter().map(|(_, i)| i.clone()));
            let s = fusion.status();
            println!(
                "{fast} {seed} {} rej {} rec {} clock {:+.2}±{:.2}",
                scoring::score(&said.odometry, &run.truth, 1.0),
                s.rejected_markers,
                s.recoveries,
                s.camera_clock_offset * 1e3,
                s.camera_clock_sigma * 1e3
            );
        }
    }
}
#[test]
fn sim() {
    let mut sc = SensorConfig::nominal(2);
    let run = simulated::run(MotionConfig::nominal(2), &sc);
    let mut c = FusionConfig::default();
    c.tight.camera_clock = std::env::var("CAM").map_or(0.05, |s| s.parse().unwrap());
    let mut fusion = Fusion::new(simulated::rig(), c);
    let mut n = 0;
    let mut said = scoring::Said::default();
    for (_, i) in &run.inputs {
        let one = scoring::run(&mut fusion, [i.clone()]);
        if let Some(o) = one.odometry.first() {
            n += 1;
            let t = o.stamp.seconds_since(sc.epoch);
            if n % 25 == 0 || n < 60 {
                let s = fusion.tight().state().unwrap();
                let k = run.motion.climber(t);
                let tr = run.motion.kinematics(t).world_from_volant;
                let e = scoring::error6(&o.world_from_volant, &tr);
                println!(
                    "{t:.3} pos {:6.2} {:6.2} {:6.2} sig {:.2} {:.2} rot {:6.3} {:6.3} {:6.3} sig {:.3} {:.3} CLK {:.2}±{:.2} v {:?} climber {:6.2} {:6.2} {:6.3} sig {:.2} rate {:.3} acc {:.2} sig {:.2} ba {:?}",
                    e[0] * 1e3,
                    e[1] * 1e3,
                    e[2] * 1e3,
                    o.pose_covariance[(0, 0)].sqrt() * 1e3,
                    o.pose_covariance[(2, 2)].sqrt() * 1e3,
                    e[3].to_degrees(),
                    e[4].to_degrees(),
                    e[5].to_degrees(),
                    o.pose_covariance[(3, 3)].sqrt().to_degrees(),
                    o.pose_covariance[(5, 5)].sqrt().to_degrees(),
                    s.camera_clock * 1e3,
                    s.covariance[(24, 24)].sqrt() * 1e3,
                    (s.velocity - run.motion.kinematics(t).velocity).as_slice(),
                    (k[0] - s.climber[0]) * 1e3,
                    (k[1] - s.climber[1]) * 1e3,
                    (k[2] - s.climber[2]).to_degrees(),
                    s.covariance[(15, 15)].sqrt() * 1e3,
                    s.climber_rate[0],
                    s.climber_acceleration[0],
                    s.covariance[(21, 21)].sqrt(),
                    s.accelerometer_bias.as_slice()
                );
            }
        }
        said.odometry.extend(one.odometry);
        said.records.extend(one.records);
        for w in one.warnings {
            println!("{w}");
        }
    }
    println!("{}", scoring::score(&said.odometry, &run.truth, 1.0));
    let used: Vec<_> = said.records.iter().filter(|r| r.nis.is_finite()).collect();
    println!(
        "nis mean {} gated {}",
        used.iter().map(|r| r.nis).sum::<f64>() / used.len() as f64,
        said.records.iter().filter(|r| r.outcome == pose_fusion::MarkerOutcome::Gated).count()
    );
    sc.seed = 2;
}
