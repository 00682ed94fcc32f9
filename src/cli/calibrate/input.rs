//! What is calibrated from: pictures and captures of a board, with the board found in them.

use crate::calibrate::target::{Sighting, find};
use crate::calibrate::{Board, MIN_VIEWS, mean};
use crate::capture::{self, Capture};
use crate::image::{Image, read_png};
use anyhow::Context;
use std::path::{Path, PathBuf};

/// A picture or a capture with the board in it.
pub(super) struct Shot {
    pub(super) name: String,
    pub(super) file: PathBuf,
    pub(super) size: (usize, usize),
    pub(super) sighting: Sighting,
    /// If it is one.
    pub(super) capture: Option<Capture>,
}

/// A picture or a capture without the board.
pub(super) struct LeftOut {
    pub(super) name: String,
    pub(super) detail: String,
}

/// The shots that show the board, and the others.
pub(super) struct Shots {
    pub(super) shots: Vec<Shot>,
    pub(super) left_out: Vec<LeftOut>,
}

/// What shows no board is told on standard error, too. Errors where a file cannot be read, is given twice, or is of another
/// size than the first, and where too few show the board.
pub(super) fn read_shots(paths: &[PathBuf], board: &Board) -> anyhow::Result<Shots> {
    different(paths)?;
    let mut out = Shots { shots: Vec::new(), left_out: Vec::new() };
    let mut first: Option<(PathBuf, (usize, usize))> = None;
    for (n, path) in paths.iter().enumerate() {
        let (image, capture) = read(path)?;
        let size = (image.width, image.height);
        let (one, of_first) = first.get_or_insert((path.clone(), size));
        anyhow::ensure!(
            size == *of_first,
            "{}: {}×{} px, allowed: {}×{} as {}: a calibration is of one sensor in one mode",
            path.display(),
            size.0,
            size.1,
            of_first.0,
            of_first.1,
            one.display()
        );
        let name = capture::name_of(path);
        match find(&image, board) {
            Ok(sighting) => {
                eprintln!("{}/{} {name}: {} of {} points", n + 1, paths.len(), count(&sighting), sighting.marks.len());
                out.shots.push(Shot { name, file: path.clone(), size, sighting, capture });
            }
            Err(e) => {
                eprintln!("{}/{} {name}: left out: {e}", n + 1, paths.len());
                out.left_out.push(LeftOut { name, detail: e.to_string() });
            }
        }
    }
    anyhow::ensure!(
        out.shots.len() >= MIN_VIEWS,
        "--board {board}: found in {} of {}, at least {MIN_VIEWS} are needed",
        out.shots.len(),
        paths.len()
    );
    Ok(out)
}

/// A view that counts twice would make a calibration look better than it is.
fn different(paths: &[PathBuf]) -> anyhow::Result<()> {
    let mut seen = std::collections::HashMap::new();
    for path in paths {
        // what does not resolve is an error when it is read
        let Ok(file) = path.canonicalize() else { continue };
        if let Some(before) = seen.insert(file, path) {
            anyhow::bail!("{}: given twice (as {}), allowed: each view once", path.display(), before.display());
        }
    }
    Ok(())
}

/// One shot, which must show the board.
pub(super) fn read_shot(path: &Path, board: &Board) -> anyhow::Result<Shot> {
    let (image, capture) = read(path)?;
    let sighting = find(&image, board).with_context(|| path.display().to_string())?;
    let size = (image.width, image.height);
    Ok(Shot { name: capture::name_of(path), file: path.into(), size, sighting, capture })
}

/// The picture at `path`, or the mean of the fringe images of the capture there.
fn read(path: &Path) -> anyhow::Result<(Image<f32>, Option<Capture>)> {
    if path.is_dir() {
        let capture = Capture::open(path)?;
        return Ok((mean(&capture)?, Some(capture)));
    }
    let image = read_png(path)?; // its errors name the file
    let pixels = image.pixels.iter().map(|&v| f32::from(v)).collect();
    Ok((Image { width: image.width, height: image.height, pixels }, None))
}

fn count(sighting: &Sighting) -> usize {
    sighting.marks.iter().flatten().count()
}
