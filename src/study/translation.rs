//! The published rail experiment (tables 7, 8): steps of 5 mm to ±50 mm along and across, and up, too. Out: step errors, the
//! error over the range, the rail's direction fitted to what was measured, and the scale along it.

use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::{largest, mean, mean_magnitude, slope};
use super::sweep::{self, Moved, Run};
use super::{Bench, Error, Given, Progress};
use crate::geometry::Point3;
use crate::sim::{Body, Deviation};
use nalgebra::{Matrix3, Vector3};

const STEP_MM: f64 = 5.0;
const STEPS: i32 = 10;
/// The axes: name, what the published tables say of its mean step and of 100 mm.
const AXES: [(&str, Option<(&str, &str)>); 3] =
    [("along", Some(("< 0.6", "≤ 1.901"))), ("across", Some(("< 0.3", "≤ 1.037"))), ("up", None)];

/// One run's figures.
struct Found {
    /// Of each step that was measured at both its ends: how much too long, mm.
    steps: Vec<f64>,
    /// From the first to the last place measured: how far, and how much too long, mm.
    range: Option<(f64, f64)>,
    /// Per cent by which ways along the fitted rail come out too long.
    scale_percent: Option<f64>,
    /// Angle between the fitted rail and the true one, degrees.
    rail_deg: Option<f64>,
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let bench = Bench::new(given.scale, given.seed)?;
    let models = sweep::bodies(given.of(10, 1));
    let measurers = sweep::teach(&bench, &models, |_| Deviation::default(), progress)?;
    let (steps, step) = if given.quick { (2, 25.0) } else { (STEPS, STEP_MM) };
    let mut runs = Vec::new();
    let mut axes = Vec::new();
    for (model, body) in models.iter().enumerate() {
        for axis in 0..AXES.len() {
            let (built, paint) = sweep::vehicle(&bench, model, body, axis);
            let places = (-steps..=steps).map(|s| (step * f64::from(s), shifted(axis, step * f64::from(s)))).collect();
            runs.push(Run { model, body: built, paint, places });
            axes.push(axis);
        }
    }
    let moved = sweep::measure(&bench, &measurers, &runs, progress)?;
    let found: Vec<Found> =
        moved.iter().zip(&axes).zip(&runs).map(|((m, axis), run)| found(m, *axis, &run.body)).collect();

    let (in_view, ok, mut remarks) = sweep::refused(&runs, &moved, "mm");
    let mut table = Table::new(
        "By run",
        &[
            "axis",
            "model",
            "paint",
            "moved mm",
            "mean step error mm",
            "largest mm",
            "over the range mm",
            "scale %",
            "rail off °",
        ],
    );
    for ((run, f), axis) in runs.iter().zip(&found).zip(&axes) {
        table.row(vec![
            Cell::text(AXES[*axis].0),
            Cell::text(&run.body.name),
            Cell::text(run.paint.name),
            Cell::number(f.range.map(|r| r.0), 0),
            Cell::number(mean_magnitude(&f.steps), 4),
            Cell::number(largest(&f.steps), 4),
            Cell::number(f.range.map(|r| r.1), 4),
            Cell::number(f.scale_percent, 4),
            Cell::number(f.rail_deg, 4),
        ]);
    }
    let all: Vec<Vec<f64>> = found.iter().map(|f| f.steps.clone()).collect();
    let mut paints = Table::new("By paint", &["paint", "steps", "mean step error mm", "largest mm"]);
    for (name, steps) in sweep::by_paint(&runs, &all) {
        let cells = [mean_magnitude(&steps), largest(&steps)].map(|v| Cell::number(v, 4));
        paints.row([Cell::text(name), Cell::count(steps.len())].into_iter().chain(cells).collect());
    }
    let mut figures = Vec::new();
    for (axis, (name, published)) in AXES.iter().enumerate() {
        let of = |value: &dyn Fn(&Found) -> Vec<f64>| -> Vec<f64> {
            found.iter().zip(&axes).filter(|(_, a)| **a == axis).flat_map(|(f, _)| value(f)).collect()
        };
        let steps = mean_magnitude(&of(&|f| f.steps.clone()));
        let range = largest(&of(&|f| f.range.map(|r| r.1).into_iter().collect()));
        let with = |figure: Figure, text: Option<&str>| match text {
            Some(text) => figure.published(text),
            None => figure,
        };
        let mean_step = Figure::new(format!("{name}: mean step error"), steps, "mm", 4).must(Must::AtMost(0.03));
        let over = Figure::new(format!("{name}: largest error over 100 mm"), range, "mm", 4).must(Must::AtMost(0.08));
        figures.push(with(mean_step, published.map(|p| p.0)));
        figures.push(with(over, published.map(|p| p.1)));
        let scale = of(&|f| f.scale_percent.into_iter().collect());
        figures.push(Figure::new(format!("{name}: scale, mean"), mean(&scale), "%", 4));
        figures.push(Figure::new(
            format!("{name}: rail's direction off, largest"),
            largest(&of(&|f| f.rail_deg.into_iter().collect())),
            "°",
            4,
        ));
    }
    figures.push(Figure::new("measured, of those in view", 100.0 * ok as f64 / in_view.max(1) as f64, "%", 1));
    for (axis, (name, _)) in AXES.iter().enumerate() {
        let of = runs.iter().zip(&found).zip(&axes).filter(|(_, a)| **a == axis);
        let worst =
            of.filter_map(|((run, f), _)| Some((run, f.range?.1))).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
        if let Some((run, off)) = worst {
            let (paint, model) = (run.paint.name, &run.body.name);
            remarks.push(format!("The largest error over the range {name}, {off:+.4} mm, is that of {paint} {model}."));
        }
    }
    let plots = AXES.iter().enumerate().map(|(axis, (name, _))| Plot {
        title: format!("Error of the position over the way {name}"),
        x: "moved, mm".into(),
        y: "error along the way, mm".into(),
        series: curves(&runs, &moved, &axes, axis),
        levels: vec![-0.08, 0.08],
    });
    Ok(Outcome {
        setting: format!(
            "{} The vehicle moves by {step} mm a step from {} to {} mm along its x (along), y (across, which is depth) and z (up), \
             750 mm from the camera; {in_view} places with all features in view.",
            sweep::setting(given, models.len(), runs.len()),
            -step * f64::from(steps),
            step * f64::from(steps)
        ),
        figures,
        tables: vec![table, paints],
        remarks,
        plots: plots.collect(),
        pictures: vec![sweep::picture(&bench, &measurers, &runs[0])?],
    })
}

fn shifted(axis: usize, mm: f64) -> Deviation {
    match axis {
        0 => Deviation { along_mm: mm, ..Deviation::default() },
        1 => Deviation { across_mm: mm, ..Deviation::default() },
        _ => Deviation { up_mm: mm, ..Deviation::default() },
    }
}

/// Error along the axis of the way, vehicle axes, at each place that was measured.
fn curves(runs: &[Run], moved: &[Vec<Moved>], axes: &[usize], axis: usize) -> Vec<Series> {
    let of = runs.iter().zip(moved).zip(axes).filter(|(_, a)| **a == axis);
    of.map(|((run, moved), _)| Series {
        name: format!("{} {}", run.paint.name, run.body.name),
        points: moved.iter().filter_map(|m| Some((m.at, m.measured.as_ref()?.error()?[axis]))).collect(),
        joined: true,
    })
    .collect()
}

fn found(moved: &[Moved], axis: usize, body: &Body) -> Found {
    // the features' centroid in the camera's frame, which no step turns
    let at = Point3::new(
        body.features().iter().map(|f| Vector3::from(f.at)).sum::<Vector3<f64>>() / body.features().len() as f64,
    );
    let steps = sweep::steps(moved).filter_map(|(_, a, _, b)| {
        Some((b.pose()? * at - a.pose()? * at).norm() - (b.truth * at - a.truth * at).norm())
    });
    let range = || {
        let (first, a, last, b) = sweep::ends(moved)?;
        Some((last.at - first.at, (b.pose()? * at - a.pose()? * at).norm() - (b.truth * at - a.truth * at).norm()))
    };
    let measured: Vec<(f64, Vector3<f64>)> = moved
        .iter()
        .filter_map(|m| {
            let measured = m.measured.as_ref()?;
            Some((m.at, (measured.pose()? * at).xyz))
        })
        .collect();
    let rail = rail(&measured);
    let truth = moved.iter().find_map(|m| Some(m.measured.as_ref()?.truth.r * Vector3::ith(axis, 1.0)));
    let along: Vec<(f64, f64)> = rail.iter().flat_map(|r| measured.iter().map(|(at, p)| (*at, r.dot(p)))).collect();
    Found {
        steps: steps.collect(),
        range: range(),
        scale_percent: slope(&along).map(|s| 100.0 * (s - 1.0)),
        rail_deg: rail.zip(truth).map(|(r, t)| r.cross(&t).norm().asin().to_degrees()),
    }
}

/// Direction of the straight line that lies nearest to the points, the way they go; none of fewer than two.
fn rail(points: &[(f64, Vector3<f64>)]) -> Option<Vector3<f64>> {
    let (first, last) = (points.first()?.1, points.last()?.1);
    let middle = points.iter().map(|p| p.1).sum::<Vector3<f64>>() / points.len() as f64;
    let scatter: Matrix3<f64> = points.iter().map(|p| (p.1 - middle) * (p.1 - middle).transpose()).sum();
    let eigen = scatter.symmetric_eigen();
    let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
    let way = direction.dot(&(last - first));
    (way != 0.0).then(|| direction * way.signum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rail_is_fitted_the_way_it_goes() {
        let direction = Vector3::new(0.6, -0.8, 0.0);
        let points: Vec<_> = (0..5)
            .map(|k| (f64::from(k), direction * f64::from(k) + Vector3::new(1.0, 2.0, 0.01 * f64::from(k % 2))))
            .collect();
        assert!((rail(&points).expect("a line") - direction).norm() < 5e-3);
        assert!(rail(&points[..1]).is_none());
    }
}
