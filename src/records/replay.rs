//! Kept captures measured again with the present program. In: a record and its capture. Out: both measurements, and by
//! how much they differ. Calibration and vehicle model are those kept with the capture, or others that are given; the
//! detector is given.

use super::report::{numbers, parsed, shown};
use super::{CAPTURES, Event, Record, Reference, capture_name};
use crate::calibrate::Calibration;
use crate::capture::Capture;
use crate::detect::Detector;
use crate::measure::{Measurement, Measurer, measure};
use crate::vehicle::VehicleFile;
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::Path;
use std::sync::Arc;

/// A version of datum reproduces another's pose within so much: mm along each axis, degrees about each.
pub const REPRODUCED: (f64, f64) = (0.005, 0.001);

/// What is measured by; calibration and model where they are not those kept with the capture.
#[derive(Clone, Default)]
pub struct With {
    /// The calibration.
    pub calibration: Option<Calibration>,
    /// The vehicle model.
    pub vehicle: Option<VehicleFile>,
    /// What proposes the regions; none: they are searched for.
    pub detector: Option<Arc<Detector>>,
    /// Uses the calibration for captures that are binned by a common factor.
    pub scale_calibration: bool,
}

/// A capture measured again.
#[derive(Clone, Debug, PartialEq)]
pub struct Replayed {
    /// Its record's id.
    pub record: u64,
    /// The vehicle's.
    pub vin: String,
    /// The program that measured it then.
    pub software: String,
    /// What was measured then, the object of `measure --json`; null if measuring was not come to.
    pub before: Value,
    /// What is measured now.
    pub now: Measurement,
}

impl Replayed {
    /// Now less then: x, y, z in mm; roll, pitch, yaw in degrees, the short way round. None without both poses.
    pub fn difference(&self) -> Option<[f64; 6]> {
        let (p, e) = (self.now.reference_mm?, self.now.euler_deg?);
        let now = [p.x, p.y, p.z, e.roll, e.pitch, e.yaw];
        let mut difference = [0.0; 6];
        for (k, (now, before)) in now.into_iter().zip(numbers(&self.before)).enumerate() {
            let d = now - before?;
            difference[k] = if k < 3 { d } else { d - 360.0 * (d / 360.0).round() };
        }
        Some(difference)
    }

    /// Verdict and code are as they were.
    pub fn same_verdict(&self) -> bool {
        self.before_verdict() == (self.now.verdict.name(), self.now.code.map_or(0, |c| c.number().into()))
    }

    /// Verdict and code are as they were, and each coordinate within [`REPRODUCED`], if there was a pose.
    pub fn reproduced(&self) -> bool {
        let within =
            |d: [f64; 6]| d.iter().enumerate().all(|(k, d)| d.abs() <= if k < 3 { REPRODUCED.0 } else { REPRODUCED.1 });
        let had_none = numbers(&self.before).iter().any(Option::is_none);
        self.same_verdict() && self.difference().map_or(had_none && self.now.euler_deg.is_none(), within)
    }

    fn before_verdict(&self) -> (&str, u64) {
        (self.before["verdict"].as_str().unwrap_or("–"), self.before["code"].as_u64().unwrap_or(0))
    }
}

/// Measures the kept capture of `record` in the records' `folder` again. None if it has none, or has none any more.
pub fn replay(folder: &Path, record: &Record, with: &With) -> anyhow::Result<Option<Replayed>> {
    let Event::Vehicle(vehicle) = &record.event else { return Ok(None) };
    let folder = folder.join(CAPTURES).join(capture_name(record.id));
    if !vehicle.images || !folder.is_dir() {
        return Ok(None);
    }
    let capture = Capture::open(&folder)?;
    let calibration = with.calibration.clone().map_or_else(|| Reference::calibration(&folder), Ok)?;
    let model = with.vehicle.clone().map_or_else(|| Reference::vehicle(&folder), Ok)?;
    let (c, p) = (&capture.camera, &capture.projector);
    let calibration = calibration.for_sizes((c.width, c.height), (p.width, p.height), with.scale_calibration)?;
    let measurer = Measurer::new(calibration, model)?.with_detector(with.detector.clone());
    let (now, _drawing) = measure(&measurer, &capture, &mut |_| {})?;
    let (vin, software, before) = (vehicle.vin.clone(), record.software.clone(), parsed(vehicle));
    Ok(Some(Replayed { record: record.id, vin, software, before, now }))
}

/// For people: one line per capture, differences in µm and 0.001°.
pub fn replay_table(all: &[Replayed]) -> String {
    let mut out = format!(
        "{:>8}  {:<17} {:<8} {:<32} {:>7} {:>7} {:>7} {:>8} {:>8} {:>8}\n",
        "record", "VIN", "by", "verdict", "x µm", "y µm", "z µm", "roll m°", "pitch m°", "yaw m°"
    );
    for r in all {
        let (verdict, code) = r.before_verdict();
        let coded = |name: &str, code: u64| if code == 0 { name.to_owned() } else { format!("{name} {code}") };
        let (before, now) =
            (coded(verdict, code), coded(r.now.verdict.name(), r.now.code.map_or(0, |c| c.number().into())));
        let verdict = if r.same_verdict() { now } else { format!("{before} → {now}") };
        let d = r.difference().map(|d| d.map(|d| format!("{:+.0}", (1000.0 * d).round() + 0.0)));
        let d = d.unwrap_or_else(|| std::array::from_fn(|_| "–".into()));
        let _ = writeln!(
            out,
            "{:>8}  {:<17} {:<8} {verdict:<32} {:>7} {:>7} {:>7} {:>8} {:>8} {:>8}",
            r.record,
            shown(&r.vin),
            r.software,
            d[0],
            d[1],
            d[2],
            d[3],
            d[4],
            d[5]
        );
    }
    out
}

/// For programs: an array, one object per capture.
pub fn replay_json(all: &[Replayed]) -> String {
    let one = |r: &Replayed| {
        let keys = ["x_um", "y_um", "z_um", "roll_mdeg", "pitch_mdeg", "yaw_mdeg"];
        let difference = r.difference().map(|d| keys.into_iter().zip(d.map(|d| 1000.0 * d)).collect::<Vec<_>>());
        let difference =
            difference.map_or(Value::Null, |d| d.into_iter().map(|(k, d)| (k.to_owned(), json!(d))).collect());
        json!({
            "record": r.record, "vin": r.vin, "software": r.software, "same_verdict": r.same_verdict(),
            "difference": difference, "before": r.before, "now": r.now,
        })
        .to_string()
    };
    format!("[{}]\n", all.iter().map(one).collect::<Vec<_>>().join(",\n "))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::code::Code;
    use crate::measure::{Euler, Method, Verdict, Xyz};

    fn replayed(before: Value) -> Replayed {
        let now = Measurement {
            reference_mm: Some(Xyz { x: 1.0, y: 2.0, z: 3.0 }),
            euler_deg: Some(Euler { roll: 0.0, pitch: 0.0, yaw: -179.9995 }),
            ..Measurement::without_pose("a".into(), Verdict::Ok, None, String::new(), Method::Points)
        };
        Replayed { record: 3, vin: "V".into(), software: "0.1.0".into(), before, now }
    }

    #[test]
    fn differences_are_now_less_then_and_angles_go_the_short_way_round() {
        let before = json!({"verdict": "ok", "code": 0, "reference_mm": {"x": 1.001, "y": 2.0, "z": 2.9876},
            "euler_deg": {"roll": 0.0, "pitch": 0.001, "yaw": 179.9985}});
        let r = replayed(before);
        let line = replay_table(std::slice::from_ref(&r));
        let fields: Vec<_> = line.lines().nth(1).expect("one capture").split_whitespace().collect();
        assert_eq!(fields, ["3", "V", "0.1.0", "ok", "-1", "+0", "+12", "+0", "-1", "+2"]);
        assert!(r.same_verdict());
    }

    #[test]
    fn a_pose_is_reproduced_within_5_um_and_a_thousandth_of_a_degree() {
        let before = |x: f64, yaw: f64| {
            replayed(json!({"verdict": "ok", "code": 0, "reference_mm": {"x": x, "y": 2.0, "z": 3.0},
                "euler_deg": {"roll": 0.0, "pitch": 0.0, "yaw": yaw}}))
        };
        assert!(before(1.0049, 179.9999).reproduced());
        assert!(!before(1.0051, 179.9999).reproduced());
        assert!(!before(1.0, 179.9994).reproduced());
        let refused = |now: Measurement| Replayed {
            now,
            ..replayed(json!({"verdict": "not-measurable", "code": 401, "reference_mm": null, "euler_deg": null}))
        };
        let none = |code| {
            let (verdict, method) = (Verdict::NotMeasurable, Method::Points);
            Measurement::without_pose("a".into(), verdict, Some(code), String::new(), method)
        };
        assert!(refused(none(Code::NotFound)).reproduced());
        assert!(!refused(none(Code::Ambient)).reproduced(), "refused for another reason");
        assert!(!replayed(Value::Null).reproduced());
    }

    #[test]
    fn a_changed_verdict_is_shown_and_a_missing_pose_is_no_difference_of_0() {
        let r = replayed(json!({"verdict": "not-measurable", "code": Code::NotFound, "reference_mm": null}));
        assert!(!r.same_verdict() && r.difference().is_none());
        assert!(replay_table(std::slice::from_ref(&r)).contains("not-measurable 401 → ok"));
        assert!(replay_json(&[r]).contains("\"difference\":null"));
        assert!(!replayed(Value::Null).same_verdict(), "then it was not come to");
    }
}
