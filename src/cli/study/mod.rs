//! `datum study`: experiments that show how well the station measures, as tables, JSON or a page with plots.

mod page;
mod plot;
mod progress;
mod text;

use super::{Status, print};
use crate::calibrate::Calibration;
use crate::document::{self, Check};
use crate::study::error::{WRONG_MM, WRONG_YAW_DEG};
use crate::study::{Given, Outcome, STUDIES, Stored, Study, Takes};
use crate::vehicle::VehicleFile;
use anyhow::Context;
use progress::Bar;
use serde_json::json;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
#[command(after_help = studies())]
pub(super) struct Arguments {
    /// Which, or "all" for one report of everything that needs no captures
    #[arg(value_name = "STUDY")]
    study: String,
    /// Stored captures to look at instead of simulated ones, where a study can
    #[arg(value_name = "CAPTURE", requires_all = ["calibration", "vehicle"])]
    captures: Vec<PathBuf>,
    /// With captures: the calibration of camera and projector
    #[arg(long, value_name = "FILE", requires = "captures")]
    calibration: Option<PathBuf>,
    /// With captures, or for a study that looks at a vehicle model alone: that model
    #[arg(long, value_name = "FILE")]
    vehicle: Option<PathBuf>,
    /// Width of the tolerance that capability is stated against, mm; what makes a wrong pose, either way, if not given
    #[arg(long, value_name = "MM", default_value_t = 2.0 * WRONG_MM)]
    tolerance_mm: f64,
    /// The same of angles, degrees
    #[arg(long, value_name = "DEGREES", default_value_t = 2.0 * WRONG_YAW_DEG)]
    tolerance_deg: f64,
    /// A few vehicles at a quarter of the resolution: seconds instead of minutes
    #[arg(long)]
    quick: bool,
    /// Size of the simulated camera's image: 1, 0.5 or 0.25 of 2592×1944 [default: 0.5; 0.25 if quick]
    #[arg(long, value_name = "SCALE")]
    scale: Option<f64>,
    /// What everything random is drawn from
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Prints JSON
    #[arg(long)]
    json: bool,
    /// Writes a page with tables, plots and pictures, which needs no other file
    #[arg(long, value_name = "FILE")]
    html: Option<PathBuf>,
}

/// For the help: what there is.
fn studies() -> String {
    let widest = STUDIES.iter().map(|s| s.name.len()).max().unwrap_or(0);
    let takes = |s: &Study| match s.takes {
        Takes::Nothing => "",
        Takes::Captures => "; or CAPTUREs",
        Takes::Vehicle => "; or a --vehicle",
    };
    let line = |s: &Study| format!("  {:widest$}  {}{}\n", s.name, s.about, takes(s));
    format!("Studies:\n{}", STUDIES.iter().map(line).collect::<String>())
}

/// A study and what it found.
struct Done {
    study: &'static Study,
    outcome: Outcome,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let check = Check(Path::new("datum study"));
    let chosen: Vec<&Study> = STUDIES.iter().filter(|s| a.study == "all" || a.study == s.name).collect();
    let names = || STUDIES.iter().map(|s| s.name).collect::<Vec<_>>().join(", ");
    check.that(!chosen.is_empty(), "STUDY", &a.study, format!("{}, all", names()))?;
    let scale = a.scale.unwrap_or(if a.quick { 0.25 } else { 0.5 });
    check.that([1.0, 0.5, 0.25].contains(&scale), "--scale", scale, "1, 0.5 or 0.25")?;
    check.within("--tolerance-mm", a.tolerance_mm, 1e-3..=1e3)?;
    check.within("--tolerance-deg", a.tolerance_deg, 1e-3..=90.0)?;
    let vehicle = a.vehicle.as_deref().map(VehicleFile::read).transpose()?;
    let takes = if !a.captures.is_empty() {
        Takes::Captures
    } else if vehicle.is_some() {
        Takes::Vehicle
    } else {
        Takes::Nothing
    };
    let can = |s: &&Study| s.takes == takes || takes == Takes::Nothing;
    let able = || STUDIES.iter().filter(can).map(|s| s.name).collect::<Vec<_>>().join(", ");
    let given_what = if takes == Takes::Captures { "with captures" } else { "with --vehicle alone" };
    check.that(chosen.iter().all(can), format!("STUDY {given_what}"), &a.study, able())?;
    let (stored, vehicle) = match (&a.calibration, vehicle) {
        (Some(calibration), Some(vehicle)) => {
            let calibration = Calibration::read(calibration)?;
            (Some(Stored { captures: a.captures.clone(), calibration, vehicle }), None)
        }
        (_, vehicle) => (None, vehicle),
    };
    let tolerance = (a.tolerance_mm, a.tolerance_deg);
    let given = Given { scale, quick: a.quick, seed: a.seed, stored, vehicle, tolerance };
    let mut done = Vec::new();
    for study in chosen {
        let bar = Bar::new(study.name);
        let outcome = (study.run)(&given, &bar).with_context(|| study.name)?;
        drop(bar);
        if !a.json {
            print(&text::report(study, &outcome))?; // as it comes: the next one may take minutes
        }
        done.push(Done { study, outcome });
    }
    if a.json {
        print(&json(&given, &done))?;
    }
    if let Some(file) = &a.html {
        document::write_bytes(file, page::page(&given, &done).as_bytes())?;
        eprintln!("{}: written", file.display());
    }
    Ok(if done.iter().all(|d| d.outcome.passed()) { Status::Done } else { Status::Refused })
}

fn json(given: &Given, done: &[Done]) -> String {
    let one = |d: &Done| {
        let mut value = json!({"study": d.study.name, "about": d.study.about, "pass": d.outcome.passed()});
        let found = serde_json::to_value(&d.outcome).expect("string keys only");
        if let (Some(value), serde_json::Value::Object(found)) = (value.as_object_mut(), found) {
            value.extend(found);
        }
        value
    };
    let studies: Vec<_> = done.iter().map(one).collect();
    let software = env!("CARGO_PKG_VERSION");
    let value = json!({
        "software": software, "scale": given.scale, "quick": given.quick, "seed": given.seed, "studies": studies,
    });
    format!("{value:#}\n")
}
