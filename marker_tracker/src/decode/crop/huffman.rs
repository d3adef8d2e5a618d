//! Huffman codes of a JPEG (ITU-T T.81, annex C), with a table that skips several symbols at once.

/// Bits by which the tables are indexed.
const INDEX: u32 = 12;

/// What the next bits of a block's AC coefficients say, for a reader that needs no values.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Step {
    /// Bits of the symbols and of the values after them; 0 where no code fits in the index.
    pub bits: u8,
    /// Coefficients that they account for.
    pub coefficients: u8,
    /// Whether the block ends with them.
    pub is_last: bool,
}

/// The codes of one table.
#[derive(Clone, Debug)]
pub(super) struct Codes {
    /// Upper bound of the codes of each length, left-aligned to 16 bits.
    bounds: [u32; 17],
    /// Index of a length's first value, minus its first code.
    offsets: [i32; 17],
    values: Vec<u8>,
    /// Length and value of the code at the start of a byte; length 0 where it is longer.
    short: [(u8, u8); 256],
    /// Runs of AC symbols by the next bits.
    steps: Box<[Step; 1 << INDEX]>,
}

impl Codes {
    /// The codes of a table: number of codes of each length from 1 to 16, and their values. `None`
    /// where they are no prefix code or no coefficient has such a symbol.
    pub fn new(counts: &[u8], values: &[u8]) -> Option<Self> {
        let (mut bounds, mut offsets) = ([0; 17], [0; 17]);
        let (mut code, mut index) = (0u32, 0);
        for (length, count) in (1..).zip(counts.iter().map(|c| u32::from(*c))) {
            offsets[length] = index - code as i32;
            code += count;
            index += count as i32;
            if code > 1 << length {
                return None;
            }
            bounds[length] = code << (16 - length);
            code <<= 1;
        }
        let (short, steps) = ([(0, 0); 256], Box::new([Step::default(); 1 << INDEX]));
        let mut codes = Self { bounds, offsets, values: values.to_vec(), short, steps };
        let short = |byte: u32| codes.search(byte << 8).filter(|(length, _)| *length <= 8);
        codes.short = std::array::from_fn(|byte| short(byte as u32).unwrap_or_default());
        for bits in 0..1 << INDEX {
            codes.steps[bits] = codes.step((bits as u64) << (16 - INDEX));
        }
        Some(codes)
    }

    fn search(&self, bits: u32) -> Option<(u8, u8)> {
        let length = (1..17).find(|l| bits < self.bounds[*l])?;
        let index = self.offsets[length] + (bits >> (16 - length)) as i32;
        Some((length as u8, *self.values.get(usize::try_from(index).ok()?)?))
    }

    /// Length and value of the first code in `bits`, left-aligned; `None` where there is none.
    #[inline(always)]
    pub fn first(&self, bits: u64) -> Option<(u32, u8)> {
        let (length, value) = match self.short[(bits >> 56) as usize] {
            (0, _) => self.search((bits >> 48) as u32)?,
            found => found,
        };
        Some((u32::from(length), value))
    }

    /// The code of a value, and its length; `None` where it has none.
    pub fn code_of(&self, value: u8) -> Option<(u64, u32)> {
        let index = self.values.iter().position(|v| *v == value)? as i32;
        // For every shorter length it would be at or beyond the bound of the codes.
        (1..17).find_map(|length| {
            let code = (index - self.offsets[length]) as u32;
            (code << (16 - length) < self.bounds[length])
                .then_some((u64::from(code), length as u32))
        })
    }

    /// Coefficients and bits of the value of an AC symbol, both 0 for the end of a block; `None`
    /// for an invalid one.
    pub fn ac(symbol: u8) -> Option<(u32, u32)> {
        match (symbol >> 4, symbol & 15) {
            (0, 0) => Some((0, 0)),
            (15, 0) => Some((16, 0)),
            // Larger values do not occur in images of 8 bits.
            (_, 0 | 11..) => None,
            (run, size) => Some((u32::from(run) + 1, u32::from(size))),
        }
    }

    /// The AC symbols whose codes are in the first [`INDEX`] bits.
    fn step(&self, bits: u64) -> Step {
        let (mut used, mut count, mut is_last) = (0, 0, false);
        while used < INDEX && !is_last {
            let Some((length, symbol)) = self.first(bits << (48 + used)) else { break };
            if used + length > INDEX {
                break;
            }
            let Some((coefficients, size)) = Self::ac(symbol) else { break };
            used += length + size;
            count += coefficients;
            is_last = symbol == 0;
        }
        Step { bits: used as u8, coefficients: count as u8, is_last }
    }

    /// The step at the start of `bits` (64 bits).
    #[inline(always)]
    pub fn skip(&self, bits: u64) -> Step {
        self.steps[(bits >> (64 - INDEX)) as usize]
    }
}
