//! The calibration of camera and projector. In: its file. Out: the rig, with the covariance of its parameters.
//! Not here: what is measured with it.

mod file;

pub use file::{Calibration, PARAMETERS, ParameterCovariance, Quality, Rms, Serials};
