//! Corners where two dark and two bright squares meet. In: a grey image. Out: where to about a pixel's third, the two
//! edges through each, and its contrast. Not here: which belong to one board, the last tenth of a pixel.
//!
//! Found where the Hessian of the smoothed image is most a saddle; kept where the grey levels on a ring about it are
//! those of such a corner: Bennett, Lasenby, "ChESS – quick and robust detection of chess-board features", Computer
//! Vision and Image Understanding 118 (2014) 197, there with fixed samples, here with the edges' directions.

use super::saddle::settle;
use crate::image::Image;
use crate::optics::Pixel;
use nalgebra::Vector2;
use rayon::prelude::*;
use std::f64::consts::PI;

/// A corner of four squares.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Corner {
    /// Where, px.
    pub(super) at: Pixel,
    /// Unit vectors along its edges: turning from the first to the second as from x to y one passes a bright square.
    /// From a corner to the next along an edge they change places.
    pub(super) axes: [Vector2<f64>; 2],
    /// Half the difference of bright and dark, grey levels.
    pub(super) contrast: f64,
}

/// Of the ring, px: so small that squares of six pixels hold it, so large that a blur of a pixel leaves its shape.
const RING: f64 = 4.0;
/// Pairs of opposite samples on the ring.
const PAIRS: usize = 16;
/// No corners so near to the border, px.
const MARGIN: usize = 6;
/// More are clutter; the strongest are kept.
const MOST: usize = 3000;

/// The corners of `image`, the strongest first.
pub(super) fn corners(image: &Image<f32>) -> Vec<Corner> {
    let (width, height) = (image.width, image.height);
    if width <= 2 * MARGIN || height <= 2 * MARGIN {
        return Vec::new();
    }
    let response: &[f32] = &saddleness(&smoothed(image));
    let mut sample: Vec<f32> = response.iter().step_by(13).copied().filter(|r| *r > 0.0).collect();
    if sample.is_empty() {
        return Vec::new();
    }
    let middle = sample.len() / 2;
    let (_, median, rest) = sample.select_nth_unstable_by(middle, f32::total_cmp);
    // well above the noise; in an image without any, above a hundredth of the strongest contrast
    let least = (10.0 * *median).max(1e-4 * rest.iter().copied().fold(*median, f32::max));
    let row = |y: usize| {
        let here = &response[y * width..(y + 1) * width];
        let peaks = (MARGIN..width - MARGIN).filter(move |&x| here[x] > least && peak(response, width, x, y));
        peaks.filter_map(move |x| corner(image, &settle(image, &Pixel::new(x as f64, y as f64))?))
    };
    let mut found: Vec<Corner> = (MARGIN..height - MARGIN).into_par_iter().flat_map_iter(row).collect();
    found.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    found.truncate(MOST);
    found
}

/// `image` under the binomial filter of five taps, a blur of one pixel; its two outermost pixels are left as they are.
fn smoothed(image: &Image<f32>) -> Image<f32> {
    let (width, height) = (image.width, image.height);
    let mut out = image.clone();
    let rows = out.pixels.par_chunks_exact_mut(width).enumerate().skip(2).take(height - 4);
    rows.for_each_init(
        || vec![0.0; width],
        |down, (y, out)| {
            let [a, b, c, d, e] = [0, 1, 2, 3, 4].map(|k| image.row(y + k - 2));
            for (x, down) in down.iter_mut().enumerate() {
                *down = (a[x] + e[x] + 4.0 * (b[x] + d[x]) + 6.0 * c[x]) / 256.0;
            }
            for (out, w) in out[2..].iter_mut().zip(down.windows(5)) {
                *out = w[0] + w[4] + 4.0 * (w[1] + w[3]) + 6.0 * w[2];
            }
        },
    );
    out
}

/// Minus the determinant of the Hessian per pixel, 0 on the border: positive at saddles, contrast squared.
fn saddleness(image: &Image<f32>) -> Vec<f32> {
    let width = image.width;
    let mut out = vec![0.0; image.pixels.len()];
    let rows = out.par_chunks_exact_mut(width).enumerate().skip(1).take(image.height - 2);
    rows.for_each(|(y, out)| {
        let [above, here, below] = [y - 1, y, y + 1].map(|y| image.row(y).windows(3));
        for (out, ((a, b), c)) in out[1..].iter_mut().zip(above.zip(here).zip(below)) {
            let (xx, yy) = (b[0] - 2.0 * b[1] + b[2], a[1] - 2.0 * b[1] + c[1]);
            let xy = 0.25 * (c[2] - c[0] - a[2] + a[0]);
            *out = xy * xy - xx * yy;
        }
    });
    out
}

/// Whether (x, y) is the one greatest of its 5 × 5 pixels.
fn peak(response: &[f32], width: usize, x: usize, y: usize) -> bool {
    let here = response[y * width + x];
    (y - 2..=y + 2).all(|v| {
        let row = &response[v * width + x - 2..=v * width + x + 2];
        row.iter().enumerate().all(|(k, r)| *r < here || (*r == here && (v, k) >= (y, 2)))
    })
}

/// The corner at `at`, if the ring about it crosses four edges, opposite ones alike.
fn corner(image: &Image<f32>, at: &Pixel) -> Option<Corner> {
    let angle = |k: f64| k * PI / PAIRS as f64;
    let mut even = [0.0; PAIRS]; // means of opposite samples: shading cancels
    let mut odd = 0.0;
    for (k, even) in even.iter_mut().enumerate() {
        let (sin, cos) = angle(k as f64).sin_cos();
        let arm = RING * Vector2::new(cos, sin);
        let [a, b] = [linear(image, &(at + arm))?, linear(image, &(at - arm))?];
        *even = 0.5 * (a + b);
        odd += (0.5 * (a - b)).powi(2);
    }
    let [low, high] = [f64::min, f64::max].map(|f| even.into_iter().fold(even[0], f));
    let contrast = 0.5 * (high - low);
    let wave = even.map(|e| e - 0.5 * (high + low));
    let energy: f64 = wave.iter().map(|w| w * w).sum();
    // three areas that meet at a board's border have as much difference as likeness
    if !(contrast > 0.0 && odd < 0.5 * energy && energy > 0.3 * PAIRS as f64 * contrast * contrast) {
        return None;
    }
    let next = |k: usize| wave[(k + 1) % PAIRS];
    let crossings: Vec<usize> = (0..PAIRS).filter(|&k| (wave[k] > 0.0) != (next(k) > 0.0)).collect();
    let &[i, j] = crossings.as_slice() else { return None };
    let edge = |k: usize| angle(k as f64 + wave[k] / (wave[k] - next(k)));
    let (a, b) = (edge(i), edge(j));
    let (from, to) = if wave[j] > 0.0 { (a, b) } else { (b, a + PI) };
    let bright = to - from;
    let axes = [from, to].map(|t| Vector2::new(t.cos(), t.sin()));
    (0.4..PI - 0.4).contains(&bright).then_some(Corner { at: *at, axes, contrast })
}

/// Between four pixels; `None` outside.
fn linear(image: &Image<f32>, p: &Pixel) -> Option<f64> {
    let (x, y) = (p.x.floor(), p.y.floor());
    if !(x >= 0.0 && y >= 0.0 && x + 1.0 < image.width as f64 && y + 1.0 < image.height as f64) {
        return None;
    }
    let (u, v) = (p.x - x, p.y - y);
    let at = |dx, dy| f64::from(image.at(x as usize + dx, y as usize + dy));
    Some((1.0 - v) * ((1.0 - u) * at(0, 0) + u * at(1, 0)) + v * ((1.0 - u) * at(0, 1) + u * at(1, 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Four sectors about (40.3, 39.8), each as grey as it says, between edges in directions `angles` (degrees).
    fn sectors(angles: [f64; 4], grey: [f64; 4]) -> Image<f32> {
        let mut image = Image::filled(80, 80, 0.0);
        for (i, pixel) in image.pixels.iter_mut().enumerate() {
            let sample = |k: i32| {
                let (x, y) = ((i % 80) as f64 + f64::from(k % 8) / 8.0, (i / 80) as f64 + f64::from(k / 8) / 8.0);
                let angle = (y - 40.25).atan2(x - 40.75).to_degrees().rem_euclid(360.0);
                grey[angles.iter().filter(|a| **a <= angle).count() % 4]
            };
            *pixel = ((0..64).map(sample).sum::<f64>() / 64.0) as f32;
        }
        image
    }

    #[test]
    fn a_corner_of_four_squares_is_one_with_its_edges() {
        for (first, second) in [(20.0, 110.0), (70.0, 120.0), (5.0, 60.0), (45.0, 160.0)] {
            let angles = [first, second, first + 180.0, second + 180.0];
            let found = corners(&sectors(angles, [20.0, 100.0, 20.0, 100.0])); // bright from first to second
            assert_eq!(found.len(), 1, "{first} {second}: {found:?}");
            let Corner { at, axes, contrast } = &found[0];
            assert!((at - Pixel::new(40.3, 39.8)).norm() < 0.3 && (35.0..41.0).contains(contrast), "{found:?}");
            for (axis, angle) in axes.iter().zip([first, second]) {
                let off = (axis.y.atan2(axis.x).to_degrees() - angle + 90.0).rem_euclid(180.0) - 90.0;
                assert!(off.abs() < 6.0, "{first} {second}: {off}°");
            }
            assert!(axes[0].perp(&axes[1]) > 0.0);
        }
    }

    #[test]
    fn edges_and_other_corners_are_none() {
        let right = [10.0, 100.0, 190.0, 280.0];
        for (name, grey) in [
            ("edge", [20.0, 20.0, 100.0, 100.0]),
            ("outer corner", [20.0, 100.0, 100.0, 100.0]),
            ("two squares on grey", [20.0, 100.0, 60.0, 60.0]),
            ("even", [50.0; 4]),
        ] {
            assert_eq!(corners(&sectors(right, grey)), [], "{name}");
        }
    }
}
