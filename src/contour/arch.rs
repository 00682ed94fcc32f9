//! The top of an arch. In: points of its edge, along and up, mm. Out: where it is highest, with covariance.
//! Not here: which way is up: callers turn the points so, from the vehicle's pose.

use crate::geometry::robust::{Weights, start, truncated};
use crate::lent::List;
use nalgebra::{Matrix2, SMatrix, SVector};
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
    let inside = List::of(points.iter().filter(|p| (p.0 - centre).abs() <= window).copied());
    if inside.len() < 10 {
        return Err(NoArchTop::TooFewPoints { got: inside.len() });
    }
    let scaled = List::of(inside.iter().map(|(s, h, v)| ((s - centre) / window, *h, *v)));
    let fit = |order| Polynomial::fit(&scaled, order).ok_or(NoArchTop::Degenerate);
    let fits = [fit(2)?, fit(3)?, fit(4)?];
    // One scale for all orders: that of the most flexible, as a too stiff curve would excuse itself by its own scatter.
    let scale = fits[2].scale;
    let bic = |f: &&Polynomial| f.misfit(&scaled, scale) + (f.order + 1) as f64 * (scaled.len() as f64).ln();
    let best = fits.iter().min_by(|a, b| bic(a).total_cmp(&bic(b))).ok_or(NoArchTop::Degenerate)?;
    let top = best.maximum().ok_or(NoArchTop::NoMaximum)?;
    let along = -powers(top, best.order, 1) / best.value(top, 2);
    let height = powers(top, best.order, 0);
    let spread = |a: &Row, b: &Row| a.dot(&(best.covariance * b));
    let cross = spread(&along, &height) * window;
    Ok(ArchTop {
        along: centre + window * top,
        height: best.value(top, 0),
        covariance: Matrix2::new(spread(&along, &along) * window * window, cross, cross, spread(&height, &height)),
        radius: window * window / best.value(top, 2).abs(),
        order: best.order,
        scale,
    })
}

/// A polynomial over −1..=1.
struct Polynomial {
    order: usize,
    /// Zeros after those of the order; so in the covariance.
    coefficients: Row,
    covariance: SMatrix<f64, TERMS, TERMS>,
    scale: f64,
}

impl Polynomial {
    /// Robust least squares over (x, value, variance); `None` where the places do not fix one.
    fn fit(points: &[(f64, f64, f64)], order: usize) -> Option<Self> {
        let few = |few: &[usize]| Self::solve(few.iter().map(|k| (points[*k], 1.0)), order);
        let mut fit = start(points.len(), few, |f, most| truncated(f.residuals(points), most))?;
        let mut weights = Weights::default();
        for _ in 0..30 {
            weights.weigh(fit.residuals(points));
            let next = Self::solve(points.iter().copied().zip(weights.weights.iter().copied()), order)?;
            let change = (next.coefficients - fit.coefficients).amax();
            fit = Self { scale: weights.scale, ..next };
            if change < 1e-9 {
                break;
            }
        }
        Some(fit)
    }

    /// Least squares of weighted points.
    fn solve(points: impl Iterator<Item = ((f64, f64, f64), f64)>, order: usize) -> Option<Self> {
        let (mut a, mut b) = (SMatrix::<f64, TERMS, TERMS>::zeros(), Row::zeros());
        for ((x, value, variance), weight) in points {
            let row = powers(x, order, 0);
            b += row * (value * weight / variance);
            a += row * row.transpose() * (weight / variance);
        }
        (order + 1..TERMS).for_each(|k| a[(k, k)] = 1.0); // coefficients that are not there are 0, and known
        let factor = a.cholesky()?;
        let mut covariance = factor.inverse();
        (order + 1..TERMS).for_each(|k| covariance[(k, k)] = 0.0);
        Some(Self { order, coefficients: factor.solve(&b), covariance, scale: 1.0 })
    }

    /// The value at `x`, derived `times` times.
    fn value(&self, x: f64, times: usize) -> f64 {
        self.coefficients.dot(&powers(x, self.order, times))
    }

    fn residuals(&self, points: &[(f64, f64, f64)]) -> impl Iterator<Item = f64> {
        let at = |x: f64| self.coefficients.iter().rev().fold(0.0, |value, c| value * x + c); // Horner's scheme
        points.iter().map(move |(x, value, variance)| (value - at(*x)) / variance.sqrt())
    }

    /// Squared residuals over `scale`, each at most 3 squared.
    fn misfit(&self, points: &[(f64, f64, f64)], scale: f64) -> f64 {
        self.residuals(points).map(|r| (r / scale).powi(2).min(9.0)).sum()
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

type Row = SVector<f64, TERMS>;

/// The powers of `x`, 0 to `order`, derived `times` times; then zeros.
fn powers(x: f64, order: usize, times: usize) -> Row {
    let power = |k: usize| {
        let factor: f64 = (0..times).map(|t| k as f64 - t as f64).product(); // 0 where k < times
        factor * repeat_n(x, k.saturating_sub(times)).product::<f64>()
    };
    Row::from_fn(|k, _| if k <= order { power(k) } else { 0.0 })
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
