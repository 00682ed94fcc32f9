//! `datum reset`: a station in, one as it left the factory out.

use super::{Status, print};
use crate::backup::reset;
use crate::station::StationFile;
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration
    #[arg(long, value_name = "FILE", default_value = "station.toml")]
    config: PathBuf,
    /// Does it; without, it only says what would go
    #[arg(long)]
    yes: bool,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let config = StationFile::read(&a.config)?;
    let plan = reset(&config)?;
    let mut out = String::new();
    for file in &plan.goes {
        writeln!(out, "  goes      {}", file.display())?;
    }
    if let Some(calibration) = &plan.stays {
        writeln!(out, "  stays     {}", calibration.display())?;
    }
    print(&out)?;
    if !a.yes {
        print("Nothing was removed. `datum backup F` keeps what goes, records apart; --yes removes it.\n")?;
        return Ok(Status::Done);
    }
    let _lock = match super::restore::hold(&a.config)? {
        Ok(lock) => lock,
        Err(status) => return Ok(status),
    };
    plan.apply(&config)?;
    print("Removed.\n")?;
    Ok(Status::Done)
}
