//! A million corrupted inputs in a few seconds; `--example fuzz` runs more.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

#[path = "../fuzz/exercise.rs"]
mod exercise;
#[path = "../fuzz/mutate.rs"]
mod mutate;

#[test]
fn a_million_corrupted_streams_logs_and_conversations_never_panic() {
    let seeds = mutate::seeds();
    let mut random = mutate::Random(0x5DEE_CE66_D1CE_4E5B);
    let mut input = Vec::new();
    for k in 0..1_000_000_u32 {
        mutate::mutate(&seeds, &mut random, &mut input);
        match k % 10 {
            0 | 1 => exercise::driver(&input),
            2 => exercise::log(&input),
            _ => exercise::stream(&input),
        }
    }
}

#[test]
fn the_seeds_contain_valid_frames_and_a_valid_conversation() {
    // Otherwise the runs above might fail the first check of the parser every time.
    use imu_driver::{driver::*, protocol::*};
    let seeds = mutate::seeds();
    let mut frames = 0;
    for seed in &seeds[..10] {
        FrameParser::new().parse(&seed[7..], |_| frames += 1);
    }
    assert_eq!(frames, 6 * 3 + 4 * 2);
    let mut driver = Driver::new(DriverConfig { baud: None, ..DriverConfig::default() }).unwrap();
    let mut at = rig_model::Stamp::from_nanos(1_760_001_000_000_000_000);
    let mut samples = 0;
    let mut rest = &seeds[10][..];
    driver.handle(Input::Tick { at });
    while let Some((&[length, pause], tail)) = rest.split_first_chunk::<2>() {
        while let Some(output) = driver.poll() {
            match output {
                Output::Open { .. } => driver.handle(Input::Opened { at }),
                Output::Sample(_) => samples += 1,
                _ => {}
            }
        }
        at = at.plus_seconds(f64::from(pause).powi(2) * 1e-5);
        let (bytes, tail) = tail.split_at(usize::from(length));
        driver.handle(Input::Bytes { bytes, arrival: at });
        rest = tail;
    }
    // Samples wait for the clock fit; the end of the stream releases them.
    assert_eq!(samples, 0);
    driver.finish();
    while let Some(output) = driver.poll() {
        samples += u32::from(matches!(output, Output::Sample(_)));
    }
    assert_eq!(samples, 3);
}
