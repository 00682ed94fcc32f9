//! The body's surface from its depth map: one coarse surface of the whole side, then a patch about each feature.
//! In:  depth per pixel, a pose good to a few mm, the taught panel masks. Out: surfaces in camera coordinates, mm.
//! A coarse surface comes first, and patches are held to it: near the panel's border a fit on its own would take
//! tyre or door for the body. Only the panel that carries the features counts: doors and flaps stand otherwise on each body.

use crate::code::Code;
use crate::fringe::{CoordinateMap, DepthMap, State};
use crate::geometry::{Cell, Local, Point3, Polynomial, Surface, frame};
use crate::optics::{Lens, Pixel};
use crate::vehicle::PanelMask;
use nalgebra::{Vector2, Vector3};
use std::collections::BTreeMap;

/// A local frame and the panel about it.
pub(crate) struct Site<'a> {
    pub(crate) local: Local<frame::Camera>,
    pub(crate) panel: &'a PanelMask,
    /// Where the panel begins, mm from the origin: patches reach that much wider.
    pub(crate) hole_mm: f64,
}

impl<'a> Site<'a> {
    pub(crate) fn new(local: Local<frame::Camera>, panel: &'a PanelMask) -> Self {
        Self { local, panel, hole_mm: panel.hole_mm() }
    }

    fn radii(&self) -> [f64; 4] {
        RADII_MM.map(|r| r + self.hole_mm)
    }
}

/// Side of a cell, mm: several pixels, and well below the radius of any flare.
const CELL_MM: f64 = 3.0;
const COARSE_CELL_MM: f64 = 6.0;
/// Patches are held to the coarse surface within this, mm.
const HOLD_MM: f64 = 3.0;
/// What a patch may be made of.
const ORDERS: std::ops::RangeInclusive<usize> = 2..=5;
const RADII_MM: [f64; 4] = [30.0, 45.0, 60.0, 90.0];
/// The widest of them beyond the hole of a flap.
pub(crate) const REACH_MM: f64 = RADII_MM[3];
/// Least share of a patch's pixels with valid depth. On black paint, where the projector mirrors itself, half of
/// them go; a few per cent are enough for a fit, but not to be sure what it is a fit of.
const MIN_COVERAGE: f64 = 0.15;
/// Largest misfit of a patch, rms mm.
const MAX_MISFIT_MM: f64 = 0.25;

/// Why so many pixels are of no use, by what most of those show. `usable` of them are.
pub(crate) fn why_no_depth(states: &[State], usable: usize) -> Code {
    let count = |of: &[State]| states.iter().filter(|s| of.contains(s)).count();
    let most = |n: usize| 2 * n > states.len() - usable;
    if most(count(&[State::Saturated])) {
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
}

/// Sums of one cell.
#[derive(Default, Clone, Copy)]
struct Sums {
    weight: f64,
    u: f64,
    v: f64,
    w: f64,
}

impl Sums {
    fn add(&mut self, c: &Vector3<f64>, variance: f64) {
        let weight = 1.0 / variance;
        self.weight += weight;
        self.u += weight * c.x;
        self.v += weight * c.y;
        self.w += weight * c.z;
    }

    fn cell(&self, index: [i32; 2]) -> Cell {
        let n = self.weight;
        Cell { index, uv: Vector2::new(self.u / n, self.v / n), w: self.w / n, variance: 1.0 / n }
    }
}

fn cell_index(uv: &Vector2<f64>, side: f64) -> [i32; 2] {
    [(uv.x / side).floor() as i32, (uv.y / side).floor() as i32]
}

/// What the pixels of a site's panel have, before there is depth.
pub(crate) fn panel_states(map: &CoordinateMap, camera: &Lens, site: &Site<'_>, mut visit: impl FnMut(State)) {
    let normal: Vector3<f64> = site.local.axes.column(2).into();
    let height = normal.dot(&site.local.origin.xyz);
    for (i, pixel) in map.pixels.iter().enumerate().step_by(5) {
        let at = Pixel::new((map.window.x + i % map.window.width) as f64, (map.window.y + i / map.window.width) as f64);
        let Some(ray) = camera.ray(&at) else { continue };
        let uv = site.local.coordinates(Point3::new(ray * (height / normal.dot(&ray)))).xy();
        if uv.norm() <= site.radii()[1] && site.panel.contains(&uv) {
            visit(pixel.state);
        }
    }
}

/// The rays of `map`'s window that meet the local plane of `site` within `reach_mm` on its panel, each with its
/// local (u, v) there and its depth.
fn panel_pixels(
    map: &DepthMap<'_>,
    camera: &Lens,
    site: &Site<'_>,
    reach_mm: f64,
    mut visit: impl FnMut(&Vector3<f64>, &Vector2<f64>, &crate::fringe::Depth),
) {
    let Some(centre) = camera.project(&site.local.origin.xyz) else { return };
    let window = map.rays.window;
    let reach = 1.3 * reach_mm * camera.fx / site.local.origin.xyz.z;
    let range = |centre: f64, first: usize, n: usize| {
        let last = (first + n) as f64;
        let from = (centre - reach).clamp(first as f64, last) as usize;
        from..((centre + reach).clamp(first as f64, last) as usize).max(from)
    };
    let normal: Vector3<f64> = site.local.axes.column(2).into();
    let height = normal.dot(&site.local.origin.xyz);
    for y in range(centre.y, window.y, window.height) {
        for x in range(centre.x, window.x, window.width) {
            let ray = map.rays.at(x, y);
            let s = height / normal.dot(&ray);
            let uv = site.local.coordinates(Point3::new(ray * s)).xy();
            if uv.norm() <= reach_mm && site.panel.contains(&uv) {
                visit(&ray, &uv, &map.pixels[(y - window.y) * window.width + x - window.x]);
            }
        }
    }
}

/// The coarse surface: a quartic over the panel about all features, in the frame of the first with the origin
/// amid them. `None` where too little of it has depth.
pub(crate) fn coarse(map: &DepthMap<'_>, camera: &Lens, sites: &[Site<'_>]) -> Option<Surface<frame::Camera>> {
    let middle = sites.iter().map(|s| s.local.origin.xyz).sum::<Vector3<f64>>() / sites.len() as f64;
    let local = Local { origin: Point3::new(middle), axes: sites.first()?.local.axes };
    let mut sums: BTreeMap<[i32; 2], Vec<(Vector3<f64>, f64)>> = BTreeMap::new();
    for site in sites {
        panel_pixels(map, camera, site, site.radii()[3], |ray, _, depth| {
            if depth.state == State::Valid {
                let c = local.coordinates(Point3::new(ray * f64::from(depth.z)));
                sums.entry(cell_index(&c.xy(), COARSE_CELL_MM)).or_default().push((c, f64::from(depth.sigma).powi(2)));
            }
        });
    }
    let cells: Vec<Cell> = sums
        .iter_mut()
        .filter(|(_, points)| points.len() >= 4)
        .map(|(index, points)| {
            // the median in w, so that a few wild pixels do not move the cell
            let middle = points.len() / 2;
            let (c, variance) = *points.select_nth_unstable_by(middle, |a, b| a.0.z.total_cmp(&b.0.z)).1;
            Cell { index: *index, uv: c.xy(), w: c.z, variance: variance + 0.05 * 0.05 }
        })
        .collect();
    Surface::fit(local, &cells, 4, f64::INFINITY)
}

/// What a patch may be.
pub(crate) enum Shape<'a> {
    /// Anything smooth: of the orders and radii the one with the least expected error over these local (u, v).
    Smooth(&'a [Vector2<f64>]),
    /// What was taught, within the radius (mm) it was taught for.
    Taught(&'a Polynomial, f64),
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
    let everywhere = PanelMask::new(site.panel.cell_mm, site.panel.half, |_| true);
    let flap_mm = site.hole_mm - FLAP_MARGIN_MM;
    let mut sums: BTreeMap<[i32; 2], Sums> = BTreeMap::new();
    let outward: Vector3<f64> = site.local.axes.column(2).into();
    let flap = Site { local: site.local, panel: &everywhere, hole_mm: 0.0 };
    panel_pixels(map, camera, &flap, flap_mm, |ray, _, depth| {
        let c = site.local.coordinates(Point3::new(ray * f64::from(depth.z)));
        let w = c.z - panel.polynomial.height(&c.xy());
        if depth.state == State::Valid && w.abs() < HOLD_MM {
            let variance = (f64::from(depth.sigma) * outward.dot(ray)).powi(2);
            sums.entry(cell_index(&c.xy(), CELL_MM)).or_default().add(&Vector3::new(c.x, c.y, w), variance);
        }
    });
    let cells: Vec<Cell> = sums.iter().map(|(i, s)| s.cell(*i)).collect();
    let flap = Surface::fit(site.local, &cells, 4, flap_mm)?;
    let ring = (0..36).map(|k| {
        let (sin, cos) = (f64::from(k) * std::f64::consts::TAU / 36.0).sin_cos();
        flap.polynomial.height(&(Vector2::new(cos, sin) * site.hole_mm))
    });
    Some(flap.polynomial.height(uv) - ring.sum::<f64>() / 36.0)
}

/// The patch about `site`, held to `coarse`.
pub(crate) fn patch(
    map: &DepthMap<'_>,
    camera: &Lens,
    site: &Site<'_>,
    coarse: &Surface<frame::Camera>,
    shape: &Shape<'_>,
) -> Result<Patch, Code> {
    let (mut states, mut valid) = (Vec::new(), 0usize);
    let mut sums: BTreeMap<[i32; 2], Sums> = BTreeMap::new();
    let mut samples = Vec::new();
    let outward: Vector3<f64> = site.local.axes.column(2).into();
    let radii = site.radii();
    panel_pixels(map, camera, site, radii[3], |ray, uv, depth| {
        let near = uv.norm() <= radii[1];
        states.extend(near.then_some(depth.state));
        if depth.state != State::Valid {
            return;
        }
        let p = Point3::new(ray * f64::from(depth.z));
        let c = coarse.local.coordinates(p);
        if (c.z - coarse.polynomial.height(&c.xy())).abs() > HOLD_MM {
            return;
        }
        valid += usize::from(near);
        let c = site.local.coordinates(p);
        let variance = (f64::from(depth.sigma) * outward.dot(ray)).powi(2);
        sums.entry(cell_index(&c.xy(), CELL_MM)).or_default().add(&c, variance);
        samples.push((c, variance));
    });
    let coverage = valid as f64 / states.len().max(1) as f64;
    if coverage < MIN_COVERAGE {
        return Err(why_no_depth(&states, valid));
    }
    let cells = |sums: &BTreeMap<[i32; 2], Sums>| sums.iter().map(|(i, s)| s.cell(*i)).collect::<Vec<_>>();
    let fit = |cells: &[Cell]| match shape {
        Shape::Smooth(at) => Surface::choose(site.local, cells, ORDERS, &radii, at),
        Shape::Taught(shape, radius_mm) => Surface::fit_shape(site.local, cells, shape, *radius_mm),
    };
    let first = fit(&cells(&sums)).ok_or(Code::CoverageLow)?;
    // once more without the pixels that stand out: edge pixels that mix two depths, fringe orders gone wrong
    sums.clear();
    for (c, variance) in &samples {
        let off = c.z - first.polynomial.height(&c.xy());
        if off * off < 16.0 * variance + 0.15 * 0.15 {
            sums.entry(cell_index(&c.xy(), CELL_MM)).or_default().add(c, *variance);
        }
    }
    let surface = fit(&cells(&sums)).ok_or(Code::CoverageLow)?;
    if surface.misfit_mm > MAX_MISFIT_MM {
        return Err(Code::NotSmooth);
    }
    Ok(Patch { surface, coverage })
}
