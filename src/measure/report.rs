//! What a finished run says: the measurement with every number it knows, and what to draw.
//! In:  the judged pose or the refusal, and the features. Out: a `Measurement` and a `Drawing`.

use super::cycle::{Run, contour_windows};
use super::judge::{self, Evidence, Judged, Refused};
use super::{Drawing, FeatureResult, Measurement, Station, TargetUncertainty, Uncertainty, Verdict, Xyz};
use crate::geometry::{EulerDeg, Point3, frame};
use crate::lent::List;
use nalgebra::Vector3;

impl Run<'_, '_> {
    pub(super) fn report(&self, outcome: Result<Judged, Refused>) -> Measurement {
        let c = self.cycle;
        let m = c.measurer;
        let mut out = match outcome {
            Ok(judged) => self.measured(&judged),
            Err(refused) => {
                let detail = format!("{} {}", refused.code.entry().sentence, refused.detail);
                let mut out = Measurement::without_pose(
                    c.capture.name(),
                    Verdict::NotMeasurable,
                    Some(refused.code),
                    detail.trim_end().into(),
                    m.method,
                );
                out.distance_deviation_mm = refused.distance_deviation_mm;
                out.features = self.features(None);
                out
            }
        };
        out.depth_coverage = self.coverage;
        out.station = m.station();
        out
    }

    pub(super) fn measured(&self, judged: &Judged) -> Measurement {
        let c = self.cycle;
        let (m, model) = (c.measurer, &c.measurer.vehicle);
        let camera_from_vehicle = judged.registration.a_from_b;
        let station_from_vehicle = m.station_from_camera() * camera_from_vehicle;
        let reference = Point3::<frame::Vehicle>::new(Vector3::from(model.reference_mm));
        let at = judged.registration.at;
        // until there is a datum survey the station frame is the taught vehicle's: what counts is the deviation
        let mut shown = (station_from_vehicle * reference).xyz;
        if m.station() == Station::Taught {
            shown -= reference.xyz;
        }
        let angles = EulerDeg::from_rotation(&station_from_vehicle.r);
        let taught = m.templates[0].taught_pose().inverse() * camera_from_vehicle;
        let moved = (taught * at) - at;
        let turned = EulerDeg::from_rotation(&taught.r);
        let (verdict, code, detail) = match judge::exceeded(judged, model, &moved, &turned) {
            Some((verdict, code, detail)) => (verdict, Some(code), detail),
            None => (Verdict::Ok, None, String::new()),
        };
        let mut out = Measurement::without_pose(c.capture.name(), verdict, code, detail, m.method);
        let r = station_from_vehicle.r;
        let at_reference = r * judge::point_covariance(&judged.covariance, &at, &reference.xyz) * r.inverse();
        let u = |variance: f64| 2.0 * variance.max(0.0).sqrt();
        let rotation = judged.covariance.fixed_view::<3, 3>(3, 3).into_owned();
        let targets = model.targets.iter().map(|t| {
            let spread = judge::point_covariance(&judged.covariance, &at, &Vector3::from(t.position_mm));
            TargetUncertainty { name: t.name.clone(), mm: u(spread.symmetric_eigenvalues().max()) }
        });
        out.uncertainty_k2 = Some(Uncertainty {
            x_mm: u(at_reference[(0, 0)]),
            y_mm: u(at_reference[(1, 1)]),
            z_mm: u(at_reference[(2, 2)]),
            roll_deg: u(rotation[(0, 0)]).to_degrees(),
            pitch_deg: u(rotation[(1, 1)]).to_degrees(),
            yaw_deg: u(rotation[(2, 2)]).to_degrees(),
            targets: targets.collect(),
        });
        out.camera_from_vehicle = Some((&camera_from_vehicle).into());
        out.station_from_vehicle = Some((&station_from_vehicle).into());
        out.reference_mm = Some(Xyz { x: shown.x, y: shown.y, z: shown.z });
        out.euler_deg = Some(angles.into());
        out.covariance = Some(std::array::from_fn(|i| std::array::from_fn(|j| judged.covariance[(i, j)])));
        out.covariance_at_mm = Some(at.xyz.into());
        out.residual_rms_mm = Some(judged.residual_rms_mm);
        out.distance_deviation_mm = Some(judged.distance_deviation_mm);
        out.points_minus_dense_mm = judged.points_minus_dense_mm;
        out.features = self.features(Some(judged));
        out
    }

    pub(super) fn features(&self, judged: Option<&Judged>) -> Vec<FeatureResult> {
        let m = self.cycle.measurer;
        let camera = &m.calibration.rig.camera;
        let mut residuals = judged.map(|j| j.registration.residuals.iter());
        m.vehicle
            .features
            .iter()
            .enumerate()
            .map(|(k, feature)| {
                let mut out = FeatureResult::unknown(&feature.name);
                if let Ok(region) = &self.cycle.regions[k] {
                    out.score = Some(region.score);
                    out.region = Some(if region.by_detector { "detector" } else { "search" });
                    out.pixel = Some(region.pixel.into());
                }
                match self.located.get(k) {
                    Some(Ok(located)) => {
                        let evidence = Evidence { feature, template: &m.templates[k], located, errors: &m.errors };
                        let covariance = evidence.located_covariance();
                        out.pixel = camera.project(&located.point.xyz).map(Into::into);
                        out.camera_mm = Some(located.point.xyz.into());
                        out.covariance_mm2 = Some(std::array::from_fn(|i| std::array::from_fn(|j| covariance[(i, j)])));
                        out.residual_mm = residuals.as_mut().and_then(Iterator::next).map(|r| r.norm());
                        out.score = out.score.or(Some(located.share));
                        out.region = out.region.or(Some("pose"));
                    }
                    Some(Err(code)) => out.code = Some(*code),
                    None => {}
                }
                out
            })
            .collect()
    }

    pub(super) fn drawing(&self) -> Drawing {
        let m = self.cycle.measurer;
        let pose = self.pose.or(self.cycle.first_pose);
        Drawing {
            regions: List::of(pose.map(|p| contour_windows(m, &p, 0.0)).into_iter().flatten()),
            contours: List::of(self.located.iter().flatten().flat_map(|l| l.contour.iter().copied())),
        }
    }
}
