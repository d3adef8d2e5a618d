//! Normalized squared errors over many runs.

use super::*;

/// Normalized squared errors of position, velocity and attitude every tenth of a second.
///
/// The simulated rig has no calibration errors, so the filter is configured without them; its IMU
/// has scale factors and misalignments as configured. Else the filter has its defaults, though the
/// runs' biases are smaller (0.03 m/s² and 0.008 rad/s, 1 sigma).
fn nees(seed: u64) -> Vec<[f64; 3]> {
    let sensors = SensorConfig::nominal(seed);
    let mut run = simulated::run(MotionConfig::nominal(seed), &sensors);
    let imu = simulated::config().tight.imu;
    let mut random = Random::fork(seed, "IMU constants");
    let mut three = |sigma: f64| Vector3::from_fn(|_, _| sigma * random.normal());
    let scales = [three(imu.gyroscope_scale), three(imu.accelerometer_scale)];
    let turns = [three(imu.misalignment), three(imu.misalignment)];
    let measured = |k: usize, v: &Vector3<f64>| v + scales[k].component_mul(v) + turns[k].cross(v);
    for (_, input) in &mut run.inputs {
        if let Input::Imu(sample) = input {
            sample.angular_velocity = measured(0, &sample.angular_velocity);
            sample.specific_force = measured(1, &sample.specific_force);
        }
    }
    let (_, outputs) = scoring::follow(simulated::config(), run.inputs());
    let mut found = Vec::new();
    for tenth in FIRST..118 {
        let at = sensors.epoch.plus_seconds(tenth as f64 / 10.0);
        let o = outputs.odometry.iter().find(|o| o.stamp >= at).unwrap();
        let k = run.motion.kinematics(o.stamp.seconds_since(sensors.epoch));
        let error = PoseError::new(&o.world_from_volant, &k.world_from_volant);
        let [position, rotation] = Nees::pair(&error, &o.pose_covariance);
        let v = k.world_from_volant.rotation.inverse() * k.velocity - o.linear_velocity;
        let square = |e: Vector3<f64>, c: Matrix3<f64>| e.dot(&c.cholesky().unwrap().solve(&e));
        found.push([
            position,
            square(v, o.twist_covariance.fixed_view::<3, 3>(0, 0).into_owned()),
            rotation,
        ]);
    }
    found
}

/// From two seconds on.
const FIRST: usize = 20;
/// χ² with 150 degrees of freedom, 2.5 % and 97.5 %, over 50.
const INTERVAL: (f64, f64) = (117.985 / 50.0, 185.800 / 50.0);

#[test]
fn the_covariance_matches_the_errors_of_fifty_runs() {
    let runs = in_parallel(100..150, nees);
    let (low, high) = INTERVAL;
    let times = runs[0].len();
    for (k, name) in ["position", "velocity", "attitude"].into_iter().enumerate() {
        let averages: Vec<f64> =
            (0..times).map(|t| runs.iter().map(|r| r[t][k]).sum::<f64>() / 50.0).collect();
        let share = |f: &dyn Fn(f64) -> bool| {
            averages.iter().filter(|a| f(**a)).count() as f64 / times as f64
        };
        let (below, above) = (share(&|a| a < low), share(&|a| a > high));
        let mean = averages.iter().sum::<f64>() / times as f64;
        println!(
            "{name}: ANEES {mean:.2} (ideal 3), inside [{low:.2}, {high:.2}] {:.0} % of the time, \
             {:.0} % below, {:.0} % above",
            100.0 * (1.0 - below - above),
            100.0 * below,
            100.0 * above
        );
        assert!(below + above <= 0.1, "{mean}: below {below}, above {above}");
    }
}
