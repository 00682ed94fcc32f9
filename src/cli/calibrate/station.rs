//! `datum calibrate station`: the datum survey. One capture of discs with known station coordinates in; the calibration
//! with `station_from_camera` out.

use super::super::{Status, print};
use super::report;
use crate::Calibration;
use crate::calibrate::{
    Centre, Circle, Culprit, MAX_RESIDUAL_MM, MAX_SIGMAS, Misfit, Survey, centre, decode, keep, mean, read_circles,
    survey, target,
};
use crate::capture::Capture;
use crate::document::Check;
use crate::fringe::Axis;
use crate::image::Window;
use crate::optics::{Pixel, Rig};
use anyhow::Context;
use serde_json::json;
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// The folder with a capture.toml that shows the circles
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// The calibration of camera and projector
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The surveyed circles: format = 1 and, for each of three or more dark discs on bright ground, a table [[circle]] with
    /// name, station_mm = [x, y, z], pixel = [x, y] inside its image, and sigma_mm (if not 0.05)
    #[arg(long, value_name = "FILE")]
    circles: PathBuf,
    /// Writes the calibration with station_from_camera; one that is there is kept beside it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Writes it although circles fit badly
    #[arg(long)]
    force: bool,
    /// Prints JSON
    #[arg(long)]
    json: bool,
}

/// Translations of one rig, written and read again, differ by less, mm; matrices by less, too.
const SAME: f64 = 1e-9;

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let circles = read_circles(&a.circles)?;
    let calibration = Calibration::read(&a.calibration)?;
    let capture = Capture::open(&a.capture)?;
    let (c, p) = (&capture.camera, &capture.projector);
    let fitted = calibration
        .for_sizes((c.width, c.height), (p.width, p.height), false)
        .with_context(|| capture.file().display().to_string())?;
    let image = mean(&capture)?;
    let columns = decode(&capture, Window::whole(c.width, c.height), Axis::Column)?;
    let mut centres = Vec::new();
    for (k, circle) in circles.iter().enumerate() {
        let near = Pixel::from(circle.pixel);
        let edge = target::disc_about(&image, &near);
        let found = edge.as_ref().and_then(|edge| centre(&fitted.rig, &columns, edge));
        let allowed = if edge.is_none() {
            "a pixel inside the image of a dark disc on bright ground, all of it in view"
        } else {
            "a disc on flat ground that the fringes light"
        };
        Check(&a.circles).that(
            found.is_some(),
            format!("circle[{k}].pixel"),
            format!("{:?}", circle.pixel),
            allowed,
        )?;
        centres.extend(found);
    }
    let solved = survey(&circles, &centres, &fitted).with_context(|| a.circles.display().to_string())?;
    if let Some(culprit) = solved.culprit(&circles, &centres, &fitted).filter(|_| !a.force) {
        let found = format!("{:?}, {}", circles[culprit.circle].station_mm, misfit(&circles, &solved, &culprit));
        let allowed = format!(
            "within {MAX_RESIDUAL_MM} mm and {MAX_SIGMAS} sigmas of where it is measured (--force writes all the same)"
        );
        Check(&a.circles).that(false, format!("circle[{}].station_mm", culprit.circle), found, allowed)?;
    }
    let stated = fitted.covariance.is_some();
    let text =
        if a.json { format!("{:#}\n", as_json(&circles, &centres, &solved)) } else { table(&circles, &solved, stated) };
    print(&text)?;
    if let Some(out) = &a.out {
        // the calibration that is surveyed may replace itself; one of another rig is worth what `keep` finds
        let itself = Calibration::read(out).is_ok_and(|there| same_rig(&there.rig, &calibration.rig));
        let surveyed = Calibration { station_from_camera: Some(solved.station_from_camera), ..calibration };
        let kept = keep(out, &surveyed, a.force || itself)?;
        kept.iter().for_each(|old| eprintln!("{}: the one before", old.display()));
    }
    Ok(Status::Done)
}

fn same_rig(a: &Rig, b: &Rig) -> bool {
    let (p, q) = (&a.projector_from_camera, &b.projector_from_camera);
    a.camera == b.camera
        && a.projector == b.projector
        && (p.t - q.t).amax() < SAME
        && (p.r.matrix() - q.r.matrix()).amax() < SAME
}

/// What is wrong with the circle, and with how much certainty it is this one.
fn misfit(circles: &[Circle], s: &Survey, c: &Culprit) -> String {
    let names = |of: &[usize]| of.iter().map(|&k| format!("{:?}", circles[k].name)).collect::<Vec<_>>().join(" or ");
    let which = match (c.certain, c.or.as_slice()) {
        (true, []) => "the others fit without it".into(),
        (true, or) => format!("though it may be {} instead", names(or)),
        (false, _) if circles.len() == 3 => "the worst of three, of which any may be wrong".into(),
        (false, _) => "and no one circle explains it: more are wrong, or the capture is".into(),
    };
    let name = &circles[c.circle].name;
    let Misfit { mm, sigmas } = c.misfit;
    format!("{name:?}: {which}; all together {:.1} sigmas, this one {sigmas:.1} sigmas, {mm:.2} mm off", s.sigmas)
}

/// Two standard deviations: of the circles' centroid along the station's axes, mm, and of the frame's turns, degrees.
fn uncertainty_k2(s: &Survey) -> ([f64; 3], [f64; 3]) {
    let sigma = |k: usize| 2.0 * s.registration.covariance[(k, k)].sqrt();
    ([0, 1, 2].map(sigma), [3, 4, 5].map(|k| sigma(k).to_degrees()))
}

fn as_json(circles: &[Circle], centres: &[Centre], s: &Survey) -> serde_json::Value {
    let (mm, deg) = uncertainty_k2(s);
    let circle = |(k, c): (usize, &Circle)| {
        let residual: [f64; 3] = s.registration.residuals[k].into();
        let camera: [f64; 3] = centres[k].point.xyz.into();
        json!({"name": c.name, "camera_mm": camera, "residual_mm": residual, "residual_sigmas": s.misfits[k].sigmas})
    };
    json!({
        "station_from_camera": report::pose(&s.station_from_camera),
        "residual_rms_mm": s.rms_mm,
        "residual_sigmas": s.sigmas,
        "checked": s.checked,
        "circles": circles.iter().enumerate().map(circle).collect::<Vec<_>>(),
        "uncertainty_k2": {"x_mm": mm[0], "y_mm": mm[1], "z_mm": mm[2], "rx_deg": deg[0], "ry_deg": deg[1], "rz_deg": deg[2]},
        "uncertainty_at_mm": <[f64; 3]>::from(s.registration.at.xyz),
    })
}

/// `stated`: the calibration states its covariance.
fn table(circles: &[Circle], s: &Survey, stated: bool) -> String {
    let mut out = String::from("circle                  off by x        y        z mm   sigmas\n");
    for ((c, r), m) in circles.iter().zip(&s.registration.residuals).zip(&s.misfits) {
        let _ = writeln!(out, "{:<22} {:>9.3} {:>8.3} {:>8.3} {:>11.1}", c.name, r.x, r.y, r.z, m.sigmas);
    }
    let (mm, deg) = uncertainty_k2(s);
    let at = s.registration.at.xyz;
    let t = s.station_from_camera.t;
    let _ = writeln!(
        out,
        "rms {:.3} mm; the camera stands at ({:.2}, {:.2}, {:.2}) mm in the station",
        s.rms_mm, t.x, t.y, t.z
    );
    let _ = writeln!(
        out,
        "U(k=2) at ({:.0}, {:.0}, {:.0}): {:.3}, {:.3}, {:.3} mm; {:.4}, {:.4}, {:.4}° about x, y, z",
        at.x, at.y, at.z, mm[0], mm[1], mm[2], deg[0], deg[1], deg[2]
    );
    if !stated {
        let _ = writeln!(out, "without the calibration's share: it states no covariance");
    }
    if !s.checked {
        let _ = writeln!(
            out,
            "hardly checked: of three circles only their distances are; one that is off across their plane tilts the \
             station. Survey a fourth."
        );
    }
    out
}
