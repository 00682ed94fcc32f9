//! Ellipses through edge points. In: points with their variances, px or mm. Out: an ellipse with its covariance,
//! or why there is none. Not here: which points, what the ellipse is the image of.
//!
//! Start: Halíř, Flusser, "Numerically stable direct least squares fitting of ellipses", WSCG 1998. Then orthogonal
//! distances by Gauss–Newton with Tukey weights. The shape is a symmetric matrix M, the ellipse `c + M·(cos, sin)`:
//! axes and angle would be singular at a circle, M is not.

use crate::geometry::robust::{Weights, start, truncated};
use crate::lent::List;
use nalgebra::{Matrix2, Matrix3, Matrix5, SMatrix, SymmetricEigen, Vector2, Vector3, Vector5};
use std::f64::consts::TAU;
use std::ops::RangeInclusive;

/// The curve `centre + shape·(cos t, sin t)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ellipse {
    /// Centre, in the points' unit.
    pub centre: Vector2<f64>,
    /// Symmetric, positive definite: its eigenvalues are the semi-axes, its eigenvectors their directions.
    pub shape: Matrix2<f64>,
}

impl Ellipse {
    /// From semi-axes, and the direction (rad, from x towards y) of the first of them.
    pub fn from_axes(centre: Vector2<f64>, a: f64, b: f64, angle: f64) -> Self {
        let r = *nalgebra::Rotation2::new(angle).matrix();
        Self { centre, shape: r * Matrix2::new(a, 0.0, 0.0, b) * r.transpose() }
    }

    /// Semi-major and semi-minor axis.
    pub fn semi_axes(&self) -> (f64, f64) {
        let axes = self.shape.symmetric_eigenvalues();
        (axes.max(), axes.min())
    }

    /// The point at parameter `t`, rad.
    pub fn at(&self, t: f64) -> Vector2<f64> {
        self.centre + self.shape * Vector2::new(t.cos(), t.sin())
    }

    /// Distances of `points` over their sigmas to first order (Sampson's): |M⁻¹(p − c)| − 1 over its slope.
    fn approx_distances(&self, points: &[(Vector2<f64>, f64)]) -> impl Iterator<Item = f64> {
        let inverse = self.shape.try_inverse().unwrap_or_default();
        points.iter().map(move |(p, variance)| {
            let u = inverse * (p - self.centre);
            (u.norm() - 1.0) * u.norm() / ((inverse * u).norm() * variance.sqrt())
        })
    }

    /// The (cos t, sin t) of the point of the ellipse nearest to each of `points`.
    fn feet(&self, points: &[(Vector2<f64>, f64)]) -> impl Iterator<Item = Vector2<f64>> {
        let eigen = SymmetricEigen::new(self.shape);
        let (q, axes) = (eigen.eigenvectors, eigen.eigenvalues);
        points.iter().map(move |(p, _)| {
            let y = q.transpose() * (p - self.centre);
            let z = Vector2::new((axes.x * y.x).abs(), (axes.y * y.y).abs()).map(|v| v.max(1e-12 * axes.max().powi(2)));
            // The foot's (cos t, sin t) is z/(s + axes²) per axis, of length 1: s by Newton from its lower end, from
            // where the squared length falls and is convex. Eberly, "Distance from a point to an ellipse", 2013.
            let mut s = (z.x - axes.x * axes.x).max(z.y - axes.y * axes.y);
            for _ in 0..60 {
                let d = Vector2::new(s + axes.x * axes.x, s + axes.y * axes.y);
                let u = z.component_div(&d);
                let step = 0.5 * (u.norm_squared() - 1.0) / (u.x * u.x / d.x + u.y * u.y / d.y);
                s += step;
                if step.abs() < 1e-13 * axes.max().powi(2) {
                    break;
                }
            }
            let u = Vector2::new(z.x / (s + axes.x * axes.x), z.y / (s + axes.y * axes.y)).normalize();
            q * Vector2::new(u.x.copysign(y.x), u.y.copysign(y.y))
        })
    }
}

/// What the caller takes for an ellipse.
#[derive(Clone, Debug, PartialEq)]
pub struct EllipseLimits {
    /// Least share of the full turn that must be seen, 0..=1.
    pub coverage: f64,
    /// Semi-axes, in the points' unit.
    pub semi_axes: RangeInclusive<f64>,
}

/// An ellipse and how well it is known.
#[derive(Clone, Debug, PartialEq)]
pub struct EllipseFit {
    /// The curve.
    pub ellipse: Ellipse,
    /// Of (centre x, y, shape xx, xy, yy), from the stated variances alone.
    pub covariance: Matrix5<f64>,
    /// Share of the full turn with points on the curve, in steps of 10°.
    pub coverage: f64,
    /// Sum of weighted squared distances over their variances.
    pub chi2: f64,
    /// Sum of the weights: points that the fit rests on, of all that were given.
    pub weight: f64,
    /// Scatter of the points over their stated sigmas, at least 1.
    pub scale: f64,
}

impl EllipseFit {
    /// Covariance of the centre.
    pub fn centre_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }
}

/// Why there is no ellipse.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoEllipse {
    /// An ellipse has 5 unknowns, and one point is to check with.
    #[error("{got} points, at least 6 needed")]
    TooFewPoints {
        /// Points given.
        got: usize,
    },
    /// A line, two lines, or a fit that ran away.
    #[error("the points lie on no ellipse")]
    Degenerate,
    /// Too little of the curve was seen.
    #[error("{:.0} % of the turn seen, at least {:.0} % wanted", got * 100.0, wanted * 100.0)]
    Coverage {
        /// Share seen.
        got: f64,
        /// Share wanted.
        wanted: f64,
    },
    /// Not the size looked for.
    #[error("semi-axes {major:.2} and {minor:.2} are not those looked for")]
    Axes {
        /// Semi-major axis.
        major: f64,
        /// Semi-minor axis.
        minor: f64,
    },
}

/// Fits an ellipse to `points` with variances (of their distance from the curve; unit²), robustly.
///
/// The centre is within 1.1 of the bound (FIM = Σ jjᵀ/σ²) on a full arc and on half of one; a fifth of the points
/// lying together 10 sigma and more off the curve costs no more than its own loss. Beyond 30 % of such it may fail.
/// The covariance is from the variances as stated: times `scale²` where the scatter is believed instead.
pub fn fit_ellipse(points: &[(Vector2<f64>, f64)], limits: &EllipseLimits) -> Result<EllipseFit, NoEllipse> {
    if points.len() < 6 {
        return Err(NoEllipse::TooFewPoints { got: points.len() });
    }
    let some = |few: &[usize]| direct(few.iter().map(|k| points[*k].0));
    let loss = |e: &Ellipse, most: f64| truncated(e.approx_distances(points), most);
    let mut ellipse = start(points.len(), some, loss).ok_or(NoEllipse::Degenerate)?;
    let mut system = System::default();
    for _ in 0..50 {
        system.build(points, &ellipse);
        let step = system.information.cholesky().ok_or(NoEllipse::Degenerate)?.solve(&system.gradient);
        ellipse.centre += step.fixed_rows::<2>(0);
        ellipse.shape += Matrix2::new(step[2], step[3], step[3], step[4]);
        if !(ellipse.semi_axes().1 > 0.0 && ellipse.semi_axes().0 < 1e9) {
            return Err(NoEllipse::Degenerate);
        }
        if step.amax() < 1e-9 * ellipse.semi_axes().0 {
            break;
        }
    }
    let (major, minor) = ellipse.semi_axes();
    if !(limits.semi_axes.contains(&major) && limits.semi_axes.contains(&minor)) {
        return Err(NoEllipse::Axes { major, minor });
    }
    system.build(points, &ellipse);
    let weights = &system.weights.weights;
    let coverage = coverage(&system.rows, weights);
    if coverage < limits.coverage {
        return Err(NoEllipse::Coverage { got: coverage, wanted: limits.coverage });
    }
    Ok(EllipseFit {
        ellipse,
        covariance: system.information.cholesky().ok_or(NoEllipse::Degenerate)?.inverse(),
        coverage,
        chi2: system.rows.iter().zip(weights).map(|(row, w)| w * row.residual.powi(2)).sum(),
        weight: weights.iter().sum(),
        scale: system.weights.scale,
    })
}

/// The weighted normal equations at an ellipse.
#[derive(Default)]
struct System {
    rows: List<Row>,
    weights: Weights,
    information: Matrix5<f64>,
    gradient: Vector5<f64>,
}

/// What a point says.
struct Row {
    /// (cos t, sin t) of the nearest point of the ellipse.
    foot: Vector2<f64>,
    /// Its distance over its sigma.
    residual: f64,
    /// How that follows the unknowns.
    jacobian: Vector5<f64>,
}

impl System {
    /// At `ellipse`, in the buffers of an earlier one.
    fn build(&mut self, points: &[(Vector2<f64>, f64)], ellipse: &Ellipse) {
        let unit = ellipse.shape.determinant() * ellipse.shape.try_inverse().unwrap_or_default(); // adjugate: normal ∝ M⁻¹u
        let row = |((p, variance), u): (&(Vector2<f64>, f64), Vector2<f64>)| {
            let (n, sigma) = ((unit * u).normalize(), variance.sqrt());
            Row {
                foot: u,
                residual: n.dot(&(p - ellipse.centre - ellipse.shape * u)) / sigma,
                jacobian: Vector5::new(n.x, n.y, n.x * u.x, n.x * u.y + n.y * u.x, n.y * u.y) / sigma,
            }
        };
        self.rows.clear();
        self.rows.extend(points.iter().zip(ellipse.feet(points)).map(row));
        self.weights.weigh(self.rows.iter().map(|row| row.residual));
        (self.information, self.gradient) = (Matrix5::zeros(), Vector5::zeros());
        for (row, weight) in self.rows.iter().zip(&self.weights.weights) {
            self.information += row.jacobian * row.jacobian.transpose() * *weight;
            self.gradient += row.jacobian * (row.residual * weight);
        }
    }
}

/// The share of 36 steps of the turn in which at least one point has half its weight.
fn coverage(rows: &[Row], weights: &[f64]) -> f64 {
    let mut seen = [false; 36];
    for (u, _) in rows.iter().map(|row| row.foot).zip(weights).filter(|(_, w)| **w > 0.5) {
        seen[((u.y.atan2(u.x) / TAU).rem_euclid(1.0) * 36.0) as usize % 36] = true;
    }
    seen.iter().filter(|s| **s).count() as f64 / 36.0
}

/// Halíř and Flusser's direct fit, unweighted. `None` where no ellipse comes out.
fn direct(points: impl ExactSizeIterator<Item = Vector2<f64>> + Clone) -> Option<Ellipse> {
    let n = points.len() as f64;
    let middle = points.clone().sum::<Vector2<f64>>() / n;
    let unit = (points.clone().map(|p| (p - middle).norm_squared()).sum::<f64>() / n).sqrt();
    if unit.is_nan() || unit <= 0.0 {
        return None;
    }
    let (mut s1, mut s2, mut s3) = (Matrix3::zeros(), Matrix3::zeros(), Matrix3::zeros()); // scatter, as in the paper
    for p in points {
        let p = (p - middle) / unit;
        let (d1, d2) = (Vector3::new(p.x * p.x, p.x * p.y, p.y * p.y), Vector3::new(p.x, p.y, 1.0));
        s1 += d1 * d1.transpose();
        s2 += d1 * d2.transpose();
        s3 += d2 * d2.transpose();
    }
    let t = -s3.try_inverse()? * s2.transpose();
    let m = s1 + s2 * t;
    let m = Matrix3::from_rows(&[m.row(2) / 2.0, -m.row(1), m.row(0) / 2.0]); // C1⁻¹·m
    let a1 = m.complex_eigenvalues().iter().find_map(|lambda| {
        let a1 = null_vector(&(m - Matrix3::identity() * lambda.re));
        (4.0 * a1.x * a1.z - a1.y * a1.y > 1e-12).then_some(a1)
    })?;
    let a2 = t * a1;
    // a x² + b xy + c y² + d x + e y + f = 0 as (p − c)ᵀ·A·(p − c) = k
    let quadratic = Matrix2::new(a1.x, a1.y / 2.0, a1.y / 2.0, a1.z);
    let linear = Vector2::new(a2.x, a2.y) / 2.0;
    let centre = -quadratic.try_inverse()? * linear;
    let k = -(a2.z + linear.dot(&centre));
    let eigen = SymmetricEigen::new(quadratic / k); // eigenvalues 1/a², 1/b²
    if eigen.eigenvalues.min() <= 0.0 {
        return None;
    }
    let axes = Matrix2::from_diagonal(&eigen.eigenvalues.map(|v| unit / v.sqrt()));
    let shape = eigen.eigenvectors * axes * eigen.eigenvectors.transpose();
    shape.iter().all(|v| v.is_finite()).then_some(Ellipse { centre: middle + unit * centre, shape })
}

/// The unit vector that a matrix of rank 2 takes to zero.
fn null_vector(m: &SMatrix<f64, 3, 3>) -> Vector3<f64> {
    let rows = [m.row(0).transpose(), m.row(1).transpose(), m.row(2).transpose()];
    let crosses = [rows[0].cross(&rows[1]), rows[1].cross(&rows[2]), rows[2].cross(&rows[0])];
    crosses.into_iter().fold(Vector3::zeros(), |a, b| if b.norm() > a.norm() { b } else { a }).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    const SIGMA: f64 = 0.1;
    const ANY: EllipseLimits = EllipseLimits { coverage: 0.0, semi_axes: 0.0..=1e9 };

    fn truth() -> Ellipse {
        Ellipse::from_axes(Vector2::new(310.0, 255.0), 290.0, 250.0, 0.4)
    }

    /// `n` points along `arc` rad of the truth, off by noise, and by `glint` px outwards on their second fifth.
    fn edge(n: usize, arc: f64, glint: f64, noise: &mut Noise) -> Vec<(Vector2<f64>, f64)> {
        let point = |k: usize| {
            let t = arc * k as f64 / n as f64;
            let u = Vector2::new(t.cos(), t.sin());
            let normal = (truth().shape.try_inverse().expect("a proper ellipse") * u).normalize();
            let off = if (n / 5..2 * n / 5).contains(&k) { glint * (1.0 + 2.0 * noise.uniform()) } else { 0.0 };
            (truth().at(t) + normal * (SIGMA * noise.gauss() + off), SIGMA * SIGMA)
        };
        (0..n).map(point).collect()
    }

    /// Root mean square error of the centre, over the bound (of the good points) and over the stated covariance.
    fn centre_ratios(arc: f64, glint: f64) -> (f64, f64) {
        let (mut noise, trials) = (Noise::new(5), 400);
        let good = (0..600).filter(|k| glint == 0.0 || !(120..240).contains(k));
        let exact: Vec<_> = good.map(|k| (truth().at(arc * f64::from(k) / 600.0), SIGMA * SIGMA)).collect();
        let mut full = System::default();
        full.build(&exact, &truth());
        let full = full.information; // on the curve, every weight is 1
        let bound = full.try_inverse().expect("regular").fixed_view::<2, 2>(0, 0).into_owned();
        let (mut by_bound, mut by_stated) = (0.0, 0.0);
        for _ in 0..trials {
            let fit = fit_ellipse(&edge(600, arc, glint, &mut noise), &ANY).expect("an ellipse");
            let error = fit.ellipse.centre - truth().centre;
            let over = |c: Matrix2<f64>| (error.transpose() * c.try_inverse().expect("regular") * error)[0] / 2.0;
            by_bound += over(bound);
            by_stated += over(fit.centre_covariance());
        }
        ((by_bound / f64::from(trials)).sqrt(), (by_stated / f64::from(trials)).sqrt())
    }

    #[test]
    fn the_centre_reaches_the_bound_and_its_covariance_is_true() {
        let (bound, stated) = centre_ratios(TAU, 0.0);
        let (half_bound, half_stated) = centre_ratios(TAU / 2.0, 0.0);
        eprintln!("centre: full arc {bound:.3} bounds, {stated:.3} sigmas; 180°: {half_bound:.3}, {half_stated:.3}");
        assert!(bound < 1.2 && half_bound < 1.3, "{bound} {half_bound}");
        assert!((0.9..1.1).contains(&stated) && (0.9..1.1).contains(&half_stated), "{stated} {half_stated}");
    }

    #[test]
    fn a_glint_along_a_fifth_of_the_edge_does_not_move_the_centre() {
        let (bound, _) = centre_ratios(TAU, 1.0);
        eprintln!("centre with 20 % off by 1 to 3 px: {bound:.3} bounds of the rest");
        assert!(bound < 1.2, "{bound}");
    }

    #[test]
    fn a_planted_ellipse_is_recovered_also_as_a_circle() {
        arbtest::arbtest(|u| {
            let mut between = |lo: f64, hi: f64| Ok(lo + (hi - lo) * f64::from(u.arbitrary::<u16>()?) / 65535.0);
            let (a, ratio) = (between(5.0, 400.0)?, if between(0.0, 1.0)? < 0.3 { 1.0 } else { between(0.2, 1.0)? });
            let truth = Ellipse::from_axes(
                Vector2::new(between(0.0, 2e3)?, between(0.0, 2e3)?),
                a,
                a * ratio,
                between(-1.5, 1.5)?,
            );
            let points: Vec<_> = (0..40).map(|k| (truth.at(f64::from(k) * 0.157), 0.01)).collect();
            let fit = fit_ellipse(&points, &ANY).expect("40 points on an ellipse");
            // the points are exact, so this is rounding only
            assert!((fit.ellipse.centre - truth.centre).norm() < 1e-7 * a, "{fit:?} for {truth:?}");
            assert!((fit.ellipse.shape - truth.shape).amax() < 1e-7 * a, "{fit:?} for {truth:?}");
            assert!(fit.coverage == 1.0 && fit.chi2 < 1e-9 && fit.scale == 1.0);
            Ok(())
        });
    }

    #[test]
    fn what_is_no_such_ellipse_is_refused() {
        let mut noise = Noise::new(9);
        let line: Vec<_> = (0..50).map(|k| (Vector2::new(f64::from(k), 2.0 * f64::from(k)), 0.01)).collect();
        assert_eq!(fit_ellipse(&line, &ANY).err(), Some(NoEllipse::Degenerate));
        assert_eq!(fit_ellipse(&line[..5], &ANY).err(), Some(NoEllipse::TooFewPoints { got: 5 }));
        let half = edge(300, TAU / 2.0, 0.0, &mut noise);
        let refused = fit_ellipse(&half, &EllipseLimits { coverage: 0.7, ..ANY });
        assert!(matches!(refused, Err(NoEllipse::Coverage { got, .. }) if (0.45..0.6).contains(&got)), "{refused:?}");
        let refused = fit_ellipse(&half, &EllipseLimits { semi_axes: 200.0..=270.0, ..ANY });
        assert!(matches!(refused, Err(NoEllipse::Axes { major, .. }) if (major - 290.0).abs() < 2.0), "{refused:?}");
        let message = NoEllipse::Coverage { got: 0.5, wanted: 0.7 }.to_string();
        assert_eq!(message, "50 % of the turn seen, at least 70 % wanted");
    }
}
