//! A station made from a backup. In: a [`Backup`], where the configuration lies or is to lie. Out: what would change; the
//! same done, each file whole or as it was, and everything that was replaced in a folder of its own.

use super::Backup;
use super::belongings::{belongings, folders, inside};
use crate::calibrate::Calibration;
use crate::document::{self, Check, Error};
use crate::station::StationFile;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The configuration's name in a backup.
pub(super) const CONFIG: &str = "station.toml";

/// What becomes of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// There is none yet.
    New,
    /// It is as in the backup.
    Same,
    /// It is another one, which is kept aside.
    Replaced,
    /// The backup has none in a folder that is restored whole: it is kept aside.
    Removed,
}

/// A backup that was checked against the place it is for.
#[derive(Debug)]
pub struct Restore<'a> {
    backup: &'a Backup,
    config: PathBuf,
    /// What becomes of each file, by its path from the configuration's folder.
    pub changes: BTreeMap<String, Change>,
    /// Vehicle models that this version cannot use, and why; the others are none the worse.
    pub unusable: Vec<String>,
}

impl<'a> Restore<'a> {
    /// Checks that `backup` makes a station, and compares it with what is at `config`, a path that may not exist yet.
    /// Nothing is changed.
    pub fn new(backup: &'a Backup, config: &Path) -> Result<Self, Error> {
        let (restored, unusable) = tried(backup)?;
        let here = StationFile { file: config.into(), ..restored };
        let mut changes = BTreeMap::new();
        for (name, content) in &backup.files {
            let change = match fs::read(place(config, name)) {
                Ok(there) if there == *content => Change::Same,
                Ok(_) => Change::Replaced,
                Err(_) if place(config, name).exists() => Change::Replaced,
                Err(_) => Change::New,
            };
            changes.insert(name.clone(), change);
        }
        for (_, folder) in folders(&here) {
            for file in inside(&here, &folder)? {
                let name = file.to_string_lossy().into_owned();
                changes.entry(name).or_insert(Change::Removed);
            }
        }
        Ok(Self { backup, config: config.into(), changes, unusable })
    }

    /// Whether everything is as in the backup already.
    pub fn is_done(&self) -> bool {
        self.changes.values().all(|c| *c == Change::Same)
    }

    /// Does it; where what was replaced is, if anything was. The configuration comes last: broken off before that, the
    /// station has its former one, and doing it again does the rest.
    pub fn apply(&self) -> Result<Option<PathBuf>, Error> {
        let folder = self.config.parent().unwrap_or(Path::new(""));
        let free = (1u32..).map(|n| folder.join(format!("{ASIDE}{n}"))).find(|f| !f.exists());
        let aside = free.expect("numbers do not end");
        let of = |wanted: Change| self.changes.iter().filter(move |(_, c)| **c == wanted).map(|(name, _)| name);
        let mut kept = false;
        for name in of(Change::Replaced).chain(of(Change::Removed)) {
            let (from, to) = (place(&self.config, name), aside.join(name));
            let written = |source| Error::Write { file: to.clone(), source };
            fs::create_dir_all(to.parent().unwrap_or(&aside)).map_err(written)?;
            fs::copy(&from, &to).and_then(|_| fs::File::open(&to)?.sync_all()).map_err(written)?;
            kept = true;
        }
        let (config, others): (Vec<_>, Vec<_>) =
            of(Change::New).chain(of(Change::Replaced)).partition(|name| *name == CONFIG);
        for name in others.into_iter().chain(config) {
            let to = place(&self.config, name);
            let parent = to.parent().unwrap_or(folder);
            fs::create_dir_all(parent).map_err(|source| Error::Write { file: to.clone(), source })?;
            document::write_bytes(&to, &self.backup.files[name])?;
        }
        for name in of(Change::Removed) {
            let file = place(&self.config, name);
            fs::remove_file(&file).map_err(|source| Error::Write { file, source })?;
        }
        Ok(kept.then_some(aside))
    }
}

/// Where what was replaced is kept, with a number.
pub(super) const ASIDE: &str = "before-restore-";

fn place(config: &Path, name: &str) -> PathBuf {
    if name == CONFIG { config.into() } else { config.with_file_name(name) }
}

/// Unpacks the backup where it harms nobody and reads what came out: its configuration, and the models of no use.
fn tried(backup: &Backup) -> Result<(StationFile, Vec<String>), Error> {
    let room = Room::new()?;
    for (name, content) in &backup.files {
        let to = room.0.join(name);
        let parent = to.parent().expect("below the room");
        fs::create_dir_all(parent).map_err(|source| Error::Write { file: to.clone(), source })?;
        document::write_bytes(&to, content)?;
    }
    let config = StationFile::read(&room.0.join(CONFIG))?;
    let named = belongings(&config)?;
    for name in backup.files.keys().filter(|name| *name != CONFIG) {
        let allowed = "files that the configuration in it names";
        Check(&config.file).that(named.contains(Path::new(name)), "backup", format!("{name:?}"), allowed)?;
    }
    if let Some(calibration) = &config.calibration {
        Calibration::read(&config.beside(calibration))?;
    }
    config.read_detector()?;
    let unusable = super::unusable_jobs(&config).iter().map(|e| room.shortened(e)).collect();
    Ok((config, unusable))
}

/// A folder for as long as it is needed.
struct Room(PathBuf);

impl Room {
    fn new() -> Result<Self, Error> {
        use std::sync::atomic::{AtomicU32, Ordering};
        static COUNT: AtomicU32 = AtomicU32::new(0);
        let n = COUNT.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("datum-restore-{}-{n}", std::process::id()));
        // not one that somebody else has put there
        fs::create_dir(&folder).map_err(|source| Error::Write { file: folder.clone(), source })?;
        Ok(Self(folder))
    }

    /// An error without the room's own path.
    fn shortened(&self, e: &Error) -> String {
        let cause = std::error::Error::source(e).map_or_else(String::new, |s| format!(": {s}"));
        format!("{e}{cause}").replace(&format!("{}/", self.0.display()), "")
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0); // litter in a folder for it
    }
}
