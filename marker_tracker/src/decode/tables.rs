//! Huffman tables of JPEGs that have none.
//!
//! Motion JPEG may leave out the tables and means those of ITU-T T.81, annex K.3.3. The decoder
//! assumes them only where the segment `AVI1` is present, which many cameras do not send.

use std::borrow::Cow;

/// Segment with the tables K.3 (DC, luma), K.5 (AC, luma), K.4 (DC, chroma) and K.6 (AC, chroma).
const STANDARD: &[u8; 420] = b"\
    \xff\xc4\x01\xa2\0\0\x01\x05\x01\x01\x01\x01\x01\x01\0\0\0\0\0\0\0\0\x01\x02\x03\x04\x05\x06\
    \x07\x08\t\n\x0b\x10\0\x02\x01\x03\x03\x02\x04\x03\x05\x05\x04\x04\0\0\x01}\x01\x02\x03\0\x04\
    \x11\x05\x12!1A\x06\x13Qa\x07\"q\x142\x81\x91\xa1\x08#B\xb1\xc1\x15R\xd1\xf0$3br\x82\t\n\x16\
    \x17\x18\x19\x1a%&'()*456789:CDEFGHIJSTUVWXYZcdefghijstuvwxyz\x83\x84\x85\x86\x87\x88\x89\x8a\
    \x92\x93\x94\x95\x96\x97\x98\x99\x9a\xa2\xa3\xa4\xa5\xa6\xa7\xa8\xa9\xaa\xb2\xb3\xb4\xb5\xb6\
    \xb7\xb8\xb9\xba\xc2\xc3\xc4\xc5\xc6\xc7\xc8\xc9\xca\xd2\xd3\xd4\xd5\xd6\xd7\xd8\xd9\xda\xe1\
    \xe2\xe3\xe4\xe5\xe6\xe7\xe8\xe9\xea\xf1\xf2\xf3\xf4\xf5\xf6\xf7\xf8\xf9\xfa\x01\0\x03\x01\x01\
    \x01\x01\x01\x01\x01\x01\x01\0\0\0\0\0\0\x01\x02\x03\x04\x05\x06\x07\x08\t\n\x0b\x11\0\x02\x01\
    \x02\x04\x04\x03\x04\x07\x05\x04\x04\0\x01\x02w\0\x01\x02\x03\x11\x04\x05!1\x06\x12AQ\x07aq\
    \x13\"2\x81\x08\x14B\x91\xa1\xb1\xc1\t#3R\xf0\x15br\xd1\n\x16$4\xe1%\xf1\x17\x18\x19\x1a&'()*5\
    6789:CDEFGHIJSTUVWXYZcdefghijstuvwxyz\x82\x83\x84\x85\x86\x87\x88\x89\x8a\x92\x93\x94\x95\x96\
    \x97\x98\x99\x9a\xa2\xa3\xa4\xa5\xa6\xa7\xa8\xa9\xaa\xb2\xb3\xb4\xb5\xb6\xb7\xb8\xb9\xba\xc2\
    \xc3\xc4\xc5\xc6\xc7\xc8\xc9\xca\xd2\xd3\xd4\xd5\xd6\xd7\xd8\xd9\xda\xe2\xe3\xe4\xe5\xe6\xe7\
    \xe8\xe9\xea\xf2\xf3\xf4\xf5\xf6\xf7\xf8\xf9\xfa";

/// The image with the standard tables before its first scan, where it is a baseline JPEG without
/// any table.
pub(super) fn with_tables(jpeg: &[u8]) -> Cow<'_, [u8]> {
    match place_without_tables(jpeg) {
        Some(at) => Cow::Owned([&jpeg[..at], STANDARD, &jpeg[at..]].concat()),
        None => Cow::Borrowed(jpeg),
    }
}

/// Where the first scan starts, without a table before it; `None` for any other image.
fn place_without_tables(jpeg: &[u8]) -> Option<usize> {
    let (mut at, mut is_baseline) = (2, false);
    loop {
        let &[0xff, marker, high, low] = jpeg.get(at..at + 4)? else { return None };
        match marker {
            0xc0 => is_baseline = true,
            0xc4 => return None,
            0xda => return is_baseline.then_some(at),
            _ => {}
        }
        at += 2 + usize::from(u16::from_be_bytes([high, low]));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        decode::{
            decode_compressed,
            fixtures::{assert_same, encoded},
            jpeg::WindowDecoder,
        },
        image::OwnedImage,
    };

    /// The image without its tables.
    fn without_tables(jpeg: &[u8]) -> Vec<u8> {
        let (mut bare, mut at) = (jpeg[..2].to_vec(), 2);
        while jpeg[at + 1] != 0xda {
            let end = at + 2 + usize::from(u16::from_be_bytes([jpeg[at + 2], jpeg[at + 3]]));
            if jpeg[at + 1] != 0xc4 {
                bare.extend_from_slice(&jpeg[at..end]);
            }
            at = end;
        }
        bare.extend_from_slice(&jpeg[at..]);
        bare
    }

    #[test]
    fn a_motion_jpeg_without_tables_is_decoded_as_the_same_image_with_them() {
        let jpeg = encoded(64, 48, |_| {});
        let bare = without_tables(&jpeg);
        assert!(bare.len() < jpeg.len());
        let whole = decode_compressed("jpeg", &jpeg).unwrap();
        assert_eq!(decode_compressed("jpeg", &bare).unwrap(), whole);
        let (mut windows, mut image) = (WindowDecoder::default(), OwnedImage::default());
        let exact = windows.decode(&bare, &[[8, 8, 30, 30], [0; 4], [0; 4], [0; 4]], &mut image);
        assert_same(&image, &whole, exact.unwrap().unwrap()[0], "without tables");
    }

    #[test]
    fn other_images_are_left_as_they_are() {
        let jpeg = encoded(64, 48, |_| {});
        assert_eq!(*with_tables(&jpeg), *jpeg);
        let progressive = without_tables(&encoded(64, 48, |e| e.set_progressive(true)));
        assert_eq!(*with_tables(&progressive), *progressive);
        for cut in [2, 5, 30] {
            assert_eq!(*with_tables(&jpeg[..cut]), jpeg[..cut]);
        }
    }
}
