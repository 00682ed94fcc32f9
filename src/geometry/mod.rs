//! Points, poses and surfaces in millimetres. In: coordinates and their covariances. Out: poses,
//! fitted surfaces and registrations, with covariances. Not here: pixels, images, files.

mod angles;
mod joint;
mod pose;
mod registration;
pub mod robust;
mod surface;

pub use angles::EulerDeg;
pub use joint::{Distance, Joint, MAX_SHARED, register_jointly};
pub use pose::{Point3, Pose, frame, rotation_from_rows, skew};
pub use registration::{MIN_SPREAD, NoPose, Pair, Registration, motion_jacobian, register, spread};
pub use surface::{Cell, Local, MAX_ORDER, Polynomial, Surface};
