//! Which projector pixel lights a point of a board. In: a capture of the board, where the camera sees its points. Out: the
//! same points in the projector's picture. Not here: how a lens is found.
//!
//! A board is flat, so what a camera without distortion sees of it maps to projector pixels by one homography, bent a little
//! by the projector's lens: both are fitted to the whole board, and what is left of it, affine, robustly about each point;
//! over a window of a square's size ripple of the fringes and the print's edges average out. After Moreno, Taubin, "Simple,
//! accurate, and robust projector-camera calibration", 3DIMPVT 2012, whose homographies are local and of distorted pixels:
//! over so wide a window a camera's usual distortion bends the map enough to shift its middle by 0.1 px.

use super::adjust::Seen;
use super::{Board, Homography};
use crate::capture::{self, Capture, Fringes, coordinates};
use crate::fringe::{self, Axis, CoordinateMap, Limits, State};
use crate::geometry::{Polynomial, robust};
use crate::image::{Image, Window};
use crate::optics::{Lens, Pixel};
use nalgebra::{Matrix3, Vector2, Vector3};
use rayon::prelude::*;

/// On a smooth board a wrong order stands out against its neighbours; what sets disagree by gamma does not matter.
const LIMITS: Limits = Limits { order_residual: 0.45, ..Limits::DEFAULT };
/// Radius of the window about a point, in distances to its neighbours.
const RADIUS: f64 = 0.8;
/// Pixels of a window that are fitted; neighbours share their noise anyway.
const SAMPLES: usize = 1200;
/// Fewer determine no affine map worth having.
const MIN_SAMPLES: usize = 40;

/// The projector's picture as the camera sees it about the points of a board.
#[derive(Clone, Debug)]
pub struct Lit(Vec<About>);

/// The fringes about one point.
#[derive(Clone, Debug)]
struct About {
    point: usize,
    /// Of the window, px.
    radius: f64,
    columns: Vec<Sample>,
    rows: Option<Vec<Sample>>,
}

/// A pixel, the projector coordinate there, and its variance.
type Sample = (Pixel, f64, f32);

/// Why a capture cannot be decoded.
#[derive(Debug, thiserror::Error)]
pub enum NotLit {
    /// An image.
    #[error(transparent)]
    Capture(#[from] capture::Error),
    /// The fringes.
    #[error("{}", file.display())]
    Fringes {
        /// The capture's description.
        file: std::path::PathBuf,
        /// What is wrong with them.
        source: fringe::Error,
    },
}

/// The mean of all fringe images of `capture`: what it shows, under even light.
pub fn mean(capture: &Capture) -> Result<Image<f32>, NotLit> {
    let mut mean = Image::filled(capture.camera.width, capture.camera.height, 0f32);
    let share = 1.0 / capture.fringes.iter().map(|s| s.images.len()).sum::<usize>() as f32;
    for file in capture.fringes.iter().flat_map(|set| &set.images) {
        let image = capture.load(file)?;
        mean.pixels.iter_mut().zip(&image.pixels).for_each(|(m, &v)| *m += share * f32::from(v));
    }
    Ok(mean)
}

/// Projector coordinates along `axis` of the pixels in `window` of `capture`.
pub fn decode(capture: &Capture, window: Window, axis: Axis) -> Result<CoordinateMap, NotLit> {
    let bad = |source| NotLit::Fringes { file: capture.file(), source };
    let mut fringes = Fringes::new(capture, window, Some(axis));
    for (s, set) in capture.fringes.iter().enumerate().filter(|(_, set)| set.axis == axis) {
        for (step, file) in set.images.iter().enumerate() {
            fringes.add(s, step as u32, &capture.load(file)?).map_err(bad)?;
        }
    }
    let phases = fringes.phases(&fringes.noise(capture), &LIMITS).map_err(bad)?;
    coordinates(capture, &phases, axis, &LIMITS).map_err(bad)
}

impl Lit {
    /// Reads and decodes the fringes of `capture` about the points `seen` of `board`. Rows are left out where no row set
    /// has one fringe; columns are needed.
    pub fn read(capture: &Capture, board: &Board, seen: &[Seen]) -> Result<Self, NotLit> {
        let radii = radii(board, seen);
        let margin = radii.iter().copied().fold(0.0, f64::max).ceil();
        let bound = |k: usize, pick: fn(f64, f64) -> f64| seen.iter().map(|s| s.1[k]).reduce(pick).unwrap_or(0.0);
        let window = Window::clipped(
            bound(0, f64::min) - margin,
            bound(1, f64::min) - margin,
            bound(0, f64::max) + margin,
            bound(1, f64::max) + margin,
            capture.camera.width,
            capture.camera.height,
        )
        .unwrap_or(Window::whole(1, 1));
        let rows = match decode(capture, window, Axis::Row) {
            Ok(map) => Some(map),
            Err(NotLit::Fringes { source: fringe::Error::NoSet { .. } | fringe::Error::Ambiguous { .. }, .. }) => None,
            Err(e) => return Err(e),
        };
        let columns = decode(capture, window, Axis::Column)?;
        let about = |(&(point, at), &radius): (&Seen, &f64)| About {
            point,
            radius,
            columns: samples(&columns, &at, radius),
            rows: rows.as_ref().map(|rows| samples(rows, &at, radius)),
        };
        Ok(Self(seen.par_iter().zip(&radii).map(about).collect()))
    }

    /// Whether there are row fringes that are absolute.
    pub fn has_rows(&self) -> bool {
        self.0.iter().all(|about| about.rows.is_some())
    }

    /// Whether no point has enough valid fringes about it.
    pub fn is_empty(&self) -> bool {
        let few = |samples: &Vec<Sample>| samples.len() < MIN_SAMPLES;
        self.0.iter().all(|about| few(&about.columns) || about.rows.as_ref().is_some_and(few))
    }

    /// The projector pixels that light the points `seen` by a camera of this `lens`; points without enough valid fringes
    /// about them are left out. Without row fringes the projector's row is NaN.
    pub fn projector(&self, seen: &[Seen], lens: &Lens) -> Vec<Seen> {
        let straight = |at: &Pixel| lens.undistort(at).unwrap_or_else(|| lens.normalised(at));
        let about = |map: &(dyn Fn(&Pixel) -> Vector2<f64> + Sync)| -> Vec<(Seen, Pixel)> {
            let lit = |&(k, at): &Seen| {
                let about = self.0.iter().find(|about| about.point == k)?;
                let column = local(&about.columns, &at, about.radius, |p| map(p).x)?;
                let row = match &about.rows {
                    Some(rows) => local(rows, &at, about.radius, |p| map(p).y)?,
                    None => f64::NAN,
                };
                Some(((k, Pixel::new(column, row)), at))
            };
            seen.par_iter().filter_map(lit).collect()
        };
        let mut found = about(&|_| Vector2::zeros());
        for bent in [false, true] {
            let flat = |row: f64| if row.is_nan() { 0.0 } else { row };
            let pairs: Vec<_> =
                found.iter().map(|((_, lit), at)| (straight(at), Vector2::new(lit.x, flat(lit.y)))).collect();
            let Some(map) = Homography::fit(&pairs) else { break };
            let bend = if bent { Bend::of(&map, &pairs) } else { None };
            found = about(&|p| {
                let p = straight(p);
                map.apply(&p) + bend.as_ref().map_or(Vector2::zeros(), |b| b.at(&p))
            });
        }
        found.into_iter().map(|(seen, _)| seen).collect()
    }
}

/// What the projector's lens adds to a plane's homography: distortion is of third order.
struct Bend([Polynomial; 2]);

impl Bend {
    /// From what pairs of the camera's undistorted view and the projector's pixel are off `map`; `None` of too few to tell.
    fn of(map: &Homography, pairs: &[(Vector2<f64>, Pixel)]) -> Option<Self> {
        let off: Vec<_> = pairs.iter().map(|(at, lit)| (*at, lit - map.apply(at))).collect();
        let along = |axis: usize| Polynomial::through(off.iter().map(|(at, off)| (*at, off[axis])), 3);
        Some(Self([along(0)?, along(1)?]))
    }

    fn at(&self, p: &Vector2<f64>) -> Vector2<f64> {
        let Self([x, y]) = self;
        Vector2::new(x.height(p), y.height(p))
    }
}

/// The window of each point, px: from the distance to its nearest neighbours in the grid.
fn radii(board: &Board, seen: &[Seen]) -> Vec<f64> {
    let columns = board.columns;
    let of = |&(k, at): &Seen| {
        let next = |other: &&Seen| {
            let (dx, dy) = ((k % columns).abs_diff(other.0 % columns), (k / columns).abs_diff(other.0 / columns));
            dx + dy == 1
        };
        let (sum, n) = seen.iter().filter(next).fold((0.0, 0), |(s, n), o| (s + (o.1 - at).norm(), n + 1));
        if n > 0 { RADIUS * sum / f64::from(n) } else { 0.0 }
    };
    seen.iter().map(of).collect()
}

/// Valid pixels of `map` within `radius` of `at`, evenly some [`SAMPLES`] of them.
fn samples(map: &CoordinateMap, at: &Pixel, radius: f64) -> Vec<Sample> {
    let w = map.window;
    let (x, y) = (at.x - w.x as f64, at.y - w.y as f64);
    let Some(about) = Window::clipped(x - radius, y - radius, x + radius, y + radius, w.width, w.height) else {
        return Vec::new();
    };
    let stride = ((about.width * about.height) as f64 / SAMPLES as f64).sqrt().ceil().max(1.0) as usize;
    let mut samples = Vec::new();
    for y in (about.y..about.y + about.height).step_by(stride) {
        for x in (about.x..about.x + about.width).step_by(stride) {
            let pixel = Pixel::new((w.x + x) as f64, (w.y + y) as f64);
            let c = &map.pixels[y * w.width + x];
            if c.state == State::Valid && (pixel - at).norm() <= radius {
                samples.push((pixel, c.value, c.variance));
            }
        }
    }
    samples
}

/// The projector coordinate at `at`: what the samples within `radius` differ from `expected`, fitted robustly by an affine
/// map. `None` where there are too few.
fn local(samples: &[Sample], at: &Pixel, radius: f64, expected: impl Fn(&Pixel) -> f64) -> Option<f64> {
    let off = |(pixel, value, variance): &Sample| {
        (((pixel - at) / radius).push(1.0), value - expected(pixel), f64::from(*variance))
    };
    affine(&samples.iter().map(off).collect::<Vec<_>>()).map(|fit| fit.coefficients.z + expected(at))
}

/// A robust fit of `value = coefficients · place`, place = (x, y, 1).
pub(super) struct Affine {
    pub(super) coefficients: Vector3<f64>,
    /// From the samples' scatter.
    pub(super) covariance: Matrix3<f64>,
}

/// Fits samples of place, value and variance. `None` where there are too few, or they do not determine the map.
pub(super) fn affine(samples: &[(Vector3<f64>, f64, f64)]) -> Option<Affine> {
    if samples.len() < MIN_SAMPLES {
        return None;
    }
    // from the median: an order that is wrong by a whole fringe must not decide where weights start
    let middle = robust::median(&mut samples.iter().map(|s| s.1).collect::<Vec<_>>());
    let mut out = Affine { coefficients: Vector3::new(0.0, 0.0, middle), covariance: Matrix3::zeros() };
    for _ in 0..12 {
        let residuals: Vec<f64> =
            samples.iter().map(|(place, value, v)| (value - place.dot(&out.coefficients)) / v.sqrt()).collect();
        let sigma = robust::mad_sigma(residuals.iter().copied()).max(1e-9);
        let (mut left, mut right) = (Matrix3::zeros(), Vector3::zeros());
        for ((place, value, variance), residual) in samples.iter().zip(&residuals) {
            let weight = robust::tukey(residual / sigma) / variance;
            left += weight * place * place.transpose();
            right += weight * *value * place;
        }
        let inverse = left.cholesky()?.inverse();
        let next = inverse * right;
        let still = (next - out.coefficients).amax() < 1e-5 * next.amax();
        out = Affine { coefficients: next, covariance: inverse * sigma.powi(2) };
        if still {
            break;
        }
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::testing::rig;
    use crate::geometry::{Point3, Pose, frame};
    use nalgebra::Rotation3;

    /// Both lenses are distorted. Points come out 0.014 px off at most; without the projector's bend in the fit it would be
    /// 0.028, without the camera's lens it is 0.052.
    #[test]
    fn points_are_lit_by_the_pixel_that_lights_them_whatever_the_lenses() {
        let (rig, board): (_, Board) = (rig(), "circles:8x4:60:30".parse().expect("a board"));
        let r = Rotation3::from_euler_angles(0.1, 0.3, 0.02);
        let pose = Pose::<frame::Camera, frame::Board>::new(r, Vector3::new(-200.0, -90.0, 730.0));
        let lit = |p: Vector3<f64>| {
            rig.projector.project(&(rig.projector_from_camera * Point3::new(p)).xyz).expect("in front")
        };
        let places: Vec<Vector3<f64>> =
            board.points().into_iter().map(|p| (pose * Point3::new(p.push(0.0))).xyz).collect();
        let seen: Vec<Seen> = places.iter().map(|p| rig.camera.project(p).expect("in front")).enumerate().collect();
        let normal: Vector3<f64> = pose.r.matrix().column(2).into();
        let lit_at = |at: &Pixel| {
            let ray = rig.camera.ray(at).expect("no fold");
            lit(ray * (normal.dot(&pose.t) / normal.dot(&ray)))
        };
        let about = |(&(point, at), radius): (&Seen, f64)| {
            let off = (0..1600).map(|k| Pixel::new(f64::from(k % 40) - 19.5, f64::from(k / 40) - 19.5) * radius / 20.0);
            let pixels: Vec<Pixel> = off.filter(|off| off.norm() <= radius).map(|off| at + off).collect();
            let samples = |axis: usize| pixels.iter().map(|at| (*at, lit_at(at)[axis], 1e-4)).collect();
            About { point, radius, columns: samples(0), rows: Some(samples(1)) }
        };
        let fringes = Lit(seen.iter().zip(radii(&board, &seen)).map(about).collect());
        assert!(fringes.has_rows() && !fringes.is_empty());
        let off = |lens: &Lens| -> f64 {
            let found = fringes.projector(&seen, lens);
            assert_eq!(found.len(), 32);
            found.iter().map(|(k, at)| (at - lit(places[*k])).norm()).fold(0.0, f64::max)
        };
        let (by_lens, without) = (off(&rig.camera), off(&Lens::pinhole(1296, 972)));
        assert!(by_lens < 0.02, "{by_lens} px");
        assert!(without > 2.0 * by_lens, "{without} px without the lens");
    }
}
