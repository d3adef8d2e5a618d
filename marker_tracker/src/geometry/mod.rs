//! The platform's pose in the camera frame, as far as the tracker needs it: to predict the squares'
//! outlines and to decide whether patches of the right colors can be the markers.

mod refine;
mod square;

pub(crate) use refine::{Geometry, PoseObservation, PosePrior, moved};
pub(crate) use square::project_square;
