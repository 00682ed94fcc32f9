//! datum: where a vehicle's own coordinate system lies, measured from its body.
//!
//! Images of a car body go in (one lit by red bars, several by projected fringes); the pose of the
//! vehicle's ISO 8855 frame comes out, with its covariance, or a code that says why there is none.
//! Everything between the two is pure: no device, no clock, no state from one vehicle to the next.
//!
//! Lengths are millimetres, angles radians (degrees in files and reports), pixels have integer centres.

pub mod backup;
pub mod calibrate;
pub mod capture;
pub mod cli;
pub mod code;
pub mod contour;
pub mod dataset;
pub mod detect;
pub mod document;
pub mod fringe;
pub mod geometry;
pub mod hal;
pub mod heap;
pub mod image;
pub mod lent;
pub mod measure;
pub mod optics;
pub mod plc;
pub mod records;
pub mod sim;
pub mod station;
pub mod study;
#[cfg(test)]
mod testing;
pub mod time;
pub mod vehicle;

pub use calibrate::Calibration;
pub use capture::Capture;
pub use code::Code;
pub use geometry::{Point3, Pose, frame};
pub use image::Image;
pub use measure::Measurement;
pub use optics::{Lens, Pixel, Rig};
pub use vehicle::VehicleFile;

/// The README's example: it must compile and run.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
