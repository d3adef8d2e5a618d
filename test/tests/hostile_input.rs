//! Random bytes through every parser of external data: a few seconds of what `make fuzz` does
//! without a limit. And the cost of a small input: a declared size is rejected before memory is
//! allocated for it.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(clippy::disallowed_methods, reason = "a test that measures time")]

#[path = "../fuzz/exercise/mod.rs"]
mod exercise;

use bag::BagReader;
use exercise::{
    TARGETS, image,
    mutate::{Random, mutate},
};
use marker_tracker::{ImageError, decode_compressed};
use std::{
    io::Cursor,
    path::Path,
    time::{Duration, Instant},
};

/// Longest time for one input; usual are microseconds.
const LONGEST: Duration = Duration::from_secs(10);

/// Result of some work, and the most memory that it had at one time, bytes.
fn most_memory<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let mut result = None;
    let most = allocation_counter::measure(|| result = Some(work())).bytes_max;
    (result.unwrap(), most)
}

/// A bag of these bytes, read to its end, and the number of its messages.
fn read_bag(bytes: Vec<u8>) -> (BagReader, usize) {
    let mut bag = BagReader::from_reader(Path::new("x.mcap"), Cursor::new(bytes)).unwrap();
    let messages = std::iter::from_fn(|| bag.next_message().unwrap()).count();
    (bag, messages)
}

/// A bag with this chunk.
fn with_chunk(body: &[u8]) -> Vec<u8> {
    [&b"\x89MCAP0\r\n\x06"[..], &(body.len() as u64).to_le_bytes(), body].concat()
}

fn run(name: &str) {
    let target = TARGETS.iter().find(|t| t.name == name).unwrap();
    let seeds = (target.seeds)();
    for seed in &seeds {
        (target.run)(seed);
    }
    let mut random = Random(0x9E37_79B9_7F4A_7C15);
    let mut input = Vec::new();
    let inputs = std::env::var("VOLANT_HOSTILE_INPUTS");
    for number in 0..inputs.map_or(50_000_u64, |text| text.parse().unwrap()) {
        mutate(&seeds, target.words, &mut random, &mut input);
        let start = Instant::now();
        let ((), most) = most_memory(|| (target.run)(&input));
        let time = start.elapsed();
        // An image's pixels and a chunk decompressed are the most there is; lengths that are
        // claimed are none.
        assert!(most < 64 << 20 && time < LONGEST, "{name}, {number}: {most} bytes, {time:?}");
    }
}

macro_rules! tests {
    ($($name:ident: $target:literal,)*) => {
        $(#[test]
        fn $name() {
            run($target);
        })*
    };
}

tests!(
    messages: "cdr",
    parameter_files_and_the_rig: "parameters",
    calibration_files: "calibration",
    bag_metadata: "metadata",
    images: "image",
    bags: "bag",
    streams_of_the_imu: "stream",
    logs_of_the_imu: "log",
    conversations_with_the_imu: "driver",
);

#[test]
fn the_seeds_are_valid_inputs() {
    // Without this the runs above could be shut out at the first check.
    for seed in exercise::yaml::parameter_seeds() {
        ros_parameters::ParameterFile::parse(std::str::from_utf8(&seed).unwrap()).unwrap();
    }
    for seed in exercise::yaml::calibration_seeds() {
        rig_model::CameraModel::from_calibration_file(std::str::from_utf8(&seed).unwrap()).unwrap();
    }
    for seed in &exercise::yaml::metadata_seeds()[..2] {
        bag::files_named_by(std::str::from_utf8(seed).unwrap()).unwrap();
    }
    let decoded = image::seeds().iter().filter(|s| decode_compressed("", s).is_ok()).count();
    // Three JPEGs, one of headers only, and the PNGs with colors.
    assert_eq!(decoded, 3 + 1 + 4);
    for seed in exercise::bag::seeds() {
        let (bag, messages) = read_bag(seed);
        assert!(messages == 6 || messages == 1, "{messages}");
        assert!(bag.losses().is_empty(), "{:?}", bag.losses());
    }
    let seeds = exercise::imu::seeds();
    let frames: u64 = seeds[..10].iter().map(|seed| exercise::imu::stream(seed)).sum();
    assert_eq!(frames, 6 * 3 + 4 * 2);
    assert_eq!(exercise::imu::driver(&seeds[10]), 3);
}

#[test]
fn a_small_image_that_declares_a_huge_size_is_rejected_without_allocation() {
    let huge = u32::from(u16::MAX);
    let mut claims = vec![
        ("jpeg 65535", image::jpeg_headers(65_535, 65_535, false)),
        ("jpeg 65535 progressive", image::jpeg_headers(65_535, 65_535, true)),
        // Within the largest side, and far beyond what its bytes can hold.
        ("jpeg 8000x4000", image::jpeg_headers(8000, 4000, false)),
        ("jpeg 16384 x 16384", image::jpeg_headers(16_384, 16_384, true)),
        ("jpeg 65535 x 1", image::jpeg_headers(65_535, 1, false)),
    ];
    for (color, depth) in [(2, 8), (6, 16), (3, 1)] {
        claims.push(("png 65535", image::png(huge, huge, color, depth, 100)));
        claims.push(("png 8000x4000", image::png(8000, 4000, color, depth, 100)));
        claims.push((
            "png of 2^31 px",
            image::png(i32::MAX as u32, i32::MAX as u32, color, depth, 100),
        ));
        claims.push(("png of 2^31 columns", image::png(i32::MAX as u32, 1, color, depth, 100)));
    }
    for (what, data) in claims {
        let (result, most) = most_memory(|| decode_compressed("", &data));
        let error = result.unwrap_err();
        assert!(
            matches!(error, ImageError::TooLarge { .. } | ImageError::Decode { .. }),
            "{what}: {error}"
        );
        assert!(most < 1 << 20, "{what}: {most} bytes for {}", data.len());
    }
}

#[test]
fn a_jpeg_with_any_sampling_factors_is_decoded_or_rejected() {
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
    let across_down = [1_u8, 2, 4].into_iter().flat_map(|a| (1..=4).map(move |d| a << 4 | d));
    let factors: Vec<u8> = across_down.collect();
    let mut images = 0;
    for ((width, height), progressive) in [(24, 17), (33, 40), (17, 3), (8, 8)]
        .into_iter()
        .flat_map(|size| [(size, false), (size, true)])
    {
        let pixels: Vec<u8> = (0..width * height * 3).map(|i| (i * 7919 % 251) as u8).collect();
        let mut jpeg = vec![];
        let mut encoder = Encoder::new(&mut jpeg, 90);
        encoder.set_sampling_factor(SamplingFactor::R_4_4_4);
        encoder.set_progressive(progressive);
        encoder.encode(&pixels, width as u16, height as u16, ColorType::Rgb).unwrap();
        let start_of_frame = [0xff, if progressive { 0xc2 } else { 0xc0 }, 0, 17, 8];
        let at = jpeg.windows(5).position(|bytes| bytes == start_of_frame).unwrap();
        for (luma, blue, red) in factors.iter().flat_map(|l| {
            let factors = &factors;
            factors.iter().flat_map(move |b| factors.iter().map(move |r| (*l, *b, *r)))
        }) {
            for (i, value) in [luma, blue, red].into_iter().enumerate() {
                jpeg[at + 11 + 3 * i] = value;
            }
            let finer = |c: u8| c >> 4 > luma >> 4 || c & 15 > luma & 15;
            match decode_compressed("jpeg", &jpeg) {
                Ok(_) => {
                    assert!(!finer(blue) && !finer(red), "{luma:#x} {blue:#x} {red:#x}");
                    images += 1;
                }
                Err(error) => assert!(
                    !(finer(blue) || finer(red)) || error.to_string().contains("finer"),
                    "{luma:#x} {blue:#x} {red:#x}: {error}"
                ),
            }
        }
    }
    assert!(images > 100, "{images}");
}

#[test]
fn lengths_beyond_the_input_allocate_nothing() {
    use volant_msgs::{cdr, sensor_msgs::msg::Image, tf2_msgs::msg::TFMessage};
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend(u32::MAX.to_le_bytes());
    bytes.extend([0; 100]);
    let (result, most) = most_memory(|| cdr::from_bytes::<TFMessage>(&bytes));
    assert!(result.is_err() && most < 1 << 16, "{most}");
    let mut image = cdr::to_bytes(&Image { data: vec![0; 8], ..Image::default() });
    let at = image.len() - 12;
    image[at..at + 4].copy_from_slice(&0x7FFF_FFFF_u32.to_le_bytes());
    let (result, most) = most_memory(|| cdr::from_bytes::<Image>(&image));
    assert!(result.is_err() && most < 1 << 16, "{most}");
}

/// Found by the fuzzer: arithmetic below zero in the `mcap` crate.
#[test]
fn a_record_longer_than_its_chunk_is_damage() {
    let mut records = vec![3];
    records.extend(200_u64.to_le_bytes());
    records.extend([0; 40]);
    let mut body = vec![0; 16];
    body.extend((records.len() as u64).to_le_bytes());
    body.extend([0; 8]);
    body.extend((records.len() as u64).to_le_bytes());
    body.extend(&records);
    // What follows the chunk's records would do for the rest.
    body.extend([0; 300]);
    let (bag, messages) = read_bag(with_chunk(&body));
    assert_eq!(messages, 0);
    assert!(bag.losses()[0].contains("longer than the chunk"), "{:?}", bag.losses());
}

#[test]
fn a_chunk_that_decompresses_without_end_is_rejected() {
    // A chunk that claims 2 GiB, in all three forms of compression, and with and without a
    // checksum.
    for compression in ["", "lz4", "zstd"] {
        for crc in [0_u32, 7] {
            let mut body = vec![0; 16];
            body.extend((2_u64 << 30).to_le_bytes());
            body.extend(crc.to_le_bytes());
            body.extend((compression.len() as u32).to_le_bytes());
            body.extend(compression.as_bytes());
            body.extend(16_u64.to_le_bytes());
            body.extend([0; 16]);
            let file = with_chunk(&body);
            let ((bag, _), most) = most_memory(|| read_bag(file));
            assert!(!bag.losses().is_empty());
            assert!(most < 8 << 20, "{compression} {crc}: {most}");
        }
    }
}
