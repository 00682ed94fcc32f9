//! `datum calibrate projector`: captures of a board with column and row fringes in; the rig out.

use super::super::{Status, print};
use super::input::{Shot, read_shots, seen};
use super::report;
use crate::calibrate::{
    Board, Calibration, Lit, MIN_VIEWS, Quality, Rms, Serials, Solution, Terms, View, keep, scale_sigma, solve,
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

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let mut shots = read_shots(&a.captures, &a.board)?;
    anyhow::ensure!(
        shots.len() >= MIN_VIEWS,
        "--board {}: found in {} of {} captures, at least {MIN_VIEWS} are needed",
        a.board,
        shots.len(),
        a.captures.len()
    );
    let projector = projector_size(&shots)?;
    let points = a.board.points();
    if a.board.diameter().is_some() {
        // the centres of discs are better once the lens is known
        let view = |s: &Shot| View { name: s.name.clone(), seen: [seen(&s.sighting), Vec::new()] };
        let views: Vec<View> = shots.iter().map(view).collect();
        let lens = solve(&points, &views, [Some(shots[0].size), None], Terms::Chosen)?.devices[0].lens.clone();
        shots.iter_mut().for_each(|s| s.sighting = s.sighting.through(&a.board, &lens));
    }
    let mut views = Vec::new();
    for (n, shot) in shots.iter().enumerate() {
        eprintln!("{}/{} {}: decoding", n + 1, shots.len(), shot.name);
        let camera = seen(&shot.sighting);
        let lit = Lit::read(capture(shot)?, &a.board, &camera)?.projector(&a.board, &camera);
        let rows = lit.iter().all(|(_, at)| at.y.is_finite());
        Check(&capture(shot)?.file()).that(
            rows && !lit.is_empty(),
            "[[fringes]]",
            if lit.is_empty() { "no valid fringes on the board" } else { "no row set of count 1" },
            "column and row fringes on the board, the coarsest of each with count 1",
        )?;
        views.push(View { name: shot.name.clone(), seen: [camera, lit] });
    }
    let solution = solve(&points, &views, [Some(shots[0].size), Some(projector)], Terms::Chosen)?;
    let calibration = calibration(&solution, &shots, a)?;
    let coverage = solution.coverage();
    let scale = calibration.quality.as_ref().and_then(|q| q.scale_sigma_percent);
    let text = if a.json {
        format!("{:#}\n", report::json(&solution, &coverage, scale))
    } else {
        report::table(&solution, &coverage, scale)
    };
    print(&text)?;
    if let Some(file) = &a.out {
        let kept = keep(file, &calibration, a.force)?;
        kept.iter().for_each(|old| eprintln!("{}: the one before", old.display()));
    }
    Ok(Status::Done)
}

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
    let mut out = Calibration {
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
    };
    let sigma = scale_sigma(&out, s.working_distance_mm(&a.board.points()));
    out.quality.as_mut().expect("set just now").scale_sigma_percent = sigma.map(|s| 100.0 * s);
    Ok(out)
}
