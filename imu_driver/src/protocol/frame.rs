//! Frames `FA | BID | MID | LEN | [EXTLEN if LEN = FF] | data | checksum` in a stream of bytes.
//!
//! The frames found do not depend on how the bytes are chunked. After an invalid frame the search
//! continues **one** byte after its preamble, so that a valid frame inside it is found. The buffer
//! does not grow; no frame allocates. No input can cause a panic: all slices are checked.

use super::message::MessageId;

/// First byte of every frame.
const PREAMBLE: u8 = 0xFA;
/// Bus identifier of the master, and of the data of a stand-alone device.
const BUS_MASTER: u8 = 0xFF;
/// Bus identifier that also addresses a stand-alone device.
const BUS_STANDALONE: u8 = 0x01;
/// Largest length of data, bytes: 2048 in the manual, 8192 in the vendor's legacy library.
pub const MAX_DATA: usize = 8192;
/// Largest overhead of a frame, bytes: preamble, BID, MID, LEN, EXTLEN, checksum.
const MAX_OVERHEAD: usize = 7;

/// An incomplete frame, and as many bytes after it as are buffered at a time.
const CAPACITY: usize = 2 * (MAX_DATA + MAX_OVERHEAD);

/// A frame with a valid checksum, borrowed from the parser's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Message identifier.
    pub message: MessageId,
    /// Data of the message.
    pub data: &'a [u8],
    /// Length on the wire, bytes, from preamble to checksum.
    pub wire_length: usize,
    /// Position of the preamble in the stream, bytes since the parser was created.
    pub offset: u64,
}

/// Counts of a [`FrameParser`]; `frame_bytes + skipped_bytes` is the number of parsed bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ParserCounts {
    /// Frames with a valid checksum.
    pub frames: u64,
    /// Frames with an invalid checksum.
    pub bad_checksums: u64,
    /// Bytes of valid frames.
    pub frame_bytes: u64,
    /// Bytes outside valid frames.
    pub skipped_bytes: u64,
}

/// Finds frames in a stream of bytes.
#[derive(Clone, Debug, Default)]
pub struct FrameParser {
    buffer: Vec<u8>,
    /// Number of bytes at its front that are parsed.
    start: usize,
    counts: ParserCounts,
}

enum Step {
    Frame { message: u8, data: (usize, usize), length: usize },
    Invalid { bad_checksum: bool },
    NeedMore,
}

impl FrameParser {
    /// Creates an empty parser with its buffer, the only allocation.
    pub fn new() -> Self {
        Self { buffer: Vec::with_capacity(CAPACITY), ..Self::default() }
    }

    /// Returns the next frame at the end of a stream: searches inside an incomplete one.
    pub fn next_frame_at_end(&mut self) -> Option<Frame<'_>> {
        self.advance(true)
    }

    /// Calls `handle` with every frame that is complete with `bytes`, which may be empty.
    pub fn parse(&mut self, bytes: &[u8], mut handle: impl FnMut(Frame<'_>)) {
        let mut parts = bytes.chunks(CAPACITY / 2);
        loop {
            while let Some(frame) = self.advance(false) {
                handle(frame);
            }
            let Some(part) = parts.next() else { return };
            self.buffer.drain(..self.start);
            self.start = 0;
            self.buffer.extend_from_slice(part);
        }
    }

    /// Discards the first byte of an incomplete frame that timed out, so that the search continues.
    pub fn give_up_candidate(&mut self) {
        self.skip(self.pending().min(1));
    }

    /// Discards the buffered bytes before another stream starts; they count as skipped.
    pub fn reset(&mut self) {
        self.skip(self.pending());
    }

    /// Number of buffered bytes of an incomplete frame.
    pub fn pending(&self) -> usize {
        self.buffer.len() - self.start
    }

    /// Number of bytes pushed since the parser was created.
    pub fn pushed(&self) -> u64 {
        self.counts.frame_bytes + self.counts.skipped_bytes + self.pending() as u64
    }

    /// Counts since the parser was created.
    pub fn counts(&self) -> ParserCounts {
        self.counts
    }

    fn skip(&mut self, n: usize) {
        self.start += n;
        self.counts.skipped_bytes += n as u64;
    }

    fn advance(&mut self, at_end: bool) -> Option<Frame<'_>> {
        loop {
            let waiting = self.buffer.get(self.start..)?;
            if waiting.first() != Some(&PREAMBLE) {
                let garbage = waiting.iter().position(|&b| b == PREAMBLE).unwrap_or(waiting.len());
                self.skip(garbage);
                if self.pending() == 0 {
                    return None;
                }
                continue;
            }
            match examine(waiting) {
                Step::Frame { message, data: (from, to), length } => {
                    let base = self.start;
                    let offset = self.counts.frame_bytes + self.counts.skipped_bytes;
                    self.start += length;
                    self.counts.frames += 1;
                    self.counts.frame_bytes += length as u64;
                    let data = self.buffer.get(base + from..base + to)?;
                    let message = MessageId(message);
                    return Some(Frame { message, data, wire_length: length, offset });
                }
                Step::Invalid { bad_checksum } => {
                    self.counts.bad_checksums += u64::from(bad_checksum);
                    self.skip(1);
                }
                Step::NeedMore if at_end => self.skip(1),
                Step::NeedMore => return None,
            }
        }
    }
}

/// Examines bytes that start with a preamble.
#[inline]
fn examine(bytes: &[u8]) -> Step {
    let invalid = Step::Invalid { bad_checksum: false };
    match bytes.get(1) {
        None => return Step::NeedMore,
        Some(&(BUS_MASTER | BUS_STANDALONE)) => {}
        Some(_) => return invalid,
    }
    let &[_, _, message, short_length, ..] = bytes else {
        return Step::NeedMore;
    };
    let (header, data_length) = if short_length == 0xFF {
        let (Some(&high), Some(&low)) = (bytes.get(4), bytes.get(5)) else {
            return Step::NeedMore;
        };
        (6, usize::from(u16::from_be_bytes([high, low])))
    } else {
        (4, usize::from(short_length))
    };
    if data_length > MAX_DATA {
        return invalid;
    }
    let length = header + data_length + 1;
    let Some(checked) = bytes.get(1..length) else {
        return Step::NeedMore;
    };
    if checked.iter().fold(0_u8, |sum, &b| sum.wrapping_add(b)) != 0 {
        return Step::Invalid { bad_checksum: true };
    }
    Step::Frame { message, data: (header, header + data_length), length }
}

/// Returns a frame from the master, or from a stand-alone device.
///
/// Data beyond [`MAX_DATA`] are truncated.
pub fn frame(message: MessageId, data: &[u8]) -> Vec<u8> {
    let data = data.get(..MAX_DATA).unwrap_or(data);
    let mut out = Vec::with_capacity(data.len() + MAX_OVERHEAD);
    out.extend_from_slice(&[PREAMBLE, BUS_MASTER, message.0]);
    match u8::try_from(data.len()) {
        Ok(length) if length < 0xFF => out.push(length),
        _ => {
            out.push(0xFF);
            out.extend_from_slice(&(data.len() as u16).to_be_bytes());
        }
    }
    out.extend_from_slice(data);
    let sum = out.iter().skip(1).fold(0_u8, |sum, &b| sum.wrapping_add(b));
    out.push(sum.wrapping_neg());
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(parser: &mut FrameParser, bytes: &[u8]) -> Vec<(u8, Vec<u8>)> {
        let mut found = Vec::new();
        parser.parse(bytes, |f| found.push((f.message.0, f.data.to_vec())));
        found
    }

    #[test]
    fn frames_equal_those_of_the_manual() {
        assert_eq!(frame(MessageId::GO_TO_CONFIG, &[]), [0xFA, 0xFF, 0x30, 0x00, 0xD1]);
        assert_eq!(frame(MessageId::GO_TO_CONFIG.ack(), &[]), [0xFA, 0xFF, 0x31, 0x00, 0xD0]);
        assert_eq!(frame(MessageId::GO_TO_MEASUREMENT, &[]), [0xFA, 0xFF, 0x10, 0x00, 0xF1]);
    }

    #[test]
    fn a_valid_frame_inside_an_invalid_one_is_found() {
        let mut parser = FrameParser::new();
        // The invalid header claims eight bytes of data: a valid frame and three more bytes.
        let mut bytes = vec![0x00, 0xFA, 0xFA, 0xFF, 0x32, 0x08];
        bytes.extend(frame(MessageId::GO_TO_CONFIG.ack(), &[]));
        bytes.extend([1, 2, 3, 0xEE]);
        assert_eq!(frames(&mut parser, &bytes), [(0x31, vec![])]);
        assert_eq!(parser.counts().bad_checksums, 1);
        assert_eq!(parser.counts().skipped_bytes + parser.counts().frame_bytes, bytes.len() as u64);
    }

    #[test]
    fn frames_of_any_length_and_inside_a_truncated_one_are_found() {
        let mut parser = FrameParser::new();
        for length in [0, 1, 253, 254, 255, 256, 2048, MAX_DATA] {
            let data: Vec<u8> = (0..length).map(|i| (i * 7) as u8).collect();
            assert_eq!(frames(&mut parser, &frame(MessageId::MT_DATA, &data)), [(0x32, data)]);
        }
        // A log that ends inside a frame with a complete one in its data.
        let mut cut = vec![0xFA, 0xFF, 0x32, 0x40];
        cut.extend(frame(MessageId::GO_TO_CONFIG.ack(), &[]));
        assert_eq!(frames(&mut parser, &cut), []);
        let inside = parser.next_frame_at_end().map(|f| f.message);
        assert_eq!(inside, Some(MessageId::GO_TO_CONFIG.ack()));
        assert_eq!(parser.next_frame_at_end(), None);
        assert_eq!(parser.pending(), 0);
    }

    #[test]
    fn reset_discards_buffered_bytes() {
        let whole = frame(MessageId::MT_DATA, &[1, 2, 3, 4]);
        let mut parser = FrameParser::new();
        assert_eq!(frames(&mut parser, &whole[..5]), []);
        parser.reset();
        assert_eq!(frames(&mut parser, &whole[5..]), []);
        assert_eq!(frames(&mut parser, &whole), [(0x32, vec![1, 2, 3, 4])]);
    }
}
