//! A camera image made as small as a network wants it, in one pass: scaled by area averaging, centred, grey beside it.
//! In:  the image, the network's size. Out: one plane of 0..=1, and the way back from its pixels to the image's.
//! Not here: networks.

use crate::image::Image;
use crate::optics::Pixel;
use std::ops::Range;

/// What is beside the image, of 255, as YOLOv8 is trained with.
const GREY: f32 = 114.0 / 255.0;

/// How an image of one size lies in a network's input.
#[derive(Clone, Debug)]
pub(crate) struct Letterbox {
    image: (usize, usize),
    input: (usize, usize),
    /// Size of the scaled image, and its left upper corner in the input.
    inner: (usize, usize),
    at: (usize, usize),
    /// Per column of the scaled image: the image's columns that are whole in it, and the shares of those before and
    /// behind them.
    columns: Vec<(Range<usize>, [f32; 2])>,
}

impl Letterbox {
    /// For images and an input of these widths and heights, none of them 0.
    pub(crate) fn new(image: (usize, usize), input: (usize, usize)) -> Self {
        let scale = (input.0 as f64 / image.0 as f64).min(input.1 as f64 / image.1 as f64);
        let side = |n: usize, most: usize| ((n as f64 * scale).round() as usize).clamp(1, most);
        let inner = (side(image.0, input.0), side(image.1, input.1));
        let at = ((input.0 - inner.0) / 2, (input.1 - inner.1) / 2);
        let columns = (0..inner.0).map(|k| parts(k, inner.0, image.0)).collect();
        Self { image, input, inner, at, columns }
    }

    /// Writes the input's plane: `white` becomes 1, and so does what is brighter. Panics if sizes differ from those it was
    /// made for.
    pub(crate) fn fill(&self, image: &Image<u16>, white: f64, plane: &mut [f32]) {
        assert!((image.width, image.height) == self.image && plane.len() == self.input.0 * self.input.1, "sizes");
        plane.fill(GREY);
        let area = image.width as f64 * image.height as f64 / (self.inner.0 * self.inner.1) as f64;
        let scale = (1.0 / (area * white.max(1.0))) as f32;
        let mut sums = vec![0f32; image.width];
        for y in 0..self.inner.1 {
            let (whole, [before, behind]) = parts(y, self.inner.1, image.height);
            sums.fill(0.0);
            let mut add = |y: usize, share: f32| {
                for (sum, v) in sums.iter_mut().zip(image.row(y)) {
                    *sum += share * f32::from(*v);
                }
            };
            if before > 0.0 {
                add(whole.start - 1, before);
            }
            if behind > 0.0 {
                add(whole.end, behind);
            }
            whole.for_each(|y| add(y, 1.0));
            let out = &mut plane[(self.at.1 + y) * self.input.0 + self.at.0..][..self.inner.0];
            for (out, (whole, [before, behind])) in out.iter_mut().zip(&self.columns) {
                let mut sum: f32 = sums[whole.clone()].iter().sum();
                if *before > 0.0 {
                    sum += before * sums[whole.start - 1];
                }
                if *behind > 0.0 {
                    sum += behind * sums[whole.end];
                }
                *out = (sum * scale).min(1.0);
            }
        }
    }

    /// The image's pixel at a place of the input, whose first pixel reaches from 0 to 1.
    pub(crate) fn to_image(&self, x: f64, y: f64) -> Pixel {
        let back = |v: f64, at: usize, inner: usize, image: usize| (v - at as f64) * image as f64 / inner as f64 - 0.5;
        Pixel::new(back(x, self.at.0, self.inner.0, self.image.0), back(y, self.at.1, self.inner.1, self.image.1))
    }
}

/// What the `k`-th of `n` equal parts of `0..of` holds: whole numbers, and the shares of those before and behind them.
fn parts(k: usize, n: usize, of: usize) -> (Range<usize>, [f32; 2]) {
    // in n-ths, so that nothing is rounded
    let (from, to) = (k * of, (k + 1) * of);
    let (first, end) = (from.div_ceil(n), to / n);
    let share = |part: usize| part as f32 / n as f32;
    if first > end {
        // inside one
        return (first..first, [share(to - from), 0.0]);
    }
    (first..end, [share(first * n - from), share(to - end * n)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Random;

    /// The mean over each pixel's area, straight from its definition.
    fn naive(image: &Image<u16>, white: f64, input: (usize, usize)) -> Vec<f32> {
        let (w, h) = (image.width as f64, image.height as f64);
        let scale = (input.0 as f64 / w).min(input.1 as f64 / h);
        let inner = ((w * scale).round(), (h * scale).round());
        let at = (((input.0 as f64 - inner.0) / 2.0).floor(), ((input.1 as f64 - inner.1) / 2.0).floor());
        let overlap = |k: usize, a: f64, b: f64| ((k as f64 + 1.0).min(b) - (k as f64).max(a)).max(0.0);
        let mut out = Vec::new();
        for y in 0..input.1 {
            for x in 0..input.0 {
                let (x, y) = (x as f64 - at.0, y as f64 - at.1);
                if x < 0.0 || y < 0.0 || x >= inner.0 || y >= inner.1 {
                    out.push(114.0 / 255.0);
                    continue;
                }
                let (fx, fy) = (w / inner.0, h / inner.1);
                let (mut sum, mut area) = (0.0, 0.0);
                for v in 0..image.height {
                    for u in 0..image.width {
                        let share = overlap(u, x * fx, (x + 1.0) * fx) * overlap(v, y * fy, (y + 1.0) * fy);
                        sum += share * f64::from(image.at(u, v));
                        area += share;
                    }
                }
                out.push((sum / area / white).min(1.0) as f32);
            }
        }
        out
    }

    #[test]
    fn every_pixel_is_the_mean_over_its_area() {
        let mut random = Random::new(4, &[]);
        for (size, input) in [((81, 61), (32, 32)), ((64, 48), (32, 24)), ((20, 70), (64, 32)), ((13, 9), (32, 64))] {
            let pixels = (0..size.0 * size.1).map(|_| random.below(300) as u16).collect();
            let image = Image { width: size.0, height: size.1, pixels };
            let mut plane = vec![0.0; input.0 * input.1];
            Letterbox::new(size, input).fill(&image, 255.0, &mut plane);
            for (k, (a, b)) in plane.iter().zip(naive(&image, 255.0, input)).enumerate() {
                assert!((a - b).abs() < 1e-5, "{size:?} in {input:?}, {k}: {a} {b}");
            }
        }
    }

    #[test]
    fn places_in_the_input_go_back_to_the_images_pixels() {
        let letterbox = Letterbox::new((2592, 1944), (320, 256));
        assert_eq!((letterbox.inner, letterbox.at), ((320, 240), (0, 8)));
        assert_eq!(letterbox.to_image(0.0, 8.0), Pixel::new(-0.5, -0.5));
        assert_eq!(letterbox.to_image(320.0, 248.0), Pixel::new(2591.5, 1943.5));
        assert_eq!(letterbox.to_image(160.0, 128.0), Pixel::new(1295.5, 971.5));
    }
}
