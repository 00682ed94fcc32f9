//! One vehicle in a line, for people. In: what a cycle came to. Out: text. Not here: where it is shown.

use crate::geometry::{Point3, Pose, frame};
use crate::measure::Measurement;
use crate::plc::ResultCode;
use crate::station::Finished;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// The acquisition's budget on the reference hardware, in a line.
pub(super) fn budget(f: &Finished, allowed_ms: u64) -> String {
    let b = &f.budget;
    format!(
        "acquisition on the reference hardware: {} images for the red light, {} for the bars, {} for the projector, {} \
         fringes and the repeat: {} at 30/s are {:.2} s, allowed {:.2} s\n",
        b.red,
        b.bars,
        b.projector,
        b.fringes,
        b.images(),
        b.at_30_per_s().as_secs_f64(),
        allowed_ms as f64 / 1e3
    )
}

/// One vehicle in a line.
pub(super) fn line(f: &Finished) -> String {
    let o = &f.outcome;
    let verdict = match o.result {
        ResultCode::Ok => "ok",
        ResultCode::OutOfLimits => "out of limits",
        ResultCode::TooUncertain => "too uncertain",
        ResultCode::NotMeasurable => "not measurable",
        ResultCode::Aborted => "aborted",
    };
    let ms = |d: Option<std::time::Duration>| d.map_or("–".into(), |d| format!("{:.0}", d.as_secs_f64() * 1e3));
    let mut out = format!("job {:03} {:16} {verdict:14}", o.job, f.name);
    if let Some(p) = &o.pose {
        let ([x, y, z], [roll, pitch, yaw]) = (p.position_mm, p.angles_deg);
        out += &format!(" {x:+8.2} {y:+8.2} {z:+8.2} mm {roll:+7.3} {pitch:+7.3} {yaw:+7.3}°");
        let off = f.measurement.as_ref().zip(f.truth).and_then(|(m, truth)| error(m, &truth));
        if let Some((mm, deg)) = off {
            out += &format!(" off {mm:.3} mm {deg:.4}°");
        }
    }
    let l = o.light.unwrap_or_default();
    out += &format!(
        " acquired {} ms ({} images, computed {:.0} ms) total {} ms bars {:.2} {:.2}",
        ms(o.acquisition),
        f.budget.images(),
        f.computed.as_secs_f64() * 1e3,
        ms(o.total),
        l[0],
        l[1]
    );
    if f.tries > 1 {
        out += &format!(" second try after {}", f.first.map_or("–".into(), |c| c.to_string()));
    }
    if !f.said.is_empty() {
        out += &format!(" {}", f.said);
    }
    out + "\n"
}

/// How far a measured pose is off: the features' centroid, mm; the rotation, degrees.
pub(super) fn error(m: &Measurement, truth: &Pose<frame::Camera, frame::Vehicle>) -> Option<(f64, f64)> {
    let p = m.camera_from_vehicle.as_ref()?;
    let r = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| p.rotation[i][j]));
    let measured = Pose::<frame::Camera, frame::Vehicle>::new(r, p.translation_mm.into());
    let motion: Pose<frame::Vehicle, frame::Vehicle> = truth.inverse() * measured;
    let at = Point3::new(Vector3::from(m.covariance_at_mm?));
    Some((((motion * at) - at).norm(), motion.r.angle().to_degrees()))
}
