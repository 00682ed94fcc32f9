//! Pinhole cameras with Brown–Conrady distortion, of which the projector is one seen backwards.
//! In: points in a lens's own frame, or pixels. Out: pixels, or rays. Not here: where parameters come from.

mod lens;

pub use lens::{Lens, Pixel};

use crate::geometry::{Pose, frame};

/// Camera, projector, and how they stand to each other: all that triangulation needs.
#[derive(Clone, Debug, PartialEq)]
pub struct Rig {
    /// The camera's lens.
    pub camera: Lens,
    /// The projector's lens.
    pub projector: Lens,
    /// Camera coordinates to projector coordinates.
    pub projector_from_camera: Pose<frame::Projector, frame::Camera>,
}
