//! A small seeded generator: the same seed makes the same scene on every machine.

/// SplitMix64.
#[derive(Clone, Debug)]
pub struct Rng(u64);

impl Rng {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in [0, 1).
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform in [from, to).
    pub fn within(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.unit()
    }

    /// Standard normal (Box and Muller).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }
}

/// Normal deviates from a table: fast enough for every pixel of a frame.
pub struct NoiseTable(Vec<f32>);

impl NoiseTable {
    const LENGTH: usize = 1 << 16;

    /// Quantiles of the standard normal, so that the table itself has mean 0 and deviation 1.
    pub fn new() -> Self {
        let mut rng = Rng::new(77);
        let mut table: Vec<f32> = (0..Self::LENGTH).map(|_| rng.normal() as f32).collect();
        let mean = table.iter().sum::<f32>() / Self::LENGTH as f32;
        let deviation = (table.iter().map(|x| (x - mean) * (x - mean)).sum::<f32>()
            / Self::LENGTH as f32)
            .sqrt();
        table.iter_mut().for_each(|x| *x = (*x - mean) / deviation);
        Self(table)
    }

    /// One deviate per 16 bits of the generator.
    pub fn four(&self, rng: &mut Rng) -> [f32; 4] {
        let bits = rng.bits();
        [0, 16, 32, 48].map(|shift| self.0[(bits >> shift) as usize & (Self::LENGTH - 1)])
    }
}
