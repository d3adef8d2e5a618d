//! The frame: `FA | BID | MID | LEN | [EXTLEN if LEN = FF] | data | checksum`, found in a stream of bytes.
//!
//! In flow bytes in any portions; out flow whole frames with a right checksum, always the same ones for the same
//! bytes. After something that looked like a frame and was none the search goes on **one** byte further, so that a
//! true preamble inside it is not missed. The buffer is of a fixed size and no frame costs an allocation. All access
//! is by checked slices: no input makes it panic.

use super::message::MessageId;

/// First byte of every frame.
pub const PREAMBLE: u8 = 0xFA;
/// Bus identifier of the master, and of a stand-alone unit's data.
pub const BUS_MASTER: u8 = 0xFF;
/// Bus identifier that also addresses a stand-alone unit.
pub const BUS_STANDALONE: u8 = 0x01;
/// Longest data: the manual says 2048, the vendor's legacy library takes 8192.
pub const MAX_DATA: usize = 8192;
/// A frame's bytes that are not data, at most: preamble, BID, MID, LEN, EXTLEN, checksum.
pub const MAX_OVERHEAD: usize = 7;

const CAPACITY: usize = 2 * (MAX_DATA + MAX_OVERHEAD);

/// One frame whose checksum is right; it borrows the parser's buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// FF or 01.
    pub bus_id: u8,
    /// What kind of message it is.
    pub message: MessageId,
    /// Its data.
    pub data: &'a [u8],
    /// All its bytes on the wire, from the preamble to the checksum.
    pub wire_length: usize,
    /// Bytes of the stream before its preamble, counted since the parser was made.
    pub offset: u64,
}

/// What passed through a [`FrameParser`]. `frame_bytes + skipped_bytes` is all that was parsed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ParserCounts {
    /// Frames with a right checksum.
    pub frames: u64,
    /// Things that looked like a whole frame but for their checksum.
    pub bad_checksums: u64,
    /// Bytes of right frames.
    pub frame_bytes: u64,
    /// Bytes that belong to no right frame.
    pub skipped_bytes: u64,
}

/// Finds frames in a stream of bytes.
#[derive(Clone, Debug)]
pub struct FrameParser {
    buffer: Box<[u8]>,
    start: usize,
    end: usize,
    counts: ParserCounts,
}

impl Default for FrameParser {
    fn default() -> Self {
        Self::new()
    }
}

enum Step {
    Frame { bus_id: u8, message: u8, data: (usize, usize), length: usize },
    NotHere { bad_checksum: bool },
    NeedMore,
}

impl FrameParser {
    /// An empty parser; its buffer is the only thing it ever allocates.
    pub fn new() -> Self {
        Self {
            buffer: vec![0; CAPACITY].into_boxed_slice(),
            start: 0,
            end: 0,
            counts: ParserCounts::default(),
        }
    }

    /// Takes bytes from the front of `bytes` and says how many: all of them unless the buffer is full. Once
    /// [`FrameParser::next_frame`] has returned `None` there is room for more than 8 KiB.
    pub fn push(&mut self, bytes: &[u8]) -> usize {
        if self.start == self.end {
            (self.start, self.end) = (0, 0);
        } else if self.buffer.len() - self.end < bytes.len() {
            self.buffer.copy_within(self.start..self.end, 0);
            self.end -= self.start;
            self.start = 0;
        }
        let n = bytes.len().min(self.buffer.len() - self.end);
        if let (Some(to), Some(from)) = (self.buffer.get_mut(self.end..self.end + n), bytes.get(..n)) {
            to.copy_from_slice(from);
            self.end += n;
        }
        n
    }

    /// The next whole frame among the bytes pushed so far.
    pub fn next_frame(&mut self) -> Option<Frame<'_>> {
        self.advance(false)
    }

    /// Like [`FrameParser::next_frame`] where no further byte will come: a frame that was cut short is skipped, and
    /// what it seemed to contain is searched.
    pub fn next_frame_at_end(&mut self) -> Option<Frame<'_>> {
        self.advance(true)
    }

    /// Calls `take` with every frame that `bytes` completes.
    pub fn parse(&mut self, mut bytes: &[u8], mut take: impl FnMut(Frame<'_>)) {
        while !bytes.is_empty() {
            let n = self.push(bytes);
            bytes = bytes.get(n..).unwrap_or_default();
            while let Some(frame) = self.next_frame() {
                take(frame);
            }
        }
    }

    /// The frame that is being waited for is a false one (nothing that long can be on its way): search on one byte
    /// further. Returns false where nothing is waited for.
    pub fn give_up_candidate(&mut self) -> bool {
        if self.start == self.end {
            return false;
        }
        self.skip(1);
        true
    }

    /// Forgets what is buffered, so that nothing of an old stream is glued to a new one; the bytes count as skipped.
    pub fn reset(&mut self) {
        self.skip(self.end - self.start);
    }

    /// Bytes that wait for the rest of their frame.
    pub fn pending(&self) -> usize {
        self.end - self.start
    }

    /// Bytes that were pushed since the parser was made.
    pub fn pushed(&self) -> u64 {
        self.counts.frame_bytes + self.counts.skipped_bytes + self.pending() as u64
    }

    /// What passed so far.
    pub fn counts(&self) -> ParserCounts {
        self.counts
    }

    fn skip(&mut self, n: usize) {
        self.start += n;
        self.counts.skipped_bytes += n as u64;
    }

    fn advance(&mut self, at_end: bool) -> Option<Frame<'_>> {
        loop {
            let waiting = self.buffer.get(self.start..self.end)?;
            if waiting.first() != Some(&PREAMBLE) {
                let garbage = waiting.iter().position(|&b| b == PREAMBLE).unwrap_or(waiting.len());
                self.skip(garbage);
                if self.start == self.end {
                    return None;
                }
                continue;
            }
            match examine(waiting) {
                Step::Frame { bus_id, message, data: (from, to), length } => {
                    let base = self.start;
                    let offset = self.counts.frame_bytes + self.counts.skipped_bytes;
                    self.start += length;
                    self.counts.frames += 1;
                    self.counts.frame_bytes += length as u64;
                    let data = self.buffer.get(base + from..base + to)?;
                    let message = MessageId(message);
                    return Some(Frame { bus_id, message, data, wire_length: length, offset });
                }
                Step::NotHere { bad_checksum } => {
                    self.counts.bad_checksums += u64::from(bad_checksum);
                    self.skip(1);
                }
                Step::NeedMore if at_end => self.skip(1),
                Step::NeedMore => return None,
            }
        }
    }
}

/// What the bytes are, given that the first is a preamble.
#[inline]
fn examine(bytes: &[u8]) -> Step {
    let not_here = Step::NotHere { bad_checksum: false };
    match bytes.get(1) {
        None => return Step::NeedMore,
        Some(&(BUS_MASTER | BUS_STANDALONE)) => {}
        Some(_) => return not_here,
    }
    let &[_, bus_id, message, short_length, ..] = bytes else {
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
        return not_here;
    }
    let length = header + data_length + 1;
    let Some(summed) = bytes.get(1..length) else {
        return Step::NeedMore;
    };
    if summed.iter().fold(0_u8, |sum, &b| sum.wrapping_add(b)) != 0 {
        return Step::NotHere { bad_checksum: true };
    }
    Step::Frame { bus_id, message, data: (header, header + data_length), length }
}

/// Appends a frame to `out`, with the extended length where the data need it. Data beyond [`MAX_DATA`] are cut off.
pub fn write_frame(bus_id: u8, message: MessageId, data: &[u8], out: &mut Vec<u8>) {
    let data = data.get(..MAX_DATA).unwrap_or(data);
    let start = out.len();
    out.extend_from_slice(&[PREAMBLE, bus_id, message.0]);
    match u8::try_from(data.len()) {
        Ok(length) if length < 0xFF => out.push(length),
        _ => {
            out.push(0xFF);
            out.extend_from_slice(&(data.len() as u16).to_be_bytes());
        }
    }
    out.extend_from_slice(data);
    let sum = out.iter().skip(start + 1).fold(0_u8, |sum, &b| sum.wrapping_add(b));
    out.push(sum.wrapping_neg());
}

/// A frame from the master, ready to be written.
pub fn frame(message: MessageId, data: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(data.len() + MAX_OVERHEAD);
    write_frame(BUS_MASTER, message, data, &mut out);
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
    fn the_manual_s_frames_are_written_byte_by_byte() {
        assert_eq!(frame(MessageId::GO_TO_CONFIG, &[]), [0xFA, 0xFF, 0x30, 0x00, 0xD1]);
        assert_eq!(frame(MessageId::GO_TO_CONFIG.ack(), &[]), [0xFA, 0xFF, 0x31, 0x00, 0xD0]);
        assert_eq!(frame(MessageId::GO_TO_MEASUREMENT, &[]), [0xFA, 0xFF, 0x10, 0x00, 0xF1]);
    }

    #[test]
    fn a_true_preamble_inside_a_false_frame_is_found() {
        let mut parser = FrameParser::new();
        // The false header claims eight bytes of data, which are a true frame and three more.
        let mut bytes = vec![0x00, 0xFA, 0xFA, 0xFF, 0x32, 0x08];
        bytes.extend(frame(MessageId::GO_TO_CONFIG.ack(), &[]));
        bytes.extend([1, 2, 3, 0xEE]);
        assert_eq!(frames(&mut parser, &bytes), [(0x31, vec![])]);
        assert_eq!(parser.counts().bad_checksums, 1);
        assert_eq!(parser.counts().skipped_bytes + parser.counts().frame_bytes, bytes.len() as u64);
    }

    #[test]
    fn frames_of_any_length_and_the_end_of_a_cut_one() {
        let mut parser = FrameParser::new();
        for length in [0, 1, 253, 254, 255, 256, 2048, MAX_DATA] {
            let data: Vec<u8> = (0..length).map(|i| (i * 7) as u8).collect();
            assert_eq!(frames(&mut parser, &frame(MessageId::MT_DATA, &data)), [(0x32, data)]);
        }
        // A log cut within a frame whose data hold a whole one.
        let mut cut = vec![0xFA, 0xFF, 0x32, 0x40];
        cut.extend(frame(MessageId::GO_TO_CONFIG.ack(), &[]));
        assert_eq!(frames(&mut parser, &cut), []);
        assert_eq!(parser.next_frame_at_end().map(|f| f.message), Some(MessageId::GO_TO_CONFIG.ack()));
        assert_eq!(parser.next_frame_at_end(), None);
        assert_eq!(parser.pending(), 0);
    }

    #[test]
    fn a_reset_forgets_the_old_stream() {
        let whole = frame(MessageId::MT_DATA, &[1, 2, 3, 4]);
        let mut parser = FrameParser::new();
        assert_eq!(frames(&mut parser, &whole[..5]), []);
        parser.reset();
        assert_eq!(frames(&mut parser, &whole[5..]), []);
        assert_eq!(frames(&mut parser, &whole), [(0x32, vec![1, 2, 3, 4])]);
    }
}
