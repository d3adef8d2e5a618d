//! Rigs that differ in everything: mountings, layouts, lenses, rates, noises and delays at random.

use super::{against_rig, in_parallel, simulated};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use rig_model::{CameraModel, Distortion, Frames, ImuMounting, MarkerLayout, PerColor, Rig};
use rig_simulator::{inertial::SensorConfig, motion::MotionConfig, random::Random};

fn pick<T: Copy, const N: usize>(r: &mut Random, of: [T; N]) -> T {
    of[r.index(N)]
}

fn logarithmic(r: &mut Random, low: f64, high: f64) -> f64 {
    r.within(low.ln(), high.ln()).exp()
}

/// Uniform over all rotations.
fn any_rotation(r: &mut Random) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(nalgebra::Quaternion::new(
        r.normal(),
        r.normal(),
        r.normal(),
        r.normal(),
    ))
}

struct Case {
    rig: Rig,
    camera: CameraModel,
    motion: MotionConfig,
    sensors: SensorConfig,
    about: String,
}

fn case(seed: u64) -> Case {
    let mut r = Random::fork(seed, "rig");
    // From the camera down to the platform, m. The layout fills a fifth to a half of the image.
    let distance = logarithmic(&mut r, 0.6, 4.0);
    let (width, height) = pick(&mut r, [(320u32, 240u32), (640, 480), (1280, 720), (1920, 1080)]);
    let focal = f64::from(height) * r.within(0.7, 1.3);
    let spread = distance / focal * f64::from(height) * r.within(0.1, 0.2);
    let lens = match r.index(3) {
        0 => Distortion::PlumbBob([0.0; 5]),
        1 => Distortion::PlumbBob([-0.23, 0.082, 7e-4, -4e-4, -6e-3]),
        _ => Distortion::Equidistant([-0.01, 0.02, -0.01, 2e-3]),
    };
    let middle = [f64::from(width) / 2.0, f64::from(height) / 2.0];
    let intrinsics = [focal, focal * r.within(0.99, 1.01), middle[0] + 5.0, middle[1] - 7.0];
    let camera = CameraModel::new(width, height, intrinsics, lens).unwrap();

    let down = UnitQuaternion::from_scaled_axis(Vector3::x() * std::f64::consts::PI);
    let turn = UnitQuaternion::from_scaled_axis(Vector3::z() * r.within(-3.1, 3.1));
    let lean = UnitQuaternion::from_scaled_axis(Vector3::new(r.normal(), r.normal(), 0.0) * 0.03);
    let camera_turn = turn * lean * down;
    let below = r.within(0.05, 0.3);
    let imu_turn = if r.unit() < 0.3 { UnitQuaternion::identity() } else { any_rotation(&mut r) };
    let lever = Vector3::new(r.normal(), r.normal(), r.normal()) * 0.5 * spread;
    let [accelerometer, gyroscope] =
        [logarithmic(&mut r, 5e-4, 6e-3), logarithmic(&mut r, 5e-5, 2e-3)];
    // Lengths as a rig file has them.
    let rounded = |v: f64| (v * 1e4).round() / 1e4;
    let mut center = |x: f64, y: f64| {
        let mut shift = || spread * r.within(-0.15, 0.15);
        let center = [spread * x + shift(), spread * y + shift(), 0.1 * shift()];
        Point3::from(center.map(rounded))
    };
    let centers = [center(1.0, 1.0), center(-1.0, 1.0), center(-1.0, -1.0), center(1.0, -1.0)];
    let [x, y] = [r.within(-0.03, 0.03), r.within(-0.03, 0.03)].map(|x| x * distance);
    let camera_position = [x, y, -below].map(|v| (v * 1e3).round() / 1e3);
    let rig = Rig {
        frames: Frames::default(),
        climber_from_camera: Isometry3::from_parts(camera_position.into(), camera_turn),
        imu: ImuMounting {
            volant_from_imu: Isometry3::from_parts(lever.map(rounded).into(), imu_turn),
            accelerometer_noise_density: accelerometer,
            gyroscope_noise_density: gyroscope,
        },
        markers: MarkerLayout { side: rounded(spread * 0.4), centers: PerColor(centers) },
        colors: PerColor([None; 4]),
    };
    let climber_height = r.within(1.0, 9.0);
    let motion = MotionConfig {
        duration: 16.0,
        swing: r.within(0.02, 0.12),
        // The rope, and with it the pendulum, is as long as the camera is high.
        frequency: (9.81 / (distance + below)).sqrt() / std::f64::consts::TAU,
        wobble: r.within(0.0, 0.05),
        yaw: r.within(0.0, 0.6),
        climber_speed: r.within(0.0, 0.6),
        climber_turn_rate: r.within(0.0, 0.3),
        climber_height,
        platform_height: climber_height - below - distance,
        ..MotionConfig::nominal(seed)
    };
    let nominal = SensorConfig::nominal(seed);
    let imu_rate = pick(&mut r, [50.0, 100.0, 200.0, 400.0, 1000.0]);
    let image_rate = pick(&mut r, [10.0, 25.0, 30.0, 60.0, 90.0]);
    let climber_rate = pick(&mut r, [20.0, 50.0, 100.0, 500.0]);
    let image_delay = r.within(0.005, 0.12);
    let sensors = SensorConfig {
        imu_rate,
        image_rate,
        climber_rate,
        accelerometer_bias: nominal.accelerometer_bias * 2.0,
        attitude_error: if r.unit() < 0.5 { 0.0 } else { nominal.attitude_error },
        pixel_noise: logarithmic(&mut r, 0.03, 0.4),
        image_delay: [image_delay, image_delay * 1.3],
        climber_quantum: pick(&mut r, [[0.0, 0.0], [1e-4, 1e-4], [5e-4, 5e-4], [1e-3, 9e-4]]),
        imu_delay: [0.001, 0.001 + 0.5 / imu_rate],
        climber_noise: pick(&mut r, [[0.0, 0.0], [5e-4, 5e-4], [2e-3, 2e-3]]),
        climber_delay: [0.002, r.within(0.003, 0.05)],
        ..nominal
    };
    let ahead = r.within(-0.1, 0.1);
    let sensors = SensorConfig { camera_clock_ahead: ahead, climber_clock_ahead: ahead, ..sensors };
    let fisheye = matches!(lens, Distortion::Equidistant(_));
    let about = format!(
        "{distance:.1} m, {width} px wide, f {focal:.0}{}, {image_rate} Hz, {:.2} px; \
         IMU {imu_rate} Hz, {accelerometer:.1e}, {gyroscope:.1e}; climber {climber_rate} Hz, \
         {:.2} m/s; offset {:+.0} ms, swing {:.2}",
        if fisheye { " fisheye" } else { "" },
        sensors.pixel_noise,
        motion.climber_speed,
        ahead * 1e3,
        motion.swing,
    );
    Case { rig, camera, motion, sensors, about }
}

/// Largest geometric mean of the RMSE over the bound, and largest of one rig: a gyroscope that is
/// ten times better than its scale factor, a camera that sees little, or an offset that is found
/// late.
const POSITION: [f64; 2] = [1.15, 3.0];
const ROTATION: f64 = 1.4;
/// At most one of this many rigs may report wrong encoders.
const BLAMELESS: usize = 24;
/// Largest NEES of a rig, of three degrees of freedom each.
const NEES: f64 = 10.0;

#[test]
fn other_rigs_come_near_the_bound() {
    let from: u64 = std::env::var("VOLANT_SEED").ok().and_then(|n| n.parse().ok()).unwrap_or(1);
    let runs = in_parallel(from..from + super::runs(), |seed| {
        let case = case(seed);
        let mut config = simulated::config();
        let [step, turn_step] = case.sensors.climber_quantum;
        config.tight.climber.quantum = step.max(1e-5);
        config.tight.climber.turn_quantum = turn_step.max(1e-5);
        let against =
            against_rig(&case.rig, &case.camera, case.motion, &case.sensors, &config, 6.0);
        (seed, against, case.about)
    });
    let mut logarithms = [0.0; 2];
    for (seed, run, about) in &runs {
        let (position, rotation) = run.ratios();
        let [position_nees, rotation_nees] = run.nees.map(|sum| sum / run.samples);
        println!(
            "{seed}: position {position:.2} of {:.2} mm, rotation {rotation:.2} of {:.3}°, NEES \
             {position_nees:.1} {rotation_nees:.1}, {} encoder warnings; {about}",
            (run.position[1] / run.samples).sqrt() * 1e3,
            (run.rotation[1] / run.samples).sqrt().to_degrees(),
            run.encoder_warnings,
        );
        logarithms[0] += position.ln();
        logarithms[1] += rotation.ln();
        assert!(run.missing < 10, "{seed}: {} missing", run.missing);
        assert!(position < POSITION[1], "{seed}");
        assert!(position_nees.max(rotation_nees) < NEES, "{seed}");
    }
    let [position, rotation] = logarithms.map(|sum| (sum / runs.len() as f64).exp());
    println!(
        "{} rigs, RMSE over the bound, geometric mean: position {position:.3}, rotation \
         {rotation:.3}",
        runs.len()
    );
    let blamed = runs.iter().filter(|(_, run, _)| run.encoder_warnings > 0).count();
    assert!(blamed * BLAMELESS <= runs.len(), "{blamed} rigs whose encoders are reported");
    assert!(position < POSITION[0] && rotation < ROTATION, "{position:.3} {rotation:.3}");
}
