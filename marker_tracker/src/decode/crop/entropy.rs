//! Bits of a JPEG's entropy-coded data: reading, skipping and writing.

use super::huffman::Codes;

/// Bytes after the data that may be read with its last bits.
const PADDING: [u8; 16] = [0; 16];

/// One segment of entropy-coded data without its stuffed bytes.
#[derive(Debug, Default)]
pub(super) struct Segment {
    bytes: Vec<u8>,
    /// Next bit.
    at: usize,
}

/// One block of 8 × 8 coefficients.
pub(super) struct Block {
    /// DC coefficient minus that of the component's previous block.
    pub difference: i32,
    /// First bit of the AC coefficients.
    start: usize,
}

impl Segment {
    /// Loads the data at the start of `jpeg`; returns their length. `None` without a marker after
    /// them.
    pub fn load(&mut self, jpeg: &[u8]) -> Option<usize> {
        self.bytes.clear();
        self.at = 0;
        let mut from = 0;
        loop {
            let found = from + memchr::memchr(0xff, jpeg.get(from..)?)?;
            self.bytes.extend_from_slice(&jpeg[from..found]);
            if *jpeg.get(found + 1)? != 0 {
                self.bytes.extend_from_slice(&PADDING);
                return Some(found);
            }
            self.bytes.push(0xff);
            from = found + 2;
        }
    }

    /// Whether all bits have been read, except for less than a byte of padding.
    pub fn is_at_end(&self) -> bool {
        let end = 8 * (self.bytes.len() - PADDING.len());
        (self.at..self.at + 8).contains(&end)
    }

    /// The bits from `at` on, left-aligned; at least 57 are valid.
    #[inline(always)]
    fn peek(&self, at: usize) -> Option<u64> {
        let bytes = self.bytes.get(at / 8..at / 8 + 8)?;
        Some(u64::from_be_bytes(bytes.try_into().ok()?) << (at % 8))
    }

    /// Reads over the next block; `None` where it is invalid.
    #[inline(always)]
    pub fn block(&mut self, dc: &Codes, ac: &Codes) -> Option<Block> {
        let mut next = self.peek(self.at)?;
        let (length, size) = dc.first(next)?;
        next <<= length;
        let difference = value(next, size)?;
        next <<= size;
        let start = self.at + (length + u32::from(size)) as usize;
        let mut bits =
            Bits { next, valid: 64 - (start - self.at / 8 * 8) as u32, byte: self.at / 8 + 8 };
        let mut count = 1;
        loop {
            bits.refill(&self.bytes)?;
            // Two symbols of 26 bits at most, or two steps of fewer.
            for _ in 0..2 {
                let step = ac.skip(bits.next);
                // Bits after the last coefficient are the next block's.
                let last = if step.bits > 0 && count + u32::from(step.coefficients) < 64 {
                    count += u32::from(step.coefficients);
                    bits.drop(step.bits.into());
                    step.is_last
                } else {
                    let (length, symbol) = ac.first(bits.next)?;
                    let (coefficients, size) = Codes::ac(symbol)?;
                    count += coefficients;
                    bits.drop(length + size);
                    symbol == 0 || count == 64
                };
                if last {
                    self.at = 8 * bits.byte - bits.valid as usize;
                    return Some(Block { difference, start });
                }
                if count > 64 {
                    return None;
                }
            }
        }
    }
}

/// Bits of a segment in a register.
struct Bits {
    /// The next bits, left-aligned, and how many of them are valid.
    next: u64,
    valid: u32,
    /// The byte after them.
    byte: usize,
}

impl Bits {
    /// Fills up to 56 valid bits or more.
    #[inline(always)]
    fn refill(&mut self, bytes: &[u8]) -> Option<()> {
        let bytes = bytes.get(self.byte..self.byte + 8)?;
        self.next |= u64::from_be_bytes(bytes.try_into().ok()?) >> self.valid;
        self.byte += (63 - self.valid as usize) / 8;
        self.valid |= 56;
        Some(())
    }

    #[inline(always)]
    fn drop(&mut self, count: u32) {
        self.next <<= count;
        self.valid -= count;
    }
}

/// The value of `size` bits (ITU-T T.81, F.2.2.1) at the start of `bits`; `None` where an image of
/// 8 bits has no such value.
fn value(bits: u64, size: u8) -> Option<i32> {
    match size {
        0 => Some(0),
        1..=11 => {
            let value = (bits >> (64 - size)) as i32;
            Some(if bits >> 63 == 1 { value } else { value + 1 - (1 << size) })
        }
        _ => None,
    }
}

/// Writer of entropy-coded data.
#[derive(Debug, Default)]
pub(super) struct BitWriter {
    bytes: Vec<u8>,
    pending: u64,
    /// Number of pending bits, below 32.
    count: u32,
}

impl BitWriter {
    /// Codes of the DC differences of 0 to 11 bits: these numbers, in [`Self::DC_BITS`] bits.
    pub const COUNTS: [u8; 16] = [0, 0, 0, 12, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
    const DC_BITS: u32 = 4;

    /// Removes all bits.
    pub fn clear(&mut self) {
        self.bytes.clear();
        (self.pending, self.count) = (0, 0);
    }

    /// Appends the low `count` bits of `bits`, at most 32.
    #[inline]
    fn put(&mut self, bits: u64, count: u32) {
        self.pending = (self.pending << count) | bits;
        self.count += count;
        if self.count >= 32 {
            self.count -= 32;
            let word = (self.pending >> self.count) as u32;
            self.bytes.extend_from_slice(&word.to_be_bytes());
        }
    }

    /// Appends the block that `segment` has just read, with another DC difference. `None` where an
    /// image of 8 bits has no such difference.
    pub fn copy(&mut self, segment: &Segment, block: &Block, difference: i32) -> Option<()> {
        let size = 32 - difference.unsigned_abs().leading_zeros();
        if size > 11 {
            return None;
        }
        self.put(size.into(), Self::DC_BITS);
        let value = if difference < 0 { difference + (1 << size) - 1 } else { difference };
        self.put(value as u64, size);
        let mut at = block.start;
        while at < segment.at {
            let count = (segment.at - at).min(32);
            self.put(segment.peek(at)? >> (64 - count), count as u32);
            at += count;
        }
        Some(())
    }

    /// Appends a block with its predecessor's DC coefficient and no others; `end`: the code of the
    /// end of a block.
    pub fn empty(&mut self, (code, length): (u64, u32)) {
        self.put(code, Self::DC_BITS + length);
    }

    /// Appends all bits, padded to a byte, to a JPEG, with stuffed bytes.
    pub fn finish(&mut self, jpeg: &mut Vec<u8>) {
        while !self.count.is_multiple_of(8) {
            self.put(1, 1);
        }
        let rest = (self.pending << (64 - self.count.max(1))).to_be_bytes();
        self.bytes.extend_from_slice(&rest[..self.count as usize / 8]);
        for piece in self.bytes.split_inclusive(|byte| *byte == 0xff) {
            jpeg.extend_from_slice(piece);
            if piece.ends_with(&[0xff]) {
                jpeg.push(0);
            }
        }
    }
}
