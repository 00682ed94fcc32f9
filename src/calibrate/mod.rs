//! Calibration and its upkeep. In: pictures and captures of a board. Out: camera and projector, how they stand to each other
//! and to the station, with the covariance of it all; whether that still holds. Not here: what is measured with it.
//!
//! picture → [`target::find`] → points seen by the camera → [`Lit`] → the same points in the projector → [`solve_shown`] →
//! [`Calibration`] → [`keep`]. Afterwards: [`verify`] on a board, [`Health`] on every vehicle, [`survey`] for the station.

mod adjust;
mod board;
mod file;
mod guidance;
mod health;
mod homography;
mod keep;
mod phase;
mod points;
mod propagate;
mod scale;
mod shown;
mod solve;
mod start;
mod survey;
pub mod target;
mod triangulated;
mod verify;

pub use adjust::{Device, Seen};
pub use board::{Board, BoardKind, NotABoard};
pub use file::{Calibration, CameraFile, PARAMETERS, ParameterCovariance, Quality, Rms, Serials};
pub use guidance::Coverage;
pub use health::{Health, Known, MAX_EPIPOLAR_PX, MAX_INDEX, Turn};
pub use homography::Homography;
pub use keep::{NotKept, check_replaceable, keep, keep_camera};
pub use phase::{Lit, NotLit, decode, mean};
pub use points::read_points;
pub(crate) use propagate::changed;
pub use propagate::{PointJacobian, Sensitivity, independent_errors};
pub use scale::scale_sigma;
pub use shown::{Shown, solve_shown};
pub use solve::{MIN_VIEWS, Solution, Terms, Unsolved, View, ViewReport, solve};
pub use survey::{
    Centre, Circle, Culprit, MAX_RESIDUAL_MM, MAX_SIGMAS, Misfit, Survey, Unsurveyed, centre, read_circles, survey,
};
pub use triangulated::BoardFit;
pub use verify::{TooFew, Verification, VerifyLimits, verify};

#[cfg(test)]
mod testing {
    //! The rig of the rendered captures, and a covariance such as a calibration states.

    use super::{PARAMETERS, ParameterCovariance};
    use crate::geometry::Pose;
    use crate::optics::{Lens, Rig};
    use nalgebra::{Rotation3, Vector3};

    pub(super) fn rig() -> Rig {
        let lens =
            |width, height, f, cx, cy, distortion| Lens { width, height, fx: f, fy: f + 1.0, cx, cy, distortion };
        Rig {
            camera: lens(1296, 972, 1351.8, 651.45, 481.1, [-0.0853, 0.1042, 0.00043, -0.00031, -0.0215]),
            projector: lens(1280, 800, 1052.0, 633.7, 391.4, [-0.02, 0.01, 0.0002, -0.0001, 0.0]),
            projector_from_camera: Pose::new(
                Rotation3::from_euler_angles(0.0113, -0.2853, -0.0103),
                Vector3::new(213.0, -11.67, 77.83),
            ),
        }
    }

    /// Lenses to 0.1 px and a little of distortion, turns to 0.006°, shifts to 0.05 mm; neighbours correlated.
    pub(super) fn stated() -> ParameterCovariance {
        let sigma = |k: usize| match PARAMETERS[k] {
            "rx" | "ry" | "rz" => 1e-4,
            "tx" | "ty" | "tz" => 0.05,
            name if name.ends_with(['x', 'y']) => 0.1,
            _ => 1e-4,
        };
        ParameterCovariance::from_fn(|i, j| {
            sigma(i) * sigma(j) * (-0.5f64).powi(i32::try_from(i.abs_diff(j)).expect("small"))
        })
    }
}
