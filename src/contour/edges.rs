//! Edges to sub-pixel. In: a grey image, where to look, and the variance of its pixels. Out: edgels, each with
//! the variance of its place. Not here: which edge is wanted, chains, lens distortion.
//!
//! Found by the maximum of the smoothed gradient along its direction: Devernay, "A non-maxima suppression method
//! for edge detection with sub-pixel accuracy", INRIA RR-2724, 1995. Refined by fitting blurred steps to raw pixels.

use crate::image::{Image, Window};
use crate::lent::List;
use crate::optics::Pixel;
use nalgebra::Vector2;
use std::f64::consts::{PI, SQRT_2};

/// A point of an edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edgel {
    /// Where, px.
    pub position: Pixel,
    /// Across the edge, towards bright; unit length.
    pub normal: Vector2<f64>,
    /// Steepest slope across the edge, grey levels per px.
    pub strength: f64,
    /// Of the position along the normal, from pixel noise alone, px².
    pub variance: f64,
    /// How soft the edge is: px along the normal per unit of its contrast, about the middle of the step. 0: not measured.
    pub softness: f64,
}

/// How edges are told from noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeFilter {
    /// Of the Gaussian, px.
    pub sigma: f64,
    /// An edge begins where the gradient exceeds this many sigmas of its noise, and this many grey levels per px.
    pub start: (f64, f64),
    /// And goes on through neighbours that exceed these.
    pub keep: (f64, f64),
}

impl Default for EdgeFilter {
    /// Little smoothing, 10 sigma to start, 5 to go on; any slope.
    fn default() -> Self {
        Self { sigma: 0.7, start: (10.0, 0.0), keep: (5.0, 0.0) }
    }
}

/// A smoothing kernel and its derivative, `-radius..=radius`.
struct Kernels {
    smooth: List<f32>,
    derive: List<f32>,
}

impl Kernels {
    /// Gaussian of `sigma` px integrated over pixels, and its central slope; unit gain on a constant and on a ramp.
    fn new(sigma: f64) -> Self {
        let radius = (4.0 * sigma).ceil() as i32;
        let gauss = |x: f64| (-0.5 * (x / sigma).powi(2)).exp();
        let cdf = |x: f64| step(x / sigma).0;
        let taps = || (-radius..=radius).map(f64::from);
        let smooth = List::of(taps().map(|x| cdf(x + 0.5) - cdf(x - 0.5)));
        let derive = List::of(taps().map(|x| gauss(x - 0.5) - gauss(x + 0.5)));
        let (gain, slope) = (smooth.iter().sum::<f64>(), taps().zip(&derive).map(|(x, d)| x * d).sum::<f64>());
        Self {
            smooth: List::of(smooth.iter().map(|v| (v / gain) as f32)),
            derive: List::of(derive.iter().map(|v| (v / slope) as f32)),
        }
    }

    /// Variance of the gradient, and of the difference of two gradients 2 px apart across the edge, for unit pixel noise.
    fn noise(&self) -> (f64, f64) {
        let energy = |k: &[f32]| k.iter().map(|v| f64::from(v * v)).sum::<f64>();
        let padded = List::of([&[0.0; 2], &self.derive[..], &[0.0; 2]].into_iter().flatten().copied());
        let apart = List::of(padded.windows(3).map(|w| w[2] - w[0]));
        (energy(&self.derive) * energy(&self.smooth), energy(&apart) * energy(&self.smooth))
    }
}

/// A gradient, row by row, grey levels per px: its parts along x and y.
struct Gradient {
    x: List<f32>,
    y: List<f32>,
}

impl Gradient {
    /// Over `window`. Pixels beyond the image repeat its border.
    fn new(image: &Image<f32>, window: Window, kernels: &Kernels) -> Self {
        let (width, radius) = (window.width, kernels.smooth.len() / 2);
        let rows = window.height + 2 * radius;
        let [mut derived, mut smoothed] = [(); 2].map(|()| List::filled(0f32, rows * width)); // along rows
        let mut padded = List::filled(0.0, width + 2 * radius);
        for (r, (d, s)) in derived.chunks_exact_mut(width).zip(smoothed.chunks_exact_mut(width)).enumerate() {
            let row = image.row((window.y + r).saturating_sub(radius).min(image.height - 1));
            for (i, v) in padded.iter_mut().enumerate() {
                *v = row[(window.x + i).saturating_sub(radius).min(image.width - 1)];
            }
            for (k, (of_d, of_s)) in kernels.derive.iter().zip(&kernels.smooth).enumerate() {
                add(d, &padded[k..], *of_d);
                add(s, &padded[k..], *of_s);
            }
        }
        let [mut x, mut y] = [(); 2].map(|()| List::filled(0f32, window.height * width));
        for (r, (x, y)) in x.chunks_exact_mut(width).zip(y.chunks_exact_mut(width)).enumerate() {
            for (k, (of_d, of_s)) in kernels.derive.iter().zip(&kernels.smooth).enumerate() {
                add(x, &derived[(r + k) * width..], *of_s);
                add(y, &smoothed[(r + k) * width..], *of_d);
            }
        }
        Self { x, y }
    }

    fn at(&self, i: usize) -> Vector2<f32> {
        Vector2::new(self.x[i], self.y[i])
    }
}

/// `sums` and `factor` times the values that begin `values`: side by side, as vector units like it.
fn add(sums: &mut [f32], values: &[f32], factor: f32) {
    sums.iter_mut().zip(values).for_each(|(sum, v)| *sum += v * factor);
}

/// The edgels inside `window`, row by row, not on its outermost pixels.
///
/// `variance` gives the variance of a pixel's noise from its grey level. At the default filter and a blur of 0.8 px,
/// edges are within 0.11 px, across 4 px of gap 0.13, across 3 px 0.3: good to begin with, see `refine`.
/// Panics if the window is not inside the image.
pub fn find_edges(
    image: &Image<f32>,
    window: Window,
    filter: &EdgeFilter,
    variance: impl Fn(f64) -> f64,
) -> List<Edgel> {
    assert!(window.x + window.width <= image.width && window.y + window.height <= image.height, "window in image");
    let kernels = Kernels::new(filter.sigma);
    let (of_gradient, of_difference) = kernels.noise();
    let gradient = Gradient::new(image, window, &kernels);
    let strength = List::of(gradient.x.iter().zip(&gradient.y).map(|(x, y)| (x * x + y * y).sqrt()));
    let width = window.width;
    const NONE: u32 = u32::MAX;
    let mut found: List<(Edgel, bool)> = List::new(); // whether it is kept: an edge may begin here, or goes on
    let mut at = List::filled(NONE, strength.len()); // by pixel: which of them
    let mut stack = List::new();
    for y in 1..window.height.saturating_sub(1) {
        for x in 1..width.saturating_sub(1) {
            let i = y * width + x;
            if f64::from(strength[i]) <= filter.keep.1 {
                continue; // most pixels: no noise need be known
            }
            let pixel_variance = variance(f64::from(image.at(window.x + x, window.y + y)));
            let noise = (pixel_variance * of_gradient).sqrt();
            let exceeds = |(sigmas, slope): (f64, f64)| f64::from(strength[i]) > (sigmas * noise).max(slope);
            if !exceeds(filter.keep) {
                continue;
            }
            let Some((step, curvature)) = peak(&strength, width, i, gradient.at(i)) else { continue };
            let normal = gradient.at(i).map(f64::from).normalize();
            let edgel = Edgel {
                position: Pixel::new((window.x + x) as f64, (window.y + y) as f64) + step,
                normal,
                strength: f64::from(strength[i]),
                variance: pixel_variance * of_difference / (4.0 * curvature * curvature) / normal.amax().powi(2),
                softness: 0.0,
            };
            at[i] = found.len() as u32;
            found.push((edgel, false));
            if exceeds(filter.start) {
                stack.push(i);
            }
        }
    }
    while let Some(i) = stack.pop() {
        let Some((_, kept)) = found.get_mut(at[i] as usize).filter(|(_, kept)| !kept) else { continue };
        *kept = true;
        let rows = [i - width, i, i + width];
        stack.extend(rows.iter().flat_map(|i| i - 1..=i + 1).filter(|i| at[*i] != NONE));
    }
    List::of(found.iter().filter(|(_, kept)| *kept).map(|(edgel, _)| *edgel))
}

/// The offset (px) from pixel `i` to the maximum of `strength` along the gradient `g`, and the curvature there
/// (per px² of the axis nearest to `g`); `None` where `i` is no maximum. `i` is not on the border.
fn peak(strength: &[f32], width: usize, i: usize, g: Vector2<f32>) -> Option<(Vector2<f64>, f64)> {
    // One step along the axis nearest to the gradient, `t` of a step along the other.
    let (main, other, t) = if g.x.abs() >= g.y.abs() { (1, width, g.y / g.x) } else { (width, 1, g.x / g.y) };
    let blend = |straight: usize, diagonal: usize| {
        f64::from(strength[straight]) * f64::from(1.0 - t.abs()) + f64::from(strength[diagonal]) * f64::from(t.abs())
    };
    let (before, after) = if t >= 0.0 {
        (blend(i - main, i - main - other), blend(i + main, i + main + other))
    } else {
        (blend(i - main, i - main + other), blend(i + main, i + main - other))
    };
    let here = f64::from(strength[i]);
    if !(here > before && here >= after) {
        return None;
    }
    let curvature = 2.0 * here - before - after;
    let steps = 0.5 * (after - before) / curvature;
    let t = f64::from(t);
    Some((if main == 1 { Vector2::new(steps, steps * t) } else { Vector2::new(steps * t, steps) }, curvature))
}

/// The share of the way from dark to bright at which an edge is: less follows reflections inside the gap, more the
/// shading of the hem.
const LEVEL: f64 = 0.5;
/// An edge's softness is taken from so far above and below that share.
const SLOPE_LEVELS: [f64; 2] = [0.1, 0.2];
/// Variance of a smoothed value over a pixel's, had the profile not been averaged with its neighbours.
const NOISE_GAIN: f64 = 0.55;
/// Step along the profile, px.
const STEP: f64 = 0.5;
/// Smoothing along the profile, px.
const SMOOTHING: f64 = 0.6;
/// Profiles are the mean of five, so far apart along the edge, px.
const SPACING: f64 = 0.7;

/// The edgels where their profiles pass half the contrast, from the bright side; those that do not are dropped.
///
/// Bright and dark levels are looked for within `reach` px of the found edge, the crossing within two thirds of it.
/// `body` gives the grey level of the surface about a place: brighter is glint and does not count. A profile is the
/// mean of five parallel ones, so neighbouring edgels share noise; `variance` is stated so that a sum over all of
/// them is right. At a blur of 0.8 px and 80 grey levels over 1.8 of noise isolated edges reach 1.27 times the bound
/// `σ_I·√(2√π·s)/C` (limits: Rao, Cramér) and 0.003 px of bias. A gap without a floor, below 5 px, draws its edges in: 0.09 px at 4 px, 0.24 px at 3 px.
pub fn cross_level(
    image: &Image<f32>,
    edgels: &[Edgel],
    reach: f64,
    body: impl Fn(&Pixel) -> f64,
    variance: impl Fn(f64) -> f64,
) -> List<Edgel> {
    let mut profile = Profile::new(reach);
    List::of(edgels.iter().filter_map(|e| crossing(image, e, &mut profile, body(&e.position), &variance)))
}

/// The grey levels across one edge, and what is the same of all of them.
struct Profile {
    reach: f64,
    /// Smoothing, of sum 1.
    kernel: List<f32>,
    /// Five side by side for each value of the profile.
    places: List<[Place; 5]>,
    raw: List<f32>,
    values: List<f64>,
}

impl Profile {
    fn new(reach: f64) -> Self {
        let tail = (3.0 * SMOOTHING / STEP) as usize;
        let taps = (0..=2 * tail).map(|k| (-0.5 * ((k as f64 - tail as f64) * STEP / SMOOTHING).powi(2)).exp());
        let gain: f64 = taps.clone().sum();
        let kernel = List::of(taps.map(|v| (v / gain) as f32));
        let mut new = Self { reach, kernel, places: List::new(), raw: List::new(), values: List::new() };
        let places = 2 * new.half() + 1;
        new.places.resize(places, [Place::default(); 5]);
        new
    }

    /// Steps to each side of the edge.
    fn zero(&self) -> usize {
        (self.reach / STEP).ceil() as usize
    }

    /// And before it is smoothed.
    fn half(&self) -> usize {
        self.zero() + self.kernel.len() / 2
    }

    /// Takes the smoothed profile across `e`; `None` where it leaves the image.
    fn take(&mut self, image: &Image<f32>, e: &Edgel) -> Option<()> {
        let tangent = Vector2::new(-e.normal.y, e.normal.x) * SPACING;
        let half = self.half();
        let far = e.normal.abs() * (half as f64 * STEP) + tangent.abs() * 2.0;
        let patch = Patch::about(image, &e.position, &far)?;
        let (normal, tangent) = (e.normal.map(|v| (v * STEP) as f32), tangent.map(|v| v as f32));
        for (i, five) in self.places.iter_mut().enumerate() {
            let at = patch.middle + normal * (i as f32 - half as f32);
            for (k, place) in five.iter_mut().enumerate() {
                *place = patch.place(at + tangent * (k as f32 - 2.0));
            }
        }
        self.raw.clear();
        self.raw.extend(self.places.iter().map(|five| patch.sum(five) / 5.0));
        let smooth = |around: &[f32]| around.iter().zip(&self.kernel).map(|(v, k)| f64::from(v * k)).sum::<f64>();
        self.values.clear();
        self.values.extend(self.raw.windows(self.kernel.len()).map(smooth));
        Some(())
    }
}

fn crossing(
    image: &Image<f32>,
    e: &Edgel,
    profile: &mut Profile,
    body: f64,
    variance: impl Fn(f64) -> f64,
) -> Option<Edgel> {
    profile.take(image, e)?;
    let (reach, zero, values) = (profile.reach, profile.zero(), &profile.values);
    let n = 2 * zero;
    let place = |i: usize| (i as f64 - zero as f64) * STEP;
    // the mean about the darkest place: the least of many noisy values would be too dark
    let darkest = (0..=zero).min_by(|i, j| values[*i].total_cmp(&values[*j]))?;
    let beside = values[darkest.saturating_sub(1)] + values[(darkest + 1).min(zero)];
    let dark = 0.5 * values[darkest] + 0.25 * beside;
    let bright = values[zero..].iter().copied().fold(0.0, f64::max).min(body);
    if bright <= dark {
        return None;
    }
    // from where the bright side is bright, down to each level in turn
    let top = (zero..=n).rev().find(|i| values[*i] >= bright)?;
    let mut below = top;
    let mut cross = |share: f64| {
        let level = dark + share * (bright - dark);
        below = (0..=below.min(top - 1)).rev().find(|i| values[*i] < level)?;
        let four = [below.saturating_sub(1), below, below + 1, (below + 2).min(n)].map(|i| values[i]);
        let (part, slope) = reaches(&four, level);
        Some((place(below) + part * STEP, slope / STEP, level))
    };
    let [mut upper, mut lower] = [[0.0; SLOPE_LEVELS.len()]; 2];
    for (upper, apart) in upper.iter_mut().zip(SLOPE_LEVELS).rev() {
        *upper = cross(LEVEL + apart)?.0;
    }
    let (at, slope_here, level) = cross(LEVEL)?;
    for (lower, apart) in lower.iter_mut().zip(SLOPE_LEVELS) {
        *lower = cross(LEVEL - apart)?.0;
    }
    if at.abs() > reach * 2.0 / 3.0 {
        return None;
    }
    let apart = |(l, (u, d)): (&f64, (&f64, &f64))| l * (u - d);
    let squares: f64 = SLOPE_LEVELS.iter().map(|l| 2.0 * l * l).sum();
    let softness = SLOPE_LEVELS.iter().zip(upper.iter().zip(&lower)).map(apart).sum::<f64>() / squares;
    Some(Edgel {
        position: e.position + e.normal * at,
        normal: e.normal,
        strength: slope_here,
        variance: variance(level) * NOISE_GAIN / (slope_here * slope_here),
        softness,
    })
}

/// Where between the second and the third of `four` values, a step apart, the Catmull–Rom curve through them reaches
/// `level`, which lies between those two: in steps from the second. And its slope there, per step.
fn reaches(four: &[f64; 4], level: f64) -> (f64, f64) {
    let [before, low, high, after] = *four;
    let linear = ((level - low) / (high - low), high - low);
    let [b, c, d] = [
        0.5 * (high - before),
        before - 2.5 * low + 2.0 * high - 0.5 * after,
        0.5 * (after - before) + 1.5 * (low - high),
    ];
    let slope = |t: f64| b + t * (2.0 * c + 3.0 * d * t);
    let newton = |t: f64, _| t - (low + t * (b + t * (c + t * d)) - level) / slope(t);
    let t = (0..3).fold(linear.0, newton);
    if (0.0..=1.0).contains(&t) && slope(t) > 0.0 { (t, slope(t)) } else { linear }
}

/// Catmull–Rom's weights of four values, `t` of the way from the second to the third.
fn weights(t: f32) -> [f32; 4] {
    // of 1, t, t², t³: the four weights side by side
    const POWERS: [[f32; 4]; 4] =
        [[0.0, 1.0, 0.0, 0.0], [-0.5, 0.0, 0.5, 0.0], [1.0, -2.5, 2.0, -0.5], [-0.5, 1.5, -1.5, 0.5]];
    std::array::from_fn(|i| POWERS[0][i] + t * (POWERS[1][i] + t * (POWERS[2][i] + t * POWERS[3][i])))
}

/// A part of an image to interpolate in.
struct Patch<'a> {
    /// All pixels from its first on, and all from those one, two and three rows below; each as many.
    rows: [&'a [f32]; 4],
    width: usize,
    /// What it was made about, from the second column and row on, px.
    middle: Vector2<f32>,
}

/// A place in a [`Patch`]: the first of the four by four pixels about it, and the weights of their columns and rows.
#[derive(Clone, Copy, Default)]
struct Place {
    first: usize,
    across: [f32; 4],
    down: [f32; 4],
}

impl<'a> Patch<'a> {
    /// The places within `far` px of `middle`; `None` where one of them is within two pixels of the image's border.
    fn about(image: &'a Image<f32>, middle: &Pixel, far: &Vector2<f64>) -> Option<Self> {
        let (low, high) = (middle - far, middle + far);
        let inside = |low: f64, high: f64, n: usize| low >= 1.0 && high < n as f64 - 2.0; // a NaN is not
        if !(inside(low.x, high.x, image.width) && inside(low.y, high.y, image.height)) {
            return None;
        }
        // one pixel of margin to each side: places are found again in single precision
        let [column, row] = [low.x, low.y].map(|v| (v as usize).saturating_sub(2));
        let middle = (middle - Vector2::new((column + 1) as f64, (row + 1) as f64)).map(|v| v as f32);
        let (width, pixels) = (image.width, &image.pixels[row * image.width + column..]);
        let rows = [0, 1, 2, 3].map(|j| &pixels[j * width..pixels.len() - (3 - j) * width]);
        Some(Self { rows, width, middle })
    }

    /// `p`: px from the second column and row on.
    fn place(&self, p: Vector2<f32>) -> Place {
        let (column, row) = (p.x as i32, p.y as i32); // processors know 32 bits best
        let (across, down) = (weights(p.x - column as f32), weights(p.y - row as f32));
        Place { first: row as usize * self.width + column as usize, across, down }
    }

    /// The sum of the values at `places`, four columns side by side.
    fn sum(&self, places: &[Place]) -> f32 {
        let mut sums = [0f32; 4];
        for place in places {
            let mut columns = [0f32; 4];
            for (row, w) in self.rows.iter().zip(place.down) {
                let row: &[f32; 4] = row[place.first..].first_chunk().expect("a patch has four columns or more");
                (0..4).for_each(|i| columns[i] += w * row[i]);
            }
            (0..4).for_each(|i| sums[i] += columns[i] * place.across[i]);
        }
        sums.iter().sum()
    }
}

/// The normal distribution function and its density at `u`, to 1.5e-7.
/// Abramowitz, Stegun, "Handbook of Mathematical Functions", 1964, 7.1.26.
pub(crate) fn step(u: f64) -> (f64, f64) {
    let (z, gauss) = (u.abs() / SQRT_2, (-0.5 * u * u).exp());
    let t = 1.0 / (1.0 + 0.327_591_1 * z);
    let series = [1.061_405_429, -1.453_152_027, 1.421_413_741, -0.284_496_736, 0.254_829_592];
    let tail = 0.5 * gauss * t * series.iter().fold(0.0, |s, c| s * t + c);
    (if u < 0.0 { tail } else { 1.0 - tail }, gauss / (2.0 * PI).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{Noise, mean_std};

    const BLUR: f64 = 0.8;
    const SIGMA: f64 = 1.8;

    /// 48 × 48 pixels of a gap `width` px wide, levels 20 in it and 100 outside, blurred and integrated over pixels.
    /// Its one edge passes `phase` px from pixel (24, 24), with the normal towards bright at `angle`.
    fn gap(width: f64, angle: f64, phase: f64) -> Image<f32> {
        let mut image = Image::filled(48, 48, 0.0);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let mean = |f: &dyn Fn(f64) -> f64| {
                (0..16)
                    .map(|k| {
                        let (x, y) = (
                            (i % 48) as f64 - 24.375 + 0.25 * f64::from(k % 4),
                            (i / 48) as f64 - 24.375 + 0.25 * f64::from(k / 4),
                        );
                        f(x * angle.cos() + y * angle.sin() - phase)
                    })
                    .sum::<f64>()
                    / 16.0
            };
            *pixel = (20.0 + 80.0 * mean(&|u| step(u / BLUR).0 + step((-width - u) / BLUR).0)) as f32;
        }
        image
    }

    /// Signed errors (px, towards bright) and sigmas of the edgels near the middle of that one edge.
    fn errors(edgels: &[Edgel], angle: f64, phase: f64) -> Vec<(f64, f64)> {
        let normal = Vector2::new(angle.cos(), angle.sin());
        let near = edgels
            .iter()
            .filter(|e| e.normal.dot(&normal) > 0.7 && (e.position - Pixel::new(24.0, 24.0)).norm() < 10.0);
        near.map(|e| ((e.position - Pixel::new(24.0, 24.0)).dot(&normal) - phase, e.variance.sqrt())).collect()
    }

    #[test]
    fn interpolation_in_single_precision_is_that_in_double() {
        let mut noise = Noise::new(5);
        let image =
            Image { width: 9, height: 8, pixels: (0..72).map(|_| 128.0 + 60.0 * noise.gauss() as f32).collect() };
        let weight = |d: f64| match d.abs() {
            d if d <= 1.0 => 1.5 * d * d * d - 2.5 * d * d + 1.0,
            d if d < 2.0 => -0.5 * d * d * d + 2.5 * d * d - 4.0 * d + 2.0,
            _ => 0.0,
        };
        let about = |x: f64, y: f64, far: f64| Patch::about(&image, &Pixel::new(x, y), &Vector2::repeat(far));
        for (x, y) in [(1.0, 1.0), (4.3, 2.8), (6.999, 5.5), (3.25, 5.999)] {
            let all =
                (0..72).map(|i| f64::from(image.pixels[i]) * weight(x - (i % 9) as f64) * weight(y - (i / 9) as f64));
            let patch = about(x, y, 0.0).expect("inside");
            let got = patch.sum(&[patch.place(patch.middle)]);
            assert!((f64::from(got) - all.sum::<f64>()).abs() < 2e-4, "{x} {y}: {got}");
        }
        for (x, y) in [(0.99, 3.0), (3.0, 6.0), (7.0, 3.0), (f64::NAN, 3.0), (3.0, f64::INFINITY), (-1e300, 3.0)] {
            assert!(about(x, y, 0.0).is_none(), "{x} {y}");
        }
        assert!(about(4.0, 3.0, 1.9).is_some() && about(4.0, 3.0, 2.1).is_none() && about(2.0, 3.0, 1.1).is_none());
    }

    #[test]
    fn a_level_is_reached_where_the_curve_through_four_values_has_it() {
        let curve = |x: f64| step(x).0;
        for start in [-1.2, -0.6, -0.4, 0.3] {
            let four = [-1.0, 0.0, 1.0, 2.0].map(|k| curve(start + 0.3 * k));
            for part in [0.0, 0.2, 0.5, 0.9] {
                let (at, slope) = reaches(&four, curve(start + 0.3 * part));
                assert!((at - part).abs() < 0.003, "{start} {part}: {at}");
                assert!((slope / (0.3 * step(start + 0.3 * part).1) - 1.0).abs() < 0.03, "{start} {part}: {slope}");
            }
        }
    }

    fn edges(image: &Image<f32>) -> List<Edgel> {
        find_edges(image, Window::whole(48, 48), &EdgeFilter::default(), |_| SIGMA * SIGMA)
    }

    /// Largest error of noise-free edges of a gap, before and after refinement, over angles and phases.
    fn largest_bias(width: f64) -> (f64, f64) {
        let (mut found, mut refined) = (0.0f64, 0.0f64);
        for angle in (0..=18).map(|k| f64::from(5 * k).to_radians()) {
            for phase in (0..5).map(|k| 0.2 * f64::from(k)) {
                let image = gap(width, angle, phase);
                let edgels = edges(&image);
                let better = errors(&cross_level(&image, &edgels, 6.0, |_| 100.0, |_| SIGMA * SIGMA), angle, phase);
                assert!(better.len() >= 13, "{} edgels at {angle}", better.len());
                found = errors(&edgels, angle, phase).iter().fold(found, |m, e| m.max(e.0.abs()));
                refined = better.iter().fold(refined, |m, e| m.max(e.0.abs()));
            }
        }
        (found, refined)
    }

    /// Standard deviation of the mean place of a noisy edge's edgels, over the bound for as many rows, and over what
    /// their variances state; and the mean error, px.
    fn noise_ratios(width: f64) -> (f64, f64, f64) {
        let mut noise = Noise::new(7);
        let (mut by_bound, mut by_sigma, mut bias) = (Vec::new(), Vec::new(), Vec::new());
        let bound = SIGMA * (2.0 * PI.sqrt() * BLUR).sqrt() / 80.0;
        for trial in 0..360 {
            let (angle, phase) = (f64::from(trial % 90).to_radians(), noise.uniform());
            let mut image = gap(width, angle, phase);
            let exact = errors(&cross_level(&image, &edges(&image), 6.0, |_| 100.0, |_| SIGMA * SIGMA), angle, phase);
            let offset = exact.iter().map(|e| e.0).sum::<f64>() / exact.len() as f64;
            image.pixels.iter_mut().for_each(|v| *v += (SIGMA * noise.gauss()) as f32);
            let found = errors(&cross_level(&image, &edges(&image), 6.0, |_| 100.0, |_| SIGMA * SIGMA), angle, phase);
            let n = found.len() as f64;
            let mean = found.iter().map(|e| e.0).sum::<f64>() / n - offset;
            let stated = (found.iter().map(|e| e.1 * e.1).sum::<f64>() / n).sqrt();
            by_bound.push(mean * n.sqrt() / bound);
            by_sigma.push(mean * n.sqrt() / stated);
            bias.push(mean);
        }
        (mean_std(&by_bound).1, mean_std(&by_sigma).1, mean_std(&bias).0)
    }

    #[test]
    fn an_isolated_edge_is_unbiased_in_every_direction_and_near_the_bound() {
        let (found, refined) = largest_bias(30.0);
        let (by_bound, by_sigma, bias) = noise_ratios(30.0);
        eprintln!(
            "isolated: bias found {found:.4}, refined {refined:.4} px; noise: {by_bound:.3} bounds, {by_sigma:.3} sigmas, mean {bias:.4}"
        );
        assert!(found < 0.11 && refined < 0.02, "{found} {refined}");
        assert!(by_bound < 1.3 && bias.abs() < 0.01, "{by_bound} {bias}");
        assert!((0.8..1.2).contains(&by_sigma), "{by_sigma}");
    }

    #[test]
    fn the_other_edge_of_a_gap_drags_only_where_the_gap_has_no_floor() {
        for (width, allowed) in [(3.0, 0.25), (4.0, 0.10), (6.0, 0.02), (10.0, 0.02)] {
            let (found, refined) = largest_bias(width);
            let (by_bound, by_sigma, bias) = noise_ratios(width);
            eprintln!(
                "gap {width}: bias found {found:.4}, refined {refined:.4} px; noise: {by_bound:.3} bounds, {by_sigma:.3} sigmas, mean {bias:.4}"
            );
            assert!(refined < allowed && bias.abs() < 0.02, "gap {width}: {refined} {bias}");
            assert!(by_bound < 1.6 && (0.8..1.3).contains(&by_sigma), "gap {width}: {by_bound} {by_sigma}");
        }
    }

    #[test]
    fn a_found_edge_knows_its_noise_before_refinement() {
        let (mut noise, mut ratios) = (Noise::new(8), Vec::new());
        for angle in [0.0, 0.5, 1.5] {
            let exact = gap(30.0, angle, 0.1);
            let truth = edges(&exact);
            for _ in 0..20 {
                let mut image = exact.clone();
                image.pixels.iter_mut().for_each(|v| *v += (SIGMA * noise.gauss()) as f32);
                for e in &edges(&image) {
                    let near = truth.iter().find(|t| (t.position - e.position).norm() < 0.3);
                    ratios.extend(near.map(|t| (e.position - t.position).dot(&t.normal) / e.variance.sqrt()));
                }
            }
        }
        let (_, std) = mean_std(&ratios);
        eprintln!("found: {std:.3} sigmas of {}", ratios.len());
        assert!(ratios.len() > 1000 && (0.8..1.2).contains(&std), "{std}");
    }

    #[test]
    fn noise_alone_has_no_edges() {
        let mut noise = Noise::new(3);
        let mut image = Image::filled(200, 200, 80.0);
        image.pixels.iter_mut().for_each(|v| *v += (SIGMA * noise.gauss()) as f32);
        assert!(find_edges(&image, Window::whole(200, 200), &EdgeFilter::default(), |_| SIGMA * SIGMA).is_empty());
    }

    #[test]
    fn an_edge_is_where_it_is_whatever_the_window() {
        let image = gap(6.0, 0.3, 0.1);
        let window = Window { x: 10, y: 12, width: 30, height: 25 };
        let (part, whole) = (find_edges(&image, window, &EdgeFilter::default(), |_| 3.0), edges(&image));
        assert!(part.len() > 30 && part.iter().all(|e| whole.iter().any(|w| (w.position - e.position).norm() < 1e-5)));
    }
}
