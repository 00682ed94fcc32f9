//! What a vehicle model lets one expect before anything is measured, and what a further feature would bring.
//! In:  a vehicle model, taught or not. Out: expected U (k = 2) per axis and at its targets; the same with one feature more in
//! different places; and with midpoints of measured points, which the publication proposes as features.
//!
//! Expected is what is stated on the taught paint: noise, what light does to edges, clicks, build tolerance. Not here: what a
//! calibration adds; whether a feature can be found where it would help.

use super::outcome::{Cell, Figure, Outcome, Plot, Series, Table};
use super::sweep;
use super::{Error, Given, Progress};
use crate::geometry::motion_jacobian;
use crate::measure::{ARCH_TURN_RAD, EDGE_BIAS_MM, LIGHT_SHIFT_MM_PER_DEG, NORMAL_BIAS_MM, PAINT_SHIFT_MM};
use crate::sim::{self, Deviation, PAINTS, Scene, Setup};
use crate::vehicle::{Feature, Kind, Target, Template, VehicleFile};
use nalgebra::{DMatrix, Matrix3, Matrix6, Vector3};

/// Noise of a feature's place along the panel and across it, 1 sigma, mm.
const NOISE_MM: (f64, f64) = (0.01, 0.003);
/// Radius of a wheel arch: its top slides along by that times how well its turn is known, mm.
const ARCH_MM: f64 = 365.0;
/// What a click's pixel is at the usual distance at half resolution, mm.
const CLICK_MM_PER_PX: f64 = 0.55;
/// How far a vehicle is turned against the taught attitude, degrees.
const TURNED_DEG: f64 = 2.5;
/// A further feature is looked for so far from the features' middle, along and up, mm: about what is in view.
const REACH_MM: [f64; 2] = [320.0, 220.0];

/// A feature as it is expected: where, and how well, vehicle axes.
#[derive(Clone, Debug)]
struct Point {
    at: Vector3<f64>,
    covariance: Matrix3<f64>,
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let (models, setting) = match &given.vehicle {
        Some(vehicle) => (vec![(vehicle.clone(), templates(vehicle)?)], format!("{}.", vehicle.name)),
        None => {
            let models = simulated(given.scale, given.of(10, 4));
            let setting = format!("The first {} models of the simulated station, clicked exactly.", models.len());
            (models, setting)
        }
    };
    progress.begin("computing", models.len());
    let mut table = Table::new(
        "Expected U (k = 2): of the features' middle, of the angles, at the targets",
        &["model", "features", "x mm", "y mm", "z mm", "roll °", "pitch °", "yaw °", "worst target mm", "which"],
    );
    let mut further = Table::new(
        "Worst target's U (k = 2), mm, with one corner more at a place beside the features' middle (along, up; mm)",
        &[
            "model",
            "now",
            "best place",
            "there",
            "fore, up",
            "fore, down",
            "middle, up",
            "middle, down",
            "aft, up",
            "aft, down",
        ],
    );
    let mut midpoints = Table::new(
        "Worst target's U (k = 2), mm, with every midpoint of two features as a feature, too",
        &["model", "without", "if midpoints were measured", "what it really is", "with the best weights"],
    );
    let mut series = Vec::new();
    let mut shares = Vec::new();
    for (vehicle, templates) in &models {
        let points = points(vehicle, templates);
        let too_few = || Error::Nothing { what: format!("{}: its features determine no pose", vehicle.name) };
        let (covariance, at) = expected(&points).ok_or_else(too_few)?;
        let u = |v: f64| 2.0 * v.max(0.0).sqrt();
        let (worst, which) = worst(&covariance, &at, &vehicle.targets).unwrap_or((f64::NAN, "–"));
        let mut row = vec![Cell::text(&vehicle.name), Cell::count(points.len())];
        row.extend((0..3).map(|i| Cell::number(u(covariance[(i, i)]), 3)));
        row.extend((3..6).map(|i| Cell::number(u(covariance[(i, i)]).to_degrees(), 4)));
        row.extend([Cell::number(worst, 3), Cell::text(which)]);
        table.row(row);

        let with = |place: [f64; 2]| {
            let more = Point { at: at + Vector3::new(place[0], 0.0, place[1]), covariance: of_corner(Vector3::y()) };
            let all: Vec<Point> = points.iter().cloned().chain([more]).collect();
            let (covariance, at) = expected(&all)?;
            Some(self::worst(&covariance, &at, &vehicle.targets)?.0)
        };
        let grid = |n: i32| (-n..=n).map(move |k| f64::from(k) / f64::from(n));
        let all = grid(8).flat_map(|a| grid(6).map(move |b| [a * REACH_MM[0], b * REACH_MM[1]]));
        let best = all.filter_map(|place| Some((place, with(place)?))).min_by(|a, b| a.1.total_cmp(&b.1));
        let mut row = vec![Cell::text(&vehicle.name), Cell::number(worst, 3)];
        row.push(Cell::text(best.map_or("–".into(), |(p, _)| format!("{:+.0}, {:+.0}", p[0], p[1]))));
        row.push(Cell::number(best.map(|b| b.1), 3));
        for along in [1.0, 0.0, -1.0] {
            row.extend(
                [1.0, -1.0].map(|up| Cell::number(with([0.8 * along * REACH_MM[0], 0.8 * up * REACH_MM[1]]), 3)),
            );
        }
        further.row(row);
        shares.extend(best.map(|b| 100.0 * (1.0 - b.1 / worst)));
        series.push(Series {
            name: vehicle.name.clone(),
            points: grid(16).filter_map(|a| Some((a * REACH_MM[0], with([a * REACH_MM[0], 0.0])?))).collect(),
            joined: true,
        });

        let [believed, real, weighted] = with_midpoints(&points).ok_or_else(too_few)?;
        let of = |c: &Matrix6<f64>| self::worst(c, &at, &vehicle.targets).map(|w| w.0);
        midpoints.row(vec![
            Cell::text(&vehicle.name),
            Cell::number(worst, 3),
            Cell::number(of(&believed), 3),
            Cell::number(of(&real), 3),
            Cell::number(of(&weighted), 3),
        ]);
        progress.step();
    }
    let mean_share = super::statistics::mean(&shares);
    let number = |table: &Table, column: usize| {
        let values: Vec<f64> = table
            .rows
            .iter()
            .filter_map(|r| match r[column] {
                Cell::Number(v, _) => v,
                Cell::Text(_) => None,
            })
            .collect();
        super::statistics::mean(&values)
    };
    let gained = number(&midpoints, 1).zip(number(&midpoints, 4)).map(|(without, with)| 100.0 * (1.0 - with / without));
    Ok(Outcome {
        setting: format!(
            "{setting} From the model alone: noise of {} mm, edges that lie {EDGE_BIAS_MM} mm (1 sigma) beside, a vehicle turned by \
             {TURNED_DEG}°, its paint the taught one, an exact calibration.",
            NOISE_MM.0
        ),
        figures: vec![
            Figure::new("worst target's U (k = 2), mean of the models", number(&table, 8), "mm", 3),
            Figure::new("what one corner more takes off it, at the best place", mean_share, "%", 0),
            Figure::new("what midpoints take off it, with the best weights", gained, "%", 1).published("proposed as features"),
        ],
        tables: vec![table, further, midpoints],
        remarks: vec![
            "A midpoint is computed from two measured points and holds their errors: counted as measured it makes the uncertainty look \
             smaller, and the pose no better."
                .into(),
        ],
        plots: vec![Plot {
            title: "Worst target's U (k = 2) with one corner more, at the height of the features' middle".into(),
            x: "along, mm".into(),
            y: "mm".into(),
            series,
            levels: Vec::new(),
        }],
        pictures: Vec::new(),
    })
}

/// The templates, in the features' order; none of a model that is not taught.
fn templates(vehicle: &VehicleFile) -> Result<Vec<Template>, Error> {
    let taught = vehicle.features.iter().all(|f| f.template.is_some());
    Ok(if taught { vehicle.templates()? } else { Vec::new() })
}

fn simulated(scale: f64, n: usize) -> Vec<(VehicleFile, Vec<Template>)> {
    let setup = Setup::new(scale, 8);
    let features = |body| sim::features(&Scene::new(body, PAINTS[0], &Deviation::default()), &setup);
    sweep::bodies(n).into_iter().filter_map(features).map(|f| (f, Vec::new())).collect()
}

/// How well each feature is expected to be known.
fn points(vehicle: &VehicleFile, templates: &[Template]) -> Vec<Point> {
    let point = |(k, f): (usize, &Feature)| {
        let template = templates.get(k);
        let normal = template.map_or(Vector3::y(), |t| Vector3::from(t.axes[2]));
        let along = template.map_or(Vector3::x(), |t| Vector3::from(t.axes[0]));
        let panel = Matrix3::identity() - normal * normal.transpose();
        let mut covariance = of_corner(normal) + Matrix3::identity() * f.position_sigma_mm.powi(2);
        covariance += match template {
            Some(t) => {
                let axes = Matrix3::from_fn(|i, j| t.axes[j][i]);
                axes * t.covariance() * axes.transpose()
            }
            None => panel * (CLICK_MM_PER_PX * f.pixel_sigma).powi(2),
        };
        if f.kind == Kind::ArchTop {
            covariance += along * along.transpose() * (ARCH_MM * ARCH_TURN_RAD).powi(2);
        }
        Point { at: f.position().xyz, covariance }
    };
    vehicle.features.iter().enumerate().map(point).collect()
}

/// Of a corner whose click does not count.
fn of_corner(normal: Vector3<f64>) -> Matrix3<f64> {
    let across = normal * normal.transpose();
    (Matrix3::identity() - across) * (EDGE_BIAS_MM.powi(2) + NOISE_MM.0.powi(2))
        + across * (NORMAL_BIAS_MM.powi(2) + NOISE_MM.1.powi(2))
}

/// Covariance of the pose, as the station states it, and the point it is of; none where points determine no pose.
fn expected(points: &[Point]) -> Option<(Matrix6<f64>, Vector3<f64>)> {
    let at = middle(points)?;
    let mut normal = Matrix6::zeros();
    for p in points {
        let j = motion_jacobian(&p.at, &at);
        normal += j.transpose() * p.covariance.try_inverse()? * j;
    }
    Some((normal.cholesky()?.inverse() + common(), at))
}

/// What shifts all features together, along the panel.
fn common() -> Matrix6<f64> {
    let shift = PAINT_SHIFT_MM.powi(2) + (LIGHT_SHIFT_MM_PER_DEG * TURNED_DEG).powi(2);
    let mut out = Matrix6::zeros();
    (out[(0, 0)], out[(2, 2)]) = (shift, shift);
    out
}

fn middle(points: &[Point]) -> Option<Vector3<f64>> {
    (points.len() >= 3).then(|| points.iter().map(|p| p.at).sum::<Vector3<f64>>() / points.len() as f64)
}

/// U (k = 2) at the worst target, as the station states it, and which it is.
fn worst<'a>(covariance: &Matrix6<f64>, at: &Vector3<f64>, targets: &'a [Target]) -> Option<(f64, &'a str)> {
    let of = |t: &'a Target| {
        let j = motion_jacobian(&Vector3::from(t.position_mm), at);
        let spread: Matrix3<f64> = j * covariance * j.transpose();
        (2.0 * spread.symmetric_eigenvalues().max().max(0.0).sqrt(), t.name.as_str())
    };
    targets.iter().map(of).max_by(|a, b| a.0.total_cmp(&b.0))
}

/// Covariances of the pose with every midpoint of two points as a point, too: as if midpoints had been measured; what that
/// pose's really is; and that of the best weights, which know that midpoints hold the errors of their points.
fn with_midpoints(points: &[Point]) -> Option<[Matrix6<f64>; 3]> {
    let at = middle(points)?;
    let n = points.len();
    let pairs: Vec<(usize, usize)> = (0..n).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
    let m = n + pairs.len();
    // every point, measured or not, as a mixture of the measured ones
    let mut mixture = DMatrix::zeros(3 * m, 3 * n);
    mixture.fill_with_identity();
    for (k, (a, b)) in pairs.iter().enumerate() {
        for i in 0..3 {
            mixture[(3 * (n + k) + i, 3 * a + i)] = 0.5;
            mixture[(3 * (n + k) + i, 3 * b + i)] = 0.5;
        }
    }
    let mut measured = DMatrix::zeros(3 * n, 3 * n);
    let mut motions = DMatrix::zeros(3 * n, 6);
    for (k, p) in points.iter().enumerate() {
        measured.fixed_view_mut::<3, 3>(3 * k, 3 * k).copy_from(&p.covariance);
        motions.fixed_view_mut::<3, 6>(3 * k, 0).copy_from(&motion_jacobian(&p.at, &at));
    }
    let covariance = &mixture * measured * mixture.transpose();
    let motions = &mixture * motions;
    let mut weights = DMatrix::zeros(3 * m, 3 * m);
    for k in 0..m {
        let own: Matrix3<f64> = covariance.fixed_view::<3, 3>(3 * k, 3 * k).into_owned();
        weights.fixed_view_mut::<3, 3>(3 * k, 3 * k).copy_from(&own.try_inverse()?);
    }
    let six = |m: DMatrix<f64>| Matrix6::from_fn(|i, j| m[(i, j)]);
    let believed = (motions.transpose() * &weights * &motions).try_inverse()?;
    let gain = &believed * motions.transpose() * &weights;
    let real = &gain * &covariance * gain.transpose();
    // Gauss and Markov: all points' covariance has the rank of the measured ones'. Scaled, as rad and mm differ by so much
    let top = covariance.amax();
    let inverse = (covariance / top).pseudo_inverse(1e-9).ok()? / top;
    let best = (motions.transpose() * inverse * &motions).try_inverse()?;
    Some([believed, real, best].map(|c| six(c) + common()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model(n: usize) -> Vec<Point> {
        let (vehicle, templates) = simulated(0.25, n).pop().expect("in view");
        points(&vehicle, &templates)
    }

    #[test]
    fn midpoints_bring_nothing_and_make_believe() {
        for n in [1, 7] {
            let points = model(n);
            let (without, _) = expected(&points).expect("a pose");
            let [believed, real, best] = with_midpoints(&points).expect("a pose");
            for i in 0..6 {
                let of = |c: &Matrix6<f64>| (c - common())[(i, i)].sqrt();
                assert!((of(&best) / of(&without) - 1.0).abs() < 1e-4, "axis {i}: {} for {}", of(&best), of(&without));
                assert!(of(&real) > of(&without) * (1.0 - 1e-9) && of(&believed) < 0.9 * of(&without), "axis {i}");
            }
        }
    }

    #[test]
    fn a_corner_more_helps_most_far_from_the_others() {
        let points = model(1);
        let at = middle(&points).expect("four");
        let yaw = |x: f64| {
            let more = Point { at: at + Vector3::new(x, 0.0, 0.0), covariance: of_corner(Vector3::y()) };
            expected(&points.iter().cloned().chain([more]).collect::<Vec<_>>()).expect("a pose").0[(5, 5)]
        };
        let now = expected(&points).expect("a pose").0[(5, 5)];
        assert!(yaw(300.0) < 0.8 * now && yaw(0.0) > 0.95 * now && yaw(300.0) < yaw(150.0));
        assert!(expected(&points[..2]).is_none(), "two points determine no pose");
    }
}
