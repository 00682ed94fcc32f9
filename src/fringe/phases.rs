//! What is known of the phase of each pixel of a window: a list of each quantity, as vector units read and write them.

use crate::lent::List;
use rayon::prelude::*;

/// Whether a pixel's phase or depth may be used, and if not, what is wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum State {
    /// Every check passed.
    Valid,
    /// Fewer than three unsaturated steps.
    Saturated,
    /// Too little modulation for the noise.
    #[default]
    Weak,
    /// The samples are no sine: light changed or the object moved.
    NotSine,
    /// The sets disagree about which fringe it is, or are too noisy to tell.
    WrongOrder,
    /// Coarse sets saturated, the finest valid: which fringe it is a prediction may tell.
    Unordered,
    /// Phase is known, but its ray and the projector's do not meet in front of both.
    NoDepth,
}

/// One pixel's phase.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// Wrapped phase, rad, −π..=π; NaN unless valid.
    pub phase: f32,
    /// Its variance, rad²; NaN unless valid.
    pub variance: f32,
    /// A, mean level over one fringe, DN; NaN if saturated.
    pub level: f32,
    /// B, DN; NaN if saturated.
    pub modulation: f32,
    /// At least one step was saturated.
    pub saturated: bool,
    /// What the phase is worth.
    pub state: State,
}

impl Phase {
    /// Of a pixel that nothing is known of.
    pub(super) const NONE: Self = Self {
        phase: f32::NAN,
        variance: f32::NAN,
        level: f32::NAN,
        modulation: f32::NAN,
        saturated: false,
        state: State::Weak,
    };
}

/// A [`Phase`] per pixel.
#[derive(Clone, Debug, Default)]
pub struct Phases {
    pub(super) phase: List<f32>,
    pub(super) variance: List<f32>,
    pub(super) level: List<f32>,
    pub(super) modulation: List<f32>,
    pub(super) saturated: List<bool>,
    pub(super) state: List<State>,
}

/// Some pixels of [`Phases`], to be written; all lists are as long.
pub(super) struct Part<'a> {
    pub(super) phase: &'a mut [f32],
    pub(super) variance: &'a mut [f32],
    pub(super) level: &'a mut [f32],
    pub(super) modulation: &'a mut [f32],
    pub(super) saturated: &'a mut [bool],
    pub(super) state: &'a mut [State],
}

impl Phases {
    /// Pixels.
    pub fn len(&self) -> usize {
        self.state.len()
    }

    /// Whether there is no pixel.
    pub fn is_empty(&self) -> bool {
        self.state.is_empty()
    }

    /// Of pixel `i`. Panics if there is no such.
    pub fn at(&self, i: usize) -> Phase {
        Phase {
            phase: self.phase[i],
            variance: self.variance[i],
            level: self.level[i],
            modulation: self.modulation[i],
            saturated: self.saturated[i],
            state: self.state[i],
        }
    }

    /// Of every pixel.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = Phase> {
        (0..self.len()).map(|i| self.at(i))
    }

    /// Of `n` pixels to be overwritten: what they hold is of earlier ones, or nothing is known of them.
    pub(super) fn stale(n: usize) -> Self {
        let Phase { phase, variance, level, modulation, saturated, state } = Phase::NONE;
        Self {
            phase: List::stale(phase, n),
            variance: List::stale(variance, n),
            level: List::stale(level, n),
            modulation: List::stale(modulation, n),
            saturated: List::stale(saturated, n),
            state: List::stale(state, n),
        }
    }

    /// All pixels, `n` to a part; fewer in the last.
    pub(super) fn parts(&mut self, n: usize) -> impl IndexedParallelIterator<Item = Part<'_>> {
        let lists = (
            self.phase.par_chunks_mut(n),
            self.variance.par_chunks_mut(n),
            self.level.par_chunks_mut(n),
            self.modulation.par_chunks_mut(n),
            self.saturated.par_chunks_mut(n),
            self.state.par_chunks_mut(n),
        );
        lists.into_par_iter().map(|(phase, variance, level, modulation, saturated, state)| Part {
            phase,
            variance,
            level,
            modulation,
            saturated,
            state,
        })
    }
}

impl Part<'_> {
    pub(super) fn len(&self) -> usize {
        self.state.len()
    }

    /// Writes every pixel.
    pub(super) fn fill(&mut self, pixel: Phase) {
        self.phase.fill(pixel.phase);
        self.variance.fill(pixel.variance);
        self.level.fill(pixel.level);
        self.modulation.fill(pixel.modulation);
        self.saturated.fill(pixel.saturated);
        self.state.fill(pixel.state);
    }

    /// Writes pixel `i`. Panics if there is no such.
    pub(super) fn set(&mut self, i: usize, pixel: Phase) {
        self.phase[i] = pixel.phase;
        self.variance[i] = pixel.variance;
        self.level[i] = pixel.level;
        self.modulation[i] = pixel.modulation;
        self.saturated[i] = pixel.saturated;
        self.state[i] = pixel.state;
    }
}

impl FromIterator<Phase> for Phases {
    fn from_iter<I: IntoIterator<Item = Phase>>(pixels: I) -> Self {
        let pixels: Vec<Phase> = pixels.into_iter().collect();
        let mut new = Self::stale(pixels.len());
        new.parts(1).zip(pixels).for_each(|(mut part, pixel)| part.set(0, pixel));
        new
    }
}

#[cfg(test)]
impl Phases {
    pub(super) fn change(&mut self, i: usize, change: impl FnOnce(&mut Phase)) {
        let mut pixel = self.at(i);
        change(&mut pixel);
        let n = self.len();
        self.parts(n).for_each(|mut part| part.set(i, pixel));
    }
}
