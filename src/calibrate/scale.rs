//! How well a calibration knows lengths. In: a calibration with its covariance. Out: the standard deviation of scale. It
//! comes from the board alone: nothing else in a calibration has a length.

use super::file::Calibration;
use super::propagate::Sensitivity;
use crate::fringe::Axis;
use crate::geometry::Point3;
use crate::optics::Pixel;
use nalgebra::{RowSVector, Vector3};

/// Points of the plane that is measured, columns and rows, over the middle half of the field.
const GRID: (usize, usize) = (5, 4);

/// Standard deviation, as a share, of lengths measured on a plane across the middle of the field at `distance_mm`. `None`
/// without a covariance, or where the two lenses do not look there.
pub fn scale_sigma(calibration: &Calibration, distance_mm: f64) -> Option<f64> {
    let covariance = calibration.covariance.as_ref()?;
    let camera = &calibration.rig.camera;
    let share = |k: usize, n: usize| 0.25 + 0.5 * k as f64 / (n - 1) as f64;
    let at = |i: usize, j: usize| {
        Pixel::new(share(i, GRID.0) * camera.width as f64, share(j, GRID.1) * camera.height as f64)
    };
    let points: Option<Vec<Vector3<f64>>> =
        (0..GRID.0 * GRID.1).map(|k| Some(camera.ray(&at(k % GRID.0, k / GRID.0))? * distance_mm)).collect();
    let points = points?;
    let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
    let (mut gradient, mut square) = (RowSVector::<f64, 24>::zeros(), 0.0);
    for p in &points {
        let arm = p - middle;
        gradient += arm.transpose() * Sensitivity::new(&calibration.rig, Axis::Column, &Point3::new(*p))?.point;
        square += arm.norm_squared();
    }
    let gradient = gradient / square;
    Some((gradient * **covariance * gradient.transpose())[0].max(0.0).sqrt())
}
