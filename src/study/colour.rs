//! The published colours (table 1): every paint, under the red bars and under white ones. Out: how bright panel and gap are at
//! the exposure that suits white paint, the contrast of the features' edges, how well the features are known.
//! White bars are simulated by the paints: under them each gives back what it gives back of the projector's white light.

use super::fixed::Fixed;
use super::outcome::{Cell, Figure, Outcome, Plot, Series, Table};
use super::statistics::{mean, rms, standard_deviation};
use super::sweep;
use super::{Bench, Error, Given, Measured, Progress, Shot};
use crate::measure::Measurer;
use crate::sim::{Deviation, PAINTS, Paint};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

/// Light of the bars on the body, lx: amid the published window.
const LUX: f64 = 200.0;
/// An edge's panel and gap are looked at this far to either side of the taught contour, mm on the body.
const PANEL_MM: f64 = 4.0;
const GAP_MM: f64 = 1.5;

const LIGHTS: [&str; 2] = ["red", "white"];

/// One paint in one light.
struct Seen {
    paint: Paint,
    light: usize,
    /// Of white, at the exposure of white paint in this light.
    panel: f64,
    gap: f64,
    /// Measured ok at that exposure.
    ok_fixed: bool,
    /// Captures as the station exposes them, and how many were ok.
    captures: usize,
    ok: usize,
    /// Along the panel, of all features: as stated, and from capture to capture, mm.
    stated: Option<f64>,
    scatter: Option<f64>,
}

impl Seen {
    /// (bright − dark) / (bright + dark).
    fn contrast(&self) -> f64 {
        (self.panel - self.gap) / (self.panel + self.gap)
    }
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(3, 1));
    let measurers = sweep::teach(&bench, &models, |_| Deviation::default(), progress)?;
    let captures = given.of(10, 3);
    let all: Vec<(usize, usize, usize)> = (0..models.len())
        .flat_map(|model| {
            (0..PAINTS.len()).flat_map(move |paint| (0..LIGHTS.len()).map(move |light| (model, paint, light)))
        })
        .collect();
    progress.begin("measuring", all.len() * (captures + 1));
    let one = |&(model, paint, light): &(usize, usize, usize)| -> Result<(usize, Seen), Error> {
        let station = |paint: usize, place: u64| {
            let place = [9, model as u64, paint as u64, light as u64, place];
            bench.station(&models[model], lit(PAINTS[paint], light), &Deviation::default(), &place)
        };
        let exposed = bench.exposed_for(&station(0, 0), LUX)?;
        let seen = Seen {
            paint: PAINTS[paint],
            light,
            captures,
            ..at_fixed(&exposed, &station(paint, 1), &measurers[model])?
        };
        progress.step();
        let standing = station(paint, 2);
        let mut measured = Vec::new();
        for _ in 0..captures {
            measured.push(bench.shoot(&standing)?.measure(&measurers[model]));
            progress.step();
        }
        let ok: Vec<&Measured> = measured.iter().filter(|m| m.ok()).collect();
        Ok((model, Seen { ok: ok.len(), stated: stated(&ok), scatter: scatter(&ok), ..seen }))
    };
    let found = all.par_iter().map(one).collect::<Result<Vec<_>, _>>()?;

    let mut table = Table::new(
        format!("At {LUX} lx, mean over the models; features along their panel, in the station's own exposure"),
        &["paint", "light", "panel %", "gap %", "contrast", "ok as white", "ok", "sigma stated mm", "scatter mm"],
    );
    let mut contrasts: [Vec<f64>; 2] = Default::default();
    let mut levels: [Vec<(f64, f64)>; 2] = Default::default();
    for (k, paint) in PAINTS.iter().enumerate() {
        for (light, name) in LIGHTS.iter().enumerate() {
            let of: Vec<&Seen> =
                found.iter().map(|f| &f.1).filter(|s| s.paint.name == paint.name && s.light == light).collect();
            let average = |value: fn(&Seen) -> f64| mean(&of.iter().map(|s| value(s)).collect::<Vec<_>>());
            let known = |value: fn(&Seen) -> Option<f64>| rms(&of.iter().filter_map(|s| value(s)).collect::<Vec<_>>());
            contrasts[light].extend(average(Seen::contrast));
            levels[light].extend(average(|s| 100.0 * (s.panel - s.gap)).map(|v| (k as f64, v)));
            let share = |n: usize, of: usize| Cell::text(format!("{n}/{of}"));
            table.row(vec![
                Cell::text(paint.name),
                Cell::text(*name),
                Cell::number(average(|s| 100.0 * s.panel), 1),
                Cell::number(average(|s| 100.0 * s.gap), 1),
                Cell::number(average(Seen::contrast), 2),
                share(of.iter().filter(|s| s.ok_fixed).count(), of.len()),
                share(of.iter().map(|s| s.ok).sum(), of.iter().map(|s| s.captures).sum()),
                Cell::number(known(|s| s.stated), 4),
                Cell::number(known(|s| s.scatter), 4),
            ]);
        }
    }
    let of_light = |light: usize| found.iter().map(|f| &f.1).filter(move |s| s.light == light);
    let mut figures = Vec::new();
    for (light, name) in LIGHTS.iter().enumerate() {
        let least = contrasts[light].iter().copied().reduce(f64::min);
        let sigma = of_light(light).filter_map(|s| s.scatter).reduce(f64::max);
        let (ok, all) = of_light(light).fold((0, 0), |(ok, all), s| (ok + s.ok, all + s.captures));
        figures.push(Figure::new(format!("{name} bars: least edge contrast of a paint"), least, "", 2));
        figures.push(Figure::new(format!("{name} bars: largest scatter of features"), sigma, "mm", 4));
        figures.push(Figure::new(format!("{name} bars: measured ok"), 100.0 * ok as f64 / all.max(1) as f64, "%", 1));
    }
    let series = LIGHTS.iter().zip(levels).map(|(name, points)| Series { name: (*name).into(), points, joined: false });
    Ok(Outcome {
        setting: format!(
            "Simulated station at scale {}: {} models as drawn, taught on white under the red bars, each in every paint under red and \
             under white bars of {LUX} lx, {captures} captures of each; seed {}. White bars give back of a paint what the projector \
             does.",
            given.scale,
            models.len(),
            given.seed
        ),
        figures,
        tables: vec![table],
        remarks: vec![
            "Panel and gap are of white's grey level, at the exposure that suits white paint; contrast is their difference over their \
             sum."
                .into(),
        ],
        plots: vec![Plot {
            title: "Panel over gap at white paint's exposure".into(),
            x: format!("paint: {}", PAINTS.map(|p| p.name).join(", ")),
            y: "% of white".into(),
            series: series.collect(),
            levels: Vec::new(),
        }],
        pictures: Vec::new(),
    })
}

/// A paint as bars of this light see it.
fn lit(paint: Paint, light: usize) -> Paint {
    if LIGHTS[light] == "white" { Paint { red: paint.white, ..paint } } else { paint }
}

fn at_fixed(exposed: &Fixed, station: &crate::sim::Station, measurer: &Measurer) -> Result<Seen, Error> {
    let shot = exposed.shoot(station)?;
    let [panel, gap] = edges(&shot, measurer);
    Ok(Seen {
        paint: PAINTS[0],
        light: 0,
        panel,
        gap,
        ok_fixed: shot.measure(measurer).ok(),
        captures: 0,
        ok: 0,
        stated: None,
        scatter: None,
    })
}

/// Median levels beside the features' edges, on the panel and in the gap, of white and less the hall's.
fn edges(shot: &Shot, measurer: &Measurer) -> [f64; 2] {
    let camera = &measurer.rig().camera;
    let span = shot.capture.camera.white_level() - shot.capture.camera.black_level;
    let mut levels: [Vec<f64>; 2] = Default::default();
    for (_, template) in measurer.features() {
        let local = template.local(&shot.truth);
        let surface = template.surface.polynomial().expect("taught");
        for p in &template.contour {
            for (levels, off) in levels.iter_mut().zip([PANEL_MM, -GAP_MM]) {
                let uv = p.at() + p.normal() * off;
                let at = local.point(&uv.push(surface.height(&uv))).xyz;
                let Some(pixel) = camera.project(&at) else { continue };
                let (x, y) = (pixel.x.round(), pixel.y.round());
                if x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64 {
                    let of = |image: &crate::Image<u16>| f64::from(image.at(x as usize, y as usize));
                    levels.push((of(&shot.shots.red) - of(&shot.shots.ambient)) / span);
                }
            }
        }
    }
    levels.map(|mut levels| if levels.is_empty() { f64::NAN } else { crate::geometry::robust::median(&mut levels) })
}

/// Root mean square over the features of their stated sigma along the panel, which is seen nearly from in front.
fn stated(measured: &[&Measured]) -> Option<f64> {
    let features = measured.iter().flat_map(|m| &m.measurement.features);
    let along = |c: [[f64; 3]; 3]| {
        let c = Matrix3::from_fn(|i, j| c[i][j]);
        (0.5 * (c[(0, 0)] + c[(1, 1)])).sqrt()
    };
    rms(&features.filter_map(|f| f.covariance_mm2.map(along)).collect::<Vec<_>>())
}

/// The same of their scatter from capture to capture.
fn scatter(measured: &[&Measured]) -> Option<f64> {
    let n = measured.first()?.measurement.features.len();
    let axis = |k: usize, axis: usize| {
        let at: Vec<f64> =
            measured.iter().filter_map(|m| Some(Vector3::from(m.measurement.features[k].camera_mm?)[axis])).collect();
        standard_deviation(&at)
    };
    rms(&(0..n).flat_map(|k| [axis(k, 0), axis(k, 1)]).flatten().collect::<Vec<_>>())
}
