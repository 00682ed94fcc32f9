//! Experiments that show how well the station measures, beside the tables that were published for the method it grew from.
//! In:  what is given (scale, seed, quick or full, captures where there are any). Out: an [`Outcome`]: figures with the
//! published ones and their targets, tables, curves, pictures. Not here: how they are printed or drawn; arguments; terminals.
//!
//! The published tables: Scientific Reports (2025), s41598-025-07269-y. A study is one file and one line of [`STUDIES`].

mod advice;
mod anova;
mod bench;
mod board;
mod colour;
mod control;
mod corner;
pub mod error;
mod fixed;
mod gauge;
mod light;
mod line;
mod models;
mod outcome;
mod repeat;
mod rotation;
mod statistics;
mod stored;
mod sweep;
mod translation;
mod uncertainty;

pub use bench::{Bench, Measured, Shot};
pub use outcome::{Cell, Figure, Must, Outcome, Plot, Seen, Series, Table};

use crate::calibrate::Calibration;
use crate::capture::{self, RecordError};
use crate::measure::TeachError;
use crate::vehicle::VehicleFile;
use std::path::PathBuf;

/// An experiment.
pub struct Study {
    /// What it is called on the command line.
    pub name: &'static str,
    /// What it shows, in a line.
    pub about: &'static str,
    /// What it can look at beside the simulated station.
    pub takes: Takes,
    /// Does it.
    pub run: fn(&Given, &dyn Progress) -> Result<Outcome, Error>,
}

/// What an experiment can look at beside the simulated station.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Takes {
    /// Nothing.
    Nothing,
    /// Stored captures.
    Captures,
    /// A vehicle model alone.
    Vehicle,
}

/// All of them, in the order of a report.
pub const STUDIES: &[Study] = &[
    Study {
        name: "control",
        about: "the method as published beside ours, on the same captures",
        takes: Takes::Captures,
        run: control::run,
    },
    Study {
        name: "board",
        about: "from frame to frame on a circle board, ten repeats at five distances (published tables 4, 5)",
        takes: Takes::Nothing,
        run: board::run,
    },
    Study {
        name: "corner",
        about: "a corner found 2 px beside its place, by injection and by covariance (published table 3)",
        takes: Takes::Nothing,
        run: corner::run,
    },
    Study {
        name: "light",
        about: "which light works, with the loop open and closed (published table 2)",
        takes: Takes::Nothing,
        run: light::run,
    },
    Study {
        name: "colour",
        about: "every paint under red and white bars: contrast, features (published table 1)",
        takes: Takes::Nothing,
        run: colour::run,
    },
    Study {
        name: "rotation",
        about: "2.5° steps to ±12.5°, the camera on a turntable at 800 mm (published table 6)",
        takes: Takes::Nothing,
        run: rotation::run,
    },
    Study {
        name: "translation",
        about: "5 mm steps to ±50 mm along, across and up (published tables 7, 8)",
        takes: Takes::Nothing,
        run: translation::run,
    },
    Study {
        name: "models",
        about: "the ten models in every paint (published table 9)",
        takes: Takes::Nothing,
        run: models::run,
    },
    Study {
        name: "repeat",
        about: "25 fresh captures of a standing vehicle: Cg, Cgk",
        takes: Takes::Captures,
        run: repeat::run,
    },
    Study {
        name: "gauge",
        about: "gauge R&R with the vehicle parked anew: 10 vehicles, 3 people, 2 times",
        takes: Takes::Nothing,
        run: gauge::run,
    },
    Study {
        name: "uncertainty",
        about: "error over stated sigma, coverage of k = 2, detection of a displaced feature",
        takes: Takes::Nothing,
        run: uncertainty::run,
    },
    Study {
        name: "advice",
        about: "from a vehicle model alone: expected U (k = 2), what a further feature and midpoints bring",
        takes: Takes::Vehicle,
        run: advice::run,
    },
];

/// What an experiment is given.
#[derive(Clone, Debug)]
pub struct Given {
    /// Size of the simulated camera's image: 1, 0.5 or 0.25 of 2592×1944.
    pub scale: f64,
    /// Whether a few vehicles are enough.
    pub quick: bool,
    /// What everything random is drawn from.
    pub seed: u64,
    /// Stored captures to look at instead of simulated ones.
    pub stored: Option<Stored>,
    /// A vehicle model to look at, where that is all an experiment takes.
    pub vehicle: Option<VehicleFile>,
    /// Widths of the tolerance that capability is stated against, mm and degrees.
    pub tolerance: (f64, f64),
}

impl Given {
    /// `full`, or as many as are enough for a quick look.
    pub fn of(&self, full: usize, quick: usize) -> usize {
        if self.quick { quick } else { full }
    }
}

/// Stored captures and what to measure them with.
#[derive(Clone, Debug)]
pub struct Stored {
    /// Their folders.
    pub captures: Vec<PathBuf>,
    /// The calibration of camera and projector.
    pub calibration: Calibration,
    /// The vehicle model.
    pub vehicle: VehicleFile,
}

/// Is told how far an experiment has come.
pub trait Progress: Sync {
    /// So many steps of this begin.
    fn begin(&self, what: &str, steps: usize);
    /// One of them is done.
    fn step(&self);
}

/// Nobody is told.
impl Progress for () {
    fn begin(&self, _: &str, _: usize) {}
    fn step(&self) {}
}

/// Why an experiment has no outcome.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The simulated station did not record.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A model was not taught.
    #[error("{body}")]
    Teach {
        /// Of which body.
        body: String,
        /// Why.
        source: Box<TeachError>,
    },
    /// A stored file.
    #[error(transparent)]
    Document(#[from] crate::document::Error),
    /// A stored capture.
    #[error(transparent)]
    Capture(#[from] capture::Error),
    /// Where a model is to be taught, it is not wholly in view.
    #[error("{body}: a feature is out of the image where it should be taught")]
    OutOfView {
        /// Which.
        body: String,
    },
    /// There is nothing to make a figure of.
    #[error("{what}")]
    Nothing {
        /// What is missing.
        what: String,
    },
}
