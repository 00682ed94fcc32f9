//! `datum calibrate verify`: one capture of a board against a calibration; exit status 1 where it does not hold.

use super::super::{Status, print};
use super::input::read_shot;
use super::report;
use crate::Calibration;
use crate::calibrate::{Board, Lit, PARAMETERS, VerifyLimits, verify};
use anyhow::Context;
use serde_json::json;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// The folder with a capture.toml that shows the board
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// The board: chessboard:11x8:35 (inner corners, pitch mm), circles:8x4:60:30 (pitch, diameter), marked:8x4:60:30
    #[arg(long)]
    board: Board,
    /// The calibration of camera and projector
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// Uses the calibration for a capture that is binned by a common factor
    #[arg(long)]
    scale_calibration: bool,
    /// Largest scale error, %
    #[arg(long, value_name = "LIMIT", value_parser = limit, default_value_t = VerifyLimits::default().scale_percent)]
    max_scale_percent: f64,
    /// Largest deviation from flat, rms, mm
    #[arg(long, value_name = "LIMIT", value_parser = limit, default_value_t = VerifyLimits::default().flatness_mm)]
    max_flatness_mm: f64,
    /// Largest epipolar residual, rms, projector px
    #[arg(long, value_name = "LIMIT", value_parser = limit, default_value_t = VerifyLimits::default().epipolar_px)]
    max_epipolar_px: f64,
    /// Prints JSON
    #[arg(long)]
    json: bool,
}

fn limit(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0);
    number.ok_or_else(|| "allowed: a finite number greater than 0".into())
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let calibration = Calibration::read(&a.calibration)?;
    let shot = read_shot(&a.capture, &a.board)?;
    let capture = shot
        .capture
        .as_ref()
        .with_context(|| format!("{}: a picture; a folder with a capture.toml is needed", a.capture.display()))?;
    let projector = (capture.projector.width, capture.projector.height);
    let calibration = calibration
        .for_sizes(shot.size, projector, a.scale_calibration)
        .with_context(|| capture.file().display().to_string())?;
    let rig = &calibration.rig;
    let camera = shot.sighting.through(&a.board, &rig.camera).seen();
    let lit = Lit::read(capture, &a.board, &camera)?.projector(&camera, &rig.camera);
    let limits = VerifyLimits {
        scale_percent: a.max_scale_percent,
        flatness_mm: a.max_flatness_mm,
        epipolar_px: a.max_epipolar_px,
    };
    let result = verify(rig, &a.board, &camera, &lit, limits).with_context(|| a.capture.display().to_string())?;
    let text = if a.json {
        let mut out = report::rig(&rig.camera, Some(rig));
        let std = calibration.covariance.as_ref().map(|c| {
            let of = |(k, name): (usize, &&str)| (name.to_string(), json!(c[(k, k)].sqrt()));
            PARAMETERS.iter().enumerate().map(of).collect::<serde_json::Map<_, _>>()
        });
        let rms = result.reprojection_rms_px;
        out.insert("rms_px".into(), json!({"camera": rms[0], "projector": rms[1], "joint": rms[2]}));
        out.insert("std".into(), json!(std));
        out.insert("views".into(), json!([{"name": shot.name, "rms_px": rms[0], "used": true}]));
        out.insert("leave_one_out_rms_px".into(), json!(null));
        let board = &result.board;
        out.insert("kabsch".into(), json!([{"name": shot.name, "rms_mm": board.rms_mm, "scale": board.scale}]));
        out.insert("verification".into(), json!(result));
        format!("{:#}\n", serde_json::Value::Object(out))
    } else {
        let frames = result.frames_error_mm.map_or(String::new(), |[x, y, z]| {
            format!("From the left half's frame to the right half's: off by ({x:+.3}, {y:+.3}, {z:+.3}) mm.\n")
        });
        format!("{}\n{frames}", result.detail)
    };
    print(&text)?;
    Ok(if result.ok { Status::Done } else { Status::Refused })
}
