//! The four number formats of the protocol, and a bounds-checked reader.

ros_parameters::choices! {
    /// Number format: OutputSettings bits 9:8, MTData2 identifier bits 1:0.
    #[derive(Hash)]
    pub enum NumberFormat {
        /// IEEE 754 single.
        Float32 = "float32",
        /// Signed fixed point, 32 bits with 20 fractional bits.
        Fp1220 = "fp12.20",
        /// Signed fixed point: 32 fractional bits, followed on the wire by 16 integer bits.
        Fp1632 = "fp16.32",
        /// IEEE 754 double.
        Float64 = "double",
    }
}

impl NumberFormat {
    /// All four, in the order of their codes.
    pub const ALL: [Self; 4] = [Self::Float32, Self::Fp1220, Self::Fp1632, Self::Float64];

    /// Format of bits 1:0; the other bits are ignored.
    pub const fn from_bits(bits: u32) -> Self {
        Self::ALL[(bits & 3) as usize]
    }

    /// Code of the format, bits 1:0.
    pub const fn bits(self) -> u32 {
        self as u32
    }

    /// Size of one number, bytes.
    pub const fn size(self) -> usize {
        match self {
            Self::Float32 | Self::Fp1220 => 4,
            Self::Fp1632 => 6,
            Self::Float64 => 8,
        }
    }

    /// Appends one number, clamped to the range of the format (NaN is 0 in fixed point).
    pub fn write(self, value: f64, out: &mut Vec<u8>) {
        match self {
            Self::Float32 => out.extend_from_slice(&(value as f32).to_be_bytes()),
            Self::Fp1220 => {
                out.extend_from_slice(&((value * 1_048_576.0).round() as i32).to_be_bytes())
            }
            Self::Fp1632 => {
                let limit = (1_i64 << 47) as f64;
                let scaled = (value * 4_294_967_296.0).round().clamp(-limit, limit - 1.0) as i64;
                out.extend_from_slice(&(scaled as u32).to_be_bytes());
                out.extend_from_slice(&((scaled >> 32) as i16).to_be_bytes());
            }
            Self::Float64 => out.extend_from_slice(&value.to_be_bytes()),
        }
    }
}

/// Reads big-endian fields from the front of a slice; each method returns `None` at its end.
#[derive(Clone, Copy, Debug)]
pub struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    /// Creates a reader at the front of `data`.
    pub const fn new(data: &'a [u8]) -> Self {
        Self(data)
    }

    /// The remaining bytes.
    pub const fn rest(&self) -> &'a [u8] {
        self.0
    }

    /// The next `n` bytes.
    #[inline]
    pub fn take(&mut self, n: usize) -> Option<&'a [u8]> {
        self.0.split_off(..n)
    }

    #[inline]
    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (head, tail) = self.0.split_first_chunk::<N>()?;
        self.0 = tail;
        Some(*head)
    }

    /// One byte.
    #[inline]
    pub fn u8(&mut self) -> Option<u8> {
        self.array::<1>().map(|[b]| b)
    }

    /// Two bytes.
    #[inline]
    pub fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_be_bytes)
    }

    /// Four bytes.
    #[inline]
    pub fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_be_bytes)
    }

    #[inline]
    fn number(&mut self, format: NumberFormat) -> Option<f64> {
        Some(match format {
            NumberFormat::Float32 => f64::from(f32::from_be_bytes(self.array()?)),
            NumberFormat::Fp1220 => f64::from(i32::from_be_bytes(self.array()?)) / 1_048_576.0,
            NumberFormat::Fp1632 => {
                let fraction = u32::from_be_bytes(self.array()?);
                let integer = i16::from_be_bytes(self.array()?);
                let scaled = (i64::from(integer) << 32) | i64::from(fraction);
                scaled as f64 / 4_294_967_296.0
            }
            NumberFormat::Float64 => f64::from_be_bytes(self.array()?),
        })
    }

    /// `N` numbers in `format`.
    #[inline]
    pub fn numbers<const N: usize>(&mut self, format: NumberFormat) -> Option<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            *value = self.number(format)?;
        }
        Some(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fp1632_of_a_recorded_frame() {
        // From the first frame of a recorded FP16.32 log: acceleration x and y.
        let bytes = [0x0b, 0xd2, 0xd9, 0x60, 0x00, 0x00, 0xbc, 0x86, 0xa0, 0x00, 0xff, 0xf8];
        let [x, y] = Reader::new(&bytes).numbers(NumberFormat::Fp1632).unwrap();
        assert_eq!((x, y), (0.04618605226278305, -7.263570785522461));
    }

    #[test]
    fn numbers_round_trip_and_fixed_point_clamps() {
        let quantize = |format: NumberFormat, value: f64| {
            let mut bytes = Vec::new();
            format.write(value, &mut bytes);
            let [x] = Reader::new(&bytes).numbers(format).unwrap();
            x
        };
        for format in NumberFormat::ALL {
            assert_eq!(NumberFormat::from_bits(format.bits()), format);
            for value in [0.0, 1.0, -1.0, 9.812_345, -2047.5, 1e-6, -1e-6] {
                let x = quantize(format, value);
                let error = (x - value).abs();
                let bound = if format == NumberFormat::Fp1220 { 0.5 / 1_048_576.0 } else { 1e-4 };
                assert!(error <= bound, "{format:?} {value} {error}");
                assert_eq!(quantize(format, x), x);
            }
        }
        assert!((quantize(NumberFormat::Fp1220, 1e9) - 2048.0).abs() < 1e-5);
        assert!((quantize(NumberFormat::Fp1632, -1e9) + 32768.0).abs() < 1e-5);
        assert_eq!(quantize(NumberFormat::Fp1632, f64::NAN), 0.0);
    }
}
