//! The published ten vehicles (table 9): each of the ten named models in every paint, as it may roll in. Out: per model the
//! errors at the features' centroid.

use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::{largest, rms};
use super::sweep::{self, Run};
use super::{Bench, Error, Given, Progress};
use crate::sim::{Build, Deviation, PAINTS};
use nalgebra::Vector6;

/// So many of those that miss a target are named.
const WORST: usize = 6;

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 2));
    let measurers = sweep::teach(&bench, &models, |_| Deviation::default(), progress)?;
    let mut runs = Vec::new();
    for (model, body) in models.iter().enumerate() {
        for k in 0..given.of(PAINTS.len(), 2) {
            let place = [4, model as u64, k as u64];
            let built = body.clone().built(Build::random(&mut bench.random(&place)));
            let paint = PAINTS[(k + 3 * model) % PAINTS.len()];
            runs.push(Run { model, body: built, paint, places: vec![(0.0, sweep::stands(&bench, body, &place))] });
        }
    }
    let moved = sweep::measure(&bench, &measurers, &runs, progress)?;
    let errors: Vec<Option<Vector6<f64>>> =
        moved.iter().map(|m| m[0].measured.as_ref().and_then(super::Measured::error)).collect();

    let mut table = Table::new(
        "By model: root mean square and largest over its paints and places",
        &["model", "measured", "x mm", "y mm", "z mm", "roll °", "pitch °", "yaw °", "largest mm", "largest °"],
    );
    let of_model = |model: usize| -> Vec<Vector6<f64>> {
        runs.iter().zip(&errors).filter(|(run, _)| run.model == model).filter_map(|(_, e)| *e).collect()
    };
    for (model, body) in models.iter().enumerate() {
        let e = of_model(model);
        let axis = |i: usize, unit: f64| rms(&e.iter().map(|e| e[i] * unit).collect::<Vec<_>>());
        let mut row = vec![Cell::text(&body.name), Cell::count(e.len())];
        row.extend((0..3).map(|i| Cell::number(axis(i, 1.0), 3)));
        row.extend((3..6).map(|i| Cell::number(axis(i, 1f64.to_degrees()), 4)));
        row.push(Cell::number(largest(&e.iter().map(millimetres).collect::<Vec<_>>()), 3));
        row.push(Cell::number(largest(&e.iter().map(degrees).collect::<Vec<_>>()), 4));
        table.row(row);
    }
    let mut paints = Table::new("By paint", &["paint", "measured", "rms mm", "largest mm", "rms °", "largest °"]);
    for paint in PAINTS {
        let worn = runs.iter().zip(&errors).filter(|(run, _)| run.paint.name == paint.name).filter_map(|(_, e)| *e);
        let (mm, deg): (Vec<f64>, Vec<f64>) = worn.map(|e| (millimetres(&e), degrees(&e))).unzip();
        if !mm.is_empty() {
            let numbers = [(rms(&mm), 3), (largest(&mm), 3), (rms(&deg), 4), (largest(&deg), 4)];
            let numbers = numbers.map(|(v, digits)| Cell::number(v, digits));
            paints.row([Cell::text(paint.name), Cell::count(mm.len())].into_iter().chain(numbers).collect());
        }
    }
    let (in_view, ok, mut remarks) = sweep::refused(&runs, &moved, "");
    let known = || runs.iter().zip(&errors).filter_map(|(run, e)| Some((run, (*e)?)));
    for (what, off, limit) in [("mm", millimetres as fn(&Vector6<f64>) -> f64, 0.06), ("°", degrees, 0.02)] {
        let mut beyond: Vec<_> = known().filter(|(_, e)| off(e) > limit).collect();
        beyond.sort_by(|a, b| off(&b.1).total_cmp(&off(&a.1)));
        let n = beyond.len();
        let beyond: Vec<String> = beyond
            .into_iter()
            .take(WORST)
            .map(|(run, e)| {
                let d = &run.places[0].1;
                format!("{} {} {:.3} {what} (turned by {:+.1}°)", run.paint.name, run.body.name, off(&e), d.yaw_deg)
            })
            .collect();
        if !beyond.is_empty() {
            let all = known().count();
            remarks.push(format!("Beyond {limit} {what}: {n} of {all}; the worst are {}.", beyond.join(", ")));
        }
    }
    let all: Vec<Vector6<f64>> = errors.iter().flatten().copied().collect();
    let of_axis = |axes: std::ops::Range<usize>, unit: f64| {
        largest(&all.iter().flat_map(|e| axes.clone().map(|i| e[i] * unit)).collect::<Vec<_>>())
    };
    let per_model = |of: fn(&Vector6<f64>) -> f64| {
        let each = (0..models.len()).filter_map(|m| rms(&of_model(m).iter().map(of).collect::<Vec<_>>()));
        largest(&each.collect::<Vec<_>>())
    };
    let series = PAINTS.iter().map(|paint| Series {
        name: paint.name.into(),
        points: known()
            .filter(|(run, _)| run.paint.name == paint.name)
            .map(|(run, e)| (run.places[0].1.yaw_deg, millimetres(&e)))
            .collect(),
        joined: false,
    });
    Ok(Outcome {
        setting: format!(
            "{} Each stands as it may roll in: up to ±50 mm along and across, ±20 mm up, ±12.5° about the vertical, ±1° about the \
             others, all features in view.",
            sweep::setting(given, models.len(), runs.len())
        ),
        figures: vec![
            Figure::new("largest error along x", of_axis(0..1, 1.0), "mm", 3).published("≤ 1"),
            Figure::new("largest error along y", of_axis(1..2, 1.0), "mm", 3).published("≤ 0.5"),
            Figure::new("largest error in yaw", of_axis(5..6, 1f64.to_degrees()), "°", 4).published("≤ 0.21"),
            Figure::new("worst model's rms position error", per_model(millimetres), "mm", 3),
            Figure::new("worst model's rms rotation error", per_model(degrees), "°", 4),
            Figure::new("largest position error", largest(&all.iter().map(millimetres).collect::<Vec<_>>()), "mm", 3)
                .must(Must::AtMost(0.06)),
            Figure::new("largest rotation error", largest(&all.iter().map(degrees).collect::<Vec<_>>()), "°", 4)
                .must(Must::AtMost(0.02)),
            Figure::new("measured", 100.0 * ok as f64 / in_view.max(1) as f64, "%", 1),
        ],
        tables: vec![table, paints],
        remarks,
        plots: vec![Plot {
            title: "Position error over the turn".into(),
            x: "turned, °".into(),
            y: "error at the centroid, mm".into(),
            series: series.collect(),
            levels: vec![0.06],
        }],
        pictures: vec![sweep::picture(&bench, &measurers, &runs[0])?],
    })
}

/// Length of the shift.
fn millimetres(e: &Vector6<f64>) -> f64 {
    e.fixed_rows::<3>(0).norm()
}

/// Angle of the turn.
fn degrees(e: &Vector6<f64>) -> f64 {
    e.fixed_rows::<3>(3).norm().to_degrees()
}
