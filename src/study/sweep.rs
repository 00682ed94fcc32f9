//! Vehicles that are moved in known steps. In: models, paints, places. Out: what was measured at each place, in order.
//! Every model is taught once, on white, where the experiment begins. Not here: what is made of it.

use super::{Bench, Error, Given, Measured, Progress, Seen};
use crate::geometry::{Pose, frame};
use crate::measure::Measurer;
use crate::sim::{Body, Build, Deviation, PAINTS, Paint};
use rayon::prelude::*;

/// One vehicle that is moved.
pub(super) struct Run {
    /// Its model's place in the list.
    pub(super) model: usize,
    /// As it was built.
    pub(super) body: Body,
    pub(super) paint: Paint,
    /// How far it is moved in each step, mm or degrees, and how it stands then.
    pub(super) places: Vec<(f64, Deviation)>,
}

/// Where a run's vehicle was measured.
pub(super) struct Moved {
    pub(super) at: f64,
    /// None: not all features are in the image there.
    pub(super) measured: Option<Measured>,
}

/// The first few of the ten models.
pub(super) fn bodies(n: usize) -> Vec<Body> {
    crate::sim::names().take(n).map(|name| Body::named(name).expect("listed")).collect()
}

/// One vehicle of `body` for run `k` of a model: built as no other, of the next paint, so that ten models in three runs wear
/// each of the six paints five times.
pub(super) fn vehicle(bench: &Bench, model: usize, body: &Body, k: usize) -> (Body, Paint) {
    let built = body.clone().built(Build::random(&mut bench.random(&[1, model as u64, k as u64])));
    (built, PAINTS[(3 * model + k) % PAINTS.len()])
}

/// As a vehicle may roll in with all its features in view.
pub(super) fn stands(bench: &Bench, body: &Body, place: &[u64]) -> Deviation {
    let mut random = bench.random(place);
    std::iter::repeat_with(|| Deviation::random(&mut random))
        .find(|d| bench.in_view(body, d))
        .expect("where it should stand it is in view, and so it is nearby")
}

/// Teaches the models, each standing `taught_at`.
pub(super) fn teach(
    bench: &Bench,
    models: &[Body],
    taught_at: impl Fn(&Body) -> Deviation + Sync,
    progress: &dyn Progress,
) -> Result<Vec<Measurer>, Error> {
    progress.begin("teaching", models.len());
    let teach = |body: &Body| {
        let taught = bench.teach(body, PAINTS[0], &taught_at(body));
        progress.step();
        taught
    };
    // the first alone: what all share is made then
    let (first, others) = models.split_first().ok_or(Error::Nothing { what: "no models".into() })?;
    let first = teach(first)?;
    let others: Result<Vec<_>, _> = others.par_iter().map(teach).collect();
    Ok(std::iter::once(first).chain(others?).collect())
}

/// Measures every run at each of its places.
pub(super) fn measure(
    bench: &Bench,
    measurers: &[Measurer],
    runs: &[Run],
    progress: &dyn Progress,
) -> Result<Vec<Vec<Moved>>, Error> {
    let all: Vec<(usize, usize)> =
        runs.iter().enumerate().flat_map(|(r, run)| (0..run.places.len()).map(move |k| (r, k))).collect();
    progress.begin("measuring", all.len());
    let one = |&(r, k): &(usize, usize)| -> Result<Moved, Error> {
        let run = &runs[r];
        let (at, deviation) = &run.places[k];
        let measured = if bench.in_view(&run.body, deviation) {
            let station = bench.station(&run.body, run.paint, deviation, &[2, r as u64, k as u64]);
            Some(bench.shoot(&station)?.measure(&measurers[run.model]))
        } else {
            None
        };
        progress.step();
        Ok(Moved { at: *at, measured })
    };
    let mut moved = all.par_iter().map(one).collect::<Result<Vec<_>, _>>()?.into_iter();
    Ok(runs.iter().map(|run| moved.by_ref().take(run.places.len()).collect()).collect())
}

/// How many were in view, how many of these were measured and called ok, and a sentence on each of the others.
pub(super) fn refused(runs: &[Run], moved: &[Vec<Moved>], unit: &str) -> (usize, usize, Vec<String>) {
    let (mut in_view, mut ok, mut said) = (0, 0, Vec::new());
    for (run, moved) in runs.iter().zip(moved) {
        for m in moved {
            let Some(measured) = &m.measured else { continue };
            in_view += 1;
            ok += usize::from(measured.ok());
            if !measured.ok() {
                let (paint, name, why) = (run.paint.name, &run.body.name, &measured.measurement.detail);
                said.push(format!(
                    "{paint} {name} at {:+} {unit}: {}, {why}",
                    m.at,
                    measured.measurement.verdict.name()
                ));
            }
        }
    }
    (in_view, ok, said)
}

/// What the station saw of a run's first place.
pub(super) fn picture(bench: &Bench, measurers: &[Measurer], run: &Run) -> Result<Seen, Error> {
    let (at, deviation) = run.places.first().ok_or(Error::Nothing { what: "no places".into() })?;
    let shot = bench.shoot(&bench.station(&run.body, run.paint, deviation, &[3]))?;
    let measured = shot.measure(&measurers[run.model]);
    Ok(shot.seen(format!("{} {} at {at:+}", run.paint.name, run.body.name), &measured))
}

/// Between two poses, in axes of the first.
pub(super) fn between(
    a: &Pose<frame::Camera, frame::Vehicle>,
    b: &Pose<frame::Camera, frame::Vehicle>,
) -> Pose<frame::Vehicle, frame::Vehicle> {
    a.inverse() * *b
}

/// Neighbours of which both were measured.
pub(super) fn steps(moved: &[Moved]) -> impl Iterator<Item = (&Moved, &Measured, &Moved, &Measured)> {
    moved.windows(2).filter_map(|pair| {
        let [a, b] = pair else { return None };
        let ok = |m: &'_ Moved| m.measured.as_ref().is_some_and(Measured::ok);
        (ok(a) && ok(b)).then_some(())?;
        Some((a, a.measured.as_ref()?, b, b.measured.as_ref()?))
    })
}

/// The first and the last that were measured.
pub(super) fn ends(moved: &[Moved]) -> Option<(&Moved, &Measured, &Moved, &Measured)> {
    let mut ok = moved.iter().filter_map(|m| m.measured.as_ref().filter(|m| m.ok()).map(|measured| (m, measured)));
    let first = ok.next()?;
    let last = ok.next_back()?;
    Some((first.0, first.1, last.0, last.1))
}

/// The six paints or fewer, by name, of what runs wear.
pub(super) fn by_paint<'a>(runs: &'a [Run], values: &'a [Vec<f64>]) -> Vec<(&'static str, Vec<f64>)> {
    let of = |paint: &Paint| {
        let worn = runs.iter().zip(values).filter(|(run, _)| run.paint.name == paint.name);
        (paint.name, worn.flat_map(|(_, v)| v.iter().copied()).collect::<Vec<_>>())
    };
    PAINTS.iter().map(of).filter(|(_, v)| !v.is_empty()).collect()
}

/// In words: how many vehicles of how many models, at what scale.
pub(super) fn setting(given: &Given, models: usize, runs: usize) -> String {
    format!(
        "Simulated station at scale {} ({} models as drawn, taught on white; {runs} runs with vehicles built off the drawing by up to \
         {} mm, in the paints in turn), seed {}.",
        given.scale,
        models,
        crate::sim::BUILD_MM,
        given.seed
    )
}
