//! Simulated MTx on a pseudo-terminal, level and rotating slowly, until it is stopped:
//! `cargo run --release -p imu_driver --features simulated --example simulated_imu -- /tmp/ttyIMU`.
#![allow(clippy::print_stdout, reason = "a command-line tool")]

use imu_driver::simulated_imu::{SimulatedImuConfig, SimulatedSample, pty::PtyImu};
use nalgebra::{UnitQuaternion, Vector3};

fn main() -> std::io::Result<()> {
    let link = std::env::args().nth(1).unwrap_or_else(|| "/tmp/ttyIMU".into());
    let rate = 0.1;
    let imu = PtyImu::start(
        SimulatedImuConfig::default(),
        link,
        Box::new(move |at| SimulatedSample {
            angular_velocity: Vector3::new(0.0, 0.0, rate),
            enu_from_imu: UnitQuaternion::from_euler_angles(
                0.0,
                0.0,
                (at.as_nanos() % 1_000_000_000_000) as f64 * 1e-9 * rate,
            ),
            ..SimulatedSample::stationary()
        }),
    )?;
    println!("{}", imu.path().display());
    loop {
        std::thread::sleep(std::time::Duration::from_secs(1));
    }
}
