//! The fringe sets of a capture, summed up as their images come. In: fringe images, and what the capture says of them.
//! Out: the noise law of each set, phases, projector coordinates. Not here: depth.

use super::Capture;
use crate::fringe::{
    self, Accumulator, Axis, CoordinateMap, Limits, NoiseLaw, NoiseSample, PatternSet, PhaseMap, difference_samples,
    residual_samples,
};
use crate::image::{Image, Window};

/// Pixels from which a noise law is estimated.
const NOISE_SAMPLES: usize = 50_000;

/// Grey levels per electron of an 8-bit image of a sensor with 8000 electrons full well: where nothing is known.
pub const TYPICAL_GAIN: f64 = 0.032;

/// The fringe sets of one capture while they are summed up.
#[derive(Clone, Debug)]
pub struct Fringes {
    /// Where in the image.
    pub window: Window,
    sums: Vec<Accumulator>,
    /// Noise samples of sets that tell nothing by themselves.
    differences: Vec<NoiseSample>,
    white_level: u16,
    only: Option<Axis>,
}

impl Fringes {
    /// Empty sums over `window` for all sets of `capture`; nothing is kept of sets along another axis than `only`.
    pub fn new(capture: &Capture, window: Window, only: Option<Axis>) -> Self {
        let white_level = capture.camera.white_level().clamp(1.0, f64::from(u16::MAX)) as u16;
        let sums = capture.fringes.iter().map(|set| {
            let windows: &[Window] = if only.is_none_or(|axis| axis == set.axis) { &[window] } else { &[] };
            let set = PatternSet::new(set.axis, set.count, set.steps).expect("checked when the capture was read");
            Accumulator::new(set, white_level, windows).expect("checked when the capture was read")
        });
        Self { window, sums: sums.collect(), differences: Vec::new(), white_level, only }
    }

    /// Takes image `step` of set `set`, in any order.
    pub fn add(&mut self, set: usize, step: u32, image: &Image<u16>) -> Result<(), fringe::Error> {
        let pattern = *self.sums[set].set();
        if pattern.steps == 3 && self.differences.is_empty() {
            self.differences = difference_samples(image, pattern.axis, self.window, self.white_level, NOISE_SAMPLES);
        }
        self.sums[set].add(step, image)
    }

    /// The noise law of each set: stated, or from its own residuals, or from another set's, or from the images.
    pub fn noise(&self, capture: &Capture) -> Vec<NoiseLaw> {
        let (black, read) = (capture.camera.black_level, capture.camera.read_noise_e.unwrap_or(0.0));
        let stated = |k: usize| capture.fringes[k].gain_dn_per_e.map(|gain| NoiseLaw::from_sensor(gain, read, black));
        let own = |k: usize| NoiseLaw::estimate(&residual_samples(&self.sums[k], NOISE_SAMPLES), black);
        let of_any = || {
            (0..self.sums.len())
                .find_map(|k| stated(k).or_else(|| own(k)))
                .or_else(|| NoiseLaw::estimate(&self.differences, black))
                .unwrap_or(NoiseLaw::from_sensor(TYPICAL_GAIN, read, black))
        };
        (0..self.sums.len()).map(|k| stated(k).or_else(|| own(k)).unwrap_or_else(of_any)).collect()
    }

    /// The wrapped phases of every set that is kept. `noise`: one law per set of the capture.
    pub fn phases(&self, noise: &[NoiseLaw], limits: &Limits) -> Result<Vec<PhaseMap>, fringe::Error> {
        let kept = self.sums.iter().zip(noise).filter(|(s, _)| self.only.is_none_or(|axis| axis == s.set().axis));
        let decoded = kept.map(|(sums, noise)| fringe::decode(sums, noise, limits));
        Ok(decoded.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
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
