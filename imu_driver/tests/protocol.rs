//! The protocol under all ways of cutting, writing and damaging a stream.
#![allow(missing_docs, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::print_stdout)]

use imu_driver::protocol::{
    Attitude, Configuration, Decoder, FrameParser, GlobalFrame, LegacyFormat, Measurement, MessageId,
    NumberFormat, Orientation, OutputMode, OutputSettings, Status, Utc, frame,
    measurement::{RawGps, RawInertial},
    mtdata2,
};
use proptest::{collection::vec, prelude::*};

/// Every combination of bits that mean something, raw data included.
fn any_format() -> impl Strategy<Value = LegacyFormat> {
    (any::<u16>(), any::<u32>(), 0..3_u32).prop_map(|(mode, settings, form)| LegacyFormat {
        mode: OutputMode(mode & 0x583F),
        settings: OutputSettings((settings & 0x8000_0F73) | (form << 2)),
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
        vectors in vector::<12>(),
        numbers in vector::<4>(),
        attitude in attitude(form),
        words in any::<[u16; 13]>(),
        utc in any::<(u32, u16, [u8; 6])>(),
        gps in vec(any::<u8>(), 44),
        status in any::<u8>(),
    ) -> Measurement {
        let v = |i: usize| Some([vectors[i], vectors[i + 1], vectors[i + 2]]);
        let w = |i: usize| [words[i], words[i + 1], words[i + 2]];
        let (nanosecond, year, [month, day, hour, minute, second, flags]) = utc;
        Measurement {
            acceleration: v(0),
            angular_velocity: v(3),
            magnetic_field: v(6),
            velocity: v(9),
            temperature: Some(numbers[0]),
            latitude_longitude: Some([numbers[1], numbers[2]]),
            altitude: Some(numbers[3]),
            orientation: Some(Orientation { attitude, frame: GlobalFrame::NorthWestUp }),
            raw: Some(RawInertial { acceleration: w(0), angular_velocity: w(3), magnetic_field: w(6), temperature: words[9] }),
            raw_gps: Some(RawGps(gps.try_into().unwrap())),
            analog: [Some(words[10]), Some(words[11])],
            counter: Some(words[12]),
            status: Some(Status(u32::from(status))),
            utc: Some(Utc { nanosecond, year, month, day, hour, minute, second, flags }),
            ..Measurement::default()
        }
    }
}

/// What of a measurement a format carries, as the format writes it.
fn as_carried(m: &Measurement, format: LegacyFormat) -> Measurement {
    let (mode, settings) = (format.mode, format.settings);
    let round = |x: f64| settings.number_format().quantise(x);
    let vector = |v: Option<[f64; 3]>| v.map(|v| v.map(round));
    let calibrated = |bit: u32, v| if format.sends_vector(bit) { vector(v) } else { None };
    let when = |bit: u16| mode.has(bit);
    let gps = when(OutputMode::RAW_GPS);
    Measurement {
        acceleration: calibrated(OutputSettings::NO_ACCELERATION, m.acceleration),
        angular_velocity: calibrated(OutputSettings::NO_ANGULAR_VELOCITY, m.angular_velocity),
        magnetic_field: calibrated(OutputSettings::NO_MAGNETIC_FIELD, m.magnetic_field),
        velocity: vector(m.velocity).filter(|_| when(OutputMode::VELOCITY)),
        temperature: m.temperature.map(round).filter(|_| when(OutputMode::TEMPERATURE)),
        latitude_longitude: m.latitude_longitude.map(|v| v.map(round)).filter(|_| when(OutputMode::POSITION)),
        altitude: m.altitude.map(round).filter(|_| when(OutputMode::POSITION)),
        orientation: m.orientation.filter(|_| when(OutputMode::ORIENTATION)).map(|o| Orientation {
            attitude: match o.attitude {
                Attitude::Quaternion(q) => Attitude::Quaternion(q.map(round)),
                Attitude::Euler(e) => Attitude::Euler(e.map(round)),
                Attitude::Matrix(c) => Attitude::Matrix(c.map(round)),
            },
            frame: settings.global_frame(),
        }),
        raw: m.raw.filter(|_| when(OutputMode::RAW_INERTIAL)),
        raw_gps: m.raw_gps.filter(|_| gps),
        has_gnss: gps,
        analog: [OutputSettings::NO_ANALOG_1, OutputSettings::NO_ANALOG_2].map(|bit| {
            let index = usize::from(bit == OutputSettings::NO_ANALOG_2);
            m.analog[index].filter(|_| when(OutputMode::AUXILIARY) && !settings.has(bit))
        }),
        counter: m.counter.filter(|_| settings.has(OutputSettings::COUNTER)),
        status: m.status.filter(|_| when(OutputMode::STATUS)),
        utc: m.utc.filter(|_| settings.has(OutputSettings::UTC)),
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

/// Frames, noise, cut frames and false preambles, one after the other.
fn any_stream() -> impl Strategy<Value = Vec<u8>> {
    let piece = prop_oneof![
        4 => (any::<u8>(), vec(any::<u8>(), 0..300)).prop_map(|(id, data)| frame(MessageId(id), &data)),
        1 => (vec(any::<u8>(), 0..100), 0..50_usize)
            .prop_map(|(data, cut)| { let mut f = frame(MessageId::MT_DATA, &data); f.truncate(cut); f }),
        1 => vec(any::<u8>(), 0..40),
        1 => vec(prop_oneof![Just(0xFA_u8), Just(0xFF), Just(0x01), Just(0x32), Just(0x00)], 0..12),
        1 => vec(any::<u8>(), 300..1200).prop_map(|data| frame(MessageId::MT_DATA2, &data)),
    ];
    vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_split_of_any_stream_gives_the_same_frames(stream in any_stream(), cuts in vec(0..90_usize, 0..60)) {
        let (whole, counts) = parse(&stream, &[]);
        prop_assert_eq!((&whole, counts), (&parse(&stream, &cuts).0, parse(&stream, &cuts).1));
        let bytewise = parse(&stream, &vec![1; stream.len()]);
        prop_assert_eq!((&whole, counts), (&bytewise.0, bytewise.1));
        prop_assert_eq!(counts.frames as usize, whole.len());
        prop_assert_eq!(counts.frame_bytes + counts.skipped_bytes, stream.len() as u64);
    }

    #[test]
    fn every_legacy_format_round_trips(
        (format, m) in any_format().prop_flat_map(|f| {
            (Just(f), any_measurement((f.settings.0 >> 2) & 3))
        })
    ) {
        let mut data = Vec::new();
        format.encode(&m, &mut data);
        prop_assert_eq!(data.len(), format.data_length());
        prop_assert_eq!(format.decode(&data), Ok(as_carried(&m, format)));
        // And through the wire, after the Configuration.
        let configuration = Configuration { format, ..Configuration::default() };
        let mut stream = frame(MessageId::REQ_CONFIGURATION.ack(), &configuration.to_data());
        stream.extend(frame(MessageId::MT_DATA, &data));
        let mut decoder = Decoder::default();
        let mut decoded = Vec::new();
        FrameParser::new().parse(&stream, |f| decoded.push(decoder.decode(&f).unwrap()));
        prop_assert_eq!(decoded, vec![None, Some(as_carried(&m, format))]);
        prop_assert!(format.decode(&data[..data.len().saturating_sub(1)]).is_err() || data.is_empty());
    }

    #[test]
    fn mtdata2_round_trips_in_all_formats(m in any_measurement(0), bits in 0..4_u32, fine in any::<u32>()) {
        let format = NumberFormat::from_bits(bits);
        let m = Measurement {
            sample_time_fine: Some(fine),
            pressure: Some(fine),
            raw: None,
            raw_gps: None,
            analog: [None; 2],
            ..m
        };
        let mut data = Vec::new();
        mtdata2::encode(&m, format, &mut data);
        let round3 = |v: Option<[f64; 3]>| v.map(|v| v.map(|x| format.quantise(x)));
        let expected = Measurement {
            acceleration: round3(m.acceleration),
            angular_velocity: round3(m.angular_velocity),
            magnetic_field: round3(m.magnetic_field),
            velocity: round3(m.velocity),
            temperature: m.temperature.map(|x| format.quantise(x)),
            altitude: m.altitude.map(|x| format.quantise(x)),
            latitude_longitude: m.latitude_longitude.map(|v| v.map(|x| format.quantise(x))),
            orientation: m.orientation.map(|o| match o.attitude {
                Attitude::Quaternion(q) => {
                    Orientation { attitude: Attitude::Quaternion(q.map(|x| format.quantise(x))), ..o }
                }
                _ => o,
            }),
            ..m.clone()
        };
        prop_assert_eq!(mtdata2::decode(&data), Ok(expected));
    }

    #[test]
    fn no_bytes_whatever_make_a_decoder_panic(data in vec(any::<u8>(), 0..400), mode: u16, settings: u32) {
        let format = LegacyFormat { mode: OutputMode(mode), settings: OutputSettings(settings) };
        let _ = format.decode(&data);
        let mut fitting = data.clone();
        fitting.resize(format.data_length(), 0x5A);
        prop_assert!(format.decode(&fitting).is_ok());
        let _ = mtdata2::decode(&data);
        let _ = Configuration::from_data(&data);
        let _ = imu_driver::log::saved_configuration(&data);
    }
}

#[test]
fn every_single_output_mode_and_form_and_number_format_has_its_own_length() {
    // Data of one number format: temperature, three vectors, attitude, position, velocity, status, counter, UTC.
    for format in NumberFormat::ALL {
        for (form, attitude) in [(0, 4), (1, 3), (2, 9)] {
            let all = LegacyFormat {
                mode: OutputMode(0x083F),
                settings: OutputSettings(3 | (form << 2) | (format.bits() << 8)),
            };
            let numbers = 1 + 9 + attitude + 3 + 3;
            assert_eq!(all.data_length(), numbers * format.size() + 4 + 1 + 2 + 12);
        }
    }
    let raw = LegacyFormat { mode: OutputMode(0x4000), settings: OutputSettings(1) };
    assert_eq!(raw.data_length(), 22);
    let gps = LegacyFormat { mode: OutputMode(0x1000), settings: OutputSettings(0) };
    assert_eq!(gps.data_length(), 44);
}
