//! What a kept capture was measured by, kept with it: calibration and vehicle model, as they were.
//! In:  both, as loaded. Out: their files in the capture's folder, and back.
//!
//! Copies, not references: they have 150 kB where the images have 30 MB, and jobs and calibrations are replaced.

use crate::calibrate::Calibration;
use crate::document::{self, Error};
use crate::vehicle::VehicleFile;
use std::path::Path;

/// The calibration's file in a kept capture's folder.
const CALIBRATION: &str = "calibration.toml";
/// The model's, with its templates beside it.
const VEHICLE: &str = "vehicle.toml";

/// Calibration and vehicle model, with the bytes of its templates. Made once when a job is loaded.
#[derive(Clone, Debug)]
pub struct Reference {
    calibration: Calibration,
    vehicle: VehicleFile,
    templates: Vec<Vec<u8>>,
}

impl Reference {
    /// Of what is measured by. `templates`: the bytes of the model's template files, in its features' order; their
    /// names are the model's, since its fingerprint holds them.
    pub fn new(calibration: Calibration, vehicle: VehicleFile, templates: Vec<Vec<u8>>) -> Self {
        Self { calibration, vehicle, templates }
    }

    /// Writes them into a capture's folder, beside its images.
    pub fn write(&self, folder: &Path) -> Result<(), Error> {
        self.calibration.write(&folder.join(CALIBRATION))?;
        self.vehicle.write(&folder.join(VEHICLE))?;
        let templates = self.vehicle.features.iter().zip(&self.templates);
        templates.filter_map(|(feature, bytes)| Some((feature.template.as_ref()?, bytes))).try_for_each(
            |(name, bytes)| document::write_bytes(&folder.join(name), bytes), // a name has no slashes: checked
        )
    }

    /// The calibration that is kept in `folder`.
    pub fn calibration(folder: &Path) -> Result<Calibration, Error> {
        Calibration::read(&folder.join(CALIBRATION))
    }

    /// The vehicle model that is kept in `folder`.
    pub fn vehicle(folder: &Path) -> Result<VehicleFile, Error> {
        VehicleFile::read(&folder.join(VEHICLE))
    }
}
