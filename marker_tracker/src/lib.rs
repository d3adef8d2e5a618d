//! Marker tracker: an image in, one [`MarkerObservations`](rig_model::MarkerObservations) out.
//!
//! For each of four colored squares the tracker estimates the area centroid of its image in raw
//! pixels with its covariance, and whether it was measured, predicted or lost. The core is pure: no
//! middleware, clock, thread, file or device; time is the image's stamp.
//!
//! ```
//! use marker_tracker::{ImageView, Input, Output, PixelFormat, Tracker, TrackerConfig};
//! # use rig_model::{MarkerLayout, PerColor, Stamp};
//! # use nalgebra::Point3;
//! # let corners = [(0.15, 0.15), (-0.15, 0.15), (-0.15, -0.15), (0.15, -0.15)];
//! # let centers = PerColor(corners.map(|(x, y)| Point3::new(x, y, 0.0)));
//! # let layout = MarkerLayout { side: 0.076, centers };
//! let mut tracker = Tracker::new(layout, TrackerConfig::default());
//! let pixels = vec![0u8; 64 * 48 * 3];
//! tracker.handle(Input::Image(ImageView {
//!     stamp: Stamp::from_nanos(0),
//!     width: 64,
//!     height: 48,
//!     step: 64 * 3,
//!     format: PixelFormat::Rgb8,
//!     data: &pixels,
//! }));
//! assert!(matches!(tracker.poll(), Some(Output::Observations(_))));
//! ```

mod appearance;
mod association;
mod colors;
mod config;
mod debug_view;
mod decode;
mod edge;
mod encoding;
mod engine;
mod flow;
mod form;
mod geometry;
mod hue;
mod image;
#[cfg(feature = "node")]
pub mod node;
#[cfg(feature = "opencv")]
mod opencv;
mod outline;
mod quad;
mod scan;
mod signal;
mod tracker;
mod tracking;

pub use colors::{CalibratedColor, ColorCalibration, find_patches};
#[cfg(feature = "opencv")]
pub use config::BinaryThreshold;
pub use config::{Method, TrackerConfig};
pub use debug_view::{MarkerView, Outcome, SignalView};
pub use decode::{Decoder, PartialImage, decode_compressed, decode_compressed_into};
pub use encoding::from_encoding;
pub use hue::hue;
pub use image::{ImageError, ImageView, OwnedImage, PixelFormat};
pub use scan::Patch;
pub use tracker::{Input, Output, Tracker, Warning};
