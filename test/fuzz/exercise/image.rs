//! Images: JPEG and PNG, and raw ones whose fields may contradict each other.

use marker_tracker::{ImageView, OwnedImage, decode_compressed_into, from_encoding};
use rig_model::Stamp;
use std::cell::RefCell;

pub const WORDS: &[&[u8]] = &[
    b"\xFF\xD8\xFF",
    b"\xFF\xC0",
    b"\xFF\xC2",
    b"\xFF\xC4",
    b"\xFF\xDB",
    b"\xFF\xDA",
    b"\xFF\xDD",
    b"\xFF\xD9",
    b"\xFF\xE0",
    b"\xFF\xE2",
    b"\xFF\xEE",
    b"IHDR",
    b"IDAT",
    b"PLTE",
    b"tRNS",
    b"iCCP",
    b"iTXt",
    b"acTL",
    b"fcTL",
    b"fdAT",
    b"IEND",
    b"\x89PNG\r\n\x1A\n",
];

const ENCODINGS: [&str; 16] = [
    "rgb8",
    "bgr8",
    "rgba8",
    "bgra8",
    "8UC3",
    "8UC4",
    "mono8",
    "16UC1",
    "bayer_rggb8",
    "bayer_grbg16",
    "yuv422",
    "yuyv",
    "yuv422_yuy2",
    "uyvy",
    "",
    "nv12",
];

thread_local! {
    static IMAGE: RefCell<OwnedImage> = RefCell::default();
}

/// An image of more pixels than this is decoded in one of [`SELDOM`] inputs: it costs as much as a
/// thousand small ones and differs from them only in its declared size, which is checked before.
const MANY_PIXELS: u64 = 1 << 14;
const SELDOM: usize = 64;

pub fn run(data: &[u8]) {
    let sum = data
        .iter()
        .fold(0_usize, |sum, byte| sum.wrapping_mul(31).wrapping_add(usize::from(*byte)));
    if claimed(data) > MANY_PIXELS && sum % SELDOM != 0 {
        raw(data);
        return;
    }
    decode(data);
    let mut repaired = data.to_vec();
    if with_right_checksums(&mut repaired) {
        decode(&repaired);
    }
    raw(data);
}

fn decode(data: &[u8]) {
    IMAGE.with_borrow_mut(|image| {
        // What a large image left must not hide that a small one takes too little.
        if image.data.len() > 1 << 22 {
            *image = OwnedImage::default();
        }
        if decode_compressed_into("fuzzed", data, image).is_ok() {
            image.view(Stamp::default()).check().expect("a decoded image with a consistent size");
            assert!(image.width * image.height <= ImageView::MAX_PIXELS);
            // Three or four bytes per pixel.
            assert!(
                image.data.len() <= 4 * (2048 * data.len() + (1 << 16)),
                "{} of {}",
                image.data.len(),
                data.len()
            );
        }
    });
}

/// Pixels that the headers claim, at most.
fn claimed(data: &[u8]) -> u64 {
    let number = |bytes: &[u8]| bytes.iter().fold(0, |n, b| n << 8 | u64::from(*b));
    if let Some(header) = data.strip_prefix(b"\x89PNG\r\n\x1A\n").and_then(|rest| rest.get(8..16)) {
        return number(&header[..4]).saturating_mul(number(&header[4..]));
    }
    let frames =
        data.windows(9).filter(|w| w[0] == 0xFF && (0xC0..=0xCF).contains(&w[1]) && w[1] != 0xC4);
    frames.map(|w| number(&w[5..7]) * number(&w[7..9])).max().unwrap_or(0)
}

/// A raw image whose fields are the first bytes.
fn raw(data: &[u8]) {
    let Some((&[encoding, big, w0, w1, h0, h1, s0, s1, scale], pixels)) =
        data.split_first_chunk::<9>()
    else {
        return;
    };
    // Small numbers, and ones whose product does not fit.
    let scaled = |a: u8, b: u8| usize::from(u16::from_le_bytes([a, b])) << (scale % 48);
    let (width, height, step) = (scaled(w0, w1), scaled(h0, h1), scaled(s0, s1));
    let encoding = ENCODINGS[usize::from(encoding) % ENCODINGS.len()];
    let mut scratch = OwnedImage::default();
    let at = Stamp::default();
    if let Ok(view) =
        from_encoding(at, width, height, encoding, big & 1 == 1, step, pixels, &mut scratch)
    {
        view.check().expect("a raw image with a consistent size");
        assert_eq!((view.width, view.height), (width, height));
    }
}

/// Gives each chunk of a PNG its right checksum; whether it is one.
fn with_right_checksums(data: &mut [u8]) -> bool {
    if !data.starts_with(b"\x89PNG\r\n\x1A\n") {
        return false;
    }
    let mut at = 8;
    while let Some(length) = data.get(at..at + 4) {
        let length = length.iter().fold(0_usize, |n, b| n << 8 | usize::from(*b));
        let Some(end) = (at + 8).checked_add(length).filter(|end| end + 4 <= data.len()) else {
            break;
        };
        let crc = crc32(&data[at + 4..end]);
        data[end..end + 4].copy_from_slice(&crc.to_be_bytes());
        at = end + 4;
    }
    true
}

pub fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |mut crc, byte| {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = (crc >> 1) ^ (0xEDB8_8320 & (crc & 1).wrapping_neg());
        }
        crc
    })
}

fn chunk(out: &mut Vec<u8>, name: &[u8; 4], body: &[u8]) {
    out.extend((body.len() as u32).to_be_bytes());
    let from = out.len();
    out.extend(name);
    out.extend(body);
    let crc = crc32(&out[from..]);
    out.extend(crc.to_be_bytes());
}

/// A PNG of that size whose pixels are stored without compression, or as few of them as `most`
/// bytes hold.
pub fn png(width: u32, height: u32, color: u8, depth: u8, most: usize) -> Vec<u8> {
    let mut out = b"\x89PNG\r\n\x1A\n".to_vec();
    let mut header = vec![];
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend([depth, color, 0, 0, 0]);
    chunk(&mut out, b"IHDR", &header);
    if color == 3 {
        chunk(&mut out, b"PLTE", &[255, 0, 0, 0, 255, 0, 0, 0, 255]);
    }
    let channels = match color {
        2 => 3,
        6 => 4,
        4 => 2,
        _ => 1,
    };
    let row = 1 + (width as usize * channels * usize::from(depth)).div_ceil(8);
    let size = (row.saturating_mul(height as usize)).min(most).min(65_535);
    // zlib with one stored block; the row's first byte is its filter.
    let mut body = vec![0x78, 0x01, 0x01];
    body.extend((size as u16).to_le_bytes());
    body.extend((!(size as u16)).to_le_bytes());
    let pixels: Vec<u8> =
        (0..size).map(|k| if k % row == 0 { (k / row % 5) as u8 } else { (k * 7) as u8 }).collect();
    body.extend(&pixels);
    let (a, b) = pixels.iter().fold((1_u32, 0_u32), |(a, b), p| {
        ((a + u32::from(*p)) % 65_521, (b + a + u32::from(*p)) % 65_521)
    });
    body.extend((b << 16 | a).to_be_bytes());
    chunk(&mut out, b"IDAT", &body);
    chunk(&mut out, b"IEND", &[]);
    out
}

/// The headers of a JPEG of that size, without image data.
pub fn jpeg_headers(width: u16, height: u16, progressive: bool) -> Vec<u8> {
    let mut out = vec![0xFF, 0xD8];
    out.extend([0xFF, 0xDB, 0, 67, 0]);
    out.extend([1; 64]);
    out.extend([0xFF, if progressive { 0xC2 } else { 0xC0 }, 0, 17, 8]);
    out.extend(height.to_be_bytes());
    out.extend(width.to_be_bytes());
    out.extend([3, 1, 0x22, 0, 2, 0x11, 0, 3, 0x11, 0]);
    for table in [0x00, 0x10] {
        out.extend([0xFF, 0xC4, 0, 20, table, 1]);
        out.extend([0; 15]);
        out.push(0);
    }
    out.extend([0xFF, 0xDA, 0, 12, 3, 1, 0, 2, 0, 3, 0, 0, if progressive { 0 } else { 63 }, 0]);
    out.extend([0; 16]);
    out.extend([0xFF, 0xD9]);
    out
}

pub fn seeds() -> Vec<Vec<u8>> {
    use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
    let (width, height) = (24_u16, 17_u16);
    let pixels: Vec<u8> =
        (0..usize::from(width) * usize::from(height) * 3).map(|k| (k * k / 7) as u8).collect();
    let mut seeds = vec![];
    for (progressive, sampling, optimized) in [
        (false, SamplingFactor::R_4_2_0, false),
        (false, SamplingFactor::R_4_4_4, true),
        (true, SamplingFactor::R_4_2_2, true),
    ] {
        let mut jpeg = vec![];
        let mut encoder = Encoder::new(&mut jpeg, 60);
        encoder.set_progressive(progressive);
        encoder.set_optimized_huffman_tables(optimized);
        encoder.set_sampling_factor(sampling);
        encoder.set_restart_interval(if optimized { 0 } else { 2 });
        encoder.encode(&pixels, width, height, ColorType::Rgb).expect("an image");
        seeds.push(jpeg);
    }
    for (color, depth) in [(2, 8), (6, 8), (2, 16), (3, 2), (0, 8), (4, 8)] {
        seeds.push(png(13, 7, color, depth, usize::MAX));
    }
    seeds.push(jpeg_headers(640, 480, false));
    seeds.push(jpeg_headers(64, 48, true));
    for (k, _) in ENCODINGS.iter().enumerate() {
        let mut raw = vec![k as u8, 0, 8, 0, 6, 0, 32, 0, 0];
        raw.extend([k as u8 * 5; 32 * 6]);
        seeds.push(raw);
    }
    seeds
}
