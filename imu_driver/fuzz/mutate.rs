//! Corrupted inputs without a fuzzer: frames and conversations, truncated, flipped, repeated and
//! spliced at random.

use imu_driver::protocol::{
    Configuration, LegacyFormat, Measurement, MessageId, NumberFormat, OutputMode, OutputSettings,
    frame, mtdata2,
};

/// xorshift64*.
pub struct Random(pub u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    fn below(&mut self, n: usize) -> usize {
        ((self.next() >> 32) as usize * n.max(1)) >> 32
    }
}

/// Valid inputs to corrupt.
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
    // A conversation that leads to measuring: chunks with length and pause.
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

/// Writes one corrupted input to `out`.
pub fn mutate(seeds: &[Vec<u8>], random: &mut Random, out: &mut Vec<u8>) {
    out.clear();
    out.extend_from_slice(&seeds[random.below(seeds.len())]);
    for _ in 0..1 + random.below(6) {
        let at = random.below(out.len());
        match random.below(8) {
            0 => out.truncate(at),
            1 if !out.is_empty() => {
                out.remove(at);
            }
            2 => out.insert(at.min(out.len()), random.next() as u8),
            3 => {
                let other = &seeds[random.below(seeds.len())];
                let from = random.below(other.len());
                out.extend_from_slice(&other[from..]);
            }
            4 if out.len() < 1000 => out.extend_from_within(at..),
            5 => {
                if let Some(byte) = out.get_mut(at) {
                    *byte = [0xFA, 0xFF, 0x00, 0x01, 0x7F, 0x80][random.below(6)];
                }
            }
            _ => {
                if let Some(byte) = out.get_mut(at) {
                    *byte ^= 1 << random.below(8);
                }
            }
        }
    }
    if random.below(4) == 0 {
        repair(out);
    }
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
