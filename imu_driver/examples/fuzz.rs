//! Corrupted inputs (default ten million) for parser, decoders, CSV and driver:
//! `cargo run --release -p imu_driver --no-default-features --example fuzz -- 10000000 [SEED]`.
#![allow(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a command-line tool that measures its time"
)]

#[path = "../fuzz/exercise.rs"]
mod exercise;
#[path = "../fuzz/mutate.rs"]
mod mutate;

fn main() {
    let mut arguments = std::env::args().skip(1);
    let inputs = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(10_000_000_u64);
    let seed = arguments.next().and_then(|n| n.parse().ok()).unwrap_or(1_u64);
    let seeds = mutate::seeds();
    let mut random = mutate::Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let mut input = Vec::new();
    let mut bytes = 0;
    let start = std::time::Instant::now();
    for k in 0..inputs {
        mutate::mutate(&seeds, &mut random, &mut input);
        bytes += input.len();
        match k % 10 {
            0 | 1 => exercise::driver(&input),
            2 => exercise::log(&input),
            _ => exercise::stream(&input),
        }
    }
    let seconds = start.elapsed().as_secs_f64();
    println!("{inputs} inputs, {bytes} bytes, {seconds:.1} s, 0 findings (a finding panics)");
}
