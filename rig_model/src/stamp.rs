//! Time of a sample, in nanoseconds since the epoch of the clock that stamped it.

use std::fmt;

/// Instant, ns since the Unix epoch (or since the start of simulated time).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Stamp(i64);

impl Stamp {
    /// Instant from nanoseconds since the epoch.
    pub const fn from_nanos(nanos: i64) -> Self {
        Self(nanos)
    }

    /// Instant from the two fields of `builtin_interfaces/Time`.
    pub const fn from_sec_nanosec(sec: i32, nanosec: u32) -> Self {
        Self(sec as i64 * 1_000_000_000 + nanosec as i64)
    }

    /// The two fields of `builtin_interfaces/Time`; seconds are clamped to 32 bits.
    pub fn to_sec_nanosec(self) -> (i32, u32) {
        let sec = self.0.div_euclid(1_000_000_000).clamp(i64::from(i32::MIN), i64::from(i32::MAX));
        (sec as i32, self.0.rem_euclid(1_000_000_000) as u32)
    }

    /// Nanoseconds since the epoch.
    pub const fn as_nanos(self) -> i64 {
        self.0
    }

    /// Whether it is zero: its publisher does not set it.
    pub const fn is_unset(self) -> bool {
        self.0 == 0
    }

    /// Returns `self - earlier`, s; negative if `earlier` is later. Saturates.
    pub fn seconds_since(self, earlier: Stamp) -> f64 {
        self.0.saturating_sub(earlier.0) as f64 * 1e-9
    }

    /// Returns the instant `seconds` later, rounded to a nanosecond. Saturates.
    pub fn plus_seconds(self, seconds: f64) -> Stamp {
        Stamp(self.0.saturating_add((seconds * 1e9).round() as i64))
    }
}

impl fmt::Display for Stamp {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (sign, nanos) = (if self.0 < 0 { "-" } else { "" }, self.0.unsigned_abs());
        write!(f, "{sign}{}.{:09}", nanos / 1_000_000_000, nanos % 1_000_000_000)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ros_fields_round_trip_also_before_the_epoch() {
        for nanos in
            [0, 1, 999_999_999, 1_000_000_000, 1_760_001_000_062_293_974, -1, -1_000_000_001]
        {
            let (sec, nanosec) = Stamp::from_nanos(nanos).to_sec_nanosec();
            assert_eq!(Stamp::from_sec_nanosec(sec, nanosec), Stamp::from_nanos(nanos));
        }
    }

    #[test]
    fn the_text_is_in_seconds_also_before_the_epoch() {
        for (nanos, text) in [
            (1_760_001_000_062_293_974, "1760001000.062293974"),
            (0, "0.000000000"),
            (-594_857_500, "-0.594857500"),
            (-1_000_000_001, "-1.000000001"),
            (i64::MIN, "-9223372036.854775808"),
        ] {
            assert_eq!(Stamp::from_nanos(nanos).to_string(), text);
        }
    }

    #[test]
    fn differences_keep_nanoseconds_at_current_epochs() {
        let a = Stamp::from_nanos(1_760_001_000_062_293_974);
        assert_eq!(a.plus_seconds(0.033_333_333).seconds_since(a), 0.033_333_333);
    }
}
