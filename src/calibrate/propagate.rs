//! What errors of the calibrated parameters do to what is measured with them.
//! In:  the rig, a surface point. Out: how the point, and the projector coordinate expected across the measuring axis,
//! move with each of [`super::PARAMETERS`]. Not here: what is made of points; where the parameters' covariance comes from.
//!
//! What a capture fixes is the camera pixel and the projector coordinate that gave the depth: a parameter that is off
//! moves the point where the two meet.

use super::file::ParameterCovariance;
use crate::fringe::{Axis, projector_coordinate, triangulate};
use crate::geometry::{Point3, frame};
use crate::optics::Rig;
use nalgebra::{Rotation3, RowSVector, SMatrix, Vector3};

/// Movements of a point, camera axes, by each of [`super::PARAMETERS`] (columns), or by each of as many independent errors.
pub type PointJacobian = SMatrix<f64, 3, 24>;

/// The first of the six parameters of `projector_from_camera`: rx, ry, rz (rad), tx, ty, tz (mm).
pub(crate) const RELATION: usize = 18;

/// How one point follows the parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivity {
    /// ∂ point / ∂ parameters, camera axes, mm per unit.
    pub point: PointJacobian,
    /// ∂ (measured less expected coordinate across the measuring axis) / ∂ parameters, projector px per unit: the
    /// epipolar residual. A longer baseline, everything else the same, leaves none.
    pub across: RowSVector<f64, 24>,
}

impl Sensitivity {
    /// Of `point`, whose depth came from the projector coordinate along `axis`. Central differences; `None` where the
    /// point is not in front of both lenses.
    pub fn new(rig: &Rig, axis: Axis, point: &Point3<frame::Camera>) -> Option<Self> {
        let other = if axis == Axis::Column { Axis::Row } else { Axis::Column };
        let pixel = rig.camera.project(&point.xyz)?;
        let at = projector_coordinate(rig, axis, point)?;
        let met = |rig: &Rig| {
            let ray = rig.camera.ray(&pixel)?;
            let met = Point3::new(ray * triangulate(rig, &ray, axis, at)?.0);
            Some((met, projector_coordinate(rig, other, &met)?))
        };
        let mut out = Self { point: PointJacobian::zeros(), across: RowSVector::zeros() };
        for k in 0..24 {
            let h = step(k);
            let (above, below) = (met(&changed(rig, k, h))?, met(&changed(rig, k, -h))?);
            out.point.set_column(k, &((above.0 - below.0) / (2.0 * h)));
            out.across[k] = (below.1 - above.1) / (2.0 * h);
        }
        Some(out)
    }
}

/// A step over which the point moves by some 0.01 mm, so that neither rounding nor curvature shows.
fn step(k: usize) -> f64 {
    match k {
        0..4 | 9..13 => 1e-2,        // px
        4..9 | 13..RELATION => 1e-4, // distortion
        RELATION..21 => 1e-5,        // rad
        _ => 1e-2,                   // mm
    }
}

/// The rig with parameter `k` of [`super::PARAMETERS`] larger by `by`.
pub(crate) fn changed(rig: &Rig, k: usize, by: f64) -> Rig {
    let mut out = rig.clone();
    let relation = &mut out.projector_from_camera;
    match k {
        RELATION..21 => relation.r = Rotation3::new(Vector3::ith(k - RELATION, by)) * relation.r,
        21.. => relation.t[k - 21] += by,
        _ => {
            let lens = if k < 9 { &mut out.camera } else { &mut out.projector };
            match k % 9 {
                0 => lens.fx += by,
                1 => lens.fy += by,
                2 => lens.cx += by,
                3 => lens.cy += by,
                d => lens.distortion[d - 4] += by,
            }
        }
    }
    out
}

/// L of `covariance` = L·Lᵀ: the parameters' errors as a mixture of 24 independent ones of variance 1. What rounding
/// leaves below zero counts as zero.
pub fn independent_errors(covariance: &ParameterCovariance) -> ParameterCovariance {
    // parameters differ by ten orders of magnitude: what is decomposed is their correlation
    let sigmas = covariance.diagonal().map(f64::sqrt);
    let over = sigmas.map(|s| if s > 0.0 { 1.0 / s } else { 0.0 });
    let unit = ParameterCovariance::from_fn(|i, j| covariance[(i, j)] * over[i] * over[j]).symmetric_eigen();
    let roots = unit.eigenvalues.map(|v| v.max(0.0).sqrt());
    ParameterCovariance::from_diagonal(&sigmas) * unit.eigenvectors * ParameterCovariance::from_diagonal(&roots)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::PARAMETERS;
    use crate::calibrate::testing::{rig, stated};
    use crate::geometry::{Pair, Pose, register};
    use crate::testing::Noise;
    use nalgebra::{Matrix3, Matrix6, SVector, Vector6};

    /// Four features as they stand in the station, camera frame, mm.
    const SEEN: [[f64; 3]; 4] =
        [[-140.3, 140.6, 745.2], [164.3, 139.1, 735.4], [7.6, -58.0, 739.8], [24.4, 106.8, 735.7]];

    #[test]
    fn a_longer_baseline_scales_points_and_leaves_the_epipolar_lines() {
        for axis in [Axis::Column, Axis::Row] {
            for seen in SEEN {
                let (mut rig, point) = (rig(), Point3::new(Vector3::from(seen)));
                rig.projector_from_camera.t.y = 150.0; // beside and below, so that both axes tell depth
                let s = Sensitivity::new(&rig, axis, &point).expect("in front");
                let t = rig.projector_from_camera.t;
                let longer = s.point.fixed_columns::<3>(21) * t;
                assert!((longer - point.xyz).norm() < 1e-4 * point.xyz.norm(), "{axis:?}: {longer} for {point:?}");
                assert!((s.across.fixed_columns::<3>(21) * t)[0].abs() < 1e-4, "{axis:?}");
            }
        }
    }

    #[test]
    fn errors_are_independent_and_make_the_covariance() {
        let covariance = stated();
        let errors = independent_errors(&covariance);
        let unit = covariance.diagonal().map(|v| 1.0 / v.sqrt());
        let off = (errors * errors.transpose() - covariance).component_mul(&(unit * unit.transpose()));
        assert!(off.amax() < 1e-9, "{off}");
        assert_eq!(independent_errors(&ParameterCovariance::zeros()), ParameterCovariance::zeros());
    }

    /// Rigs drawn from the covariance see four features; each pose that follows is held against the true one.
    #[test]
    fn the_pose_covariance_is_that_of_a_monte_carlo_run_over_calibrations() {
        let (truth, errors, draws) = (rig(), independent_errors(&stated()), 20_000);
        let pose = Pose::<frame::Camera, frame::Vehicle>::new(
            Rotation3::from_euler_angles(1.6, 0.02, 3.1),
            Vector3::new(-2645.0, 777.0, 1656.0),
        );
        let points = SEEN.map(|p| Point3::<frame::Camera>::new(p.into()));
        let pairs = |measured: &[Point3<frame::Camera>]| -> Vec<_> {
            let pair = |(p, m): (&Point3<frame::Camera>, &Point3<frame::Camera>)| Pair {
                measured: *m,
                nominal: pose.inverse() * *p,
                covariance: Matrix3::from_diagonal(&Vector3::new(1.0, 2.0, 0.3)),
            };
            points.iter().zip(measured).map(pair).collect()
        };
        let spread: Vec<PointJacobian> = points
            .iter()
            .map(|p| Sensitivity::new(&truth, Axis::Column, p).expect("in front").point * errors)
            .collect();
        let exact = pairs(&points);
        let stated = register(&exact).expect("a pose").response(&exact, &spread);
        let stated = stated * stated.transpose();
        let mut noise = Noise::new(7);
        let mut sampled = Matrix6::zeros();
        for _ in 0..draws {
            let off = errors * SVector::<f64, 24>::from_fn(|_, _| noise.gauss());
            let drawn = (0..PARAMETERS.len()).fold(truth.clone(), |rig, k| changed(&rig, k, off[k]));
            let measured = points.map(|p| {
                let pixel = truth.camera.project(&p.xyz).expect("in front");
                let at = projector_coordinate(&truth, Axis::Column, &p).expect("in front");
                let ray = drawn.camera.ray(&pixel).expect("inside");
                Point3::new(ray * triangulate(&drawn, &ray, Axis::Column, at).expect("they meet").0)
            });
            let got = register(&pairs(&measured)).expect("a pose");
            let small = pose.inverse() * got.a_from_b;
            let (dt, w) = (small * got.at - got.at, small.r.scaled_axis());
            let e = Vector6::new(dt.x, dt.y, dt.z, w.x, w.y, w.z);
            sampled += e * e.transpose() / f64::from(draws);
        }
        for i in 0..6 {
            for j in 0..6 {
                let off = (sampled[(i, j)] - stated[(i, j)]) / (stated[(i, i)] * stated[(j, j)]).sqrt();
                assert!(off.abs() < 0.04, "{i},{j} off by {off:.3}"); // 20 000 draws: 0.01
            }
        }
    }
}
