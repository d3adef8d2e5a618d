//! Number of allocations per frame, counted by the allocator.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout
)]

use allocation_counter::measure;
use imu_driver::protocol::{
    Decoder, FrameParser, LegacyFormat, Measurement, MessageId, NumberFormat, frame, mtdata2,
};

#[test]
fn ten_thousand_frames_are_decoded_without_allocation() {
    let m = Measurement {
        acceleration: Some([0.1, 0.2, 9.8]),
        angular_velocity: Some([0.0; 3]),
        counter: Some(1),
        ..Measurement::default()
    };
    let mut stream = Vec::new();
    for number in NumberFormat::ALL {
        let mut data = Vec::new();
        mtdata2::encode(&m, number, &mut data);
        stream.extend(frame(MessageId::MT_DATA2, &data));
    }
    let mut data = Vec::new();
    LegacyFormat::STANDARD.encode(&m, &mut data);
    stream.extend(frame(MessageId::MT_DATA, &data));
    // A frame with an invalid checksum.
    stream.extend([0xFA, 0xFF, 0x32, 0x02, 1, 2, 3, 4]);
    let mut parser = FrameParser::new();
    let mut decoder = Decoder { format: Some(LegacyFormat::STANDARD) };
    let mut decoded = 0;
    let allocations = measure(|| {
        for _ in 0..2_000 {
            for chunk in stream.chunks(37) {
                parser.parse(chunk, |f| {
                    decoded += usize::from(matches!(decoder.decode(&f), Ok(Some(_))))
                });
            }
        }
    })
    .count_total;
    println!("{decoded} frames decoded, {allocations} allocations");
    assert_eq!((decoded, allocations), (10_000, 0));
    // The counter works.
    assert_eq!(measure(|| drop(std::hint::black_box(Box::new(1_u8)))).count_total, 1);
}
