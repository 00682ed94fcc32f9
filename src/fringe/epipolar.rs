//! How far the fringes across the measuring axis lie off the epipolar lines, over everything that is lit.
//! In:  depth from one axis, wrapped phases of the other (no set with one fringe is needed), the rig.
//! Out: cells of the image with their mean residual. Not here: what the residuals say of the rig.
//!
//! Where camera and projector stand to each other as calibrated, a point's depth tells which projector coordinate
//! lights it along the other axis too. Any surface will do.

use super::{Axis, DepthMap, PhaseMap, State, projector_coordinate};
use crate::geometry::{Point3, frame, robust};
use crate::image::Window;
use crate::lent::{List, side_by_side};
use crate::optics::{Pixel, Rig};
use nalgebra::Vector3;
use std::f64::consts::TAU;

/// The mean over one cell of the image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EpipolarCell {
    /// Column and row of the cell in its grid.
    pub index: [i32; 2],
    /// The mean pixel.
    pub pixel: Pixel,
    /// The mean surface point.
    pub point: Point3<frame::Camera>,
    /// Measured less expected projector coordinate, px; the nearest of those a fringe apart.
    pub residual: f64,
    /// Its standard deviation from the pixels' scatter, px.
    pub sigma: f64,
}

/// Cells along the longer side of the window.
const CELLS: usize = 24;
/// Pixels along a cell's side that are looked at: some 600 of 0.06 px each make a mean good to 0.0025 px.
const SAMPLES: usize = 24;
/// Least share of a cell's samples with depth and phase.
const MIN_SHARE: f64 = 0.3;

/// Residuals of the phases `across` against `depth`, which comes from the projector's other axis. Means are robust
/// (biweight): mirrored fringes and mixed pixels at edges do not move them. Panics if the windows differ.
pub fn epipolar_cells(rig: &Rig, depth: &DepthMap<'_>, across: &PhaseMap) -> List<EpipolarCell> {
    let window = depth.rays.window;
    assert_eq!(window, across.window, "depth and phases of different windows");
    let side = window.width.max(window.height).div_ceil(CELLS).max(1);
    let (columns, rows) = (window.width.div_ceil(side), window.height.div_ceil(side));
    let extent = if across.set.axis == Axis::Column { rig.projector.width } else { rig.projector.height };
    let pitch = across.set.pitch(extent);
    let of_rows = side_by_side(rows, |row| {
        List::of((0..columns).filter_map(|column| cell(rig, depth, across, pitch, [column, row], side)))
    });
    List::of(of_rows.iter().flatten().copied())
}

/// Whether [`epipolar_cells`] looks at column `x` and row `y` of `window`, both counted from its corner.
pub fn is_sampled(window: &Window, x: usize, y: usize) -> bool {
    let side = window.width.max(window.height).div_ceil(CELLS).max(1);
    let stride = side.div_ceil(SAMPLES);
    (x % side).is_multiple_of(stride) && (y % side).is_multiple_of(stride)
}

fn cell(
    rig: &Rig,
    depth: &DepthMap<'_>,
    across: &PhaseMap,
    pitch: f64,
    index: [usize; 2],
    side: usize,
) -> Option<EpipolarCell> {
    let Window { x, y, width, height } = depth.rays.window;
    let stride = side.div_ceil(SAMPLES);
    let range = |i: usize, n: usize| (i * side..((i + 1) * side).min(n)).step_by(stride);
    let (mut asked, mut sums) = (0usize, (Pixel::zeros(), Vector3::zeros()));
    let mut residuals = List::new(); // rad, wrapped
    for row in range(index[1], height) {
        for column in range(index[0], width) {
            asked += 1;
            let phase = across.pixels.at(row * width + column);
            let Some(point) = depth.point(x + column, y + row).filter(|_| phase.state == State::Valid) else {
                continue;
            };
            let Some(expected) = projector_coordinate(rig, across.set.axis, &point) else { continue };
            residuals.push(f64::from(phase.phase) - (expected + 0.5) / pitch * TAU);
            sums.0 += Pixel::new((x + column) as f64, (y + row) as f64);
            sums.1 += point.xyz;
        }
    }
    let n = residuals.len() as f64;
    if n < (MIN_SHARE * asked as f64).max(10.0) {
        return None;
    }
    // the mean direction needs no unwrapping; about it nothing wraps
    let (sin, cos) = residuals.iter().fold((0.0, 0.0), |(s, c), r| (s + r.sin(), c + r.cos()));
    let middle = sin.atan2(cos);
    for r in &mut residuals {
        let turns = (*r - middle) / TAU;
        *r = (turns - turns.round()) * pitch;
    }
    let mut mean = robust::median(&mut residuals.clone());
    let (mut weight, mut scale) = (0.0, 0.0);
    for _ in 0..5 {
        scale = robust::mad_sigma(residuals.iter().map(|r| r - mean)).max(1e-6);
        let weights = residuals.iter().map(|r| robust::tukey((r - mean) / scale));
        let sum: f64;
        (weight, sum) = weights.zip(&residuals).fold((0.0, 0.0), |(w, s), (weight, r)| (w + weight, s + weight * r));
        mean = sum / weight;
    }
    Some(EpipolarCell {
        index: index.map(|i| i32::try_from(i).expect("few cells")),
        pixel: sums.0 / n,
        point: Point3::new(sums.1 / n),
        residual: middle / TAU * pitch + mean,
        sigma: scale / weight.sqrt(),
    })
}
