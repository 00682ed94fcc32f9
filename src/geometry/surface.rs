//! Smooth surfaces fitted to noisy depth: height `w` over a local plane as a polynomial in `u`, `v`.
//! In:  cells of averaged samples (u, v, w, variance) in a local frame, mm.
//! Out: polynomials with their covariance; ray intersections.
//! Not here: which samples belong to the surface (that is known from the panel's mask and the depth map).
//!
//! An order is a compromise: a low one is quiet, a high one follows more of the body, and a choice between them is
//! drawn by noise. So a surface is taught as a quintic that is as smooth as its cells allow; and once taught it is fitted
//! again by its height and tilt only.

use super::Point3;
use super::robust::{Weights, start, truncated};
use crate::lent::List;
use nalgebra::{Cholesky, Const, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// A right-handed local frame on the body: `u`, `v` along the surface, `w` outward (towards the camera).
#[derive(Debug, PartialEq)]
pub struct Local<F> {
    /// Origin in the outer frame, mm.
    pub origin: Point3<F>,
    /// Columns: the axes u, v, w in the outer frame.
    pub axes: Matrix3<f64>,
}

impl<F> Clone for Local<F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<F> Copy for Local<F> {}

impl<F> Local<F> {
    /// Local coordinates (u, v, w) of `p`, mm.
    pub fn coordinates(&self, p: Point3<F>) -> Vector3<f64> {
        self.axes.transpose() * (p - self.origin)
    }

    /// The point with local coordinates `c`, mm.
    pub fn point(&self, c: &Vector3<f64>) -> Point3<F> {
        Point3::new(self.origin.xyz + self.axes * c)
    }
}

/// The mean of the depth samples of one cell of a grid over the surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    /// Column and row of the cell in its grid.
    pub index: [i32; 2],
    /// Mean position along the plane, mm.
    pub uv: Vector2<f64>,
    /// Mean height, mm.
    pub w: f64,
    /// Variance of `w`, mm², from the samples' noise.
    pub variance: f64,
}

/// The highest polynomial order: a quintic has 21 coefficients.
pub const MAX_ORDER: usize = 5;

/// w = Σ c·uⁱ·vʲ, i + j ≤ order, with the covariance of its coefficients.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    order: usize,
    scale: f64,
    /// Zeros after those of the order.
    coefficients: SVector<f64, MAX_TERMS>,
    covariance: SMatrix<f64, MAX_TERMS, MAX_TERMS>,
}

const MAX_TERMS: usize = terms(MAX_ORDER);

/// Number of coefficients of a polynomial of two variables.
const fn terms(order: usize) -> usize {
    (order + 1) * (order + 2) / 2
}

/// `function::<ORDER, TERMS>` of an order known at run time: what it does over and over is then unrolled.
macro_rules! of_order {
    ($order:expr, $function:ident($($argument:expr),*)) => {
        match $order {
            0 => $function::<0, { terms(0) }>($($argument),*),
            1 => $function::<1, { terms(1) }>($($argument),*),
            2 => $function::<2, { terms(2) }>($($argument),*),
            3 => $function::<3, { terms(3) }>($($argument),*),
            4 => $function::<4, { terms(4) }>($($argument),*),
            _ => $function::<MAX_ORDER, MAX_TERMS>($($argument),*),
        }
    };
}

/// The monomials uⁱ·vʲ, by rising i + j; u and v already divided by the scale.
#[inline(always)]
fn monomials<const ORDER: usize, const TERMS: usize>(u: f64, v: f64) -> SVector<f64, TERMS> {
    let mut m = SVector::zeros();
    m[0] = 1.0;
    let mut k = 1;
    for degree in 1..=ORDER {
        let before = k - degree; // first monomial of the degree below
        for i in 0..degree {
            m[k] = m[before + i] * u;
            k += 1;
        }
        m[k] = m[k - degree - 1] * v;
        k += 1;
    }
    m
}

/// By Horner's scheme in u for each power of v, and in v.
#[inline(always)]
fn height<const ORDER: usize, const TERMS: usize>(c: &[f64], u: f64, v: f64) -> f64 {
    let c = &c[..TERMS];
    let mut sum = 0.0;
    for i in (0..=ORDER).rev() {
        let mut along = 0.0; // of uⁿ⁻ⁱ·vⁱ over all degrees n
        for degree in (i..=ORDER).rev() {
            along = along * u + c[degree * (degree + 1) / 2 + i];
        }
        sum = sum * v + along;
    }
    sum
}

/// The same, with its slopes along u and v: both sums of Horner's scheme are derived as they run.
fn rise<const ORDER: usize, const TERMS: usize>(c: &[f64], u: f64, v: f64) -> [f64; 3] {
    let c = &c[..TERMS];
    let [mut sum, mut du, mut dv] = [0.0; 3];
    for i in (0..=ORDER).rev() {
        let [mut along, mut slope] = [0.0; 2];
        for degree in (i..=ORDER).rev() {
            slope = slope * u + along;
            along = along * u + c[degree * (degree + 1) / 2 + i];
        }
        dv = dv * v + sum;
        du = du * v + slope;
        sum = sum * v + along;
    }
    [sum, du, dv]
}

fn variance<const ORDER: usize, const TERMS: usize>(p: &Polynomial, u: f64, v: f64) -> f64 {
    let m = monomials::<ORDER, TERMS>(u, v);
    m.dot(&(p.covariance.fixed_view::<TERMS, TERMS>(0, 0) * m))
}

/// Normal equations: the information (its lower triangle only), the right side, Σ weight·w², and how many points took part.
struct Normal<const TERMS: usize> {
    information: SMatrix<f64, TERMS, TERMS>,
    right: SVector<f64, TERMS>,
    square: f64,
    used: usize,
}

/// Of the polynomial of least squares over (u and v in units of the scale, height, weight). `None` with fewer than 1.5
/// points per coefficient.
fn normal<const ORDER: usize, const TERMS: usize>(
    points: impl Iterator<Item = (Vector2<f64>, f64, f64)>,
) -> Option<Normal<TERMS>> {
    let mut n = Normal { information: SMatrix::zeros(), right: SVector::zeros(), square: 0.0, used: 0 };
    for (uv, w, weight) in points.filter(|(.., weight)| *weight > 0.0) {
        n.used += 1;
        n.square += weight * w * w;
        let m = monomials::<ORDER, TERMS>(uv.x, uv.y);
        for j in 0..TERMS {
            let weighted = weight * m[j];
            n.right[j] += weighted * w;
            for i in j..TERMS {
                n.information[(i, j)] += weighted * m[i];
            }
        }
    }
    (2 * n.used >= 3 * TERMS).then_some(n)
}

/// The polynomial of least squares, and the factor of its information. `None` where the points do not determine it.
fn solve<const ORDER: usize, const TERMS: usize>(
    points: impl Iterator<Item = (Vector2<f64>, f64, f64)>,
) -> Option<(SVector<f64, TERMS>, Cholesky<f64, Const<TERMS>>)> {
    let n = normal::<ORDER, TERMS>(points)?;
    let cholesky = Cholesky::new(n.information)?; // reads the lower triangle only
    let diagonal = cholesky.l_dirty().diagonal();
    (diagonal.min() >= 1e-7 * diagonal.max()).then(|| (cholesky.solve(&n.right), cholesky))
}

/// Cells in units of their own: what a fit asks of them again and again.
struct Scaled {
    scale: f64,
    points: List<ScaledCell>,
}

/// u and v over the scale, height, 1/sigma.
type ScaledCell = (Vector2<f64>, f64, f64);

impl Scaled {
    fn new<'c>(cells: impl Iterator<Item = &'c Cell> + Clone) -> Self {
        let scale = cells.clone().map(|c| c.uv.amax()).fold(1.0, f64::max);
        Self { scale, points: List::of(cells.map(|c| (c.uv / scale, c.w, c.variance.sqrt().recip()))) }
    }

    /// Of a polynomial, each over its sigma.
    fn residuals(&self, p: &Polynomial) -> impl Iterator<Item = f64> {
        let to_own = self.scale / p.scale;
        self.points.iter().map(move |(uv, w, inverse_sigma)| {
            let uv = uv * to_own;
            (w - of_order!(p.order, height(p.coefficients.as_slice(), uv.x, uv.y))) * inverse_sigma
        })
    }
}

impl Scaled {
    /// (u and v over the scale, height, weight); `weights` multiply 1/variance.
    fn weighted<'a>(&'a self, weights: &'a [f64]) -> impl Iterator<Item = (Vector2<f64>, f64, f64)> + 'a {
        let weighted =
            |((uv, w, inverse_sigma), weight): (&ScaledCell, &f64)| (*uv, *w, inverse_sigma.powi(2) * weight);
        self.points.iter().zip(weights).map(weighted)
    }
}

/// Weighted least squares.
fn fit<const ORDER: usize, const TERMS: usize>(cells: &Scaled, weights: &[f64]) -> Option<Polynomial> {
    let (coefficients, cholesky) = solve::<ORDER, TERMS>(cells.weighted(weights))?;
    Some(Polynomial::solved::<TERMS>(ORDER, cells.scale, &coefficients, &cholesky))
}

/// The quintic that is as smooth as the cells allow. A quadric is free; what a body has beyond it is taken for a draw of a
/// Gaussian process of some height and length, by whose series (of the squared exponential kernel) the higher
/// coefficients are expected to be small; and of heights and lengths for that which makes the cells likeliest
/// (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, 2.7 and 5.4.1).
fn smooth(cells: &Scaled, weights: &[f64]) -> Option<Polynomial> {
    let n = normal::<MAX_ORDER, MAX_TERMS>(cells.weighted(weights))?;
    let higher = terms(2)..MAX_TERMS;
    let mut best: Option<(f64, SVector<f64, MAX_TERMS>, Cholesky<f64, Const<MAX_TERMS>>)> = None;
    for length_mm in LENGTHS_MM {
        let expected = monomial_scatter(cells.scale / length_mm);
        for height_mm in HEIGHTS_MM {
            let mut information = n.information;
            let mut evidence = -0.5 * n.square;
            for k in higher.clone() {
                let prior = (height_mm * expected[k]).powi(-2);
                information[(k, k)] += prior;
                evidence += 0.5 * prior.ln();
            }
            let Some(cholesky) = Cholesky::new(information) else { continue };
            let c = cholesky.solve(&n.right);
            evidence += 0.5 * n.right.dot(&c) - cholesky.l_dirty().diagonal().map(f64::ln).sum();
            if best.as_ref().is_none_or(|(most, ..)| evidence > *most) {
                best = Some((evidence, c, cholesky));
            }
        }
    }
    let (_, c, cholesky) = best?;
    Some(Polynomial::solved::<MAX_TERMS>(MAX_ORDER, cells.scale, &c, &cholesky))
}

/// Standard deviations of the coefficients of uⁱ·vʲ in a process of height 1 whose length is one over `scale`:
/// scaleⁱ⁺ʲ/√(i!·j!).
fn monomial_scatter(scale: f64) -> SVector<f64, MAX_TERMS> {
    let m = monomials::<MAX_ORDER, MAX_TERMS>(scale, scale);
    let factorial = |k: usize| (1..=k).product::<usize>() as f64;
    let powers = (0..=MAX_ORDER).flat_map(|degree| (0..=degree).map(move |j| (degree - j, j)));
    SVector::from_iterator(m.iter().zip(powers).map(|(m, (i, j))| m / (factorial(i) * factorial(j)).sqrt()))
}

/// The fit that outliers do not pull, without its covariance: of fits to few of the cells the one that most of them agree with.
fn robust_start<const ORDER: usize, const TERMS: usize>(judges: &Scaled) -> Option<Polynomial> {
    let points = &judges.points;
    let point = |k: &usize| (points[*k].0, points[*k].1, points[*k].2.powi(2));
    let few = |picked: &[usize]| Some(solve::<ORDER, TERMS>(picked.iter().map(point))?.0);
    let loss = |c: &SVector<f64, TERMS>, most: f64| {
        let residual = |(uv, w, inverse_sigma): &ScaledCell| {
            (w - height::<ORDER, TERMS>(c.as_slice(), uv.x, uv.y)) * inverse_sigma
        };
        truncated(points.iter().map(residual), most)
    };
    let coefficients = start(points.len(), few, loss)?;
    let mut started = Polynomial::flat(ORDER, judges.scale);
    started.coefficients.fixed_rows_mut::<TERMS>(0).copy_from(&coefficients);
    Some(started)
}

impl Polynomial {
    /// Height 0 without noise.
    fn flat(order: usize, scale: f64) -> Self {
        Self { order, scale, coefficients: SVector::zeros(), covariance: SMatrix::zeros() }
    }

    fn solved<const TERMS: usize>(
        order: usize,
        scale: f64,
        coefficients: &SVector<f64, TERMS>,
        cholesky: &Cholesky<f64, Const<TERMS>>,
    ) -> Self {
        let mut solved = Self::flat(order, scale);
        solved.coefficients.fixed_rows_mut::<TERMS>(0).copy_from(coefficients);
        solved.covariance.fixed_view_mut::<TERMS, TERMS>(0, 0).copy_from(&cholesky.inverse());
        solved
    }

    /// A surface without noise from its coefficients by rising degree, u and v in units of `scale` mm; `None` where
    /// their number is that of no order up to [`MAX_ORDER`], or a number is not finite.
    pub fn from_coefficients(scale: f64, coefficients: &[f64]) -> Option<Self> {
        let order = (0..=MAX_ORDER).find(|order| terms(*order) == coefficients.len())?;
        let finite = scale > 0.0 && scale.is_finite() && coefficients.iter().all(|c| c.is_finite());
        let mut exact = Self::flat(order, scale);
        exact.coefficients.rows_mut(0, coefficients.len()).copy_from_slice(coefficients);
        finite.then_some(exact)
    }

    /// The surface of least squares through points (u, v) and w, all alike; `None` with fewer than 1.5 points per
    /// coefficient, or where they do not determine it.
    pub fn through(points: impl Iterator<Item = (Vector2<f64>, f64)> + Clone, order: usize) -> Option<Self> {
        let scale = points.clone().map(|(uv, _)| uv.amax()).fold(f64::MIN_POSITIVE, f64::max);
        let scaled = Scaled { scale, points: List::of(points.map(|(uv, w)| (uv / scale, w, 1.0))) };
        let weights = vec![1.0; scaled.points.len()];
        of_order!(order, fit(&scaled, &weights))
    }

    /// Scale (mm) and coefficients, as `from_coefficients` takes them.
    pub fn coefficients(&self) -> (f64, Vec<f64>) {
        (self.scale, self.coefficients.as_slice()[..terms(self.order)].to_vec())
    }

    /// Height at (u, v), mm.
    pub fn height(&self, uv: &Vector2<f64>) -> f64 {
        of_order!(self.order, height(self.coefficients.as_slice(), uv.x / self.scale, uv.y / self.scale))
    }

    /// Slopes ∂w/∂u, ∂w/∂v at (u, v).
    pub fn slope(&self, uv: &Vector2<f64>) -> Vector2<f64> {
        self.rise(uv).1
    }

    /// Height and slopes at (u, v).
    fn rise(&self, uv: &Vector2<f64>) -> (f64, Vector2<f64>) {
        let [w, du, dv] =
            of_order!(self.order, rise(self.coefficients.as_slice(), uv.x / self.scale, uv.y / self.scale));
        (w, Vector2::new(du, dv) / self.scale)
    }

    /// Variance of the height at (u, v), mm², from the cells' noise.
    pub fn variance(&self, uv: &Vector2<f64>) -> f64 {
        of_order!(self.order, variance(self, uv.x / self.scale, uv.y / self.scale))
    }
}

/// A polynomial surface on the body, in frame `F`.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface<F> {
    /// The plane that heights are measured from.
    pub local: Local<F>,
    /// Heights.
    pub polynomial: Polynomial,
    /// Cells within this distance of the local origin took part, mm.
    pub radius_mm: f64,
    /// Scatter of the cells beyond their noise, rms, mm: what the polynomial does not follow.
    pub misfit_mm: f64,
    /// Share of the cells that took part.
    pub inliers: f64,
}

impl<F> Surface<F> {
    /// Fits a polynomial of `order` to the cells within `radius_mm` of the local origin, robustly: from the
    /// quadric that most cells agree with, which a tyre behind a part of the patch does not pull, by Tukey's
    /// biweight with its scale from the residuals. `None` where the cells do not determine it.
    pub fn fit(local: Local<F>, cells: &[Cell], order: usize, radius_mm: f64) -> Option<Self> {
        Self::robust(local, cells, order.min(2), radius_mm, |cells, weights| of_order!(order, fit(cells, weights)))
    }

    /// Fits a quintic as smooth as the cells allow, as robustly: for a surface that is not known yet, and where it ends, too,
    /// at a corner that no cell reaches. Its covariance holds noise and what is expected beyond the cells, not by how much it is
    /// too smooth: errors there are some 1.5 sigmas.
    pub fn fit_smooth(local: Local<F>, cells: &[Cell], radius_mm: f64) -> Option<Self> {
        Self::robust(local, cells, 2, radius_mm, smooth)
    }

    fn robust(
        local: Local<F>,
        cells: &[Cell],
        first_order: usize,
        radius_mm: f64,
        refit: impl Fn(&Scaled, &[f64]) -> Option<Polynomial>,
    ) -> Option<Self> {
        let inside = cells.iter().filter(|c| c.uv.norm() <= radius_mm);
        let scaled = Scaled::new(inside.clone());
        let n = scaled.points.len();
        let judges = Scaled::new(inside.clone().step_by(n.div_ceil(JUDGES).max(1)));
        let mut weights = Weights::default();
        let mut polynomial = of_order!(first_order, robust_start(&judges))?;
        for round in 0..BIWEIGHT_ROUNDS {
            weights.weigh(scaled.residuals(&polynomial));
            let weights = &weights.weights;
            polynomial =
                if round == 0 { of_order!(first_order, fit(&scaled, weights)) } else { refit(&scaled, weights) }?;
        }
        let used = weights.weights.iter().filter(|w| **w > 0.0).count();
        Some(Self {
            misfit_mm: misfit(inside, &weights.weights, &polynomial),
            local,
            polynomial,
            radius_mm,
            inliers: used as f64 / n as f64,
        })
    }

    /// Fits `shape`, a surface taught in the same local frame, to the cells within `radius_mm`: only its height and
    /// tilt are free, so whatever the polynomial does not follow is the same as when it was taught, and cancels.
    /// `None` where the cells do not determine them.
    pub fn fit_shape(local: Local<F>, cells: &[Cell], shape: &Polynomial, radius_mm: f64) -> Option<Self> {
        let off = List::of(cells.iter().map(|c| Cell { w: c.w - shape.height(&c.uv), ..*c }));
        let fit = Self::fit(local, &off, 1, radius_mm)?;
        let mut polynomial = shape.clone();
        polynomial.covariance.fill(0.0);
        let to_shape = shape.scale / fit.polynomial.scale;
        let factor = [1.0, to_shape, to_shape];
        for i in 0..3 {
            polynomial.coefficients[i] += fit.polynomial.coefficients[i] * factor[i];
            for j in 0..3 {
                polynomial.covariance[(i, j)] = fit.polynomial.covariance[(i, j)] * factor[i] * factor[j];
            }
        }
        Some(Self { polynomial, ..fit })
    }

    /// Where the ray from the outer frame's origin along `direction` meets the surface moved inwards by
    /// `depth_mm` along its normal: local coordinates. `None` where it runs past.
    pub fn meet(&self, direction: &Vector3<f64>, depth_mm: f64) -> Option<Vector3<f64>> {
        let start = self.local.coordinates(Point3::new(Vector3::zeros()));
        let d = self.local.axes.transpose() * direction;
        if d.z.abs() < 1e-6 * d.norm() {
            return None;
        }
        let mut s = -start.z / d.z; // where it meets the local plane
        for _ in 0..20 {
            let p = start + s * d;
            let (height, slope) = self.polynomial.rise(&p.xy());
            let gap = p.z - (height - depth_mm * (1.0 + slope.norm_squared()).sqrt());
            let step = gap / (d.z - slope.dot(&d.xy()));
            s -= step;
            if (step * d.norm()).abs() < 1e-9 {
                return Some(start + s * d);
            }
        }
        None
    }

    /// The point of the surface over (u, v).
    pub fn point(&self, uv: &Vector2<f64>) -> Point3<F> {
        self.local.point(&Vector3::new(uv.x, uv.y, self.polynomial.height(uv)))
    }

    /// The outward unit normal over (u, v), in the outer frame.
    pub fn normal(&self, uv: &Vector2<f64>) -> Vector3<f64> {
        let slope = self.polynomial.slope(uv);
        (self.local.axes * Vector3::new(-slope.x, -slope.y, 1.0)).normalize()
    }

    /// Standard deviation of the height over (u, v), mm: noise of the fit and its misfit.
    pub fn sigma_mm(&self, uv: &Vector2<f64>) -> f64 {
        (self.polynomial.variance(uv) + self.misfit_mm * self.misfit_mm).sqrt()
    }
}

const BIWEIGHT_ROUNDS: usize = 6;
/// Over which length a body differs from a quadric, mm, and by how much, mm: from a rolled flange to a door, from nothing
/// to a flare.
const LENGTHS_MM: [f64; 7] = [15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 130.0];
const HEIGHTS_MM: [f64; 7] = [0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0];

/// At most this many cells judge where the robust fit starts.
const JUDGES: usize = 300;

/// What the polynomial does not follow, rms, mm: the mean product of the residuals of neighbouring cells, which
/// noise leaves at 0 whatever its size (Moran, Biometrika 37 (1950) 17), less twice the scatter of that mean.
fn misfit<'c>(cells: impl Iterator<Item = &'c Cell>, weights: &[f64], polynomial: &Polynomial) -> f64 {
    let used = cells.zip(weights).filter(|(_, w)| **w > 0.0);
    let mut residuals = List::of(used.map(|(c, _)| (c.index, c.w - polynomial.height(&c.uv), c.variance)));
    residuals.sort_unstable_by_key(|(index, ..)| *index); // as they mostly come
    let (mut products, mut scatter, mut pairs) = (0.0, 0.0, 0.0);
    let mut below = 0; // the first that is not before the neighbour in the next row
    for (k, &([i, j], r, variance)) in residuals.iter().enumerate() {
        while residuals.get(below).is_some_and(|(index, ..)| *index < [i + 1, j]) {
            below += 1;
        }
        for (place, neighbour) in [(below, [i + 1, j]), (k + 1, [i, j + 1])] {
            if let Some((_, s, other)) = residuals.get(place).filter(|(index, ..)| *index == neighbour) {
                products += r * s;
                scatter += variance * other;
                pairs += 1.0;
            }
        }
    }
    if pairs == 0.0 {
        return f64::INFINITY;
    }
    (products / pairs - 2.0 * f64::sqrt(scatter) / pairs).max(0.0).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::frame::Camera;
    use crate::testing::Noise;

    fn local() -> Local<Camera> {
        let axes = nalgebra::Rotation3::from_euler_angles(3.0, 0.2, -0.1).into_inner();
        Local { origin: Point3::new(Vector3::new(-150.0, 120.0, 790.0)), axes }
    }

    fn cells(height: impl Fn(f64, f64) -> f64, sigma: f64) -> Vec<Cell> {
        let mut noise = Noise::new(1);
        (-30..=30)
            .flat_map(|i| (-30..=30).map(move |j| ([i, j], f64::from(i) * 3.0, f64::from(j) * 3.0)))
            .map(|(index, u, v)| Cell {
                index,
                uv: Vector2::new(u, v),
                w: height(u, v) + sigma * noise.gauss(),
                variance: sigma * sigma,
            })
            .collect()
    }

    #[test]
    fn monomials_are_in_the_order_of_their_degree() {
        assert_eq!(monomials::<2, 6>(2.0, 3.0).as_slice(), [1.0, 2.0, 3.0, 4.0, 6.0, 9.0]);
        assert_eq!(monomials::<4, 15>(2.0, 3.0).as_slice()[10..], [16.0, 24.0, 36.0, 54.0, 81.0]);
    }

    #[test]
    fn the_height_is_the_sum_over_the_monomials() {
        let mut noise = Noise::new(4);
        let c = SVector::<f64, MAX_TERMS>::from_fn(|_, _| noise.gauss());
        for (u, v) in [(0.3, -0.8), (1.7, 0.4)] {
            for order in 0..=MAX_ORDER {
                let sum = c.rows(0, terms(order)).dot(&monomials::<MAX_ORDER, MAX_TERMS>(u, v).rows(0, terms(order)));
                let got = of_order!(order, height(c.as_slice(), u, v));
                assert!((got - sum).abs() < 1e-12, "order {order}: {got} {sum}");
            }
        }
    }

    #[test]
    fn the_slope_is_the_heights_derivative() {
        let mut noise = Noise::new(2);
        for order in 0..=MAX_ORDER {
            let coefficients: Vec<f64> = (0..terms(order)).map(|_| noise.gauss()).collect();
            let polynomial = Polynomial::from_coefficients(40.0, &coefficients).expect("of an order");
            let (uv, h) = (Vector2::new(13.0, -29.0), 1e-3);
            let at = |du: f64, dv: f64| polynomial.height(&(uv + Vector2::new(du, dv)));
            let slope = Vector2::new(at(h, 0.0) - at(-h, 0.0), at(0.0, h) - at(0.0, -h)) / (2.0 * h);
            assert!((polynomial.slope(&uv) - slope).amax() < 1e-9, "order {order}");
        }
    }

    #[test]
    fn the_misfit_is_that_of_each_cell_beside_its_two_next() {
        let mut cells = cells(|u, v| 1e-4 * u * v, 0.01);
        let weights: Vec<f64> = (0..cells.len()).map(|k| if k % 7 < 2 { 0.0 } else { 1.0 }).collect();
        let flat = Polynomial::from_coefficients(1.0, &[0.0]).expect("a constant");
        let used = || cells.iter().zip(&weights).filter(|(_, w)| **w > 0.0).map(|(c, _)| c);
        let map: std::collections::BTreeMap<_, _> = used().map(|c| (c.index, c)).collect();
        let next = |c: &Cell| [[c.index[0] + 1, c.index[1]], [c.index[0], c.index[1] + 1]];
        let pairs: Vec<(&Cell, &Cell)> = used()
            .flat_map(|c| next(c).into_iter().filter_map(|n| Some((c, *map.get(&n)?))).collect::<Vec<_>>())
            .collect();
        let n = pairs.len() as f64;
        let mean = pairs.iter().map(|(a, b)| a.w * b.w).sum::<f64>() / n;
        let scatter = pairs.iter().map(|(a, b)| a.variance * b.variance).sum::<f64>();
        let expected = (mean - 2.0 * scatter.sqrt() / n).sqrt();
        assert!(expected > 0.02 && (misfit(cells.iter(), &weights, &flat) / expected - 1.0).abs() < 1e-9);
        cells.reverse();
        let reversed: Vec<f64> = weights.iter().rev().copied().collect();
        assert!((misfit(cells.iter(), &reversed, &flat) / expected - 1.0).abs() < 1e-9, "in any order");
    }

    #[test]
    fn coefficients_are_expected_as_the_kernels_series_has_them() {
        // exp(−|p−q|²/2) = exp(−|p|²/2)·exp(−|q|²/2)·Σ (p·q)ᵏ/k!
        let (p, q) = (Vector2::new(0.5, -0.3), Vector2::new(-0.2, 0.6));
        let scatter = monomial_scatter(1.0);
        let [at_p, at_q] = [p, q].map(|r| monomials::<MAX_ORDER, MAX_TERMS>(r.x, r.y));
        let series: f64 = (0..MAX_TERMS).map(|k| scatter[k].powi(2) * at_p[k] * at_q[k]).sum();
        let kernel = (-0.5 * ((p - q).norm_squared() - p.norm_squared() - q.norm_squared())).exp();
        assert!((series / kernel - 1.0).abs() < 1e-5, "{series} {kernel}");
        assert!((monomial_scatter(0.5)[9] - 0.125 * scatter[9]).abs() < 1e-12);
    }

    /// Cells of a corner's panel: what is beyond 5 mm of its two borders.
    fn corner(height: impl Fn(f64, f64) -> f64, seed: u64) -> Vec<Cell> {
        let mut noise = Noise::new(seed);
        let mut cells = cells(height, 0.0);
        cells.retain(|c| c.uv.x > 4.0 && c.uv.y > 4.0);
        for c in &mut cells {
            (c.w, c.variance) = (c.w + 0.02 * noise.gauss(), 0.02 * 0.02);
        }
        cells
    }

    #[test]
    fn a_flat_body_is_taught_as_quietly_as_by_a_quadric() {
        let at = Vector2::zeros();
        let variance = |fit: Option<Surface<Camera>>| fit.expect("fits").polynomial.variance(&at);
        let cells = corner(|u, _| -u * u / 4000.0, 3);
        let [smooth, quadric, quintic] = [
            Surface::fit_smooth(local(), &cells, 60.0),
            Surface::fit(local(), &cells, 2, 60.0),
            Surface::fit(local(), &cells, 5, 60.0),
        ]
        .map(variance);
        assert!(smooth < 2.0 * quadric && quintic > 20.0 * quadric, "{smooth:.2e} {quadric:.2e} {quintic:.2e}");
    }

    #[test]
    fn a_flare_is_followed_to_a_corner_that_no_cell_reaches_and_its_sigma_is_nearly_the_scatter() {
        let at = Vector2::zeros();
        let (mut square, mut over_sigma, mut quadrics, mut quintics) = (0.0, 0.0, 0.0, 0.0);
        const N: u64 = 60;
        for seed in 0..N {
            let cells = corner(|u, v| -u * u / 4000.0 + 2.0 * (-v / 30.0).exp(), seed);
            let error = |fit: Surface<Camera>| (fit.polynomial.height(&at) - 2.0).powi(2);
            let fit = Surface::fit_smooth(local(), &cells, 60.0).expect("fits");
            over_sigma += error(fit.clone()) / fit.polynomial.variance(&at);
            square += error(fit);
            quadrics += error(Surface::fit(local(), &cells, 2, 60.0).expect("fits"));
            quintics += error(Surface::fit(local(), &cells, 5, 60.0).expect("fits"));
        }
        let [square, over_sigma, quadrics, quintics] =
            [square, over_sigma, quadrics, quintics].map(|s| (s / N as f64).sqrt());
        assert!(square < 0.4 * quintics && square < 0.6 * quadrics, "{square:.3} {quadrics:.3} {quintics:.3}");
        // smoothing is a bias, too, and the covariance holds none: 1.5 here
        assert!((0.7..1.8).contains(&over_sigma), "{over_sigma:.2} {square:.3}");
    }

    #[test]
    fn stated_sigma_is_the_scatter_of_repeated_fits() {
        let (mut sum, mut stated) = (0.0, 0.0);
        let at = Vector2::new(-60.0, 50.0);
        for k in 0..200 {
            let mut cells = cells(|_, _| 0.0, 0.0);
            let mut noise = Noise::new(7 + k);
            for c in &mut cells {
                (c.w, c.variance) = (0.1 * noise.gauss(), 0.01);
            }
            let fit = Surface::fit(local(), &cells, 3, 90.0).expect("fits");
            sum += fit.polynomial.height(&at).powi(2);
            stated += fit.polynomial.variance(&at);
        }
        assert!((sum / stated - 1.0).abs() < 0.25, "{}", sum / stated); // 200 draws: 10 % sigma
    }

    #[test]
    fn a_tyre_behind_a_third_of_the_patch_does_not_pull() {
        let truth = |u: f64, _: f64| -u * u / 4000.0;
        let mut cells = cells(truth, 0.05);
        for c in cells.iter_mut().filter(|c| c.uv.y > 30.0) {
            c.w -= 2.5;
        }
        let fit = Surface::fit(local(), &cells, 2, 90.0).expect("fits");
        assert!(fit.polynomial.height(&Vector2::zeros()).abs() < 0.02, "{}", fit.polynomial.height(&Vector2::zeros()));
        assert!(fit.inliers < 0.75, "{}", fit.inliers);
    }

    #[test]
    fn rays_meet_the_surface_and_its_inward_copy() {
        let fit = Surface::fit(local(), &cells(|u, v| 0.2 * u - v * v / 900.0, 0.001), 3, 90.0).expect("fits");
        for uv in [Vector2::new(0.0, 0.0), Vector2::new(40.0, -25.0)] {
            let on = fit.point(&uv);
            let met = fit.meet(&on.xyz, 0.0).expect("meets");
            assert!((met.xy() - uv).norm() < 1e-6);
            let inside = Point3::<Camera>::new(on.xyz - 0.7 * fit.normal(&uv));
            let met = fit.local.point(&fit.meet(&inside.xyz, 0.7).expect("meets"));
            assert!((met - inside).norm() < 1e-2, "{}", (met - inside).norm()); // slope changes over 0.7 mm
        }
    }
}
