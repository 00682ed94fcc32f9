//! Records for people and for other programs. In: records. Out: a table, JSON, JSON Lines, CSV.
//! Text that came over the wire is shown without control characters; in JSON it is escaped.

use super::{CAPTURES, Event, Record, Vehicle, capture_name};
use crate::time::moment;
use serde_json::{Map, Value, json};
use std::fmt::Write;
use std::path::Path;

/// One aligned line per record. `folder`: of the records, to see which raw images are there.
pub fn table(folder: &Path, records: &[Record]) -> String {
    let mut out = format!(
        "{:>8}  {:<24} {:<17} {:>3}  {:<14} {:>9} {:>9} {:>9} {:>8} {:>8} {:>8} {:>6}\n",
        "record", "time, UTC", "VIN", "job", "verdict", "x mm", "y mm", "z mm", "roll °", "pitch °", "yaw °", "ms"
    );
    for r in records {
        let time = moment(r.at_ms);
        let (kind, code, sentence) = match &r.event {
            Event::Vehicle(v) => {
                let pose = pose(v);
                let number = |n: Option<f64>, digits: usize| n.map_or("–".into(), |n| format!("{n:.digits$}"));
                let _ = write!(
                    out,
                    "{:>8}  {time:<24} {:<17} {:>3}  {:<14} {:>9} {:>9} {:>9} {:>8} {:>8} {:>8} {:>6}",
                    r.id,
                    shown(&v.vin),
                    v.job,
                    v.verdict.name(),
                    number(pose[0], 3),
                    number(pose[1], 3),
                    number(pose[2], 3),
                    number(pose[3], 4),
                    number(pose[4], 4),
                    number(pose[5], 4),
                    v.total_ms.map_or("–".into(), |ms| ms.to_string()),
                );
                let why = if v.code == 0 { String::new() } else { format!("{} {}", v.code, shown(&v.sentence)) };
                let images = images(folder, r.id, v).map(|_| "images".to_owned());
                let rest: Vec<_> = [Some(why).filter(|w| !w.is_empty()), images].into_iter().flatten().collect();
                let _ = writeln!(out, "{}{}", if rest.is_empty() { "" } else { "  " }, rest.join(" · "));
                continue;
            }
            Event::Boot(b) => ("boot", 0, &b.sentence),
            Event::Verification(v) => ("verification", v.code, &v.sentence),
            Event::Alarm(a) => ("alarm", a.code, &a.sentence),
        };
        let code = if code == 0 { String::new() } else { format!(" {code}") };
        let line = format!("{:>8}  {time:<24} {kind}{code} {}", r.id, shown(sentence));
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}

/// An array, one object per line.
pub fn json(folder: &Path, records: &[Record]) -> String {
    let lines: Vec<_> = records.iter().map(|r| object(folder, r)).collect();
    format!("[{}]\n", lines.join(",\n "))
}

/// One object per line.
pub fn json_lines(folder: &Path, records: &[Record]) -> String {
    records.iter().map(|r| object(folder, r) + "\n").collect()
}

/// The measurement goes in as it was written: reading its numbers and writing them again might change them.
fn object(folder: &Path, r: &Record) -> String {
    let mut head = Map::new();
    head.insert("record".into(), r.id.into());
    head.insert("at".into(), moment(r.at_ms).into());
    head.insert("software".into(), r.software.clone().into());
    let (kind, fields, measurement) = match &r.event {
        Event::Vehicle(v) => {
            let mut fields = json!(v);
            fields["images"] = images(folder, r.id, v).map_or(Value::Null, Into::into);
            ("vehicle", fields, v.measurement.as_deref().unwrap_or("null"))
        }
        Event::Boot(b) => ("boot", json!(b), ""),
        Event::Verification(v) => ("verification", json!(v), ""),
        Event::Alarm(a) => ("alarm", json!(a), ""),
    };
    head.insert("kind".into(), kind.into());
    let fields = fields.as_object().into_iter().flatten().filter(|(key, _)| *key != "measurement" && *key != "at_ms");
    head.extend(fields.map(|(key, value)| (key.clone(), value.clone())));
    let mut text = Value::Object(head).to_string();
    if !measurement.is_empty() {
        text.pop();
        let _ = write!(text, ",\"measurement\":{measurement}}}");
    }
    text
}

/// The columns of [`csv`].
const COLUMNS: &str = "record,time,vin,trigger_id,job,verdict,code,detail,sentence,x_mm,y_mm,z_mm,roll_deg,pitch_deg,\
                       yaw_deg,u_x_mm,u_y_mm,u_z_mm,u_roll_deg,u_pitch_deg,u_yaw_deg,residual_rms_mm,light_left,\
                       light_right,camera_celsius,projector_celsius,acquisition_ms,total_ms,captures,images,software";

/// A heading and one line per vehicle, as RFC 4180 has it; other records are left out. What is not known is empty.
pub fn csv(folder: &Path, records: &[Record]) -> String {
    let mut out = format!("{COLUMNS}\r\n");
    for r in records {
        let Event::Vehicle(v) = &r.event else { continue };
        let m = parsed(v);
        let number = |n: Option<f64>| n.map_or(String::new(), |n| n.to_string());
        let count = |n: Option<u32>| n.map_or(String::new(), |n| n.to_string());
        let u = ["x_mm", "y_mm", "z_mm", "roll_deg", "pitch_deg", "yaw_deg"].map(|k| m["uncertainty_k2"][k].as_f64());
        let mut fields = vec![
            r.id.to_string(),
            moment(r.at_ms),
            field(&v.vin),
            v.trigger_id.to_string(),
            v.job.to_string(),
            v.verdict.name().into(),
            v.code.to_string(),
            v.detail.to_string(),
            field(&v.sentence),
        ];
        fields.extend(pose(v).into_iter().chain(u).map(number));
        fields.push(number(m["residual_rms_mm"].as_f64()));
        fields
            .extend([v.light.map(|l| l[0]), v.light.map(|l| l[1]), v.camera_celsius, v.projector_celsius].map(number));
        fields.extend([v.acquisition_ms, v.total_ms].map(count));
        fields.push(v.captures.to_string());
        fields.extend([field(&images(folder, r.id, v).unwrap_or_default()), field(&r.software)]);
        let _ = write!(out, "{}\r\n", fields.join(","));
    }
    out
}

/// The measurement's object; null if there is none.
pub(super) fn parsed(v: &Vehicle) -> Value {
    v.measurement.as_ref().and_then(|text| serde_json::from_str(text).ok()).unwrap_or(Value::Null)
}

/// x, y, z (mm), roll, pitch, yaw (°) of a measurement's object.
pub(super) fn numbers(m: &Value) -> [Option<f64>; 6] {
    let (p, e) = (&m["reference_mm"], &m["euler_deg"]);
    [&p["x"], &p["y"], &p["z"], &e["roll"], &e["pitch"], &e["yaw"]].map(Value::as_f64)
}

fn pose(v: &Vehicle) -> [Option<f64>; 6] {
    numbers(&parsed(v))
}

/// The folder of a vehicle's raw images, if they were to be kept and are there still.
fn images(folder: &Path, record: u64, v: &Vehicle) -> Option<String> {
    let name = Path::new(CAPTURES).join(capture_name(record));
    (v.images && folder.join(&name).is_dir()).then(|| name.display().to_string())
}

/// Without what would move a terminal's cursor or break a line.
pub(super) fn shown(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { '\u{FFFD}' } else { c }).collect()
}

/// A field of CSV. What a spreadsheet would take for a formula is given a quote before it.
fn field(text: &str) -> String {
    let mut text = shown(text);
    if text.starts_with(['=', '+', '-', '@']) {
        text.insert(0, '\'');
    }
    if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text }
}

/// One record of each kind, and a vehicle without a pose: for tests.
#[cfg(test)]
pub(super) fn samples() -> Vec<Record> {
    use super::{Alarm, Boot, Totals, Verdict, Verification};
    let measured = concat!(
        r#"{"verdict":"ok","reference_mm":{"x":-50.25,"y":0.125,"z":0.0},"euler_deg":{"roll":0.01,"pitch":-0.02,"#,
        r#""yaw":12.5},"uncertainty_k2":{"x_mm":0.2,"yaw_deg":0.03},"residual_rms_mm":0.06}"#
    );
    let good = Vehicle {
        trigger_id: 42,
        vin: "WDATUM00000000042".into(),
        job: 12,
        job_fingerprint: 1,
        calibration_fingerprint: 2,
        verdict: Verdict::Ok,
        code: 0,
        detail: 0,
        sentence: String::new(),
        measurement: Some(measured.into()),
        captures: 1,
        light: Some([0.5, 0.625]),
        ambient: None,
        camera_celsius: Some(41.5),
        projector_celsius: None,
        acquisition_ms: Some(1150),
        total_ms: Some(1290),
        images: true,
    };
    let mut bad = good.clone();
    bad.vin = "WDATUM\x1b[2J,\"0043".into();
    bad.verdict = Verdict::NotMeasurable;
    (bad.code, bad.detail, bad.sentence) = (401, 3, "A feature was not found. cap".into());
    (bad.measurement, bad.acquisition_ms) = (None, None);
    let verified = Verification {
        code: 703,
        sentence: "The verification failed: lengths are wrong.".into(),
        scale_error: Some(0.0005),
        ..Verification::default()
    };
    let alarm = Alarm { code: 201, detail: 0, sentence: "The camera does not answer.".into() };
    let events = [
        Event::Boot(Boot::default()),
        Event::Vehicle(Box::new(good)),
        Event::Vehicle(Box::new(bad)),
        Event::Verification(verified),
        Event::Alarm(alarm),
    ];
    let record = |(n, event): (u64, Event)| Record {
        id: n,
        at_ms: 1_795_564_800_000 + 1000 * n,
        software: "0.1.0".into(),
        event,
        totals: Totals::default(),
    };
    (1..).zip(events).map(record).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_a_line_per_record_and_no_control_character() {
        let text = table(Path::new("/no/records"), &samples());
        let lines: Vec<_> = text.lines().collect();
        assert_eq!(lines.len(), 6);
        assert_eq!(
            lines[2],
            "       2  2026-11-25T00:00:02.000Z WDATUM00000000042  12  ok               -50.250     0.125     0.000   \
             0.0100  -0.0200  12.5000   1290"
        );
        assert!(lines[3].ends_with("1290  401 A feature was not found. cap") && !text.contains('\x1b'), "{text}");
        assert!(lines[1].ends_with("boot") && lines[5].ends_with("alarm 201 The camera does not answer."));
    }

    #[test]
    fn json_holds_the_measurement_as_it_was_written() {
        let text = json(Path::new("/no/records"), &samples());
        let all: Vec<Value> = serde_json::from_str(&text).expect("JSON");
        assert!(text.contains("\"measurement\":{\"verdict\":\"ok\",\"reference_mm\""));
        assert_eq!((all[1]["kind"].as_str(), all[1]["verdict"].as_str()), (Some("vehicle"), Some("ok")));
        assert_eq!((all[1]["record"].as_u64(), all[1]["images"].is_null()), (Some(2), true), "the images are gone");
        assert_eq!(all[2]["vin"], "WDATUM\x1b[2J,\"0043");
        assert!(all[2]["measurement"].is_null() && all[3]["scale_error"] == 0.0005 && all[4]["code"] == 201);
        assert_eq!(json(Path::new("."), &[]), "[]\n");
        assert_eq!(json_lines(Path::new("."), &samples()).lines().count(), 5);
    }

    #[test]
    fn csv_has_as_many_fields_as_columns_and_no_formulas() {
        let text = csv(Path::new("/no/records"), &samples());
        let lines: Vec<_> = text.split("\r\n").collect();
        assert_eq!((lines.len(), lines[0].split(',').count()), (4, 31));
        assert_eq!(lines[1].split(',').count(), 31);
        assert!(
            lines[1].contains(",-50.25,0.125,0,0.01,-0.02,12.5,0.2,,,,,0.03,0.06,0.5,0.625,41.5,,1150,1290,1,,0.1.0")
        );
        assert!(lines[2].contains(",\"WDATUM\u{FFFD}[2J,\"\"0043\","), "{}", lines[2]);
        assert_eq!(field("=1+1"), "'=1+1");
    }
}
