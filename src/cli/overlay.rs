//! The red image with what a measurement saw drawn in: regions, contours by their residual, features.
//! In: a red image and what came of it. Out: a picture in colour; one RGB PNG per capture.

use crate::Capture;
use crate::image::{Image, write_png_rgb};
use crate::measure::{Drawing, Measurement};
use anyhow::Context;
use std::path::Path;

const REGION: [u8; 3] = [70, 110, 200];
const FEATURE: [u8; 3] = [255, 220, 40];
/// A contour point this far off its taught place is drawn fully red, mm.
const RED_AT_MM: f64 = 0.15;

pub(super) fn write(folder: &Path, capture: &Capture, m: &Measurement, drawing: &Drawing) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    let red = capture.load(capture.red()?)?;
    let picture = picture(&red, capture.camera.white_level(), m, drawing, 1);
    write_png_rgb(&folder.join(format!("{}.png", m.capture)), &picture)?;
    Ok(())
}

/// The red image, of which `white` is the level of white, with every `shrink` pixels along each side made one.
pub(super) fn picture(
    red: &Image<u16>,
    white: f64,
    m: &Measurement,
    drawing: &Drawing,
    shrink: usize,
) -> Image<[u8; 3]> {
    let (width, height) = (red.width / shrink, red.height / shrink);
    let scale = 255.0 / white / (shrink * shrink) as f64;
    let grey = |x: usize, y: usize| {
        let rows = (y * shrink..(y + 1) * shrink).flat_map(|y| &red.row(y)[x * shrink..(x + 1) * shrink]);
        [(rows.map(|v| f64::from(*v)).sum::<f64>() * scale).min(255.0) as u8; 3]
    };
    let pixels = (0..height).flat_map(|y| (0..width).map(move |x| grey(x, y))).collect();
    let mut picture = Image { width, height, pixels };
    let small = |c: f64| (c + 0.5) / shrink as f64 - 0.5;
    for w in &drawing.regions {
        let last = |from: usize, size: usize, of: usize| ((from + size - 1) / shrink).min(of - 1);
        let (right, bottom) = (last(w.x, w.width, width), last(w.y, w.height, height));
        frame(&mut picture, (w.x / shrink, w.y / shrink), (right, bottom));
    }
    for (p, off) in &drawing.contours {
        let share = (off.abs() / RED_AT_MM).min(1.0);
        dot(&mut picture, small(p.x), small(p.y), [(255.0 * share) as u8, (255.0 * (1.0 - share)) as u8, 0]);
    }
    for pixel in m.features.iter().filter_map(|f| f.pixel) {
        let [x, y] = pixel.map(small);
        for k in -9i32..=9 {
            if k.abs() > 2 {
                dot(&mut picture, x + f64::from(k), y, FEATURE);
                dot(&mut picture, x, y + f64::from(k), FEATURE);
            }
        }
    }
    picture
}

fn dot(picture: &mut Image<[u8; 3]>, x: f64, y: f64, colour: [u8; 3]) {
    let (x, y) = (x.round(), y.round());
    if x >= 0.0 && y >= 0.0 && x < picture.width as f64 && y < picture.height as f64 {
        picture.row_mut(y as usize)[x as usize] = colour;
    }
}

fn frame(picture: &mut Image<[u8; 3]>, (left, top): (usize, usize), (right, bottom): (usize, usize)) {
    for x in left..=right {
        picture.row_mut(top)[x] = REGION;
        picture.row_mut(bottom)[x] = REGION;
    }
    for y in top..=bottom {
        picture.row_mut(y)[left] = REGION;
        picture.row_mut(y)[right] = REGION;
    }
}
