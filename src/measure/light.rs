//! How the red image is lit. In: the red image. Out: the body's level, the blur, where it is saturated.
//! Not here: what it shows.

use crate::image::{Image, Window};
use crate::lent::List;
use nalgebra::{Vector2, Vector3};

/// How the red image is lit, whatever it shows.
pub(super) struct Light {
    /// Upper quartile of the grey levels above black: the body's.
    pub(super) body: f64,
}

/// How far along a blurred edge its height is looked for, px.
const EDGE_PX: usize = 8;
/// Least height of an edge as a share of the body's level.
const EDGE_SHARE: f32 = 0.3;

fn quantile(values: &mut [f32], q: f64) -> f64 {
    let k = ((values.len() - 1) as f64 * q) as usize;
    f64::from(*values.select_nth_unstable_by(k, f32::total_cmp).1)
}

impl Light {
    pub(super) fn new(red: &Image<f32>, black: f64) -> Self {
        let mut levels = List::of(red.pixels.iter().step_by(31).copied());
        Self { body: quantile(&mut levels, 0.75) - black }
    }

    /// Blur of the sharpest edges of `red`, px, 1 sigma; none where it shows no edges.
    pub(super) fn blur_px(&self, red: &Image<f32>) -> Option<f64> {
        let places = || {
            let columns = EDGE_PX..red.width.saturating_sub(EDGE_PX);
            (EDGE_PX..red.height.saturating_sub(EDGE_PX))
                .step_by(2)
                .flat_map(move |y| columns.clone().map(move |x| (x, y)))
        };
        let slope =
            |(x, y)| 0.5 * Vector2::new(red.at(x + 1, y) - red.at(x - 1, y), red.at(x, y + 1) - red.at(x, y - 1));
        let mut slopes = List::of(places().map(|p| slope(p).norm()));
        if slopes.is_empty() {
            return None;
        }
        let steep = quantile(&mut slopes, 0.999) as f32;
        // each has a height of its own: a glint is brighter than any body
        let blur = |(x, y): (usize, usize)| {
            let s = slope((x, y));
            if s.norm() < steep {
                return None;
            }
            let along =
                |k: usize| if s.x.abs() > s.y.abs() { red.at(x + k - EDGE_PX, y) } else { red.at(x, y + k - EDGE_PX) };
            let levels = || (0..=2 * EDGE_PX).map(along);
            let height = levels().fold(f32::MIN, f32::max) - levels().fold(f32::MAX, f32::min);
            // a step of this height blurred by sigma rises by height / (sigma √2π) at its steepest
            let sigma = height / (s.amax() * std::f32::consts::TAU.sqrt());
            (height > EDGE_SHARE * self.body as f32).then_some(sigma)
        };
        let mut blurs = List::of(places().filter_map(blur));
        (!blurs.is_empty()).then(|| quantile(&mut blurs, 0.5))
    }
}

/// Share of saturated pixels within 20 mm of a point, in the red image.
pub(super) fn saturated_share(
    red: &Image<u16>,
    white: f64,
    camera: &crate::optics::Lens,
    centre: &Vector3<f64>,
) -> f64 {
    let Some(p) = camera.project(centre) else { return 0.0 };
    let half = 20.0 * camera.fx / centre.z;
    let Some(w) = Window::clipped(p.x - half, p.y - half, p.x + half, p.y + half, red.width, red.height) else {
        return 0.0;
    };
    let saturated = (w.y..w.y + w.height)
        .map(|y| red.row(y)[w.x..w.x + w.width].iter().filter(|v| f64::from(**v) >= white).count());
    saturated.sum::<usize>() as f64 / (w.width * w.height) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps of 100 between 20 and 120 every 40 px, blurred by `sigma` px, and a line ten times as bright.
    fn steps(sigma: f64) -> Image<f32> {
        let mut red = Image::filled(400, 100, 0.0);
        let step = |d: f64| (1.0 + (1.702 * d / sigma).exp()).recip(); // close to the normal's integral
        for y in 0..red.height {
            let row = red.row_mut(y);
            for (x, v) in row.iter_mut().enumerate() {
                let d = (x as f64).rem_euclid(80.0) - 40.0;
                let glint = 1000.0 * (-0.5 * ((x as f64 - 200.0) / sigma.hypot(1.0)).powi(2)).exp();
                *v = (20.0 + 100.0 * step(20.0 - d.abs()) + glint) as f32;
            }
        }
        red
    }

    #[test]
    fn the_blur_is_that_of_the_edges_whatever_their_height() {
        for sigma in [1.5, 4.0] {
            let red = steps(sigma);
            let blur = Light::new(&red, 10.0).blur_px(&red).expect("edges");
            assert!((blur / sigma - 1.0).abs() < 0.4, "{sigma}: {blur}");
        }
        let flat = Image::filled(400, 100, 50.0);
        assert_eq!(Light::new(&flat, 10.0).blur_px(&flat), None);
    }
}
