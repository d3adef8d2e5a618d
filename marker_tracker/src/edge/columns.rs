//! Quantities of all rows of an edge, eight at a time.

use wide::f32x8;

/// Maximum number of rows of one edge that are used; longer edges are sampled evenly.
pub(crate) const MAX_ROWS: usize = 64;

/// One quantity of all rows.
pub(super) type Column = [f32; MAX_ROWS];

/// Eight rows of a quantity.
#[inline(always)]
pub(crate) fn eight<const N: usize>(column: &[f32; N], group: usize) -> f32x8 {
    let mut values = [0.0; 8];
    values.copy_from_slice(&column[group..group + 8]);
    f32x8::from(values)
}

/// Mask of those of eight rows that exist.
#[inline(always)]
pub(super) fn present(group: usize, count: usize) -> f32x8 {
    let numbers =
        f32x8::from([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]) + f32x8::splat(group as f32);
    numbers.simd_lt(f32x8::splat(count as f32))
}
