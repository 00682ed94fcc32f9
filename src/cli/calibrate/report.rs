//! A solved calibration for people and for programs (formats.md §7).

use super::input::LeftOut;
use crate::calibrate::{Coverage, PARAMETERS, Solution, ViewReport};
use crate::optics::Lens;
use serde_json::{Value, json};
use std::fmt::Write;

/// A lens with the keys of the calibration file.
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

/// All that `calibrate camera` and `calibrate projector` print with --json; without `coverage` where the field is not known.
pub(super) fn json(
    s: &Solution,
    coverage: Option<&Coverage>,
    scale_sigma_percent: Option<f64>,
    left_out: &[LeftOut],
) -> Value {
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
    let view = |v: &ViewReport| {
        let [camera, projector] = v.rms_px.map(|rms| v.used.then_some(rms));
        json!({
            "name": v.name,
            "rms_px": camera,
            "projector_rms_px": both.and(projector),
            "used": v.used,
            "rejected_points": v.rejected,
        })
    };
    let unseen = |l: &LeftOut| json!({"name": l.name, "rms_px": null, "projector_rms_px": null, "used": false, "rejected_points": null, "detail": l.detail});
    out.insert("views".into(), s.views.iter().map(view).chain(left_out.iter().map(unseen)).collect());
    out.insert("leave_one_out_rms_px".into(), json!(s.leave_one_out_rms_px));
    let kabsch = |v: &ViewReport| v.held_out.map(|h| json!({"name": v.name, "rms_mm": h.rms_mm, "scale": h.scale}));
    out.insert("kabsch".into(), s.views.iter().filter_map(kabsch).collect());
    out.insert("scale_sigma_percent".into(), json!(scale_sigma_percent));
    out.insert("coverage".into(), json!(coverage.map(|c| c.share)));
    out.insert("missing".into(), json!(coverage.map(|c| &c.missing)));
    Value::Object(out)
}

/// Where the lens's axis meets the image, with the sigmas given; one that did not earn its place is at the centre.
fn principal_point(l: &Lens, sigmas: [f64; 2]) -> String {
    let centre = [l.width, l.height].map(|side| (side as f64 - 1.0) / 2.0);
    if [l.cx, l.cy] == centre {
        return format!("at the centre (fixed), {:.1}, {:.1} px", l.cx, l.cy);
    }
    format!("{:.3} ± {:.3}, {:.3} ± {:.3} px", l.cx, sigmas[0], l.cy, sigmas[1])
}

/// The same for a person.
pub(super) fn table(s: &Solution, coverage: Option<&Coverage>, scale_sigma_percent: Option<f64>) -> String {
    let mut out = String::new();
    let std = s.parameter_covariance();
    for (k, (device, name)) in s.devices.iter().zip(["camera", "projector"]).enumerate() {
        let (l, sigma) = (&device.lens, |i: usize| std[(9 * k + i, 9 * k + i)].sqrt());
        let _ = writeln!(
            out,
            "{name:<9} f {:.3} ± {:.3}, {:.3} ± {:.3} px; principal point {}",
            l.fx,
            sigma(0),
            l.fy,
            sigma(1),
            principal_point(l, [sigma(2), sigma(3)])
        );
        let terms =
            ["k1", "k2", "p1", "p2", "k3"].iter().zip(&l.distortion).enumerate().filter(|(_, (_, v))| **v != 0.0);
        let kept: Vec<String> = terms.map(|(i, (t, v))| format!("{t} {v:.5} ± {:.5}", sigma(4 + i))).collect();
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
    let joint = s.rig().is_some();
    let of_projector = if joint { " projector" } else { "" };
    let _ = writeln!(out, "view                      rms px{of_projector}  held out: scale %   rms mm");
    for v in &s.views {
        let held =
            v.held_out.map_or(String::new(), |h| format!("{:>14.3} {:>12.3}", 100.0 * (h.scale - 1.0), h.rms_mm));
        let rms = |of: f64| if v.used { format!("{of:.3}") } else { String::new() };
        let camera = if v.used { rms(v.rms_px[0]) } else { "left out".into() };
        let projector = if joint { format!(" {:>9}", rms(v.rms_px[1])) } else { String::new() };
        let rejected =
            if v.rejected > 0 && v.used { format!("  ({} points left out)", v.rejected) } else { String::new() };
        let _ = writeln!(out, "{:<24} {camera:>8}{projector} {held}{rejected}", v.name);
    }
    let [camera, projector, _] = s.rms_px;
    let joint = if joint { format!(", projector {projector:.3} px") } else { String::new() };
    let out_rms = s.leave_one_out_rms_px.map_or("too few views".into(), |r| format!("{r:.3} px"));
    let _ = writeln!(out, "rms       camera {camera:.3} px{joint}; each view predicted by the others: {out_rms}");
    if let Some(scale) = scale_sigma_percent {
        let _ = writeln!(out, "scale     from the board alone, ± {scale:.4} %");
    }
    if let Some(coverage) = coverage {
        let _ = writeln!(out, "coverage  {:.0} % of the field", 100.0 * coverage.share);
        for m in &coverage.missing {
            let _ = writeln!(out, "          missing: {m}");
        }
    }
    out
}
