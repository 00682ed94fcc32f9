//! `datum calibrate camera`: pictures of a board, or given points, in; the camera's lens out.

use super::super::{Status, print};
use super::input::{LeftOut, Shot, Shots, read_shots};
use super::report;
use crate::calibrate::{Board, Solution, Terms, View, check_replaceable, keep_camera, read_points, solve};
use crate::document::Check;
use crate::image::MAX_SIDE;
use crate::optics::Pixel;
use anyhow::Context;
use std::path::{Path, PathBuf};

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

/// Larger pixels, and larger coordinates of a board in any unit, are no points; their squares would overflow.
const MAX_PIXEL: f64 = 1e5;
const MAX_BOARD: f64 = 1e6;
/// Images of fewer columns or rows show no board.
const MIN_SIDE: usize = 16;

fn size(text: &str) -> Result<(usize, usize), String> {
    let side = |t: &str| t.parse().ok().filter(|n| (MIN_SIDE..=MAX_SIDE).contains(n));
    let sides = text.split_once('x').and_then(|(w, h)| side(w).zip(side(h)));
    sides.ok_or_else(|| format!("allowed: WIDTHxHEIGHT in px, each {MIN_SIDE} to {MAX_SIDE}"))
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    a.out.as_deref().map_or(Ok(()), |out| check_replaceable(out, a.force))?;
    let (solution, left_out) = match &a.board {
        Some(board) => from_shots(a, board)?,
        None => (from_points(a)?, Vec::new()),
    };
    // an assumed image ends where the points do: they cover it, whatever they are
    let known = a.board.is_some() || a.size.is_some();
    let coverage = known.then(|| solution.coverage());
    if let Some(file) = &a.out {
        let kept = keep_camera(file, &solution, a.board.as_ref(), a.force)?;
        kept.iter().for_each(|old| eprintln!("{}: the one before", old.display()));
        let skew = solution.devices[0].skew;
        if skew != 0.0 {
            eprintln!("{}: without the skew of {skew:.4} px: a calibration file has none", file.display());
        }
    }
    let text = if a.json {
        format!("{:#}\n", report::json(&solution, coverage.as_ref(), None, &left_out))
    } else {
        report::table(&solution, coverage.as_ref(), None)
    };
    print(&text)?;
    Ok(Status::Done)
}

fn from_shots(a: &Arguments, board: &Board) -> anyhow::Result<(Solution, Vec<LeftOut>)> {
    let Shots { mut shots, left_out } = read_shots(&a.shots, board)?;
    let points = board.points();
    let solved = |shots: &[Shot]| {
        let view = |s: &Shot| View { name: s.name.clone(), seen: [s.sighting.seen(), Vec::new()] };
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
    Ok((solution, left_out))
}

fn from_points(a: &Arguments) -> anyhow::Result<Solution> {
    let [model, data @ ..] = a.points.as_slice() else { unreachable!("clap asks for two files at least") };
    let board = read_points(model)?;
    within(model, &board, Pixel::repeat(-MAX_BOARD), Pixel::repeat(MAX_BOARD))?;
    // half an image outside of it a point may be wrong; further out the size is
    let (low, high) = a.size.map_or((Pixel::repeat(-MAX_PIXEL), Pixel::repeat(MAX_PIXEL)), |(w, h)| {
        let size = Pixel::new(w as f64, h as f64);
        (-0.5 * size, 1.5 * size)
    });
    let mut views = Vec::new();
    let mut largest = Pixel::zeros();
    for file in data {
        let pixels = read_points(file)?;
        let allowed = format!("as many as {}, {}", model.display(), board.len());
        Check(file).that(pixels.len() == board.len(), "count of points", pixels.len(), allowed)?;
        within(file, &pixels, low, high)?;
        largest = pixels.iter().fold(largest, |a, p| a.sup(p));
        let name = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        views.push(View { name, seen: [pixels.into_iter().enumerate().collect(), Vec::new()] });
    }
    let size = match a.size {
        Some(size) => size,
        None => assumed(largest)?,
    };
    Ok(solve(&board, &views, [Some(size), None], Terms::Zhang)?)
}

/// All of `points` lie in the box.
fn within(file: &Path, points: &[Pixel], low: Pixel, high: Pixel) -> Result<(), crate::document::Error> {
    let inside = |p: &Pixel| *p >= low && *p <= high;
    let allowed = format!("x {} to {}, y {} to {}", low.x, high.x, low.y, high.y);
    let outside = points.iter().enumerate().find(|(_, p)| !inside(p));
    outside.map_or(Ok(()), |(k, p)| {
        Check(file).that(false, format!("point {}", k + 1), format!("({:?}, {:?})", p.x, p.y), allowed)
    })
}

/// The size of an image that ends at its last points.
fn assumed(largest: Pixel) -> anyhow::Result<(usize, usize)> {
    let (w, h) = (largest.x.ceil() as usize + 1, largest.y.ceil() as usize + 1);
    let sides = MIN_SIDE..=MAX_SIDE;
    let likely = sides.contains(&w) && sides.contains(&h);
    likely.then_some(()).with_context(|| format!("--size is needed: from the points the image would be {w}×{h} px"))?;
    eprintln!("image size assumed from the points: {w}×{h} px; --size sets it");
    Ok((w, h))
}
