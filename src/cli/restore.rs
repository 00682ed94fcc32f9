//! `datum restore`: a backup in, a station out.

use super::{Status, print};
use crate::backup::{Backup, Change, Restore};
use crate::records::{Fault, Lock};
use crate::station::StationFile;
use anyhow::Context;
use std::fmt::Write;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The backup
    #[arg(value_name = "F")]
    file: PathBuf,
    /// Where the station's configuration lies, or is to lie; everything else goes beside it
    #[arg(long, value_name = "FILE", default_value = "station.toml")]
    config: PathBuf,
    /// Says what would change, and changes nothing
    #[arg(long)]
    dry_run: bool,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let backup = Backup::read(&a.file)?;
    let restore = Restore::new(&backup, &a.config)
        .with_context(|| format!("{}: what it holds does not make a station", a.file.display()))?;
    let mut out =
        format!("{}: station {}, by datum {}, {}\n", a.file.display(), backup.serial, backup.software, backup.taken_at);
    for (name, change) in &restore.changes {
        let what = match change {
            Change::New => "new",
            Change::Same => "as it is",
            Change::Replaced => "replaced",
            Change::Removed => "removed",
        };
        writeln!(out, "  {what:<10}{name}")?;
    }
    print(&out)?;
    for said in &restore.unusable {
        eprintln!("warning: a vehicle model that this version cannot use: {said}");
    }
    if restore.is_done() {
        print("Nothing to do: everything is as in the backup.\n")?;
    } else if a.dry_run {
        print("Nothing was changed. What is replaced or removed will be kept in a folder before-restore-N.\n")?;
    } else {
        let _lock = match hold(&a.config)? {
            Ok(lock) => lock,
            Err(status) => return Ok(status),
        };
        match restore.apply()? {
            Some(aside) => print(&format!("Restored; what was there before is in {}.\n", aside.display()))?,
            None => print("Restored.\n")?,
        }
    }
    Ok(Status::Done)
}

/// The lock of the records of the station at `config`, so that no service runs meanwhile; none where there are no records.
pub(super) fn hold(config: &Path) -> anyhow::Result<Result<Option<Lock>, Status>> {
    // where the configuration cannot be read its records are where they usually are
    let config =
        StationFile::read(config).unwrap_or_else(|_| StationFile { file: config.into(), ..StationFile::default() });
    let records = config.beside(&config.records.folder);
    if !records.is_dir() {
        return Ok(Ok(None));
    }
    match Lock::hold(&records) {
        Ok(lock) => Ok(Ok(Some(lock))),
        Err(held @ Fault::Held { .. }) => {
            eprintln!("error: {held} End it first (on an appliance: systemctl stop datum).");
            Ok(Err(Status::Device))
        }
        Err(fault) => Err(fault.into()),
    }
}
