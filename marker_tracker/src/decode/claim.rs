//! Check of what an image's header claims.

use crate::image::{ImageError, ImageView};

/// Allowance, so that a small image need not fill its size, bytes or pixels.
const SMALL: usize = 1 << 16;

/// Checks a claimed size (px) before memory is allocated for it: `needed` may not exceed `most`,
/// which is what `length` bytes can hold.
///
/// # Errors
/// [`ImageError::TooLarge`].
pub(super) fn check(
    width: usize,
    height: usize,
    needed: usize,
    most: usize,
    length: usize,
) -> Result<(), ImageError> {
    let small_side = width <= ImageView::MAX_SIDE && height <= ImageView::MAX_SIDE;
    // With both sides below 2^14 nothing overflows.
    if small_side && width * height <= ImageView::MAX_PIXELS && needed <= most.saturating_add(SMALL)
    {
        Ok(())
    } else {
        Err(ImageError::TooLarge { width, height, length })
    }
}
