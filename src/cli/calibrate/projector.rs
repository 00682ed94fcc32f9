//! `datum calibrate projector`: captures of a board with column and row fringes in; the rig out.

use super::super::{Status, print};
use super::input::{Shot, Shots, read_shots};
use super::report;
use crate::calibrate::{
    Board, Calibration, Lit, Quality, Rms, Serials, Shown, Solution, check_replaceable, keep, scale_sigma, solve_shown,
};
use crate::capture::Capture;
use crate::document::Check;
use anyhow::Context;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// Folders with a capture.toml that show the board under column and row fringes
    #[arg(required = true, value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// The board: chessboard:11x8:35 (inner corners, pitch mm), circles:8x4:60:30 (pitch, diameter), marked:8x4:60:30
    #[arg(long)]
    board: Board,
    /// Standard deviation of the board's pitch, %: how well the print was measured
    #[arg(long, default_value_t = 0.02, value_parser = percent, value_name = "PERCENT")]
    pitch_sigma_percent: f64,
    /// Writes the calibration; one that is there is kept beside it
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replaces a better calibration, or a file that is none
    #[arg(long)]
    force: bool,
    /// Prints JSON
    #[arg(long)]
    json: bool,
}

fn percent(text: &str) -> Result<f64, String> {
    let value = text.parse().ok().filter(|v| (0.0..=5.0).contains(v));
    value.ok_or_else(|| "allowed: 0 to 5 %".into())
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    a.out.as_deref().map_or(Ok(()), |out| check_replaceable(out, a.force))?;
    if let Some(picture) = a.captures.iter().find(|c| c.is_file()) {
        anyhow::bail!("{}: a file, allowed: folders with a capture.toml", picture.display());
    }
    let Shots { shots, left_out } = read_shots(&a.captures, &a.board)?;
    let projector = projector_size(&shots)?;
    let points = a.board.points();
    let mut shown = Vec::new();
    for (n, shot) in shots.iter().enumerate() {
        eprintln!("{}/{} {}: decoding", n + 1, shots.len(), shot.name);
        let lit = Lit::read(capture(shot)?, &a.board, &shot.sighting.seen())?;
        Check(&capture(shot)?.file()).that(
            lit.has_rows() && !lit.is_empty(),
            "[[fringes]]",
            if lit.has_rows() { "no valid fringes on the board" } else { "no row set of count 1" },
            "column and row fringes on the board, the coarsest of each with count 1",
        )?;
        shown.push(Shown { name: shot.name.clone(), sighting: shot.sighting.clone(), lit });
    }
    let solution = solve_shown(&a.board, &shown, [shots[0].size, projector])?;
    let distance_mm = solution.working_distance_mm(&points);
    let mut calibration = calibration(&solution, &shots, a)?;
    let of_fit = scale_sigma(&calibration, distance_mm);
    calibration.add_scale_sigma(a.pitch_sigma_percent / 100.0);
    let total = scale_sigma(&calibration, distance_mm).map(|s| 100.0 * s);
    calibration.quality.get_or_insert_default().scale_sigma_percent = total;
    let coverage = solution.coverage();
    let text = if a.json {
        format!("{:#}\n", report::json(&solution, Some(&coverage), total, &left_out))
    } else {
        report::table(&solution, Some(&coverage), total)
    };
    if let Some(s) = of_fit {
        eprintln!("scale: ± {:.4} % from the fit, ± {:.4} % from the board's pitch", 100.0 * s, a.pitch_sigma_percent);
    }
    if total.is_some_and(|t| t > WARN_SCALE_PERCENT) {
        eprintln!(
            "warning: lengths are known to ± {:.2} % only: take what is missing below",
            total.unwrap_or(f64::NAN)
        );
    }
    if let Some(file) = &a.out {
        let surveyed = Calibration::read(file).is_ok_and(|c| c.station_from_camera.is_some());
        let kept = keep(file, &calibration, a.force)
            .inspect_err(|_| eprint!("{}", report::table(&solution, Some(&coverage), total)))?;
        kept.iter().for_each(|old| eprintln!("{}: the one before", old.display()));
        if surveyed {
            eprintln!("warning: the datum survey is not carried over: repeat `datum calibrate station`");
        }
    }
    print(&text)?;
    Ok(Status::Done)
}

/// Sigma of scale above which a rig is hardly fit to measure, %.
const WARN_SCALE_PERCENT: f64 = 0.05;

fn capture(shot: &Shot) -> anyhow::Result<&Capture> {
    shot.capture
        .as_ref()
        .with_context(|| format!("{}: a picture; a folder with a capture.toml is needed", shot.file.display()))
}

/// The projector's size, which all captures share.
fn projector_size(shots: &[Shot]) -> anyhow::Result<(usize, usize)> {
    let mut size = None;
    for shot in shots {
        let capture = capture(shot)?;
        let own = (capture.projector.width, capture.projector.height);
        let (w, h) = *size.get_or_insert(own);
        let found = format!("{}×{}", own.0, own.1);
        let allowed = format!("{w}×{h} as the first capture's");
        Check(&capture.file()).that(own == (w, h), "projector.width × projector.height", found, allowed)?;
    }
    size.context("no captures")
}

fn calibration(s: &Solution, shots: &[Shot], a: &Arguments) -> anyhow::Result<Calibration> {
    let captures: Vec<&Capture> = shots.iter().filter_map(|s| s.capture.as_ref()).collect();
    let date = captures.iter().map(|c| c.taken_at.clone()).max();
    let serial = captures.first().and_then(|c| c.camera.serial.clone());
    let id = date.as_ref().map(|d| format!("{d}/{}/-", serial.as_deref().unwrap_or("-")));
    let [camera, projector, joint] = s.rms_px.map(Some);
    Ok(Calibration {
        file: a.out.clone().unwrap_or_default(),
        id,
        rig: s.rig().context("a calibration without a projector")?,
        station_from_camera: None,
        covariance: Some(Box::new(s.parameter_covariance())),
        quality: Some(Quality {
            date,
            board: Some(a.board.to_string()),
            views: Some(s.views.iter().filter(|v| v.used).count() as u32),
            scale_sigma_percent: None,
            rms_px: Some(Rms { camera, projector, joint }),
            serials: serial.map(|camera| Serials { camera: Some(camera), projector: None }),
        }),
    })
}
