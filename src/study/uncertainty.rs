//! Whether the stated uncertainty is that of the errors, and whether a displaced feature shows.
//! In:  calibrations drawn from a calibration's covariance, teachings whose clicks are off as stated; vehicles in many
//! poses. Out: error over sigma per axis and target, how often U (k = 2) covers, how often displacements are refused.

use super::error::{at_target, beyond_stated, covariance, is_wrong, over_sigma};
use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::rms;
use super::sweep;
use super::{Bench, Error, Given, Measured, Progress, Shot};
use crate::calibrate::{
    Board, Calibration, ParameterCovariance, Seen, Terms, View, changed, independent_errors, solve,
};
use crate::geometry::{Point3, motion_jacobian};
use crate::measure::{Measurer, Taught};
use crate::optics::{Pixel, Rig};
use crate::sim::{Body, Build, DISTANCE_MM, Deviation, PAINTS, Random, Script, Station, board as printed};
use crate::vehicle::{Template, VehicleFile};
use nalgebra::{DMatrix, DVector, Matrix6, SVector, Vector3};
use rayon::prelude::*;
use std::sync::Arc;

/// A click under a magnifier is off by so much, 1 sigma per axis, mm on the body: a quarter of a pixel at half resolution.
const CLICK_MM: f64 = 0.15;
/// How well boards are seen, 1 sigma, px.
const BOARD_PX: f64 = 0.05;
/// How well a board's pitch is known, as a share.
const PITCH: f64 = 0.0002;
/// Features are displaced by so much, mm.
const DISPLACED_MM: [f64; 5] = [0.3, 0.5, 1.0, 2.0, 3.0];
/// Geometry allows to see a displacement where a rigid motion cannot take up this share of it.
const VISIBLE: f64 = 0.3;
const AXES: [&str; 6] = ["x", "y", "z", "roll", "pitch", "yaw"];

/// A calibration drawn at random, and two teachings by it.
struct Drawn {
    calibration: Calibration,
    /// Clicks are off.
    clicked: Model,
    /// Clicks are exact, and known to be.
    exact: Model,
    measurer: Measurer,
}

struct Model {
    vehicle: VehicleFile,
    templates: Vec<Template>,
}

/// One measurement of one draw.
struct Row {
    /// In the order of [`AXES`], then x, y, z of every target.
    over: Vec<f64>,
    paint: &'static str,
    /// A wrong pose; and one that is off by more than twice its U at a target, which no honest one is.
    wrong: (bool, bool),
}

/// One displaced feature.
struct Displaced {
    features: usize,
    mm: f64,
    /// Taught with exact clicks.
    exact: bool,
    /// Share of it that no rigid motion takes up.
    visible: f64,
    refused: bool,
    /// A wrong pose called ok.
    wrong: bool,
}

/// What became of one vehicle.
struct Looked {
    rows: Vec<Row>,
    refused: Vec<String>,
    displaced: Vec<Displaced>,
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    let (draws, poses) = (given.of(20, 2), given.of(50, 4));
    let stated = stated_covariance(&bench.setup.rig, &mut bench.random(&[30]));
    let mut drawn: Vec<Vec<Drawn>> = Vec::new();
    progress.begin("teaching", draws);
    for (m, body) in models.iter().enumerate() {
        let to_teach = bench.to_teach(body, PAINTS[0], &Deviation::default())?;
        let own: Vec<usize> = (0..draws).filter(|d| d % models.len() == m).collect();
        let one = |d: &usize| {
            let drawn = draw(&bench, &stated, &to_teach, &mut bench.random(&[31, *d as u64]));
            progress.step();
            drawn
        };
        drawn.push(own.par_iter().map(one).collect::<Result<_, _>>()?);
    }
    let all: Vec<(usize, usize)> = (0..models.len()).flat_map(|m| (0..poses).map(move |p| (m, p))).collect();
    progress.begin("measuring", all.len());
    let look = |&(m, p): &(usize, usize)| -> Result<Looked, Error> {
        let looked = looked(&bench, &models[m], &drawn[m], [m as u64, p as u64]);
        progress.step();
        looked
    };
    let looked = all.par_iter().map(look).collect::<Result<Vec<_>, _>>()?;
    let targets: Vec<String> = drawn[0][0].clicked.vehicle.targets.iter().map(|t| t.name.clone()).collect();
    let setting = format!(
        "Simulated station at scale {}: {draws} calibrations drawn from the covariance that twelve boards give (seen to {BOARD_PX} px, \
         pitch to {} %), each with a teaching of one of {} models on white whose clicks are off by {CLICK_MM} mm sigma; each measures \
         {poses} vehicles, built off the drawing and in the paints in turn, as they may roll in; seed {}. A displaced feature's nominal \
         point lies beside the true one, in any direction.",
        given.scale,
        100.0 * PITCH,
        models.len(),
        given.seed
    );
    Ok(outcome(setting, draws, &targets, &looked))
}

/// What a calibration by twelve boards states.
fn stated_covariance(rig: &Rig, random: &mut Random) -> ParameterCovariance {
    let board: Board = "chessboard:11x8:35".parse().expect("a board");
    let points = board.points();
    let mut places = printed::places(&board);
    places.extend(
        [
            ([-30.0, 20.0, 730.0], [15.0, -30.0, 6.0]),
            ([30.0, -20.0, 790.0], [-30.0, 12.0, -6.0]),
            ([0.0, 30.0, 750.0], [30.0, -12.0, 90.0]),
            ([10.0, -30.0, 710.0], [-12.0, 30.0, 180.0]),
        ]
        .map(|(at, tilt)| printed::place(&board, at, tilt)),
    );
    let (c, p) = ((rig.camera.width, rig.camera.height), (rig.projector.width, rig.projector.height));
    let views: Vec<View> = places
        .iter()
        .enumerate()
        .map(|(k, pose)| {
            let mut seen = |to: &dyn Fn(&Vector3<f64>) -> Option<Pixel>, (w, h): (usize, usize)| -> Vec<Seen> {
                let place = |(i, q): (usize, &nalgebra::Vector2<f64>)| {
                    let at = to(&(*pose * Point3::new(q.push(0.0))).xyz)?;
                    let inside = at.x >= 0.0 && at.y >= 0.0 && at.x < w as f64 && at.y < h as f64;
                    let off = Pixel::new(random.normal(), random.normal()) * BOARD_PX;
                    inside.then_some((i, at + off))
                };
                points.iter().enumerate().filter_map(place).collect()
            };
            let camera = seen(&|x| rig.camera.project(x), c);
            let relation = &rig.projector_from_camera;
            let projector = seen(&|x| rig.projector.project(&(*relation * Point3::new(*x)).xyz), p);
            View { name: k.to_string(), seen: [camera, projector] }
        })
        .collect();
    let solution = solve(&points, &views, [Some(c), Some(p)], Terms::Chosen).expect("twelve tilted boards");
    let mut calibration = Calibration {
        file: std::path::PathBuf::new(),
        id: None,
        rig: rig.clone(),
        station_from_camera: None,
        covariance: Some(Box::new(solution.parameter_covariance())),
        quality: None,
    };
    calibration.add_scale_sigma(PITCH);
    *calibration.covariance.expect("just given")
}

/// A rig that is off as `stated`, and a teaching by it whose clicks are off.
fn draw(
    bench: &Bench,
    stated: &ParameterCovariance,
    (shot, features): &(Shot, VehicleFile),
    random: &mut Random,
) -> Result<Drawn, Error> {
    let off = independent_errors(stated) * SVector::<f64, 24>::from_fn(|_, _| random.normal());
    let rig = (0..24).fold(bench.setup.rig.clone(), |rig, k| changed(&rig, k, off[k]));
    let calibration = Calibration { rig, covariance: Some(Box::new(*stated)), ..bench.calibration.clone() };
    let mut off = features.clone();
    let sigma_px = CLICK_MM * bench.setup.rig.camera.fx / DISTANCE_MM;
    for f in &mut off.features {
        f.pixel_sigma = sigma_px;
        f.pixel = f.pixel.map(|p| p.map(|v| v + sigma_px * random.normal()));
    }
    let model = |features: &VehicleFile| -> Result<Model, Error> {
        let Taught { model, templates, .. } = bench.taught(shot, features, &calibration)?;
        Ok(Model { vehicle: model, templates })
    };
    let (clicked, exact) = (model(&off)?, model(features)?);
    let measurer = measurer(bench, &calibration, &clicked.vehicle, &clicked.templates);
    Ok(Drawn { calibration, clicked, exact, measurer })
}

fn measurer(bench: &Bench, calibration: &Calibration, vehicle: &VehicleFile, templates: &[Template]) -> Measurer {
    Measurer::with_templates(calibration.clone(), vehicle.clone(), templates.to_vec()).sharing(&bench.shared)
}

/// Measures one vehicle with every draw of its model, and with features displaced.
fn looked(bench: &Bench, body: &Body, drawn: &[Drawn], place: [u64; 2]) -> Result<Looked, Error> {
    let [m, p] = place;
    let paint = PAINTS[(p as usize + m as usize) % PAINTS.len()];
    let built = body.clone().built(Build::random(&mut bench.random(&[32, m, p])));
    let stands = sweep::stands(bench, body, &[33, m, p]);
    let vehicle = (built, paint, stands);
    let seed = bench.random(&[34, m, p]).bits();
    let station = Station::with_vehicle(Arc::clone(&bench.setup), seed, vehicle, Script::default());
    let shot = bench.shoot(&station)?;
    let mut out = Looked { rows: Vec::new(), refused: Vec::new(), displaced: Vec::new() };
    for d in drawn {
        let measured = shot.measure(&d.measurer);
        match row(&measured, &d.clicked.vehicle, paint.name) {
            Some(row) => out.rows.push(row),
            None => out.refused.push(format!("{} {}: {}", paint.name, body.name, measured.measurement.detail)),
        }
    }
    // 1 mm for each vehicle; for every other one another displacement or the other teaching
    let others = DISPLACED_MM.iter().filter(|mm| **mm != 1.0).nth(p as usize / 2 % (DISPLACED_MM.len() - 1));
    let second = if p.is_multiple_of(2) { others.map(|mm| (*mm, true)) } else { Some((1.0, false)) };
    for (k, (mm, exact)) in [Some((1.0, true)), second].into_iter().flatten().enumerate() {
        let d = &drawn[k % drawn.len()];
        let mut random = bench.random(&[35, m, p, k as u64]);
        out.displaced.push(displaced(bench, &shot, d, (mm, exact), &mut random));
    }
    Ok(out)
}

fn row(measured: &Measured, vehicle: &VehicleFile, paint: &'static str) -> Option<Row> {
    let (m, truth) = (&measured.measurement, &measured.truth);
    let e = measured.error()?;
    let mut over: Vec<f64> = over_sigma(&e, m)?.iter().copied().collect();
    let (covariance, at): (Matrix6<f64>, Vector3<f64>) = (covariance(m)?, Vector3::from(m.covariance_at_mm?));
    for t in &vehicle.targets {
        let j = motion_jacobian(&Vector3::from(t.position_mm), &at);
        let spread = j * covariance * j.transpose();
        let off = at_target(m, truth, t.position_mm)?;
        over.extend((0..3).map(|i| off[i] / spread[(i, i)].sqrt()));
    }
    let dishonest = beyond_stated(m, truth, &vehicle.targets);
    Some(Row { over, paint, wrong: (is_wrong(m, truth, &vehicle.targets), dishonest) })
}

fn displaced(bench: &Bench, shot: &Shot, d: &Drawn, (mm, exact): (f64, bool), random: &mut Random) -> Displaced {
    let model = if exact { &d.exact } else { &d.clicked };
    let n = model.vehicle.features.len();
    let k = random.below(n);
    let direction = Vector3::new(random.normal(), random.normal(), random.normal()).normalize();
    let mut vehicle = model.vehicle.clone();
    let moved = Vector3::from(vehicle.features[k].position_mm) + direction * mm;
    vehicle.features[k].position_mm = moved.into();
    let points: Vec<Vector3<f64>> = model.vehicle.features.iter().map(|f| f.position().xyz).collect();
    let measured = shot.measure(&measurer(bench, &d.calibration, &vehicle, &model.templates));
    let wrong = measured.ok() && is_wrong(&measured.measurement, &measured.truth, &vehicle.targets);
    Displaced { features: n, mm, exact, visible: visible(&points, k, &direction), refused: !measured.ok(), wrong }
}

/// The share of a displacement of point `k` along `direction` that no rigid motion of the points takes up.
fn visible(points: &[Vector3<f64>], k: usize, direction: &Vector3<f64>) -> f64 {
    let n = points.len();
    let middle = points.iter().sum::<Vector3<f64>>() / n as f64;
    let mut motions = DMatrix::zeros(3 * n, 6);
    for (i, p) in points.iter().enumerate() {
        // turns in units of 100 mm
        let mut j = motion_jacobian(p, &middle);
        j.fixed_columns_mut::<3>(3).scale_mut(0.01);
        motions.fixed_view_mut::<3, 6>(3 * i, 0).copy_from(&j);
    }
    let mut shift = DVector::zeros(3 * n);
    shift.fixed_rows_mut::<3>(3 * k).copy_from(direction);
    let normal = (motions.transpose() * &motions).try_inverse();
    normal.map_or(0.0, |inverse| (&shift - &motions * (inverse * (motions.transpose() * &shift))).norm())
}

fn outcome(setting: String, draws: usize, targets: &[String], looked: &[Looked]) -> Outcome {
    let rows: Vec<&Row> = looked.iter().flat_map(|l| &l.rows).collect();
    let refused: Vec<&String> = looked.iter().flat_map(|l| &l.refused).collect();
    let names: Vec<String> = AXES
        .iter()
        .map(|a| (*a).into())
        .chain(targets.iter().flat_map(|t| ["x", "y", "z"].map(|a| format!("{t}, {a}"))))
        .collect();
    let of = |axis: usize| rows.iter().filter_map(|r| r.over.get(axis).copied()).collect::<Vec<f64>>();
    let covered = |values: &[f64]| {
        let inside = values.iter().filter(|v| v.abs() <= 2.0).count();
        (!values.is_empty()).then(|| 100.0 * inside as f64 / values.len() as f64)
    };
    let mut table = Table::new("Error over stated sigma", &["axis", "values", "rms", "k=2 covers %", "largest"]);
    for (axis, name) in names.iter().enumerate() {
        let values = of(axis);
        table.row(vec![
            Cell::text(name),
            Cell::count(values.len()),
            Cell::number(rms(&values), 2),
            Cell::number(covered(&values), 1),
            Cell::number(super::statistics::largest(&values), 2),
        ]);
    }
    let mut paints = Table::new("By paint", &["paint", "measured", "rms", "k=2 covers %"]);
    for paint in PAINTS {
        let worn: Vec<f64> =
            rows.iter().filter(|r| r.paint == paint.name).flat_map(|r| r.over.iter().copied()).collect();
        if !worn.is_empty() {
            let measured = Cell::count(worn.len() / names.len());
            let share = Cell::number(covered(&worn), 1);
            paints.row(vec![Cell::text(paint.name), measured, Cell::number(rms(&worn), 2), share]);
        }
    }
    let pose: Vec<f64> = (0..AXES.len()).flat_map(of).collect();
    let target: Vec<f64> = (AXES.len()..names.len()).flat_map(of).collect();
    let wrong = rows.iter().filter(|r| r.wrong.0).count();
    let dishonest = rows.iter().filter(|r| r.wrong.1).count();
    let mut figures = Vec::new();
    for (what, values) in [("pose", &pose), ("targets", &target)] {
        let sigma = Figure::new(format!("{what}: error over sigma, rms"), rms(values), "", 2);
        figures.push(sigma.must(Must::Within(0.9, 1.15)));
        let share = Figure::new(format!("{what}: k=2 covers"), covered(values), "%", 1);
        figures.push(share.must(Must::Within(93.0, 97.0)));
    }
    figures.push(Figure::new(
        "refused, of all measured",
        100.0 * refused.len() as f64 / (refused.len() + rows.len()).max(1) as f64,
        "%",
        1,
    ));
    figures.push(Figure::new("wrong poses called ok", wrong as f64, "", 0));
    figures.push(Figure::new("of these, off by more than 2 U at a target", dishonest as f64, "", 0));
    let displaced: Vec<&Displaced> = looked.iter().flat_map(|l| &l.displaced).collect();
    let share = |of: &dyn Fn(&Displaced) -> bool| {
        let all: Vec<&&Displaced> = displaced.iter().filter(|d| of(d)).collect();
        let refused = all.iter().filter(|d| d.refused).count();
        (
            all.len(),
            (!all.is_empty()).then(|| 100.0 * refused as f64 / all.len() as f64),
            all.iter().filter(|d| d.wrong).count(),
        )
    };
    let mut detection = Table::new(
        "A feature displaced",
        &["features", "clicks", "displaced mm", "geometry", "vehicles", "refused %", "wrong poses called ok"],
    );
    for features in [4, 3] {
        let others = DISPLACED_MM.map(|mm| (mm, true));
        for (mm, exact) in others.into_iter().chain([(1.0, false)]) {
            for (allows, said) in [(true, "allows to see it"), (false, "hides it")] {
                let (n, refused, wrong) = share(&|d| {
                    let kind = d.features == features && d.mm == mm && d.exact == exact;
                    kind && (d.visible >= VISIBLE) == allows
                });
                if n > 0 {
                    detection.row(vec![
                        Cell::count(features),
                        Cell::text(if exact { "exact".into() } else { format!("± {CLICK_MM} mm") }),
                        Cell::number(mm, 1),
                        Cell::text(said),
                        Cell::count(n),
                        Cell::number(refused, 1),
                        Cell::count(wrong),
                    ]);
                }
            }
        }
    }
    for (features, must) in [(4, 99.0), (3, 95.0)] {
        let (n, refused, _) = share(&|d| d.features == features && d.mm >= 1.0 && d.exact && d.visible >= VISIBLE);
        if n > 0 {
            let name = format!("{features} features: one displaced by 1 mm or more refused");
            figures.push(Figure::new(name, refused, "%", 1).must(Must::AtLeast(must)));
        }
    }
    let mut remarks = vec![format!(
        "Geometry hides a displacement where a rigid motion of all features takes up more than {:.0} % of it: with three features every one \
         across their plane, and near the line between two of them what turns about the third; then only the panel's normals speak. \
         A pose counts as wrong beyond 0.5 mm, too, and calibrations and clicks as drawn here may move it so far against the camera. \
         {draws} draws share their calibration and teaching over all their vehicles: the figures scatter by some {:.0} %.",
        100.0 * (1.0 - VISIBLE),
        100.0 / (2.0 * 4.0 * draws as f64).sqrt()
    )];
    remarks.extend(refused.iter().take(10).map(|r| format!("Refused: {r}")));
    let quantiles = |values: &[f64]| {
        let mut sorted: Vec<f64> = values.iter().map(|v| v.abs()).collect();
        sorted.sort_by(f64::total_cmp);
        let n = sorted.len().max(1) as f64;
        (1..=40)
            .map(|k| 0.1 * f64::from(k))
            .map(|s| (s, 100.0 * sorted.partition_point(|v| *v <= s) as f64 / n))
            .collect()
    };
    Outcome {
        setting,
        figures,
        tables: vec![table, paints, detection],
        remarks,
        plots: vec![Plot {
            title: "How many errors lie within k sigmas; a normal distribution has 68 % within one and 95 % within two"
                .into(),
            x: "k".into(),
            y: "errors within, %".into(),
            series: vec![
                Series { name: "pose".into(), points: quantiles(&pose), joined: true },
                Series { name: "targets".into(), points: quantiles(&target), joined: true },
            ],
            levels: vec![68.3, 95.4],
        }],
        pictures: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn three_points_hide_what_leaves_their_plane_and_four_hide_less() {
        let three = [[0.0, 0.0, 0.0], [300.0, 0.0, 0.0], [150.0, 0.0, 200.0]].map(Vector3::from);
        assert!(visible(&three, 2, &Vector3::y()) < 1e-9, "a turn about the two others takes it up");
        assert!(visible(&three, 2, &Vector3::z()) > 0.5);
        let four = [three[0], three[1], three[2], Vector3::new(150.0, 0.0, 10.0)];
        assert!(visible(&four, 2, &Vector3::z()) > visible(&three, 2, &Vector3::z()));
        assert!(visible(&four, 3, &Vector3::y()) > 0.4, "it leaves the plane of the others");
    }

    #[test]
    fn twelve_boards_state_a_calibration_as_good_as_real_ones() {
        let rig = crate::sim::Setup::new(0.25, 8).rig;
        let stated = stated_covariance(&rig, &mut Random::new(1, &[]));
        let calibration = Calibration {
            file: std::path::PathBuf::new(),
            id: None,
            rig,
            station_from_camera: None,
            covariance: Some(Box::new(stated)),
            quality: None,
        };
        let scale = 100.0 * crate::calibrate::scale_sigma(&calibration, 750.0).expect("stated");
        assert!((0.02..0.06).contains(&scale), "{scale} %: the pitch's own 0.02 % and a little more");
    }
}
