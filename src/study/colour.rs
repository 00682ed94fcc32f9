//! The published colours (table 1): every paint, under the red bars and under white ones. Out: how bright panel and gap are at
//! the exposure that suits white paint, the features' edges over noise there, how well the features are known.
//! White bars are simulated by the paints: under them each gives back what it gives back of the projector's white light.

use super::outcome::{Cell, Figure, Outcome, Plot, Series, Table};
use super::statistics::{mean, rms, standard_deviation};
use super::sweep;
use super::{Bench, Error, Given, Measured, Progress, Shot};
use crate::capture::TYPICAL_GAIN;
use crate::fringe::NoiseLaw;
use crate::geometry::robust;
use crate::measure::{FeatureResult, Measurer};
use crate::sim::{Deviation, PAINTS, Paint};
use crate::vehicle::Kind;
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
    /// Grey levels above black, as a share of white, at the exposure of white paint in this light.
    panel: f64,
    gap: f64,
    /// Their difference over the panel's noise.
    over_noise: f64,
    /// Measured ok at that exposure.
    ok_fixed: bool,
    /// Captures as the station exposes them, and how many were ok.
    captures: usize,
    ok: usize,
    /// Along the panel, of corners and flap: as stated, and from capture to capture, mm. An arch slides along itself.
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
    // the first is white
    let paints: Vec<Paint> = if given.quick { [0, 3, 5].map(|k| PAINTS[k]).to_vec() } else { PAINTS.to_vec() };
    let place = |model: usize, light: usize, paint: usize| [9, model as u64, light as u64, paint as u64];
    let station = |model: usize, light: usize, paint: usize| {
        let stands = Deviation::default();
        bench.station(&models[model], lit(paints[paint], light), &stands, &place(model, light, paint))
    };
    let all: Vec<(usize, usize)> =
        (0..models.len()).flat_map(|model| (0..LIGHTS.len()).map(move |light| (model, light))).collect();
    progress.begin("measuring", all.len() * paints.len() * (captures + 1));
    let of_light = |&(model, light): &(usize, usize)| -> Result<Vec<Seen>, Error> {
        let exposed = bench.exposed_for(&station(model, light, 0), LUX)?;
        let of_paint = |paint: usize| -> Result<Seen, Error> {
            let (standing, measurer) = (station(model, light, paint), &measurers[model]);
            let shot = exposed.shoot(&standing)?;
            let ok_fixed = shot.measure(measurer).ok();
            progress.step();
            let mut measured = Vec::new();
            for _ in 0..captures {
                measured.push(bench.shoot(&standing)?.measure(measurer));
                progress.step();
            }
            let ok: Vec<&Measured> = measured.iter().filter(|m| m.ok()).collect();
            let [panel, gap, over_noise] = edges(&shot, measurer);
            let (stated, scatter) = (stated(&ok, measurer), scatter(&ok, measurer));
            Ok(Seen {
                paint: paints[paint],
                light,
                panel,
                gap,
                over_noise,
                ok_fixed,
                captures,
                ok: ok.len(),
                stated,
                scatter,
            })
        };
        (0..paints.len()).into_par_iter().map(of_paint).collect()
    };
    let found: Vec<Seen> = all.par_iter().map(of_light).collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect();

    let mut table = Table::new(
        format!("At {LUX} lx, mean over the models; features along their panel, in the station's own exposure"),
        &[
            "paint",
            "light",
            "panel %",
            "gap %",
            "contrast",
            "edge over noise",
            "ok as white",
            "ok",
            "sigma stated mm",
            "scatter mm",
        ],
    );
    let mut edges_over_noise: [Vec<f64>; 2] = Default::default();
    let mut levels: [Vec<(f64, f64)>; 2] = Default::default();
    for (k, paint) in paints.iter().enumerate() {
        for (light, name) in LIGHTS.iter().enumerate() {
            let of: Vec<&Seen> = found.iter().filter(|s| s.paint.name == paint.name && s.light == light).collect();
            let average = |value: fn(&Seen) -> f64| mean(&of.iter().map(|s| value(s)).collect::<Vec<_>>());
            let known = |value: fn(&Seen) -> Option<f64>| rms(&of.iter().filter_map(|s| value(s)).collect::<Vec<_>>());
            let over_noise = average(|s| s.over_noise);
            edges_over_noise[light].extend(over_noise);
            levels[light].extend(over_noise.map(|v| (k as f64, v)));
            let share = |n: usize, of: usize| Cell::text(format!("{n}/{of}"));
            table.row(vec![
                Cell::text(paint.name),
                Cell::text(*name),
                Cell::number(average(|s| 100.0 * s.panel), 1),
                Cell::number(average(|s| 100.0 * s.gap), 2),
                Cell::number(average(Seen::contrast), 2),
                Cell::number(over_noise, 1),
                share(of.iter().filter(|s| s.ok_fixed).count(), of.len()),
                share(of.iter().map(|s| s.ok).sum(), of.iter().map(|s| s.captures).sum()),
                Cell::number(known(|s| s.stated), 4),
                Cell::number(known(|s| s.scatter), 4),
            ]);
        }
    }
    let of_light = |light: usize| found.iter().filter(move |s| s.light == light);
    let mut figures = Vec::new();
    for (light, name) in LIGHTS.iter().enumerate() {
        let least = edges_over_noise[light].iter().copied().reduce(f64::min);
        let sigma = of_light(light).filter_map(|s| s.scatter).reduce(f64::max);
        let (ok, all) = of_light(light).fold((0, 0), |(ok, all), s| (ok + s.ok, all + s.captures));
        figures.push(Figure::new(
            format!("{name} bars: weakest paint's edge over noise, exposed as white"),
            least,
            "",
            1,
        ));
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
             sum, the edge their difference over the panel's noise."
                .into(),
        ],
        plots: vec![Plot {
            title: "Edges at white paint's exposure".into(),
            x: format!("paint: {}", paints.iter().map(|p| p.name).collect::<Vec<_>>().join(", ")),
            y: "difference over noise".into(),
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

/// Levels beside the features' edges, above black as a share of white: on the panel and in the gap; and their
/// difference over the panel's noise.
fn edges(shot: &Shot, measurer: &Measurer) -> [f64; 3] {
    let (lens, camera) = (&measurer.rig().camera, &shot.capture.camera);
    let mut levels: [Vec<f64>; 2] = Default::default();
    for (_, template) in measurer.features() {
        let local = template.local(&shot.truth);
        let surface = template.surface.polynomial().expect("taught");
        for p in &template.contour {
            for (levels, off) in levels.iter_mut().zip([PANEL_MM, -GAP_MM]) {
                let uv = p.at() + p.normal() * off;
                let at = local.point(&uv.push(surface.height(&uv))).xyz;
                let Some(pixel) = lens.project(&at) else { continue };
                let (x, y) = (pixel.x.round(), pixel.y.round());
                if x >= 0.0 && y >= 0.0 && x < lens.width as f64 && y < lens.height as f64 {
                    levels.push(f64::from(shot.shots.red.at(x as usize, y as usize)));
                }
            }
        }
    }
    let [mut on_panel, in_gap] = levels;
    // a gap may be darker than a grey level: their mean tells more than the median
    let (Some(gap), false) = (mean(&in_gap), on_panel.is_empty()) else { return [f64::NAN; 3] };
    let panel = robust::median(&mut on_panel);
    let gain = shot.capture.images.red_gain_dn_per_e.unwrap_or(TYPICAL_GAIN);
    let noise = NoiseLaw::from_sensor(gain, camera.read_noise_e.unwrap_or(0.0), camera.black_level);
    let share = |level: f64| (level - camera.black_level) / (camera.white_level() - camera.black_level);
    [share(panel), share(gap), (panel - gap) / noise.variance(panel).sqrt()]
}

/// The features of a measurement but the arch.
fn held<'m>(measured: &'m Measured, measurer: &'m Measurer) -> impl Iterator<Item = &'m FeatureResult> {
    let features = measured.measurement.features.iter().zip(measurer.features());
    features.filter(|(_, (feature, _))| feature.kind != Kind::ArchTop).map(|(f, _)| f)
}

/// Root mean square over the features of their stated sigma along the panel, which is seen nearly from in front.
fn stated(measured: &[&Measured], measurer: &Measurer) -> Option<f64> {
    let along = |c: [[f64; 3]; 3]| (0.5 * (c[0][0] + c[1][1])).sqrt();
    let sigmas = measured.iter().flat_map(|m| held(m, measurer)).filter_map(|f| f.covariance_mm2.map(along));
    rms(&sigmas.collect::<Vec<_>>())
}

/// The same of their scatter from capture to capture.
fn scatter(measured: &[&Measured], measurer: &Measurer) -> Option<f64> {
    let at: Vec<Vec<[f64; 3]>> =
        measured.iter().map(|m| held(m, measurer).filter_map(|f| f.camera_mm).collect()).collect();
    let n = at.iter().map(Vec::len).min()?;
    let axis = |k: usize, axis: usize| standard_deviation(&at.iter().map(|of| of[k][axis]).collect::<Vec<_>>());
    rms(&(0..n).flat_map(|k| [axis(k, 0), axis(k, 1)]).flatten().collect::<Vec<_>>())
}
