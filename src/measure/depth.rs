//! Depth of a capture: its fringe sets summed up as they come, then decoded and triangulated.
//! In:  fringe images and what the capture says of them. Out: projector coordinates, a depth map, the coarse surface.
//! Not here: patches about features.

use super::body::{self, Site};
use crate::calibrate::MAX_EPIPOLAR_PX;
use crate::capture::Capture;
use crate::fringe::{
    self, Accumulator, Axis, CoordinateMap, DepthMap, Limits, NoiseLaw, NoiseSample, PatternSet, Rays,
    difference_samples, residual_samples,
};
use crate::geometry::{Surface, frame};
use crate::image::{Image, Window};

/// The fringe sets of one capture while they are summed up.
pub(super) struct Fringes {
    pub(super) window: Window,
    sums: Vec<Accumulator>,
    /// Noise samples of sets that tell nothing by themselves.
    differences: Vec<NoiseSample>,
    white_level: u16,
}

impl Fringes {
    pub(super) fn new(capture: &Capture, window: Window) -> Self {
        let white_level = capture.camera.white_level().clamp(1.0, f64::from(u16::MAX)) as u16;
        let sums = capture.fringes.iter().map(|set| {
            let set = PatternSet::new(set.axis, set.count, set.steps).expect("checked when the capture was read");
            Accumulator::new(set, white_level, &[window]).expect("checked when the capture was read")
        });
        Self { window, sums: sums.collect(), differences: Vec::new(), white_level }
    }

    pub(super) fn add(&mut self, set: usize, step: u32, image: &Image<u16>) -> Result<(), fringe::Error> {
        let pattern = *self.sums[set].set();
        if pattern.steps == 3 && self.differences.is_empty() {
            self.differences = difference_samples(image, pattern.axis, self.window, self.white_level, NOISE_SAMPLES);
        }
        self.sums[set].add(step, image)
    }

    /// The noise law of each set: stated, or from its own residuals, or from another set's, or from the images.
    fn noise(&self, capture: &Capture) -> Vec<NoiseLaw> {
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

    /// The finest phases along the axis that the depth does not come from, if there are any.
    pub(super) fn across(&self, capture: &Capture, axis: Axis, noise: &[NoiseLaw]) -> Option<fringe::PhaseMap> {
        let sets = self.sums.iter().zip(noise).filter(|(sums, _)| sums.set().axis != axis);
        let (sums, noise) = sets.max_by_key(|(sums, _)| sums.set().count)?;
        let extent = if axis == Axis::Column { capture.projector.height } else { capture.projector.width };
        // a pitch of a few pixels cannot tell which fringe it is
        (sums.set().pitch(extent) > 8.0 * MAX_EPIPOLAR_PX).then_some(())?;
        fringe::decode(sums, noise, &Limits::default()).ok()?.pop()
    }

    /// Projector coordinates of the window along the columns, or the rows where only they are absolute.
    pub(super) fn coordinates(&self, capture: &Capture) -> Result<(CoordinateMap, Vec<NoiseLaw>), fringe::Error> {
        let noise = self.noise(capture);
        let limits = Limits::default();
        let mut maps = Vec::new();
        for (sums, noise) in self.sums.iter().zip(&noise) {
            maps.extend(fringe::decode(sums, noise, &limits)?);
        }
        let columns = fringe::unwrap(&maps, Axis::Column, capture.projector.width, &limits);
        let map = match columns {
            Err(e) => fringe::unwrap(&maps, Axis::Row, capture.projector.height, &limits).map_err(|_| e)?,
            Ok(map) => map,
        };
        Ok((map, noise))
    }
}

const NOISE_SAMPLES: usize = 50_000;

/// Grey levels per electron of an 8-bit image of a sensor with 8000 electrons full well: where nothing is known.
pub(super) const TYPICAL_GAIN: f64 = 0.032;

/// The noise law of the red image: stated, or else that of the finest fringes.
pub(super) fn red_noise(capture: &Capture, fringes: &[NoiseLaw]) -> NoiseLaw {
    let (black, read) = (capture.camera.black_level, capture.camera.read_noise_e.unwrap_or(0.0));
    let stated = capture.images.red_gain_dn_per_e.map(|gain| NoiseLaw::from_sensor(gain, read, black));
    stated.or_else(|| fringes.last().copied()).unwrap_or(NoiseLaw::from_sensor(TYPICAL_GAIN, read, black))
}

/// Depth of a window: decoded, triangulated, and once a coarse surface is known, with the fringes ordered by it
/// where the coarse sets were saturated.
pub(super) struct BodyDepth<'a> {
    pub(super) map: DepthMap<'a>,
    pub(super) coarse: Surface<frame::Camera>,
}

impl<'a> BodyDepth<'a> {
    pub(super) fn new(
        rig: &crate::optics::Rig,
        rays: &'a Rays,
        coordinates: &mut CoordinateMap,
        sites: &[Site<'_>],
    ) -> Option<Self> {
        let map = DepthMap::new(rig, rays, coordinates);
        let coarse = body::coarse(&map, &rig.camera, sites)?;
        let axis = coordinates.axis;
        let expected = |x: usize, y: usize| {
            let ray = rays.at(x, y);
            let met = coarse.local.point(&coarse.meet(&ray, 0.0)?);
            fringe::projector_coordinate(rig, axis, &met)
        };
        let mut ordered = coordinates.clone();
        if ordered.predict(&Limits::default(), expected) == 0 {
            return Some(Self { map, coarse });
        }
        *coordinates = ordered;
        let map = DepthMap::new(rig, rays, coordinates);
        let coarse = body::coarse(&map, &rig.camera, sites)?;
        Some(Self { map, coarse })
    }
}
