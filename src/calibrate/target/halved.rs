//! An image at ever lower resolution, so that large things are found where they are small. In: an image. Out: it, and
//! by turns half of it. Not here: what is looked for.

use crate::image::Image;
use crate::optics::Pixel;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::borrow::Cow;

/// Images are halved until their shorter side would be below this, px.
const SMALLEST: usize = 120;

/// `image` and all below it, each the means of 2 × 2 pixels of the one before.
pub(super) fn halved(image: &Image<f32>) -> Vec<Cow<'_, Image<f32>>> {
    let mut levels = vec![Cow::Borrowed(image)];
    loop {
        let last = &levels[levels.len() - 1];
        let (width, height) = (last.width / 2, last.height / 2);
        if width.min(height) < SMALLEST {
            return levels;
        }
        let mut half = Image::filled(width, height, 0.0);
        half.pixels.par_chunks_exact_mut(width).enumerate().for_each(|(y, out)| {
            let (upper, lower) = (last.row(2 * y).chunks_exact(2), last.row(2 * y + 1).chunks_exact(2));
            for (out, (a, b)) in out.iter_mut().zip(upper.zip(lower)) {
                *out = 0.25 * (a[0] + a[1] + b[0] + b[1]);
            }
        });
        levels.push(Cow::Owned(half));
    }
}

/// Where a place of a level is one level up.
pub(super) fn doubled(p: &Pixel) -> Pixel {
    2.0 * p + Vector2::new(0.5, 0.5)
}
