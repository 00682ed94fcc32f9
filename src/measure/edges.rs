//! The red image's edges, as rays. In: the red image, where to look. Out: edgels with the rays through them.
//! Not here: which of them belong to a feature, how far away they are.

use super::TYPICAL_DISTANCE_MM;
use crate::contour::{EdgeFilter, Edgel, cross_level, find_edges};
use crate::fringe::NoiseLaw;
use crate::geometry::robust;
use crate::image::{Image, Window};
use crate::optics::{Lens, Pixel};
use nalgebra::Vector3;
use std::collections::HashMap;

/// An edgel with its ray, and the ray through the point 1 px towards bright; camera frame, z = 1.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EdgeRay {
    pub(crate) edgel: Edgel,
    /// How soft it is with those beside it, px per unit of its contrast.
    pub(crate) softness_px: f64,
    pub(crate) ray: Vector3<f64>,
    pub(crate) bright: Vector3<f64>,
}

/// Side of the cells that the body's grey level is taken from, as a share of the image's width.
const LEVEL_CELLS: usize = 40;

/// The image with everything brighter than the body about it cut off: hems glint, and a glint beside a gap moves
/// the gap's edge. And the body's level: the brightest of the medians of neighbouring cells, interpolated.
pub(crate) fn without_glints(image: &Image<f32>) -> (Image<f32>, Image<f32>) {
    let side = (image.width / LEVEL_CELLS).max(8);
    let (columns, rows) = (image.width.div_ceil(side), image.height.div_ceil(side));
    let mut medians = Image::filled(columns, rows, 0f32);
    let mut values = Vec::with_capacity(side * side);
    for j in 0..rows {
        for i in 0..columns {
            values.clear();
            for y in j * side..((j + 1) * side).min(image.height) {
                values.extend_from_slice(&image.row(y)[i * side..((i + 1) * side).min(image.width)]);
            }
            let middle = values.len() / 2;
            medians.row_mut(j)[i] = *values.select_nth_unstable_by(middle, f32::total_cmp).1;
        }
    }
    let level = |i: usize, j: usize| {
        let around = (j.saturating_sub(1)..=(j + 1).min(rows - 1))
            .flat_map(|j| (i.saturating_sub(1)..=(i + 1).min(columns - 1)).map(move |i| (i, j)));
        around.map(|(i, j)| medians.at(i, j)).fold(0.0, f32::max)
    };
    let mut levels = Image::filled(columns, rows, 0f32);
    for j in 0..rows {
        for i in 0..columns {
            levels.row_mut(j)[i] = level(i, j);
        }
    }
    let (mut out, mut body) = (image.clone(), Image::filled(image.width, image.height, 0f32));
    let place = |p: usize, n: usize| {
        let c = ((p as f32 + 0.5) / side as f32 - 0.5).clamp(0.0, (n - 1) as f32);
        let first = (c as usize).min(n.saturating_sub(2));
        (first, (first + 1).min(n - 1), c - first as f32)
    };
    for y in 0..image.height {
        let (j0, j1, t) = place(y, rows);
        for (x, (value, level)) in out.row_mut(y).iter_mut().zip(body.row_mut(y)).enumerate() {
            let (i0, i1, s) = place(x, columns);
            let top = levels.at(i0, j0) * (1.0 - s) + levels.at(i1, j0) * s;
            let bottom = levels.at(i0, j1) * (1.0 - s) + levels.at(i1, j1) * s;
            *level = top * (1.0 - t) + bottom * t;
            *value = value.min(*level);
        }
    }
    (out, body)
}

/// Hems and gaps are within this of an edge, mm; and never fewer px, for the image's blur.
const REACH_MM: f64 = 3.3;
const REACH_PX: f64 = 6.0;

fn reach_px(camera: &Lens) -> f64 {
    (REACH_MM * camera.fx / TYPICAL_DISTANCE_MM).max(REACH_PX)
}

/// Softness is the same along an edge over so many px, of the same direction to within this cosine.
const NEIGHBOURS_PX: f64 = 8.0;
const SAME_EDGE: f64 = 0.9;

/// The edges inside `windows` of an image already without glints.
pub(crate) fn edge_rays(
    image: &Image<f32>,
    level: &Image<f32>,
    windows: &[Window],
    noise: &NoiseLaw,
    camera: &Lens,
) -> Vec<EdgeRay> {
    let mut out = Vec::new();
    for window in windows {
        let contrast = 0.1 * f64::from(image.pixels[image.pixels.len() / 2]).max(20.0);
        let filter = EdgeFilter { start: (10.0, contrast), keep: (5.0, 0.4 * contrast), ..EdgeFilter::default() };
        let found = find_edges(image, *window, &filter, |level| noise.variance(level));
        let body = |p: &Pixel| {
            let clamp = |v: f64, n: usize| (v.round().max(0.0) as usize).min(n - 1);
            f64::from(level.at(clamp(p.x, level.width), clamp(p.y, level.height)))
        };
        let crossings = cross_level(image, &found, reach_px(camera), body, |level| noise.variance(level));
        let soft = softness(&crossings);
        out.extend(crossings.into_iter().zip(soft).filter_map(|(edgel, soft)| {
            let bright: Pixel = edgel.position + edgel.normal;
            Some(EdgeRay { edgel, softness_px: soft, ray: camera.ray(&edgel.position)?, bright: camera.ray(&bright)? })
        }));
    }
    out
}

/// The softness of each edge: the median of those within [`NEIGHBOURS_PX`] along it, as a single one is too noisy.
fn softness(edgels: &[Edgel]) -> Vec<f64> {
    let cell = |e: &Edgel| ((e.position.x / NEIGHBOURS_PX) as i64, (e.position.y / NEIGHBOURS_PX) as i64);
    let mut cells: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    for (i, e) in edgels.iter().enumerate() {
        cells.entry(cell(e)).or_default().push(i);
    }
    let beside =
        |e: &Edgel, o: &Edgel| (o.position - e.position).norm() <= NEIGHBOURS_PX && o.normal.dot(&e.normal) > SAME_EDGE;
    let mut values = Vec::new();
    let mut of = |e: &Edgel| {
        values.clear();
        let (x, y) = cell(e);
        let around = (0..9).filter_map(|k| cells.get(&(x + k % 3 - 1, y + k / 3 - 1))).flatten();
        values.extend(around.map(|&j| &edgels[j]).filter(|o| beside(e, o)).map(|o| o.softness));
        robust::median(&mut values)
    };
    edgels.iter().map(&mut of).collect()
}
