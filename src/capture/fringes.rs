//! The fringe sets of a capture, kept as their images come. In: fringe images, and what the capture says of them.
//! Out: the noise law of each set, phases, projector coordinates. Not here: depth.

use super::Capture;
use crate::fringe::{
    self, Axis, Coordinate, CoordinateMap, Limits, NoiseLaw, NoiseSample, PatternSet, PhaseMap, Phases, Stack,
    difference_samples, residual_samples,
};
use crate::image::{Image, Window};

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
    stacks: Vec<Stack>,
    /// Noise samples of sets that tell nothing by themselves.
    differences: Vec<NoiseSample>,
    white_level: u16,
    only: Option<Axis>,
    /// The law that is stated of each set, or that its own images told when they were all there.
    known: Vec<Option<NoiseLaw>>,
    black: f64,
    /// Where sets are decoded as soon as they are complete and their noise is known; nowhere if empty.
    wanted: Vec<bool>,
    /// What was decoded so, per set.
    decoded: Vec<Option<PhaseMap>>,
    /// Buffers for what will be.
    spare: Vec<Phases>,
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
            stacks: stacks.collect(),
            differences: Vec::new(),
            white_level,
            only,
            known: capture.fringes.iter().map(stated).collect(),
            black,
            wanted: Vec::new(),
            decoded: vec![None; capture.fringes.len()],
            spare: Vec::new(),
        }
    }

    /// Of all sets of `capture`, where `window` is of what is left of the images when only every `every`-th column and
    /// row is looked at. Sets are decoded when their last image comes, where `wanted` is true, row by row.
    /// The buffers of `spare` are used again.
    pub fn as_they_come(spare: Self, capture: &Capture, window: Window, every: usize, wanted: Vec<bool>) -> Self {
        let mut new = Self::new(capture, Window::whole(0, 0), None);
        (new.window, new.every, new.wanted) = (window, every, wanted);
        let mut stacks = spare.stacks.into_iter();
        for own in &mut new.stacks {
            if let Some(mut reused) = stacks.next() {
                reused.turn_to(*own.set(), new.white_level).expect("the set of a stack");
                *own = reused;
            }
            own.thin(every);
            own.restart(&[window]);
        }
        new.spare = spare.spare;
        new.give_back(spare.decoded.into_iter().flatten());
        new
    }

    /// Nothing, of no capture: what a first capture begins with.
    pub fn none() -> Self {
        Self {
            window: Window::whole(0, 0),
            every: 1,
            stacks: Vec::new(),
            differences: Vec::new(),
            white_level: u16::MAX,
            only: None,
            known: Vec::new(),
            black: 0.0,
            wanted: Vec::new(),
            decoded: Vec::new(),
            spare: Vec::new(),
        }
    }

    /// Takes phases that are no longer needed, for their buffers.
    pub fn give_back(&mut self, phases: impl IntoIterator<Item = PhaseMap>) {
        self.spare.extend(phases.into_iter().map(|map| map.pixels));
    }

    /// Gives up the list of what was wanted, for its buffer.
    pub fn take_wanted(&mut self) -> Vec<bool> {
        std::mem::take(&mut self.wanted)
    }

    fn decode(&mut self, set: usize, noise: &NoiseLaw) -> Result<PhaseMap, fringe::Error> {
        let stack = &self.stacks[set];
        let pixels = self.spare.pop().unwrap_or_default();
        let mut map = PhaseMap { set: *stack.set(), window: self.window, pixels };
        fringe::decode_where(stack, 0, noise, &Limits::DEFAULT, &self.wanted, &mut map)?;
        Ok(map)
    }

    /// Takes image `step` of set `set`, in any order.
    pub fn add(&mut self, set: usize, step: u32, image: &Image<u16>) -> Result<(), fringe::Error> {
        let pattern = *self.stacks[set].set();
        if pattern.steps == 3 && self.differences.is_empty() {
            let window = self.in_image(image);
            self.differences = difference_samples(image, pattern.axis, window, self.white_level, NOISE_SAMPLES);
        }
        self.stacks[set].add(step, image)?;
        if !self.wanted.is_empty() && self.stacks[set].is_complete() {
            self.known[set] = self.known[set].or_else(|| self.own(set));
            if let Some(noise) = self.known[set] {
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

    /// The noise law of each set: stated, or from its own residuals, or from another set's, or from the images.
    pub fn noise(&self, capture: &Capture) -> Vec<NoiseLaw> {
        let read = capture.camera.read_noise_e.unwrap_or(0.0);
        let known = |k: usize| self.known[k].or_else(|| self.own(k));
        let of_any = || {
            (0..self.stacks.len())
                .find_map(known)
                .or_else(|| NoiseLaw::estimate(&self.differences, self.black))
                .unwrap_or(NoiseLaw::from_sensor(TYPICAL_GAIN, read, self.black))
        };
        (0..self.stacks.len()).map(|k| known(k).unwrap_or_else(of_any)).collect()
    }

    /// The wrapped phases of every set that is kept. `noise`: one law per set of the capture.
    pub fn phases(&self, noise: &[NoiseLaw], limits: &Limits) -> Result<Vec<PhaseMap>, fringe::Error> {
        let kept = self.stacks.iter().zip(noise).filter(|(s, _)| self.only.is_none_or(|axis| axis == s.set().axis));
        let decoded = kept.map(|(stack, noise)| fringe::decode(stack, noise, limits));
        Ok(decoded.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// The wrapped phases of every set where they were wanted; what was decoded as it came is moved out.
    pub fn take_phases(&mut self, noise: &[NoiseLaw]) -> Result<Vec<PhaseMap>, fringe::Error> {
        let phases = |k: usize| match self.decoded[k].take() {
            Some(map) => Ok(map),
            None => self.decode(k, &noise[k]),
        };
        (0..noise.len()).map(phases).collect()
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
    coordinates_reusing(Vec::new(), capture, phases, axis, limits)
}

/// As [`coordinates`], in the buffer of `pixels`.
pub fn coordinates_reusing(
    pixels: Vec<Coordinate>,
    capture: &Capture,
    phases: &[PhaseMap],
    axis: Axis,
    limits: &Limits,
) -> Result<CoordinateMap, fringe::Error> {
    let extent = match axis {
        Axis::Column => capture.projector.width,
        Axis::Row => capture.projector.height,
    };
    fringe::unwrap_reusing(pixels, phases, axis, extent, limits)
}
