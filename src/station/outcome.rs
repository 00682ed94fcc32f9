//! From a measurement to what the PLC is told. In: the measurement, its model. Out: units and places as the registers have them.
//! Not here: rounding; registers.

use crate::code::Code;
use crate::geometry::{Point3, Pose, frame};
use crate::measure::{Measurement, Verdict};
use crate::plc::{FeatureOutcome, Outcome, PoseOutcome, ResultCode, Trigger};
use crate::vehicle::VehicleFile;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// An outcome that says nothing yet.
pub(super) fn empty(result: ResultCode, code: Option<Code>, detail: u16, trigger: Trigger, job: u16) -> Outcome {
    Outcome {
        result,
        code,
        detail,
        trigger,
        job,
        pose: None,
        features: [None; 4],
        distance_deviation_mm: None,
        surface_vs_point_mm: None,
        depth_coverage: None,
        calibration_health_px: None,
        light: None,
        ambient: None,
        camera_celsius: None,
        projector_celsius: None,
        acquisition: None,
        total: None,
        taken_at_ms: 0,
        record: 0,
    }
}

/// What a measurement of `vehicle` comes to.
pub(super) fn outcome(m: &Measurement, vehicle: &VehicleFile, trigger: Trigger) -> Outcome {
    let result = match m.verdict {
        Verdict::Ok => ResultCode::Ok,
        Verdict::OutOfLimits => ResultCode::OutOfLimits,
        Verdict::TooUncertain => ResultCode::TooUncertain,
        Verdict::NotMeasurable | Verdict::Error => ResultCode::NotMeasurable,
    };
    let mut out = empty(result, m.code, 0, trigger, vehicle.job);
    out.pose = pose(m);
    let station_from_camera = station_from_camera(m);
    for (feature, nominal) in m.features.iter().zip(&vehicle.features) {
        out.features[nominal.class.index()] = Some(FeatureOutcome {
            code: feature.code,
            position_mm: feature
                .camera_mm
                .zip(station_from_camera)
                .map(|(p, pose)| (pose * Point3::<frame::Camera>::new(p.into())).xyz.into()),
            residual_mm: feature.residual_mm,
            score: feature.score,
        });
    }
    // the first feature that says why
    let to_blame = m.code.and_then(|code| m.features.iter().position(|f| f.code == Some(code)));
    let number = |k: usize| vehicle.features[k].class.index() as u16 + 1;
    out.detail = to_blame.map_or(0, number);
    out.distance_deviation_mm = m.distance_deviation_mm;
    out.surface_vs_point_mm = m.points_minus_dense_mm;
    out.depth_coverage = m.depth_coverage;
    out.calibration_health_px = m.calibration_health.as_ref().map(|h| h.epipolar_px);
    out
}

fn pose(m: &Measurement) -> Option<PoseOutcome> {
    if matches!(m.verdict, Verdict::NotMeasurable | Verdict::Error) {
        return None;
    }
    let (at, angles, u) = (m.reference_mm?, m.euler_deg?, m.uncertainty_k2.as_ref()?);
    Some(PoseOutcome {
        position_mm: [at.x, at.y, at.z],
        angles_deg: [angles.roll, angles.pitch, angles.yaw],
        u_position_mm: [u.x_mm, u.y_mm, u.z_mm],
        u_angles_deg: [u.roll_deg, u.pitch_deg, u.yaw_deg],
        u_target_mm: u.targets.iter().map(|t| t.mm).reduce(f64::max),
        residual_rms_mm: m.residual_rms_mm?,
    })
}

fn station_from_camera(m: &Measurement) -> Option<Pose<frame::Station, frame::Camera>> {
    let matrix = |p: &crate::measure::PoseMatrix| {
        let r = Matrix3::from_fn(|i, j| p.rotation[i][j]);
        (Rotation3::from_matrix_unchecked(r), Vector3::from(p.translation_mm))
    };
    let (r, t) = matrix(m.station_from_vehicle.as_ref()?);
    let station_from_vehicle = Pose::<frame::Station, frame::Vehicle>::new(r, t);
    let (r, t) = matrix(m.camera_from_vehicle.as_ref()?);
    Some(station_from_vehicle * Pose::<frame::Camera, frame::Vehicle>::new(r, t).inverse())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::{FeatureResult, Method, PoseMatrix, TargetUncertainty, Uncertainty, Xyz};

    fn measurement(verdict: Verdict) -> Measurement {
        let mut m = Measurement::without_pose(String::new(), verdict, None, String::new(), Method::Points);
        // camera z is the vehicle's y, 100 mm away; the station frame is 5 mm beside the vehicle's
        let r = [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]];
        m.camera_from_vehicle = Some(PoseMatrix { rotation: r, translation_mm: [0.0, 0.0, 100.0] });
        let one = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        m.station_from_vehicle = Some(PoseMatrix { rotation: one, translation_mm: [5.0, 0.0, 0.0] });
        m.reference_mm = Some(Xyz { x: 5.0, y: 0.0, z: 0.0 });
        m.euler_deg = Some(crate::measure::Euler { roll: 1.0, pitch: 2.0, yaw: 3.0 });
        let target = |name: &str, mm| TargetUncertainty { name: name.into(), mm };
        m.uncertainty_k2 = Some(Uncertainty {
            x_mm: 0.1,
            y_mm: 0.2,
            z_mm: 0.3,
            roll_deg: 0.01,
            pitch_deg: 0.02,
            yaw_deg: 0.03,
            targets: vec![target("a", 0.4), target("b", 0.6)],
        });
        m.residual_rms_mm = Some(0.05);
        m
    }

    fn vehicle() -> VehicleFile {
        let setup = crate::sim::Setup::new(0.25, 8);
        let body = crate::sim::Body::named("suv-a").expect("listed");
        let paint = crate::sim::Paint::named("white").expect("listed");
        let scene = crate::sim::Scene::new(body, paint, &crate::sim::Deviation::default());
        crate::sim::features(&scene, &setup).expect("in view")
    }

    #[test]
    fn a_pose_keeps_its_units_and_features_their_places() {
        let (vehicle, mut m) = (vehicle(), measurement(Verdict::Ok));
        m.features = vehicle.features.iter().map(|f| FeatureResult::unknown(&f.name)).collect();
        m.features[1].camera_mm = Some([10.0, 0.0, 120.0]);
        let out = outcome(&m, &vehicle, Trigger::default());
        let pose = out.pose.expect("ok");
        assert_eq!((pose.position_mm, pose.angles_deg), ([5.0, 0.0, 0.0], [1.0, 2.0, 3.0]));
        assert_eq!((pose.u_target_mm, pose.residual_rms_mm), (Some(0.6), 0.05));
        let at = out.features[1].and_then(|f| f.position_mm).expect("measured");
        let expected = [15.0, 20.0, 0.0];
        assert!(at.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{at:?}");
        assert_eq!(out.features[0].and_then(|f| f.position_mm), None);
    }

    #[test]
    fn what_is_not_measurable_has_no_pose_and_names_its_feature() {
        let (vehicle, mut m) = (vehicle(), measurement(Verdict::NotMeasurable));
        m.features = vehicle.features.iter().map(|f| FeatureResult::unknown(&f.name)).collect();
        (m.code, m.features[2].code) = (Some(Code::Ellipse), Some(Code::Ellipse));
        let out = outcome(&m, &vehicle, Trigger::default());
        assert_eq!((out.result, out.code, out.detail), (ResultCode::NotMeasurable, Some(Code::Ellipse), 3));
        assert_eq!(out.pose, None);
        for (verdict, result) in
            [(Verdict::OutOfLimits, ResultCode::OutOfLimits), (Verdict::TooUncertain, ResultCode::TooUncertain)]
        {
            let out = outcome(&measurement(verdict), &vehicle, Trigger::default());
            assert!(out.result == result && out.pose.is_some());
        }
    }
}
