//! The datum survey: where the station's frame lies. In: the edges of discs as the camera sees them, the depth about them,
//! their station coordinates. Out: `station_from_camera`, what it leaves of each disc, and how well it is known.
//! Not here: how the station's coordinates were measured; finding discs.

use super::phase::affine;
use crate::contour::{EllipseLimits, fit_ellipse};
use crate::document::{self, Check};
use crate::fringe::{Axis, CoordinateMap, State, triangulate};
use crate::geometry::{NoPose, Pair, Point3, Pose, Registration, frame, register};
use crate::optics::{Pixel, Rig};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::Deserialize;
use std::path::Path;

/// One disc whose centre was surveyed.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Circle {
    /// For reports.
    pub name: String,
    /// Its centre, station frame, mm.
    pub station_mm: [f64; 3],
    /// A raw pixel inside its image: which of the discs in view it is.
    pub pixel: [f64; 2],
    /// Standard deviation of `station_mm` per axis, mm.
    #[serde(default = "surveyed_to")]
    pub sigma_mm: f64,
}

/// What a laser tracker or a good total station reaches in a cell.
fn surveyed_to() -> f64 {
    0.05
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Document {
    #[expect(dead_code, reason = "checked by document::read")]
    format: u32,
    circle: Vec<Circle>,
}

/// The circles in `file`: `format = 1` and, per circle, a table `[[circle]]`.
pub fn read_circles(file: &Path) -> Result<Vec<Circle>, document::Error> {
    let d: Document = document::read(file)?;
    let check = Check(file);
    check.within("number of [[circle]]", d.circle.len(), 3..=100)?;
    for (k, c) in d.circle.iter().enumerate() {
        check.name(format!("circle[{k}].name"), &c.name)?;
        check.finite(format!("circle[{k}].station_mm"), &c.station_mm)?;
        check.finite(format!("circle[{k}].pixel"), &c.pixel)?;
        check.positive(format!("circle[{k}].sigma_mm"), c.sigma_mm)?;
    }
    Ok(d.circle)
}

/// A disc in camera coordinates.
#[derive(Clone, Copy, Debug)]
pub struct Centre {
    /// mm.
    pub point: Point3<frame::Camera>,
    /// mm².
    pub covariance: Matrix3<f64>,
}

/// How far about a disc its plane is fitted, in radii of its image.
const ABOUT: f64 = 1.7;
/// What print and ripple leave of a disc's place, 1 sigma, mm: along its plane and across.
const BIAS_MM: [f64; 2] = [0.01, 0.02];

/// The centre of the disc with `edge` (raw px): a plane through the depth in and about it, in which its edge is a circle.
/// `None` where there are too few valid pixels, or the edge is none.
pub fn centre(rig: &Rig, columns: &CoordinateMap, edge: &[Pixel]) -> Option<Centre> {
    let n = edge.len() as f64;
    let middle = edge.iter().sum::<Pixel>() / n;
    let reach = ABOUT * edge.iter().map(|p| (p - middle).norm()).sum::<f64>() / n;
    // on a plane 1/Z is affine in the ray's x and y
    let mut samples = Vec::new();
    let w = columns.window;
    for (i, c) in columns.pixels.iter().enumerate().filter(|(_, c)| c.state == State::Valid) {
        let pixel = Pixel::new((w.x + i % w.width) as f64, (w.y + i / w.width) as f64);
        if (pixel - middle).norm() > reach {
            continue;
        }
        let ray = rig.camera.ray(&pixel)?;
        if let Some((z, slope)) = triangulate(rig, &ray, Axis::Column, c.value) {
            let variance = f64::from(c.variance) * (slope / (z * z)).powi(2);
            samples.push((ray, 1.0 / z, variance));
        }
    }
    let plane = affine(&samples)?;
    let meet = |p: &Pixel| {
        let ray = rig.camera.ray(p)?;
        Some(ray / plane.coefficients.dot(&ray)).filter(|m| m.z > 0.0)
    };
    let normal = plane.coefficients.normalize(); // n·p = const: n·ray·Z = 1
    let u = normal.cross(&Vector3::y()).normalize();
    let v = normal.cross(&u);
    let at = meet(&middle)?;
    let on_plane = |p: &Pixel| meet(p).map(|m| Vector2::new(u.dot(&(m - at)), v.dot(&(m - at))));
    let circle: Option<Vec<_>> = edge.iter().map(|p| Some((on_plane(p)?, 0.01))).collect();
    let limits = EllipseLimits { coverage: 0.7, semi_axes: 0.5..=1e3 };
    let fit = fit_ellipse(&circle?, &limits).ok()?;
    let c = fit.ellipse.centre;
    let point = at + u * c.x + v * c.y;
    let scatter = fit.chi2 / (fit.weight - 5.0).max(1.0);
    let along = fit.centre_covariance() * scatter;
    let ray = point / point.z;
    let depth = (ray.transpose() * plane.covariance * ray)[0] * point.z.powi(4);
    let flat = nalgebra::Matrix3x2::from_columns(&[u, v]);
    let covariance = flat * along * flat.transpose()
        + (Matrix3::identity() - normal * normal.transpose()) * BIAS_MM[0].powi(2)
        + normal * normal.transpose() * (depth + BIAS_MM[1].powi(2));
    Some(Centre { point: Point3::new(point), covariance })
}

/// A solved survey.
#[derive(Clone, Debug)]
pub struct Survey {
    /// The station's frame.
    pub station_from_camera: Pose<frame::Station, frame::Camera>,
    /// The registration it comes from: residuals in station axes, covariance about the circles' centroid. If the circles
    /// fit worse than they state, the covariance is as much larger.
    pub registration: Registration<frame::Camera, frame::Station>,
    /// Root mean square of the residuals, mm.
    pub rms_mm: f64,
}

/// The station's frame from discs as measured and as surveyed.
pub fn survey(circles: &[Circle], centres: &[Centre]) -> Result<Survey, NoPose> {
    let pair = |(circle, centre): (&Circle, &Centre)| Pair {
        measured: centre.point,
        nominal: Point3::<frame::Station>::new(Vector3::from(circle.station_mm)),
        covariance: centre.covariance + Matrix3::identity() * circle.sigma_mm.powi(2),
    };
    let pairs: Vec<_> = circles.iter().zip(centres).map(pair).collect();
    let mut registration = register(&pairs)?;
    let n = pairs.len() as f64;
    let excess = (registration.chi2 / (3.0 * n - 6.0)).max(1.0);
    registration.covariance *= excess;
    let rms_mm = (registration.residuals.iter().map(|r| r.norm_squared()).sum::<f64>() / n).sqrt();
    Ok(Survey { station_from_camera: registration.a_from_b.inverse(), registration, rms_mm })
}
