//! Initialization: from one image, with what was known before, and of the camera time offset.

mod alignment;
pub mod ambiguity;
pub mod checkpoint;
pub mod from_image;
pub mod preintegration;
pub mod time_offset;
mod windows;
