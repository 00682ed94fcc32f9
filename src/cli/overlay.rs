//! The red image with what a measurement saw drawn in: regions, contours by their residual, features.
//! In: a capture and its result. Out: one RGB PNG per capture.

use crate::Capture;
use crate::image::{Image, Window, write_png_rgb};
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
    let scale = 255.0 / capture.camera.white_level();
    let grey = |v: &u16| [(f64::from(*v) * scale).min(255.0) as u8; 3];
    let mut picture = Image { width: red.width, height: red.height, pixels: red.pixels.iter().map(grey).collect() };
    for region in &drawing.regions {
        frame(&mut picture, region);
    }
    for (p, off) in &drawing.contours {
        let share = (off.abs() / RED_AT_MM).min(1.0);
        dot(&mut picture, p.x, p.y, [(255.0 * share) as u8, (255.0 * (1.0 - share)) as u8, 0]);
    }
    for pixel in m.features.iter().filter_map(|f| f.pixel) {
        for k in -9i32..=9 {
            if k.abs() > 2 {
                dot(&mut picture, pixel[0] + f64::from(k), pixel[1], FEATURE);
                dot(&mut picture, pixel[0], pixel[1] + f64::from(k), FEATURE);
            }
        }
    }
    write_png_rgb(&folder.join(format!("{}.png", m.capture)), &picture)?;
    Ok(())
}

fn dot(picture: &mut Image<[u8; 3]>, x: f64, y: f64, colour: [u8; 3]) {
    let (x, y) = (x.round(), y.round());
    if x >= 0.0 && y >= 0.0 && x < picture.width as f64 && y < picture.height as f64 {
        picture.row_mut(y as usize)[x as usize] = colour;
    }
}

fn frame(picture: &mut Image<[u8; 3]>, w: &Window) {
    for x in w.x..w.x + w.width {
        picture.row_mut(w.y)[x] = REGION;
        picture.row_mut(w.y + w.height - 1)[x] = REGION;
    }
    for y in w.y..w.y + w.height {
        picture.row_mut(y)[w.x] = REGION;
        picture.row_mut(y)[w.x + w.width - 1] = REGION;
    }
}
