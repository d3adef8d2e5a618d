//! Protocol: chunking, round trips in all formats, corrupted streams, allocations.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use allocation_counter::measure;
use imu_driver::protocol::{
    Attitude, Configuration, Decoder, FrameParser, GlobalFrame, LegacyFormat, Measurement,
    MessageId, NumberFormat, Orientation, OutputMode, OutputSettings, Status, frame, mtdata2,
    number::Reader,
};
use proptest::{collection::vec, prelude::*};

fn legacy(mode: u16, settings: u32) -> LegacyFormat {
    LegacyFormat {
        mode: OutputMode::from_bits_retain(mode),
        settings: OutputSettings::from_bits_retain(settings),
    }
}

/// Every combination of documented bits, including raw data.
fn any_format() -> impl Strategy<Value = LegacyFormat> {
    (any::<u16>(), any::<u32>(), 0..3_u32).prop_map(|(mode, settings, form)| LegacyFormat {
        mode: OutputMode::from_bits_truncate(mode),
        settings: OutputSettings::from_bits_retain((settings & 0x8000_0F73) | (form << 2)),
    })
}

fn number() -> impl Strategy<Value = f64> {
    prop_oneof![-2000.0..2000.0, Just(0.0), -1e-3..1e-3]
}

fn vector<const N: usize>() -> impl Strategy<Value = [f64; N]> {
    vec(number(), N).prop_map(|v| v.try_into().unwrap())
}

fn attitude(form: u32) -> BoxedStrategy<Attitude> {
    match form {
        0 => vector().prop_map(Attitude::Quaternion).boxed(),
        1 => vector().prop_map(Attitude::Euler).boxed(),
        _ => vector().prop_map(Attitude::Matrix).boxed(),
    }
}

prop_compose! {
    fn any_measurement(form: u32)(
        vectors in vector::<9>(),
        temperature in number(),
        attitude in attitude(form),
        counter in any::<u16>(),
        status in any::<u8>(),
    ) -> Measurement {
        let v = |i: usize| Some([vectors[i], vectors[i + 1], vectors[i + 2]]);
        let orientation = Some(Orientation { attitude, frame: GlobalFrame::NorthWestUp });
        Measurement {
            acceleration: v(0),
            angular_velocity: v(3),
            magnetic_field: v(6),
            temperature: Some(temperature),
            orientations: [orientation, None, None],
            counter: Some(counter),
            status: Some(Status::from_bits_retain(u32::from(status))),
            ..Measurement::default()
        }
    }
}

/// The measurement with its numbers in this format.
fn rounded(m: Measurement, format: NumberFormat) -> Measurement {
    let round = |x: f64| {
        let mut bytes = Vec::new();
        format.write(x, &mut bytes);
        let [x] = Reader::new(&bytes).numbers(format).unwrap();
        x
    };
    let vector = |v: Option<[f64; 3]>| v.map(|v| v.map(round));
    Measurement {
        acceleration: vector(m.acceleration),
        angular_velocity: vector(m.angular_velocity),
        magnetic_field: vector(m.magnetic_field),
        temperature: m.temperature.map(round),
        orientations: m.orientations.map(|o| {
            let o = o?;
            let attitude = match o.attitude {
                Attitude::Quaternion(q) => Attitude::Quaternion(q.map(round)),
                Attitude::Euler(e) => Attitude::Euler(e.map(round)),
                Attitude::Matrix(c) => Attitude::Matrix(c.map(round)),
            };
            Some(Orientation { attitude, ..o })
        }),
        ..m
    }
}

/// The measurement after a round trip in this format.
fn as_encoded(m: &Measurement, format: LegacyFormat) -> Measurement {
    let (mode, settings) = (format.mode, format.settings);
    let when = |bit: OutputMode| mode.contains(bit);
    let calibrated = |omit| when(OutputMode::CALIBRATED) && !settings.contains(omit);
    let m = rounded(m.clone(), settings.number_format());
    Measurement {
        acceleration: m.acceleration.filter(|_| calibrated(OutputSettings::NO_ACCELERATION)),
        angular_velocity: m
            .angular_velocity
            .filter(|_| calibrated(OutputSettings::NO_ANGULAR_VELOCITY)),
        magnetic_field: m.magnetic_field.filter(|_| calibrated(OutputSettings::NO_MAGNETIC_FIELD)),
        temperature: m.temperature.filter(|_| when(OutputMode::TEMPERATURE)),
        orientations: m.orientations.map(|o| {
            let o = o.filter(|_| when(OutputMode::ORIENTATION))?;
            Some(Orientation { frame: settings.global_frame(), ..o })
        }),
        counter: m.counter.filter(|_| settings.contains(OutputSettings::COUNTER)),
        status: m.status.filter(|_| when(OutputMode::STATUS)),
        other_inertial: when(OutputMode::RAW_INERTIAL),
        ..Measurement::default()
    }
}

type Found = Vec<(u8, Vec<u8>)>;

fn parse(stream: &[u8], cuts: &[usize]) -> (Found, imu_driver::protocol::ParserCounts) {
    let mut parser = FrameParser::new();
    let mut found = Vec::new();
    let mut rest = stream;
    for cut in cuts {
        let (head, tail) = rest.split_at((*cut).min(rest.len()));
        parser.parse(head, |f| found.push((f.message.0, f.data.to_vec())));
        rest = tail;
    }
    parser.parse(rest, |f| found.push((f.message.0, f.data.to_vec())));
    while let Some(f) = parser.next_frame_at_end() {
        found.push((f.message.0, f.data.to_vec()));
    }
    (found, parser.counts())
}

/// A sequence of frames, noise, truncated frames and preambles.
fn any_stream() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        4 => (any::<u8>(), vec(any::<u8>(), 0..300))
            .prop_map(|(id, data)| frame(MessageId(id), &data)),
        1 => (vec(any::<u8>(), 0..100), 0..50_usize).prop_map(|(data, length)| {
            let mut f = frame(MessageId::MT_DATA, &data);
            f.truncate(length);
            f
        }),
        1 => vec(any::<u8>(), 0..40),
        1 => vec(prop::sample::select(vec![0xFA_u8, 0xFF, 0x01, 0x32, 0x00]), 0..12),
        1 => vec(any::<u8>(), 300..1200).prop_map(|data| frame(MessageId::MT_DATA2, &data)),
    ];
    vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 2000,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn any_chunking_of_a_stream_gives_the_same_frames(
        stream in any_stream(),
        cuts in vec(0..90_usize, 0..60),
    ) {
        let (whole, counts) = parse(&stream, &[]);
        for cuts in [cuts, vec![1; stream.len()]] {
            let chunked = parse(&stream, &cuts);
            prop_assert_eq!((&whole, counts), (&chunked.0, chunked.1));
        }
        prop_assert_eq!(counts.frames as usize, whole.len());
        prop_assert_eq!(counts.frame_bytes + counts.skipped_bytes, stream.len() as u64);
    }

    #[test]
    fn every_legacy_format_round_trips(
        (format, m) in any_format().prop_flat_map(|f| {
            (Just(f), any_measurement((f.settings.bits() >> 2) & 3))
        })
    ) {
        let mut data = Vec::new();
        format.encode(&m, &mut data);
        prop_assert_eq!(data.len(), format.data_length());
        prop_assert_eq!(format.decode(&data), Ok(as_encoded(&m, format)));
        // On the wire, after a Configuration.
        let configuration = Configuration { format, ..Configuration::default() };
        let mut stream = frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data());
        stream.extend(frame(MessageId::MT_DATA, &data));
        let mut decoder = Decoder::default();
        let mut decoded = Vec::new();
        FrameParser::new().parse(&stream, |f| decoded.push(decoder.decode(&f).unwrap()));
        prop_assert_eq!(decoded, vec![None, Some(as_encoded(&m, format))]);
        let shorter = &data[..data.len().saturating_sub(1)];
        prop_assert!(format.decode(shorter).is_err() || data.is_empty());
    }

    #[test]
    fn mtdata2_round_trips_in_all_formats(
        m in any_measurement(0),
        bits in 0..4_u32,
        fine in any::<u32>(),
    ) {
        let format = NumberFormat::from_bits(bits);
        let m = Measurement { sample_time_fine: Some(fine), ..m };
        let mut data = Vec::new();
        mtdata2::encode(&m, format, &mut data);
        prop_assert_eq!(mtdata2::decode(&data), Ok(rounded(m, format)));
    }
}

#[test]
fn lengths_follow_from_output_mode_form_and_number_format() {
    // Temperature, three vectors, orientation, position, velocity, status, counter, UTC.
    for format in NumberFormat::ALL {
        for (form, attitude) in [(0, 4), (1, 3), (2, 9)] {
            let all = legacy(0x083F, 3 | (form << 2) | (format.bits() << 8));
            let numbers = 1 + 9 + attitude + 3 + 3;
            assert_eq!(all.data_length(), numbers * format.size() + 4 + 1 + 2 + 12);
        }
    }
    assert_eq!(legacy(0x4000, 1).data_length(), 22);
    assert_eq!(legacy(0x1000, 0).data_length(), 44);
}

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
