//! `datum backup`: a station in, one file out.

use super::{Status, print, sentence};
use crate::Calibration;
use crate::backup::{Backup, belongings, unusable_jobs};
use crate::document::{self, Error};
use crate::station::StationFile;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A file of a station has at most so many bytes: a detector's network.
const MAX_BYTES: u64 = 64 << 20;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The file to write
    #[arg(value_name = "F")]
    file: PathBuf,
    /// The station's configuration
    #[arg(long, value_name = "FILE", default_value = "station.toml")]
    config: PathBuf,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let config = StationFile::read(&a.config)?;
    if let Some(calibration) = &config.calibration {
        Calibration::read(&config.beside(calibration))?; // what cannot be restored is told now
    }
    config.read_detector()?;
    for e in unusable_jobs(&config) {
        eprintln!("warning: {}", sentence(&e));
    }
    let mut files = BTreeMap::from([("station.toml".into(), document::read_bytes(&a.config, MAX_BYTES)?)]);
    for path in belongings(&config)? {
        let file = config.beside(&path);
        let Some(name) = path.to_str() else {
            let wrong = "its name is not UTF-8, allowed: names of plain text".into();
            return Err(Error::Content { file, wrong }.into());
        };
        files.insert(name.to_owned(), document::read_bytes(&file, MAX_BYTES)?);
    }
    let bytes: usize = files.values().map(Vec::len).sum();
    let backup = Backup::new(&config.serial, files);
    backup.write(&a.file)?;
    let (n, serial) = (backup.files.len(), &backup.serial);
    print(&format!("{}: {n} files of station {serial}, {} kB\n", a.file.display(), bytes.div_ceil(1000)))?;
    Ok(Status::Done)
}
