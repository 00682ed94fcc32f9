//! What belongs to a station. In: its configuration. Out: the files that it names, and what it is called.

use crate::detect;
use crate::document::{Check, Error};
use crate::station::StationFile;
use crate::vehicle::VehicleFile;
use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};

/// The folder beside the configuration that holds what an appliance is called and where it is reached: hostname and
/// network, as its first start made them or a person put them there.
pub const IDENTITY: &str = "identity";

/// The files of a station, by their paths from its configuration's folder; the configuration itself apart. An error names
/// a key whose path leads out of that folder: what lies elsewhere would not be found again.
pub fn belongings(config: &StationFile) -> Result<BTreeSet<PathBuf>, Error> {
    let check = Check(&config.file);
    let below = |key: &str, path: &Path| {
        let ok = path.components().all(|c| matches!(c, Component::Normal(_))) && path.to_str().is_some();
        check.that(ok, key, path.display(), "a path below the configuration's folder, or there is no backup")
    };
    let mut files = BTreeSet::new();
    if let Some(calibration) = &config.calibration {
        below("calibration", calibration)?;
        files.insert(calibration.clone());
    }
    if ![detect::DEFAULT, detect::NONE].iter().any(|name| config.detector == Path::new(name)) {
        below("detector", &config.detector)?;
        files.insert(config.detector.clone());
    }
    for (key, folder) in folders(config) {
        below(key, &folder)?;
        files.extend(inside(config, &folder)?);
    }
    Ok(files)
}

/// The folders that belong to a station whole, each with the key that names it.
pub(super) fn folders(config: &StationFile) -> Vec<(&'static str, PathBuf)> {
    let mut folders = vec![("jobs.folder", config.jobs.folder.clone()), (IDENTITY, IDENTITY.into())];
    folders.extend(config.projector.patterns.clone().map(|patterns| ("projector.patterns", patterns)));
    folders
}

/// The files in one of them, none where there is no folder. Hidden ones are work that was broken off.
pub(super) fn inside(config: &StationFile, folder: &Path) -> Result<Vec<PathBuf>, Error> {
    let at = config.beside(folder);
    let entries = match std::fs::read_dir(&at) {
        Ok(entries) => entries,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(source) => return Err(Error::Read { file: at, source }),
    };
    let mut files = Vec::new();
    for entry in entries {
        let entry = entry.map_err(|source| Error::Read { file: at.clone(), source })?;
        let name = entry.file_name();
        if entry.path().is_file() && !name.as_encoded_bytes().starts_with(b".") {
            files.push(folder.join(name));
        }
    }
    Ok(files)
}

/// Vehicle models of the station that cannot be used, each with what is wrong with it: it keeps no other from being used.
pub fn unusable_jobs(config: &StationFile) -> Vec<Error> {
    let files = inside(config, &config.jobs.folder).unwrap_or_default();
    let models = files.iter().filter(|f| f.extension().is_some_and(|e| e == "toml"));
    let usable = |file: &PathBuf| VehicleFile::read(&config.beside(file)).and_then(|model| model.templates()).err();
    models.filter_map(usable).collect()
}
