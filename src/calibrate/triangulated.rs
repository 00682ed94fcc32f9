//! A board in three dimensions, held against itself. In: where camera and projector see its points, the rig. Out: its
//! scale, how well it keeps its shape, its pose. What reprojection cannot show, this does: a wrong baseline or toe-in.

use super::adjust::Seen;
use crate::fringe::{Axis, triangulate};
use crate::geometry::{Pair, Point3, Pose, frame, register};
use crate::optics::Rig;
use nalgebra::{Matrix3, Vector2, Vector3};

/// A triangulated board against the true one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BoardFit {
    /// Points triangulated.
    pub points: usize,
    /// Distance of points from the board laid onto them rigidly, root mean square, mm.
    pub rms_mm: f64,
    /// The same across the board, mm.
    pub flatness_mm: f64,
    /// Lengths measured over true lengths.
    pub scale: f64,
    /// Where the board lies.
    pub camera_from_board: Pose<frame::Camera, frame::Board>,
}

/// The points of a board that camera and projector (by its column) both see, in camera coordinates, mm, by index.
pub(super) fn points(rig: &Rig, camera: &[Seen], projector: &[Seen]) -> Vec<(usize, Point3<frame::Camera>)> {
    let point = |&(k, at): &Seen| {
        let column = projector.iter().find(|p| p.0 == k)?.1.x;
        let ray = rig.camera.ray(&at)?;
        Some((k, Point3::new(ray * triangulate(rig, &ray, Axis::Column, column)?.0)))
    };
    camera.iter().filter_map(point).collect()
}

/// The triangulated board against `board`; `None` of fewer than four points or of points on a line.
pub(super) fn triangulated(rig: &Rig, board: &[Vector2<f64>], camera: &[Seen], projector: &[Seen]) -> Option<BoardFit> {
    fit(board, &points(rig, camera, projector))
}

/// `points`, by index, against `board`.
pub(super) fn fit(board: &[Vector2<f64>], points: &[(usize, Point3<frame::Camera>)]) -> Option<BoardFit> {
    if points.len() < 4 {
        return None;
    }
    let pair = |&(k, measured): &(usize, Point3<frame::Camera>)| Pair {
        measured,
        nominal: Point3::<frame::Board>::new(board[k].push(0.0)),
        covariance: Matrix3::identity(),
    };
    let pairs: Vec<_> = points.iter().map(pair).collect();
    let registration = register(&pairs).ok()?;
    let n = pairs.len() as f64;
    let mean_square = |f: &dyn Fn(&Vector3<f64>) -> f64| registration.residuals.iter().map(f).sum::<f64>() / n;
    // the least-squares scale about the centroid, which a rigid fit leaves where it is
    let (mut along, mut square) = (0.0, 0.0);
    for (pair, residual) in pairs.iter().zip(&registration.residuals) {
        let arm = pair.nominal - registration.at;
        along += residual.dot(&arm);
        square += arm.norm_squared();
    }
    Some(BoardFit {
        points: pairs.len(),
        rms_mm: mean_square(&|r| r.norm_squared()).sqrt(),
        flatness_mm: mean_square(&|r| r.z * r.z).sqrt(),
        scale: 1.0 + along / square,
        camera_from_board: registration.a_from_b,
    })
}
