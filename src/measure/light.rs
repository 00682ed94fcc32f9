//! How the red image is lit. In: the red image. Out: the body's level, the blur, where it is saturated.
//! Not here: what it shows.

use crate::image::{Image, Window};
use crate::lent::List;
use nalgebra::Vector3;

/// How the red image is lit, whatever it shows.
pub(super) struct Light {
    /// Upper quartile of the grey levels above black, without the hall's light: the body's.
    pub(super) body: f64,
    /// Blur of the sharpest edges, px, 1 sigma, where it shows anything dark beside the body.
    pub(super) blur_px: Option<f64>,
}

/// Rows that are enough to see how sharp an image is.
const ROWS: usize = 250;

fn quantile(values: &mut [f32], q: f64) -> f64 {
    let k = ((values.len() - 1) as f64 * q) as usize;
    f64::from(*values.select_nth_unstable_by(k, f32::total_cmp).1)
}

impl Light {
    /// Of the red image as it was taken, and without the hall's light.
    pub(super) fn new(taken: &Image<u16>, red: &Image<f32>, black: f64) -> Self {
        let mut levels = List::of(red.pixels.iter().step_by(31).copied());
        Self { body: quantile(&mut levels, 0.75) - black, blur_px: blur_px(taken, black) }
    }
}

/// Seen as it was taken: what is subtracted has edges of its own, and of a blurred image how much is to be subtracted is hard
/// to tell.
fn blur_px(taken: &Image<u16>, black: f64) -> Option<f64> {
    let mut levels = List::of(taken.pixels.iter().step_by(31).map(|v| f32::from(*v)));
    let (dark, bright) = (quantile(&mut levels, 0.05), quantile(&mut levels, 0.75));
    let body = bright - black;
    if dark - black >= 0.5 * body {
        return None;
    }
    let at = |x: usize, y: usize| f32::from(taken.at(x, y)).min(bright as f32);
    let rows = (1..taken.height - 1).step_by((taken.height / ROWS).max(1));
    let places = rows.flat_map(|y| (1..taken.width - 1).map(move |x| (x, y)));
    let slope = |(x, y)| 0.5 * (at(x + 1, y) - at(x - 1, y)).hypot(at(x, y + 1) - at(x, y - 1));
    let mut slopes = List::of(places.map(slope));
    // a step of this height blurred by sigma rises by height / (sigma √2π) at its steepest
    let steepest = quantile(&mut slopes, 0.999);
    Some(body / (steepest.max(1e-6) * std::f64::consts::TAU.sqrt()))
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
