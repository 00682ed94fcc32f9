//! Wrapped phase from the images of one fringe set.
//! In: a complete stack, the camera's noise law. Out: per pixel phase, its variance, level and modulation, or why not.
//! Method: least squares over the steps that were not saturated; Greivenkamp, "Generalized data reduction for
//! heterodyne interferometry", Optical Engineering 23 (1984) 350. Not here: which fringe it is.

use super::phases::{Phase, Phases, State};
use super::sines::{BLOCK, Sines};
use super::{Error, NoiseLaw, PatternSet, Stack};
use crate::image::Window;
use crate::lent::List;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use std::sync::OnceLock;

/// Of a set, as the mask of saturated steps holds.
const MAX_STEPS: usize = 16;

/// What a pixel must show to be believed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Least modulation, in sigmas of one sample.
    pub modulation_sigmas: f64,
    /// Least modulation, DN: below it rounding to whole grey levels is no longer noise.
    pub modulation_dn: f64,
    /// What a sine-fit residual may hold besides noise: rms of harmonics and flicker over the modulation.
    /// Gamma 1.1 leaves 0.02, gamma 1.2 0.04.
    pub harmonics: f64,
    /// Most that two sets may disagree about the phase, in fringes of the finer; 0.5 would be anything. Three steps
    /// under gamma disagree systematically, and at a ratio of 16 by 0.3.
    pub order_residual: f64,
}

impl Limits {
    /// What a linear projector, four steps and ratios of eight keep easily.
    pub const DEFAULT: Self =
        Self { modulation_sigmas: 4.0, modulation_dn: 2.0, harmonics: 0.04, order_residual: 0.25 };
}

impl Default for Limits {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The phases of one set in one window, row by row.
#[derive(Clone, Debug)]
pub struct PhaseMap {
    /// The set decoded.
    pub set: PatternSet,
    /// Where in the image.
    pub window: Window,
    /// `window.width * window.height` phases.
    pub pixels: Phases,
}

/// One map per window of `stack`. The variance propagates `noise` at each step's fitted level through the fit; with
/// all of four steps or more it is 2σ_I²/(N·B²) with σ_I² at the mean level. Errors where steps are missing.
pub fn decode(stack: &Stack, noise: &NoiseLaw, limits: &Limits) -> Result<List<PhaseMap>, Error> {
    let mut maps = List::new();
    for k in 0..stack.complete()?.len() {
        maps.push(decode_where(stack, k, noise, limits, &[])?);
    }
    Ok(maps)
}

/// As [`decode`], of window `k` alone, and only where `wanted`, row by row: all else is left weak. An empty `wanted`
/// wants everything. Panics if there is no such window or `wanted` is of another size.
pub fn decode_where(
    stack: &Stack,
    k: usize,
    noise: &NoiseLaw,
    limits: &Limits,
    wanted: &[bool],
) -> Result<PhaseMap, Error> {
    let (set, planes) = (*stack.set(), &stack.complete()?[k]);
    let all = wanted.is_empty();
    assert!(all || wanted.len() == planes.len(), "what is wanted is of another window");
    let mut pixels = Phases::stale(planes.len());
    let fits = Fits::new(set, stack.white_level());
    let sines = Sines::new(&set, stack.white_level(), noise, limits, implausible_chi2(f64::from(set.steps) - 3.0));
    pixels.parts(BLOCK).with_min_len(4).enumerate().for_each(|(block, mut phases)| {
        let range = block * BLOCK..block * BLOCK + phases.len();
        let wanted = |i: usize| all || wanted[range.start + i];
        if !(0..phases.len()).any(wanted) {
            return phases.fill(Phase::NONE);
        }
        let mut steps = [[].as_slice(); MAX_STEPS];
        let (steps, _) = steps.split_at_mut(set.steps as usize);
        steps.iter_mut().zip(planes.part(range.clone())).for_each(|(to, from)| *to = from);
        if !sines.fit(steps, &mut phases) {
            for i in 0..phases.len() {
                if sines.is_apart(steps, &phases, i) {
                    phases.set(i, fits.phase(steps.iter().map(|step| step[i]), noise, limits));
                }
            }
        }
        (0..phases.len()).filter(|i| !wanted(*i)).for_each(|i| phases.set(i, Phase::NONE));
    });
    Ok(PhaseMap { set, window: planes.window, pixels })
}

/// The least-squares fits of one set, one per mask of saturated steps, made when first met.
pub(super) struct Fits {
    set: PatternSet,
    white_level: u16,
    /// Sine and cosine of each step's shift.
    shifts: heapless::Vec<(f64, f64), MAX_STEPS>,
    by_mask: List<OnceLock<Option<Fit>>>,
}

/// I_k = w_k·x, with w_k = (1, cos θ_k, −sin θ_k) and x = (A, B·cos φ, B·sin φ).
struct Fit {
    /// (Σ w·wᵀ)⁻¹; times w_k it is the weight of step k in the answer.
    inverse: Matrix3<f64>,
}

/// What the fit of one pixel says.
struct Sine {
    x: Vector3<f64>,
    residual: f64,
}

impl Fits {
    pub(super) fn new(set: PatternSet, white_level: u16) -> Self {
        let shifts = (0..set.steps).map(|step| set.shift(step).sin_cos()).collect();
        Self { set, white_level, shifts, by_mask: List::of((0..1 << set.steps).map(|_| OnceLock::new())) }
    }

    /// w_k of the steps that are not `saturated`.
    fn used(&self, saturated: u16) -> impl Iterator<Item = Vector3<f64>> + Clone {
        let used = (0..).zip(&self.shifts).filter(move |(step, _)| saturated >> step & 1 == 0);
        used.map(|(_, (sin, cos))| Vector3::new(1.0, *cos, -sin))
    }

    fn fit(&self, saturated: u16) -> Option<&Fit> {
        let make = || {
            let used = self.used(saturated);
            if used.clone().count() < 3 {
                return None;
            }
            let normal: Matrix3<f64> = used.map(|w| w * w.transpose()).sum();
            Some(Fit { inverse: normal.try_inverse()? })
        };
        self.by_mask[usize::from(saturated)].get_or_init(make).as_ref()
    }

    /// Level and residual variance (DN², mean over the degrees of freedom) of an unsaturated pixel, whose samples of each
    /// step are given; `None` where there is no freedom.
    pub(super) fn residual(&self, samples: impl Iterator<Item = u16>) -> Option<(f64, f64)> {
        let (sums, saturated) = self.sums(samples);
        let freedom = self.set.steps.checked_sub(3).filter(|&f| f > 0 && saturated == 0)?;
        let sine = self.fit(0)?.solve(&sums);
        Some((sine.x[0], sine.residual / f64::from(freedom)))
    }

    /// The same of what two pixels do not have in common: of their difference's residual the half.
    pub(super) fn residual_apart(
        &self,
        one: impl Iterator<Item = u16> + Clone,
        other: impl Iterator<Item = u16> + Clone,
    ) -> Option<(f64, f64)> {
        let square = one.clone().zip(other.clone()).map(|(a, b)| (f64::from(a) - f64::from(b)).powi(2)).sum();
        let ((one, over), (other, too)) = (self.sums(one), self.sums(other));
        let freedom = self.set.steps.checked_sub(3).filter(|&f| f > 0 && over | too == 0)?;
        let apart = [one[0] - other[0], one[1] - other[1], one[2] - other[2], square];
        let sine = self.fit(0)?.solve(&apart);
        Some((0.5 * (one[0] + other[0]) / f64::from(self.set.steps), 0.5 * sine.residual / f64::from(freedom)))
    }

    /// ΣI, ΣI·cos θ, ΣI·sin θ, ΣI² of the steps that are not saturated, θ the step's shift; and by bit which are.
    fn sums(&self, samples: impl Iterator<Item = u16>) -> ([f64; 4], u16) {
        let (mut sums, mut saturated) = ([0.0; 4], 0);
        for ((step, sample), (sin, cos)) in (0..).zip(samples).zip(&self.shifts) {
            if sample >= self.white_level {
                saturated |= 1 << step;
                continue;
            }
            let i = f64::from(sample);
            sums.iter_mut().zip([1.0, *cos, *sin, i]).for_each(|(sum, weight)| *sum += i * weight);
        }
        (sums, saturated)
    }

    /// The phase of a pixel by the fit of the steps that are not saturated; whose samples are given step by step.
    fn phase(&self, samples: impl Iterator<Item = u16>, noise: &NoiseLaw, limits: &Limits) -> Phase {
        let (sums, saturated) = self.sums(samples);
        let nothing = Phase { saturated: saturated != 0, state: State::Saturated, ..Phase::NONE };
        let Some(fit) = self.fit(saturated) else { return nothing };
        let Sine { x, residual } = fit.solve(&sums);
        let (level, modulation) = (x[0], (x[1] * x[1] + x[2] * x[2]).sqrt()); // nothing here overflows: no `hypot`
        let seen = Phase { level: level as f32, modulation: modulation as f32, ..nothing };

        let one_sample = noise.variance(level);
        if modulation < limits.modulation_dn.max(limits.modulation_sigmas * one_sample.sqrt()) {
            return Phase { state: State::Weak, ..seen };
        }
        let gradient = Vector3::new(0.0, -x[2], x[1]) / (modulation * modulation); // of atan2(x2, x1)
        let share = |w: Vector3<f64>| gradient.dot(&(fit.inverse * w)).powi(2) * noise.variance(w.dot(&x));
        let variance: f64 = self.used(saturated).map(share).sum();
        // A few neighbouring steps tell a sine badly: no worse than a full set of the least modulation.
        if variance * limits.modulation_sigmas.powi(2) > 1.0 {
            return Phase { state: State::Weak, ..seen };
        }
        let freedom = self.used(saturated).count() as f64 - 3.0;
        let spread = one_sample + (limits.harmonics * modulation).powi(2);
        if residual > spread * implausible_chi2(freedom) {
            return Phase { state: State::NotSine, ..seen };
        }
        Phase { phase: x[2].atan2(x[1]) as f32, variance: variance as f32, state: State::Valid, ..seen }
    }
}

impl Fit {
    fn solve(&self, &[i, cos, sin, square]: &[f64; 4]) -> Sine {
        let rhs = Vector3::new(i, cos, -sin);
        let x = self.inverse * rhs;
        Sine { x, residual: (square - x.dot(&rhs)).max(0.0) }
    }
}

/// A chi² that noise alone exceeds about once in 10⁴ pixels. Without freedom the residual is rounding: anything goes.
fn implausible_chi2(freedom: f64) -> f64 {
    if freedom > 0.0 { freedom + 4.0 * (2.0 * freedom).sqrt() + 8.0 } else { 1e30 }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Random, planted, samples};
    use super::*;
    use crate::fringe::Axis;
    use std::f64::consts::{PI, TAU};

    const NOISE: NoiseLaw = NoiseLaw { gain: 0.036, variance0: 0.2, black: 0.0 };

    fn set(steps: u32) -> PatternSet {
        PatternSet::new(Axis::Column, 1, steps).expect("legal")
    }

    fn one(stack: &Stack) -> PhaseMap {
        decode(stack, &NOISE, &Limits::default()).expect("complete").remove(0)
    }

    /// Phase errors of the valid pixels over their stated sigma: (how many, mean, standard deviation).
    fn errors(map: &PhaseMap, truth: impl Fn(usize) -> f64) -> (usize, f64, f64) {
        let error = |(i, p): (usize, Phase)| {
            let e = f64::from(p.phase) - truth(i);
            (e - TAU * (e / TAU).round()) / f64::from(p.variance).sqrt()
        };
        let valid = map.pixels.iter().enumerate().filter(|(_, p)| p.state == State::Valid);
        let e: Vec<f64> = valid.map(error).collect();
        let mean = e.iter().sum::<f64>() / e.len() as f64;
        let std = (e.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / e.len() as f64).sqrt();
        (e.len(), mean, std)
    }

    #[test]
    fn pixels_side_by_side_are_decoded_as_each_alone() {
        // dark and weak ones at the end; every seventh goes below black in its trough, as glints and shadows do
        let light = |i: usize| {
            let (level, modulation) = (80.0 - 0.1 * i as f64, (60.0 - 0.1 * i as f64).max(0.0));
            (level, if i.is_multiple_of(7) { 1.1 * level } else { modulation }, 0.37 * i as f64)
        };
        let (n, black) = (5 * BLOCK + 17, NoiseLaw { black: 6.0, ..NOISE });
        for (steps, white, noise) in
            [3, 4, 5, 8, 16].iter().flat_map(|n| [(*n, 256, NOISE), (*n, 256, black), (*n, 130, NOISE)])
        {
            let mut random = Random(23); // 130: some lose a step
            let images = samples(set(steps), n, light, |light| random.sample(light.max(0.0), &noise));
            let mut stack = Stack::new(set(steps), white, &[Window::whole(n, 1)]).expect("legal");
            (0..).zip(&images).for_each(|(step, image)| stack.add(step, image).expect("fits"));
            let map = decode(&stack, &noise, &Limits::DEFAULT).expect("complete").remove(0);
            let fits = Fits::new(set(steps), white);
            let mut states = std::collections::HashMap::new();
            for (i, got) in map.pixels.iter().enumerate() {
                let alone = fits.phase(images.iter().map(|image| image.pixels[i]), &noise, &Limits::DEFAULT);
                assert_eq!((got.state, got.saturated), (alone.state, alone.saturated), "{steps} steps, {i}");
                *states.entry(format!("{:?}", got.state)).or_insert(0) += 1;
                let near = |a: f32, b: f32, within: f32| (a.is_nan() && b.is_nan()) || (a - b).abs() <= within;
                let turns = ((got.phase - alone.phase) / std::f32::consts::TAU).round();
                let phase = if turns.is_nan() { got.phase } else { got.phase - turns * std::f32::consts::TAU };
                assert!(near(phase, alone.phase, 2e-6), "{got:?} {alone:?}");
                assert!(near(got.variance, alone.variance, 2e-5 * alone.variance), "{got:?} {alone:?}");
                assert!(near(got.level, alone.level, 2e-5) && near(got.modulation, alone.modulation, 2e-5));
            }
            assert!(states["Valid"] > 300 && states["Weak"] > 50, "{states:?}");
        }
    }

    #[test]
    fn phase_errors_follow_the_noise_law_without_bias() {
        for steps in [3, 4, 8] {
            for (level, modulation) in [(80.0, 60.0), (45.0, 30.0), (15.0, 8.0)] {
                let n = 20_000;
                let phase = |i: usize| TAU * (i as f64 * 0.618).fract() - PI;
                let mut random = Random(7);
                let map = one(&planted(set(steps), n, |i| (level, modulation, phase(i)), &NOISE, Some(&mut random)));
                let (valid, mean, std) = errors(&map, phase);
                assert!(valid > n * 998 / 1000, "{steps} steps, B {modulation}: {valid} valid");
                assert!(mean.abs() < 0.03, "{steps} steps, B {modulation}: bias {mean} sigma");
                assert!((0.95..1.05).contains(&std), "{steps} steps, B {modulation}: {std} of the stated sigma");
                let law = 2.0 * NOISE.variance(level) / (f64::from(steps) * modulation * modulation);
                let stated = map.pixels.iter().filter(|p| p.state == State::Valid).map(|p| f64::from(p.variance));
                let stated = stated.sum::<f64>() / valid as f64;
                assert!((stated / law - 1.0).abs() < 0.03, "{steps} steps, B {modulation}: {stated} for {law}");
            }
        }
    }

    #[test]
    fn three_steps_are_noisy_where_their_steep_samples_are_bright() {
        let stated = [0.0, PI / 3.0].map(|phase| {
            let n = 20_000;
            let map = one(&planted(set(3), n, |_| (80.0, 60.0, phase), &NOISE, Some(&mut Random(17))));
            let (valid, _, std) = errors(&map, |_| phase);
            assert!(valid == n && (0.95..1.05).contains(&std), "{std} of the stated sigma at {phase}");
            map.pixels.iter().map(|p| f64::from(p.variance)).sum::<f64>() / n as f64
        });
        assert!(stated[1] > 1.7 * stated[0], "{stated:?}"); // shot noise: 1 ± B / 2A of the mean
    }

    #[test]
    fn any_one_saturated_step_of_four_still_decodes_with_the_right_variance() {
        for step in 0..4 {
            // Only this step exceeds 255.
            let phase = |i: usize| 0.7 * ((i as f64 * 0.618).fract() - 0.5) - set(4).shift(step);
            let n = 20_000;
            let map = one(&planted(set(4), n, |i| (180.0, 110.0, phase(i)), &NOISE, Some(&mut Random(11))));
            assert!(map.pixels.iter().all(|p| p.saturated));
            let (valid, mean, std) = errors(&map, phase);
            assert!(valid > n * 998 / 1000 && mean.abs() < 0.03, "step {step}: {valid} valid, bias {mean}");
            assert!((0.95..1.05).contains(&std), "step {step}: {std} of the stated sigma");
        }
    }

    #[test]
    fn three_neighbouring_steps_at_the_foot_of_a_saturated_sine_are_weak() {
        let map = one(&planted(set(16), 1, |_| (274.6, 22.0, PI), &NOISE, None)); // 254, 253, 254, the rest saturated
        let p = map.pixels.at(0);
        assert!(p.state == State::Weak && p.modulation > 13.0, "{p:?}");
    }

    #[test]
    fn two_saturated_steps_of_four_are_invalid() {
        let map = one(&planted(set(4), 1, |_| (200.0, 110.0, -PI / 4.0), &NOISE, None));
        let p = map.pixels.at(0);
        assert!(p.state == State::Saturated && p.saturated && p.phase.is_nan() && p.variance.is_nan(), "{p:?}");
    }

    #[test]
    fn clean_rounded_signals_and_mild_gamma_are_sines_and_a_moved_edge_is_none() {
        for steps in [4, 5, 8, 16] {
            let phase = |i: usize| TAU * i as f64 / 500.0;
            let quiet = NoiseLaw { gain: 0.0, variance0: 1.0 / 12.0, black: 0.0 };
            let clean = planted(set(steps), 500, |i| (60.0, 40.0, phase(i)), &NOISE, None);
            let map = &decode(&clean, &quiet, &Limits::default()).expect("complete")[0];
            assert!(map.pixels.iter().all(|p| p.state == State::Valid), "clean, {steps} steps");

            let mut gamma = Stack::new(set(steps), 255, &[Window::whole(500, 1)]).expect("legal");
            let mut moved = gamma.clone();
            for step in 0..steps {
                let light = |i| 0.5 + 0.5 * (phase(i) + set(steps).shift(step)).cos();
                let image = |f: &dyn Fn(usize) -> f64| crate::Image {
                    width: 500,
                    height: 1,
                    pixels: (0..500).map(|i| f(i).round() as u16).collect(),
                };
                gamma.add(step, &image(&|i| 20.0 + 180.0 * light(i).powf(1.2))).expect("fits");
                let half = if step >= steps / 2 { 0.4 } else { 1.0 };
                moved.add(step, &image(&|i| 20.0 + 180.0 * light(i) * half)).expect("fits");
            }
            assert!(one(&gamma).pixels.iter().all(|p| p.state == State::Valid), "gamma, {steps} steps");
            let caught = one(&moved).pixels.iter().filter(|p| p.state == State::NotSine).count();
            assert!(caught > 300, "moved, {steps} steps: {caught} of 500");
        }
    }

    #[test]
    fn light_without_fringes_is_weak() {
        let mut random = Random(3);
        let map = one(&planted(set(4), 5000, |_| (120.0, 0.0, 0.0), &NOISE, Some(&mut random)));
        let weak = map.pixels.iter().filter(|p| p.state == State::Weak && p.phase.is_nan()).count();
        assert!(weak >= 4999, "{weak}");
    }
}
