//! The hall's light in the red image. In: the red image and the ambient one, which need not be exposed alike.
//! Out: the red image as the bars alone light it. Not here: whether the hall is too bright.
//!
//! Tubes at the ceiling light hems from above: they brighten the hems that face up and leave alone those that face
//! down, which moves edges apart by tenths of a mm on dark paint. Subtracted, they do neither.

use crate::capture::Camera;
use crate::image::Image;
use crate::lent::{Lent, List};

/// Side of a tile, as a share of the image's width.
const TILES: usize = 54;
/// A tile is smooth panel where its darkest pixel has this share of its median, and bright enough from here on (share
/// of white).
const SMOOTH: f64 = 0.5;
const BRIGHT: f64 = 0.08;
/// Darker ambient images are noise, share of white.
const DIM: f64 = 0.04;
/// The ambient image's structure is a lamp's, not the paint's, from this share of its level on (1 sigma).
const STRUCTURE: f64 = 0.12;
/// So many tiles must agree.
const MIN_TILES: usize = 6;
/// The red image was not exposed more than this differently.
const SHARES: std::ops::RangeInclusive<f64> = 0.1..=10.0;

/// `red` in grey levels with what `ambient` says of the hall's light taken off, where neither is saturated; without an
/// ambient image `red` as it is.
pub(super) fn without(red: &Image<u16>, ambient: Option<&Image<u16>>, camera: &Camera) -> Lent<Image<f32>> {
    let mut out = Lent::<Image<f32>>::new();
    (out.width, out.height) = (red.width, red.height);
    let Some((ambient, share)) = ambient.and_then(|a| Some((a, share(red, a, camera)? as f32))) else {
        out.pixels.extend(red.pixels.iter().map(|v| f32::from(*v)));
        return out;
    };
    let (black, white) = (camera.black_level as f32, camera.white_level() as f32);
    out.pixels.extend(red.pixels.iter().zip(&ambient.pixels).map(|(r, a)| {
        let (r, a) = (f32::from(*r), f32::from(*a));
        if r >= white || a >= white { r } else { r - share * (a - black) }
    }));
    out
}

/// Grey levels of `red` per grey level of `ambient` that the hall's light alone gives: the slope of one on the other
/// over smooth tiles of the panel on which the ambient image shows the edge of a lamp's mirror image. Where too few do,
/// 1: exposed alike, as [`crate::capture::record`] does. `None` where they have nothing to do with each other.
fn share(red: &Image<u16>, ambient: &Image<u16>, camera: &Camera) -> Option<f64> {
    let side = (red.width / TILES).max(8);
    let (black, white) = (camera.black_level, camera.white_level());
    let mut slopes = List::new();
    let [mut a, mut r] = [(); 2].map(|()| List::filled(0.0, side * side));
    let basis = quadratic(side);
    for y in (0..red.height.saturating_sub(side - 1)).step_by(side) {
        for x in (0..red.width.saturating_sub(side - 1)).step_by(side) {
            for (j, (a, r)) in a.chunks_exact_mut(side).zip(r.chunks_exact_mut(side)).enumerate() {
                for (to, from) in [(a, ambient), (r, red)] {
                    for (to, from) in to.iter_mut().zip(&from.row(y + j)[x..x + side]) {
                        *to = f64::from(*from) - black;
                    }
                }
            }
            let least = r.iter().copied().fold(f64::MAX, f64::min);
            let most = |v: &[f64]| v.iter().copied().fold(0.0, f64::max);
            let mean = r.iter().sum::<f64>() / r.len() as f64;
            let clipped = most(&a).max(most(&r)) >= 0.96 * (white - black);
            if clipped || mean < BRIGHT * (white - black) || least < SMOOTH * mean {
                continue;
            }
            let level = a.iter().sum::<f64>() / a.len() as f64;
            for values in [&mut *a, &mut *r] {
                for b in &basis {
                    let along: f64 = values.iter().zip(b).map(|(v, b)| v * b).sum();
                    values.iter_mut().zip(b).for_each(|(v, b)| *v -= along * b);
                }
            }
            let energy: f64 = a.iter().map(|v| v * v).sum();
            if level > DIM * (white - black) && energy > (STRUCTURE * level).powi(2) * a.len() as f64 {
                slopes.push(a.iter().zip(&r).map(|(a, r)| a * r).sum::<f64>() / energy);
            }
        }
    }
    if slopes.len() < MIN_TILES {
        return Some(1.0);
    }
    let found = crate::geometry::robust::median(&mut slopes);
    SHARES.contains(&found).then_some(found)
}

/// Orthonormal quadratic polynomials over a tile.
fn quadratic(side: usize) -> List<List<f64>> {
    let at = |k: usize| k as f64 / (side - 1) as f64 * 2.0 - 1.0;
    let terms: [fn(f64, f64) -> f64; 6] = [|_, _| 1.0, |x, _| x, |_, y| y, |x, _| x * x, |x, y| x * y, |_, y| y * y];
    let mut basis: List<List<f64>> = List::new();
    for term in terms {
        let mut v = List::of((0..side * side).map(|k| term(at(k % side), at(k / side))));
        for b in &basis {
            let along: f64 = v.iter().zip(b).map(|(v, b)| v * b).sum();
            v.iter_mut().zip(b).for_each(|(v, b)| *v -= along * b);
        }
        let norm = v.iter().map(|v| v * v).sum::<f64>().sqrt();
        v.iter_mut().for_each(|v| *v /= norm);
        basis.push(v);
    }
    basis
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera {
            width: 648,
            height: 240,
            bits: 8,
            white_level: None,
            black_level: 2.0,
            read_noise_e: None,
            serial: None,
        }
    }

    /// A panel lit by the bars, falling off to the right; and by the hall, with or without a tube's mirror image across it.
    fn lit(exposed: f64, tube: f64) -> (Image<u16>, Image<u16>, Vec<f64>) {
        let (mut red, mut ambient, mut bars) =
            (Image::filled(648, 240, 0), Image::filled(648, 240, 0), Vec::with_capacity(648 * 240));
        for y in 0..240 {
            for x in 0..648 {
                let own = 90.0 - 0.025 * x as f64;
                let hall = 16.0 + tube * (-((y as f64 - 100.3 - 0.1 * x as f64) / 2.5).powi(2)).exp();
                red.row_mut(y)[x] = (2.0 + own + exposed * hall).round() as u16;
                ambient.row_mut(y)[x] = (2.0 + hall).round() as u16;
                bars.push(own);
            }
        }
        (red, ambient, bars)
    }

    #[test]
    fn the_halls_light_is_taken_off_however_the_two_are_exposed() {
        for (exposed, tube) in [(1.5, 40.0), (0.6, 40.0), (1.0, 0.0)] {
            let (red, ambient, bars) = lit(exposed, tube);
            let left = without(&red, Some(&ambient), &camera());
            let off =
                left.pixels.iter().zip(&bars).map(|(v, own)| (f64::from(*v) - 2.0 - own).abs()).fold(0.0, f64::max);
            assert!(off < 2.5, "{exposed}: {off} levels, of which rounding is up to 1.3");
            let as_it_is = without(&red, None, &camera());
            assert!(as_it_is.pixels.iter().zip(&red.pixels).all(|(a, b)| *a == f32::from(*b)));
        }
    }
}
