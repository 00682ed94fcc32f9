//! The control: the method as published beside ours, on the same captures. If it did better here than its publication says,
//! the captures would be too kind to say anything of ours.
//! Out: errors of both methods, and of the steps between neighbouring places, which is what was published.

use super::error::{self, CameraFromVehicle};
use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::{largest, mean, rms};
use super::stored;
use super::sweep::{self, between};
use super::{Bench, Error, Given, Progress, Stored};
use crate::geometry::Point3;
use crate::measure::{Measurement, Measurer, Method, Verdict};
use crate::sim::Deviation;
use nalgebra::Vector3;
use rayon::prelude::*;

/// A step either way, and the published mean error of one: tables 6 to 8.
const STEP_DEG: f64 = 2.5;
const STEP_MM: f64 = 5.0;
const PUBLISHED_DEG: f64 = 0.12;
/// One place by both methods.
struct Both {
    name: String,
    at: f64,
    truth: Option<CameraFromVehicle>,
    /// By the published method and by ours.
    by: [Measurement; 2],
}

const METHODS: [&str; 2] = ["published method", "ours"];

/// Position, mm, and rotation, degrees.
type Off = (f64, f64);

impl Both {
    /// The pose of a method: ours where it may be used, which is also where the vehicle stands outside the limits; the
    /// published one's always, as it is never called ok.
    fn pose(&self, method: usize) -> Option<CameraFromVehicle> {
        let m = &self.by[method];
        (method == 0 || matches!(m.verdict, Verdict::Ok | Verdict::OutOfLimits)).then(|| error::pose(m))?
    }

    fn off(&self, method: usize) -> Option<Off> {
        self.pose(method)?;
        let e = error::error(&self.by[method], self.truth.as_ref()?)?;
        Some((e.fixed_rows::<3>(0).norm(), e.fixed_rows::<3>(3).norm().to_degrees()))
    }
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    match &given.stored {
        Some(stored) => of_stored(stored, progress),
        None => simulated(given, progress),
    }
}

fn of_stored(stored: &Stored, progress: &dyn Progress) -> Result<Outcome, Error> {
    progress.begin("measuring", stored.captures.len());
    let by = |method| move |m: Measurer| m.with_method(method);
    let places = stored::measured(stored, [&by(Method::Published), &by(Method::Points)], progress)?
        .into_iter()
        .map(|(name, truth, by)| Both { name, at: 0.0, truth, by })
        .collect::<Vec<_>>();
    let known = places.iter().filter(|b| b.truth.is_some()).count();
    let setting = format!(
        "{} stored captures of {}, {known} of them with their truth; one model for both methods.",
        places.len(),
        stored.vehicle.name
    );
    let places: Vec<&Both> = places.iter().collect();
    Ok(Outcome { setting, figures: figures(&places, Vec::new()), tables: vec![table(&places)], ..Outcome::default() })
}

fn simulated(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    progress.begin("teaching", models.len());
    let teach = |body| -> Result<[Measurer; 2], Error> {
        let (shot, features) = bench.to_teach(body, crate::sim::PAINTS[0], &Deviation::default())?;
        let taught = bench.taught(&shot, &features, &bench.calibration)?;
        progress.step();
        let measurer = |method| bench.measurer(&bench.calibration, taught.clone()).with_method(method);
        Ok([measurer(Method::Published), measurer(Method::Points)])
    };
    let measurers = models.par_iter().map(teach).collect::<Result<Vec<_>, _>>()?;
    let reach = given.of(2, 1);
    // of each model: turned in steps, then moved along and across in steps, always from where it should stand
    let ways: [fn(f64) -> Deviation; 3] = [
        |k| Deviation { yaw_deg: STEP_DEG * k, ..Deviation::default() },
        |k| Deviation { along_mm: STEP_MM * k, ..Deviation::default() },
        |k| Deviation { across_mm: STEP_MM * k, ..Deviation::default() },
    ];
    let mut all = Vec::new();
    for model in 0..models.len() {
        for way in 0..ways.len() {
            all.extend((0..=2 * reach).map(|k| (model, way, k as f64 - reach as f64)));
        }
    }
    progress.begin("measuring", all.len());
    let one = |&(model, way, k): &(usize, usize, f64)| -> Result<Both, Error> {
        let (body, paint) = sweep::vehicle(&bench, model, &models[model], way);
        let place = [7, model as u64, way as u64, k.to_bits()];
        let shot = bench.shoot(&bench.station(&body, paint, &ways[way](k), &place))?;
        let [published, ours] = measurers[model].each_ref().map(|m| shot.measure(m).measurement);
        progress.step();
        let at = k * if way == 0 { STEP_DEG } else { STEP_MM };
        let unit = if way == 0 { "°" } else { ["", "mm along", "mm across"][way] };
        let name = format!("{} {} {at:+} {unit}", paint.name, body.name);
        Ok(Both { name, at, truth: Some(shot.truth), by: [published, ours] })
    };
    let places = all.par_iter().map(one).collect::<Result<Vec<_>, _>>()?;

    let runs: Vec<&[Both]> = places.chunks(2 * reach + 1).collect();
    let of_way = |way: usize| runs.iter().skip(way).step_by(ways.len()).copied();
    let mut figures_of_steps = Vec::new();
    for (method, by) in METHODS.iter().enumerate() {
        let turns: Vec<f64> = of_way(0).flat_map(|run| steps(run, method)).map(|s| s.1.abs()).collect();
        let figure = Figure::new(format!("{by}: mean error of {STEP_DEG}° steps"), mean(&turns), "°", 4);
        figures_of_steps.push(figure.published(format!("< {PUBLISHED_DEG}")));
        for (way, name, published) in [(1, "along", "< 0.6"), (2, "across", "< 0.3")] {
            let shifts: Vec<f64> = of_way(way).flat_map(|run| steps(run, method)).map(|s| s.0.abs()).collect();
            let what = format!("{by}: mean error of {STEP_MM} mm steps {name}");
            figures_of_steps.push(Figure::new(what, mean(&shifts), "mm", 3).published(published));
        }
    }
    let curve = |method: usize| Series {
        name: METHODS[method].into(),
        points: of_way(0).flatten().filter_map(|b| Some((b.at, b.off(method)?.1))).collect(),
        joined: false,
    };
    let seen: Vec<&Both> = places.iter().collect();
    Ok(Outcome {
        setting: format!(
            "Simulated station at scale {}: {} models as drawn, taught on white; of each a vehicle that turns by {STEP_DEG}° a step, \
             one that moves along and one that moves across by {STEP_MM} mm a step, in the paints in turn, built off the drawing \
             by up to {} mm; both methods on the same {} captures; seed {}.",
            given.scale,
            models.len(),
            crate::sim::BUILD_MM,
            places.len(),
            given.seed
        ),
        figures: figures(&seen, figures_of_steps),
        tables: vec![table(&seen)],
        remarks: vec![
            "The published method has the regions, edges, ellipses, fringes and calibration of ours; it refuses no pose for being \
             implausible, so that all of them count."
                .into(),
        ],
        plots: vec![Plot {
            title: "Rotation error over the turn".into(),
            x: "turned, °".into(),
            y: "error, °".into(),
            series: vec![curve(0), curve(1)],
            levels: Vec::new(),
        }],
        pictures: Vec::new(),
    })
}

/// Of neighbouring places that were both measured: measured less true way of the features' centroid, mm, and turn, degrees.
fn steps(run: &[Both], method: usize) -> Vec<Off> {
    let step = |pair: &[Both]| {
        let [a, b] = pair else { return None };
        let at = Point3::new(Vector3::from(a.by[method].covariance_at_mm?));
        let measured = between(&a.pose(method)?, &b.pose(method)?);
        let truth = between(a.truth.as_ref()?, b.truth.as_ref()?);
        let way = |p: &crate::geometry::Pose<_, _>| ((*p * at) - at).norm();
        Some((way(&measured) - way(&truth), (measured.r.angle() - truth.r.angle()).to_degrees()))
    };
    run.windows(2).filter_map(step).collect()
}

fn figures(places: &[&Both], of_steps: Vec<Figure>) -> Vec<Figure> {
    let mut figures = of_steps;
    let mut sizes = Vec::new();
    // errors are compared on the same captures only
    let by_both: Vec<&&Both> = places.iter().filter(|b| (0..2).all(|method| b.off(method).is_some())).collect();
    for (method, by) in METHODS.iter().enumerate() {
        let (mm, deg): (Vec<f64>, Vec<f64>) = by_both.iter().filter_map(|b| b.off(method)).unzip();
        for (values, unit, digits, published) in
            [(&mm, "mm", 3, "≤ 1 along, ≤ 0.5 across"), (&deg, "°", 4, "≤ 0.21 of yaw")]
        {
            let what = if unit == "mm" { "position" } else { "rotation" };
            let figure = Figure::new(format!("{by}: rms {what} error"), rms(values), unit, digits);
            // poses that are better than its steps were would come from captures that are too kind
            let kind = method == 0 && unit == "°";
            figures.push(if kind { figure.must(Must::AtLeast(PUBLISHED_DEG)) } else { figure });
            figures.push(
                Figure::new(format!("{by}: largest {what} error"), largest(values), unit, digits).published(published),
            );
            sizes.push(rms(values));
        }
        figures.push(Figure::new(
            format!("{by}: poses"),
            100.0 * places.iter().filter(|b| b.pose(method).is_some()).count() as f64 / places.len().max(1) as f64,
            "%",
            1,
        ));
    }
    let [mm, deg, our_mm, our_deg] = sizes[..] else { return figures };
    let times = |theirs: Option<f64>, ours: Option<f64>| Some(theirs? / ours?);
    figures.push(Figure::new("published method over ours, rms position", times(mm, our_mm), "", 1));
    figures.push(Figure::new("published method over ours, rms rotation", times(deg, our_deg), "", 1));
    figures
}

fn table(places: &[&Both]) -> Table {
    let columns = ["capture", "published mm", "°", "its verdict", "ours mm", "°", "its verdict"];
    let mut table = Table::new("Errors at the features' centroid, length of the shift and angle of the turn", &columns);
    for b in places {
        let mut row = vec![Cell::text(&b.name)];
        for method in 0..2 {
            let off = b.off(method);
            row.push(Cell::number(off.map(|o| o.0), 3));
            row.push(Cell::number(off.map(|o| o.1), 4));
            let m = &b.by[method];
            let code = m.code.map_or_else(String::new, |c| format!(" {}", c.number()));
            row.push(Cell::text(format!("{}{code}", m.verdict.name())));
        }
        table.row(row);
    }
    table
}
