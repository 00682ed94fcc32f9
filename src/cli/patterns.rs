//! `datum patterns`: the default pattern set as PNGs, and a list of them in the words of a capture.toml.

use super::{Status, print};
use crate::Calibration;
use crate::capture::{FringeSet, Projector};
use crate::document;
use crate::fringe::{Axis, PatternSet};
use crate::image::write_png;
use crate::station::stored_pictures;
use anyhow::Context;
use std::path::PathBuf;

/// Periods across the projector, and phase steps.
const SETS: [(u32, u32); 3] = [(1, 4), (8, 4), (64, 8)];

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The folder to write into
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Writes what a projector that stores its pictures is to hold, in the order of the names: black, an even grey, the
    /// fringes in the order of a cycle, then row fringes for boards
    #[arg(long)]
    stored: bool,
    /// Takes the projector's size from this calibration; without it: 1280×800
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
}

/// What patterns.toml lists.
#[derive(serde::Serialize)]
struct List {
    format: u32,
    projector: Projector,
    fringes: Vec<FringeSet>,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let calibration = a.calibration.as_deref().map(Calibration::read).transpose()?;
    let (width, height) = calibration.map_or((1280, 800), |c| (c.rig.projector.width, c.rig.projector.height));
    let finest = SETS[2].0; // two pixels a period are the least that can be shown
    anyhow::ensure!(finest as usize * 2 <= width, "{finest} fringes need a projector of {} columns", finest * 2);
    std::fs::create_dir_all(&a.out).with_context(|| format!("{}: cannot be made", a.out.display()))?;
    if a.stored {
        let pictures = stored_pictures(width, height);
        for (k, picture) in pictures.iter().enumerate() {
            write_png(&a.out.join(format!("{k:03}.png")), picture)?;
        }
        print(&format!("{}: {} pictures of {width}×{height} to be stored\n", a.out.display(), pictures.len()))?;
        return Ok(Status::Done);
    }
    let mut fringes = Vec::new();
    for (count, steps) in SETS {
        let set = PatternSet::new(Axis::Column, count, steps)?;
        let mut images = Vec::new();
        for step in 0..steps {
            let name = PathBuf::from(format!("column-{count:02}-{step:02}.png"));
            write_png(&a.out.join(&name), &set.render(step, width, height))?;
            images.push(name);
        }
        fringes.push(FringeSet { axis: Axis::Column, count, steps, gain_dn_per_e: None, exposure_ms: None, images });
    }
    let written: usize = fringes.iter().map(|s| s.images.len()).sum();
    let list = List { format: document::FORMAT, projector: Projector { width, height }, fringes };
    document::write(&a.out.join("patterns.toml"), &list)?;
    print(&format!("{}: {written} patterns of {width}×{height} and patterns.toml\n", a.out.display()))?;
    Ok(Status::Done)
}
