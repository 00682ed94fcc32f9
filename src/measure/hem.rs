//! How much paint and light have changed the edges of rolled hems since teaching, told by one that is seen all around.
//! In: the distances of a closed contour from the taught one, with their normals. Out: by how much it has grown. Not here:
//! which contour; what is done with it.
//!
//! A hem's brightness falls from the panel into the gap, sooner with one paint than with another, and so moves the edge
//! that is seen, by up to 0.15 mm between white and metallic paint. An opening only grows or shrinks by that. Other edges
//! move by about as much, but not by the same: subtracted, it made metallic paint three times better and black paint four
//! times worse, as a flap's narrow gap is lit otherwise than an arch. So it is what the edges are uncertain by.

use nalgebra::{Matrix3, Vector2, Vector3};

/// Directions are told apart by so many points at least.
const MIN_POINTS: usize = 60;
/// An opening that grew by more is another one, mm; other checks find that.
const MAX_MM: f64 = 0.6;

/// How far the edges of an opening lie from the taught ones, mm: all around, and in the direction in which most. From
/// distances (mm, along the normals, towards bright) of points all around; 0 of too few.
pub(super) fn growth_mm(points: impl Iterator<Item = (f64, Vector2<f64>)>) -> f64 {
    let (mut n, mut a, mut b) = (0usize, Matrix3::<f64>::identity() * 1e-9, Vector3::zeros());
    for (distance, normal) in points {
        let row = Vector3::new(1.0, normal.x * normal.x - normal.y * normal.y, 2.0 * normal.x * normal.y);
        a += row * row.transpose();
        b += row * distance;
        n += 1;
    }
    let fit = a.cholesky().map(|a| a.solve(&b)).filter(|_| n >= MIN_POINTS).unwrap_or_default();
    (fit.x.abs() + fit.yz().norm()).min(MAX_MM)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_an_opening_has_grown_by_does_not_depend_on_where_it_is() {
        let points = (0..90).map(|k| {
            let turn = f64::from(k) * std::f64::consts::TAU / 90.0;
            let normal = Vector2::new(turn.cos(), turn.sin());
            (0.05 - 0.03 * (2.0 * turn).cos() + Vector2::new(0.2, -0.1).dot(&normal), normal)
        });
        let growth = growth_mm(points);
        assert!((growth - 0.08).abs() < 1e-9, "{growth}");
    }
}
