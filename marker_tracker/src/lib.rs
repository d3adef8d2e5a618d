//! The marker tracker: an image flows in, one [`MarkerObservations`](rig_model::MarkerObservations) flows out.
//!
//! For each of the four coloured squares the tracker tells the area centroid of its image in raw pixels, whether it was
//! measured, predicted or lost, and the covariance of the centroid. This is a pure core: no middleware, clock, thread,
//! file or device; the time is the image's stamp.
//!
//! ```
//! use marker_tracker::{ImageView, Input, Output, PixelFormat, Tracker, TrackerConfig};
//! # use rig_model::{MarkerLayout, PerColor, Stamp};
//! # use nalgebra::Point3;
//! # let layout = MarkerLayout { side: 0.076, centres: PerColor([Point3::new(0.15, 0.15, 0.0),
//! #     Point3::new(-0.15, 0.15, 0.0), Point3::new(-0.15, -0.15, 0.0), Point3::new(0.15, -0.15, 0.0)]) };
//! let mut tracker = Tracker::new(layout, TrackerConfig::default());
//! let pixels = vec![0u8; 64 * 48 * 3];
//! tracker.handle(Input::Image(ImageView {
//!     stamp: Stamp::from_nanos(0), width: 64, height: 48, step: 64 * 3, format: PixelFormat::Rgb8, data: &pixels,
//! }));
//! assert!(matches!(tracker.poll(), Some(Output::Observations(_))));
//! ```

mod acquire;
mod blob;
mod colors;
mod config;
mod decode;
mod edge;
mod engine;
mod flow;
mod geometry;
mod image;
mod interior;
mod model;
#[cfg(feature = "node")]
pub mod node;
#[cfg(feature = "opencv")]
mod opencv;
mod outline;
mod patches;
mod quad;
mod signal;
mod tracker;

pub use colors::{CalibratedColor, ColorCalibration};
pub use config::TrackerConfig;
pub use decode::{decode_compressed, decode_compressed_into};
pub use image::{ImageError, ImageView, OwnedImage, PixelFormat, from_encoding};
#[cfg(feature = "opencv")]
pub use opencv::draw;
pub use patches::{Patch, PatchTracker, find_patches};
pub use tracker::{Input, Mark, Output, Seen, Tracker, Warning};
