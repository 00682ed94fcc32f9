//! Where a corner of four squares lies. In: a grey image, about where, and the edges about there. Out: the crossing of
//! the two edges to sub-pixel, its sigma and contrast. Not here: which corners there are.
//!
//! A blurred corner under a plane of illumination is fitted to the pixels by Levenberg's and Marquardt's method. The
//! model is as symmetric about the corner as the corner is, so that neither the blur's shape nor skew edges move it.
//! To start with, the saddle of a quadratic: Lucchese, Mitra, "Using saddle points for subpixel feature detection in
//! camera calibration targets", APCCAS 2002.

use crate::contour::step;
use crate::image::Image;
use crate::optics::Pixel;
use nalgebra::{SMatrix, SVector, Vector2};

/// A corner, fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Saddle {
    /// Where, px.
    pub(super) at: Pixel,
    /// Per axis, from the scatter about the model, px.
    pub(super) sigma: f64,
    /// Half the difference of bright and dark, grey levels; negative where the square between the given arms is dark.
    pub(super) contrast: f64,
}

/// Pixels about the middle of the quadratic's window.
const SETTLE: i32 = 3;

/// The saddle near `at` of quadratics through 7 × 7 pixels; `None` where there is none within two pixels.
pub(super) fn settle(image: &Image<f32>, at: &Pixel) -> Option<Pixel> {
    let reach = f64::from(SETTLE);
    let inside = |v: f64, n: usize| v >= reach && v + reach <= n as f64 - 1.0;
    let mut p = *at;
    for _ in 0..4 {
        let centre = p.map(f64::round);
        if !(inside(centre.x, image.width) && inside(centre.y, image.height)) {
            return None;
        }
        // x, y, x² − mean, y² − mean and xy are orthogonal on the window: each coefficient is one sum
        let (mut x1, mut y1, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0);
        for dy in -SETTLE..=SETTLE {
            let left = centre.x as usize - SETTLE as usize;
            let row = &image.row((centre.y as i32 + dy) as usize)[left..=left + 2 * SETTLE as usize];
            let y = f64::from(dy);
            for (dx, v) in (-SETTLE..=SETTLE).zip(row) {
                let (x, v) = (f64::from(dx), f64::from(*v));
                x1 += x * v;
                y1 += y * v;
                xx += (x * x - 4.0) * v;
                yy += (y * y - 4.0) * v;
                xy += x * y * v;
            }
        }
        // Σx² = 196, Σ(x² − 4)² = 588, Σx²y² = 784 over 7 × 7 pixels
        let (x1, y1, xx, yy, xy) = (x1 / 196.0, y1 / 196.0, 2.0 * xx / 588.0, 2.0 * yy / 588.0, xy / 784.0);
        let det = xx * yy - xy * xy;
        if det.is_nan() || det >= 0.0 {
            return None;
        }
        let step = Vector2::new(xy * y1 - yy * x1, xy * x1 - xx * y1) / det;
        let to = centre + step.cap_magnitude(1.5);
        let moved = (to - p).norm();
        p = to;
        if (p - at).norm() > 2.0 {
            return None;
        }
        if moved < 0.02 {
            break;
        }
    }
    Some(p)
}

/// Unknowns: corner x, y; directions of both edges; blur; mean, contrast; relative slope of the illumination x, y.
const N: usize = 9;
/// Good corners take five steps.
const STEPS: usize = 12;
type Normal = (SMatrix<f64, N, N>, SVector<f64, N>, f64);

/// A residual of more than this share of the contrast is no corner. Print on rough paper comes to 0.2.
const ROUGHEST: f64 = 0.25;
/// Nor is a blur of more than this share of the shorter arm: something lies on the corner.
const SOFTEST: f64 = 0.4;
/// Nor is light that falls off by more than this from the corner to the end of an arm: where two squares meet a ground of
/// another grey, the model would have it so.
const STEEPEST: f64 = 0.4;
/// Of the pixels' spread at least this share must be the difference of bright and dark, to begin with.
const CLEAREST: f64 = 0.3;

/// Fits the corner near `start` to the pixels within ± both arms of it: a parallelogram along its edges.
///
/// `arms`: along the edges, px, the second clockwise on the screen from the first; shorter than a square's sides.
/// `None` where the pixels show no corner or the fit leaves their middle.
pub(super) fn fit(image: &Image<f32>, start: &Pixel, arms: [Vector2<f64>; 2]) -> Option<Saddle> {
    let pixels = window(image, start, arms)?;
    if pixels.len() < 3 * N {
        return None;
    }
    let angle = |v: &Vector2<f64>| v.y.atan2(v.x);
    let count = pixels.len() as f64;
    let mean = pixels.iter().map(|p| p.1).sum::<f64>() / count;
    let spread = (pixels.iter().map(|p| (p.1 - mean).powi(2)).sum::<f64>() / count).sqrt();
    let contrast = contrast(&pixels, arms);
    if contrast.abs() < CLEAREST * spread {
        return None;
    }
    let mut x = SVector::<f64, N>::from([0.0, 0.0, angle(&arms[0]), angle(&arms[1]), 1.0, mean, contrast, 0.0, 0.0]);
    let (mut normal, mut right, mut cost) = system(&pixels, &x);
    let mut damping = 1e-3;
    let shorter = arms[0].norm().min(arms[1].norm());
    let reach = 0.7 * shorter;
    for _ in 0..STEPS {
        let mut damped = normal;
        for k in 0..N {
            damped[(k, k)] += damping * normal[(k, k)] + f64::MIN_POSITIVE;
        }
        let delta = damped.cholesky()?.solve(&right);
        let mut tried = x + delta;
        tried[4] = tried[4].clamp(0.2, 20.0);
        let (n, r, c) = system(&pixels, &tried);
        if c < cost {
            let settled = delta.fixed_rows::<2>(0).amax() < 5e-4;
            (x, normal, right, cost) = (tried, n, r, c);
            damping *= 0.1;
            if settled {
                break;
            }
        } else {
            damping *= 10.0;
            if delta.fixed_rows::<2>(0).amax() < 5e-4 || damping > 1e6 {
                break;
            }
        }
    }
    let moved = Vector2::new(x[0], x[1]);
    let variance = cost / (count - N as f64);
    let turned = (x[2] - angle(&arms[0])).abs().max((x[3] - angle(&arms[1])).abs());
    let even = arms.iter().all(|arm| Vector2::new(x[7], x[8]).dot(arm).abs() < STEEPEST);
    let clear = variance.sqrt() < ROUGHEST * x[6].abs() && x[4] < SOFTEST * shorter;
    if !(even && clear && moved.norm() < reach && turned < 0.35) {
        return None;
    }
    let covariance = normal.cholesky()?.inverse() * variance;
    let sigma = (0.5 * (covariance[(0, 0)] + covariance[(1, 1)])).sqrt();
    (sigma < 0.3 * reach).then_some(Saddle { at: start + moved, sigma, contrast: x[6] })
}

/// The pixels within ± both arms of `start`, from there, with their grey levels.
fn window(image: &Image<f32>, start: &Pixel, arms: [Vector2<f64>; 2]) -> Option<Vec<(Vector2<f64>, f64)>> {
    let reach = arms[0].abs() + arms[1].abs();
    let window = crate::image::Window::clipped(
        start.x - reach.x,
        start.y - reach.y,
        start.x + reach.x,
        start.y + reach.y,
        image.width,
        image.height,
    )?;
    let across = arms[0].perp(&arms[1]);
    let mut pixels = Vec::with_capacity(window.width * window.height);
    for y in window.y..window.y + window.height {
        let row = image.row(y);
        for (x, v) in row.iter().enumerate().skip(window.x).take(window.width) {
            let d = Vector2::new(x as f64, y as f64) - start;
            if d.perp(&arms[1]).abs() <= across && arms[0].perp(&d).abs() <= across {
                pixels.push((d, f64::from(*v)));
            }
        }
    }
    Some(pixels)
}

/// Half the difference between the mean of the square between the arms with the one opposite, and that of the others.
fn contrast(pixels: &[(Vector2<f64>, f64)], arms: [Vector2<f64>; 2]) -> f64 {
    let mut sums = [(0.0, 0.0); 2];
    for (d, v) in pixels {
        let between = (d.perp(&arms[1]) > 0.0) == (arms[0].perp(d) > 0.0);
        let sum = &mut sums[usize::from(between)];
        *sum = (sum.0 + v, sum.1 + 1.0);
    }
    let [other, between] = sums.map(|(v, n)| v / f64::max(n, 1.0));
    0.5 * (between - other)
}

/// The normal equations of the model at `x`, and the sum of squared residuals.
fn system(pixels: &[(Vector2<f64>, f64)], x: &SVector<f64, N>) -> Normal {
    let (mut normal, mut right, mut cost) = ([[0.0; N]; N], [0.0; N], 0.0);
    let corner = Vector2::new(x[0], x[1]);
    let ((sa, ca), (sb, cb)) = (x[2].sin_cos(), x[3].sin_cos());
    let (sigma, mean, contrast, slope) = (x[4], x[5], x[6], Vector2::new(x[7], x[8]));
    let (side_a, side_b) = (Profile::new(x[2], sigma), Profile::new(x[3], sigma));
    for (d, v) in pixels {
        let p = d - corner;
        // beyond the first edge on the second arm's side, and the other way round; and along both
        let (u, w) = (ca * p.y - sa * p.x, sb * p.x - cb * p.y);
        let (along_a, along_b) = (ca * p.x + sa * p.y, cb * p.x + sb * p.y);
        let ((su, du, bu), (sw, dw, bw)) = (side_a.at(u), side_b.at(w));
        let light = 1.0 + slope.dot(d);
        let surface = mean + contrast * su * sw;
        let k = light * contrast;
        let (ku, kw) = (k * du * sw, k * su * dw);
        let j = [
            ku * sa - kw * sb,
            kw * cb - ku * ca,
            -ku * along_a,
            kw * along_b,
            k * (bu * sw + su * bw),
            light,
            light * su * sw,
            d.x * surface,
            d.y * surface,
        ];
        let r = v - light * surface;
        cost += r * r;
        for a in 0..N {
            right[a] += j[a] * r;
            for b in 0..=a {
                normal[a][b] += j[a] * j[b];
            }
        }
    }
    let normal = SMatrix::from_fn(|a, b| normal[a.max(b)][a.min(b)]);
    (normal, SVector::from(right), cost)
}

/// The profile across an edge from −1 to 1: a Gaussian blur, averaged over the pixel.
struct Profile {
    sigma: f64,
    /// The pixel seen along the edge is a trapezoid; three points with its second and fourth moment stand for it.
    node: f64,
    weight: f64,
}

impl Profile {
    /// Of an edge in direction `angle`, rad.
    fn new(angle: f64, sigma: f64) -> Self {
        let (sin, cos) = angle.sin_cos();
        let square = 12.0 * (1.0 / 48.0 - (sin.powi(4) + cos.powi(4)) / 120.0);
        Self { sigma, node: square.sqrt(), weight: 1.0 / (24.0 * square) }
    }

    /// At `d` px across the edge: its value, and its slopes by distance and by blur.
    fn at(&self, d: f64) -> (f64, f64, f64) {
        if d.abs() > 5.0 * self.sigma + self.node {
            return (d.signum(), 0.0, 0.0);
        }
        let points = [(-self.node, self.weight), (0.0, 1.0 - 2.0 * self.weight), (self.node, self.weight)];
        points.iter().fold((-1.0, 0.0, 0.0), |(value, slope, blur), (offset, weight)| {
            let z = (d + offset) / self.sigma;
            let (phi, density) = step(z);
            let density = 2.0 * weight * density / self.sigma;
            (value + 2.0 * weight * phi, slope + density, blur - z * density)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation2;

    /// A corner at `at` with edges along `angles` (degrees), bright between them, averaged over pixels and blurred by
    /// `sigma`; light grows by `slope` per px.
    fn scene(at: Pixel, angles: [f64; 2], sigma: f64, slope: Vector2<f64>) -> Image<f32> {
        let edges = angles.map(|a| Rotation2::new(a.to_radians()) * Vector2::x());
        let mut image = Image::filled(48, 48, 0.0);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let sample = |k: i32| {
                let offset = Vector2::new(f64::from(k % 8), f64::from(k / 8)).add_scalar(0.5) / 8.0;
                let d = Pixel::new((i % 48) as f64, (i / 48) as f64) + offset.add_scalar(-0.5) - at;
                let side = |z: f64| 2.0 * step(z / sigma).0 - 1.0;
                60.0 + 40.0 * side(edges[0].perp(&d)) * side(d.perp(&edges[1]))
            };
            let d = Pixel::new((i % 48) as f64, (i / 48) as f64) - at;
            *pixel = ((0..64).map(sample).sum::<f64>() / 64.0 * (1.0 + slope.dot(&d))) as f32;
        }
        image
    }

    #[test]
    fn a_planted_corner_is_found_whatever_its_place_blur_skew_and_light() {
        arbtest::arbtest(|u| {
            let mut between = |lo: f64, hi: f64| Ok(lo + (hi - lo) * f64::from(u.arbitrary::<u16>()?) / 65535.0);
            let at = Pixel::new(between(22.0, 25.0)?, between(22.0, 25.0)?);
            let first = between(-180.0, 180.0)?;
            let angles = [first, first + between(50.0, 130.0)?];
            let slope = Vector2::new(between(-0.015, 0.015)?, between(-0.015, 0.015)?);
            let image = scene(at, angles, between(0.25, 2.0)?, slope);
            let arms = angles.map(|a| Rotation2::new((a + 5.0).to_radians()) * Vector2::new(10.0, 0.0));
            let start = at + Vector2::new(between(-0.8, 0.8)?, between(-0.8, 0.8)?);
            let found = fit(&image, &start, arms).expect("a clear corner");
            // the trapezoid by three points, and the product of two blurred edges, are near to the truth
            assert!((found.at - at).norm() < 0.01, "{:?} for {at:?}, {angles:?}", found.at);
            assert!((found.contrast - 40.0).abs() < 1.0, "{found:?}");
            let turned = [arms[1], -arms[0]];
            let found = fit(&image, &start, turned).expect("the same corner");
            assert!((found.at - at).norm() < 0.01 && found.contrast < -39.0, "a dark square is between these arms");
            Ok(())
        })
        .budget_ms(2000);
    }

    #[test]
    fn a_sharp_corner_along_the_pixels_is_not_drawn_to_them() {
        // a Gaussian alone, not averaged over the pixel, is off by up to 0.07 px here
        for k in 0..10 {
            let at = Pixel::new(23.5 + 0.1 * f64::from(k), 24.0 - 0.07 * f64::from(k));
            let image = scene(at, [0.5, 90.3], 0.15, Vector2::zeros());
            let arms = [Vector2::new(9.0, 0.0), Vector2::new(0.0, 9.0)];
            let found = fit(&image, &(at + Vector2::new(0.2, 0.3)), arms).expect("a clear corner");
            assert!((found.at - at).norm() < 0.02, "{} for {at}", found.at - at);
        }
    }

    #[test]
    fn what_is_no_corner_has_no_fit() {
        let at = Pixel::new(24.2, 23.7);
        let arms = [Vector2::new(9.0, 0.0), Vector2::new(0.0, 9.0)];
        let corner = scene(at, [0.0, 90.0], 0.8, Vector2::zeros());
        let spoilt = |change: &dyn Fn(usize, usize, f32) -> f32| {
            let mut image = corner.clone();
            for (i, v) in image.pixels.iter_mut().enumerate() {
                *v = change(i % 48, i / 48, *v);
            }
            fit(&image, &at, arms)
        };
        assert!(spoilt(&|_, _, v| v).is_some());
        assert_eq!(spoilt(&|_, _, _| 50.0), None, "even");
        assert_eq!(spoilt(&|x, _, _| if x < 24 { 20.0 } else { 100.0 }), None, "an edge");
        assert_eq!(spoilt(&|x, y, _| if x < 24 && y < 24 { 20.0 } else { 100.0 }), None, "one square");
        assert_eq!(spoilt(&|_, y, v| if y < 24 { 60.0 } else { v }), None, "two squares on grey");
        assert_eq!(spoilt(&|x, y, v| if x.abs_diff(24).pow(2) + y.abs_diff(24).pow(2) < 50 { 60.0 } else { v }), None);
        assert_eq!(fit(&corner, &Pixel::new(-40.0, 300.0), arms), None, "outside the image");
    }

    #[test]
    fn the_quadratic_settles_within_half_a_pixel() {
        for (x, y) in [(24.0, 24.0), (24.4, 23.6), (23.5, 24.5)] {
            let at = Pixel::new(x, y);
            let image = scene(at, [15.0, 95.0], 0.8, Vector2::zeros());
            let found = settle(&image, &(at + Vector2::new(0.9, -0.8))).expect("a saddle");
            assert!((found - at).norm() < 0.4, "{found} for {at}"); // enough for the fit to start from
        }
        assert_eq!(settle(&Image::filled(48, 48, 3.0), &Pixel::new(24.0, 24.0)), None);
    }
}
