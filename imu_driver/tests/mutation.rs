//! A million hostile inputs in a few seconds; ten million and more: `--example fuzz`.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

#[path = "../fuzz/exercise.rs"]
mod exercise;
#[path = "../fuzz/mutate.rs"]
mod mutate;

#[test]
fn a_million_damaged_streams_logs_and_conversations_do_no_harm() {
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
fn the_seeds_reach_what_they_are_meant_to_reach() {
    // Without this the runs above could be shut out at the first check.
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
    // They wait for the clocks' offset, and come when there is nothing more to wait for.
    assert_eq!(samples, 0);
    driver.finish();
    while let Some(output) = driver.poll() {
        samples += u32::from(matches!(output, Output::Sample(_)));
    }
    assert_eq!(samples, 3);
}
