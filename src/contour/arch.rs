//! The top of an arch. In: points of its edge, along and up, mm. Out: where it is highest, with covariance.
//! Not here: which way is up: callers turn the points so, from the vehicle's pose.

use crate::geometry::robust::{start, weigh};
use nalgebra::{DMatrix, DVector, Matrix2, RowDVector};
use std::iter::repeat_n;

/// Where an arch is highest.
#[derive(Clone, Debug, PartialEq)]
pub struct ArchTop {
    /// Along, mm.
    pub along: f64,
    /// Up, mm.
    pub height: f64,
    /// Of (along, height), mm², from the stated variances alone: strong in height, weak along.
    pub covariance: Matrix2<f64>,
    /// Of curvature at the top, mm: a turn of the frame by an angle moves the top along by so much times it.
    pub radius: f64,
    /// Of the polynomial, 2..=4.
    pub order: usize,
    /// Scatter of the points over their stated sigmas, at least 1.
    pub scale: f64,
}

/// Why an arch has no top.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoArchTop {
    /// A quartic has five unknowns.
    #[error("{got} points within the window, at least 10 needed")]
    TooFewPoints {
        /// Points inside.
        got: usize,
    },
    /// The points lie at too few places along.
    #[error("the points fix no curve")]
    Degenerate,
    /// It rises to an end of the window, or is hollow.
    #[error("no maximum inside the window")]
    NoMaximum,
}

/// The maximum of the polynomial through `points` (along, height, variance of height; mm, mm²) at most `window` mm
/// from `centre`.
///
/// Its order, 2 to 4, is the one of least BIC (Schwarz, Annals of Statistics 6, 1978). For a parabola of radius R at
/// the top, n points: `σ_along = R·σ·√(3/n)/window`, `σ_height = 1.5·σ/√n`; a cubic has 2.5 times that σ_along.
/// One parabola in 100 is taken for a cubic, then with an error along of 3 of the cubic's sigmas; a stricter choice
/// would hide real cubics of that size instead.
pub fn arch_top(points: &[(f64, f64, f64)], centre: f64, window: f64) -> Result<ArchTop, NoArchTop> {
    let inside: Vec<_> = points.iter().filter(|p| (p.0 - centre).abs() <= window).copied().collect();
    if inside.len() < 10 {
        return Err(NoArchTop::TooFewPoints { got: inside.len() });
    }
    let scaled: Vec<_> = inside.iter().map(|(s, h, v)| ((s - centre) / window, *h, *v)).collect();
    let fits = (2..=4).map(|order| Polynomial::fit(&scaled, order)).collect::<Option<Vec<_>>>();
    let fits = fits.ok_or(NoArchTop::Degenerate)?;
    // One scale for all orders: that of the most flexible, as a too stiff curve would excuse itself by its own scatter.
    let scale = fits[2].scale;
    let bic = |f: &&Polynomial| f.misfit(&scaled, scale) + f.coefficients.len() as f64 * (scaled.len() as f64).ln();
    let best = fits.iter().min_by(|a, b| bic(a).total_cmp(&bic(b))).ok_or(NoArchTop::Degenerate)?;
    let top = best.maximum().ok_or(NoArchTop::NoMaximum)?;
    let order = best.coefficients.len() - 1;
    let row = |times: usize| RowDVector::from_row_slice(&powers(top, order, times)[..=order]);
    let along = -row(1) / best.value(top, 2);
    let height = row(0);
    let spread = |a: &RowDVector<f64>, b: &RowDVector<f64>| (a * &best.covariance * b.transpose())[0];
    let cross = spread(&along, &height) * window;
    Ok(ArchTop {
        along: centre + window * top,
        height: best.value(top, 0),
        covariance: Matrix2::new(spread(&along, &along) * window * window, cross, cross, spread(&height, &height)),
        radius: window * window / best.value(top, 2).abs(),
        order,
        scale,
    })
}

/// A polynomial over −1..=1.
struct Polynomial {
    coefficients: DVector<f64>,
    covariance: DMatrix<f64>,
    scale: f64,
}

impl Polynomial {
    /// Robust least squares over (x, value, variance); `None` where the places do not fix one.
    fn fit(points: &[(f64, f64, f64)], order: usize) -> Option<Self> {
        let few = |few: &mut dyn Iterator<Item = usize>| Self::solve(few.map(|k| (points[k], 1.0)), order);
        let mut fit = start(points.len(), few, |f| f.residuals(points))?;
        for _ in 0..30 {
            let (weights, scale) = weigh(&fit.residuals(points));
            let next = Self::solve(points.iter().copied().zip(weights), order)?;
            let change = (&next.coefficients - &fit.coefficients).amax();
            fit = Self { scale, ..next };
            if change < 1e-9 {
                break;
            }
        }
        Some(fit)
    }

    /// Least squares of weighted points.
    fn solve(points: impl Iterator<Item = ((f64, f64, f64), f64)>, order: usize) -> Option<Self> {
        let (mut a, mut b) = ([[0.0; TERMS]; TERMS], [0.0; TERMS]);
        for ((x, value, variance), weight) in points {
            let row = powers(x, order, 0);
            for i in 0..=order {
                b[i] += row[i] * (value * weight / variance);
                for j in 0..=order {
                    a[i][j] += row[i] * row[j] * (weight / variance);
                }
            }
        }
        let factor = DMatrix::from_fn(order + 1, order + 1, |i, j| a[i][j]).cholesky()?;
        let b = DVector::from_row_slice(&b[..=order]);
        Some(Self { coefficients: factor.solve(&b), covariance: factor.inverse(), scale: 1.0 })
    }

    /// The value at `x`, derived `times` times.
    fn value(&self, x: f64, times: usize) -> f64 {
        let powers = powers(x, self.coefficients.len() - 1, times);
        self.coefficients.iter().zip(powers).map(|(c, p)| c * p).sum()
    }

    fn residuals(&self, points: &[(f64, f64, f64)]) -> Vec<f64> {
        points.iter().map(|(x, value, variance)| (value - self.value(*x, 0)) / variance.sqrt()).collect()
    }

    /// Squared residuals over `scale`, each at most 3 squared.
    fn misfit(&self, points: &[(f64, f64, f64)], scale: f64) -> f64 {
        self.residuals(points).iter().map(|r| (r / scale).powi(2).min(9.0)).sum()
    }

    /// Where the value is largest; `None` if that is not inside −1..1.
    fn maximum(&self) -> Option<f64> {
        let places = (-50..=50).map(|k| f64::from(k) / 50.0);
        let mut x = places.max_by(|a, b| self.value(*a, 0).total_cmp(&self.value(*b, 0)))?;
        for _ in 0..20 {
            let curvature = self.value(x, 2);
            if curvature >= 0.0 {
                return None;
            }
            x -= self.value(x, 1) / curvature;
        }
        (x.abs() < 1.0).then_some(x)
    }
}

/// Coefficients of the highest order.
const TERMS: usize = 5;

/// The powers of `x`, 0 to `order`, derived `times` times; then zeros.
fn powers(x: f64, order: usize, times: usize) -> [f64; TERMS] {
    let power = |k: usize| {
        let factor: f64 = (0..times).map(|t| k as f64 - t as f64).product(); // 0 where k < times
        factor * repeat_n(x, k.saturating_sub(times)).product::<f64>()
    };
    std::array::from_fn(|k| if k <= order { power(k) } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Noise, mean_std};

    const SIGMA: f64 = 0.03;
    const RADIUS: f64 = 350.0;

    /// `n` points of an arch of shape `f` along ±60 mm about its top at (12, 700), `outliers` of them 1 mm up.
    fn arch(n: usize, f: impl Fn(f64) -> f64, outliers: usize, noise: &mut Noise) -> Vec<(f64, f64, f64)> {
        let point = |k: usize| {
            let s = -60.0 + 120.0 * (k as f64 + 0.5) / n as f64;
            let off = if (20..20 + outliers).contains(&k) { 1.0 } else { 0.0 };
            (12.0 + s, 700.0 + f(s) + SIGMA * noise.gauss() + off, SIGMA * SIGMA)
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn a_parabolas_top_is_as_uncertain_as_the_formulas_say() {
        let (mut noise, n, trials) = (Noise::new(11), 400, 400);
        let (mut along, mut height, mut stated) = (Vec::new(), Vec::new(), Matrix2::zeros());
        for _ in 0..trials {
            let top = arch_top(&arch(n, |s| -s * s / (2.0 * RADIUS), 0, &mut noise), 12.0, 60.0).expect("an arch");
            along.push(top.along - 12.0);
            height.push(top.height - 700.0);
            stated += top.covariance / f64::from(trials);
        }
        let formula = (RADIUS * SIGMA * (3.0 / n as f64).sqrt() / 60.0, 1.5 * SIGMA / (n as f64).sqrt());
        let seen = (mean_std(&along).1, mean_std(&height).1);
        eprintln!(
            "top: along {:.4} mm (formula {:.4}), height {:.5} mm (formula {:.5})",
            seen.0, formula.0, seen.1, formula.1
        );
        let near = |a: f64, b: f64| (a / b - 1.0).abs() < 0.1;
        assert!(near(stated[(0, 0)].sqrt(), formula.0) && near(stated[(1, 1)].sqrt(), formula.1), "{stated}");
        assert!(seen.0 < 1.3 * formula.0 && seen.1 < 1.1 * formula.1, "{seen:?} {formula:?}"); // now and then a cubic wins
    }

    #[test]
    fn a_lopsided_circle_takes_a_higher_order_and_outliers_do_not_move_it() {
        let mut noise = Noise::new(12);
        let shape = |s: f64| (RADIUS * RADIUS - s * s).sqrt() - RADIUS + 4e-6 * s.powi(3);
        let points = arch(400, shape, 80, &mut noise);
        let top = arch_top(&points, 20.0, 50.0).expect("an arch");
        assert!(top.order > 2, "{top:?}");
        let error = nalgebra::Vector2::new(top.along - 12.0, top.height - 700.0);
        let chi2 = (error.transpose() * top.covariance.try_inverse().expect("regular") * error)[0];
        assert!(chi2 < 14.0 && error.y.abs() < 0.02, "{top:?}"); // 1 in 1000
    }

    #[test]
    fn a_slope_a_hollow_and_too_few_points_are_refused() {
        let mut noise = Noise::new(13);
        assert_eq!(arch_top(&arch(200, |s| 0.1 * s, 0, &mut noise), 12.0, 60.0), Err(NoArchTop::NoMaximum));
        assert_eq!(arch_top(&arch(200, |s| s * s / 700.0, 0, &mut noise), 12.0, 60.0), Err(NoArchTop::NoMaximum));
        let points = arch(200, |s| -s * s / 700.0, 0, &mut noise);
        assert_eq!(arch_top(&points, 100.0, 30.0), Err(NoArchTop::TooFewPoints { got: 3 }));
        assert_eq!(arch_top(&[(0.0, 1.0, 1.0); 20], 0.0, 5.0), Err(NoArchTop::Degenerate));
    }
}
