//! What is done with bytes from outside, parser by parser: shared by the fuzz targets
//! (coverage-guided, hours) and by `test/tests/hostile_input.rs` (a few seconds of the same in
//! every test run). A finding panics.

pub mod bag;
pub mod cdr;
pub mod image;
pub mod imu;
pub mod mutate;
pub mod yaml;

type Run = fn(&[u8]);
type Seeds = fn() -> Vec<Vec<u8>>;
type Words = &'static [&'static [u8]];

/// A parser, what is done with it, and right inputs to start from.
pub struct Target {
    /// Name in `VOLANT_FUZZ_TARGET`.
    pub name: &'static str,
    /// Takes any bytes.
    pub run: Run,
    /// Right inputs.
    pub seeds: Seeds,
    /// Words of the format, for the mutator.
    pub words: Words,
}

const fn target(name: &'static str, run: Run, seeds: Seeds, words: Words) -> Target {
    Target { name, run, seeds, words }
}

/// All of them.
pub const TARGETS: [Target; 9] = [
    target("cdr", cdr::run, cdr::seeds, cdr::WORDS),
    target("parameters", yaml::parameters, yaml::parameter_seeds, yaml::WORDS),
    target("calibration", yaml::calibration, yaml::calibration_seeds, yaml::WORDS),
    target("metadata", yaml::metadata, yaml::metadata_seeds, yaml::WORDS),
    target("image", image::run, image::seeds, image::WORDS),
    target("bag", bag::run, bag::seeds, bag::WORDS),
    target("stream", |data| imu::run(imu::stream, data), imu::seeds, imu::WORDS),
    target("log", |data| imu::run(imu::log, data), imu::seeds, imu::WORDS),
    target("driver", |data| imu::run(imu::driver, data), imu::seeds, imu::WORDS),
];
