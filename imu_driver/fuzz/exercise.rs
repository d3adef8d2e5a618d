//! Processing of corrupted bytes, shared by the fuzz targets, the example and the test.

use imu_driver::{
    driver::{Driver, DriverConfig, Input, Output},
    log::{decode_to_csv, saved_configuration},
    protocol::{Decoder, FrameParser, LegacyFormat, OutputMode, OutputSettings},
};
use rig_model::Stamp;

/// Parses and decodes bytes; the first seven select the legacy format and the size of the chunks.
pub fn stream(data: &[u8]) {
    let Some((&[m0, m1, s0, s1, s2, s3, chunk], rest)) = data.split_first_chunk::<7>() else {
        return;
    };
    let format = LegacyFormat {
        mode: OutputMode::from_bits_retain(u16::from_be_bytes([m0, m1])),
        settings: OutputSettings::from_bits_retain(u32::from_be_bytes([s0, s1, s2, s3])),
    };
    let mut decoder = Decoder { format: Some(format) };
    let mut parser = FrameParser::new();
    let mut frames = 0;
    for bytes in rest.chunks(usize::from(chunk).max(1)) {
        parser.parse(bytes, |frame| {
            frames += 1;
            let _ = decoder.decode(&frame);
        });
    }
    while let Some(frame) = parser.next_frame_at_end() {
        frames += 1;
        let _ = decoder.decode(&frame);
    }
    let counts = parser.counts();
    assert_eq!(counts.frames, frames);
    assert_eq!(counts.frame_bytes + counts.skipped_bytes, rest.len() as u64);
    let _ = format.decode(rest);
    let _ = imu_driver::protocol::mtdata2::decode(rest);
}

/// Decodes a log to CSV.
pub fn log(data: &[u8]) {
    let _ = saved_configuration(data);
    let mut table = Vec::new();
    let _ = decode_to_csv(data, Some(LegacyFormat::STANDARD), &mut table);
}

/// Chunks of bytes for the driver, each preceded by its length and the time passed.
///
/// Asserts that stamps increase and that all values are finite.
pub fn driver(data: &[u8]) {
    let Ok(mut driver) = Driver::new(DriverConfig { baud: None, ..DriverConfig::default() }) else {
        return;
    };
    let mut at = Stamp::from_nanos(1_760_001_000_000_000_000);
    let mut last: Option<Stamp> = None;
    let mut rest = data;
    driver.handle(Input::Tick { at });
    loop {
        while let Some(output) = driver.poll() {
            match output {
                Output::Open { .. } => driver.handle(Input::Opened { at }),
                Output::Sample(sample) => {
                    if let Some(imu) = &sample.imu {
                        assert!(
                            imu.specific_force
                                .iter()
                                .chain(imu.angular_velocity.iter())
                                .all(|x| x.is_finite())
                        );
                        let q = imu.orientation.as_ref().map(|o| o.enu_from_imu.norm());
                        assert!(q.is_none_or(|norm| (norm - 1.0).abs() < 1e-9));
                    }
                    assert!(last.is_none_or(|last| sample.stamp > last));
                    last = Some(sample.stamp);
                }
                _ => {}
            }
        }
        let Some((&[length, pause], tail)) = rest.split_first_chunk::<2>() else {
            return;
        };
        // Up to 0.65 s, squared so that short pauses are frequent.
        at = at.plus_seconds(f64::from(pause).powi(2) * 1e-5);
        let (bytes, tail) = tail.split_at(usize::from(length).min(tail.len()));
        match bytes {
            [] => driver.handle(Input::Tick { at }),
            [0xEE, ..] => driver.handle(Input::Lost { at, reason: "fuzzed" }),
            _ => driver.handle(Input::Bytes { bytes, arrival: at }),
        }
        rest = tail;
    }
}
