//! `datum teach`: one good capture and clicked features in, a vehicle model with templates out.

use super::{Status, print};
use crate::document::Check;
use crate::measure::{table, teach};
use crate::{Calibration, Capture, VehicleFile};
use anyhow::Context;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The folder with a capture.toml
    #[arg(value_name = "CAPTURE")]
    capture: PathBuf,
    /// The calibration of camera and projector
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The features with their pixels
    #[arg(long, value_name = "FILE")]
    features: PathBuf,
    /// The vehicle model to write; its templates are written beside it
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let calibration = Calibration::read(&a.calibration)?;
    let features = VehicleFile::read(&a.features)?;
    let capture = Capture::open(&a.capture)?;
    capture.red()?;
    let (c, p) = (&capture.camera, &capture.projector);
    let calibration = calibration
        .for_sizes((c.width, c.height), (p.width, p.height), false)
        .with_context(|| capture.file().display().to_string())?;
    for (i, f) in features.features.iter().enumerate() {
        let inside = f.click().is_some_and(|px| px.x <= c.width as f64 - 0.5 && px.y <= c.height as f64 - 0.5);
        let found = f.pixel.map_or("(missing)".into(), |p| format!("{p:?}"));
        let allowed = format!("where it was clicked in the capture's red image of {}×{}", c.width, c.height);
        Check(&a.features).that(inside, format!("feature[{i}].pixel"), found, allowed)?;
    }
    if let Some(folder) = a.out.parent().filter(|f| !f.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    }
    let stem = a.out.file_stem().and_then(|s| s.to_str()).context("--out: not a file name")?;
    let taught = teach(&capture, &calibration, &features, stem)?;
    taught.write(&a.out)?;
    print(&format!("{}: {} features taught; its own capture measures:\n", a.out.display(), taught.templates.len()))?;
    print(&table(&[taught.check]))?;
    Ok(Status::Done)
}
