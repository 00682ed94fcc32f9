//! Gauge R&R with the vehicle parked anew each time: ten vehicles, three people who park each of them, twice each. Out: %GRR
//! and ndc by analysis of variance, per axis.
//!
//! What is measured of a part is where its place is. Nobody parks twice in one place: how a vehicle really stands beside its
//! place is known of a simulated one only, and taken off. What is left differs from vehicle to vehicle (body, paint, place)
//! and with how each person parks.

use super::anova::Gauge;
use super::outcome::{Cell, Figure, Outcome, Table};
use super::sweep;
use super::{Bench, Error, Given, Measured, Progress};
use crate::sim::{Build, Deviation, PAINTS, Random};
use crate::station::deviation;
use rayon::prelude::*;

/// How a person parks: off by a habit of up to so much, and by so much more each time; mm and degrees.
const HABIT: (f64, f64) = (8.0, 1.0);
const EACH_TIME: (f64, f64) = (5.0, 0.5);
/// What the source calls good, and what may be acceptable.
const PERCENT: &str = "< 10 good, < 30 acceptable";

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    let measurers = sweep::teach(&bench, &models, |_| Deviation::default(), progress)?;
    let (parts, operators, trials) = (given.of(10, 3), given.of(3, 2), 2);
    let habits: Vec<Deviation> = (0..operators).map(|j| off(&mut bench.random(&[10, j as u64]), HABIT)).collect();
    let places: Vec<Deviation> = (0..parts).map(|i| deviation(&mut bench.random(&[11, i as u64]))).collect();
    let cells: Vec<[usize; 3]> =
        (0..parts).flat_map(|i| (0..operators).flat_map(move |j| (0..trials).map(move |k| [i, j, k]))).collect();
    progress.begin("measuring", cells.len());
    let one = |&[i, j, k]: &[usize; 3]| -> Result<Measured, Error> {
        let place = [12, i as u64, j as u64, k as u64];
        let parked = [&habits[j], &off(&mut bench.random(&place), EACH_TIME)].into_iter().fold(places[i], add);
        let model = i % models.len();
        let body = models[model].clone().built(Build::random(&mut bench.random(&[13, i as u64])));
        let station = bench.station(&body, PAINTS[i % PAINTS.len()], &parked, &place);
        let measured = bench.shoot(&station)?.measure(&measurers[model]);
        progress.step();
        Ok(measured)
    };
    let measured = cells.par_iter().map(one).collect::<Result<Vec<_>, _>>()?;
    let refused: Vec<String> = cells
        .iter()
        .zip(&measured)
        .filter(|(_, m)| !m.ok())
        .map(|(c, m)| format!("vehicle {}, person {}, time {}: {}", c[0] + 1, c[1] + 1, c[2] + 1, m.measurement.detail))
        .collect();
    if !refused.is_empty() {
        let what = format!("not crossed, as these were not measured: {}", refused.join("; "));
        return Err(Error::Nothing { what });
    }
    let mut table = Table::new(
        "Standard deviations, and what they come to",
        &[
            "axis",
            "unit",
            "repeatability",
            "reproducibility",
            "interaction",
            "gauge",
            "parts",
            "%GRR",
            "ndc",
            "% of tolerance",
        ],
    );
    let mut figures = Vec::new();
    let (mm, deg) = given.tolerance;
    for (axis, name) in ["x", "y", "z", "roll", "pitch", "yaw"].into_iter().enumerate() {
        let (unit, tolerance, digits) = if axis < 3 { ("mm", mm, 4) } else { ("°", deg, 5) };
        let value = |i: usize, j: usize, k: usize| {
            let e = measured[(i * operators + j) * trials + k].error().map_or(f64::NAN, |e| e[axis]);
            parts_of(&places[i])[axis] + if axis < 3 { e } else { e.to_degrees() }
        };
        let values: Vec<Vec<Vec<f64>>> = (0..parts)
            .map(|i| (0..operators).map(|j| (0..trials).map(|k| value(i, j, k)).collect()).collect())
            .collect();
        let g = Gauge::new(&values).ok_or(Error::Nothing { what: "fewer than two of each".into() })?;
        let sigmas = [g.repeatability, g.reproducibility, g.interaction, g.rr(), g.parts];
        let mut row = vec![Cell::text(name), Cell::text(unit)];
        row.extend(sigmas.map(|s| Cell::number(s, digits)));
        row.extend(
            [(g.percent(), 2), (g.categories(), 0), (g.percent_of(tolerance), 1)].map(|(v, d)| Cell::number(v, d)),
        );
        table.row(row);
        figures.push(Figure::new(format!("{name}: %GRR of all variation"), g.percent(), "%", 2).published(PERCENT));
        figures.push(Figure::new(format!("{name}: ndc"), g.categories(), "", 0).published("≥ 5 asked"));
        figures.push(
            Figure::new(format!("{name}: %GRR of the tolerance"), g.percent_of(tolerance), "%", 1).published(PERCENT),
        );
    }
    Ok(Outcome {
        setting: format!(
            "Simulated station at scale {}: {parts} vehicles of {} models, in the paints in turn, taught on {}; {operators} people park \
             each {trials} times, each with a habit of up to {} mm and {}° and {} mm and {}° more each time; how a vehicle really \
             stands beside its place is taken off. Tolerance: {mm} mm and {deg}° wide; seed {}. By ANOVA, after AIAG, Measurement \
             Systems Analysis, 4th edition.",
            given.scale,
            models.len(),
            PAINTS[0].name,
            HABIT.0,
            HABIT.1,
            EACH_TIME.0,
            EACH_TIME.1,
            given.seed
        ),
        figures,
        tables: vec![table],
        remarks: vec![
            "The parts' variation is that of where vehicles are parked, ±25 mm and ±5°; against a tolerance the last column counts. What \
             a paint and a body shift alike each time is no part of a gauge's R&R, but of `models` and `uncertainty`."
                .into(),
        ],
        ..Outcome::default()
    })
}

/// Drawn within these limits either way: mm, and degrees about the vertical; a tenth of that about the other axes.
fn off(random: &mut Random, (mm, deg): (f64, f64)) -> Deviation {
    let mut within = |most: f64| random.between(-most, most);
    Deviation {
        along_mm: within(mm),
        across_mm: within(mm),
        up_mm: within(0.2 * mm),
        roll_deg: within(0.1 * deg),
        pitch_deg: within(0.1 * deg),
        yaw_deg: within(deg),
    }
}

fn add(a: Deviation, b: &Deviation) -> Deviation {
    Deviation {
        along_mm: a.along_mm + b.along_mm,
        across_mm: a.across_mm + b.across_mm,
        up_mm: a.up_mm + b.up_mm,
        roll_deg: a.roll_deg + b.roll_deg,
        pitch_deg: a.pitch_deg + b.pitch_deg,
        yaw_deg: a.yaw_deg + b.yaw_deg,
    }
}

fn parts_of(d: &Deviation) -> [f64; 6] {
    [d.along_mm, d.across_mm, d.up_mm, d.roll_deg, d.pitch_deg, d.yaw_deg]
}
