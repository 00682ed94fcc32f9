//! The camera's noise law: how the variance of one sample grows with its level.
//! In: the sensor's data, or images. Out: a straight line, because photons are counted.
//! European Machine Vision Association, Standard 1288, release 4.0 (2021), §2.

use super::decode::Fits;
use super::stack::Planes;
use super::{Axis, Stack};
use crate::Image;
use crate::geometry::robust::median;
use crate::image::Window;
use crate::lent::List;

/// Rounding to whole grey levels, DN².
const ROUNDING: f64 = 1.0 / 12.0;

/// σ_I² = gain·(I − black) + variance0, DN².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseLaw {
    /// Grey levels per electron.
    pub gain: f64,
    /// Variance without light, rounding included, DN².
    pub variance0: f64,
    /// Level without light, DN.
    pub black: f64,
}

/// A level and one estimate of σ_I² at it, DN and DN².
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseSample {
    /// DN.
    pub level: f64,
    /// DN²; its expectation is σ_I².
    pub variance: f64,
}

impl NoiseLaw {
    /// From the sensor's gain (DN per electron), read noise (electrons) and black level (DN).
    pub fn from_sensor(gain_dn_per_e: f64, read_noise_e: f64, black: f64) -> Self {
        Self { gain: gain_dn_per_e, variance0: (gain_dn_per_e * read_noise_e).powi(2) + ROUNDING, black }
    }

    /// Variance of one sample at `level`, DN².
    pub fn variance(&self, level: f64) -> f64 {
        self.gain * (level - self.black).max(0.0) + self.variance0
    }

    /// The law of images whose noise has `excess` times this one's variance.
    pub fn with_excess(self, excess: f64) -> Self {
        Self { gain: excess * self.gain, variance0: excess * self.variance0, ..self }
    }

    /// From samples of images, robustly: per band of level the mean below nine times itself, then a line through
    /// the bands. A few per cent of the samples may be far off (edges, motion). Neither gain nor `variance0`
    /// comes out less than 0 and rounding allow. `None` with fewer than 200 samples.
    pub fn estimate(samples: &[NoiseSample], black: f64) -> Option<Self> {
        const BANDS: usize = 16;
        let usable = |s: &&NoiseSample| s.level.is_finite() && s.variance.is_finite();
        let levels = || samples.iter().filter(usable).map(|s| s.level);
        let (low, high) = (levels().fold(f64::INFINITY, f64::min), levels().fold(0.0, f64::max));
        let band_of = |s: &NoiseSample| {
            let band = (BANDS as f64 * (s.level - low) / (high - low + 1e-9)) as usize;
            band.min(BANDS - 1)
        };
        // Weighted sums of 1, x, x², v, x·v, with x the level above black and the weight n/v².
        let mut sums = [0.0; 5];
        let mut band = List::new();
        for k in 0..BANDS {
            band.clear();
            band.extend(samples.iter().filter(usable).filter(|s| band_of(s) == k).copied());
            if band.len() < 200 {
                continue;
            }
            let x = band.iter().map(|s| (s.level - black).max(0.0)).sum::<f64>() / band.len() as f64;
            let v = clipped_mean(&band).max(ROUNDING);
            let weight = band.len() as f64 / (v * v);
            for (sum, term) in sums.iter_mut().zip([1.0, x, x * x, v, x * v]) {
                *sum += weight * term;
            }
        }
        let [n, x, xx, v, xv] = sums;
        if n == 0.0 {
            return None;
        }
        let spread = xx - x * x / n;
        let gain = if spread > 1e-6 * xx { (xv - x * v / n) / spread } else { 0.0 };
        let variance0 = (v - gain.max(0.0) * x) / n;
        if variance0 >= ROUNDING {
            return Some(Self { gain: gain.max(0.0), variance0, black });
        }
        Some(Self { gain: ((xv - ROUNDING * x) / xx).max(0.0), variance0: ROUNDING, black })
    }
}

/// Mean of the variances below nine times their mean, to self-consistency; nine keeps 97.3 % of a squared Gaussian.
fn clipped_mean(band: &[NoiseSample]) -> f64 {
    const KEPT: f64 = 0.9733; // E[x²; |x| < 3] / P(|x| < 3) of a Gaussian of variance 1
    let mut sorted = List::of(band.iter().map(|s| s.variance));
    sorted.sort_unstable_by(f64::total_cmp);
    let mut mean = sorted[sorted.len() / 2].max(ROUNDING) / 0.4549; // the median of chi² with one degree of freedom
    for _ in 0..20 {
        let kept = sorted.partition_point(|&v| v <= 9.0 * mean).max(1);
        mean = (sorted[..kept].iter().sum::<f64>() / kept as f64 / KEPT).max(ROUNDING);
    }
    mean
}

/// Samples from the sine-fit residuals of a set of four steps or more, at most about `limit`; none from a set of
/// three, which fits anything, or one whose images are not all there. Harmonics of the projector count as noise.
pub fn residual_samples(stack: &Stack, limit: usize) -> List<NoiseSample> {
    let (set, windows) = (stack.set(), stack.complete().unwrap_or_default());
    let fits = Fits::new(*set, stack.white_level());
    let stride = (windows.iter().map(Planes::len).sum::<usize>() / limit.max(1)).max(1);
    let places = |planes: &Planes| (0..planes.len()).step_by(stride);
    let pixels = windows.iter().flat_map(|planes| places(planes).map(move |i| planes.part(i..i + 1)));
    let sample = |(level, variance)| NoiseSample { level, variance };
    List::of(pixels.filter_map(|pixel| fits.residual(pixel.map(|step| step[0]))).map(sample))
}

/// Pixels whose noise is held against a law; fewer than the second number say nothing.
const HELD: usize = 2048;
const FEWEST: usize = 200;

/// No paint makes images of fringes so much noisier (variance) than the sensor: that is something else than such images.
const NO_NOISE: f64 = 10.0;

/// By how much the images of a set are noisier than `law` says: a ratio of variances, at least 1. A projector's dither and a
/// lamp's flicker on glittering paint come on top of what a sensor does. Only what two pixels side by side along the fringes
/// do not have in common is noise: light that changes, motion, another pattern and harmonics are the same of both.
/// `wanted`: which pixels of the first window count; empty: all. 1 of a set of three steps, which fits anything, and where it
/// is too much to be noise.
pub fn excess_noise(stack: &Stack, law: &NoiseLaw, wanted: &[bool]) -> f64 {
    let (set, windows) = (stack.set(), stack.complete().unwrap_or_default());
    let (Some(planes), Some(freedom)) = (windows.first(), set.steps.checked_sub(3).filter(|f| *f > 0)) else {
        return 1.0;
    };
    let fits = Fits::new(*set, stack.white_level());
    let beside = if set.axis == Axis::Column { planes.window.width } else { 1 };
    let counts = |i: &usize| wanted.is_empty() || wanted[*i] && wanted[*i + beside];
    let pixels = || (0..planes.len().saturating_sub(beside)).filter(counts);
    let stride = pixels().count().div_ceil(HELD).max(1);
    let (mut ratios, mut n) = ([0.0; HELD], 0);
    for i in pixels().step_by(stride) {
        let [one, other] = [i, i + beside].map(|i| planes.part(i..i + 1).map(|step| step[0]));
        if let Some((level, variance)) = fits.residual_apart(one, other) {
            ratios[n] = variance / law.variance(level);
            n += 1;
        }
    }
    if n < FEWEST {
        return 1.0;
    }
    // the median, as edges and sudden gloss are no noise; of chi² over its freedom by Wilson and Hilferty (1931)
    let expected = (1.0 - 2.0 / (9.0 * f64::from(freedom))).powi(3);
    let excess = (median(&mut ratios[..n]) / expected).max(1.0);
    if excess < NO_NOISE { excess } else { 1.0 }
}

/// Samples from second differences of one fringe image along the fringes, at most about `limit`: what a set of three
/// steps can tell. `axis`: the projector's, taken for the camera's (the two stand roughly upright to each other).
/// The texture of the surface counts as noise. Samples from `white_level` up are left out. Panics if the window
/// reaches beyond the image.
pub fn difference_samples(
    image: &Image<u16>,
    axis: Axis,
    window: Window,
    white_level: u16,
    limit: usize,
) -> List<NoiseSample> {
    let (dx, dy) = if axis == Axis::Column { (0, 1) } else { (1, 0) };
    let (columns, rows) = (window.width.saturating_sub(2 * dx), window.height.saturating_sub(2 * dy));
    let stride = (columns * rows / limit.max(1)).max(1);
    let sample = |i: usize| {
        let (x, y) = (window.x + i % columns, window.y + i / columns);
        let three = [0, 1, 2].map(|k| image.at(x + k * dx, y + k * dy));
        let [a, b, c] = three.map(f64::from);
        let second = a - 2.0 * b + c; // of independent samples: variance 1 + 4 + 1
        let unsaturated = three.iter().all(|&v| v < white_level);
        unsaturated.then_some(NoiseSample { level: (a + b + c) / 3.0, variance: second * second / 6.0 })
    };
    List::of((0..columns * rows).step_by(stride).filter_map(sample))
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Random, planted};
    use super::*;
    use crate::fringe::PatternSet;

    /// The law at dark, middle and bright levels, as shares of the truth.
    fn shares(got: &NoiseLaw, truth: &NoiseLaw) -> [f64; 3] {
        [20.0, 80.0, 160.0].map(|level| got.variance(level) / truth.variance(level))
    }

    #[test]
    fn residuals_of_four_and_eight_steps_give_the_planted_law() {
        for gain in [0.02, 0.08] {
            for steps in [4, 8] {
                let truth = NoiseLaw::from_sensor(gain, 12.0, 2.0);
                let set = PatternSet::new(Axis::Column, 1, steps).expect("legal");
                let light = |i: usize| (10.0 + (i % 170) as f64, 0.7 * (i % 170) as f64, i as f64 * 0.1);
                let mut sums = planted(set, 40_000, light, &truth, Some(&mut Random(5)));
                let got = NoiseLaw::estimate(&residual_samples(&sums, 30_000), 2.0).expect("samples");
                assert!((got.gain / truth.gain - 1.0).abs() < 0.1, "{steps} steps: {got:?} for {truth:?}");
                assert!(shares(&got, &truth).iter().all(|s| (s - 1.0).abs() < 0.1), "{got:?} for {truth:?}");
                sums.restart(&[]);
                assert!(residual_samples(&sums, 30_000).is_empty());
            }
        }
    }

    #[test]
    fn second_differences_along_the_fringes_give_the_planted_law_despite_edges() {
        for (axis, gain) in [(Axis::Column, 0.02), (Axis::Row, 0.08)] {
            let truth = NoiseLaw::from_sensor(gain, 12.0, 2.0);
            let mut random = Random(9);
            let mut image = Image::filled(300, 300, 0_u16);
            for (i, sample) in image.pixels.iter_mut().enumerate() {
                let (mut x, mut y) = (i % 300, i / 300);
                if axis == Axis::Row {
                    (x, y) = (y, x);
                }
                let edge = if y % 100 < 50 { 1.0 } else { 0.3 }; // 4 % of the second differences see one
                *sample = random.sample(edge * (100.0 + 80.0 * (x as f64 * 0.2).cos()), &truth);
            }
            let samples = difference_samples(&image, axis, Window::whole(300, 300), 255, 50_000);
            let got = NoiseLaw::estimate(&samples, 2.0).expect("samples");
            assert!((got.gain / truth.gain - 1.0).abs() < 0.1, "{axis:?}: {got:?} for {truth:?}");
            assert!(shares(&got, &truth).iter().all(|s| (s - 1.0).abs() < 0.1), "{got:?} for {truth:?}");
        }
    }

    #[test]
    fn noise_beyond_the_law_is_seen_and_what_neighbours_have_in_common_is_none() {
        let (law, mut random) = (NoiseLaw::from_sensor(0.032, 6.0, 2.0), Random(4));
        let cases = [(4, 1.0, 0.0), (8, 1.0, 0.0), (4, 3.3, 0.0), (8, 3.3, 0.0), (4, 1.0, 6.0), (8, 3.3, 6.0)];
        for (steps, excess, flicker) in cases {
            let set = PatternSet::new(Axis::Column, 8, steps).expect("legal");
            let window = Window::whole(3000, 2);
            let mut stack = Stack::new(set, 255, &[window]).expect("legal");
            for step in 0..steps {
                let changed = if step % 2 == 0 { flicker } else { -flicker };
                let level = |x: usize| 140.0 + 30.0 * (0.02 * x as f64 + set.shift(step)).cos() + changed;
                let sample = |i: usize| random.sample(level(i % 3000), &law.with_excess(excess));
                let image = Image { width: 3000, height: 2, pixels: (0..6000).map(sample).collect() };
                stack.add(step, &image).expect("fits");
            }
            let all = excess_noise(&stack, &law, &[]);
            assert!((all / excess - 1.0).abs() < 0.12, "{steps} steps, {flicker}: {all} for {excess}");
            let garbage = excess_noise(&stack, &law.with_excess(excess / 20.0), &[]);
            assert_eq!(garbage, 1.0, "what is 20 times as much is no noise");
            let few: Vec<bool> = (0..6000).map(|i| i % 3000 < 100).collect();
            assert_eq!(excess_noise(&stack, &law, &few), 1.0, "of 100 pixels nothing can be said");
        }
    }

    #[test]
    fn a_set_of_three_steps_has_no_residual_and_nothing_gives_no_law() {
        let set = PatternSet::new(Axis::Column, 1, 3).expect("legal");
        let law = NoiseLaw::from_sensor(0.03, 6.0, 0.0);
        let stack = planted(set, 300, |_| (90.0, 50.0, 1.0), &law, None);
        assert!(residual_samples(&stack, 300).is_empty());
        assert_eq!(excess_noise(&stack, &law, &[]), 1.0);
        assert_eq!(NoiseLaw::estimate(&[], 0.0), None);
    }
}
