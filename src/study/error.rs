//! How far a measured pose is from the true one.
//! In:  a measurement, the true pose. Out: the motion between the two, its parts, whether it makes a wrong pose.
//! Not here: where truth comes from.

use crate::geometry::{Point3, Pose, frame};
use crate::measure::Measurement;
use crate::vehicle::Target;
use nalgebra::{Matrix3, Matrix6, Rotation3, Vector3, Vector6};

/// Where a vehicle stands.
pub type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// A wrong pose is off by more than this at the features' centroid, mm, or in yaw, degrees, or by more than twice its
/// stated U (k = 2) at a target.
pub const WRONG_MM: f64 = 0.5;
/// See there.
pub const WRONG_YAW_DEG: f64 = 0.15;

/// The measured pose; none where it was refused.
pub fn pose(m: &Measurement) -> Option<CameraFromVehicle> {
    let p = m.camera_from_vehicle?;
    let r = Matrix3::from_fn(|i, j| p.rotation[i][j]);
    Some(Pose::new(Rotation3::from_matrix_unchecked(r), p.translation_mm.into()))
}

/// The motion inverse(true)·measured in vehicle axes, by which a measured pose is off. None: no pose.
pub fn motion(m: &Measurement, truth: &CameraFromVehicle) -> Option<Pose<frame::Vehicle, frame::Vehicle>> {
    Some(truth.inverse() * pose(m)?)
}

/// Error of a measured pose, vehicle axes: x, y, z (mm) by which that motion moves the point that the covariance is of, the
/// features' centroid, and its rotation vector (rad). None: no pose.
pub fn error(m: &Measurement, truth: &CameraFromVehicle) -> Option<Vector6<f64>> {
    let motion = motion(m, truth)?;
    let at = Point3::new(Vector3::from(m.covariance_at_mm?));
    let (t, r) = ((motion * at) - at, motion.r.scaled_axis());
    Some(Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z))
}

/// The stated covariance of [`error`]. None: no pose.
pub fn covariance(m: &Measurement) -> Option<Matrix6<f64>> {
    m.covariance.map(|c| Matrix6::from_fn(|i, j| c[i][j]))
}

/// Error over stated sigma, axis by axis. None: no pose.
pub fn over_sigma(error: &Vector6<f64>, m: &Measurement) -> Option<Vector6<f64>> {
    Some(error.component_div(&covariance(m)?.diagonal().map(f64::sqrt)))
}

/// By how much a measured pose is off at `p` of the vehicle, mm. None: no pose.
pub fn at_target(m: &Measurement, truth: &CameraFromVehicle, p: [f64; 3]) -> Option<Vector3<f64>> {
    let p = Point3::new(Vector3::from(p));
    Some((motion(m, truth)? * p) - p)
}

/// Whether a pose is off by more than twice its stated U (k = 2) at one of the vehicle model's `targets`.
pub fn beyond_stated(m: &Measurement, truth: &CameraFromVehicle, targets: &[Target]) -> bool {
    let Some(u) = &m.uncertainty_k2 else { return false };
    let stated = |name: &str| u.targets.iter().find(|t| t.name == name).map_or(0.0, |t| t.mm);
    let beyond = |t: &Target| at_target(m, truth, t.position_mm).is_some_and(|d| d.norm() > 2.0 * stated(&t.name));
    targets.iter().any(beyond)
}

/// Whether a pose is a wrong one. `targets`: those of the vehicle model.
pub fn is_wrong(m: &Measurement, truth: &CameraFromVehicle, targets: &[Target]) -> bool {
    let Some(e) = error(m, truth) else { return false };
    beyond_stated(m, truth, targets)
        || e.fixed_rows::<3>(0).norm() > WRONG_MM
        || e[5].abs().to_degrees() > WRONG_YAW_DEG
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::{Method, PoseMatrix, TargetUncertainty, Uncertainty, Verdict};

    fn measured(at: CameraFromVehicle) -> Measurement {
        let u = |mm| Uncertainty {
            x_mm: 0.1,
            y_mm: 0.1,
            z_mm: 0.1,
            roll_deg: 0.1,
            pitch_deg: 0.1,
            yaw_deg: 0.1,
            targets: vec![TargetUncertainty { name: "radar".into(), mm }],
        };
        Measurement {
            camera_from_vehicle: Some(PoseMatrix::from(&at)),
            covariance: Some(std::array::from_fn(|i| std::array::from_fn(|j| if i == j { 0.01 } else { 0.0 }))),
            covariance_at_mm: Some([-2600.0, 870.0, 740.0]),
            uncertainty_k2: Some(u(0.8)),
            ..Measurement::without_pose("a".into(), Verdict::Ok, None, String::new(), Method::Points)
        }
    }

    #[test]
    fn a_turn_about_the_centroid_shows_at_targets_only() {
        let truth = CameraFromVehicle::new(Rotation3::from_euler_angles(1.6, 0.02, 3.1), Vector3::new(5.0, 6.0, 700.0));
        let at = Vector3::new(-2600.0, 870.0, 740.0);
        let turned = |deg: f64| {
            let r = Rotation3::from_axis_angle(&Vector3::z_axis(), deg.to_radians());
            measured(truth * Pose::<frame::Vehicle, frame::Vehicle>::new(r, at - r * at))
        };
        let targets = [Target { name: "radar".into(), position_mm: [900.0, 0.0, 500.0] }];
        let e = error(&turned(0.02), &truth).expect("a pose");
        assert!(e.fixed_rows::<3>(0).norm() < 1e-9 && (e[5].to_degrees() - 0.02).abs() < 1e-9, "{e}");
        assert!((over_sigma(&e, &turned(0.02)).expect("a pose")[5] - 0.02f64.to_radians() / 0.1).abs() < 1e-9);
        // 0.02° at 3.6 m are 1.26 mm, 0.03° 1.9: more than twice 0.8 mm
        let off = at_target(&turned(0.02), &truth, targets[0].position_mm).expect("a pose").norm();
        assert!((off - 1.26).abs() < 0.01, "{off}");
        assert!(!is_wrong(&turned(0.02), &truth, &targets) && is_wrong(&turned(0.03), &truth, &targets));
        assert!(beyond_stated(&turned(0.03), &truth, &targets) && !beyond_stated(&turned(0.2), &truth, &[]));
        assert!(!is_wrong(&turned(0.1), &truth, &[]) && is_wrong(&turned(0.16), &truth, &[]));
    }
}
