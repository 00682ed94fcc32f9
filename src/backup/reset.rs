//! A station as it left the factory. In: where its configuration lies. Out: what goes; the same done. Calibration files and
//! the hours of light stay: they are the camera's, the projector's and the lamps', not the plant's.

use super::belongings::belongings;
use super::restore::ASIDE;
use crate::document::Error;
use crate::records::of_vehicles;
use crate::station::StationFile;
use std::fs;
use std::path::{Path, PathBuf};

/// What goes and what stays.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reset {
    /// Files and folders that go.
    pub goes: Vec<PathBuf>,
    /// The calibration, if the configuration names one.
    pub stays: Option<PathBuf>,
}

/// What a factory reset of the station would remove; nothing is changed.
pub fn reset(config: &StationFile) -> Result<Reset, Error> {
    let stays = config.calibration.as_ref().map(|c| config.beside(c));
    let mut goes = vec![config.file.clone()];
    let files = belongings(config)?;
    goes.extend(files.iter().map(|f| config.beside(f)).filter(|f| f.exists() && Some(f) != stays.as_ref()));
    let inside = |folder: &Path| fs::read_dir(folder).into_iter().flatten().flatten();
    // by what they are, not by where: a records folder may hold more than records
    goes.extend(of_vehicles(&config.beside(&config.records.folder)));
    let beside = config.beside(Path::new("."));
    let aside = inside(&beside).filter(|e| e.file_name().as_encoded_bytes().starts_with(ASIDE.as_bytes()));
    goes.extend(aside.map(|e| config.beside(Path::new(&e.file_name()))));
    goes.sort();
    Ok(Reset { goes, stays })
}

impl Reset {
    /// Removes what goes, the configuration last: broken off before that, it can be done again.
    pub fn apply(&self, config: &StationFile) -> Result<(), Error> {
        let (last, first): (Vec<_>, Vec<_>) = self.goes.iter().partition(|f| **f == config.file);
        for file in first.into_iter().chain(last) {
            let removed = if file.is_dir() { fs::remove_dir_all(file) } else { fs::remove_file(file) };
            removed.map_err(|source| Error::Write { file: file.clone(), source })?;
        }
        Ok(())
    }
}
