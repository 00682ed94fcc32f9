//! The red image's edges, as rays. In: the red image, where to look. Out: edgels with the rays through them.
//! Not here: which of them belong to a feature, how far away they are.

use super::TYPICAL_DISTANCE_MM;
use crate::contour::{Buckets, EdgeFilter, Edgel, cross_level, find_edges};
use crate::fringe::NoiseLaw;
use crate::geometry::robust;
use crate::image::{Image, Window};
use crate::lent::{Lent, List, side_by_side};
use crate::optics::{Lens, Pixel};
use nalgebra::Vector3;

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

/// The body's grey level over an image: the brightest of the medians of neighbouring cells, interpolated.
pub(crate) struct Levels {
    side: usize,
    cells: Lent<Image<f32>>,
}

impl Levels {
    pub(crate) fn new(image: &Image<f32>) -> Self {
        let side = (image.width / LEVEL_CELLS).max(8);
        let (columns, rows) = (image.width.div_ceil(side), image.height.div_ceil(side));
        let medians = side_by_side(rows, |j| {
            let mut values = List::new();
            List::of((0..columns).map(|i| {
                values.clear();
                for y in j * side..((j + 1) * side).min(image.height) {
                    values.extend_from_slice(&image.row(y)[i * side..((i + 1) * side).min(image.width)]);
                }
                let middle = values.len() / 2;
                *values.select_nth_unstable_by(middle, f32::total_cmp).1
            }))
        });
        let level = |i: usize, j: usize| {
            let around = (j.saturating_sub(1)..=(j + 1).min(rows - 1))
                .flat_map(|j| (i.saturating_sub(1)..=(i + 1).min(columns - 1)).map(move |i| (i, j)));
            around.map(|(i, j)| medians[j][i]).fold(0.0, f32::max)
        };
        let mut cells = Image::lent(columns, rows, 0f32);
        for j in 0..rows {
            for i in 0..columns {
                cells.row_mut(j)[i] = level(i, j);
            }
        }
        Self { side, cells }
    }

    /// The body's level where there is as much brighter as darker.
    fn median(&self) -> f64 {
        robust::median(&mut List::of(self.cells.pixels.iter().map(|v| f64::from(*v))))
    }

    /// The part of `image` in `window` with everything brighter than the body about it cut off: hems glint, and a
    /// glint beside a gap moves the gap's edge. And the body's level there.
    pub(crate) fn without_glints(&self, image: &Image<f32>, window: Window) -> [Lent<Image<f32>>; 2] {
        let place = |p: usize, n: usize| {
            let c = ((p as f32 + 0.5) / self.side as f32 - 0.5).clamp(0.0, (n - 1) as f32);
            let first = (c as usize).min(n.saturating_sub(2));
            (first, (first + 1).min(n - 1), c - first as f32)
        };
        let Window { x, y, width, height } = window;
        let (cells, columns) = (&self.cells, self.cells.width);
        let [mut out, mut body] = [(); 2].map(|()| Image::lent(width, height, 0f32));
        for row in 0..height {
            let (j0, j1, t) = place(y + row, cells.height);
            let (top, bottom) = (cells.row(j0), cells.row(j1));
            let raw = &image.row(y + row)[x..x + width];
            let to = out.row_mut(row).iter_mut().zip(body.row_mut(row));
            for (column, ((value, level), raw)) in (x..).zip(to.zip(raw)) {
                let (i0, i1, s) = place(column, columns);
                let top = top[i0] * (1.0 - s) + top[i1] * s;
                let bottom = bottom[i0] * (1.0 - s) + bottom[i1] * s;
                *level = top * (1.0 - t) + bottom * t;
                *value = raw.min(*level);
            }
        }
        [out, body]
    }
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

/// An edge begins with this share of the body's level per px, which blur sets, or per mm on the body, which a wide hem sets
/// where pixels are fine: whichever is less.
const LEAST_SLOPE: [f64; 2] = [0.1, 0.18];
/// Smoothing before edges are looked for, mm on the body and never less than the filter's own: a hem that fades over many
/// fine pixels would have several maxima of slope side by side.
const SMOOTHING_MM: f64 = 0.39;

/// Pixels beyond a window that its edges' profiles and gradients may reach, besides the profiles' own reach.
const PAD_PX: usize = 10;

/// The edges inside each of `windows`; glints do not count.
pub(crate) fn edge_rays(
    image: &Image<f32>,
    windows: &[Window],
    noise: &NoiseLaw,
    camera: &Lens,
) -> List<List<EdgeRay>> {
    let levels = Levels::new(image);
    let contrast = levels.median().max(20.0) * LEAST_SLOPE[0].min(LEAST_SLOPE[1] * TYPICAL_DISTANCE_MM / camera.fx);
    let plain = EdgeFilter::default();
    let sigma = plain.sigma.max(SMOOTHING_MM * camera.fx / TYPICAL_DISTANCE_MM);
    let filter = EdgeFilter { sigma, start: (10.0, contrast), keep: (5.0, 0.4 * contrast) };
    let reach = reach_px(camera);
    side_by_side(windows.len(), |k| {
        let (window, pad) = (&windows[k], reach.ceil() as usize + PAD_PX);
        let (x, y) = (window.x.saturating_sub(pad), window.y.saturating_sub(pad));
        let (right, bottom) = (window.x + window.width + pad, window.y + window.height + pad);
        let around = Window { x, y, width: right.min(image.width) - x, height: bottom.min(image.height) - y };
        let [plain, level] = levels.without_glints(image, around);
        let found = find_edges(&plain, Window { x: window.x - x, y: window.y - y, ..*window }, &filter, |level| {
            noise.variance(level)
        });
        let body = |p: &Pixel| {
            let clamp = |v: f64, n: usize| (v.round().max(0.0) as usize).min(n - 1);
            f64::from(level.at(clamp(p.x, level.width), clamp(p.y, level.height)))
        };
        let crossings = cross_level(&plain, &found, reach, body, |level| noise.variance(level));
        let corner = Pixel::new(x as f64, y as f64);
        let soft = softness(&crossings);
        let ray = |(edgel, softness_px): (&Edgel, &f64)| {
            let (edgel, softness_px) = (Edgel { position: edgel.position + corner, ..*edgel }, *softness_px);
            let bright: Pixel = edgel.position + edgel.normal;
            Some(EdgeRay { edgel, softness_px, ray: camera.ray(&edgel.position)?, bright: camera.ray(&bright)? })
        };
        List::of(crossings.iter().zip(&soft).filter_map(ray))
    })
}

/// The softness of each edge: the median of those within [`NEIGHBOURS_PX`] along it, as a single one is too noisy.
fn softness(edgels: &[Edgel]) -> List<f64> {
    let places = Buckets::new(edgels.iter().map(|e| e.position), NEIGHBOURS_PX);
    let beside =
        |e: &Edgel, o: &Edgel| (o.position - e.position).norm() <= NEIGHBOURS_PX && o.normal.dot(&e.normal) > SAME_EDGE;
    let mut values = List::new();
    List::of(edgels.iter().map(|e| {
        values.clear();
        let around = places.near(e.position, NEIGHBOURS_PX).map(|j| &edgels[j]);
        values.extend(around.filter(|o| beside(e, o)).map(|o| o.softness));
        robust::median(&mut values)
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    #[test]
    fn edges_of_a_window_are_those_of_the_whole_image_there() {
        let mut noise = Noise::new(8);
        let mut image = Image::filled(400, 300, 0f32);
        for (i, v) in image.pixels.iter_mut().enumerate() {
            let (x, y) = ((i % 400) as f64, (i / 400) as f64);
            let off = (x - 200.0).hypot(y - 150.0) - 90.0;
            let gap = 1.0 - (-(off / 2.5).powi(4)).exp();
            *v = ((30.0 + 0.2 * x) * gap + 8.0 + noise.gauss()) as f32;
        }
        let lens = Lens { width: 400, height: 300, fx: 700.0, fy: 700.0, cx: 199.5, cy: 149.5, distortion: [0.0; 5] };
        let law = NoiseLaw { gain: 0.0, variance0: 1.0, black: 0.0 };
        let window = Window { x: 180, y: 40, width: 150, height: 60 };
        let found = edge_rays(&image, &[Window::whole(400, 300), window], &law, &lens);
        // the crossing may lie outside though its edge was found inside
        let well_inside = |e: &&EdgeRay| {
            let p = e.edgel.position - Pixel::new(window.x as f64, window.y as f64);
            p.x > 8.0 && p.y > 8.0 && p.x < window.width as f64 - 8.0 && p.y < window.height as f64 - 8.0
        };
        let [whole, part] = [0, 1].map(|k| found[k].iter().filter(well_inside).collect::<Vec<_>>());
        assert!(whole.len() == part.len() && whole.len() > 100, "{} {}", whole.len(), part.len());
        for (a, b) in whole.iter().zip(&part) {
            assert!((a.edgel.position - b.edgel.position).amax() < 1e-3 && (a.ray - b.ray).amax() < 1e-6);
        }
    }
}
