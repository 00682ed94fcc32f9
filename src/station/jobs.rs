//! The station's jobs: vehicle models from a folder, by number, ready to measure.
//! In: the folder, the calibration. Out: a job for each released model; for the others the code that says why not.
//! Not here: how models are made.

use crate::calibrate::Calibration;
use crate::code::Code;
use crate::document::Error;
use crate::measure::{Measurer, Shared};
use crate::vehicle::{TemplateError, VehicleFile};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A vehicle model, ready to measure.
pub struct Job {
    /// 1 to 999.
    pub number: u16,
    /// What people call it.
    pub name: String,
    /// The PLC's MODEL_CODE; 0: not checked.
    pub model_code: u16,
    /// CRC-32 of the released model.
    pub fingerprint: u32,
    /// Measures it.
    pub measurer: Measurer,
    /// The model.
    pub vehicle: VehicleFile,
    /// Its templates as they were read, one per feature: kept with the images they measured.
    pub templates: Vec<Vec<u8>>,
}

/// Why a model is not used: a code, and a sentence that names the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Unusable {
    /// What the PLC gets.
    pub code: Code,
    /// For the log.
    pub said: String,
}

/// A job's number and what it came to.
pub type Entry = (u16, Result<Arc<Job>, Unusable>);

/// All jobs by number.
#[derive(Default)]
pub struct Jobs(BTreeMap<u16, Result<Arc<Job>, Unusable>>);

impl Jobs {
    /// Takes one in; it replaces the one of its number.
    pub fn add(&mut self, (number, entry): Entry) {
        self.0.insert(number, entry);
    }

    /// The job of that number; `model_code` 0 is not checked.
    pub fn get(&self, number: u16, model_code: u16) -> Result<Arc<Job>, Code> {
        let job = self.0.get(&number).ok_or(Code::UnknownJob)?.as_ref().map_err(|e| e.code)?;
        if model_code != 0 && job.model_code != 0 && job.model_code != model_code {
            return Err(Code::ModelMismatch);
        }
        Ok(Arc::clone(job))
    }

    /// Those that can be measured.
    pub fn usable(&self) -> impl Iterator<Item = &Arc<Job>> {
        self.0.values().filter_map(|e| e.as_ref().ok())
    }

    /// What is wrong with the others.
    pub fn unusable(&self) -> impl Iterator<Item = &Unusable> {
        self.0.values().filter_map(|e| e.as_ref().err())
    }
}

/// The folder's files that are called as jobs are, NNN-name.toml, with their numbers. Empty where there is no folder.
fn files(folder: &Path) -> Vec<(u16, PathBuf)> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let numbered = |path: PathBuf| {
        let name = path.file_name()?.to_str()?;
        let (number, _) = name.strip_suffix(".toml")?.split_once('-')?;
        Some((number.parse().ok().filter(|_| number.len() == 3)?, path))
    };
    let mut found: Vec<_> = entries.flatten().filter_map(|e| numbered(e.path())).collect();
    found.sort();
    found
}

/// Every job of `folder`, with what all of them share. One that is broken is told as such, and the others are there.
pub fn load_all(folder: &Path, calibration: &Calibration, shared: &Shared) -> Jobs {
    let one = |(number, file): &(u16, PathBuf)| load(*number, file, calibration, shared);
    let loaded: Vec<Entry> = files(folder).par_iter().map(one).collect();
    let mut jobs = Jobs::default();
    for (number, entry) in loaded {
        // of two files of one number neither is trusted
        let twice = jobs.0.contains_key(&number).then(|| Unusable {
            code: Code::Fingerprint,
            said: format!("{}: two files of job {number}, allowed: one", folder.display()),
        });
        jobs.add((number, twice.map_or(entry, Err)));
    }
    jobs
}

/// Job `number` from its file.
pub fn load(number: u16, file: &Path, calibration: &Calibration, shared: &Shared) -> Entry {
    (number, ready(number, file, calibration, shared).map(Arc::new))
}

fn ready(number: u16, file: &Path, calibration: &Calibration, shared: &Shared) -> Result<Job, Unusable> {
    let bad = |e: Error| Unusable { code: code(&e), said: told(&e) };
    let vehicle = VehicleFile::read(file).map_err(bad)?;
    if vehicle.job != number {
        let said = format!("{}: job = {}, allowed: {number}, as the file is called", file.display(), vehicle.job);
        return Err(Unusable { code: Code::Fingerprint, said });
    }
    let templates = vehicle.read_templates().map_err(bad)?;
    if let Some(code) = vehicle.unreleased(&templates) {
        let entry = code.entry();
        return Err(Unusable { code, said: format!("{}: {} {}", file.display(), entry.sentence, entry.remedy) });
    }
    let measurer = Measurer::new(calibration.clone(), vehicle.clone()).map_err(bad)?;
    let fingerprint = vehicle.release.as_ref().map_or(0, |r| r.fingerprint);
    Ok(Job {
        number,
        name: vehicle.name.clone(),
        model_code: vehicle.model_code,
        fingerprint,
        measurer: measurer.sharing(shared),
        vehicle,
        templates,
    })
}

/// Whether the model in `file`, or a template of it, was made by another version of datum.
pub(super) fn is_of_other_version(file: &Path) -> bool {
    VehicleFile::read(file).and_then(|vehicle| vehicle.templates()).is_err_and(|e| code(&e) == Code::OtherVersion)
}

/// What is of another version can be told from what is broken.
fn code(e: &Error) -> Code {
    match e {
        Error::Value { key, .. } if key == "format" => Code::OtherVersion,
        Error::Content { wrong, .. }
            if matches!(wrong.downcast_ref::<TemplateError>(), Some(TemplateError::Version { .. })) =>
        {
            Code::OtherVersion
        }
        _ => Code::Fingerprint,
    }
}

fn told(e: &Error) -> String {
    let source = std::error::Error::source(e).map_or_else(String::new, |s| format!(": {s}"));
    format!("{e}{source}")
}
