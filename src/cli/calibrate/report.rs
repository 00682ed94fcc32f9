//! A solved calibration for people and for programs (formats.md §7).

use crate::calibrate::{Coverage, PARAMETERS, Solution};
use crate::optics::Lens;
use serde_json::{Value, json};
use std::fmt::Write;

/// Beyond it a tool shows more digits than a calibration has.
fn lens(l: &Lens) -> Value {
    json!({"width": l.width, "height": l.height, "fx": l.fx, "fy": l.fy, "cx": l.cx, "cy": l.cy, "distortion": l.distortion})
}

/// `projector_from_camera` or another pose.
pub(super) fn pose<A, B>(p: &crate::Pose<A, B>) -> Value {
    let m = p.r.matrix();
    let rows: [[f64; 3]; 3] = std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)]));
    json!({"rotation": rows, "translation_mm": <[f64; 3]>::from(p.t)})
}

/// The keys of `calibrate --json` for a rig.
pub(super) fn rig(camera: &Lens, rig: Option<&crate::Rig>) -> serde_json::Map<String, Value> {
    let mut out = serde_json::Map::new();
    out.insert("camera".into(), lens(camera));
    out.insert("projector".into(), rig.map_or(Value::Null, |r| lens(&r.projector)));
    out.insert("projector_from_camera".into(), rig.map_or(Value::Null, |r| pose(&r.projector_from_camera)));
    out
}

/// All that `calibrate camera` and `calibrate projector` print with --json.
pub(super) fn json(s: &Solution, coverage: &Coverage, scale_sigma_percent: Option<f64>) -> Value {
    let joint = s.rig();
    let mut out = rig(&s.devices[0].lens, joint.as_ref());
    out["camera"]["skew"] = json!(s.devices[0].skew);
    let both = joint.as_ref().map(|_| ());
    let [camera, projector, together] = s.rms_px;
    out.insert(
        "rms_px".into(),
        json!({"camera": camera, "projector": both.map(|()| projector), "joint": both.map(|()| together)}),
    );
    let std = s.parameter_covariance();
    let of =
        |(k, name): (usize, &&str)| (both.is_some() || k < 9).then(|| (name.to_string(), json!(std[(k, k)].sqrt())));
    let mut sigmas: serde_json::Map<String, Value> = PARAMETERS.iter().enumerate().filter_map(of).collect();
    sigmas.insert("camera.skew".into(), json!(s.skew_sigma()));
    out.insert("std".into(), Value::Object(sigmas));
    let view = |v: &crate::calibrate::ViewReport| json!({"name": v.name, "rms_px": v.used.then_some(v.rms_px[0]), "used": v.used, "rejected_points": v.rejected});
    out.insert("views".into(), s.views.iter().map(view).collect());
    out.insert("leave_one_out_rms_px".into(), json!(s.leave_one_out_rms_px));
    let kabsch = |v: &crate::calibrate::ViewReport| {
        v.held_out.map(|h| json!({"name": v.name, "rms_mm": h.rms_mm, "scale": h.scale}))
    };
    out.insert("kabsch".into(), s.views.iter().filter_map(kabsch).collect());
    out.insert("scale_sigma_percent".into(), json!(scale_sigma_percent));
    out.insert("coverage".into(), json!(coverage.share));
    out.insert("missing".into(), json!(coverage.missing));
    Value::Object(out)
}

/// The same for a person.
pub(super) fn table(s: &Solution, coverage: &Coverage, scale_sigma_percent: Option<f64>) -> String {
    let mut out = String::new();
    let std = s.parameter_covariance();
    for (k, (device, name)) in s.devices.iter().zip(["camera", "projector"]).enumerate() {
        let (l, sigma) = (&device.lens, |i: usize| std[(9 * k + i, 9 * k + i)].sqrt());
        let _ = writeln!(
            out,
            "{name:<9} f {:.3} ± {:.3}, {:.3} ± {:.3} px; principal point {:.3} ± {:.3}, {:.3} ± {:.3} px",
            l.fx,
            sigma(0),
            l.fy,
            sigma(1),
            l.cx,
            sigma(2),
            l.cy,
            sigma(3)
        );
        let terms = ["k1", "k2", "p1", "p2", "k3"].iter().zip(&l.distortion).filter(|(_, v)| **v != 0.0);
        let kept: Vec<String> = terms.map(|(t, v)| format!("{t} {v:.5}")).collect();
        let kept = if kept.is_empty() { "none earns its place".into() } else { kept.join(", ") };
        let _ = writeln!(out, "          distortion: {kept}");
        if device.skew != 0.0 {
            let _ = writeln!(out, "          skew {:.4} ± {:.4} px", device.skew, s.skew_sigma());
        }
    }
    if s.rig().is_some() {
        let t = s.projector_from_camera.t;
        let sigma = |k: usize| std[(k, k)].sqrt();
        let turn = [18, 19, 20].map(|k| sigma(k).to_degrees());
        let _ = writeln!(
            out,
            "baseline  {:.3} mm; ({:.3}, {:.3}, {:.3}) ± ({:.3}, {:.3}, {:.3}) mm, turned to ± ({:.4}, {:.4}, {:.4})°",
            t.norm(),
            t.x,
            t.y,
            t.z,
            sigma(21),
            sigma(22),
            sigma(23),
            turn[0],
            turn[1],
            turn[2]
        );
    }
    let _ = writeln!(out, "view                      rms px  held out: scale %   rms mm");
    for v in &s.views {
        let held =
            v.held_out.map_or(String::new(), |h| format!("{:>14.3} {:>12.3}", 100.0 * (h.scale - 1.0), h.rms_mm));
        let rms = if v.used { format!("{:.3}", v.rms_px[0]) } else { "left out".into() };
        let rejected =
            if v.rejected > 0 && v.used { format!("  ({} points left out)", v.rejected) } else { String::new() };
        let _ = writeln!(out, "{:<24} {rms:>8} {held}{rejected}", v.name);
    }
    let [camera, projector, _] = s.rms_px;
    let joint = s.rig().map_or(String::new(), |_| format!(", projector {projector:.3} px"));
    let out_rms = s.leave_one_out_rms_px.map_or("too few views".into(), |r| format!("{r:.3} px"));
    let _ = writeln!(out, "rms       camera {camera:.3} px{joint}; each view predicted by the others: {out_rms}");
    if let Some(scale) = scale_sigma_percent {
        let _ = writeln!(out, "scale     from the board alone, ± {scale:.4} %");
    }
    let _ = writeln!(out, "coverage  {:.0} % of the field", 100.0 * coverage.share);
    for m in &coverage.missing {
        let _ = writeln!(out, "          missing: {m}");
    }
    out
}
