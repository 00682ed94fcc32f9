//! `datum calibrate station`: the datum survey. One capture of discs with known station coordinates in; the calibration
//! with `station_from_camera` out.

use super::super::{Status, print};
use super::report;
use crate::Calibration;
use crate::calibrate::{Centre, Circle, Survey, centre, decode, mean, read_circles, survey, target};
use crate::capture::Capture;
use crate::document::Check;
use crate::fringe::Axis;
use crate::image::Window;
use crate::optics::Pixel;
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

/// Circles that fit worse are not where they are said to be, mm.
const MAX_RESIDUAL_MM: f64 = 1.0;

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
    let solved = survey(&circles, &centres).with_context(|| a.circles.display().to_string())?;
    let worst = worst(&circles, &solved);
    if !a.force {
        let allowed = format!("within {MAX_RESIDUAL_MM} mm of where it is measured (--force writes all the same)");
        let found = format!("{:?}, {:.2} mm off", circles[worst.0].station_mm, worst.1);
        Check(&a.circles).that(
            worst.1 <= MAX_RESIDUAL_MM,
            format!("circle[{}].station_mm", worst.0),
            found,
            allowed,
        )?;
    }
    print(&if a.json { format!("{:#}\n", as_json(&circles, &centres, &solved)) } else { table(&circles, &solved) })?;
    if let Some(out) = &a.out {
        let surveyed = Calibration { station_from_camera: Some(solved.station_from_camera), ..calibration };
        // the same calibration with a survey is no worse than without
        let kept = crate::calibrate::keep(out, &surveyed, true)?;
        kept.iter().for_each(|old| eprintln!("{}: the one before", old.display()));
    }
    Ok(Status::Done)
}

fn worst(circles: &[Circle], s: &Survey) -> (usize, f64) {
    let off = |k: usize| s.registration.residuals[k].norm();
    let worst = (0..circles.len()).max_by(|a, b| off(*a).total_cmp(&off(*b))).expect("three circles at least");
    (worst, off(worst))
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
        json!({"name": c.name, "camera_mm": <[f64; 3]>::from(centres[k].point.xyz), "residual_mm": residual})
    };
    json!({
        "station_from_camera": report::pose(&s.station_from_camera),
        "residual_rms_mm": s.rms_mm,
        "circles": circles.iter().enumerate().map(circle).collect::<Vec<_>>(),
        "uncertainty_k2": {"x_mm": mm[0], "y_mm": mm[1], "z_mm": mm[2], "rx_deg": deg[0], "ry_deg": deg[1], "rz_deg": deg[2]},
        "uncertainty_at_mm": <[f64; 3]>::from(s.registration.at.xyz),
    })
}

fn table(circles: &[Circle], s: &Survey) -> String {
    let mut out = String::from("circle                  off by x        y        z mm\n");
    for (c, r) in circles.iter().zip(&s.registration.residuals) {
        let _ = writeln!(out, "{:<22} {:>9.3} {:>8.3} {:>8.3}", c.name, r.x, r.y, r.z);
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
    out
}
