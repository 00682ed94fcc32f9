//! What a projector makes of a picture: gamma, the blur of its lens.
//! In: a picture of grey levels meant to be linear in light. Out: light at a place in it, 0..1.
//! Not here: what pictures mean; where their light falls.

use super::setup::Setup;
use crate::image::Image;

/// A picture as it leaves the projector's lens.
#[derive(Clone, Debug, PartialEq)]
pub struct Picture {
    width: usize,
    height: usize,
    light: Vec<f32>,
}

impl Picture {
    /// `picture` shown by the projector of `setup` on a surface `far` mm from it.
    pub fn new(picture: &Image<u8>, setup: &Setup, far: f64) -> Self {
        let level: Vec<f32> = (0..=255u8).map(|v| (f64::from(v) / 255.0).powf(setup.gamma) as f32).collect();
        let light: Vec<f32> = picture.pixels.iter().map(|v| level[usize::from(*v)]).collect();
        let sigma = setup.defocus.0.hypot(setup.defocus.1 * (far - setup.focus_mm));
        let kernel: [f32; 9] =
            std::array::from_fn(|k| (-(k as f64 - 4.0).powi(2) / (2.0 * sigma * sigma)).exp() as f32);
        let kernel = kernel.map(|k| k / kernel.iter().sum::<f32>());
        let (width, height) = (picture.width, picture.height);
        // beyond the border the picture goes on as it ends
        let near = |n: usize, at: usize, k: usize| (at + k).saturating_sub(4).min(n - 1);
        let mut across = vec![0f32; width * height];
        for (from, to) in light.chunks(width).zip(across.chunks_mut(width)) {
            for (x, to) in to.iter_mut().enumerate() {
                *to = (0..9).map(|k| kernel[k] * from[near(width, x, k)]).sum();
            }
        }
        let mut light = light;
        for (y, to) in light.chunks_mut(width).enumerate() {
            let rows: [&[f32]; 9] = std::array::from_fn(|k| &across[near(height, y, k) * width..][..width]);
            for (x, to) in to.iter_mut().enumerate() {
                *to = (0..9).map(|k| kernel[k] * rows[k][x]).sum();
            }
        }
        Self { width, height, light }
    }

    /// Light at a place of the picture, px; none beyond its border.
    pub(super) fn at(&self, column: f32, row: f32) -> f32 {
        let (x, y) = (column + 0.5, row + 0.5);
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f32 && y < self.height as f32) {
            return -(super::setup::PROJECTOR_BLACK as f32); // with what black lets through: nothing
        }
        let (c, r) = (column.clamp(0.0, (self.width - 1) as f32), row.clamp(0.0, (self.height - 1) as f32));
        let (i, j) = ((c as usize).min(self.width - 2), (r as usize).min(self.height - 2));
        let (s, t) = (c - i as f32, r - j as f32);
        let at = j * self.width + i;
        let line = |at: usize| self.light[at] + s * (self.light[at + 1] - self.light[at]);
        let (upper, lower) = (line(at), line(at + self.width));
        upper + t * (lower - upper)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_picture_keeps_its_light_and_loses_its_edges() {
        let setup = Setup::new(0.25, 8);
        let mut picture = Image::filled(64, 40, 0u8);
        (0..40).for_each(|y| picture.row_mut(y)[32..].fill(255));
        let sharp = Picture::new(&picture, &setup, setup.focus_mm);
        let soft = Picture::new(&picture, &setup, setup.focus_mm + 150.0);
        assert!(sharp.at(20.0, 20.0).abs() < 1e-6 && (sharp.at(44.0, 20.0) - 1.0).abs() < 1e-5);
        assert!((sharp.at(31.5, 20.0) - 0.5).abs() < 1e-3, "half its light where its edge is");
        assert!(soft.at(31.0, 20.0) > sharp.at(31.0, 20.0));
        let grey = Picture::new(&Image::filled(16, 16, 128), &setup, setup.focus_mm);
        assert!((f64::from(grey.at(8.3, 8.7)) - (128.0f64 / 255.0).powf(setup.gamma)).abs() < 1e-5);
    }
}
