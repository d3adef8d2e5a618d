//! A fake MTx on a pseudo-terminal, level and turning slowly: `cargo run --release -p imu_driver --features fake
//! --example fake_unit -- /tmp/ttyFAKE`. Its port is the path given; it runs until it is killed.
#![allow(clippy::print_stdout, reason = "an executable for people")]

use imu_driver::fake_unit::{FakeSample, FakeUnitConfig, pty::PtyUnit};
use nalgebra::{UnitQuaternion, Vector3};

fn main() -> std::io::Result<()> {
    let link = std::env::args().nth(1).unwrap_or_else(|| "/tmp/ttyFAKE".into());
    let rate = 0.1;
    let unit = PtyUnit::start(
        FakeUnitConfig::default(),
        link,
        Box::new(move |at| FakeSample {
            angular_velocity: Vector3::new(0.0, 0.0, rate),
            enu_from_imu: UnitQuaternion::from_euler_angles(
                0.0,
                0.0,
                (at.as_nanos() % 1_000_000_000_000) as f64 * 1e-9 * rate,
            ),
            ..FakeSample::at_rest()
        }),
    )?;
    println!("{}", unit.path().display());
    loop {
        std::thread::sleep(std::time::Duration::from_secs(1));
    }
}
