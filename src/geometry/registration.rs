//! Rigid registration of a few measured points to nominal ones, each with its own covariance.
//! In:  pairs (measured in A, nominal in B, 3×3 covariance in B's axes, mm²). Out: `a_from_b`, its covariance, residuals.
//! Start: Kabsch, Acta Cryst. A32 (1976) 922, with the reflection guard of Umeyama, PAMI 13 (1991) 376;
//! then Gauss–Newton on the weighted residuals, which is where the covariance comes from.

use super::{Point3, Pose, skew};
use crate::lent::List;
use nalgebra::{Matrix3, Matrix3x6, Matrix6, Rotation3, SMatrix, SVector, Vector3, Vector6};

/// One point known in both frames.
#[derive(Debug, Clone, Copy)]
pub struct Pair<A, B> {
    /// As measured, in A.
    pub measured: Point3<A>,
    /// As it should be, in B.
    pub nominal: Point3<B>,
    /// Covariance of `measured` less `nominal`, in A's axes, mm².
    pub covariance: Matrix3<f64>,
}

/// A pose and how well it is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Registration<A, B> {
    /// The pose that carries nominal points to measured ones.
    pub a_from_b: Pose<A, B>,
    /// Covariance of [translation of the point `at`, rotation vector] in B's axes, mm and rad, of the small
    /// motion `inverse(true)·measured`.
    pub covariance: Matrix6<f64>,
    /// The centroid of the nominal points, in B.
    pub at: Point3<B>,
    /// Per pair: measured less nominal in B's axes, mm.
    pub residuals: List<Vector3<f64>>,
    /// Σ rᵀ·Σ⁻¹·r over the pairs; 3n − 6 degrees of freedom.
    pub chi2: f64,
}

impl<A, B> Registration<A, B> {
    /// How the motion `inverse(true)·measured` follows the points: what it is per unit of errors that shift each
    /// measured point of `pairs`, the ones registered, by `shifts` (A's axes, mm per unit; one column per error).
    pub fn response<const N: usize>(&self, pairs: &[Pair<A, B>], shifts: &[SMatrix<f64, 3, N>]) -> SMatrix<f64, 6, N> {
        let to_b = self.a_from_b.r.inverse();
        let gained = |(index, (pair, shift)): (usize, (&Pair<A, B>, &SMatrix<f64, 3, N>))| {
            let weight = weight(pair, &self.a_from_b, index).expect("it was registered with it");
            motion_jacobian(&pair.nominal.xyz, &self.at.xyz).transpose() * weight * (to_b * shift)
        };
        self.covariance * pairs.iter().zip(shifts).enumerate().map(gained).sum::<SMatrix<f64, 6, N>>()
    }

    /// `chi2` of the residuals when each point of `pairs`, the ones registered, may also be off by `shifts`, as in
    /// [`Self::response`], times independent errors of variance 1 that the points share.
    pub fn chi2_granting<const N: usize>(&self, pairs: &[Pair<A, B>], shifts: &[SMatrix<f64, 3, N>]) -> f64 {
        let to_b = self.a_from_b.r.inverse();
        let moved = self.response(pairs, shifts);
        // the residuals' covariance is that of the points plus that of the errors: inverted by Woodbury's identity
        let (mut normal, mut right) = (SMatrix::<f64, N, N>::identity(), SVector::<f64, N>::zeros());
        for (index, ((pair, shift), residual)) in pairs.iter().zip(shifts).zip(&self.residuals).enumerate() {
            let left = to_b * shift - motion_jacobian(&pair.nominal.xyz, &self.at.xyz) * moved;
            let weight = weight(pair, &self.a_from_b, index).expect("it was registered with it");
            normal += left.transpose() * weight * left;
            right += left.transpose() * (weight * residual);
        }
        normal.cholesky().map_or(f64::INFINITY, |factor| self.chi2 - right.dot(&factor.solve(&right)))
    }
}

/// Why points do not determine a pose.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum NoPose {
    /// Three are needed.
    #[error("{got} points, at least 3 are needed")]
    TooFew {
        /// Points given.
        got: usize,
    },
    /// The nominal or the measured points lie (nearly) on one line.
    #[error(
        "the points lie on one line: their spread across it is {ratio:.3} of that along it, at least {MIN_SPREAD} is needed"
    )]
    Collinear {
        /// Second over first singular value of the centred points.
        ratio: f64,
    },
    /// A covariance is not positive definite.
    #[error("the covariance of point {index} is not positive definite")]
    BadCovariance {
        /// Index of the pair.
        index: usize,
    },
}

/// Least second singular value over the first of centred points that determine a pose.
pub const MIN_SPREAD: f64 = 0.05;

/// How far the points are from one line: second over first singular value of the centred coordinates.
pub fn spread(points: impl Iterator<Item = Vector3<f64>> + Clone) -> f64 {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector3<f64>>() / n;
    let scatter: Matrix3<f64> = points.map(|p| (p - mean) * (p - mean).transpose()).sum();
    let mut s = scatter.symmetric_eigenvalues();
    s.as_mut_slice().sort_by(|a, b| b.total_cmp(a));
    if s[0] > 0.0 { (s[1].max(0.0) / s[0]).sqrt() } else { 0.0 }
}

/// Registers `pairs`: least squares weighted by the inverse covariances.
pub fn register<A, B>(pairs: &[Pair<A, B>]) -> Result<Registration<A, B>, NoPose> {
    if pairs.len() < 3 {
        return Err(NoPose::TooFew { got: pairs.len() });
    }
    let ratio = spread(pairs.iter().map(|p| p.nominal.xyz)).min(spread(pairs.iter().map(|p| p.measured.xyz)));
    if ratio.is_nan() || ratio < MIN_SPREAD {
        return Err(NoPose::Collinear { ratio });
    }
    let at = pairs.iter().map(|p| p.nominal.xyz).sum::<Vector3<f64>>() / pairs.len() as f64;
    let mut pose = kabsch(pairs);
    let mut solved = None;
    for _ in 0..20 {
        let (normal, right) = normal_equations(pairs, &pose, &at)?;
        let covariance = normal.cholesky().ok_or(NoPose::Collinear { ratio })?.inverse();
        let step: Vector6<f64> = covariance * right;
        // T ← T·δ with δ(p) = at + dt + exp(ω)·(p − at)
        let turn = Rotation3::new(Vector3::new(step[3], step[4], step[5]));
        let small = Pose::<B, B>::new(turn, at + Vector3::new(step[0], step[1], step[2]) - turn * at);
        pose = pose * small;
        solved = Some(covariance);
        if step.amax() < 1e-12 {
            break;
        }
    }
    let covariance = solved.expect("the loop runs at least once");
    let mut chi2 = 0.0;
    let residuals = List::of(pairs.iter().map(|pair| residual(pair, &pose)));
    for (index, (pair, r)) in pairs.iter().zip(&residuals).enumerate() {
        chi2 += r.dot(&(weight(pair, &pose, index)? * r));
    }
    Ok(Registration { a_from_b: pose, covariance, at: Point3::new(at), residuals, chi2 })
}

/// ∂ r / ∂ [translation at `at`, rotation vector] of a point nominally at `p`, B's axes.
pub fn motion_jacobian(p: &Vector3<f64>, at: &Vector3<f64>) -> Matrix3x6<f64> {
    let mut j = Matrix3x6::zeros();
    j.fixed_view_mut::<3, 3>(0, 0).copy_from(&Matrix3::identity());
    j.fixed_view_mut::<3, 3>(0, 3).copy_from(&-skew(&(p - at)));
    j
}

fn residual<A, B>(pair: &Pair<A, B>, pose: &Pose<A, B>) -> Vector3<f64> {
    pose.inverse() * pair.measured - pair.nominal
}

/// Inverse covariance in B's axes.
fn weight<A, B>(pair: &Pair<A, B>, pose: &Pose<A, B>, index: usize) -> Result<Matrix3<f64>, NoPose> {
    let inverse = pair.covariance.cholesky().ok_or(NoPose::BadCovariance { index })?.inverse();
    Ok(pose.r.inverse() * inverse * pose.r)
}

fn normal_equations<A, B>(
    pairs: &[Pair<A, B>],
    pose: &Pose<A, B>,
    at: &Vector3<f64>,
) -> Result<(Matrix6<f64>, Vector6<f64>), NoPose> {
    let (mut normal, mut right) = (Matrix6::zeros(), Vector6::zeros());
    for (index, pair) in pairs.iter().enumerate() {
        let j = motion_jacobian(&pair.nominal.xyz, at);
        let jw = j.transpose() * weight(pair, pose, index)?;
        normal += jw * j;
        right += jw * residual(pair, pose);
    }
    Ok((normal, right))
}

/// Unweighted closed form.
fn kabsch<A, B>(pairs: &[Pair<A, B>]) -> Pose<A, B> {
    let n = pairs.len() as f64;
    let p_mean = pairs.iter().map(|p| p.nominal.xyz).sum::<Vector3<f64>>() / n;
    let q_mean = pairs.iter().map(|p| p.measured.xyz).sum::<Vector3<f64>>() / n;
    let h: Matrix3<f64> = pairs.iter().map(|p| (p.measured.xyz - q_mean) * (p.nominal.xyz - p_mean).transpose()).sum();
    let svd = h.svd(true, true);
    let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    // nalgebra sorts singular values downwards, so the last column is the one to flip
    let mut d = Matrix3::identity();
    d[(2, 2)] = (u * v_t).determinant().signum();
    let r = Rotation3::from_matrix_unchecked(u * d * v_t);
    Pose::new(r, q_mean - r * p_mean)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::frame::{Camera, Vehicle};
    use crate::testing::Noise;

    fn vector(noise: &mut Noise) -> Vector3<f64> {
        Vector3::new(noise.gauss(), noise.gauss(), noise.gauss())
    }

    const NOMINAL: [[f64; 3]; 4] =
        [[-2476.1, 873.9, 671.1], [-2780.7, 869.2, 681.8], [-2618.0, 866.7, 874.0], [-2640.0, 874.6, 710.0]];

    fn pairs(pose: &Pose<Camera, Vehicle>, n: usize, noise: &mut Noise) -> Vec<Pair<Camera, Vehicle>> {
        (0..n)
            .map(|k| {
                let nominal = Point3::new(Vector3::from(NOMINAL[k]));
                // anisotropic, different for each point
                let l = Matrix3::new(0.05 + 0.02 * k as f64, 0.0, 0.0, 0.02, 0.04, 0.0, 0.0, -0.01, 0.1);
                let measured = Point3::new((*pose * nominal).xyz + l * vector(noise));
                Pair { measured, nominal, covariance: l * l.transpose() }
            })
            .collect()
    }

    #[test]
    fn exact_points_give_the_exact_pose_also_when_coplanar_or_far_turned() {
        arbtest::arbtest(|u| {
            let mut angle = || Ok::<_, arbtest::arbitrary::Error>(f64::from(u.arbitrary::<i16>()?) / 32768.0 * 3.1);
            let pose = Pose::<Camera, Vehicle>::new(
                Rotation3::from_euler_angles(angle()?, angle()?, angle()?),
                Vector3::new(-2645.0, 777.0, 1656.0),
            );
            for n in [3, 4] {
                let mut exact = pairs(&pose, n, &mut Noise::new(1));
                for p in &mut exact {
                    p.measured = pose * p.nominal;
                }
                let got = register(&exact).expect("three points span a triangle");
                assert!((got.a_from_b.r.matrix() - pose.r.matrix()).amax() < 1e-9);
                assert!((got.a_from_b * got.at - pose * got.at).norm() < 1e-8);
                assert!((got.a_from_b.r.matrix().determinant() - 1.0).abs() < 1e-9);
            }
            Ok(())
        });
    }

    #[test]
    fn covariance_is_that_of_a_monte_carlo_run() {
        let pose = Pose::<Camera, Vehicle>::new(
            Rotation3::from_euler_angles(1.6, 0.02, 3.1),
            Vector3::new(-2645.0, 777.0, 1656.0),
        );
        for n in [3, 4] {
            let (mut noise, draws) = (Noise::new(5), 20_000);
            let (mut sampled, mut stated, mut chi2) = (Matrix6::zeros(), Matrix6::zeros(), 0.0);
            for _ in 0..draws {
                let got = register(&pairs(&pose, n, &mut noise)).expect("a triangle");
                let small = pose.inverse() * got.a_from_b;
                let dt = small * got.at - got.at;
                let w = small.r.scaled_axis();
                let e = Vector6::new(dt.x, dt.y, dt.z, w.x, w.y, w.z);
                sampled += e * e.transpose() / f64::from(draws);
                stated += got.covariance / f64::from(draws);
                chi2 += got.chi2 / f64::from(draws);
            }
            // in units of sigma: every entry of the correlation, not only the diagonal
            for i in 0..6 {
                for j in 0..6 {
                    let unit = (stated[(i, i)] * stated[(j, j)]).sqrt();
                    let off = (sampled[(i, j)] - stated[(i, j)]) / unit;
                    assert!(off.abs() < 0.05, "n {n}: {i},{j} off by {off:.3}"); // 20 000 draws: 0.01
                }
            }
            let degrees = (3 * n - 6) as f64;
            assert!((chi2 / degrees - 1.0).abs() < 0.03, "n {n}: chi2 {chi2:.3} of {degrees}");
        }
    }

    #[test]
    fn shared_errors_are_granted_in_chi2_and_none_change_nothing() {
        let pose = Pose::<Camera, Vehicle>::new(
            Rotation3::from_euler_angles(1.6, 0.02, 3.1),
            Vector3::new(-2645.0, 777.0, 1656.0),
        );
        let (mut noise, draws, mut mean) = (Noise::new(6), 4000, 0.0);
        for _ in 0..draws {
            let mut pairs = pairs(&pose, 3, &mut noise);
            let shifts: Vec<SMatrix<f64, 3, 2>> = pairs
                .iter()
                .map(|p| SMatrix::from_columns(&[p.measured.xyz * 3e-3, skew(&p.measured.xyz).column(1) * 2e-3]))
                .collect();
            let error = nalgebra::Vector2::new(noise.gauss(), noise.gauss());
            pairs.iter_mut().zip(&shifts).for_each(|(p, shift)| p.measured.xyz += shift * error);
            let got = register(&pairs).expect("a triangle");
            assert!((got.chi2_granting(&pairs, &[SMatrix::<f64, 3, 2>::zeros(); 3]) / got.chi2 - 1.0).abs() < 1e-6);
            mean += got.chi2_granting(&pairs, &shifts) / f64::from(draws);
        }
        assert!((mean / 3.0 - 1.0).abs() < 0.06, "{mean:.3} of 3 degrees of freedom"); // 4000 draws: 0.013
    }

    #[test]
    fn two_points_and_points_on_a_line_are_refused() {
        let pose = Pose::<Camera, Vehicle>::identity();
        let four = pairs(&pose, 4, &mut Noise::new(1));
        assert_eq!(register(&four[..2]).unwrap_err(), NoPose::TooFew { got: 2 });
        let line: Vec<_> = (0..3)
            .map(|k| {
                let p = Vector3::new(f64::from(k) * 150.0, if k == 1 { 3.0 } else { 0.0 }, 0.0);
                Pair {
                    measured: Point3::<Camera>::new(p),
                    nominal: Point3::<Vehicle>::new(p),
                    covariance: Matrix3::identity(),
                }
            })
            .collect();
        assert!(matches!(register(&line).unwrap_err(), NoPose::Collinear { .. }));
    }

    #[test]
    fn a_mirrored_body_leaves_residuals_and_no_reflection() {
        let pose = Pose::<Camera, Vehicle>::identity();
        let mut mirrored = pairs(&pose, 4, &mut Noise::new(3));
        for p in &mut mirrored {
            p.measured.xyz.x = -p.measured.xyz.x;
        }
        let got = register(&mirrored).expect("a triangle");
        assert!((got.a_from_b.r.matrix().determinant() - 1.0).abs() < 1e-9);
    }
}
