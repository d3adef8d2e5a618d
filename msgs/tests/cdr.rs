//! CDR compared with PyPI `rosbags` and `cyclonedds` (golden file of `make_golden_cdr.py`).
//! `test/tests/hostile_input.rs` has corrupted bytes.

#![allow(clippy::unwrap_used, clippy::panic)]

use std::sync::LazyLock;
use volant_msgs::{
    Message, cdr,
    rcl_interfaces::msg::ParameterDescriptor,
    sensor_msgs::msg::{Image, Imu},
    std_msgs::msg::Header,
};

#[derive(serde::Deserialize)]
struct Golden {
    r#type: String,
    value: serde_json::Value,
    cdr: String,
    big_endian: String,
}

static GOLDEN: LazyLock<Vec<Golden>> =
    LazyLock::new(|| serde_json::from_str(include_str!("golden_cdr.json")).unwrap());

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(&hex[i..i + 2], 16).unwrap()).collect()
}

/// Removes the padding that some writers add at the end.
fn without_padding(bytes: &[u8]) -> &[u8] {
    let end = bytes.iter().rposition(|b| *b != 0).map_or(0, |i| i + 1);
    &bytes[..end.max(4).min(bytes.len())]
}

fn check<M: Message>() -> usize {
    let rows: Vec<&Golden> = GOLDEN.iter().filter(|g| g.r#type == M::TYPE_NAME).collect();
    for row in &rows {
        let name = M::TYPE_NAME;
        let value: M =
            serde_json::from_value(row.value.clone()).unwrap_or_else(|e| panic!("{name}: {e}"));
        let theirs = bytes(&row.cdr);
        let ours = cdr::to_bytes(&value);
        assert_eq!(without_padding(&ours), without_padding(&theirs), "{name}");
        assert!(ours.len() <= theirs.len() && theirs.len() - ours.len() < 4, "{name}");
        assert_eq!(cdr::from_bytes::<M>(&theirs).as_ref(), Ok(&value), "{name}");
        assert_eq!(
            cdr::from_bytes::<M>(&bytes(&row.big_endian)).as_ref(),
            Ok(&value),
            "{name}, big endian"
        );
        // Every truncation is rejected.
        for end in 0..ours.len() {
            assert!(
                cdr::from_bytes::<M>(&ours[..end]).is_err(),
                "{name} cut to {end} of {}",
                ours.len()
            );
        }
    }
    rows.len()
}

#[test]
fn every_type_equals_rosbags_and_cyclonedds() {
    let mut compared = 0;
    let mut types = 0;
    macro_rules! all {
        ($($message:ty,)*) => { $( compared += check::<$message>(); types += 1; )* }
    }
    volant_msgs::for_each_type!(all);
    assert_eq!(compared, GOLDEN.len(), "each golden value belongs to a type");
    assert_eq!(GOLDEN.len(), 2 * types, "each type has two golden values; run make_golden_cdr.py");
}

#[test]
fn an_error_names_type_and_place() {
    let mut image = Image { data: vec![7; 12], ..Image::default() };
    image.encoding = "rgb8".into();
    let good = cdr::to_bytes(&image);
    // Claim four billion bytes of pixels.
    let at = good.len() - 12 - 4;
    let mut bad = good.clone();
    bad[at..at + 4].copy_from_slice(&[0xff; 4]);
    let said = cdr::from_bytes::<Image>(&bad).unwrap_err().to_string();
    assert!(said.starts_with("the bytes are no sensor_msgs/msg/Image"), "{said}");
    assert!(said.contains(&format!("byte {} of {}", at + 4, bad.len())), "{said}");

    let mut xcdr2 = good.clone();
    xcdr2[1] = 7;
    for header in [&xcdr2[..], &[]] {
        let said = cdr::from_bytes::<Image>(header).unwrap_err().to_string();
        assert!(said.contains("not plain CDR"), "{said}");
    }
    let imu = cdr::to_bytes(&Imu::default());
    let said = cdr::from_bytes::<Header>(&imu).unwrap_err().to_string();
    assert!(said.contains("bytes remain after the last field"), "{said}");

    let three = ParameterDescriptor {
        integer_range: vec![Default::default(); 3],
        ..ParameterDescriptor::default()
    };
    let said = cdr::from_bytes::<ParameterDescriptor>(&cdr::to_bytes(&three)).unwrap_err();
    let expected = "rcl_interfaces/msg/ParameterDescriptor: a sequence of 3 elements, more than \
                    its bound of 1";
    assert!(said.to_string().contains(expected), "{said}");
}
