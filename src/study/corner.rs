//! The published corner experiment (table 3): a corner that is found up to 2 px beside its place. Two ways, which must agree.
//! By injection: the corner is clicked so far off, all around, and the model so taught measures another capture.
//! By covariance: what the stated covariance of that measurement says comes from a click of that uncertainty.
//! All clicks are stated to be as uncertain, so that every feature has its share in the pose, as it has in the publication.
//!
//! With weights W the covariance is C = (JᵀWJ)⁻¹, and ∂C/∂σ² of one click is G·(∂Σ/∂σ²)·Gᵀ, G the pose per shift of the points:
//! what comes from that click is σ²·∂C/∂σ², and that is a difference of two stated covariances.

use super::error;
use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::{largest, mean, rms};
use super::sweep;
use super::{Bench, Error, Given, Progress, Shot};
use crate::measure::{Measurement, Verdict};
use crate::sim::{Build, Deviation, PAINTS};
use crate::vehicle::{Kind, VehicleFile};
use nalgebra::{Matrix6, Vector2, Vector6};
use rayon::prelude::*;

/// The corner is off by so many px of an image of 2592×1944, the published one's size.
const OFF_PX: f64 = 2.0;
/// The step of the difference, as a share of the click's variance.
const STEP: f64 = 0.1;

/// One corner of one model.
struct Case {
    name: String,
    teach: Shot,
    features: VehicleFile,
    corner: usize,
    measure: Shot,
}

/// What came of it.
struct Found {
    /// By direction, rad: shift of the centroid, mm, and turn, degrees.
    injected: Vec<(f64, [f64; 2])>,
    /// The same by covariance, root mean square over all directions.
    covariance: [f64; 2],
}

impl Found {
    fn rms(&self) -> [Option<f64>; 2] {
        [0, 1].map(|i| rms(&self.injected.iter().map(|(_, off)| off[i]).collect::<Vec<_>>()))
    }
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    let directions = given.of(8, 4);
    let mut cases = Vec::new();
    for (model, body) in models.iter().enumerate() {
        let corners = if given.quick { 1 } else { 2 };
        for corner in 0..corners {
            let (teach, features) = bench.to_teach(body, PAINTS[0], &Deviation::default())?;
            let is_corner = |k: &usize| features.features[*k].kind == Kind::Corner;
            let Some(corner) = (0..features.features.len()).filter(is_corner).nth(corner) else { continue };
            let place = [8, model as u64];
            let drawn = body.clone().built(Build::default());
            let stands = sweep::stands(&bench, &drawn, &place);
            let measure = bench.shoot(&bench.station(&drawn, PAINTS[0], &stands, &place))?;
            let name = format!("{} {}", body.name, features.features[corner].name);
            cases.push(Case { name, teach, features, corner, measure });
        }
    }
    progress.begin("clicking", cases.len() * (directions + 3));
    let found =
        cases.par_iter().map(|c| case(&bench, given, c, directions, progress)).collect::<Result<Vec<_>, _>>()?;

    let mut table = Table::new(
        format!("A corner {OFF_PX} px off: by injection all around, and by covariance"),
        &["corner", "largest mm", "°", "rms mm", "°", "by covariance mm", "°", "ratio, mm", "ratio, °"],
    );
    let (mut largest_off, mut ratios) = ([Vec::new(), Vec::new()], Vec::new());
    let mut not_ok = Vec::new();
    for (c, f) in cases.iter().zip(&found) {
        let Some(f) = f else {
            not_ok.push(c.name.clone());
            continue;
        };
        let worst = [0, 1].map(|i| largest(&f.injected.iter().map(|(_, off)| off[i]).collect::<Vec<_>>()));
        let ratio = [0, 1].map(|i| f.rms()[i].map(|r| r / f.covariance[i]));
        (0..2).for_each(|i| largest_off[i].extend(worst[i]));
        ratios.extend(ratio.iter().flatten().copied());
        let pair = |v: [Option<f64>; 2]| [Cell::number(v[0], 3), Cell::number(v[1], 4)];
        let mut row = vec![Cell::text(&c.name)];
        row.extend(pair(worst).into_iter().chain(pair(f.rms())).chain(pair(f.covariance.map(Some))));
        row.extend(ratio.map(|r| Cell::number(r, 3)));
        table.row(row);
    }
    let extreme = |pick: fn(f64, f64) -> f64| ratios.iter().copied().reduce(pick);
    let agree = Must::Within(0.9, 1.1);
    let curve = |(c, f): (&Case, &Option<Found>)| {
        let points = f.iter().flat_map(|f| f.injected.iter().map(|(at, off)| (at.to_degrees(), off[0]))).collect();
        Series { name: c.name.clone(), points, joined: true }
    };
    Ok(Outcome {
        setting: format!(
            "Simulated station at scale {}: {} corners of {} models as drawn, in white; each clicked {OFF_PX} px of a 2592×1944 image \
             off in {directions} directions, and another capture measured with every such model; every click stated as uncertain \
             by {:.2} px; seed {}.",
            given.scale,
            cases.len(),
            models.len(),
            OFF_PX / 2f64.sqrt(),
            given.seed
        ),
        figures: vec![
            Figure::new("largest shift of the centroid", largest(&largest_off[0]), "mm", 3).published("≤ 1.56"),
            Figure::new("largest rotation", largest(&largest_off[1]), "°", 4).published("≤ 0.35"),
            Figure::new("injection over covariance, mean", mean(&ratios), "", 3).must(agree),
            Figure::new("injection over covariance, smallest", extreme(f64::min), "", 3).must(agree),
            Figure::new("injection over covariance, largest", extreme(f64::max), "", 3).must(agree),
        ],
        tables: vec![table],
        remarks: (!not_ok.is_empty()).then(|| format!("Not measured ok: {}.", not_ok.join(", "))).into_iter().collect(),
        plots: vec![Plot {
            title: "Shift of the centroid by the click's direction".into(),
            x: "direction in the image, °".into(),
            y: "shift, mm".into(),
            series: cases.iter().zip(&found).map(curve).collect(),
            levels: Vec::new(),
        }],
        pictures: Vec::new(),
    })
}

/// None: a measurement was not ok.
fn case(
    bench: &Bench,
    given: &Given,
    c: &Case,
    directions: usize,
    progress: &dyn Progress,
) -> Result<Option<Found>, Error> {
    let off_px = OFF_PX * given.scale;
    // all directions alike: each axis has half the square of the length
    let sigma_px = off_px / 2f64.sqrt();
    let measured = |click: Vector2<f64>, variance: f64| -> Result<Measurement, Error> {
        let mut features = c.features.clone();
        features.features.iter_mut().for_each(|f| f.pixel_sigma = sigma_px);
        let corner = &mut features.features[c.corner];
        corner.pixel_sigma = sigma_px * variance.sqrt();
        corner.pixel = corner.pixel.map(|[x, y]| [x + click.x, y + click.y]);
        let taught = bench.taught(&c.teach, &features, &bench.calibration)?;
        progress.step();
        Ok(c.measure.measure(&bench.measurer(&bench.calibration, taught)).measurement)
    };
    let as_it_is = measured(Vector2::zeros(), 1.0)?;
    let stated = [1.0 + STEP, 1.0 - STEP].map(|variance| measured(Vector2::zeros(), variance));
    let [more, less] = stated;
    let (more, less) = (more?, less?);
    let clicks = (0..directions).map(|k| k as f64 * std::f64::consts::TAU / directions as f64);
    let clicked = clicks
        .map(|at| Ok((at, measured(Vector2::new(at.cos(), at.sin()) * off_px, 1.0)?)))
        .collect::<Result<Vec<_>, Error>>()?;
    let all = [&as_it_is, &more, &less].into_iter().chain(clicked.iter().map(|(_, m)| m));
    if !all.into_iter().all(|m| m.verdict == Verdict::Ok) {
        return Ok(None);
    }
    let found = || {
        let stands = error::pose(&as_it_is)?;
        let of_click: Matrix6<f64> = (error::covariance(&more)? - error::covariance(&less)?) / (2.0 * STEP);
        let injected = clicked.iter().map(|(at, m)| Some((*at, size(&error::error(m, &stands)?))));
        let size = |first: usize, unit: f64| unit * of_click.fixed_view::<3, 3>(first, first).trace().max(0.0).sqrt();
        Some(Found {
            injected: injected.collect::<Option<_>>()?,
            covariance: [size(0, 1.0), size(3, 1f64.to_degrees())],
        })
    };
    Ok(found())
}

/// Length of the shift, mm, and angle of the turn, degrees.
fn size(e: &Vector6<f64>) -> [f64; 2] {
    [e.fixed_rows::<3>(0).norm(), e.fixed_rows::<3>(3).norm().to_degrees()]
}
