//! Bytes of the IMU: parser and decoders, log, state machine.

use imu_driver::{
    driver::{Driver, DriverConfig, Input, Output},
    log::{decode_to_csv, saved_configuration},
    protocol::{
        Configuration, Decoder, FrameParser, LegacyFormat, Measurement, MessageId, NumberFormat,
        OutputMode, OutputSettings, frame, mtdata2,
    },
};
use rig_model::Stamp;

/// Beginnings of frames: of any, MTData, MTData2, Error.
pub const WORDS: &[&[u8]] = &[b"\xFA\xFF", b"\xFA\xFF\x32", b"\xFA\xFF\x36", b"\xFA\xFF\x42\x01"];

/// Processes the bytes as they are, and with corrected checksums, so that corrupted data reach the
/// decoders.
pub fn run<T>(process: fn(&[u8]) -> T, data: &[u8]) {
    process(data);
    let mut repaired = data.to_vec();
    repair(&mut repaired);
    if repaired != data {
        process(&repaired);
    }
}

/// Parses and decodes bytes; the first seven select the legacy format and the size of the chunks.
/// Returns the number of frames.
pub fn stream(data: &[u8]) -> u64 {
    let Some((&[m0, m1, s0, s1, s2, s3, chunk], rest)) = data.split_first_chunk::<7>() else {
        return 0;
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
    let _ = mtdata2::decode(rest);
    let _ = format.decode(rest);
    let mut fitting = rest.to_vec();
    fitting.resize(format.data_length(), 0x5A);
    assert!(format.decode(&fitting).is_ok());
    frames
}

/// Decodes a log to CSV.
pub fn log(data: &[u8]) {
    let _ = saved_configuration(data);
    let mut table = Vec::new();
    let _ = decode_to_csv(data, Some(LegacyFormat::STANDARD), &mut table);
}

/// Chunks of bytes for the driver, each preceded by its length and the time passed.
///
/// Asserts that stamps increase and that all values are finite. Returns the number of samples.
pub fn driver(data: &[u8]) -> u32 {
    let Ok(mut driver) = Driver::new(DriverConfig { baud: 0, ..DriverConfig::default() }) else {
        return 0;
    };
    let mut at = Stamp::from_nanos(1_760_001_000_000_000_000);
    let mut last: Option<Stamp> = None;
    let (mut samples, mut finished) = (0, false);
    let mut rest = data;
    driver.handle(Input::Tick, at);
    loop {
        while let Some(output) = driver.poll() {
            match output {
                Output::Open { .. } => driver.handle(Input::Opened, at),
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
                    samples += 1;
                }
                _ => {}
            }
        }
        let Some((&[length, pause], tail)) = rest.split_first_chunk::<2>() else {
            if finished {
                return samples;
            }
            // Releases the samples that wait for the clock fit.
            driver.finish();
            finished = true;
            continue;
        };
        // Up to 0.65 s, squared so that short pauses are frequent.
        at = at.plus_seconds(f64::from(pause).powi(2) * 1e-5);
        let (bytes, tail) = tail.split_at(usize::from(length).min(tail.len()));
        match bytes {
            [] => driver.handle(Input::Tick, at),
            [0xEE, ..] => driver.handle(Input::Lost("fuzzed"), at),
            _ => driver.handle(Input::Bytes(bytes), at),
        }
        rest = tail;
    }
}

/// Valid inputs: ten streams with frames in all formats, and a conversation that leads to
/// measuring.
pub fn seeds() -> Vec<Vec<u8>> {
    let m = Measurement {
        counter: Some(65_535),
        sample_time_fine: Some(863_999_999),
        acceleration: Some([0.1, -0.2, 9.8]),
        angular_velocity: Some([0.01, 0.02, -0.03]),
        magnetic_field: Some([0.4, 0.0, -0.9]),
        temperature: Some(25.0),
        ..Measurement::default()
    };
    let mut seeds = Vec::new();
    let format = LegacyFormat::STANDARD;
    let configuration =
        Configuration { period: 1152, format, data_length: 54, ..Configuration::default() };
    let mut data = Vec::new();
    format.encode(&m, &mut data);
    for settings in [0, 1, 0x101, 0x203, 0x302, 0x8000_0009] {
        let format = LegacyFormat {
            mode: OutputMode::from_bits_retain(0x083F),
            settings: OutputSettings::from_bits_retain(settings),
        };
        let mut data = Vec::new();
        format.encode(&m, &mut data);
        let mut seed = format.mode.bits().to_be_bytes().to_vec();
        seed.extend(format.settings.bits().to_be_bytes());
        seed.push(64);
        seed.extend(frame(MessageId::MT_DATA, &data));
        seed.extend(frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data()));
        seed.extend(frame(MessageId::MT_DATA, &data));
        seeds.push(seed);
    }
    for format in NumberFormat::ALL {
        let mut data = Vec::new();
        mtdata2::encode(&m, format, &mut data);
        seeds.push(
            [vec![0; 7], frame(MessageId::MT_DATA2, &data), frame(MessageId::MT_DATA2, &data)]
                .concat(),
        );
    }
    // Chunks with length and pause.
    let mut conversation = Vec::new();
    let mut add = |bytes: &[u8], pause: u8| {
        conversation.extend([bytes.len() as u8, pause]);
        conversation.extend(bytes);
    };
    for _ in 0..4 {
        add(&[], 200);
    }
    add(&frame(MessageId::GO_TO_CONFIG.ack(), &[]), 30);
    add(&frame(MessageId::REQ_DEVICE_ID.ack(), &[0, 0x30, 1, 2]), 30);
    add(&frame(MessageId::REQ_PRODUCT_CODE.ack(), b"MTx"), 30);
    add(&frame(MessageId::REQ_FIRMWARE.ack(), &[1, 2, 3]), 30);
    add(&frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data()), 30);
    add(&frame(MessageId::ERROR, &[4]), 30);
    add(&frame(MessageId::GO_TO_MEASUREMENT.ack(), &[]), 30);
    for counter in [65_534, 65_535, 0_u16] {
        let at = data.len() - 2;
        data[at..].copy_from_slice(&counter.to_be_bytes());
        add(&frame(MessageId::MT_DATA, &data), 31);
    }
    add(&frame(MessageId::WAKE_UP, &[]), 100);
    seeds.push(conversation);
    seeds
}

/// Corrects the checksum of every frame, so that corrupted data reach the decoders.
fn repair(bytes: &mut [u8]) {
    let mut at = 0;
    while at + 5 <= bytes.len() {
        if bytes[at] == 0xFA && bytes[at + 1] == 0xFF && bytes[at + 3] != 0xFF {
            let end = at + 4 + usize::from(bytes[at + 3]);
            if end < bytes.len() {
                let sum = bytes[at + 1..end].iter().fold(0_u8, |s, b| s.wrapping_add(*b));
                bytes[end] = sum.wrapping_neg();
                at = end;
            }
        }
        at += 1;
    }
}
