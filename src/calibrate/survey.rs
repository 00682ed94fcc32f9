//! The datum survey: where the station's frame lies. In: the edges of discs as the camera sees them, the depth about them,
//! their station coordinates. Out: `station_from_camera`, what it leaves of each disc, which one belies the others, and how
//! well it is known, the calibration's errors included.
//! Not here: how the station's coordinates were measured; finding discs.

use super::phase::affine;
use super::propagate::{PointJacobian, Sensitivity, independent_errors};
use super::{Calibration, ParameterCovariance};
use crate::contour::{EllipseLimits, fit_ellipse};
use crate::document::{self, Check};
use crate::fringe::{Axis, CoordinateMap, State, triangulate};
use crate::geometry::{NoPose, Pair, Point3, Pose, Registration, frame, motion_jacobian, register};
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

/// A circle this far from where it was surveyed is not where it is said to be, mm.
pub const MAX_RESIDUAL_MM: f64 = 1.0;
/// Nor is one so many of its own sigmas off, nor are all together. Three circles turn with a wrong one and show little of
/// it: 20 mm across their plane leave 0.3 mm along it.
pub const MAX_SIGMAS: f64 = 5.0;
/// Measured centres so near each other are one disc, mm.
const SAME_DISC_MM: f64 = 1.0;

/// A solved survey.
#[derive(Clone, Debug)]
pub struct Survey {
    /// The station's frame.
    pub station_from_camera: Pose<frame::Station, frame::Camera>,
    /// The registration it comes from: residuals in station axes, covariance about the circles' centroid with the
    /// calibration's share. If the circles fit worse than they state, their share is as much larger.
    pub registration: Registration<frame::Camera, frame::Station>,
    /// Root mean square of the residuals, mm.
    pub rms_mm: f64,
    /// Of each circle.
    pub misfits: Vec<Misfit>,
    /// Of all circles together: χ² in sigmas, about 0 where they fit as they state. Here the pose's share is taken off.
    pub sigmas: f64,
    /// There are more than three circles: of three, all but the distances between them goes into the pose unchecked.
    pub checked: bool,
}

/// How far a circle is from where it was surveyed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misfit {
    /// mm.
    pub mm: f64,
    /// The same in standard deviations along its direction: of the disc as measured, of its station coordinates, of what
    /// the calibration leaves. The pose's own share is not taken off.
    pub sigmas: f64,
}

impl Misfit {
    /// Within [`MAX_RESIDUAL_MM`] and [`MAX_SIGMAS`].
    pub fn fits(&self) -> bool {
        self.mm <= MAX_RESIDUAL_MM && self.sigmas <= MAX_SIGMAS
    }
}

/// Circles that do not fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Culprit {
    /// Index of the worst, or of the one without which the others fit.
    pub circle: usize,
    /// How far off it is: by the pose of the others if they fit without it, else by that of all.
    pub misfit: Misfit,
    /// The others fit without it.
    pub certain: bool,
    /// Circles without which the others would fit too, so that it may be one of these instead.
    pub or: Vec<usize>,
}

/// Why circles give no station frame.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Unsurveyed {
    /// Where they lie.
    #[error(transparent)]
    NoPose(#[from] NoPose),
    /// Two pixels point at one disc.
    #[error(
        "circle[{}] {:?} and circle[{}] {:?} are the same disc: measured {mm:.2} mm apart, allowed: a disc each, \
         more than {SAME_DISC_MM} mm apart", circles[0], names[0], circles[1], names[1]
    )]
    SameDisc {
        /// Indices.
        circles: [usize; 2],
        /// Names.
        names: [String; 2],
        /// Distance of their centres.
        mm: f64,
    },
    /// A disc that camera and projector cannot both see.
    #[error("circle[{circle}]: not in front of both camera and projector")]
    OutOfView {
        /// Index.
        circle: usize,
    },
}

type Pairs = Vec<Pair<frame::Camera, frame::Station>>;

/// The station's frame from discs as measured with `calibration` and as surveyed.
pub fn survey(circles: &[Circle], centres: &[Centre], calibration: &Calibration) -> Result<Survey, Unsurveyed> {
    for (j, i) in (0..centres.len()).flat_map(|j| (0..j).map(move |i| (j, i))) {
        let mm = (centres[i].point - centres[j].point).norm();
        if mm <= SAME_DISC_MM {
            let names = [i, j].map(|k| circles[k].name.clone());
            return Err(Unsurveyed::SameDisc { circles: [i, j], names, mm });
        }
    }
    let pairs = pairs(circles, centres);
    let spreads = spreads(centres, calibration)?;
    let mut registration = register(&pairs)?;
    let n = pairs.len() as f64;
    let misfits = (0..pairs.len()).map(|k| misfit(&registration, &pairs, &spreads, k)).collect();
    let of_calibration = registration.response(&pairs, &spreads);
    let chi2 = registration.chi2_granting(&pairs, &spreads);
    let excess = (chi2 / (3.0 * n - 6.0)).max(1.0);
    registration.covariance = registration.covariance * excess + of_calibration * of_calibration.transpose();
    let rms_mm = (registration.residuals.iter().map(|r| r.norm_squared()).sum::<f64>() / n).sqrt();
    let station_from_camera = registration.a_from_b.inverse();
    let sigmas = together(chi2, pairs.len());
    Ok(Survey { station_from_camera, registration, rms_mm, misfits, sigmas, checked: circles.len() > 3 })
}

impl Survey {
    /// The circle that belies the others; `None` where all fit. Of four or more each is left out in turn.
    pub fn culprit(&self, circles: &[Circle], centres: &[Centre], calibration: &Calibration) -> Option<Culprit> {
        if self.sigmas <= MAX_SIGMAS && self.misfits.iter().all(Misfit::fits) {
            return None;
        }
        let by_sigmas = |a: &usize, b: &usize| self.misfits[*a].sigmas.total_cmp(&self.misfits[*b].sigmas);
        let worst = (0..circles.len()).max_by(by_sigmas)?;
        let (pairs, spreads) = (pairs(circles, centres), spreads(centres, calibration).ok()?);
        let mut without: Vec<(usize, Misfit, f64)> = (0..circles.len())
            .filter_map(|k| Some((k, left_out(&pairs, &spreads, k)?)))
            .map(|(k, (m, c))| (k, m, c))
            .collect();
        without.sort_by(|a, b| a.2.total_cmp(&b.2));
        Some(match without.split_first() {
            Some((first, others)) => {
                Culprit { circle: first.0, misfit: first.1, certain: true, or: others.iter().map(|o| o.0).collect() }
            }
            None => Culprit { circle: worst, misfit: self.misfits[worst], certain: false, or: Vec::new() },
        })
    }
}

/// Circle `k` by the pose of the others, and their χ²; `None` where they are fewer than three or do not fit either.
fn left_out(pairs: &Pairs, spreads: &[PointJacobian], k: usize) -> Option<(Misfit, f64)> {
    let without = |n: usize| (0..n).filter(move |&i| i != k);
    let rest: Pairs = without(pairs.len()).map(|i| pairs[i]).collect();
    let rest_spreads: Vec<PointJacobian> = without(pairs.len()).map(|i| spreads[i]).collect();
    let registration = register(&rest).ok()?;
    let chi2 = registration.chi2_granting(&rest, &rest_spreads);
    let each = (0..rest.len()).all(|i| misfit(&registration, &rest, &rest_spreads, i).fits());
    if !each || together(chi2, rest.len()) > MAX_SIGMAS {
        return None;
    }
    let to_station = registration.a_from_b.inverse();
    let residual = to_station * pairs[k].measured - pairs[k].nominal;
    let j = motion_jacobian(&pairs[k].nominal.xyz, &registration.at.xyz);
    let left = to_station.r * spreads[k] - j * registration.response(&rest, &rest_spreads);
    let covariance = to_station.r * pairs[k].covariance * to_station.r.inverse()
        + left * left.transpose()
        + j * registration.covariance * j.transpose();
    Some((Misfit { mm: residual.norm(), sigmas: sigmas(&residual, &covariance) }, chi2))
}

/// Circle `k` of a registration of `pairs`.
fn misfit(
    registration: &Registration<frame::Camera, frame::Station>,
    pairs: &Pairs,
    spreads: &[PointJacobian],
    k: usize,
) -> Misfit {
    let (r, residual) = (registration.a_from_b.r.inverse(), &registration.residuals[k]);
    let j = motion_jacobian(&pairs[k].nominal.xyz, &registration.at.xyz);
    let left = r * spreads[k] - j * registration.response(pairs, spreads);
    let covariance = r * pairs[k].covariance * r.inverse() + left * left.transpose();
    Misfit { mm: residual.norm(), sigmas: sigmas(residual, &covariance) }
}

/// χ² of `circles` in sigmas: √(2χ²) is nearly Gaussian with variance 1 (Fisher).
fn together(chi2: f64, circles: usize) -> f64 {
    (2.0 * chi2).sqrt() - (2.0 * (3.0 * circles as f64 - 6.0) - 1.0).sqrt()
}

/// Length of `off` in standard deviations along its direction.
fn sigmas(off: &Vector3<f64>, covariance: &Matrix3<f64>) -> f64 {
    let square = off.norm_squared();
    if square > 0.0 { square / off.dot(&(covariance * off)).sqrt() } else { 0.0 }
}

fn pairs(circles: &[Circle], centres: &[Centre]) -> Pairs {
    let pair = |(circle, centre): (&Circle, &Centre)| Pair {
        measured: centre.point,
        nominal: Point3::<frame::Station>::new(Vector3::from(circle.station_mm)),
        covariance: centre.covariance + Matrix3::identity() * circle.sigma_mm.powi(2),
    };
    circles.iter().zip(centres).map(pair).collect()
}

/// How each centre follows the calibration's independent errors, mm per sigma; zero where it states none.
fn spreads(centres: &[Centre], calibration: &Calibration) -> Result<Vec<PointJacobian>, Unsurveyed> {
    let errors = calibration.covariance.as_deref().map_or_else(ParameterCovariance::zeros, independent_errors);
    let spread = |(circle, centre): (usize, &Centre)| {
        let sensitivity = Sensitivity::new(&calibration.rig, Axis::Column, &centre.point);
        Ok(sensitivity.ok_or(Unsurveyed::OutOfView { circle })?.point * errors)
    };
    centres.iter().enumerate().map(spread).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::testing::{rig, stated};
    use nalgebra::Rotation3;

    /// Five discs on a board 500 × 300 mm that stands at 740 mm, the last one 80 mm before it.
    const DISCS: [[f64; 3]; 5] = [
        [-200.0, -150.0, 700.0],
        [200.0, -150.0, 740.0],
        [-200.0, 150.0, 740.0],
        [200.0, 150.0, 760.0],
        [0.0, 0.0, 660.0],
    ];

    fn calibration(covariance: Option<Box<ParameterCovariance>>) -> Calibration {
        let file = "c.toml".into();
        Calibration { file, id: None, rig: rig(), station_from_camera: None, covariance, quality: None }
    }

    /// `n` discs as measured without error and as surveyed.
    fn surveyed(n: usize) -> (Vec<Circle>, Vec<Centre>) {
        let station_from_camera = Pose::<frame::Station, frame::Camera>::new(
            Rotation3::from_euler_angles(1.5, 0.1, 3.0),
            Vector3::new(-2600.0, 900.0, 700.0),
        );
        let disc = |(k, at): (usize, &[f64; 3])| {
            let point = Point3::new(Vector3::from(*at));
            let station_mm = (station_from_camera * point).xyz.into();
            let circle = Circle { name: format!("c{k}"), station_mm, pixel: [0.0; 2], sigma_mm: 0.05 };
            (circle, Centre { point, covariance: Matrix3::identity() * 0.02f64.powi(2) })
        };
        DISCS[..n].iter().enumerate().map(disc).unzip()
    }

    #[test]
    fn of_three_circles_one_far_out_of_plane_is_refused_by_its_sigmas() {
        // eight boards know lengths several times better than `stated`
        for covariance in [None, Some(Box::new(stated() * 0.04))] {
            let (mut circles, centres) = surveyed(3);
            let c = calibration(covariance);
            assert!(survey(&circles, &centres, &c).expect("a pose").culprit(&circles, &centres, &c).is_none());
            let at = |k: usize| Vector3::from(surveyed(3).0[k].station_mm);
            let normal = (at(1) - at(0)).cross(&(at(2) - at(0))).normalize();
            circles[1].station_mm = (at(1) + 20.0 * normal).into();
            let solved = survey(&circles, &centres, &c).expect("a pose");
            let culprit = solved.culprit(&circles, &centres, &c).expect("does not fit");
            assert!(culprit.misfit.mm < MAX_RESIDUAL_MM && solved.sigmas > 5.5, "{} {culprit:?}", solved.sigmas);
            assert!(!culprit.certain && !solved.checked, "{culprit:?}");
        }
    }

    #[test]
    fn sigmas_of_all_together_are_those_of_chi2() {
        // chi2 that noise exceeds once in 3.5 million times: 5 sigmas
        for (circles, chi2) in [(3, 33.1), (4, 40.4), (10, 80.5)] {
            assert!((together(chi2, circles) - 5.0).abs() < 1.0, "{}", together(chi2, circles));
        }
    }

    #[test]
    fn of_five_circles_the_culprit_is_found_by_leaving_each_out() {
        let c = calibration(Some(Box::new(stated())));
        for wrong in 0..5 {
            let (mut circles, centres) = surveyed(5);
            circles[wrong].station_mm[1] += 6.0;
            let solved = survey(&circles, &centres, &c).expect("a pose");
            let culprit = solved.culprit(&circles, &centres, &c).expect("does not fit");
            assert!(culprit.certain && culprit.or.is_empty() && culprit.circle == wrong, "{wrong}: {culprit:?}");
            assert!((culprit.misfit.mm - 6.0).abs() < 0.01, "{culprit:?}");
        }
        // two that are wrong: no absence helps
        let (mut circles, centres) = surveyed(5);
        circles[0].station_mm[1] += 6.0;
        circles[3].station_mm[0] += 9.0;
        let solved = survey(&circles, &centres, &c).expect("a pose");
        assert!(!solved.culprit(&circles, &centres, &c).expect("does not fit").certain);
    }

    #[test]
    fn the_calibrations_errors_are_part_of_the_uncertainty() {
        let (circles, centres) = surveyed(4);
        let of = |c: &Calibration| survey(&circles, &centres, c).expect("a pose").registration.covariance;
        let (none, with) = (of(&calibration(None)), of(&calibration(Some(Box::new(stated())))));
        let alone = of(&calibration(Some(Box::new(ParameterCovariance::zeros()))));
        assert_eq!(none, alone);
        let spreads = spreads(&centres, &calibration(Some(Box::new(stated())))).expect("in view");
        let pairs = pairs(&circles, &centres);
        let moved = register(&pairs).expect("a pose").response(&pairs, &spreads);
        assert!((with - none - moved * moved.transpose()).amax() < 1e-9);
        assert!(with[(1, 1)] > 2.0 * none[(1, 1)], "{with} {none}"); // depth: y of the station
    }

    #[test]
    fn the_same_disc_twice_names_both_circles() {
        let (mut circles, mut centres) = surveyed(3);
        circles.push(Circle { name: "again".into(), ..circles[1].clone() });
        let mut again = centres[1];
        again.point.xyz.x += 0.5;
        centres.push(again);
        let e = survey(&circles, &centres, &calibration(None)).expect_err("one disc twice").to_string();
        assert!(e.starts_with("circle[1] \"c1\" and circle[3] \"again\" are the same disc: measured 0.50 mm"), "{e}");
    }
}
