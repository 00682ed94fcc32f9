//! From located features to a verdict. In: what was located, the model with its limits. Out: the pose with its full
//! covariance, or the code that says why there is none. Not here: images.
//!
//! The uncertainty is propagated, never read off the residual: three points fit any body of the right size.
//! The residual is a check of its own, and so are the panel's normals, which three points alone do not see.
//!
//! What the calibration's covariance says is propagated to the pose against the camera, whatever the station frame is: a
//! deviation from a pose taught with the same calibration is known better than stated, as its errors are shared.

use super::locate::Located;
use crate::calibrate::{Known, ParameterCovariance, PointJacobian};
use crate::code::Code;
use crate::geometry::{EulerDeg, Pair, Point3, Pose, Registration, frame, motion_jacobian, register};
use crate::vehicle::{Anchor, PerFeature, Template, VehicleFile};
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector3};

type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// What shifts a feature's edges from body to body and paint to paint beyond noise, 1 sigma, mm, along the panel:
/// reflections in the hem. Black against white paint in one pose: 0.01–0.06 mm.
pub(crate) const EDGE_BIAS_MM: f64 = 0.027;
/// How much more, times the share of the contour that is not seen: with 30 % hidden it is stated five and a half times
/// as large. An assumption: how much a hidden stretch spoils what is beside it was not measured.
const HIDDEN_BIAS: f64 = 15.0;
/// And how much more is stated where the opening has grown or shrunk against the taught one: as a share of that.
const HEM_BIAS: f64 = 0.7;
/// Where the opening has grown by more than it does under the paint it was taught on, mm, another paint moves corners
/// against it: by up to this many times what is beyond.
const SAME_PAINT_MM: f64 = 0.03;
const PAINT_DISTANCE: f64 = 1.5;
/// The same across the panel: fringe harmonics, defocus; and never nothing.
pub(crate) const NORMAL_BIAS_MM: f64 = 0.005;
/// Paint and light shift all features together along the panel, 1 sigma, mm: black against white in one pose 0.03.
pub(crate) const PAINT_SHIFT_MM: f64 = 0.01;
/// And more when the vehicle turns against the bars, mm per degree away from the taught attitude: what is left once edges
/// follow the light is 0.001 to 0.003 on the independent captures, and up to 0.004 on the simulated bodies.
pub(crate) const LIGHT_SHIFT_MM_PER_DEG: f64 = 0.003;
/// Residuals farther off than this many sigmas belong to another body.
pub(super) const SIGMAS: f64 = 9.0;
/// The same for distances, which what shifts all features together leaves alone.
const DISTANCE_SIGMAS: f64 = 6.0;
/// The panel's normal at a feature, against the taught one in the measured pose: flush to 0.5°.
const NORMAL_TILT_RAD: f64 = 0.009;
/// The same in the mean over the features, 0.15°: a pose that contradicts the surface by more would be a wrong one.
/// On good captures of two bodies it stays below 0.03°.
const COMMON_TILT_RAD: f64 = 0.0026;

/// A pose that passed every check, and what was computed on the way.
pub(crate) struct Judged {
    pub(crate) registration: Registration<frame::Camera, frame::Vehicle>,
    /// The registration's covariance with the common-mode terms and the calibration's, same convention.
    pub(crate) covariance: Matrix6<f64>,
    pub(crate) residual_rms_mm: f64,
    pub(crate) distance_deviation_mm: f64,
    /// How far the pose of the points lies from the one of everything, where there are both.
    pub(crate) points_minus_dense_mm: Option<f64>,
    /// Motion per shift of each located point, camera axes.
    pub(crate) gain: PerFeature<SMatrix<f64, 6, 3>>,
}

impl Judged {
    /// The motion of the pose when each located point is shifted by `shift`, camera axes; one column per error.
    pub(crate) fn response<const N: usize>(
        &self,
        evidence: &[Evidence<'_>],
        shift: impl Fn(&Evidence<'_>) -> SMatrix<f64, 3, N>,
    ) -> SMatrix<f64, 6, N> {
        evidence.iter().zip(&self.gain).map(|(e, gain)| gain * shift(e)).sum()
    }
}

/// Why there is no pose: a code, a sentence, and what is known all the same.
pub(crate) struct Refused {
    pub(crate) code: Code,
    pub(crate) detail: String,
    pub(crate) distance_deviation_mm: Option<f64>,
}

/// What shifts a feature's edges along the panel beyond noise, 1 sigma, mm.
pub(super) fn edge_bias_mm(located: &Located) -> f64 {
    // whatever hides a part of a contour also shades or blurs what is left beside it
    EDGE_BIAS_MM * (1.0 + HIDDEN_BIAS * (1.0 - located.share))
}

/// By how much another paint than the taught one has made contours grow, 1 sigma, mm.
pub(super) fn paint_growth_mm(located: &Located) -> f64 {
    HEM_BIAS * (located.growth_mm - SAME_PAINT_MM).max(0.0)
}

/// A located feature with what it is to be compared with.
#[derive(Clone, Copy)]
pub(crate) struct Evidence<'a> {
    pub(crate) feature: &'a crate::vehicle::Feature,
    pub(crate) template: &'a Template,
    pub(crate) located: &'a Located,
    /// The calibration's independent errors, zero where it states none.
    pub(crate) errors: &'a ParameterCovariance,
}

impl Evidence<'_> {
    /// Covariance of the located point without what calibration, teaching and body contribute, camera axes, mm².
    pub(super) fn measured_covariance(&self) -> Matrix3<f64> {
        let n = self.located.normal;
        let across = n * n.transpose();
        let edge_bias = edge_bias_mm(self.located);
        self.located.noise + (Matrix3::identity() - across) * edge_bias.powi(2) + across * NORMAL_BIAS_MM.powi(2)
    }

    /// What paint and light add to that, camera axes, mm². It counts in what is stated; held against the vehicle it would let
    /// a calibration pass that is off by as much, so that only what is surely paint widens the check of distances.
    pub(super) fn paint_covariance(&self) -> Matrix3<f64> {
        let n = self.located.normal;
        (Matrix3::identity() - n * n.transpose()) * (HEM_BIAS * self.located.growth_mm).powi(2)
    }

    /// How the located point follows the calibration's independent errors, camera axes, mm per sigma. Features share
    /// them: never a part of one feature's covariance.
    pub(super) fn spread(&self) -> PointJacobian {
        self.located.response * self.errors
    }

    /// Covariance of the located point with the calibration's part, camera axes, mm².
    pub(crate) fn located_covariance(&self) -> Matrix3<f64> {
        let spread = self.spread();
        self.measured_covariance() + self.paint_covariance() + spread * spread.transpose()
    }

    pub(crate) fn known(&self, pose: &CameraFromVehicle) -> Known {
        Known { pair: self.pair(pose), spread: self.spread() }
    }

    /// Covariance of the taught point on its panel and of the body, the same for every vehicle of the model, camera axes.
    fn model_covariance(&self, pose: &CameraFromVehicle) -> Matrix3<f64> {
        let axes = self.template.local(pose).axes;
        axes * self.template.covariance() * axes.transpose()
            + Matrix3::identity() * self.feature.position_sigma_mm.powi(2)
    }

    fn pair(&self, pose: &CameraFromVehicle) -> Pair<frame::Camera, frame::Vehicle> {
        Pair {
            measured: self.located.point,
            nominal: self.feature.position(),
            covariance: self.measured_covariance() + self.model_covariance(pose),
        }
    }
}

/// Registers the evidence; `pose` is near the truth and only turns covariances.
pub(crate) fn fit(
    evidence: &[Evidence<'_>],
    pose: &CameraFromVehicle,
) -> Result<Registration<frame::Camera, frame::Vehicle>, crate::geometry::NoPose> {
    register(&evidence.iter().map(|e| e.pair(pose)).collect::<PerFeature<_>>())
}

/// The checks and the covariance.
pub(crate) fn judge(
    evidence: &[Evidence<'_>],
    pose: &CameraFromVehicle,
    model: &VehicleFile,
) -> Result<Judged, Refused> {
    let refused = |code, detail, distance_deviation_mm| Refused { code, detail, distance_deviation_mm };
    let registration = fit(evidence, pose).map_err(|e| refused(Code::TooFewFeatures, e.to_string(), None))?;
    let pose = registration.a_from_b;

    let worst = distances(evidence, &pose, model)?;
    for e in evidence {
        let taught = e.located.taught_normal;
        let tilt = taught.cross(&e.located.normal).norm();
        if tilt > NORMAL_TILT_RAD {
            let detail = format!(
                "{}: the panel is tilted by {:.2}° against the taught one, allowed {:.2}°",
                e.feature.name,
                tilt.to_degrees(),
                NORMAL_TILT_RAD.to_degrees()
            );
            return Err(refused(Code::Residual, detail, Some(worst)));
        }
    }
    let tilt = common_tilt(evidence);
    if tilt.norm() > COMMON_TILT_RAD {
        let detail = format!(
            "the panel is tilted by {:.2}° against what the features' points say, allowed {:.2}°",
            tilt.norm().to_degrees(),
            COMMON_TILT_RAD.to_degrees()
        );
        return Err(refused(Code::DenseDisagrees, detail, Some(worst)));
    }
    if evidence.len() > 3 {
        leave_one_out(evidence, &pose).map_err(|detail| refused(Code::Residual, detail, Some(worst)))?;
    } else {
        let spreads: PerFeature<_> = evidence.iter().map(Evidence::spread).collect();
        let chi2 = registration.chi2_granting(&pairs(evidence, &registration), &spreads);
        if chi2 > SIGMAS * SIGMAS {
            let detail = format!("the features are {:.1} sigmas from nominal, allowed {SIGMAS}", chi2.sqrt());
            return Err(refused(Code::Residual, detail, Some(worst)));
        }
    }

    let painted: PerFeature<_> = evidence
        .iter()
        .map(|e| {
            let pair = e.pair(&pose);
            Pair { covariance: pair.covariance + e.paint_covariance(), ..pair }
        })
        .collect();
    let stated = register(&painted).map_err(|e| refused(Code::TooFewFeatures, e.to_string(), Some(worst)))?;
    let gain = (0..evidence.len()).map(|k| {
        let only = |i: usize| if i == k { Matrix3::identity() } else { Matrix3::zeros() };
        registration
            .response(&pairs(evidence, &registration), &(0..evidence.len()).map(only).collect::<PerFeature<_>>())
    });
    let mut judged = Judged {
        covariance: stated.covariance + common_mode(evidence, &pose),
        residual_rms_mm: rms(&registration.residuals),
        distance_deviation_mm: worst,
        points_minus_dense_mm: None,
        gain: gain.collect(),
        registration,
    };
    let of_calibration = judged.response(evidence, |e| e.spread());
    judged.covariance += of_calibration * of_calibration.transpose();
    Ok(judged)
}

pub(super) fn rms(residuals: &[Vector3<f64>]) -> f64 {
    (residuals.iter().map(Vector3::norm_squared).sum::<f64>() / residuals.len() as f64).sqrt()
}

/// The largest deviation of a distance from nominal, mm, or the refusal. Distances need no pose, so no pose can hide them;
/// `pose` only turns covariances.
fn distances(evidence: &[Evidence<'_>], pose: &CameraFromVehicle, model: &VehicleFile) -> Result<f64, Refused> {
    let mut worst = 0f64;
    let mut too_far: Option<String> = None;
    for (i, a) in evidence.iter().enumerate() {
        for b in &evidence[..i] {
            let measured = a.located.point - b.located.point;
            let nominal = (a.feature.position() - b.feature.position()).norm();
            let deviation = measured.norm() - nominal;
            let along = measured.normalize();
            let of_calibration = a.spread() - b.spread();
            let of_model =
                a.model_covariance(pose) + b.model_covariance(pose) + of_calibration * of_calibration.transpose();
            let of_measuring = a.measured_covariance() + b.measured_covariance();
            let sigma = |m: Matrix3<f64>| along.dot(&(m * along)).sqrt();
            let of_paint = PAINT_DISTANCE * (a.located.growth_mm - SAME_PAINT_MM).max(0.0);
            let between = || format!("{} to {}: {:+.3} mm", b.feature.name, a.feature.name, deviation);
            // what is not known of the taught points and the calibration cannot be held against the vehicle
            if deviation.abs() > model.limits.distance_mm + 3.0 * sigma(of_model) {
                let detail = || format!("{} from nominal, allowed ±{} mm", between(), model.limits.distance_mm);
                too_far.get_or_insert_with(detail);
            } else if deviation.abs() > DISTANCE_SIGMAS * sigma(of_model + of_measuring) + of_paint {
                let allowed = DISTANCE_SIGMAS * sigma(of_model + of_measuring) + of_paint;
                let share = format_args!("{DISTANCE_SIGMAS} sigmas and the paint's share are {allowed:.3} mm");
                too_far.get_or_insert_with(|| format!("{} from nominal, {share}", between()));
            }
            worst = worst.max(deviation.abs());
        }
    }
    match too_far {
        Some(detail) => Err(Refused { code: Code::Distances, detail, distance_deviation_mm: Some(worst) }),
        None => Ok(worst),
    }
}

/// The motion of `registration`'s pose when each located point is shifted by `shift`, camera axes; one column per error.
fn response<const N: usize>(
    evidence: &[Evidence<'_>],
    registration: &Registration<frame::Camera, frame::Vehicle>,
    shift: impl Fn(&Evidence<'_>) -> SMatrix<f64, 3, N>,
) -> SMatrix<f64, 6, N> {
    registration.response(&pairs(evidence, registration), &evidence.iter().map(shift).collect::<PerFeature<_>>())
}

fn pairs(
    evidence: &[Evidence<'_>],
    registration: &Registration<frame::Camera, frame::Vehicle>,
) -> PerFeature<Pair<frame::Camera, frame::Vehicle>> {
    evidence.iter().map(|e| e.pair(&registration.a_from_b)).collect()
}

/// How the panel as a whole is turned against the taught one in the pose that the points make: the mean over the
/// features, camera axes, rad. Three points fit any plane; their distances do not see one of them rise out of it.
fn common_tilt(evidence: &[Evidence<'_>]) -> Vector3<f64> {
    let tilt = |e: &Evidence<'_>| {
        let taught = e.located.taught_normal;
        taught.cross(&e.located.normal)
    };
    evidence.iter().map(tilt).sum::<Vector3<f64>>() / evidence.len() as f64
}

/// Each feature against the pose of the others.
fn leave_one_out(evidence: &[Evidence<'_>], pose: &CameraFromVehicle) -> Result<(), String> {
    let mut worst = (0.0, 0.0, "");
    for k in 0..evidence.len() {
        let rest: PerFeature<_> = evidence.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, e)| *e).collect();
        let Ok(others) = fit(&rest, pose) else { continue }; // the rest lies on a line: nothing to say
        let pair = evidence[k].pair(pose);
        let residual = others.a_from_b.inverse() * pair.measured - pair.nominal;
        let j = motion_jacobian(&pair.nominal.xyz, &others.at.xyz);
        let r = others.a_from_b.r;
        // the calibration's errors move this one and the others together
        let apart = r.inverse() * evidence[k].spread() - j * response(&rest, &others, |e| e.spread());
        let covariance =
            r.inverse() * pair.covariance * r + j * others.covariance * j.transpose() + apart * apart.transpose();
        let Some(inverse) = covariance.try_inverse() else { continue };
        let sigmas = residual.dot(&(inverse * residual)).sqrt();
        if sigmas > worst.0 {
            worst = (sigmas, residual.norm(), &evidence[k].feature.name);
        }
    }
    let (sigmas, mm, name) = worst;
    if sigmas > SIGMAS {
        return Err(format!(
            "{name} is {mm:.3} mm or {sigmas:.1} sigmas from where the others put it, allowed {SIGMAS}"
        ));
    }
    Ok(())
}

/// Shift of all features together with the light's direction: translation along the panel.
pub(super) fn common_mode(evidence: &[Evidence<'_>], pose: &CameraFromVehicle) -> Matrix6<f64> {
    let mut out = Matrix6::zeros();
    if let Some(e) = evidence.first() {
        let turn = pose.r.inverse() * e.template.taught_pose().r;
        let degrees = turn.scaled_axis().norm().to_degrees();
        let axes = e.template.axes;
        for axis in &axes[..2] {
            let axis = Vector3::from(*axis);
            let shift = axis * axis.transpose() * (PAINT_SHIFT_MM.powi(2) + (LIGHT_SHIFT_MM_PER_DEG * degrees).powi(2));
            let mut block = out.fixed_view_mut::<3, 3>(0, 0);
            block += shift;
        }
    }
    out
}

/// Covariance of a point `p` of the vehicle (vehicle axes, mm²), given that of the motion at `at`.
pub(crate) fn point_covariance(
    covariance: &Matrix6<f64>,
    at: &Point3<frame::Vehicle>,
    p: &Vector3<f64>,
) -> Matrix3<f64> {
    let j = motion_jacobian(p, &at.xyz);
    j * covariance * j.transpose()
}

/// Limits that the measured pose passes: what of the station's or the uncertainty's is exceeded.
pub(crate) fn exceeded(
    judged: &Judged,
    model: &VehicleFile,
    moved: &Vector3<f64>,
    angles: &EulerDeg,
) -> Option<(super::Verdict, Code, String)> {
    let l = &model.limits;
    let translation = judged.covariance.fixed_view::<3, 3>(0, 0).into_owned();
    let rotation = judged.covariance.fixed_view::<3, 3>(3, 3).into_owned();
    let k2 = |m: Matrix3<f64>| 2.0 * m.symmetric_eigenvalues().max().max(0.0).sqrt();
    let (mm, deg) = (k2(translation), k2(rotation).to_degrees());
    if !(mm <= l.uncertainty_k2_mm && deg <= l.uncertainty_k2_deg) {
        let detail = format!(
            "U(k=2) is {mm:.3} mm and {deg:.4}° at the features, allowed {} mm and {}°",
            l.uncertainty_k2_mm, l.uncertainty_k2_deg
        );
        return Some((super::Verdict::TooUncertain, Code::Uncertain, detail));
    }
    let limits = [
        ("x", moved.x, l.x_mm, "mm"),
        ("y", moved.y, l.y_mm, "mm"),
        ("z", moved.z, l.z_mm, "mm"),
        ("roll", angles.roll, l.roll_deg, "°"),
        ("pitch", angles.pitch, l.pitch_deg, "°"),
        ("yaw", angles.yaw, l.yaw_deg, "°"),
    ];
    let (name, value, limit, unit) = limits.into_iter().find(|(_, v, l, _)| v.abs() > *l)?;
    let detail =
        format!("{name} = {value:+.2} {unit} at the features against the taught pose, allowed ±{limit} {unit}");
    Some((super::Verdict::OutOfLimits, Code::OutOfLimits, detail))
}

/// Whether a template's place along its own contour is weak.
pub(crate) fn slides(template: &Template) -> bool {
    matches!(template.anchor, Anchor::ArchTop { .. })
}
