//! Recordings of real devices, compared with values decoded by another program; the recordings are
//! found through `VOLANT_SHARED`.
#![allow(
    missing_docs,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::print_stderr
)]

use imu_driver::{
    log::{decode_to_csv, frames_of},
    protocol::{Attitude, Decoder, GlobalFrame, Measurement, MessageId, frame},
};
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

fn recordings() -> Option<PathBuf> {
    Some(test_support::recordings()?.join("data/xsens"))
}

/// One message of the reference: lines by heading.
type Reference = BTreeMap<String, Vec<String>>;

fn reference(text: &str) -> Vec<Reference> {
    text.split("\n\n")
        .filter(|block| !block.trim().is_empty())
        .map(|block| {
            let mut message = Reference::new();
            let mut heading = String::new();
            for line in block.lines().filter(|l| !l.is_empty()) {
                match line.strip_prefix("  ") {
                    Some(value) => message.get_mut(&heading).unwrap().push(value.to_owned()),
                    None => {
                        heading = line.trim_end_matches(':').to_owned();
                        message.insert(heading.clone(), Vec::new());
                    }
                }
            }
            message
        })
        .collect()
}

fn numbers(lines: &[String]) -> Vec<f64> {
    lines.iter().map(|l| l.rsplit(':').next().unwrap().parse().unwrap()).collect()
}

/// Bytes and reference of one of the recordings.
fn recording(folder: &Path, log: usize) -> (Vec<u8>, Vec<Reference>) {
    let folder = folder.join(log.to_string());
    let golden = std::fs::read_to_string(folder.join("output.golden")).unwrap();
    (std::fs::read(folder.join("output.bin")).unwrap(), reference(&golden))
}

/// Numbers of one kind of data.
fn theirs(reference: &Reference, name: &str) -> Option<Vec<f64>> {
    let mut kinds = reference.iter();
    let found = kinds.find(|(heading, _)| heading.split('(').next() == Some(name));
    found.map(|(_, lines)| numbers(lines))
}

fn attitude(m: &Measurement, wanted: &str) -> Option<Vec<f64>> {
    m.orientations.iter().flatten().find_map(|o| {
        assert_eq!(o.frame, GlobalFrame::EastNorthUp);
        match (wanted, o.attitude) {
            ("Quaternion", Attitude::Quaternion(q)) => Some(q.to_vec()),
            ("EulerAngles", Attitude::Euler(e)) => Some(e.to_vec()),
            ("RotationMatrix", Attitude::Matrix(c)) => Some(c.to_vec()),
            _ => None,
        }
    })
}

#[test]
fn every_used_value_of_five_recordings_equals_the_reference() {
    let Some(folder) = recordings() else { return };
    let mut compared = 0;
    for log in 1..=5 {
        let (bytes, references) = recording(&folder, log);
        let mut ours = Vec::new();
        let mut decoder = Decoder::default();
        let counts = frames_of(&bytes, |f| ours.push(decoder.decode(&f).unwrap().unwrap()));
        assert_eq!((counts.frames, counts.bad_checksums, counts.skipped_bytes), (100, 0, 0));
        assert_eq!((ours.len(), references.len()), (100, 100));
        for (m, r) in ours.iter().zip(&references) {
            let slice3 = |v: &Option<[f64; 3]>| v.map(|v| v.to_vec());
            let whole = |v: Option<u32>| v.map(|x| vec![f64::from(x)]);
            for (name, value) in [
                ("PacketCounter", whole(m.counter.map(u32::from))),
                ("SampleTimeFine", whole(m.sample_time_fine)),
                ("Temperature", m.temperature.map(|t| vec![t])),
                ("Acceleration", slice3(&m.acceleration)),
                ("DeltaV", slice3(&m.delta_velocity)),
                ("RateOfTurn", slice3(&m.angular_velocity)),
                ("DeltaQ", m.delta_orientation.map(|q| q.to_vec())),
                ("MagneticField", slice3(&m.magnetic_field)),
                ("Quaternion", attitude(m, "Quaternion")),
                ("EulerAngles", attitude(m, "EulerAngles")),
                ("RotationMatrix", attitude(m, "RotationMatrix")),
            ] {
                assert_eq!(theirs(r, name), value, "{name}");
                compared += usize::from(value.is_some());
            }
            let bits = |text: &String| u32::from_str_radix(text, 2).unwrap();
            let status = r.get("StatusWord").or(r.get("StatusByte")).map(|lines| bits(&lines[0]));
            assert_eq!(m.status.map(|s| s.bits()), status);
        }
    }
    println!("{compared} values or vectors of 500 messages are equal to the reference");
    assert!(compared > 3000, "{compared}");
}

#[test]
fn the_csv_of_every_recording_has_one_row_per_message_with_its_values() {
    let Some(folder) = recordings() else { return };
    for log in 1..=5 {
        let (bytes, references) = recording(&folder, log);
        let mut table = Vec::new();
        let counts = decode_to_csv(&bytes, None, &mut table).unwrap();
        assert_eq!((counts.rows, counts.unreadable), (100, 0));
        let table = String::from_utf8(table).unwrap();
        for (row, r) in table.lines().skip(1).zip(&references) {
            let cells: Vec<&str> = row.split(',').collect();
            assert_eq!(cells.len(), 12);
            assert_eq!(cells[0], r["PacketCounter"][0]);
            for (at, name, n) in
                [(2, "Acceleration", 3), (5, "RateOfTurn", 3), (8, "Quaternion", 4)]
            {
                let cells = &cells[at..at + n];
                match theirs(r, name) {
                    Some(values) => {
                        let ours: Vec<f64> = cells.iter().map(|c| c.parse().unwrap()).collect();
                        assert_eq!(ours, values);
                    }
                    None => assert!(cells.iter().all(|c| c.is_empty())),
                }
            }
        }
    }
}

#[test]
fn recorded_legacy_frames_are_decoded_with_their_configuration() {
    let Some(folder) = recordings() else { return };
    let text = std::fs::read_to_string(folder.join("legacy_frames.txt")).unwrap();
    let frames: Vec<Vec<u8>> = text
        .lines()
        .filter(|l| !l.starts_with('#') && !l.trim().is_empty())
        .map(|l| l.split_whitespace().map(|b| u8::from_str_radix(b, 16).unwrap()).collect())
        .collect();
    let stream = frames.concat();
    let mut log = frame(MessageId::WAKE_UP, &[]);
    log.extend(&stream);
    let mut decoder = Decoder { format: imu_driver::log::configuration_in(&log) };
    assert_eq!(decoder.format, Some(imu_driver::protocol::LegacyFormat::STANDARD));
    let mut data = Vec::new();
    let counts = frames_of(&log, |f| data.extend(decoder.decode(&f).unwrap()));
    println!("{counts:?}");
    assert_eq!((counts.frames, counts.bad_checksums, counts.skipped_bytes), (6, 0, 0));
    assert_eq!(data.len(), 2);
    assert_eq!(data[1].counter.unwrap(), data[0].counter.unwrap() + 1);
    for m in &data {
        let [x, y, z] = m.acceleration.unwrap();
        // Stationary on a table, tilted by a few degrees.
        assert!(((x * x + y * y + z * z).sqrt() - 9.81).abs() < 0.1, "{:?}", m.acceleration);
        let [w, i, j, k] = m.quaternion().unwrap();
        assert!(((w * w + i * i + j * j + k * k).sqrt() - 1.0).abs() < 1e-5);
        assert_eq!(m.orientations[0].unwrap().frame, GlobalFrame::NorthWestUp);
        // The quaternion rotates from the sensor to the global frame: specific force points up.
        let q = nalgebra::UnitQuaternion::from_quaternion(nalgebra::Quaternion::new(w, i, j, k));
        let up = q * nalgebra::Vector3::new(x, y, z);
        assert!(up.z > 9.7 && up.xy().norm() < 0.3, "{up}");
    }
}
