//! The image of a disc's centre, which is not the centre of its image. In: edge points of a board's discs, in a plane
//! that is a projective view of it. Out: the centres there. Not here: finding discs and edges.
//!
//! The edges are carried to the board's plane, where they are circles, and the fitted centres back; the map between the
//! planes comes from the centres and is made better by them in turn: Heikkilä, "Geometric camera calibration using
//! circular control points", PAMI 22 (2000) 1066, corrects the same bias by calculation from a calibrated camera.

use super::{Mark, Sighting};
use crate::calibrate::{Board, Homography};
use crate::contour::{Ellipse, EllipseLimits, fit_ellipse};
use crate::optics::{Lens, Pixel};
use nalgebra::{Matrix2, Vector2};

/// What an edge point is off by, px: the scale of the robust fit.
const EDGE_SIGMA: f64 = 0.05;
/// Of a circle so much must be seen.
const COVERAGE: f64 = 0.7;

/// Edge points a pixel apart are each the mean over 3.5 px along the edge.
const SHARED: f64 = 3.5;

/// A centre and its sigma per axis, in the plane of the edges.
type Centre = (Vector2<f64>, f64);

/// The centres of a board's discs from their `edges`, point by point; `px` is the size of a pixel in the plane of the
/// edges. `None` with fewer than four discs, or where they stand in no projective view of the board; a disc is `None`
/// where there is no edge or it is no circle.
pub(super) fn centres(board: &Board, edges: &[Vec<Vector2<f64>>], px: f64) -> Option<Vec<Option<Centre>>> {
    let points = board.points();
    let mean = |edge: &Vec<Vector2<f64>>| Some((edge.iter().sum::<Vector2<f64>>() / edge.len() as f64, f64::NAN));
    let mut centres: Vec<Option<Centre>> =
        edges.iter().map(|edge| Some(edge).filter(|e| !e.is_empty()).and_then(mean)).collect();
    for _ in 0..20 {
        let pairs: Vec<_> = points.iter().zip(&centres).filter_map(|(p, c)| Some((*p, (*c)?.0))).collect();
        let view = Homography::fit(&pairs)?;
        let back = view.inverse()?;
        let next: Vec<Option<Centre>> =
            edges.iter().zip(&centres).map(|(edge, c)| centre(board, edge, &(*c)?.0, &view, &back, px)).collect();
        let moved = next.iter().zip(&centres).filter_map(|(a, b)| Some(((*a)?.0 - (*b)?.0).norm())).fold(0.0, f64::max);
        centres = next;
        if moved < 1e-4 * px {
            break;
        }
    }
    Some(centres)
}

/// The centre of one disc, near `about`.
fn centre(
    board: &Board,
    edge: &[Vector2<f64>],
    about: &Vector2<f64>,
    view: &Homography,
    back: &Homography,
    px: f64,
) -> Option<Centre> {
    let radius = 0.5 * board.diameter()?;
    // mm of the board per unit of the plane, there
    let origin = back.apply(about);
    let slope = |d: Vector2<f64>| (back.apply(&(about + d)) - origin) / px;
    let local = Matrix2::from_columns(&[slope(Vector2::new(px, 0.0)), slope(Vector2::new(0.0, px))]);
    let sigma = EDGE_SIGMA * px * local.determinant().abs().sqrt();
    let circle: Vec<_> = edge.iter().map(|p| (back.apply(p), sigma * sigma)).collect();
    let limits = EllipseLimits { coverage: COVERAGE, semi_axes: 0.5 * radius..=2.0 * radius };
    let fit = fit_ellipse(&circle, &limits).ok()?;
    let shared = shared_noise(&fit.ellipse, &circle);
    let scatter = shared * fit.chi2 / (fit.weight - 5.0 * shared).max(1.0);
    let inverse = local.try_inverse()?;
    let covariance = inverse * fit.centre_covariance() * inverse.transpose() * scatter;
    let sigma = (0.5 * covariance.trace()).sqrt();
    sigma.is_finite().then(|| (view.apply(&fit.ellipse.centre), sigma))
}

/// By how much the noise of neighbouring edge points weighs more in a sum than if it were independent: the variance of
/// sums of ten over that of ten alone, and not less than follows from the pixels that they share.
fn shared_noise(ellipse: &Ellipse, edge: &[(Vector2<f64>, f64)]) -> f64 {
    let inverse = ellipse.shape.try_inverse().unwrap_or_default();
    let off: Vec<f64> = edge.iter().map(|(p, _)| (inverse * (p - ellipse.centre)).norm() - 1.0).collect();
    let of_sums: f64 = off.chunks(10).map(|c| c.iter().sum::<f64>().powi(2)).sum();
    let alone: f64 = off.iter().map(|r| r * r).sum();
    (of_sums / alone).max(SHARED)
}

/// See [`Sighting::through`]; `None` of chessboards, and where the lens has no inverse at any of the edges.
pub(super) fn through(sighting: &Sighting, board: &Board, lens: &Lens) -> Option<Sighting> {
    board.diameter()?;
    let straight = |p: &Pixel| lens.undistort(p);
    let edge = |mark: &Option<Mark>| mark.iter().flat_map(|m| m.edge.iter().filter_map(straight)).collect();
    let edges: Vec<Vec<Vector2<f64>>> = sighting.marks.iter().map(edge).collect();
    let px = 1.0 / (lens.fx * lens.fy).sqrt();
    let centres = centres(board, &edges, px)?;
    let mark = |(mark, centre): (&Option<Mark>, Option<Centre>)| {
        let (at, sigma) = centre?;
        let at = lens.project(&at.push(1.0))?;
        Some(Mark { at, sigma: sigma / px, edge: mark.as_ref()?.edge.clone() })
    };
    Some(Sighting { marks: sighting.marks.iter().zip(centres).map(mark).collect() })
}
