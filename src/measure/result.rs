//! What a measurement says: the objects of `measure --json`, and one line for people.
//! An unknown number is `None` and becomes null, never 0; so does a number that is not finite.

use crate::calibrate::Health;
use crate::code::Code;
use crate::geometry::{EulerDeg, Pose};
use serde::Serialize;
use std::fmt::Write;

/// One capture's result; the order of the fields is that of the JSON object.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Measurement {
    /// The capture's name.
    pub capture: String,
    /// What it comes to.
    pub verdict: Verdict,
    /// Why, if it is not ok; none is 0 in JSON.
    #[serde(serialize_with = "code_or_zero")]
    pub code: Option<Code>,
    /// The same in a sentence; empty if ok.
    pub detail: String,
    /// How it was measured.
    pub method: Method,
    /// What the station frame is.
    pub station: Station,
    /// None if refused.
    pub camera_from_vehicle: Option<PoseMatrix>,
    /// None if refused.
    pub station_from_vehicle: Option<PoseMatrix>,
    /// The model's reference point in the station frame, less its taught position while `station` is taught.
    pub reference_mm: Option<Xyz>,
    /// Angles of `station_from_vehicle`.
    pub euler_deg: Option<Euler>,
    /// Order x, y, z (mm), rx, ry, rz (rad), of the motion described in the formats, in vehicle axes.
    pub covariance: Option<[[f64; 6]; 6]>,
    /// The point whose motion it is: the features' centroid, vehicle frame.
    pub covariance_at_mm: Option<[f64; 3]>,
    /// Expanded uncertainty, k = 2.
    pub uncertainty_k2: Option<Uncertainty>,
    /// Every feature of the model, as far as known.
    pub features: Vec<FeatureResult>,
    /// Of the fit of the features to the nominal points.
    pub residual_rms_mm: Option<f64>,
    /// The largest deviation of an inter-point distance from nominal.
    pub distance_deviation_mm: Option<f64>,
    /// Share of pixels with depth in the regions of interest, 0 to 1.
    pub depth_coverage: Option<f64>,
    /// Distance of the point pose from the dense pose.
    pub points_minus_dense_mm: Option<f64>,
    /// Whether camera and projector stand to each other as calibrated; none without fringes across the measuring axis.
    pub calibration_health: Option<Health>,
    /// How long it took.
    pub timing_ms: Timing,
    /// What went wrong and did not matter: for the log.
    #[serde(skip)]
    pub warning: Option<String>,
}

/// What a measurement comes to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// Measured, certain enough, inside the limits.
    Ok,
    /// Measured, but the vehicle stands outside the limits.
    OutOfLimits,
    /// Measured, but too uncertain.
    TooUncertain,
    /// Refused.
    NotMeasurable,
    /// The capture could not be read.
    Error,
}

impl Verdict {
    /// As in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ok => "ok",
            Self::OutOfLimits => "out-of-limits",
            Self::TooUncertain => "too-uncertain",
            Self::NotMeasurable => "not-measurable",
            Self::Error => "error",
        }
    }
}

/// How a pose is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// From the features' 3D positions.
    #[default]
    Points,
    /// From the whole surface.
    Dense,
    /// As the published method does it, for comparison.
    Published,
}

/// What the station frame is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Station {
    /// The vehicle frame of the taught capture: there is no datum survey yet.
    Taught,
    /// The calibration cell, by a datum survey.
    Surveyed,
}

/// A pose in plain numbers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PoseMatrix {
    /// Row by row.
    pub rotation: [[f64; 3]; 3],
    /// mm.
    pub translation_mm: [f64; 3],
}

impl<A, B> From<&Pose<A, B>> for PoseMatrix {
    fn from(p: &Pose<A, B>) -> Self {
        let m = p.r.matrix();
        Self { rotation: std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)])), translation_mm: p.t.into() }
    }
}

/// A position, mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the names say it")]
pub struct Xyz {
    pub x: f64,
    pub y: f64,
    pub z: f64,
}

/// ISO 8855 angles, degrees.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the names say it")]
pub struct Euler {
    pub roll: f64,
    pub pitch: f64,
    pub yaw: f64,
}

impl From<EulerDeg> for Euler {
    fn from(e: EulerDeg) -> Self {
        Self { roll: e.roll, pitch: e.pitch, yaw: e.yaw }
    }
}

/// Expanded uncertainties, k = 2: of the reference point, of the angles, and at the model's targets.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the names say it, with their units")]
pub struct Uncertainty {
    pub x_mm: f64,
    pub y_mm: f64,
    pub z_mm: f64,
    pub roll_deg: f64,
    pub pitch_deg: f64,
    pub yaw_deg: f64,
    pub targets: Vec<TargetUncertainty>,
}

/// Expanded uncertainty at a target of the model.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TargetUncertainty {
    /// The target's name.
    pub name: String,
    /// mm, k = 2.
    pub mm: f64,
}

/// One feature, as far as it was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FeatureResult {
    /// Its name in the model.
    pub name: String,
    /// Why it was not used; none is 0 in JSON.
    #[serde(serialize_with = "code_or_zero")]
    pub code: Option<Code>,
    /// Raw pixel in the red image.
    pub pixel: Option<[f64; 2]>,
    /// Camera frame, mm.
    pub camera_mm: Option<[f64; 3]>,
    /// Of `camera_mm`.
    pub covariance_mm2: Option<[[f64; 3]; 3]>,
    /// Distance from the nominal point in the measured pose.
    pub residual_mm: Option<f64>,
    /// How well the template matched, 0 to 1.
    pub score: Option<f64>,
    /// What proposed its region: "detector", "search" for the taught shape, or "pose": that of the other features.
    pub region: Option<&'static str>,
}

impl FeatureResult {
    /// A feature of which nothing is known yet.
    pub fn unknown(name: &str) -> Self {
        Self {
            name: name.into(),
            code: None,
            pixel: None,
            camera_mm: None,
            covariance_mm2: None,
            residual_mm: None,
            score: None,
            region: None,
        }
    }
}

/// Milliseconds by stage.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
#[expect(missing_docs, reason = "the stages' names")]
pub struct Timing {
    pub read: Option<f64>,
    pub detect: Option<f64>,
    pub decode: Option<f64>,
    pub surface: Option<f64>,
    pub contour: Option<f64>,
    pub pose: Option<f64>,
    pub total: Option<f64>,
}

impl Measurement {
    /// A result without a pose: refused (`NotMeasurable`, with a code) or unreadable (`Error`). The caller adds
    /// what is known of the features.
    pub fn without_pose(capture: String, verdict: Verdict, code: Option<Code>, detail: String, method: Method) -> Self {
        Self {
            capture,
            verdict,
            code,
            detail,
            method,
            station: Station::Taught,
            camera_from_vehicle: None,
            station_from_vehicle: None,
            reference_mm: None,
            euler_deg: None,
            covariance: None,
            covariance_at_mm: None,
            uncertainty_k2: None,
            features: Vec::new(),
            residual_rms_mm: None,
            distance_deviation_mm: None,
            depth_coverage: None,
            points_minus_dense_mm: None,
            calibration_health: None,
            timing_ms: Timing::default(),
            warning: None,
        }
    }
}

/// Results as `measure --json` prints them: an array, one object per line.
pub fn json(results: &[Measurement]) -> String {
    let one = |m: &Measurement| serde_json::to_string(m).expect("string keys only");
    format!("[{}]\n", results.iter().map(one).collect::<Vec<_>>().join(",\n "))
}

/// Results for people: a heading, one aligned line per capture, and one for the calibration's health where it is known.
pub fn table(results: &[Measurement]) -> String {
    let widest = results.iter().map(|m| m.capture.chars().count()).max().unwrap_or(0).max("capture".len());
    let mut out = format!(
        "{:widest$}  {:<14} {:>9} {:>9} {:>9} {:>8} {:>8} {:>8} {:>7} {:>7}  features\n",
        "capture", "verdict", "x mm", "y mm", "z mm", "roll °", "pitch °", "yaw °", "U mm", "rms mm"
    );
    for m in results {
        let number = |value: Option<f64>, digits: usize| value.map_or("–".into(), |v| format!("{v:.digits$}"));
        let (r, e) = (m.reference_mm, m.euler_deg);
        let worst = m.uncertainty_k2.as_ref().map(|u| u.x_mm.max(u.y_mm).max(u.z_mm));
        let status = |f: &FeatureResult| match (f.code, f.camera_mm) {
            (Some(code), _) => format!("{} {}", f.name, code.number()),
            (None, Some(_)) => format!("{} ok", f.name),
            (None, None) => format!("{} –", f.name),
        };
        let mut features = m.features.iter().map(status).collect::<Vec<_>>().join(", ");
        if let Some(mm) = m.points_minus_dense_mm {
            let _ = write!(features, " · points {mm:.3} mm off");
        }
        if !m.detail.is_empty() {
            let gap = if features.is_empty() { "" } else { " · " };
            features = format!("{features}{gap}{}", m.detail);
        }
        let _ = writeln!(
            out,
            "{:widest$}  {:<14} {:>9} {:>9} {:>9} {:>8} {:>8} {:>8} {:>7} {:>7}  {features}",
            m.capture,
            m.verdict.name(),
            number(r.map(|r| r.x), 3),
            number(r.map(|r| r.y), 3),
            number(r.map(|r| r.z), 3),
            number(e.map(|e| e.roll), 4),
            number(e.map(|e| e.pitch), 4),
            number(e.map(|e| e.yaw), 4),
            number(worst, 3),
            number(m.residual_rms_mm, 3),
        );
        if let Some(health) = &m.calibration_health {
            let _ = writeln!(out, "{:widest$}  {}", "", health.detail);
        }
    }
    out
}

fn code_or_zero<S: serde::Serializer>(code: &Option<Code>, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_u16(code.map_or(0, Code::number))
}
