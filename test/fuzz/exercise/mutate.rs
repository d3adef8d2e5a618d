//! Right inputs made wrong at random, where no fuzzer guides.

/// xorshift64*.
pub struct Random(pub u64);

impl Random {
    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    pub fn below(&mut self, n: usize) -> usize {
        ((self.next() >> 32) as usize * n.max(1)) >> 32
    }
}

/// Lengths and counts that parsers trip over.
const NUMBERS: [u64; 10] =
    [0, 1, 0x7F, 0xFF, 0xFFFF, 0x7FFF_FFFF, 0xFFFF_FFFF, 0x8000_0000, 1 << 40, u64::MAX];

/// One input made of the seeds.
pub fn mutate(seeds: &[Vec<u8>], words: &[&[u8]], random: &mut Random, out: &mut Vec<u8>) {
    out.clear();
    let Some(seed) = seeds.get(random.below(seeds.len())) else { return };
    out.extend_from_slice(seed);
    for _ in 0..1 + random.below(5) {
        let at = random.below(out.len());
        match random.below(10) {
            0 => out.truncate(at),
            1 if !out.is_empty() => {
                let end = (at + 1 + random.below(8)).min(out.len());
                out.drain(at..end);
            }
            2 => out.insert(at, random.next() as u8),
            3 => {
                let other = &seeds[random.below(seeds.len())];
                let from = random.below(other.len());
                out.truncate(at);
                out.extend_from_slice(&other[from..]);
            }
            4 if out.len() < 1 << 14 => {
                let end = (at + random.below(64)).min(out.len());
                out.extend_from_within(at..end);
            }
            5 | 6 => {
                let number = NUMBERS[random.below(NUMBERS.len())];
                let bytes = match random.below(4) {
                    0 => number.to_le_bytes()[..2].to_vec(),
                    1 => number.to_le_bytes()[..4].to_vec(),
                    2 => (number as u32).to_be_bytes().to_vec(),
                    _ => number.to_le_bytes().to_vec(),
                };
                overwrite(out, at, &bytes);
            }
            7 if !words.is_empty() => {
                let word = words[random.below(words.len())];
                if random.below(2) == 0 {
                    overwrite(out, at, word);
                } else {
                    out.splice(at..at, word.iter().copied());
                }
            }
            _ => {
                if let Some(byte) = out.get_mut(at) {
                    *byte ^= 1 << random.below(8);
                }
            }
        }
    }
}

fn overwrite(out: &mut [u8], at: usize, bytes: &[u8]) {
    for (to, from) in out.iter_mut().skip(at).zip(bytes) {
        *to = *from;
    }
}
