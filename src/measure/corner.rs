//! What a corner's point is, other than where it was clicked: where its two edges meet, or the tip of its rounding.
//! In: a template made about the click. Out: the same about the redefined point. Only teaching needs it.

use crate::vehicle::{ContourPoint, Definition, Template};
use nalgebra::{Matrix3, Vector2, Vector3};

/// Edges nearer to the click than this may belong to the rounding, mm.
const ROUNDING_MM: f64 = 10.0;
/// What is not known of a point that visible edges define, 1 sigma along the panel, mm: they lie some tenths inside
/// the drawing's sharp edges, by how the hem is rolled.
const HEM_SIGMA_MM: f64 = 0.3;
/// Normals of one edge agree within this, rad.
const SAME_EDGE: f64 = 0.45;

/// A smooth edge: points along `along`, as a parabola in its own frame.
struct Branch {
    origin: Vector2<f64>,
    along: Vector2<f64>,
    across: Vector2<f64>,
    parabola: Vector3<f64>,
    sigma_mm: f64,
    n: usize,
}

impl Branch {
    fn fit(points: &[&ContourPoint]) -> Option<Self> {
        let n = points.len() as f64;
        let origin = points.iter().map(|p| p.at()).sum::<Vector2<f64>>() / n;
        let across = points.iter().map(|p| p.normal()).sum::<Vector2<f64>>().normalize();
        let along = Vector2::new(-across.y, across.x);
        let (mut a, mut b) = (Matrix3::zeros(), Vector3::zeros());
        let coordinates = |p: &ContourPoint| (along.dot(&(p.at() - origin)), across.dot(&(p.at() - origin)));
        for p in points {
            let (s, h) = coordinates(p);
            let row = Vector3::new(1.0, s, s * s);
            a += row * row.transpose();
            b += row * h;
        }
        let parabola = a.cholesky()?.solve(&b);
        let off = |p: &ContourPoint| {
            let (s, h) = coordinates(p);
            h - parabola.dot(&Vector3::new(1.0, s, s * s))
        };
        let sigma_mm = crate::geometry::robust::mad_sigma(points.iter().map(|p| off(p)));
        Some(Self { origin, along, across, parabola, sigma_mm, n: points.len() })
    }

    /// Distance of `p` across the branch, mm, and its gradient.
    fn distance(&self, p: &Vector2<f64>) -> (f64, Vector2<f64>) {
        let (s, h) = (self.along.dot(&(p - self.origin)), self.across.dot(&(p - self.origin)));
        let slope = self.parabola.y + 2.0 * self.parabola.z * s;
        (h - self.parabola.dot(&Vector3::new(1.0, s, s * s)), self.across - slope * self.along)
    }
}

/// Moves the template's taught point to the one that `definition` means. Errors say what is missing.
pub(super) fn redefine(template: &mut Template, definition: Definition) -> Result<(), String> {
    let far: Vec<&ContourPoint> = template.contour.iter().filter(|p| p.at().norm() > ROUNDING_MM).collect();
    // the two directions that most normals have
    let votes =
        |d: &Vector2<f64>, of: &[&ContourPoint]| of.iter().filter(|p| p.normal().dot(d) > SAME_EDGE.cos()).count();
    let fullest = |of: &[&ContourPoint]| of.iter().map(|p| p.normal()).max_by_key(|d| votes(d, of));
    let first = fullest(&far).ok_or("no edges beyond the rounding")?;
    let rest: Vec<&ContourPoint> =
        far.iter().copied().filter(|p| p.normal().dot(&first) < (2.0 * SAME_EDGE).cos()).collect();
    let second = fullest(&rest).ok_or("only one straight edge near the click, two are needed")?;
    let members =
        |d: Vector2<f64>| far.iter().copied().filter(move |p| p.normal().dot(&d) > SAME_EDGE.cos()).collect::<Vec<_>>();
    let (first, second) = (members(first), members(second));
    if first.len() < 10 || second.len() < 10 {
        return Err(format!("edges of {} and {} points near the click, 10 each are needed", first.len(), second.len()));
    }
    let branches =
        [Branch::fit(&first), Branch::fit(&second)].map(|b| b.ok_or("an edge near the click fixes no curve"));
    let [Ok(a), Ok(b)] = branches else { return Err("an edge near the click fixes no curve".into()) };
    let mut p = Vector2::zeros();
    for _ in 0..20 {
        let ((da, ga), (db, gb)) = (a.distance(&p), b.distance(&p));
        let j = nalgebra::Matrix2::new(ga.x, ga.y, gb.x, gb.y);
        let step = j.try_inverse().ok_or("the two edges do not meet")? * Vector2::new(da, db);
        p -= step;
        if step.norm() < 1e-9 {
            break;
        }
    }
    if p.norm().is_nan() || p.norm() > 2.0 * ROUNDING_MM {
        return Err(format!("the two edges meet {:.1} mm from the click, allowed {}", p.norm(), 2.0 * ROUNDING_MM));
    }
    let sigma = a.sigma_mm / (a.n as f64).sqrt() + b.sigma_mm / (b.n as f64).sqrt();
    if definition == Definition::Apex {
        let near = template.contour.iter().min_by(|x, y| (x.at() - p).norm().total_cmp(&(y.at() - p).norm()));
        p = near.ok_or("no edges near the corner")?.at();
    }
    let surface = template.surface.polynomial().ok_or("the panel has no surface there")?;
    let variance = sigma * sigma + HEM_SIGMA_MM.powi(2);
    template.at_mm = [p.x, p.y, surface.height(&p)];
    template.covariance_mm2 = [[variance, 0.0], [0.0, variance]];
    Ok(())
}
