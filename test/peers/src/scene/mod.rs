//! Scenes made from a seed, with truth: a camera above, a platform that carries markers or a tag, a
//! floor with clutter.
//!
//! Every edge is area-true: a pixel's value is the exact area integral of what its square covers,
//! found by clipping polygons, so that no peer profits from how the others' edges were drawn.

mod canvas;
mod floor;
mod geometry;
mod plate;
mod rng;

pub use canvas::{Canvas, Frame, Light};
pub use floor::{Floor, Thing};
pub use geometry::Pinhole;
pub use plate::{Plate, PlateKind};
pub use rng::Rng;
