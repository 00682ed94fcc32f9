//! The images of one fringe set, kept until all are there.
//! In: the images of one set, one at a time, in any order. Out: per window the samples of every step.
//! An image is copied once, its windows only: two bytes a sample, as fast as memory; sums as wide as a fit needs would be
//! read and written with every image.

use super::{Error, PatternSet};
use crate::Image;
use crate::image::Window;
use crate::lent::List;
use rayon::prelude::*;

/// The images of one fringe set over a list of windows.
#[derive(Clone, Debug)]
pub struct Stack {
    set: PatternSet,
    white_level: u16,
    seen: u16,
    every: usize,
    windows: List<Planes>,
}

/// The samples inside one window.
#[derive(Clone, Debug)]
pub(super) struct Planes {
    pub(super) window: Window,
    /// By step, row by row.
    steps: List<List<u16>>,
}

impl Planes {
    /// To be overwritten by the images.
    fn new(window: Window, steps: u32) -> Self {
        Self { window, steps: List::of((0..steps).map(|_| List::stale(0, window.width * window.height))) }
    }

    /// Pixels.
    pub(super) fn len(&self) -> usize {
        self.window.width * self.window.height
    }

    /// The samples of pixels `range` at each step.
    pub(super) fn part(&self, range: std::ops::Range<usize>) -> impl Iterator<Item = &[u16]> + Clone {
        self.steps.iter().map(move |plane| &plane[range.clone()])
    }
}

impl Stack {
    /// An empty one over `windows`; samples from `white_level` up count as saturated.
    /// Errors where the set is none: no fringe, or steps outside 3..=16.
    pub fn new(set: PatternSet, white_level: u16, windows: &[Window]) -> Result<Self, Error> {
        set.check()?;
        let mut empty = Self { set, white_level, seen: 0, every: 1, windows: List::new() };
        empty.restart(windows);
        Ok(empty)
    }

    /// Looks at every `every`-th column and row of the images only, from the first on; windows are of the image that
    /// is left. For a camera much finer than the surface needs.
    pub fn thin(&mut self, every: usize) {
        self.every = every.max(1);
    }

    /// Forgets the images and turns to `windows`.
    pub fn restart(&mut self, windows: &[Window]) {
        self.seen = 0;
        self.windows.clear();
        self.windows.extend(windows.iter().map(|window| Planes::new(*window, self.set.steps)));
    }

    /// Adds the image of `step` (0-based). Errors, with the images as they were: the step is none of the set's or
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
        self.seen |= 1 << step;
        for Planes { window, steps } in self.windows.iter_mut().filter(|planes| planes.len() > 0) {
            let rows = steps[step as usize].par_chunks_mut(window.width).with_min_len(64);
            rows.enumerate().for_each(|(y, to)| {
                let from = &image.row((window.y + y) * every)[window.x * every..];
                if every == 1 {
                    to.copy_from_slice(&from[..to.len()]);
                } else {
                    to.iter_mut().zip(from.iter().step_by(every)).for_each(|(to, from)| *to = *from);
                }
            });
        }
        Ok(())
    }

    /// Whether the images of all steps are there.
    pub fn is_complete(&self) -> bool {
        self.seen.count_ones() == self.set.steps
    }

    /// The fringe set.
    pub fn set(&self) -> &PatternSet {
        &self.set
    }

    /// From where on samples are saturated.
    pub(super) fn white_level(&self) -> u16 {
        self.white_level
    }

    /// The samples, once every step is there.
    pub(super) fn complete(&self) -> Result<&[Planes], Error> {
        let (got, steps) = (self.seen.count_ones(), self.set.steps);
        if self.is_complete() { Ok(&self.windows) } else { Err(Error::Incomplete { got, steps }) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fringe::Axis;

    /// Of each step, the samples of a window.
    fn kept(stack: &Stack) -> Vec<Vec<u16>> {
        let planes = &stack.complete().expect("every step")[0];
        planes.part(0..planes.len()).map(<[_]>::to_vec).collect()
    }

    #[test]
    fn windows_are_kept_from_where_they_are_and_nothing_of_earlier_images() {
        let set = |steps| PatternSet::new(Axis::Column, 1, steps).expect("legal");
        let window = Window { x: 1, y: 1, width: 2, height: 1 };
        let stack = |steps, window| Stack::new(set(steps), 255, &[window]).expect("legal");
        let spare = crate::lent::Spare::default();
        let mut first = spare.serve(|| stack(4, window));
        for (step, (left, right)) in [(10, 254), (20, 255), (30, 7), (50, 9)].into_iter().enumerate() {
            let image = Image { width: 3, height: 2, pixels: vec![99, 99, 99, 99, left, right] };
            first.add(step as u32, &image).expect("fits");
        }
        assert_eq!(kept(&first), [[10, 254], [20, 255], [30, 7], [50, 9]]);
        drop(first);
        let mut next = spare.serve(|| stack(3, Window { x: 0, ..window }));
        assert!(next.complete().is_err());
        for step in 0..3 {
            next.add(step, &Image { width: 2, height: 2, pixels: vec![1, 2, 3 + step as u16, 4] }).expect("fits");
        }
        assert_eq!(kept(&next), [[3, 4], [4, 4], [5, 4]]);
    }

    #[test]
    fn a_thinned_image_is_kept_as_the_image_that_is_left() {
        let set = PatternSet::new(Axis::Column, 1, 3).expect("legal");
        let window = Window { x: 1, y: 1, width: 2, height: 2 };
        let whole = Image { width: 8, height: 7, pixels: (0..56).collect() };
        let pixels = (0..12).map(|i| whole.at(i % 4 * 2, i / 4 * 2)).collect();
        let left = Image { width: 4, height: 4, pixels: [pixels, vec![48, 50, 52, 54]].concat() };
        let mut thinned = Stack::new(set, 50, &[window]).expect("legal");
        thinned.thin(2);
        let mut plain = Stack::new(set, 50, &[window]).expect("legal");
        for step in 0..3 {
            thinned.add(step, &whole).expect("fits");
            plain.add(step, &left).expect("fits");
        }
        assert_eq!(kept(&thinned), kept(&plain));
    }

    #[test]
    fn a_step_twice_a_small_image_and_a_missing_step_are_errors() {
        let set = PatternSet::new(Axis::Column, 1, 3).expect("legal");
        let mut a = Stack::new(set, 255, &[Window::whole(2, 2)]).expect("legal");
        assert_eq!(a.add(0, &Image::filled(2, 1, 0)), Err(Error::ImageSize { width: 2, height: 1 }));
        assert_eq!(a.add(0, &Image::filled(2, 2, 0)), Ok(()));
        assert_eq!(a.add(0, &Image::filled(2, 2, 0)), Err(Error::UnexpectedStep { step: 0, steps: 3 }));
        assert_eq!(a.add(3, &Image::filled(2, 2, 0)), Err(Error::UnexpectedStep { step: 3, steps: 3 }));
        assert_eq!(a.complete().map(<[_]>::len), Err(Error::Incomplete { got: 1, steps: 3 }));
        a.restart(&[]);
        assert_eq!(a.add(0, &Image::filled(1, 1, 0)), Ok(()));
    }
}
