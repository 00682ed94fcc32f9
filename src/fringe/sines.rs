//! The sines of many pixels side by side: of those with all their steps, which is almost every one.
//! In: their samples, step by step. Out: phase, variance, level, modulation, state; and whether some are to be fitted alone.
//!
//! Least squares of all steps are their Fourier sums, the same of every pixel, and what follows has no branch: vector
//! units take as many pixels at a time as they are wide. What is summed is what a step differs from the first by. It is
//! as large as the modulation, not as the level, so that single precision holds of squares, too.

use super::arctangent::arctangents;
use super::phases::{Part, State};
use super::{Limits, NoiseLaw, PatternSet};
use crate::lent::List;

/// Pixels whose sums are kept in registers while their steps are added.
const LANES: usize = 8;
/// Pixels decoded at a time: what they need fits into the nearest cache.
pub(super) const BLOCK: usize = 128;

/// What is the same of all pixels of a set.
pub(super) struct Sines {
    white_level: u16,
    /// 1/N, of N steps.
    share: f32,
    /// Of every step but the first, 2/N times the cosine and the negative sine of its shift.
    weights: List<(f32, f32)>,
    noise: NoiseLine,
    /// Least modulation, squared: absolute, and over the variance of a sample.
    weak: (f32, f32),
    /// Most residual, over the variance of a sample, and over the modulation squared.
    no_sine: (f32, f32),
}

/// The noise law: variance of a sample at `level`, max(gain·level + dark, least).
struct NoiseLine {
    gain: f32,
    dark: f32,
    least: f32,
    black: f32,
    /// Half the gain if the steps are three, whose steep ones may all be bright or dark: see [`Sines::judge`].
    third: f32,
}

/// Of each pixel of a block.
struct Sums {
    /// B·cos φ.
    x: [f32; BLOCK],
    /// B·sin φ.
    y: [f32; BLOCK],
    /// Σ(I − A)².
    square: [f32; BLOCK],
}

impl Sines {
    /// Of `set`, whose samples from `white_level` up are saturated. `implausible`: the χ² of a residual of this set that
    /// is none of noise.
    pub(super) fn new(set: &PatternSet, white_level: u16, noise: &NoiseLaw, limits: &Limits, implausible: f64) -> Self {
        let n = f64::from(set.steps);
        let weight = |step| {
            let (sin, cos) = set.shift(step).sin_cos();
            ((2.0 / n * cos) as f32, (-2.0 / n * sin) as f32)
        };
        Self {
            white_level,
            share: (1.0 / n) as f32,
            weights: List::of((1..set.steps).map(weight)),
            noise: NoiseLine {
                gain: noise.gain as f32,
                dark: (noise.variance0 - noise.gain * noise.black) as f32,
                least: noise.variance0 as f32,
                black: noise.black as f32,
                third: if set.steps == 3 { 0.5 * noise.gain as f32 } else { 0.0 },
            },
            weak: (limits.modulation_dn.powi(2) as f32, limits.modulation_sigmas.powi(2) as f32),
            // Σ(I − A)² is N/2·B² more than the residual
            no_sine: (implausible as f32, (limits.harmonics.powi(2) * implausible + 0.5 * n) as f32),
        }
    }

    /// The phases of at most [`BLOCK`] pixels, whose samples are given step by step. False where some are not as stated:
    /// those that [`Self::is_apart`] says.
    pub(super) fn fit(&self, steps: &[&[u16]], out: &mut Part<'_>) -> bool {
        if out.len() < LANES {
            return false;
        }
        let mut sums = Sums { x: [0.0; BLOCK], y: [0.0; BLOCK], square: [0.0; BLOCK] };
        let brightest = self.add(steps, out.level, &mut sums);
        let dark = self.judge(&sums, out);
        brightest < self.white_level && !dark
    }

    /// Whether the fit of all steps is none of pixel `i` of those that [`Self::fit`] was given: a step was saturated,
    /// or the fit goes below black, where the noise law has its bend.
    pub(super) fn is_apart(&self, steps: &[&[u16]], out: &Part<'_>, i: usize) -> bool {
        let dark = out.state[i] != State::Weak && out.modulation[i] + self.noise.black > out.level[i];
        out.len() < LANES || dark || steps.iter().any(|step| step[i] >= self.white_level)
    }

    /// The sums over all steps; gives back the brightest sample.
    fn add(&self, steps: &[&[u16]], level: &mut [f32], sums: &mut Sums) -> u16 {
        let (first, others) = steps.split_first().expect("a set has three steps or more");
        let mut brightest = [0; LANES];
        for begin in (0..level.len()).step_by(LANES) {
            let begin = begin.min(level.len() - LANES); // where the lanes go beyond the last pixel, some once more
            let lanes = |step: &[u16]| *step[begin..].first_chunk::<LANES>().expect("as long as the others");
            let base = lanes(first);
            let [mut mean, mut x, mut y, mut square] = [[0f32; LANES]; 4];
            (0..LANES).for_each(|i| brightest[i] = brightest[i].max(base[i]));
            for (step, (cos, sin)) in others.iter().zip(&self.weights) {
                let samples = lanes(step);
                for i in 0..LANES {
                    let off = f32::from(samples[i]) - f32::from(base[i]);
                    mean[i] += off;
                    x[i] += off * cos;
                    y[i] += off * sin;
                    square[i] += off * off;
                    brightest[i] = brightest[i].max(samples[i]);
                }
            }
            for i in 0..LANES {
                let off = mean[i] * self.share;
                square[i] -= mean[i] * off;
                mean[i] = f32::from(base[i]) + off;
            }
            let lists = [level as &mut [f32], &mut sums.x, &mut sums.y, &mut sums.square];
            lists
                .into_iter()
                .zip([mean, x, y, square])
                .for_each(|(to, from)| to[begin..][..LANES].copy_from_slice(&from));
        }
        brightest.into_iter().max().unwrap_or(0)
    }

    /// All else that follows from the sums; gives back whether some fit goes below black. The variance propagates the
    /// noise law at each step's fitted level: Σ (2·sin(φ+θ)/(N·B))²·σ²(A + B·cos(φ+θ)) over the shifts θ. With four steps
    /// or more nothing is left of the cosine; with three, −gain·cos 3φ/(N·B). Either is at most σ²(A)/B² where no fit goes
    /// below black, so that it is no reason of its own to be weak.
    fn judge(&self, sums: &Sums, out: &mut Part<'_>) -> bool {
        let n = out.len();
        let (x, y, square) = (&sums.x[..n], &sums.y[..n], &sums.square[..n]);
        let Part { phase, variance, level, modulation, saturated, state } = out;
        let (phase, variance) = (&mut phase[..n], &mut variance[..n]);
        let (level, modulation, state) = (&level[..n], &mut modulation[..n], &mut state[..n]);
        let NoiseLine { gain, dark, least, black, third } = self.noise;
        let ((weak, weak_noise), (no_sine_noise, no_sine)) = (self.weak, self.no_sine);
        let mut tangents = [0f32; BLOCK];
        let tangents = &mut tangents[..n];
        let mut below = false;
        for i in 0..n {
            let cos2 = x[i] * x[i];
            let b2 = cos2 + y[i] * y[i];
            modulation[i] = b2.sqrt();
            let beside = modulation[i] + x[i].abs();
            let both = 1.0 / (beside * b2); // one division for two
            tangents[i] = y[i] * b2 * both;
            let per_b2 = beside * both;
            let line = gain * level[i] + dark;
            let sample = if line > least { line } else { least };
            let strong = (b2 >= weak) & (b2 >= weak_noise * sample);
            let sine = square[i] <= sample * no_sine_noise + b2 * no_sine;
            state[i] = match (strong, sine) {
                (false, _) => State::Weak,
                (true, false) => State::NotSine,
                (true, true) => State::Valid,
            };
            let spread = 2.0 * self.share * per_b2 * (sample - third * x[i] * (4.0 * cos2 * per_b2 - 3.0));
            let valid = strong & sine;
            variance[i] = if valid { spread } else { f32::NAN };
            phase[i] = if valid { 0.0 } else { f32::NAN };
            below |= strong & (modulation[i] + black > level[i]);
        }
        arctangents(tangents, x, phase);
        saturated.fill(false);
        below
    }
}
