//! The published turntable experiment (table 6): steps of 2.5° to ±12.5°, three runs, the camera turning about its own
//! vertical axis, 800 mm before the vehicle. Over the range in view. Out: step errors, the error over the range.

use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::{largest, mean_magnitude};
use super::sweep::{self, Moved, Run};
use super::{Bench, Error, Given, Progress};
use crate::geometry::{Pose, frame};
use crate::sim::{Body, Deviation, camera_from_vehicle};
use nalgebra::{Rotation3, Unit, Vector3};

/// The vehicle is so much farther away than it should stand, mm.
const FARTHER_MM: f64 = 50.0;
const STEP_DEG: f64 = 2.5;
const STEPS: i32 = 5;

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    let measurers = sweep::teach(&bench, &models, |body| turned(body, 0.0), progress)?;
    let mut runs = Vec::new();
    for (model, body) in models.iter().enumerate() {
        for k in 0..given.of(3, 1) {
            let (built, paint) = sweep::vehicle(&bench, model, body, k);
            let angles: Vec<f64> = (-STEPS..=STEPS).map(|s| STEP_DEG * f64::from(s)).collect();
            let angles = if given.quick { angles[3..8].to_vec() } else { angles };
            let places = angles.into_iter().map(|deg| (deg, turned(body, deg))).collect();
            runs.push(Run { model, body: built, paint, places });
        }
    }
    let moved = sweep::measure(&bench, &measurers, &runs, progress)?;

    let of_steps: Vec<Vec<f64>> = moved.iter().map(|m| steps_off(m)).collect();
    let of_ranges: Vec<Option<(f64, f64)>> = moved.iter().map(|m| range_off(m)).collect();
    let (in_view, ok, mut remarks) = sweep::refused(&runs, &moved, "°");
    let mut table = Table::new(
        "By run",
        &["model", "paint", "turned °", "steps", "mean step error °", "largest °", "error over the range °"],
    );
    for ((run, steps), range) in runs.iter().zip(&of_steps).zip(&of_ranges) {
        table.row(vec![
            Cell::text(&run.body.name),
            Cell::text(run.paint.name),
            Cell::number(range.map(|r| r.0), 1),
            Cell::count(steps.len()),
            Cell::number(mean_magnitude(steps), 4),
            Cell::number(largest(steps), 4),
            Cell::number(range.map(|r| r.1), 4),
        ]);
    }
    let mut paints = Table::new("By paint", &["paint", "steps", "mean step error °", "largest °"]);
    for (name, steps) in sweep::by_paint(&runs, &of_steps) {
        let cells = [mean_magnitude(&steps), largest(&steps)].map(|v| Cell::number(v, 4));
        paints.row([Cell::text(name), Cell::count(steps.len())].into_iter().chain(cells).collect());
    }
    let all: Vec<f64> = of_steps.concat();
    let ranges: Vec<f64> = of_ranges.iter().flatten().map(|r| r.1).collect();
    if let Some(missed) = worst(&runs, &of_ranges) {
        remarks.push(missed);
    }
    let curve = |(run, moved): (&Run, &Vec<Moved>)| Series {
        name: format!("{} {}", run.paint.name, run.body.name),
        points: moved.iter().filter_map(|m| Some((m.at, m.measured.as_ref()?.error()?[5].to_degrees()))).collect(),
        joined: true,
    };
    Ok(Outcome {
        setting: format!(
            "{} The camera turns about its vertical axis, {} mm before the features, by {STEP_DEG}° a step; {in_view} places with all \
             features in view.",
            sweep::setting(given, models.len(), runs.len()),
            crate::sim::DISTANCE_MM + FARTHER_MM
        ),
        figures: vec![
            Figure::new("mean step error", mean_magnitude(&all), "°", 4).published("< 0.12").must(Must::AtMost(0.01)),
            Figure::new("largest step error", largest(&all), "°", 4),
            Figure::new("largest error over the range", largest(&ranges), "°", 4)
                .published("≤ 0.3 over 25°")
                .must(Must::AtMost(0.03)),
            Figure::new("measured, of those in view", 100.0 * ok as f64 / in_view.max(1) as f64, "%", 1),
        ],
        tables: vec![table, paints],
        remarks,
        plots: vec![Plot {
            title: "Error in yaw over the turn".into(),
            x: "turned, °".into(),
            y: "error, °".into(),
            series: runs.iter().zip(&moved).map(curve).collect(),
            levels: vec![-0.03, 0.03],
        }],
        pictures: vec![sweep::picture(&bench, &measurers, &runs[0])?],
    })
}

/// How a vehicle of `body` stands when the camera is turned by so much to the other side.
fn turned(body: &Body, deg: f64) -> Deviation {
    let stands = Deviation { across_mm: -FARTHER_MM, ..Deviation::default() };
    let straight = camera_from_vehicle(body, &stands);
    let up = Unit::new_normalize(straight.r * Vector3::z());
    let turn = Rotation3::from_axis_angle(&up, deg.to_radians());
    let pose = Pose::<frame::Camera, frame::Camera>::new(turn, Vector3::zeros()) * straight;
    Deviation::of(body, &pose)
}

/// Of each step that was measured at both its ends: measured less true turn, degrees.
fn steps_off(moved: &[Moved]) -> Vec<f64> {
    sweep::steps(moved)
        .filter_map(|(_, a, _, b)| {
            let measured = sweep::between(&a.pose()?, &b.pose()?).r.angle();
            Some((measured - sweep::between(&a.truth, &b.truth).r.angle()).to_degrees())
        })
        .collect()
}

/// How far it was turned from the first to the last place measured, and the error of that, degrees.
fn range_off(moved: &[Moved]) -> Option<(f64, f64)> {
    let (first, a, last, b) = sweep::ends(moved)?;
    let measured = sweep::between(&a.pose()?, &b.pose()?).r.angle();
    Some((last.at - first.at, (measured - sweep::between(&a.truth, &b.truth).r.angle()).to_degrees()))
}

fn worst(runs: &[Run], ranges: &[Option<(f64, f64)>]) -> Option<String> {
    let known = runs.iter().zip(ranges).filter_map(|(run, r)| Some((run, (*r)?)));
    let (run, (_, off)) = known.max_by(|a, b| a.1.1.abs().total_cmp(&b.1.1.abs()))?;
    Some(format!("The largest error over the range, {off:+.4}°, is that of {} {}.", run.paint.name, run.body.name))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Point3;

    #[test]
    fn the_camera_turns_about_itself_and_the_vehicle_keeps_its_height() {
        let body = Body::named("suv-a").expect("listed");
        let at = |deg| camera_from_vehicle(&body, &turned(&body, deg));
        let (a, b) = (at(-5.0), at(7.5));
        let turn = sweep::between(&a, &b).r;
        assert!((turn.angle().to_degrees() - 12.5).abs() < 1e-9);
        assert!(turn.scaled_axis().xy().norm() < 1e-9, "about the vehicle's vertical axis: {turn}");
        let cap = Point3::new(Vector3::from(body.features()[2].at));
        assert!(((a * cap).xyz.norm() - (b * cap).xyz.norm()).abs() < 1e-9, "as far from the lens");
        let (d, e) = (turned(&body, 0.0), turned(&body, 12.5));
        assert!((d.across_mm + FARTHER_MM).abs() < 1e-6 && d.yaw_deg.abs() < 1e-9, "{d:?}");
        assert!(e.along_mm.abs() > 150.0 && (e.up_mm - d.up_mm).abs() < 10.0, "{e:?}");
    }
}
