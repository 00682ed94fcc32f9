//! Grey images. In: PNG bytes or samples. Out: pixels by row, sub-pixel samples.
//! Not here: lens distortion, anything about what is seen.

mod png;

pub use png::{
    MAX_SIDE, PngError, PngHeader, png_rgb, read_png, read_png_header, write_png, write_png_16, write_png_rgb,
};

use crate::lent::{Lent, Reuse};

/// A grey image, row by row, `pixels[y * width + x]`; pixel centres at integers, y down.
#[derive(Clone, Debug, PartialEq)]
pub struct Image<T> {
    /// Pixels per row.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Samples, row-major; `width * height` of them.
    pub pixels: Vec<T>,
}

impl<T: Copy> Image<T> {
    /// An image filled with `value`.
    pub fn filled(width: usize, height: usize, value: T) -> Self {
        Self { width, height, pixels: vec![value; width * height] }
    }

    /// The same with room that is lent.
    #[track_caller]
    pub fn lent(width: usize, height: usize, value: T) -> Lent<Self>
    where
        T: Send + 'static,
    {
        let mut image = Lent::<Self>::new();
        (image.width, image.height) = (width, height);
        image.pixels.resize(width * height, value);
        image
    }

    /// Row `y`. Panics outside.
    pub fn row(&self, y: usize) -> &[T] {
        &self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// Row `y`, to write. Panics outside.
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.pixels[y * self.width..(y + 1) * self.width]
    }

    /// The sample at (x, y). Panics outside.
    pub fn at(&self, x: usize, y: usize) -> T {
        self.pixels[y * self.width + x]
    }
}

impl<T> Default for Image<T> {
    /// Of no pixel.
    fn default() -> Self {
        Self { width: 0, height: 0, pixels: Vec::new() }
    }
}

impl<T: Send + 'static> Reuse for Image<T> {
    const MUST_DROP: bool = <Vec<T> as Reuse>::MUST_DROP;

    fn empty(&mut self) {
        (self.width, self.height) = (0, 0);
        self.pixels.clear();
    }
}

/// A rectangle of whole pixels inside an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window {
    /// Left column.
    pub x: usize,
    /// Top row.
    pub y: usize,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
}

impl Window {
    /// The part of `x0..=x1`, `y0..=y1` that lies inside a `width` × `height` image; `None` if nothing does.
    pub fn clipped(x0: f64, y0: f64, x1: f64, y1: f64, width: usize, height: usize) -> Option<Self> {
        let (left, top) = (x0.floor().max(0.0), y0.floor().max(0.0));
        let (right, bottom) = (x1.ceil().min(width as f64 - 1.0), y1.ceil().min(height as f64 - 1.0));
        if !(right >= left && bottom >= top) {
            return None;
        }
        Some(Self {
            x: left as usize,
            y: top as usize,
            width: (right - left) as usize + 1,
            height: (bottom - top) as usize + 1,
        })
    }

    /// The whole of a `width` × `height` image.
    pub const fn whole(width: usize, height: usize) -> Self {
        Self { x: 0, y: 0, width, height }
    }
}
