//! The fringe sets of a capture, kept as their images come. In: fringe images, and what the capture says of them.
//! Out: the noise law of each set, phases, projector coordinates. Not here: depth.

use super::Capture;
use crate::fringe::{
    self, Axis, CoordinateMap, Limits, NoiseLaw, NoiseSample, PatternSet, PhaseMap, Stack, difference_samples,
    excess_noise, residual_samples,
};
use crate::image::{Image, Window};
use crate::lent::List;

/// Pixels from which a noise law is estimated.
const NOISE_SAMPLES: usize = 50_000;

/// Grey levels per electron of an 8-bit image of a sensor with 8000 electrons full well: where nothing is known.
pub const TYPICAL_GAIN: f64 = 0.032;

/// The fringe sets of one capture while its images come.
#[derive(Clone, Debug)]
pub struct Fringes {
    /// Where in the image that is left of every image: all of it, or every `every`-th column and row.
    pub window: Window,
    every: usize,
    stacks: List<Stack>,
    /// Noise samples of sets that tell nothing by themselves.
    differences: List<NoiseSample>,
    white_level: u16,
    only: Option<Axis>,
    /// The law that is stated of each set; when its images are all there, what they tell of it.
    known: List<Option<NoiseLaw>>,
    black: f64,
    /// Where sets are decoded as soon as they are complete and their noise is known; nowhere if empty.
    wanted: List<bool>,
    /// What was decoded so, per set.
    decoded: List<Option<PhaseMap>>,
}

impl Fringes {
    /// Empty stacks over `window` for all sets of `capture`; nothing is kept of sets along another axis than `only`.
    pub fn new(capture: &Capture, window: Window, only: Option<Axis>) -> Self {
        let white_level = capture.camera.white_level().clamp(1.0, f64::from(u16::MAX)) as u16;
        let stacks = capture.fringes.iter().map(|set| {
            let windows: &[Window] = if only.is_none_or(|axis| axis == set.axis) { &[window] } else { &[] };
            let set = PatternSet::new(set.axis, set.count, set.steps).expect("checked when the capture was read");
            Stack::new(set, white_level, windows).expect("checked when the capture was read")
        });
        let (black, read) = (capture.camera.black_level, capture.camera.read_noise_e.unwrap_or(0.0));
        let stated = |set: &super::FringeSet| set.gain_dn_per_e.map(|gain| NoiseLaw::from_sensor(gain, read, black));
        Self {
            window,
            every: 1,
            stacks: List::of(stacks),
            differences: List::new(),
            white_level,
            only,
            known: List::of(capture.fringes.iter().map(stated)),
            black,
            wanted: List::new(),
            decoded: List::of(capture.fringes.iter().map(|_| None)),
        }
    }

    /// Of all sets of `capture`, where `window` is of what is left of the images when only every `every`-th column and
    /// row is looked at. Sets are decoded when their last image comes, where `wanted` is true, row by row.
    pub fn as_they_come(capture: &Capture, window: Window, every: usize, wanted: List<bool>) -> Self {
        let mut new = Self { every, wanted, ..Self::new(capture, window, None) };
        new.stacks.iter_mut().for_each(|stack| stack.thin(every));
        new
    }

    fn decode(&self, set: usize, noise: &NoiseLaw) -> Result<PhaseMap, fringe::Error> {
        fringe::decode_where(&self.stacks[set], 0, noise, &Limits::DEFAULT, &self.wanted)
    }

    /// Takes image `step` of set `set`, in any order.
    pub fn add(&mut self, set: usize, step: u32, image: &Image<u16>) -> Result<(), fringe::Error> {
        let pattern = *self.stacks[set].set();
        if pattern.steps == 3 && self.differences.is_empty() {
            let window = self.in_image(image);
            self.differences = difference_samples(image, pattern.axis, window, self.white_level, NOISE_SAMPLES);
        }
        self.stacks[set].add(step, image)?;
        if self.stacks[set].is_complete() {
            // what is stated of the sensor is the least: glittering paint adds to it
            let stated = self.known[set];
            let raised = |law: NoiseLaw| law.with_excess(excess_noise(&self.stacks[set], &law, &self.wanted));
            self.known[set] = stated.map(raised).or_else(|| self.own(set));
            if let (false, Some(noise)) = (self.wanted.is_empty(), self.known[set]) {
                self.decoded[set] = Some(self.decode(set, &noise)?);
            }
        }
        Ok(())
    }

    /// The window in pixels of `image`.
    pub fn in_image<T>(&self, image: &Image<T>) -> Window {
        let (Window { x, y, width, height }, n) = (self.window, self.every);
        let (x, y) = (x * n, y * n);
        Window { x, y, width: (width * n).min(image.width - x), height: (height * n).min(image.height - y) }
    }

    fn own(&self, k: usize) -> Option<NoiseLaw> {
        NoiseLaw::estimate(&residual_samples(&self.stacks[k], NOISE_SAMPLES), self.black)
    }

    /// The noise law of each set: stated and raised to what its images have, or from its own residuals, or from another set's, or
    /// from the images.
    pub fn noise(&self, capture: &Capture) -> List<NoiseLaw> {
        let read = capture.camera.read_noise_e.unwrap_or(0.0);
        let known = |k: usize| self.known[k].or_else(|| self.own(k));
        let of_any = || {
            (0..self.stacks.len())
                .find_map(known)
                .or_else(|| NoiseLaw::estimate(&self.differences, self.black))
                .unwrap_or(NoiseLaw::from_sensor(TYPICAL_GAIN, read, self.black))
        };
        List::of((0..self.stacks.len()).map(|k| known(k).unwrap_or_else(of_any)))
    }

    /// The wrapped phases of every set that is kept. `noise`: one law per set of the capture.
    pub fn phases(&self, noise: &[NoiseLaw], limits: &Limits) -> Result<List<PhaseMap>, fringe::Error> {
        let mut maps = List::new();
        let kept = self.stacks.iter().zip(noise).filter(|(s, _)| self.only.is_none_or(|axis| axis == s.set().axis));
        for (stack, noise) in kept {
            let mut decoded = fringe::decode(stack, noise, limits)?;
            maps.append(&mut decoded);
        }
        Ok(maps)
    }

    /// The wrapped phases of every set where they were wanted; what was decoded as it came is moved out.
    pub fn take_phases(&mut self, noise: &[NoiseLaw]) -> Result<List<PhaseMap>, fringe::Error> {
        let mut maps = List::new();
        for (k, noise) in noise.iter().enumerate() {
            let decoded = self.decoded[k].take().map_or_else(|| self.decode(k, noise), Ok);
            maps.push(decoded?);
        }
        Ok(maps)
    }

    /// Where phases were wanted, row by row; empty: everywhere.
    pub fn wanted(&self) -> &[bool] {
        &self.wanted
    }
}

/// Projector coordinates along `axis` of the sets in `phases` (see [`fringe::unwrap`]).
pub fn coordinates(
    capture: &Capture,
    phases: &[PhaseMap],
    axis: Axis,
    limits: &Limits,
) -> Result<CoordinateMap, fringe::Error> {
    let extent = match axis {
        Axis::Column => capture.projector.width,
        Axis::Row => capture.projector.height,
    };
    fringe::unwrap(phases, axis, extent, limits)
}
