//! Which pixels of the red image are the panel that carries the features: bright body bounded by dark gaps.
//! In:  the red image without glints, the clicks. Out: a mask of the panel. Only teaching needs it: what it finds
//! is remembered in millimetres. Not here: depth.

use crate::image::{Image, Window};
use crate::optics::Pixel;
use std::collections::{BTreeMap, BTreeSet};

/// Brighter than this share of the body's level about it is panel; a gap blurred to three pixels is well below.
const BRIGHT: f32 = 0.72;

/// The panel: the connected bright area that touches most of the clicks within `reach` px; of equal ones the one
/// with more of the clicks' bounding box. `level` is the body's grey level about each pixel. `None` if no bright
/// area comes near two clicks.
pub(crate) fn panel_mask(red: &Image<f32>, level: &Image<f32>, clicks: &[Pixel], reach: f64) -> Option<Image<bool>> {
    let (width, height) = (red.width, red.height);
    let bright: Vec<bool> = red.pixels.iter().zip(&level.pixels).map(|(v, l)| *v > BRIGHT * l && *l > 0.0).collect();
    // a pixel counts with its neighbours, so that one bright pixel is no bridge across a gap
    let solid = |x: usize, y: usize| {
        x > 0
            && y > 0
            && x + 1 < width
            && y + 1 < height
            && (y - 1..=y + 1).all(|j| (x - 1..=x + 1).all(|i| bright[j * width + i]))
    };
    let mut labels = vec![0u32; width * height];
    let mut count = 0;
    let mut stack = Vec::new();
    for y in 0..height {
        for x in 0..width {
            if labels[y * width + x] == 0 && solid(x, y) {
                count += 1;
                labels[y * width + x] = count;
                stack.push((x, y));
                while let Some((x, y)) = stack.pop() {
                    for (i, j) in [(x + 1, y), (x.wrapping_sub(1), y), (x, y + 1), (x, y.wrapping_sub(1))] {
                        if i < width && j < height && labels[j * width + i] == 0 && solid(i, j) {
                            labels[j * width + i] = count;
                            stack.push((i, j));
                        }
                    }
                }
            }
        }
    }
    let mut touched: BTreeMap<u32, usize> = BTreeMap::new();
    for click in clicks {
        let mut near = BTreeSet::new();
        let Some(w) =
            Window::clipped(click.x - reach, click.y - reach, click.x + reach, click.y + reach, width, height)
        else {
            continue;
        };
        for y in w.y..w.y + w.height {
            for x in w.x..w.x + w.width {
                let label = labels[y * width + x];
                if label > 0 && (Pixel::new(x as f64, y as f64) - click).norm() <= reach {
                    near.insert(label);
                }
            }
        }
        for label in near {
            *touched.entry(label).or_default() += 1;
        }
    }
    let range = |f: fn(&Pixel) -> f64, n: usize| {
        let values = || clicks.iter().map(f);
        let last = (n - 1) as f64;
        let (low, high) =
            (values().fold(last, f64::min).clamp(0.0, last), values().fold(0.0, f64::max).clamp(0.0, last));
        low as usize..=high as usize
    };
    let mut area: BTreeMap<u32, usize> = BTreeMap::new();
    for y in range(|p| p.y, height) {
        for x in range(|p| p.x, width) {
            *area.entry(labels[y * width + x]).or_default() += 1;
        }
    }
    let (panel, _) = touched
        .iter()
        .filter(|(_, n)| **n >= 2)
        .max_by_key(|(label, n)| (**n, area.get(label).copied().unwrap_or(0)))?;
    let mut mask = Image::filled(width, height, false);
    for y in 0..height {
        for x in 0..width {
            if labels[y * width + x] == *panel {
                // what solidity took off
                for j in y - 1..=y + 1 {
                    mask.row_mut(j)[x - 1..=x + 1].fill(true);
                }
            }
        }
    }
    Some(mask)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_panel_is_what_lies_between_the_clicks_not_the_door_nor_the_flap() {
        let mut red = Image::filled(200, 150, 100.0);
        for y in 0..150 {
            for x in 0..200 {
                let gap = (40..43).contains(&x); // door | panel
                let ring = ((x as f64 - 120.0).hypot(y as f64 - 60.0) - 30.0).abs() < 1.5;
                let arch = y > 110;
                if gap || ring || arch {
                    red.row_mut(y)[x] = 8.0;
                }
            }
        }
        let level = Image::filled(200, 150, 100.0);
        let clicks = [Pixel::new(43.0, 110.0), Pixel::new(120.0, 60.0), Pixel::new(150.0, 110.0)];
        let mask = panel_mask(&red, &level, &clicks, 6.0).expect("a panel");
        assert!(mask.at(60, 60) && mask.at(180, 100), "the panel");
        assert!(!mask.at(20, 60) && !mask.at(120, 60) && !mask.at(120, 130), "door, flap, wheelhouse");
        assert_eq!(panel_mask(&Image::filled(200, 150, 0.0), &Image::filled(200, 150, 0.0), &clicks, 6.0), None);
    }
}
