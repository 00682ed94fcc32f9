//! Whether fringe images show the patterns that they are said to show. In: the images of all sets, pixels of a body.
//! Out: nothing, or what is wrong. The last guard: an image of another pattern than its own makes wrong depth, not noise.
//! Not here: which image was taken when (drivers); single pixels that are bad (`fringe`).
//!
//! Within a set an image of another pattern does not lie on the sine through the others: the fit's residual, as a share of
//! the modulation, is then some 0.2 to 0.7 where a right one has some 0.05. Only what is the same of two pixels side by side
//! along the fringes counts: noise, and a projector's dither on glittering paint, is not, whatever its size, and another
//! pattern is. A set that runs backwards still is a sine, and
//! so is one that begins with another step, but then its phase does not fit the next coarser set's any more. (A coarsest set
//! that begins with another of its own steps cannot be told from a body elsewhere; no camera that is late makes one.)

use crate::fringe::Axis;
use crate::geometry::robust::median;
use crate::hal::Sensor;
use crate::image::Image;
use std::f64::consts::{FRAC_PI_8, PI, TAU};

/// Median residual of a set, as a share of the modulation, from which on an image is not its pattern's. One late by a step
/// in a set of 8 makes 0.19; projectors that are not linear, 0.04.
const RESIDUAL: f64 = 0.12;
/// Pixels whose modulation is less than so many times the noise say nothing.
const SIGMAS: f64 = 6.0;
/// So few pixels say nothing.
const FEWEST: usize = 100;
/// More say nothing more.
const MOST: usize = 4000;

/// The sine of a pixel in one set: mean (DN), phase (rad), modulation (DN); and the variance of its noise, DN².
struct Fit {
    mean: f64,
    phase: f64,
    modulation: f64,
    noise: f64,
}

/// Checks the images of `sets`, in the order shown, at `pixels`; exposed with `gain`. An error says what is wrong.
pub fn check_order(
    sets: &[(Axis, u32, u32)],
    images: &[&Image<u16>],
    pixels: &[usize],
    sensor: &Sensor,
    gain: f64,
) -> Result<(), String> {
    let pixels = || pixels.iter().copied().step_by((pixels.len() / MOST).max(1));
    let mut first = 0;
    // of each set, per pixel: what was fitted where there is light enough and none is saturated
    let mut fits: Vec<Vec<Option<Fit>>> = Vec::with_capacity(sets.len());
    for &(axis, count, steps) in sets {
        let of_set = &images[first..first + steps as usize];
        first += steps as usize;
        let fitted: Vec<Option<Fit>> = pixels().map(|at| fit(of_set, at, sensor, gain)).collect();
        let along = if axis == Axis::Column { sensor.width } else { 1 };
        let share = |(at, fitted): (usize, &Option<Fit>)| {
            let (one, beside) = (fitted.as_ref()?, fit(of_set, at + along, sensor, gain)?);
            let common = common_residual(of_set, (at, one), (at + along, &beside));
            Some(common / (one.modulation * beside.modulation))
        };
        let mut shares: Vec<f64> = pixels().zip(&fitted).filter_map(share).collect();
        if steps > 3 && shares.len() >= FEWEST {
            let residual = median(&mut shares).max(0.0).sqrt();
            if residual > RESIDUAL {
                return Err(format!(
                    "The {steps} images of {count} fringes lie off their sine by {residual:.2} of its amplitude, allowed \
                     {RESIDUAL}: one of them shows another pattern."
                ));
            }
        }
        fits.push(fitted);
    }
    for (coarse, &(axis, count, _)) in sets.iter().enumerate() {
        // against the next finer set along the same axis
        let finer = sets.iter().enumerate().filter(|(_, s)| s.0 == axis && s.1 > count && s.1 % count == 0);
        let Some((fine, &(_, finer, _))) = finer.min_by_key(|(_, s)| s.1) else { continue };
        let ratio = f64::from(finer / count);
        let mut off: Vec<f64> = fits[coarse]
            .iter()
            .zip(&fits[fine])
            .filter_map(|(c, f)| Some((c.as_ref()?, f.as_ref()?)))
            // where noise alone makes the phases differ nothing is said
            .filter(|(c, _)| ratio * c.noise.sqrt() / c.modulation < 0.3)
            .map(|(c, f)| wrapped(f.phase - ratio * c.phase).abs())
            .collect();
        if off.len() >= FEWEST {
            let off = median(&mut off);
            // phases that have nothing to do with each other differ by 90° in the median, a set of 8 late by a step by 45°
            if off > FRAC_PI_8 {
                return Err(format!(
                    "{finer} fringes lie {:.0}° from where {count} say, allowed 22°: the images are out of order.",
                    off.to_degrees()
                ));
            }
        }
    }
    Ok(())
}

/// The sine through a pixel's levels; none where it is not in the images, saturated or too dim.
fn fit(images: &[&Image<u16>], at: usize, sensor: &Sensor, gain: f64) -> Option<Fit> {
    let n = images.len() as f64;
    let (mut mean, mut c, mut s) = (0.0, 0.0, 0.0);
    for (k, image) in images.iter().enumerate() {
        let level = *image.pixels.get(at)?;
        if level >= sensor.white_level {
            return None;
        }
        let level = f64::from(level) / n;
        let (sin, cos) = (TAU * k as f64 / n).sin_cos();
        (mean, c, s) = (mean + level, c + 2.0 * level * cos, s - 2.0 * level * sin);
    }
    let modulation = c.hypot(s);
    let dn = gain * sensor.dn_per_electron;
    let noise = dn * (mean - sensor.black_level).max(0.0) + (dn * sensor.read_noise_e).powi(2) + 1.0 / 12.0;
    let enough = modulation > SIGMAS * noise.sqrt();
    enough.then(|| Fit { mean, phase: s.atan2(c), modulation, noise })
}

/// The covariance of what two pixels' sines leave of their levels, DN²: the residual's variance without what is each pixel's own.
fn common_residual(images: &[&Image<u16>], one: (usize, &Fit), other: (usize, &Fit)) -> f64 {
    let n = images.len() as f64;
    let rest = |k: usize, image: &Image<u16>, (at, fit): (usize, &Fit)| {
        f64::from(image.pixels[at]) - fit.mean - fit.modulation * (fit.phase + TAU * k as f64 / n).cos()
    };
    let products = images.iter().enumerate().map(|(k, image)| rest(k, image, one) * rest(k, image, other));
    products.sum::<f64>() / (n - 3.0).max(1.0)
}

fn wrapped(angle: f64) -> f64 {
    let turned = angle.rem_euclid(TAU);
    if turned > PI { turned - TAU } else { turned }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fringe::PatternSet;
    use crate::testing::Noise;

    const SETS: [(Axis, u32, u32); 3] = [(Axis::Column, 64, 8), (Axis::Column, 8, 4), (Axis::Column, 1, 4)];

    fn sensor() -> Sensor {
        Sensor {
            width: 640,
            height: 4,
            bits: 8,
            black_level: 2.0,
            white_level: 255,
            dn_per_electron: 0.032,
            read_noise_e: 6.0,
            serial: String::new(),
        }
    }

    /// A camera that looks straight at what the projector shows, through a lens that bends it a little.
    fn images() -> Vec<Image<u16>> {
        let mut images = Vec::new();
        for (axis, count, steps) in SETS {
            let set = PatternSet::new(axis, count, steps).expect("usual");
            for step in 0..steps {
                let shown = set.render(step, 1280, 4);
                let level = |i: usize| {
                    let (x, y) = (i % 640, i / 640);
                    let at = 1.9 * x as f64 + 8e-5 * (x * x) as f64;
                    u16::from(shown.pixels[y * 1280 + at as usize]) / 2 + 20
                };
                images.push(Image { width: 640, height: 4, pixels: (0..640 * 4).map(level).collect() });
            }
        }
        images
    }

    fn check(images: &[Image<u16>]) -> Result<(), String> {
        let pixels: Vec<usize> = (0..640 * 4).collect();
        check_order(&SETS, &images.iter().collect::<Vec<_>>(), &pixels, &sensor(), 1.0)
    }

    #[test]
    fn images_of_their_patterns_pass() {
        assert_eq!(check(&images()), Ok(()));
        let dark: Vec<_> = (0..16).map(|_| Image::filled(640, 4, 3)).collect();
        assert_eq!(check(&dark), Ok(()), "nothing can be said");
    }

    /// In the finest set a fifth of the modulation, several times what the sensor has, as a projector's dither on glittering
    /// paint makes. (Coarse sets are held against finer ones, which so much noise would make meaningless.)
    #[test]
    fn pixels_that_glitter_are_no_other_pattern_and_hide_none() {
        let mut noise = Noise::new(6);
        let mut right = images();
        for (k, image) in right.iter_mut().enumerate() {
            let sigma = if k < 8 { 12.0 } else { 3.0 };
            for level in &mut image.pixels {
                *level = (f64::from(*level) + sigma * noise.gauss()).clamp(0.0, 254.0) as u16;
            }
        }
        assert_eq!(check(&right), Ok(()));
        for set in [0..8, 8..12, 12..16] {
            for (k, other) in set.clone().flat_map(|k| set.clone().map(move |other| (k, other))) {
                let mut wrong = right.clone();
                wrong[k] = right[other].clone();
                assert!(k == other || check(&wrong).is_err(), "{k} shows {other}");
            }
        }
    }

    #[test]
    fn any_one_image_of_another_pattern_is_seen() {
        let right = images();
        for (k, _) in right.iter().enumerate() {
            for (other, _) in right.iter().enumerate().filter(|(other, _)| *other != k) {
                let mut wrong = right.clone();
                wrong[k] = right[other].clone();
                assert!(check(&wrong).is_err(), "{k} shows {other}");
            }
            let mut wrong = right.clone();
            wrong[k] = Image::filled(640, 4, 20);
            assert!(check(&wrong).is_err(), "{k} is dark");
        }
    }

    #[test]
    fn images_that_are_late_or_swapped_are_seen() {
        let right = images();
        for late in 1..4 {
            let mut wrong = right.clone();
            wrong.rotate_right(late);
            assert!(check(&wrong).is_err(), "all late by {late}");
        }
        for (a, b) in (0..16).flat_map(|a| (a + 1..16).map(move |b| (a, b))) {
            let mut wrong = right.clone();
            wrong.swap(a, b);
            assert!(check(&wrong).is_err(), "{a} and {b} swapped");
        }
        for set in [0..8, 8..12, 12..16] {
            let mut wrong = right.clone();
            wrong[set.clone()].reverse();
            assert!(check(&wrong).is_err(), "{set:?} backwards");
        }
        for set in [0..8, 8..12] {
            let mut wrong = right.clone();
            wrong[set.clone()].rotate_right(1);
            assert!(check(&wrong).is_err(), "{set:?} late by a step");
        }
    }
}
