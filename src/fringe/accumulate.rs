//! Running sums over one fringe set, so that no image needs to be kept.
//! In: the images of one set, one at a time, in any order. Out: per pixel of each window ΣI, ΣI·cos, ΣI·sin,
//! ΣI² over the steps that were not saturated, and which steps those were.

use super::{Error, PatternSet};
use crate::Image;
use crate::image::Window;
use rayon::prelude::*;

/// The sums of one fringe set over a list of windows. Buffers are kept from one capture to the next.
#[derive(Clone, Debug)]
pub struct Accumulator {
    set: PatternSet,
    white_level: u16,
    seen: u16,
    every: usize,
    windows: Vec<Sums>,
}

/// The sums inside one window.
#[derive(Clone, Debug)]
pub(super) struct Sums {
    pub(super) window: Window,
    /// ΣI, ΣI·cos θ, ΣI·sin θ, ΣI² of the steps that were not saturated; θ the step's shift. For 8 bits ΣI² is exact;
    /// for 16 it is good to 1e-7 of itself, which is far below what shot noise of such levels makes of it.
    pub(super) sums: Vec<[f32; 4]>,
    /// Bit k: step k was saturated.
    pub(super) saturated: Vec<u16>,
}

impl Accumulator {
    /// Empty sums over `windows`; samples from `white_level` up count as saturated.
    /// Errors where the set is none: no fringe, or steps outside 3..=16.
    pub fn new(set: PatternSet, white_level: u16, windows: &[Window]) -> Result<Self, Error> {
        set.check()?;
        let mut empty = Self { set, white_level, seen: 0, every: 1, windows: Vec::new() };
        empty.restart(windows);
        Ok(empty)
    }

    /// Looks at every `every`-th column and row of the images only, from the first on; windows are of the image that
    /// is left. For a camera much finer than the surface needs.
    pub fn thin(&mut self, every: usize) {
        self.every = every.max(1);
    }

    /// Empties the sums and turns to another `set` and `white_level`, reusing the buffers. Errors as [`Self::new`].
    pub fn turn_to(&mut self, set: PatternSet, white_level: u16) -> Result<(), Error> {
        set.check()?;
        (self.set, self.white_level, self.seen) = (set, white_level, 0);
        Ok(())
    }

    /// Empties the sums and turns to `windows`, reusing the buffers.
    pub fn restart(&mut self, windows: &[Window]) {
        self.seen = 0;
        self.windows.truncate(windows.len());
        for (i, &window) in windows.iter().enumerate() {
            if i == self.windows.len() {
                self.windows.push(Sums { window, sums: Vec::new(), saturated: Vec::new() });
            }
            let Sums { window: w, sums, saturated } = &mut self.windows[i];
            *w = window;
            // what is left in them the first image overwrites
            sums.resize(window.width * window.height, [0.0; 4]);
            saturated.resize(window.width * window.height, 0);
        }
    }

    /// Adds the image of `step` (0-based). Errors, with the sums as they were: the step is none of the set's or
    /// was added before, or a window reaches beyond the image.
    pub fn add(&mut self, step: u32, image: &Image<u16>) -> Result<(), Error> {
        if step >= self.set.steps || self.seen >> step & 1 == 1 {
            return Err(Error::UnexpectedStep { step, steps: self.set.steps });
        }
        let every = self.every;
        let (columns, rows) = (image.width.div_ceil(every), image.height.div_ceil(every));
        let inside = |w: &Window| w.x + w.width <= columns && w.y + w.height <= rows;
        if !self.windows.iter().all(|s| inside(&s.window)) {
            return Err(Error::ImageSize { width: image.width, height: image.height });
        }
        let first = self.seen == 0;
        self.seen |= 1 << step;
        let (sin, cos) = self.set.shift(step).sin_cos();
        let (sin, cos, white) = (sin as f32, cos as f32, self.white_level);
        for Sums { window, sums, saturated } in self.windows.iter_mut().filter(|s| !s.sums.is_empty()) {
            let rows = sums.par_chunks_mut(window.width).zip(saturated.par_chunks_mut(window.width));
            rows.enumerate().for_each(|(y, (sums, saturated))| {
                let samples = image.row((window.y + y) * every)[window.x * every..].chunks(every);
                for ((samples, sums), saturated) in samples.zip(sums).zip(saturated) {
                    let sample = samples[0];
                    if first {
                        (*sums, *saturated) = ([0.0; 4], 0);
                    }
                    let over = sample >= white;
                    let i = if over { 0.0 } else { f32::from(sample) };
                    *saturated |= u16::from(over) << step;
                    for (sum, weight) in sums.iter_mut().zip([1.0, cos, sin, i]) {
                        *sum += i * weight;
                    }
                }
            });
        }
        Ok(())
    }

    /// Whether the images of all steps are there.
    pub fn is_complete(&self) -> bool {
        self.seen.count_ones() == self.set.steps
    }

    /// The fringe set that is summed.
    pub fn set(&self) -> &PatternSet {
        &self.set
    }

    /// The sums, once every step is in them.
    pub(super) fn complete(&self) -> Result<&[Sums], Error> {
        let (got, steps) = (self.seen.count_ones(), self.set.steps);
        if self.is_complete() { Ok(&self.windows) } else { Err(Error::Incomplete { got, steps }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fringe::Axis;

    #[test]
    fn sums_leave_saturated_samples_out_and_windows_where_they_are() {
        let set = PatternSet::new(Axis::Column, 1, 4).expect("legal");
        let window = Window { x: 1, y: 1, width: 2, height: 1 };
        let mut a = Accumulator::new(set, 255, &[window]).expect("legal");
        for (step, (left, right)) in [(10, 254), (20, 255), (30, 7), (50, 9)].into_iter().enumerate() {
            let image = Image { width: 3, height: 2, pixels: vec![99, 99, 99, 99, left, right] };
            a.add(step as u32, &image).expect("fits");
        }
        let sums = &a.complete().expect("four steps")[0];
        let near = |got: [f32; 4], want: [f32; 4]| got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-3);
        assert!(near(sums.sums[0], [110.0, -20.0, -30.0, 3900.0]), "{:?}", sums.sums);
        assert!(near(sums.sums[1], [270.0, 247.0, -9.0, 64646.0]), "{:?}", sums.sums);
        assert_eq!(sums.saturated, [0, 0b10]);
    }

    #[test]
    fn a_thinned_image_is_summed_as_the_image_that_is_left() {
        let set = PatternSet::new(Axis::Column, 1, 3).expect("legal");
        let window = Window { x: 1, y: 1, width: 2, height: 2 };
        let whole = Image { width: 8, height: 7, pixels: (0..56).collect() };
        let pixels = (0..12).map(|i| whole.at(i % 4 * 2, i / 4 * 2)).collect();
        let left = Image { width: 4, height: 4, pixels: [pixels, vec![48, 50, 52, 54]].concat() };
        let mut thinned = Accumulator::new(set, 50, &[window]).expect("legal");
        thinned.thin(2);
        let mut plain = Accumulator::new(set, 50, &[window]).expect("legal");
        for step in 0..3 {
            thinned.add(step, &whole).expect("fits");
            plain.add(step, &left).expect("fits");
        }
        let (thinned, plain) = (&thinned.complete().expect("all")[0], &plain.complete().expect("all")[0]);
        assert_eq!((&thinned.sums, &thinned.saturated), (&plain.sums, &plain.saturated));
    }

    #[test]
    fn a_step_twice_a_small_image_and_a_missing_step_are_errors() {
        let set = PatternSet::new(Axis::Column, 1, 3).expect("legal");
        let mut a = Accumulator::new(set, 255, &[Window::whole(2, 2)]).expect("legal");
        assert_eq!(a.add(0, &Image::filled(2, 1, 0)), Err(Error::ImageSize { width: 2, height: 1 }));
        assert_eq!(a.add(0, &Image::filled(2, 2, 0)), Ok(()));
        assert_eq!(a.add(0, &Image::filled(2, 2, 0)), Err(Error::UnexpectedStep { step: 0, steps: 3 }));
        assert_eq!(a.add(3, &Image::filled(2, 2, 0)), Err(Error::UnexpectedStep { step: 3, steps: 3 }));
        assert_eq!(a.complete().map(<[_]>::len), Err(Error::Incomplete { got: 1, steps: 3 }));
        a.restart(&[]);
        assert_eq!(a.add(0, &Image::filled(1, 1, 0)), Ok(()));
    }
}
