//! `datum calibrate camera`: pictures of a board, or given points, in; the camera's lens out.

use super::super::{Status, print};
use super::input::{read_shots, seen};
use super::report;
use crate::calibrate::{Board, MIN_VIEWS, Solution, Terms, View, keep_camera, read_points, solve};
use crate::document::Check;
use nalgebra::Vector2;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(in crate::cli) struct Arguments {
    /// Grey PNGs, or folders with a capture.toml, that show the board
    #[arg(required_unless_present = "points", value_name = "IMAGE_OR_CAPTURE")]
    shots: Vec<PathBuf>,
    /// The board: chessboard:11x8:35 (inner corners, pitch mm), circles:8x4:60:30 (pitch, diameter), marked:8x4:60:30
    #[arg(long, required_unless_present = "points")]
    board: Option<Board>,
    /// Given correspondences instead of pictures: a text file with the board's points, one with the pixels of each view
    #[arg(long, num_args = 2.., value_name = "FILE", conflicts_with_all = ["shots", "board"])]
    points: Vec<PathBuf>,
    /// With --points: the image's size; else taken from the points
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size, requires = "points")]
    size: Option<(usize, usize)>,
    /// Writes the camera's calibration
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Replaces a better calibration, or a file that is none
    #[arg(long)]
    force: bool,
    /// Prints JSON
    #[arg(long)]
    json: bool,
}

fn size(text: &str) -> Result<(usize, usize), String> {
    let side = |t: &str| t.parse().ok().filter(|n| (16..=crate::image::MAX_SIDE).contains(n));
    let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
    sides.ok_or_else(|| format!("allowed: WIDTHxHEIGHT in px, each 16 to {}", crate::image::MAX_SIDE))
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let (solution, board) = match &a.board {
        Some(board) => (from_shots(a, board)?, Some(*board)),
        None => (from_points(a)?, None),
    };
    let coverage = solution.coverage();
    if let Some(file) = &a.out {
        let kept = keep_camera(file, &solution, board.as_ref(), a.force)?;
        kept.iter().for_each(|old| eprintln!("{}: the one before", old.display()));
    }
    let text = if a.json {
        format!("{:#}\n", report::json(&solution, &coverage, None))
    } else {
        report::table(&solution, &coverage, None)
    };
    print(&text)?;
    Ok(Status::Done)
}

fn from_shots(a: &Arguments, board: &Board) -> anyhow::Result<Solution> {
    let mut shots = read_shots(&a.shots, board)?;
    anyhow::ensure!(
        shots.len() >= MIN_VIEWS,
        "--board {board}: found in {} of {} pictures, at least {MIN_VIEWS} are needed",
        shots.len(),
        a.shots.len()
    );
    let points = board.points();
    let solved = |shots: &[super::input::Shot]| {
        let view = |s: &super::input::Shot| View { name: s.name.clone(), seen: [seen(&s.sighting), Vec::new()] };
        let views: Vec<View> = shots.iter().map(view).collect();
        solve(&points, &views, [Some(shots[0].size), None], Terms::Chosen)
    };
    let mut solution = solved(&shots)?;
    if board.diameter().is_some() {
        // the centres of discs are better once the lens is known
        let lens = solution.devices[0].lens.clone();
        shots.iter_mut().for_each(|s| s.sighting = s.sighting.through(board, &lens));
        solution = solved(&shots)?;
    }
    Ok(solution)
}

fn from_points(a: &Arguments) -> anyhow::Result<Solution> {
    let [model, data @ ..] = a.points.as_slice() else { unreachable!("clap asks for two files at least") };
    let board = read_points(model)?;
    let mut views = Vec::new();
    let mut largest = Vector2::new(0f64, 0.0);
    for file in data {
        let pixels = read_points(file)?;
        let allowed = format!("as many as {}, {}", model.display(), board.len());
        Check(file).that(pixels.len() == board.len(), "count of points", pixels.len(), allowed)?;
        largest = pixels.iter().fold(largest, |a, p| a.sup(p));
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        views.push(View { name, seen: [pixels.into_iter().enumerate().collect(), Vec::new()] });
    }
    let size = a.size.unwrap_or((largest.x.ceil() as usize + 1, largest.y.ceil() as usize + 1));
    Ok(solve(&board, &views, [Some(size), None], Terms::Zhang)?)
}
