//! Fringe projection: phase-shifted images in, depth out.
//! In: raw camera images (8-bit files widened to 16) of sets of sinusoidal fringes, and the rig's calibration.
//! Out: per camera pixel the projector coordinate that lights it, the depth of the surface, and their variances.
//! Left to others: files, which windows matter, what the surface is. Where a pixel cannot be trusted it is NaN.
//!
//! images → [`Stack`] → [`decode`] → [`unwrap`] (with [`CoordinateMap::predict`]) → [`DepthMap`]; with fringes
//! across the measuring axis → [`epipolar_cells`].

mod arctangent;
mod decode;
mod epipolar;
mod noise;
mod pattern;
mod phases;
mod sines;
mod stack;
mod triangulate;
mod unwrap;

pub use decode::{Limits, PhaseMap, decode, decode_where};
pub use epipolar::{EpipolarCell, epipolar_cells, is_sampled};
pub use noise::{NoiseLaw, NoiseSample, difference_samples, excess_noise, residual_samples};
pub use pattern::{Axis, PatternSet};
pub use phases::{Phase, Phases, State};
pub use stack::Stack;
pub use triangulate::{Depth, DepthMap, Rays, epipolar_residual, projector_coordinate, triangulate};
pub use unwrap::{Coordinate, CoordinateMap, unwrap};

/// More sets than any scheme of unwrapping and exposures needs.
pub const MAX_SETS: usize = 64;

/// Why fringe images give no phase at all. A pixel without phase is a [`State`], not an error.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// A set with count 0.
    #[error("a fringe set of 0 fringes: at least 1 is needed")]
    NoFringe,
    /// Too few steps to decode, or more than the mask of saturated steps holds.
    #[error("a fringe set of {steps} steps: allowed 3..=16")]
    Steps {
        /// Steps found.
        steps: u32,
    },
    /// A step outside the set, or one that was added before.
    #[error("fringe step {step} of {steps} is none of the set's or came twice")]
    UnexpectedStep {
        /// 0-based step found.
        step: u32,
        /// Steps of the set.
        steps: u32,
    },
    /// A window reaches beyond the image.
    #[error("fringe image of {width} × {height} px is smaller than the region to decode")]
    ImageSize {
        /// Columns found.
        width: usize,
        /// Rows found.
        height: usize,
    },
    /// Decoding was asked for before every step was there.
    #[error("{got} of {steps} fringe images of a set")]
    Incomplete {
        /// Images added.
        got: u32,
        /// Images needed.
        steps: u32,
    },
    /// No set tells the fringes of this axis apart.
    #[error("absolute phase along {axis:?} is ambiguous: the coarsest set has {lowest} fringes, 1 is needed")]
    Ambiguous {
        /// The axis asked for.
        axis: Axis,
        /// Lowest count among its sets.
        lowest: u32,
    },
    /// No set varies along this axis.
    #[error("no fringe set along {axis:?}")]
    NoSet {
        /// The axis asked for.
        axis: Axis,
    },
}

#[cfg(test)]
mod testing {
    //! Planted signals: a seeded generator, a camera that counts electrons.

    use super::{NoiseLaw, PatternSet, Stack};
    use crate::Image;
    use crate::image::Window;

    /// SplitMix64 with Box–Muller; Steele, Lea, Flood, OOPSLA 2014.
    pub(super) struct Random(pub(super) u64);

    impl Random {
        pub(super) fn uniform(&mut self) -> f64 {
            self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
        }

        pub(super) fn normal(&mut self) -> f64 {
            let (u, v) = (1.0 - self.uniform(), self.uniform());
            (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
        }

        /// An 8-bit sample of light `level` (DN): shot and read noise, rounded and clipped.
        pub(super) fn sample(&mut self, level: f64, noise: &NoiseLaw) -> u16 {
            let analogue = noise.variance(level) - 1.0 / 12.0; // rounding adds the rest
            (level + analogue.max(0.0).sqrt() * self.normal()).round().clamp(0.0, 255.0) as u16
        }
    }

    /// The images of `level + modulation·cos(phase(i) + shift)` at pixel i of a row of `n`, as `sample` takes that light.
    pub(super) fn samples(
        set: PatternSet,
        n: usize,
        light: impl Fn(usize) -> (f64, f64, f64),
        mut sample: impl FnMut(f64) -> u16,
    ) -> Vec<Image<u16>> {
        let image = |step| {
            let light = |i| {
                let (level, modulation, phase) = light(i);
                level + modulation * (phase + set.shift(step)).cos()
            };
            Image { width: n, height: 1, pixels: (0..n).map(|i| sample(light(i))).collect() }
        };
        (0..set.steps).map(image).collect()
    }

    /// A stack of such images, 8-bit, with noise of `noise` if there is a generator.
    pub(super) fn planted(
        set: PatternSet,
        n: usize,
        light: impl Fn(usize) -> (f64, f64, f64),
        noise: &NoiseLaw,
        mut random: Option<&mut Random>,
    ) -> Stack {
        let sample = |light: f64| match &mut random {
            Some(random) => random.sample(light, noise),
            None => light.round().clamp(0.0, 255.0) as u16,
        };
        let mut stack = Stack::new(set, 255, &[Window::whole(n, 1)]).expect("legal set");
        let images = samples(set, n, light, sample);
        (0..).zip(&images).for_each(|(step, image)| stack.add(step, image).expect("fits"));
        stack
    }
}
