//! The published light (table 2): how bright the red light must be. Out: with the loop open, exposures as they suit white paint
//! in the middle of the published window, which light works, of the bars and of the hall; with the loop closed, as the station
//! runs, what becomes of every paint in halls from 20 to 2000 lx.

use super::fixed::Fixed;
use super::line::Line;
use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::{Bench, Error, Given, Progress, error, sweep};
use crate::measure::{Measurement, Measurer, Taught, Verdict};
use crate::sim::{Body, Cue, Deviation, Fault, PAINTS, Paint, Script, When};
use crate::vehicle::Target;
use rayon::prelude::*;

/// Light of the bars on the body, lx, that the open loop's exposures are made for.
const EXPOSED_FOR_LUX: f64 = 200.0;
/// And the hall's meanwhile.
const DARK_HALL_LUX: f64 = 20.0;
/// The bars' steps: those of the published table among them.
const BARS_LUX: [f64; 12] = [20.0, 40.0, 60.0, 96.0, 132.0, 144.0, 200.0, 248.0, 330.0, 500.0, 700.0, 1000.0];
const HALL_LUX: [f64; 7] = [20.0, 100.0, 200.0, 500.0, 800.0, 1000.0, 2000.0];
const QUICK_BARS_LUX: [f64; 3] = [20.0, 200.0, 700.0];
const QUICK_HALL_LUX: [f64; 3] = [20.0, 500.0, 2000.0];
/// Up to this much of the hall's light every paint is to be measured.
const MEASURED_TO_LUX: f64 = 500.0;

#[derive(Clone, Copy, PartialEq)]
enum Way {
    /// Loop open, the bars' light.
    Bars,
    /// Loop open, the hall's.
    Hall,
    /// Loop closed, the hall's.
    Closed,
}

const WAYS: [(Way, &str); 3] = [(Way::Bars, "open, bars"), (Way::Hall, "open, hall"), (Way::Closed, "closed, hall")];

/// One vehicle in some light.
struct Seen {
    way: Way,
    lux: f64,
    paint: Paint,
    /// In words: "ok", or the code.
    came_to: String,
    ok: bool,
    /// Ok, and wrong.
    wrong: bool,
    /// Off by so much at the centroid, mm, where it is ok.
    mm: Option<f64>,
}

impl Seen {
    fn new(
        way: Way,
        lux: f64,
        paint: Paint,
        m: Option<&Measurement>,
        truth: &Option<error::CameraFromVehicle>,
        targets: &[Target],
    ) -> Self {
        let ok = m.filter(|m| m.verdict == Verdict::Ok).zip(truth.as_ref());
        let code = m.and_then(|m| m.code).map(|c| c.number().to_string());
        Self {
            way,
            lux,
            paint,
            came_to: if ok.is_some() { "ok".into() } else { code.unwrap_or_else(|| "–".into()) },
            ok: ok.is_some(),
            wrong: ok.is_some_and(|(m, truth)| error::is_wrong(m, truth, targets)),
            mm: ok.and_then(|(m, truth)| Some(error::error(m, truth)?.fixed_rows::<3>(0).norm())),
        }
    }
}

/// A taught model.
struct Model {
    body: Body,
    taught: Taught,
    measurer: Measurer,
    exposed: Fixed,
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let (bars, hall): (&[f64], &[f64]) =
        if given.quick { (&QUICK_BARS_LUX, &QUICK_HALL_LUX) } else { (&BARS_LUX, &HALL_LUX) };
    let bodies = sweep::bodies(given.of(3, 1));
    progress.begin("teaching", bodies.len());
    let teach = |body: &Body| -> Result<Model, Error> {
        let (shot, features) = bench.to_teach(body, PAINTS[0], &Deviation::default())?;
        let taught = bench.taught(&shot, &features, &bench.calibration)?;
        let station = bench.station(body, PAINTS[0], &Deviation::default(), &[10]);
        station.set_script(in_hall(&bench, DARK_HALL_LUX));
        let measurer = bench.measurer(&bench.calibration, taught.clone());
        progress.step();
        Ok(Model { body: body.clone(), taught, measurer, exposed: bench.exposed_for(&station, EXPOSED_FOR_LUX)? })
    };
    let models = bodies.par_iter().map(teach).collect::<Result<Vec<_>, _>>()?;

    let paints: Vec<Paint> = if given.quick { [0, 3, 5].map(|k| PAINTS[k]).to_vec() } else { PAINTS.to_vec() };
    let of = |way: Way, steps: &[f64]| steps.iter().map(move |lux| (way, *lux)).collect::<Vec<_>>();
    let open_steps = [of(Way::Bars, bars), of(Way::Hall, hall)].concat();
    let vehicles: Vec<(usize, Paint)> =
        (0..models.len()).flat_map(|model| paints.iter().map(move |paint| (model, *paint))).collect();
    progress.begin("loop open", vehicles.len() * open_steps.len());
    let of_vehicle = |&(model, paint): &(usize, Paint)| {
        with_loop_open(&bench, &models[model], (model as u64, paint), &open_steps, progress)
    };
    let seen: Vec<Vec<Seen>> = vehicles.par_iter().map(of_vehicle).collect::<Result<_, _>>()?;
    progress.begin("loop closed", vehicles.len() * hall.len());
    // one after the other: a station waits for the thread that measures, which shares the work among all there are
    let closed: Vec<Vec<Seen>> = models
        .iter()
        .enumerate()
        .flat_map(|(model, m)| hall.iter().map(move |lux| (model as u64, m, *lux)))
        .map(|(model, m, lux)| with_loop_closed(&bench, m, (model, lux), &paints, progress))
        .collect::<Result<_, _>>()?;
    let seen: Vec<Seen> = seen.into_iter().chain(closed).flatten().collect();
    Ok(outcome(given, &bench, (models.len(), &paints), (bars, hall), &seen))
}

fn in_hall(bench: &Bench, lux: f64) -> Script {
    Script(vec![Cue { when: When::Always, fault: Fault::Ambient(lux / bench.setup.hall_lux()) }])
}

/// One vehicle in every light.
fn with_loop_open(
    bench: &Bench,
    m: &Model,
    (model, paint): (u64, Paint),
    steps: &[(Way, f64)],
    progress: &dyn Progress,
) -> Result<Vec<Seen>, Error> {
    let stands = sweep::stands(bench, &m.body, &[11, model]);
    let station = bench.station(&m.body, paint, &stands, &[11, model]);
    let one = |&(way, lux): &(Way, f64)| {
        let mut exposed = m.exposed;
        let mut hall_lux = lux;
        if way == Way::Bars {
            // what is brighter than the bars can be is exposed longer in a hall that is darker by as much
            let most = bench.setup.lux([1.0; 2]);
            let beyond = (lux / most).max(1.0);
            exposed.bars = [lux / beyond / most; 2];
            exposed.red *= beyond;
            hall_lux = DARK_HALL_LUX / beyond;
        }
        station.set_script(in_hall(bench, hall_lux));
        let measured = exposed.shoot(&station)?.measure(&m.measurer);
        progress.step();
        let (truth, targets) = (Some(measured.truth), &m.taught.model.targets);
        Ok(Seen::new(way, lux, paint, Some(&measured.measurement), &truth, targets))
    };
    steps.iter().map(one).collect()
}

/// A vehicle in every paint in turn before one station.
fn with_loop_closed(
    bench: &Bench,
    m: &Model,
    (model, lux): (u64, f64),
    paints: &[Paint],
    progress: &dyn Progress,
) -> Result<Vec<Seen>, Error> {
    let mut line = Line::new(bench, m.taught.clone(), lux, &[12, model, lux.to_bits()])?;
    let stands = sweep::stands(bench, &m.body, &[11, model]);
    let one = |paint: &Paint| {
        let finished = line.measure(&m.body, *paint, &stands);
        progress.step();
        let measurement = finished.as_ref().and_then(|f| f.measurement.as_ref());
        let truth = finished.as_ref().and_then(|f| f.truth);
        let seen = Seen::new(Way::Closed, lux, *paint, measurement, &truth, &m.taught.model.targets);
        // the station may refuse by the light alone what measuring would not
        match finished.and_then(|f| f.outcome.code) {
            Some(code) => Seen { came_to: code.number().to_string(), ok: false, wrong: false, mm: None, ..seen },
            None => seen,
        }
    };
    Ok(paints.iter().map(one).collect())
}

fn outcome(
    given: &Given,
    bench: &Bench,
    (models, paints): (usize, &[Paint]),
    (bars, hall): (&[f64], &[f64]),
    seen: &[Seen],
) -> Outcome {
    let of = |way: Way, lux: f64, paint: &str| -> Vec<&Seen> {
        seen.iter().filter(|s| s.way == way && s.lux == lux && s.paint.name == paint).collect()
    };
    let mut tables = Vec::new();
    for (way, title) in WAYS {
        let mut columns = vec!["lx"];
        columns.extend(paints.iter().map(|p| p.name));
        columns.push("largest mm");
        let mut table = Table::new(format!("Loop {title}: ok, or the codes"), &columns);
        for &lux in if way == Way::Bars { bars } else { hall } {
            let mut row = vec![Cell::number(lux, 0)];
            row.extend(paints.iter().map(|paint| Cell::text(in_words(&of(way, lux, paint.name)))));
            let off = seen.iter().filter(|s| s.way == way && s.lux == lux).filter_map(|s| s.mm);
            row.push(Cell::number(off.reduce(f64::max), 3));
            table.row(row);
        }
        tables.push(table);
    }
    let all_ok = &|way: Way, lux: f64, paint: &str| of(way, lux, paint).iter().all(|s| s.ok);
    let white = |way: Way| move |lux: f64| all_ok(way, lux, PAINTS[0].name);
    let by_bars = window(bars, EXPOSED_FOR_LUX, white(Way::Bars));
    let by_hall = window(hall, DARK_HALL_LUX, white(Way::Hall));
    let closed: Vec<&Seen> = seen.iter().filter(|s| s.way == Way::Closed).collect();
    let share = |of: &[&Seen]| 100.0 * of.iter().filter(|s| s.ok).count() as f64 / of.len().max(1) as f64;
    let up_to: Vec<&Seen> = closed.iter().copied().filter(|s| s.lux <= MEASURED_TO_LUX).collect();
    let window_figures = vec![
        Figure::new("loop open, white paint: measured from", by_bars.map(|w| w.0), "lx", 0)
            .published("144 (fails ≤ 132)"),
        Figure::new("loop open, white paint: measured to", by_bars.map(|w| w.1), "lx", 0)
            .published("248 (wrong or failing above)"),
        Figure::new("loop open, white paint: hall measured to", by_hall.map(|w| w.1), "lx", 0),
        Figure::new(format!("loop closed: measured up to {MEASURED_TO_LUX} lx of hall"), share(&up_to), "%", 1),
        Figure::new("loop closed: measured at all steps", share(&closed), "%", 1),
        Figure::new("wrong poses called ok", seen.iter().filter(|s| s.wrong).count() as f64, "", 0)
            .must(Must::AtMost(0.0)),
    ];
    let curve = |(way, name): &(Way, &str)| {
        let steps = if *way == Way::Bars { bars } else { hall };
        let at = |lux: &f64| {
            let of: Vec<&Seen> = seen.iter().filter(|s| s.way == *way && s.lux == *lux).collect();
            (lux.log10(), share(&of))
        };
        Series { name: (*name).into(), points: steps.iter().map(at).collect(), joined: true }
    };
    Outcome {
        setting: format!(
            "Simulated station at scale {}: {models} models as drawn, taught on white, each in {} paints standing somewhere in view. \
             Loop open: exposures as they suit white paint under {EXPOSED_FOR_LUX} lx of the bars in a hall of {DARK_HALL_LUX} lx; \
             light beyond the bars' {:.0} lx is simulated by exposing longer. Loop closed: the whole station, which finds exposures \
             and drives by itself. Seed {}.",
            given.scale,
            paints.len(),
            bench.setup.lux([1.0; 2]),
            given.seed
        ),
        figures: window_figures,
        tables,
        remarks: Vec::new(),
        plots: vec![Plot {
            title: "Measured, of all paints".into(),
            x: "log10 of lx".into(),
            y: "%".into(),
            series: WAYS.iter().map(curve).collect(),
            levels: Vec::new(),
        }],
        pictures: Vec::new(),
    }
}

/// The least and the most of the rising `steps` about `middle`, one of them, between which all are ok; none where it is not.
fn window(steps: &[f64], middle: f64, ok: impl Fn(f64) -> bool) -> Option<(f64, f64)> {
    let at = steps.iter().position(|lux| *lux == middle)?;
    let low = steps[..=at].iter().rev().take_while(|lux| ok(**lux)).last()?;
    let high = steps[at..].iter().take_while(|lux| ok(**lux)).last()?;
    Some((*low, *high))
}

/// "ok" where all were, else every code that came, and how many were ok.
fn in_words(seen: &[&Seen]) -> String {
    let ok = seen.iter().filter(|s| s.ok).count();
    let wrong = seen.iter().filter(|s| s.wrong).count();
    if wrong > 0 {
        return format!("{wrong} WRONG");
    }
    let mut codes: Vec<&str> = seen.iter().filter(|s| !s.ok).map(|s| s.came_to.as_str()).collect();
    codes.sort_unstable();
    codes.dedup();
    match (ok, codes.as_slice()) {
        (_, []) => "ok".into(),
        (0, codes) => codes.join(", "),
        (ok, codes) => format!("{ok} ok, {}", codes.join(", ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_ends_where_the_first_step_to_either_side_fails() {
        let steps = [20.0, 60.0, 200.0, 330.0, 500.0];
        assert_eq!(window(&steps, 200.0, |lux| lux != 500.0 && lux != 20.0), Some((60.0, 330.0)));
        assert_eq!(window(&steps, 200.0, |lux| lux != 330.0), Some((20.0, 200.0)), "what is ok beyond does not count");
        assert_eq!(window(&steps, 200.0, |lux| lux != 200.0), None);
        assert_eq!(window(&steps, 20.0, |_| true), Some((20.0, 500.0)));
    }

    #[test]
    fn a_cell_tells_what_all_models_came_to_and_what_was_wrong_first() {
        let seen = |came_to: &str, wrong| Seen {
            way: Way::Bars,
            lux: 200.0,
            paint: PAINTS[0],
            came_to: came_to.into(),
            ok: came_to == "ok",
            wrong,
            mm: None,
        };
        let (ok, dark, bad) = (seen("ok", false), seen("301", false), seen("ok", true));
        assert_eq!(in_words(&[&ok, &ok]), "ok");
        assert_eq!(in_words(&[&dark, &ok, &dark]), "1 ok, 301");
        assert_eq!(in_words(&[&dark]), "301");
        assert_eq!(in_words(&[&ok, &bad, &dark]), "1 WRONG");
    }
}
