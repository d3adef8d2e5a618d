//! Throughput from bytes to SI values, compared with a loop that sums the same bytes:
//! `cargo run --release -p imu_driver --no-default-features --example throughput`.
//! Recordings are found through `VOLANT_SHARED`.
#![allow(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a command-line tool that measures its time"
)]

use imu_driver::protocol::{
    Decoder, FrameParser, LegacyFormat, Measurement, MessageId, NumberFormat, frame,
};
use std::{hint::black_box, time::Instant};

const TARGET: usize = 32 << 20;
const ROUNDS: usize = 7;

fn repeated(bytes: &[u8]) -> Vec<u8> {
    bytes.iter().copied().cycle().take(TARGET / bytes.len().max(1) * bytes.len()).collect()
}

fn best(mut work: impl FnMut()) -> f64 {
    (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .fold(f64::INFINITY, f64::min)
}

fn measure(name: &str, format: Option<LegacyFormat>, bytes: &[u8]) {
    let stream = repeated(bytes);
    let sum = best(|| {
        let mut sum = 0_u64;
        for byte in black_box(&stream[..]) {
            sum += u64::from(*byte);
        }
        black_box(sum);
    });
    let mut frames = 0_u64;
    let parse = best(|| {
        let mut decoder = Decoder { format };
        let mut parser = FrameParser::new();
        let mut measurement = Measurement::default();
        frames = 0;
        // In chunks as read from a serial port.
        for bytes in black_box(&stream[..]).chunks(4096) {
            parser.parse(bytes, |f| {
                if let Ok(true) = decoder.decode_into(&f, &mut measurement) {
                    black_box(&measurement);
                    frames += 1;
                }
            });
        }
    });
    let mbps = |seconds: f64| stream.len() as f64 / seconds / 1e6;
    println!(
        "{name}: {:.0} MB/s, {:.1} million messages/s; the sum {:.0} MB/s; ratio 1/{:.1}",
        mbps(parse),
        frames as f64 / parse / 1e6,
        mbps(sum),
        parse / sum
    );
}

fn main() {
    for number in NumberFormat::ALL {
        let mut format = LegacyFormat::STANDARD;
        format.settings = format.settings.with_number_format(number);
        let m = Measurement { acceleration: Some([0.1, 0.2, 9.8]), ..Measurement::default() };
        let mut data = Vec::new();
        format.encode(&m, &mut data);
        measure(&format!("legacy {number:?}"), Some(format), &frame(MessageId::MT_DATA, &data));
    }
    let Some(shared) = std::env::var_os("VOLANT_SHARED") else {
        println!("recordings skipped: VOLANT_SHARED is not set");
        return;
    };
    for log in 1..=5 {
        let path = std::path::Path::new(&shared).join(format!("data/xsens/{log}/output.bin"));
        match std::fs::read(&path) {
            Ok(bytes) => measure(&format!("recording {log}"), None, &bytes),
            Err(error) => println!("recording {log} skipped: {error}"),
        }
    }
}
