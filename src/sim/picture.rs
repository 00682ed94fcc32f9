//! A scene for people to look at: in colour, without noise, the hall a little brighter than a camera would see it.
//! In: a scene and a setup. Out: a colour image.

use super::render::{Layers, Lit};
use super::scene::Scene;
use super::setup::Setup;
use crate::image::Image;
use rayon::prelude::*;
use std::time::Duration;

/// Red, green and blue of the bars' light.
const RED: [f32; 3] = [1.0, 0.16, 0.10];

/// The scene under room light and both bars.
pub fn picture(scene: &Scene, setup: &Setup) -> Image<[u8; 3]> {
    let layers = Layers::new(scene, setup, 0.0);
    let (width, height) = (setup.sensor.width, setup.sensor.height);
    let tint = match scene.paint.name {
        "red" => [1.0, 0.18, 0.15],
        "blue" => [0.35, 0.55, 1.0],
        _ => [1.0; 3],
    };
    let hall = Lit { bars: [0.0; 2], ambient: 1.0, picture: None };
    let bars = Lit { bars: [1.0; 2], ambient: 0.0, picture: None };
    // dark paint is shown brighter, as an eye would see it
    let by = (0.25 / (0.05 + scene.paint.white)).clamp(0.3, 2.5);
    let exposure = Duration::from_secs_f64(8e-3 * by);
    let mut image = Image::filled(width, height, [0u8; 3]);
    image.pixels.par_chunks_mut(width).enumerate().for_each(|(y, row)| {
        let (mut white, mut red) = (vec![0.0; width], vec![0.0; width]);
        layers.electrons(y, &hall, exposure, &mut white);
        layers.electrons(y, &bars, exposure, &mut red);
        for ((out, white), red) in row.iter_mut().zip(&white).zip(&red) {
            *out = std::array::from_fn(|c| {
                let light = (2.5 * tint[c] * white + 0.35 * RED[c] * red) / 8000.0;
                (255.0 * (light / (1.0 + 0.3 * light)).min(1.0).powf(1.0 / 2.2)) as u8
            });
        }
    });
    image
}
