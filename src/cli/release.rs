//! `datum release`: a taught vehicle model in, the same with its fingerprint out.

use super::{Status, print};
use crate::VehicleFile;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The vehicle model
    #[arg(value_name = "VEHICLE")]
    vehicle: PathBuf,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let mut model = VehicleFile::read(&a.vehicle)?;
    let fingerprint = model.release()?;
    print(&format!("{}: job {} released, fingerprint {fingerprint}\n", a.vehicle.display(), model.job))?;
    Ok(Status::Done)
}
