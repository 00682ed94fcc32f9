//! The body's surface from its depth map: one coarse surface of the whole side, then a patch about each feature.
//! In:  depth per pixel, a pose good to a few mm, the taught panel masks. Out: surfaces in camera coordinates, mm.
//! A coarse surface comes first, and patches are held to it: near the panel's border a fit on its own would take
//! tyre or door for the body. Only the panel that carries the features counts: doors and flaps stand otherwise on each body.

use crate::code::Code;
use crate::fringe::{CoordinateMap, DepthMap, Rays, State};
use crate::geometry::{Cell, Local, Point3, Polynomial, Surface, frame};
use crate::lent::{List, side_by_side};
use crate::optics::Lens;
use crate::vehicle::PanelMask;
use nalgebra::{Vector2, Vector3};

/// The panel about a feature.
pub(crate) struct Panel {
    pub(crate) mask: PanelMask,
    /// Where it begins, mm from the origin: patches reach that much wider.
    pub(crate) hole_mm: f64,
}

impl Panel {
    pub(crate) fn new(mask: PanelMask) -> Self {
        Self { hole_mm: mask.hole_mm(), mask }
    }
}

/// A local frame and the panel about it.
pub(crate) struct Site<'a> {
    pub(crate) local: Local<frame::Camera>,
    pub(crate) panel: &'a Panel,
}

impl Site<'_> {
    /// Every how many rows and columns its pixels are looked at.
    fn step(&self) -> usize {
        if self.panel.hole_mm > WIDE_HOLE_MM { 2 } else { 1 }
    }

    /// Of the patches about it, mm.
    pub(crate) fn radii(&self) -> [f64; 3] {
        RADII_MM.map(|r| r + self.panel.hole_mm)
    }
}

/// A hole beyond which every second pixel of every second row is enough for a patch about it, mm.
const WIDE_HOLE_MM: f64 = 30.0;
/// Side of a cell, mm: several pixels, and well below the radius of any flare.
const CELL_MM: f64 = 3.0;
const COARSE_CELL_MM: f64 = 6.0;
/// Patches are held to the coarse surface within this, mm.
const HOLD_MM: f64 = 3.0;
/// Of patches: where coverage is judged, of what is taught, of the widest.
const RADII_MM: [f64; 3] = [45.0, 60.0, 90.0];
/// The widest of them beyond the hole of a flap.
pub(crate) const REACH_MM: f64 = RADII_MM[2];
/// Least share of a patch's pixels with valid depth. On black paint, where the projector mirrors itself, half of
/// them go; a few per cent are enough for a fit, but not to be sure what it is a fit of.
const MIN_COVERAGE: f64 = 0.15;
/// Largest misfit of a patch, rms mm.
const MAX_MISFIT_MM: f64 = 0.25;

/// Why so many pixels are of no use, by what most of those show. `usable` of them are.
pub(crate) fn why_no_depth(states: &[State], usable: usize) -> Code {
    let count = |of: &[State]| states.iter().filter(|s| of.contains(s)).count();
    let most = |n: usize| 2 * n > states.len() - usable;
    if most(count(&[State::Saturated, State::Unordered])) {
        Code::Saturated
    } else if most(count(&[State::NotSine, State::WrongOrder])) {
        Code::PhaseAmbiguity
    } else if most(count(&[State::Valid]).saturating_sub(usable)) {
        Code::NotSmooth // depth there is, but of something else than the body's surface
    } else {
        Code::CoverageLow
    }
}

/// A patch about a feature, and how much of the panel there had depth.
pub(crate) struct Patch {
    pub(crate) surface: Surface<frame::Camera>,
    pub(crate) coverage: f64,
    /// What it was fitted to, in the local frame of the surface.
    pub(crate) cells: List<Cell>,
}

impl Patch {
    /// The patch about another place near its own, from the same cells: for when that place is known better.
    pub(crate) fn moved(&self, local: Local<frame::Camera>, shape: &Shape<'_>) -> Result<Self, Code> {
        let old = &self.surface.local;
        let (turn, shift) = (local.axes.transpose() * old.axes, local.coordinates(old.origin));
        let moved = |c: &Cell| {
            let p = turn * c.uv.push(c.w) + shift;
            Cell { uv: p.xy(), w: p.z, ..*c }
        };
        Self::new(local, List::of(self.cells.iter().map(moved)), self.coverage, shape)
    }

    fn new(local: Local<frame::Camera>, cells: List<Cell>, coverage: f64, shape: &Shape<'_>) -> Result<Self, Code> {
        let surface = shape.fit(local, &cells).ok_or(Code::CoverageLow)?;
        if surface.misfit_mm > MAX_MISFIT_MM {
            return Err(Code::NotSmooth);
        }
        Ok(Self { surface, coverage, cells })
    }
}

/// Sums of one cell.
#[derive(Default, Clone, Copy)]
struct Sums {
    weight: f64,
    u: f64,
    v: f64,
    w: f64,
}

/// The sums of all cells of a patch.
struct CellSums {
    half: i32,
    sums: List<Sums>,
}

impl CellSums {
    /// For points as far from the origin as `reach_mm`, and as much more as a body's height over its plane can make it
    /// look: what lies farther off is no part of the patch.
    fn new(reach_mm: f64) -> Self {
        let half = (1.5 * reach_mm / CELL_MM).ceil() as i32;
        Self { half, sums: List::filled(Sums::default(), (4 * half * half) as usize) }
    }

    fn clear(&mut self) {
        self.sums.fill(Sums::default());
    }

    fn add(&mut self, c: &Vector3<f64>, variance: f64) {
        let [i, j] = cell_index(&c.xy(), CELL_MM).map(|k| k + self.half);
        let inside = 0..2 * self.half;
        if !(inside.contains(&i) && inside.contains(&j)) {
            return;
        }
        let sums = &mut self.sums[(i * 2 * self.half + j) as usize];
        let weight = 1.0 / variance;
        sums.weight += weight;
        sums.u += weight * c.x;
        sums.v += weight * c.y;
        sums.w += weight * c.z;
    }

    /// The cells with any points, by their index.
    fn cells(&self) -> List<Cell> {
        let place = |k: i32| [k / (2 * self.half) - self.half, k % (2 * self.half) - self.half];
        let cell = |(k, s): (i32, &Sums)| {
            let n = s.weight;
            let uv = Vector2::new(s.u / n, s.v / n);
            (n > 0.0).then(|| Cell { index: place(k), uv, w: s.w / n, variance: 1.0 / n })
        };
        List::of((0..).zip(&self.sums).filter_map(cell))
    }
}

fn cell_index(uv: &Vector2<f64>, side: f64) -> [i32; 2] {
    let floor = |v: f64| {
        let cut = v as i32; // towards 0; a call of `floor` per pixel is what some processors have instead
        cut - i32::from(v < f64::from(cut))
    };
    [floor(uv.x / side), floor(uv.y / side)]
}

/// What the pixels of a site's panel have, before there is depth. Every fifth of them is asked.
pub(crate) fn panel_states(
    map: &CoordinateMap,
    rays: &Rays,
    camera: &Lens,
    site: &Site<'_>,
    mut visit: impl FnMut(State),
) {
    panel_pixels(rays, camera, site, site.radii()[0], |i, _, _| {
        if i.is_multiple_of(5) {
            visit(map.pixels[i].state);
        }
    });
}

/// The rays that meet the local plane of `site` within `reach_mm` on its panel, each with its index in the window and
/// its local (u, v) there. About a flap's hole, where a patch is several times as large as at a corner, one of four.
pub(crate) fn panel_pixels(
    rays: &Rays,
    camera: &Lens,
    site: &Site<'_>,
    reach_mm: f64,
    mut visit: impl FnMut(usize, &Vector3<f64>, &Vector2<f64>),
) {
    let Some(centre) = camera.project(&site.local.origin.xyz) else { return };
    let window = rays.window;
    let reach = 1.3 * reach_mm * camera.fx / site.local.origin.xyz.z;
    let range = |centre: f64, first: usize, n: usize| {
        let last = (first + n) as f64;
        let from = (centre - reach).clamp(first as f64, last) as usize;
        from - first..((centre + reach).clamp(first as f64, last) as usize).max(from) - first
    };
    let plane = OnPlane::new(&site.local);
    let columns = range(centre.x, window.x, window.width);
    let step = site.step();
    for y in range(centre.y, window.y, window.height).filter(|y| y.is_multiple_of(step)) {
        let first = y * window.width + columns.start.next_multiple_of(step);
        let rays = rays.part(first..(y * window.width + columns.end).max(first));
        for (i, ray) in (first..).zip(rays).step_by(step) {
            let uv = plane.meet(ray);
            if uv.norm_squared() <= reach_mm * reach_mm && site.panel.mask.contains(&uv) {
                visit(i, &ray.push(1.0), &uv);
            }
        }
    }
}

/// Where rays meet a local plane.
pub(crate) struct OnPlane {
    u: Vector3<f64>,
    v: Vector3<f64>,
    normal: Vector3<f64>,
    /// Of the origin, along u, v and the normal.
    origin: Vector3<f64>,
}

impl OnPlane {
    pub(crate) fn new(local: &Local<frame::Camera>) -> Self {
        let [u, v, normal] = [0, 1, 2].map(|k| Vector3::from(local.axes.column(k)));
        Self { u, v, normal, origin: local.axes.transpose() * local.origin.xyz }
    }

    /// Local (u, v), mm, where the ray (x, y, 1) meets the plane.
    pub(crate) fn meet(&self, ray: &Vector2<f64>) -> Vector2<f64> {
        let along = |axis: &Vector3<f64>| axis.x * ray.x + axis.y * ray.y + axis.z;
        let s = self.origin.z / along(&self.normal);
        Vector2::new(s * along(&self.u) - self.origin.x, s * along(&self.v) - self.origin.y)
    }
}

/// Points that are enough for a cell of the coarse surface.
const COARSE_POINTS: f64 = 25.0;
/// Cells of the coarse surface to each side of its middle: more than any camera sees of a body at this distance.
const COARSE_CELLS: i32 = 128;

/// The coarse surface: a quartic over the panel about all features, in the frame of the first with the origin
/// amid them. `None` where too little of it has depth.
pub(crate) fn coarse(map: &DepthMap<'_>, camera: &Lens, sites: &[Site<'_>]) -> Option<Surface<frame::Camera>> {
    let middle = sites.iter().map(|s| s.local.origin.xyz).sum::<Vector3<f64>>() / sites.len() as f64;
    let local = Local { origin: Point3::new(middle), axes: sites.first()?.local.axes };
    let side = 2 * COARSE_CELLS as usize;
    let points = side_by_side(sites.len(), |k| {
        let site = &sites[k];
        let mut points: List<(u32, Vector3<f64>, f64)> = List::new(); // cell, local coordinates, variance
        let pixels_of_cell = (COARSE_CELL_MM * camera.fx / middle.z / site.step() as f64).powi(2);
        let (every, mut number) = ((pixels_of_cell / COARSE_POINTS) as usize, 0usize);
        panel_pixels(map.rays, camera, site, site.radii()[2], |i, ray, _| {
            let depth = &map.pixels[i];
            number += 1;
            if number.is_multiple_of(every.max(1)) && depth.state == State::Valid {
                let c = local.coordinates(Point3::new(ray * f64::from(depth.z)));
                let [i, j] = cell_index(&c.xy(), COARSE_CELL_MM).map(|k| k + COARSE_CELLS);
                let inside = 0..2 * COARSE_CELLS;
                if inside.contains(&i) && inside.contains(&j) {
                    points.push((i as u32 * side as u32 + j as u32, c, f64::from(depth.sigma).powi(2)));
                }
            }
        });
        points
    });
    // sorted by counting: `end[k]` is where the points of cell k end
    let mut end = List::filled(0u32, side * side + 1);
    points.iter().flatten().for_each(|p| end[p.0 as usize + 1] += 1);
    for k in 1..end.len() {
        end[k] += end[k - 1];
    }
    let mut sorted = List::filled((Vector3::zeros(), 0.0), end[side * side] as usize);
    for (k, c, variance) in points.iter().flatten() {
        sorted[end[*k as usize] as usize] = (*c, *variance);
        end[*k as usize] += 1;
    }
    let mut cells = List::new();
    let mut rest = &mut sorted[..];
    let mut start = 0;
    for (k, &end) in (0..).zip(&end[..side * side]) {
        let points;
        (points, rest) = rest.split_at_mut((end - start) as usize);
        start = end;
        if points.len() >= 4 {
            // the median in w, so that a few wild pixels do not move the cell
            let middle = points.len() / 2;
            let (c, variance) = *points.select_nth_unstable_by(middle, |a, b| a.0.z.total_cmp(&b.0.z)).1;
            let index = [k / (2 * COARSE_CELLS), k % (2 * COARSE_CELLS)].map(|i| i - COARSE_CELLS);
            cells.push(Cell { index, uv: c.xy(), w: c.z, variance: variance + 0.05 * 0.05 });
        }
    }
    Surface::fit(local, &cells, 4, f64::INFINITY)
}

/// What a patch may be.
pub(crate) enum Shape<'a> {
    /// Anything smooth, within this radius, mm.
    Smooth(f64),
    /// What was taught, within the radius (mm) it was taught for.
    Taught(&'a Polynomial, f64),
}

impl Shape<'_> {
    fn fit(&self, local: Local<frame::Camera>, cells: &[Cell]) -> Option<Surface<frame::Camera>> {
        match self {
            Self::Smooth(radius_mm) => Surface::fit_smooth(local, cells, *radius_mm),
            Self::Taught(shape, radius_mm) => Surface::fit_shape(local, cells, shape, *radius_mm),
        }
    }
}

/// Flap pixels nearer to the gap than this are not believed, mm.
const FLAP_MARGIN_MM: f64 = 5.0;

/// How far the surface over a flap's hole lies above the panel's polynomial at `uv`, mm: the polynomial was fitted
/// around the hole only. The flap has the panel's curvature, but stands a little proud or sunk; so its shape is
/// taken from its own depth, and its height from where it meets the panel. `None` where the flap has too little depth.
pub(crate) fn bridge(
    map: &DepthMap<'_>,
    camera: &Lens,
    site: &Site<'_>,
    panel: &Surface<frame::Camera>,
    uv: &Vector2<f64>,
) -> Option<f64> {
    let everywhere = PanelMask::new(site.panel.mask.cell_mm, site.panel.mask.half, |_| true);
    let everywhere = Panel { mask: everywhere, hole_mm: 0.0 };
    let flap_mm = site.panel.hole_mm - FLAP_MARGIN_MM;
    let mut sums = CellSums::new(flap_mm);
    let outward: Vector3<f64> = site.local.axes.column(2).into();
    let flap = Site { local: site.local, panel: &everywhere };
    panel_pixels(map.rays, camera, &flap, flap_mm, |i, ray, _| {
        let depth = &map.pixels[i];
        let c = site.local.coordinates(Point3::new(ray * f64::from(depth.z)));
        let w = c.z - panel.polynomial.height(&c.xy());
        if depth.state == State::Valid && w.abs() < HOLD_MM {
            let variance = (f64::from(depth.sigma) * outward.dot(ray)).powi(2);
            sums.add(&Vector3::new(c.x, c.y, w), variance);
        }
    });
    let cells = sums.cells();
    let flap = Surface::fit(site.local, &cells, 4, flap_mm)?;
    let ring = (0..36).map(|k| {
        let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 36.0).sin_cos();
        flap.polynomial.height(&(Vector2::new(cos, sin) * site.panel.hole_mm))
    });
    Some(flap.polynomial.height(uv) - ring.sum::<f64>() / 36.0)
}

/// What is the same of a pixel about a feature in every pass.
#[derive(Clone, Copy)]
struct Sample {
    /// (x, y, 1).
    ray: Vector2<f64>,
    z: f32,
    sigma: f32,
    state: State,
    /// Whether it lies on the coarse surface.
    held: bool,
}

/// The pixels about a feature, taken once for all passes.
pub(crate) struct Samples(List<Sample>);

impl Samples {
    /// Those on the panel of `site` within `reach_mm`: with a grown panel and a longer reach than the widest patch's, what
    /// a site that stands otherwise can ask for.
    pub(crate) fn new(
        map: &DepthMap<'_>,
        camera: &Lens,
        site: &Site<'_>,
        reach_mm: f64,
        coarse: &Surface<frame::Camera>,
    ) -> Self {
        let mut samples = List::new();
        panel_pixels(map.rays, camera, site, reach_mm, |i, ray, _| {
            let depth = &map.pixels[i];
            let held = depth.state == State::Valid && {
                let c = coarse.local.coordinates(Point3::new(ray * f64::from(depth.z)));
                (c.z - coarse.polynomial.height(&c.xy())).abs() <= HOLD_MM
            };
            samples.push(Sample { ray: ray.xy(), z: depth.z, sigma: depth.sigma, state: depth.state, held });
        });
        Self(samples)
    }

    /// The patch about `site`.
    pub(crate) fn patch(&self, site: &Site<'_>, shape: &Shape<'_>) -> Result<Patch, Code> {
        let (mut states, mut valid) = (List::new(), 0usize);
        let radii = site.radii();
        let mut sums = CellSums::new(radii[2]);
        let mut used = List::new();
        let outward: Vector3<f64> = site.local.axes.column(2).into();
        let plane = OnPlane::new(&site.local);
        for sample in &self.0 {
            let uv = plane.meet(&sample.ray);
            let square = uv.norm_squared();
            if square > radii[2] * radii[2] || !site.panel.mask.contains(&uv) {
                continue;
            }
            let near = square <= radii[0] * radii[0];
            states.extend(near.then_some(sample.state));
            if !sample.held {
                continue;
            }
            valid += usize::from(near);
            let ray = sample.ray.push(1.0);
            let c = site.local.coordinates(Point3::new(ray * f64::from(sample.z)));
            let variance = (f64::from(sample.sigma) * outward.dot(&ray)).powi(2);
            sums.add(&c, variance);
            used.push((c, variance));
        }
        let coverage = valid as f64 / states.len().max(1) as f64;
        if coverage < MIN_COVERAGE {
            return Err(why_no_depth(&states, valid));
        }
        let first = shape.fit(site.local, &sums.cells()).ok_or(Code::CoverageLow)?;
        // once more without the pixels that stand out: edge pixels that mix two depths, fringe orders gone wrong
        sums.clear();
        for (c, variance) in &used {
            let off = c.z - first.polynomial.height(&c.xy());
            if off * off < 16.0 * variance + 0.15 * 0.15 {
                sums.add(c, *variance);
            }
        }
        Patch::new(site.local, sums.cells(), coverage, shape)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;
    use std::collections::BTreeMap;

    #[test]
    fn a_patch_about_another_place_is_the_same_surface() {
        let axes = nalgebra::Rotation3::from_euler_angles(3.0, 0.2, -0.1);
        let here = Local { origin: Point3::new(Vector3::new(-150.0, 120.0, 790.0)), axes: axes.into_inner() };
        let turned = axes * nalgebra::Rotation3::from_euler_angles(0.002, -0.003, 0.004);
        let there = Local { origin: here.point(&Vector3::new(0.3, -0.4, 0.2)), axes: turned.into_inner() };
        let flat = Polynomial::from_coefficients(40.0, &[0.0; 3]).expect("an order");
        let shape = Shape::Taught(&flat, 60.0);
        let index = (-15..15).flat_map(|i| (-15..15).map(move |j| [i, j]));
        let cell = |index: [i32; 2]| {
            let uv = Vector2::from(index.map(|k| CELL_MM * (f64::from(k) + 0.5)));
            Cell { index, uv, w: 0.1 + 1e-3 * uv.x - 2e-3 * uv.y, variance: 1e-4 }
        };
        let patch = Patch::new(here, List::of(index.map(cell)), 1.0, &shape).expect("a plane");
        let moved = patch.moved(there, &shape).expect("the same plane");
        for uv in [Vector2::new(0.0, 0.0), Vector2::new(30.0, -20.0), Vector2::new(-25.0, 40.0)] {
            let on = here.coordinates(moved.surface.point(&uv));
            assert!((on.z - patch.surface.polynomial.height(&on.xy())).abs() < 1e-6, "{on}");
        }
    }

    #[test]
    fn sums_in_a_grid_are_those_of_a_map_of_cells() {
        let mut noise = Noise::new(6);
        let (mut grid, mut map) = (CellSums::new(30.0), BTreeMap::<[i32; 2], [f64; 4]>::new());
        for _ in 0..3000 {
            let c = Vector3::new(12.0 * noise.gauss(), 12.0 * noise.gauss(), noise.gauss());
            let variance = 0.5 + noise.gauss().abs();
            grid.add(&c, variance);
            let index = [(c.x / CELL_MM).floor() as i32, (c.y / CELL_MM).floor() as i32];
            let sums = map.entry(index).or_default();
            for (sum, term) in sums.iter_mut().zip([1.0, c.x, c.y, c.z]) {
                *sum += term / variance;
            }
        }
        let beyond = |index: &[i32; 2]| index.iter().any(|k| !(-15..15).contains(k));
        map.retain(|index, _| !beyond(index));
        let cells = grid.cells();
        assert_eq!(cells.iter().map(|c| c.index).collect::<Vec<_>>(), map.keys().copied().collect::<Vec<_>>());
        for (cell, [n, u, v, w]) in cells.iter().zip(map.values()) {
            let off = [cell.uv.x - u / n, cell.uv.y - v / n, cell.w - w / n, cell.variance - 1.0 / n];
            assert!(off.iter().all(|d| d.abs() < 1e-12), "{cell:?}");
        }
        grid.clear();
        assert!(grid.cells().is_empty());
    }

    #[test]
    fn rays_meet_the_plane_where_geometry_says() {
        let axes = nalgebra::Rotation3::from_euler_angles(3.0, 0.2, -0.1).into_inner();
        let local = Local { origin: Point3::new(Vector3::new(-150.0, 120.0, 790.0)), axes };
        for uv in [Vector2::new(40.0, -70.0), Vector2::zeros()] {
            let p = local.point(&uv.push(0.0)).xyz;
            assert!((OnPlane::new(&local).meet(&(p.xy() / p.z)) - uv).amax() < 1e-9);
        }
    }
}
