//! Repeatability: the same vehicle, standing still, in fresh captures. The published figure, "identical across several hundred
//! runs", is one image processed again; that is no repeatability. Out: Cg and Cgk against a stated tolerance, per axis.
//!
//! Cg = 0.2·T/6s, Cgk = (0.1·T − |bias|)/3s, T the tolerance's width: Bosch, Quality Management in the Bosch Group, booklet
//! 10 (2019), type 1. Of stored captures no truth is known: there is no bias, and no Cgk.

use super::outcome::{Cell, Figure, Outcome, Plot, Series, Table};
use super::statistics::{mean, standard_deviation};
use super::sweep;
use super::{Bench, Error, Given, Progress, error};
use crate::calibrate::Calibration;
use crate::capture::Capture;
use crate::detect::{DEFAULT, Detector};
use crate::measure::{Measurement, Measurer, Verdict, measure};
use crate::sim::{Deviation, PAINTS};
use nalgebra::Vector6;
use rayon::prelude::*;
use std::path::Path;

/// What is asked of a gauge by the source.
const CAPABLE: &str = "≥ 1.33 asked";
const CAPTURES: usize = 25;

/// One standing vehicle: its name, and how far each capture of it was off, mm and degrees.
struct Stood {
    name: String,
    errors: Vec<[f64; 6]>,
    /// Whether that is against the truth.
    truth: bool,
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    match &given.stored {
        None => simulated(given, progress),
        Some(stored) => {
            progress.begin("measuring", stored.captures.len());
            let poses = stored_poses(stored, progress)?;
            let errors = against_first(&poses).iter().map(in_units).collect();
            let name = stored.vehicle.name.clone();
            let setting = format!(
                "{} stored captures of one vehicle that stands still, {} measured ok; against the first of them.",
                stored.captures.len(),
                poses.len()
            );
            Ok(outcome(given, &[Stood { name, errors, truth: false }], setting))
        }
    }
}

fn simulated(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    let measurers = sweep::teach(&bench, &models, |_| Deviation::default(), progress)?;
    let captures = given.of(CAPTURES, 5);
    progress.begin("measuring", models.len() * captures);
    let one = |(model, measurer): (usize, &Measurer)| -> Result<Stood, Error> {
        let (body, paint) = sweep::vehicle(&bench, model, &models[model], 0);
        let stands = sweep::stands(&bench, &body, &[5, model as u64]);
        // one station all the while: every image has noise of its own, and the sensor's pattern stays
        let station = bench.station(&body, paint, &stands, &[6, model as u64]);
        let mut errors = Vec::new();
        for _ in 0..captures {
            errors.extend(bench.shoot(&station)?.measure(measurer).error().map(|e| in_units(&e)));
            progress.step();
        }
        Ok(Stood { name: format!("{} {}", paint.name, body.name), errors, truth: true })
    };
    let stood = measurers.par_iter().enumerate().map(one).collect::<Result<Vec<_>, _>>()?;
    let setting = format!(
        "Simulated station at scale {}: {} vehicles of as many models, taught on {}, each standing still somewhere in view for \
         {captures} fresh captures; seed {}.",
        given.scale,
        stood.len(),
        PAINTS[0].name,
        given.seed
    );
    Ok(outcome(given, &stood, setting))
}

fn outcome(given: &Given, stood: &[Stood], setting: String) -> Outcome {
    let (mm, deg) = given.tolerance;
    let axes = ["x", "y", "z", "roll", "pitch", "yaw"];
    let columns: Vec<String> = ["vehicle", "measured"]
        .map(String::from)
        .into_iter()
        .chain(axes.iter().enumerate().map(|(i, a)| format!("{a} {}", unit(i))))
        .collect();
    let table = |title: &str| Table { title: title.into(), columns: columns.clone(), rows: Vec::new() };
    let (mut spread, mut bias) = (table("Standard deviation"), table("Bias"));
    let mut figures = Vec::new();
    for s in stood {
        let of = |i: usize| s.errors.iter().map(|e| e[i]).collect::<Vec<_>>();
        let row = |cell: &dyn Fn(usize) -> Option<f64>| {
            let cells = (0..6).map(|i| Cell::number(cell(i), if i < 3 { 4 } else { 5 }));
            [Cell::text(&s.name), Cell::count(s.errors.len())].into_iter().chain(cells).collect()
        };
        spread.row(row(&|i| standard_deviation(&of(i))));
        bias.row(row(&|i| mean(&of(i)).filter(|_| s.truth)));
    }
    for (i, axis) in axes.iter().enumerate() {
        let tolerance = if i < 3 { mm } else { deg };
        let worst = |of: &dyn Fn(&Stood) -> Option<f64>| stood.iter().filter_map(of).reduce(f64::min);
        let of = |s: &Stood| s.errors.iter().map(|e| e[i]).collect::<Vec<_>>();
        let cg = |s: &Stood| Some(0.2 * tolerance / (6.0 * standard_deviation(&of(s))?));
        let cgk = |s: &Stood| {
            let bias = mean(&of(s)).filter(|_| s.truth)?;
            Some((0.1 * tolerance - bias.abs()) / (3.0 * standard_deviation(&of(s))?))
        };
        figures.push(Figure::new(format!("Cg, {axis}, worst vehicle"), worst(&cg), "", 2).published(CAPABLE));
        if stood.iter().any(|s| s.truth) {
            figures.push(Figure::new(format!("Cgk, {axis}, worst vehicle"), worst(&cgk), "", 2).published(CAPABLE));
        }
    }
    let curve = |s: &Stood| Series {
        name: s.name.clone(),
        points: s.errors.iter().enumerate().map(|(k, e)| (k as f64, e[0])).collect(),
        joined: true,
    };
    Outcome {
        setting: format!("{setting} Tolerance: {mm} mm and {deg}° wide."),
        figures,
        tables: if stood.iter().any(|s| s.truth) { vec![spread, bias] } else { vec![spread] },
        remarks: vec![
            "Published: \"identical across several hundred runs\", which is one image processed again. The bias is that of one \
             paint in one place; Cgk counts it as the gauge's."
                .into(),
        ],
        plots: vec![Plot {
            title: "x from capture to capture".into(),
            x: "capture".into(),
            y: "error in x, mm".into(),
            series: stood.iter().map(curve).collect(),
            levels: Vec::new(),
        }],
        pictures: Vec::new(),
    }
}

fn unit(axis: usize) -> &'static str {
    if axis < 3 { "mm" } else { "°" }
}

/// mm and rad to mm and degrees.
fn in_units(e: &Vector6<f64>) -> [f64; 6] {
    std::array::from_fn(|i| if i < 3 { e[i] } else { e[i].to_degrees() })
}

fn stored_poses(stored: &super::Stored, progress: &dyn Progress) -> Result<Vec<Measurement>, Error> {
    let detector = Detector::named(Path::new(DEFAULT))?;
    let mut poses = Vec::new();
    for folder in &stored.captures {
        let capture = Capture::open(folder)?;
        let (c, p) = (&capture.camera, &capture.projector);
        let calibration: Calibration = stored.calibration.for_sizes((c.width, c.height), (p.width, p.height), false)?;
        let measurer = Measurer::new(calibration, stored.vehicle.clone())?.with_detector(detector.clone());
        let (m, _) = measure(&measurer, &capture, &mut |_| ())?;
        progress.step();
        poses.extend((m.verdict == Verdict::Ok).then_some(m));
    }
    if poses.len() < 2 {
        return Err(Error::Nothing { what: format!("{} captures measured ok, allowed: at least 2", poses.len()) });
    }
    Ok(poses)
}

/// How each pose differs from the first.
fn against_first(poses: &[Measurement]) -> Vec<Vector6<f64>> {
    let first = poses.first().and_then(error::pose);
    poses.iter().filter_map(|m| error::error(m, &first?)).collect()
}
