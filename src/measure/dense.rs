//! The pose from everything that the taught regions show: all their contour points laid onto the taught curves, and all
//! cells of their surface onto the taught surface, at once.
//! In:  templates, patches about a pose near the truth, edge rays. Out: the pose with its covariance.
//! Not here: where regions are, edges, patches, the pose of the points.
//!
//! A feature's point is three numbers, its panel's tilt two more; a contour is a hundred and a patch a thousand. They are
//! not independent: what moves them together is an unknown of its own with what is known of it beforehand.

use super::body::{Patch, Shape};
use super::cycle::{Run, sites};
use super::edges::EdgeRay;
use super::judge::{self, Evidence, Judged, Refused};
use super::locate::{Located, on_panel};
use crate::code::Code;
use crate::geometry::{
    Distance, Joint, Pair, Point3, Polynomial, Pose, Registration, frame, motion_jacobian, register, register_jointly,
};
use crate::lent::List;
use crate::vehicle::{Feature, PerFeature, Template};
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3, Vector6};
use rayon::prelude::*;

type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// A contour point belongs to the taught curve within this, mm, and where their normals agree.
const CAPTURE_MM: f64 = 1.0;
const AGREEING: f64 = 0.8;
/// Edges this far apart along a contour, and cells so far apart on a surface, know little of each other, mm.
const CONTOUR_BLOCK_MM: f64 = 12.0;
const SURFACE_BLOCK_MM: f64 = 24.0;
/// What is left of an edge's bias where growth and turn are unknowns of their own.
const SHIFT_SHARE: f64 = 0.6;
/// Hems differ along a contour: they turn it by so much at its radius of gyration, 1 sigma, mm. Growth along its normals
/// turns nothing, and shifts a contour that is seen all around nowhere; it is what another paint does first.
const TURN_MM: f64 = 0.02;
/// How much a contour grows, 1 sigma, mm, on the paint that it was taught on.
const GROWTH_MM: f64 = 0.005;
/// A patch's tilt, 1 sigma, rad: its normal bias over half its width.
const TILT_RAD: f64 = 1e-4;

/// One region: what is taught of it and what is measured there.
pub(super) struct Region<'a> {
    pub(super) feature: &'a Feature,
    pub(super) template: &'a Template,
    pub(super) surface: &'a Polynomial,
    pub(super) patch: Patch,
    pub(super) located: &'a Located,
}

/// What moves a region's contour as a whole: shift along u and v, a turn; growth along its normals, all around alike and by
/// their direction. And its surface: height and two tilts.
const BIASES: usize = 9;
const OF_CONTOUR: usize = 6;

/// A pose of everything.
pub(super) struct Dense {
    pub(super) pose: CameraFromVehicle,
    /// About which it was registered.
    pub(super) at: Vector3<f64>,
    pub(super) joint: Joint,
}

/// Registers the regions from `pose`: one step.
pub(super) fn step(
    regions: &[Region<'_>],
    rays: &[EdgeRay],
    pose: &CameraFromVehicle,
    at: &Vector3<f64>,
) -> Option<Dense> {
    let mut distances = List::new();
    let mut priors = List::new();
    for (part, region) in regions.iter().enumerate() {
        let body = region.feature.position_sigma_mm;
        let edge = (SHIFT_SHARE * judge::edge_bias_mm(region.located)).hypot(body);
        priors.extend([edge, edge, TURN_MM]);
        let growth = GROWTH_MM + judge::paint_growth_mm(region.located);
        priors.extend([growth; 3]);
        priors.extend([judge::NORMAL_BIAS_MM.hypot(body), TILT_RAD, TILT_RAD]);
        contour(region, part, rays, &mut distances);
        surface(region, part, &mut distances);
    }
    let joint = register_jointly(&distances, &priors, at)?;
    Some(Dense { pose: joint.applied(pose, at), at: *at, joint })
}

/// Groups of distances.
const CONTOURS: usize = 0;
const SURFACES: usize = 1;

/// A number of the square of `side` mm in which (u, v) of a part lies.
fn block(part: usize, group: usize, uv: &Vector2<f64>, side: f64) -> u32 {
    let [i, j] = [uv.x, uv.y].map(|v| ((v / side).floor() as i32 + 64) as u32 & 127);
    (((part as u32 * 2 + group as u32) << 7 | i) << 7) | j
}

/// Vehicle coordinates of local ones, and directions.
struct ToVehicle {
    axes: Matrix3<f64>,
    origin: Vector3<f64>,
}

impl ToVehicle {
    fn new(template: &Template) -> Self {
        Self { axes: Matrix3::from_fn(|i, j| template.axes[j][i]), origin: template.point_mm.into() }
    }

    fn point(&self, local: &Vector3<f64>) -> Point3<frame::Vehicle> {
        Point3::new(self.origin + self.axes * local)
    }
}

fn contour(region: &Region<'_>, part: usize, rays: &[EdgeRay], distances: &mut Vec<Distance>) {
    let t = region.template;
    let taught = List::of(t.contour.iter().map(|p| (p.at(), p.normal())));
    let n = taught.len() as f64;
    let reach = taught.iter().map(|p| p.0.norm()).fold(0.0, f64::max) + CAPTURE_MM;
    let middle = taught.iter().map(|p| p.0).sum::<Vector2<f64>>() / n;
    let gyration = (taught.iter().map(|p| (p.0 - middle).norm_squared()).sum::<f64>() / n).sqrt();
    let to_vehicle = ToVehicle::new(t);
    for edge in &on_panel(rays, &region.patch, t.edge_depth_mm, reach) {
        let p = edge.point.position;
        let nearest = taught
            .iter()
            .filter(|(_, n)| n.dot(&edge.point.normal) > AGREEING)
            .map(|(q, n)| ((p - q).norm_squared(), q, n))
            .min_by(|a, b| a.0.total_cmp(&b.0));
        let Some((_, q, n)) = nearest.filter(|(d2, ..)| *d2 <= CAPTURE_MM * CAPTURE_MM) else { continue };
        let turn = (p - middle).perp(n) / gyration;
        let shared = [n.x, n.y, turn, 1.0, n.x * n.x - n.y * n.y, 2.0 * n.x * n.y];
        distances.push(Distance {
            at: to_vehicle.point(&Vector3::new(p.x, p.y, edge.w)).xyz,
            direction: to_vehicle.axes * n.push(0.0),
            mm: n.dot(&(p - q)),
            variance: edge.point.variance,
            group: CONTOURS,
            block: block(part, CONTOURS, &p, CONTOUR_BLOCK_MM),
            part,
            shared: shared.into_iter().enumerate().map(|(k, share)| (BIASES * part + k, share)).collect(),
        });
    }
}

fn surface(region: &Region<'_>, part: usize, distances: &mut Vec<Distance>) {
    let (t, radius) = (region.template, region.template.surface.radius_mm);
    let to_vehicle = ToVehicle::new(t);
    for cell in region.patch.cells.iter().filter(|c| c.uv.norm() <= radius) {
        let slope = region.surface.slope(&cell.uv);
        let long = (1.0 + slope.norm_squared()).sqrt();
        let shared = [1.0, cell.uv.x, cell.uv.y];
        let first = BIASES * part + OF_CONTOUR;
        distances.push(Distance {
            at: to_vehicle.point(&cell.uv.push(cell.w)).xyz,
            direction: to_vehicle.axes * Vector3::new(-slope.x, -slope.y, 1.0) / long,
            mm: (cell.w - region.surface.height(&cell.uv)) / long,
            variance: cell.variance / (long * long),
            group: SURFACES,
            block: block(part, SURFACES, &cell.uv, SURFACE_BLOCK_MM),
            part,
            shared: shared.into_iter().enumerate().map(|(k, share)| (first + k, share)).collect(),
        });
    }
}

/// Biases that are as large as this together, in sigmas, are none: the regions do not belong to one body as it was taught.
const CONTRADICTING: f64 = judge::SIGMAS;
/// The pose of the points and this one are of the same images: beyond so many sigmas one of them is wrong.
const DISAGREEING: f64 = 6.0;
/// The pose is still when a step moves it by less than this many of its sigmas: which points belong to the contours may
/// change with every step.
const STILL: f64 = 0.1;
const MAX_STEPS: usize = 8;

impl Run<'_, '_> {
    /// The pose of all regions whose features were located, from `pose` on, near which their `patches` were made; held against
    /// that of the points.
    pub(super) fn dense(
        &self,
        points: &Judged,
        mut pose: CameraFromVehicle,
        patches: &[Result<Patch, Code>],
        rays: &[EdgeRay],
    ) -> Result<Judged, Refused> {
        let m = self.cycle.measurer;
        let evidence = self.evidence();
        let at = evidence.iter().map(|e| e.feature.position().xyz).sum::<Vector3<f64>>() / evidence.len() as f64;
        let located: PerFeature<usize> = (0..self.located.len()).filter(|k| self.located[*k].is_ok()).collect();
        let mut still = None;
        for _ in 0..MAX_STEPS {
            let sites = sites(&m.templates, &m.near, &pose);
            let features = &m.vehicle.features;
            let region = |&k: &usize| {
                let shape = Shape::Taught(&m.surfaces[k], m.templates[k].surface.radius_mm);
                let patch = patches[k].as_ref().map_err(|code| *code)?.moved(sites[k].local, &shape)?;
                let located = self.located[k].as_ref().map_err(|code| *code)?;
                Ok(Region { feature: &features[k], template: &m.templates[k], surface: &m.surfaces[k], patch, located })
            };
            let regions = located.par_iter().map(region).collect::<Result<Vec<_>, Code>>();
            let regions = regions.map_err(|code| Self::refuse(code, "Found once, it was lost again."))?;
            let unfixed = || Self::refuse(Code::Residual, "The regions' contours and surfaces fix no pose.");
            let dense = step(&regions, rays, &pose, &at).ok_or_else(unfixed)?;
            pose = dense.pose;
            if dense.joint.motion.component_div(&dense.joint.covariance.diagonal().map(f64::sqrt)).amax() < STILL {
                still = Some(dense);
                break;
            }
        }
        let dense = still
            .ok_or_else(|| Self::refuse(Code::Residual, "The regions' contours and surfaces settle on no pose."))?;
        self.judged(&dense, &evidence, points)
    }

    fn judged(&self, dense: &Dense, evidence: &[Evidence<'_>], points: &Judged) -> Result<Judged, Refused> {
        let (pose, joint, at) = (dense.pose, &dense.joint, Point3::new(dense.at));
        let deviation = points.distance_deviation_mm;
        let refused = |code, detail| Refused { code, detail, distance_deviation_mm: Some(deviation) };
        if joint.biases_chi2 > CONTRADICTING * CONTRADICTING {
            let detail = format!(
                "the regions are {:.1} sigmas from the taught ones, allowed {CONTRADICTING}",
                joint.biases_chi2.sqrt()
            );
            return Err(refused(Code::Residual, detail));
        }
        let sigmas = disagreement(evidence, &pose, &at, &joint.covariance)
            .ok_or_else(|| refused(Code::TooFewFeatures, "the features' points determine no pose".into()))?;
        let apart_mm = (points.registration.a_from_b * at - pose * at).norm();
        if sigmas > DISAGREEING {
            let detail = format!("They are {apart_mm:.3} mm or {sigmas:.1} sigmas apart, allowed {DISAGREEING}.");
            return Err(refused(Code::DenseDisagrees, detail));
        }
        let residuals = List::of(evidence.iter().map(|e| pose.inverse() * e.located.point - e.feature.position()));
        let to_vehicle = *pose.r.inverse().matrix();
        let mut judged = Judged {
            covariance: joint.covariance + self.taught_covariance(&dense.at) + judge::common_mode(evidence, &pose),
            residual_rms_mm: judge::rms(&residuals),
            distance_deviation_mm: deviation,
            points_minus_dense_mm: Some(apart_mm),
            gain: joint.gain.iter().map(|gain| gain * to_vehicle).collect(),
            registration: Registration {
                a_from_b: pose,
                covariance: joint.covariance,
                at,
                residuals,
                chi2: joint.biases_chi2,
            },
        };
        let of_calibration = judged.response(evidence, |e| e.spread());
        judged.covariance += of_calibration * of_calibration.transpose();
        Ok(judged)
    }

    /// How well the vehicle's frame is known on the taught body, by the clicks and the body's tolerances: of `at`.
    fn taught_covariance(&self, at: &Vector3<f64>) -> Matrix6<f64> {
        let m = self.cycle.measurer;
        let pair = |(feature, t): (&Feature, &Template)| {
            let pose = t.taught_pose();
            let axes = t.local(&pose).axes;
            let body = Matrix3::identity() * feature.position_sigma_mm.powi(2);
            Pair {
                measured: pose * feature.position(),
                nominal: feature.position(),
                covariance: axes * t.covariance() * axes.transpose() + body,
            }
        };
        let pairs: PerFeature<_> = m.features().map(pair).collect();
        let registration = register(&pairs).expect("it was taught from these points");
        let mut to = Matrix6::identity();
        to.fixed_view_mut::<3, 6>(0, 0).copy_from(&motion_jacobian(at, &registration.at.xyz));
        to * registration.covariance * to.transpose()
    }
}

/// How far the points' pose, held against the taught body, lies from `pose` about `at`, in sigmas. What both share, clicks
/// and calibration, has no part in it. `None` where the points determine no pose.
fn disagreement(
    evidence: &[Evidence<'_>],
    pose: &CameraFromVehicle,
    at: &Point3<frame::Vehicle>,
    covariance: &Matrix6<f64>,
) -> Option<f64> {
    let pair = |e: &Evidence<'_>| Pair {
        measured: e.located.point,
        nominal: ToVehicle::new(e.template).point(&e.template.at_mm.into()),
        covariance: e.measured_covariance()
            + e.paint_covariance()
            + Matrix3::identity() * e.feature.position_sigma_mm.powi(2),
    };
    let points = register(&evidence.iter().map(pair).collect::<PerFeature<_>>()).ok()?;
    let between = pose.inverse() * points.a_from_b;
    let (shift, turn) = ((between * points.at) - points.at, between.r.scaled_axis());
    let off = Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z);
    let mut to = Matrix6::identity();
    to.fixed_view_mut::<3, 6>(0, 0).copy_from(&motion_jacobian(&points.at.xyz, &at.xyz));
    let sum = points.covariance + to * covariance * to.transpose();
    Some(off.dot(&(sum.cholesky()?.inverse() * off)).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_of_one_square_share_a_block_and_no_other_does() {
        let of = |part, group, u: f64, v: f64| block(part, group, &Vector2::new(u, v), 12.0);
        assert_eq!(of(1, 0, 0.1, -0.1), of(1, 0, 11.9, -11.9));
        let others = [of(0, 0, 0.1, -0.1), of(1, 1, 0.1, -0.1), of(1, 0, -0.1, -0.1), of(1, 0, 0.1, 0.1)];
        assert!(others.iter().all(|b| *b != of(1, 0, 0.1, -0.1)), "{others:?}");
    }
}
