//! What is done with bytes from outside, parser by parser: shared by the fuzz targets
//! (coverage-guided, hours) and by `test/tests/hostile_input.rs` (a few seconds of the same in
//! every test run). A finding panics.

pub mod bag;
pub mod cdr;
pub mod image;
pub mod imu;
pub mod mutate;
pub mod yaml;

/// A parser, what is done with it, and right inputs to start from.
pub struct Target {
    /// As the fuzz target's executable is called.
    pub name: &'static str,
    /// Takes any bytes.
    pub run: fn(&[u8]),
    /// Right inputs.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Words of the format, for the mutator.
    pub words: &'static [&'static [u8]],
}

/// All of them.
pub const TARGETS: [Target; 9] = [
    Target { name: "cdr", run: cdr::run, seeds: cdr::seeds, words: cdr::WORDS },
    Target {
        name: "parameters",
        run: yaml::parameters,
        seeds: yaml::parameter_seeds,
        words: yaml::WORDS,
    },
    Target {
        name: "calibration",
        run: yaml::calibration,
        seeds: yaml::calibration_seeds,
        words: yaml::WORDS,
    },
    Target {
        name: "metadata",
        run: yaml::metadata,
        seeds: yaml::metadata_seeds,
        words: yaml::WORDS,
    },
    Target { name: "image", run: image::run, seeds: image::seeds, words: image::WORDS },
    Target { name: "bag", run: bag::run, seeds: bag::seeds, words: bag::WORDS },
    Target {
        name: "stream",
        run: |data| imu::run(imu::stream, data),
        seeds: imu::seeds,
        words: imu::WORDS,
    },
    Target {
        name: "log",
        run: |data| imu::run(imu::log, data),
        seeds: imu::seeds,
        words: imu::WORDS,
    },
    Target {
        name: "driver",
        run: |data| imu::run(imu::driver, data),
        seeds: imu::seeds,
        words: imu::WORDS,
    },
];
