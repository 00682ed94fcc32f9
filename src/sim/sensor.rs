//! What a sensor makes of light: blur, shot and read noise, black level, saturation, whole grey levels.
//! In:  layers and what is lit. Out: an image. Deterministic: a row's noise depends on seed, exposure and row only.

use super::random::{NORMAL, Random};
use super::render::{Layers, Lit};
use super::setup::Setup;
use crate::image::Image;
use rayon::prelude::*;
use std::time::Duration;

/// How the pixels of a sensor differ in sensitivity, 1 sigma, as a share.
const UNEVEN: f32 = 0.003;

/// How an image is taken.
#[derive(Clone, Copy, Debug)]
pub struct Take {
    /// How long light is gathered.
    pub exposure: Duration,
    /// Factor on the grey levels per electron.
    pub gain: f64,
    /// Where noise starts from: the station's seed and the exposure's number.
    pub seed: u64,
    /// See there.
    pub number: u64,
}

/// Dirt on the lens: what it takes away and what it spreads over the image.
#[derive(Clone, Debug, PartialEq)]
pub struct Dirt {
    /// Smudges: centre (share of width and height), radius (share of width), share of light lost in its middle.
    pub smudges: Vec<([f64; 2], f64, f64)>,
    /// Share of all light that is spread evenly.
    pub veil: f64,
}

impl Dirt {
    fn lost(&self, x: f64, y: f64, width: f64) -> f64 {
        let passes = |(at, radius, lost): &([f64; 2], f64, f64)| {
            let far = (x - at[0] * width).hypot(y - at[1] * width) / (radius * width);
            1.0 - lost * (-far.powi(4)).exp()
        };
        1.0 - self.smudges.iter().map(passes).product::<f64>() * (1.0 - self.veil)
    }
}

/// Takes an image of `layers` under `lit` into `image`, which has the sensor's size.
pub fn expose(setup: &Setup, layers: &Layers, lit: &Lit, dirt: Option<&Dirt>, take: &Take, image: &mut Image<u16>) {
    let (width, height) = (image.width, layers.height());
    let mut light = vec![0f32; width * height];
    light.par_chunks_mut(width).enumerate().for_each(|(y, row)| layers.electrons(y, lit, take.exposure, row));
    if let Some(dirt) = dirt {
        let mean = light.iter().map(|v| f64::from(*v)).sum::<f64>() / light.len() as f64;
        light.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
            for (x, v) in row.iter_mut().enumerate() {
                let lost = dirt.lost(x as f64, y as f64, width as f64);
                *v = (f64::from(*v) * (1.0 - lost) + dirt.veil * mean) as f32;
            }
        });
    }
    let taps: Vec<f32> =
        (-2i32..=2).map(|k| (-f64::from(k * k) / (2.0 * setup.blur_px * setup.blur_px)).exp() as f32).collect();
    let sum: f32 = taps.iter().sum();
    let taps: [f32; 5] = std::array::from_fn(|k| taps[k] / sum);
    let sensor = &setup.sensor;
    let dn = (sensor.dn_per_electron * take.gain) as f32;
    let (black, white) = (sensor.black_level as f32, f32::from(sensor.white_level));
    let read2 = (sensor.read_noise_e * sensor.read_noise_e) as f32;
    // bars are steadier than a projector's dither
    let glitter = if lit.picture.is_some() { layers.glitter } else { 0.5 * layers.glitter };
    let glitter2 = (glitter * glitter) as f32;
    image.pixels.par_chunks_mut(width).enumerate().for_each_init(
        || (vec![0f32; width + 4], vec![0f32; width]),
        |(down, across), (y, out)| {
            let line = |k: usize| &light[(y + k).saturating_sub(2).min(height - 1) * width..][..width];
            let lines: [&[f32]; 5] = std::array::from_fn(line);
            let [a, b, c, d, e] = lines;
            for (((((v, a), b), c), d), e) in down[2..].iter_mut().zip(a).zip(b).zip(c).zip(d).zip(e) {
                *v = taps[0] * (a + e) + taps[1] * (b + d) + taps[2] * c;
            }
            (down[0], down[1]) = (down[2], down[2]);
            (down[width + 2], down[width + 3]) = (down[width + 1], down[width + 1]);
            for (v, d) in across.iter_mut().zip(down.windows(5)) {
                *v = taps[0] * (d[0] + d[4]) + taps[1] * (d[1] + d[3]) + taps[2] * d[2];
            }
            let mut noise = Random::new(take.seed, &[take.number, y as u64]);
            let mut pattern = Random::new(take.seed, &[u64::MAX, y as u64]); // of the sensor: the same in every image
            let normal = &NORMAL;
            for (out, light) in out.chunks_mut(4).zip(across.chunks(4)) {
                let (n, p) = (noise.bits(), pattern.bits());
                for (k, (out, light)) in out.iter_mut().zip(light).enumerate() {
                    let of = |bits: u64| normal[usize::from((bits >> (16 * k)) as u16)];
                    let light = light * (1.0 + UNEVEN * of(p));
                    let sigma = (light + read2 + glitter2 * light * light).sqrt();
                    *out = (black + dn * (light + sigma * of(n))).round_ties_even().clamp(0.0, white) as u16;
                }
            }
        },
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::mean_std;

    /// An image of an even wall of so many grey levels.
    fn wall(setup: &Setup, level: f64, gain: f64, dirt: Option<&Dirt>) -> Image<u16> {
        let layers = Layers::empty(setup);
        let exposure = Duration::from_millis(10);
        let mut row = vec![0.0; setup.sensor.width];
        layers.electrons(0, &Lit { bars: [0.0; 2], ambient: 1.0, picture: None }, exposure, &mut row);
        let ambient = level / (f64::from(row[0]) * setup.sensor.dn_per_electron * gain);
        let lit = Lit { bars: [0.0; 2], ambient, picture: None };
        let mut image = Image::filled(setup.sensor.width, setup.sensor.height, 0);
        expose(setup, &layers, &lit, dirt, &Take { exposure, gain, seed: 1, number: 1 }, &mut image);
        image
    }

    #[test]
    fn noise_follows_shot_and_read_noise() {
        for (bits, level, gain) in [(8, 60.0, 1.0), (8, 60.0, 4.0), (10, 400.0, 1.0)] {
            let setup = Setup::new(0.25, bits);
            let image = wall(&setup, level, gain, None);
            let (mean, std) = mean_std(&image.pixels.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
            let g = setup.sensor.dn_per_electron * gain;
            let law = (g * level + (g * setup.sensor.read_noise_e).powi(2) + 1.0 / 12.0).sqrt();
            assert!((mean - level - setup.sensor.black_level).abs() < 0.02 * level.sqrt(), "{mean}");
            // pixels differ by 0.3 % on top
            assert!((std / law - 1.0).abs() < 0.05, "{bits} bits, gain {gain}: {std} for {law}");
        }
    }

    #[test]
    fn too_much_light_is_white_and_none_is_black() {
        let setup = Setup::new(0.25, 8);
        assert!(wall(&setup, 400.0, 1.0, None).pixels.iter().all(|v| *v == 255));
        let (mean, _) =
            mean_std(&wall(&setup, 1e-9, 1.0, None).pixels.iter().map(|v| f64::from(*v)).collect::<Vec<_>>());
        assert!((mean - 2.0).abs() < 0.01, "{mean}");
    }

    #[test]
    fn dirt_takes_light_where_it_sits() {
        let setup = Setup::new(0.25, 8);
        let dirt = Dirt { smudges: vec![([0.5, 0.5], 0.1, 0.8)], veil: 0.0 };
        let image = wall(&setup, 100.0, 1.0, Some(&dirt));
        let at = |x: f64| f64::from(image.at((x * image.width as f64) as usize, image.width / 2));
        assert!(at(0.5) < 35.0 && at(0.2) > 85.0, "{} {}", at(0.5), at(0.2));
    }
}
