//! The calibration of camera and projector. In: its file. Out: the rig, with the covariance of its parameters.
//! Not here: what is measured with it.

mod board;
mod file;
mod homography;
pub mod target;

pub use board::{Board, BoardKind, NotABoard};
pub use file::{Calibration, PARAMETERS, ParameterCovariance, Quality, Rms, Serials};
pub use homography::Homography;
