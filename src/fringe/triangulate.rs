//! Where a camera ray meets the plane of light of a projector column or row.
//! In: rays, projector coordinates, the rig. Out: points in camera coordinates, mm, with the variance of depth.

use super::{Axis, CoordinateMap, State};
use crate::geometry::{Point3, frame};
use crate::image::Window;
use crate::lent::List;
use crate::{Lens, Pixel, Rig};
use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

/// Depth along `ray` (camera coordinates, z = 1) at which it is lit by projector coordinate `at` (px, raw) along
/// `axis`: Z in mm and ∂Z/∂at in mm/px. The rig is taken as exact: σ_Z = |∂Z/∂at|·σ_at. `None` where the two do not
/// meet in front of both lenses. With an undistorted projector the closed form
/// Z = (x̂·T_z − T_x)/(r₁·d − x̂·r₃·d); Newton's method from there otherwise, to 1e-9 mm.
pub fn triangulate(rig: &Rig, ray: &Vector3<f64>, axis: Axis, at: f64) -> Option<(f64, f64)> {
    let (q, t) = (rig.projector_from_camera.r * ray, rig.projector_from_camera.t);
    let (lens, k) = (&rig.projector, index(axis));
    let (focal, centre) = if axis == Axis::Column { (lens.fx, lens.cx) } else { (lens.fy, lens.cy) };
    let target = (at - centre) / focal;
    let mut z = (target * t.z - t[k]) / (q[k] - target * q.z);
    for _ in 0..20 {
        let p = q * z + t;
        if !(z > 0.0 && p.z > 0.0) {
            return None;
        }
        let n = Vector2::new(p.x / p.z, p.y / p.z);
        let slope = Vector2::new(q.x - n.x * q.z, q.y - n.y * q.z) / p.z; // ∂n/∂Z
        let (d, j) = lens.distort(&n);
        let slope = (j * slope)[k];
        let step = (target - d[k]) / slope;
        z += step;
        if step.abs() < 1e-9 {
            return Some((z, 1.0 / (slope * focal)));
        }
    }
    None
}

/// The projector coordinate (px, raw) along `axis` that lights `point`; `None` at or behind the projector. It may
/// lie outside the projector's image.
pub fn projector_coordinate(rig: &Rig, axis: Axis, point: &Point3<frame::Camera>) -> Option<f64> {
    let p = rig.projector_from_camera * *point;
    rig.projector.project(&p.xyz).map(|pixel| pixel[index(axis)])
}

/// Measured minus expected projector row, px, of `ray` lit at `column` and `row`: what is left of the epipolar
/// constraint once the column has given the depth. `None` where ray and column do not meet.
pub fn epipolar_residual(rig: &Rig, ray: &Vector3<f64>, column: f64, row: f64) -> Option<f64> {
    let (z, _) = triangulate(rig, ray, Axis::Column, column)?;
    projector_coordinate(rig, Axis::Row, &Point3::new(ray * z)).map(|expected| row - expected)
}

fn index(axis: Axis) -> usize {
    match axis {
        Axis::Column => 0,
        Axis::Row => 1,
    }
}

/// The camera's rays through every pixel of one window, found once per calibration and window.
#[derive(Clone, Debug)]
pub struct Rays {
    /// Where in the image.
    pub window: Window,
    /// Undistorted normalised coordinates, row by row; NaN where the lens has no inverse.
    normalised: List<Vector2<f64>>,
}

impl Rays {
    /// The rays of `lens` through the pixels of `window`.
    pub fn new(lens: &Lens, window: Window) -> Self {
        let mut normalised = List::filled(Vector2::repeat(f64::NAN), window.width * window.height);
        normalised.par_chunks_mut(window.width.max(1)).enumerate().for_each(|(y, row)| {
            let pixel = |x| Pixel::new((window.x + x) as f64, (window.y + y) as f64);
            for x in 0..row.len() {
                // The two neighbours' course, a little off by curvature alone, is where Newton starts.
                let known = if x >= 2 { 2.0 * row[x - 1] - row[x - 2] } else { Vector2::repeat(f64::NAN) };
                let found = if known.x.is_finite() {
                    lens.undistort_near(&pixel(x), &known)
                } else {
                    lens.undistort(&pixel(x))
                };
                row[x] = found.unwrap_or(Vector2::repeat(f64::NAN));
            }
        });
        Self { window, normalised }
    }

    /// The ray through image pixel (x, y), z = 1. Panics outside the window.
    pub fn at(&self, x: usize, y: usize) -> Vector3<f64> {
        self.ray(position(&self.window, x, y).expect("inside the window"))
    }

    /// The rays of pixels `range` of the window, row by row: (x, y) at z = 1.
    pub fn part(&self, range: std::ops::Range<usize>) -> &[Vector2<f64>] {
        &self.normalised[range]
    }

    fn ray(&self, i: usize) -> Vector3<f64> {
        self.normalised[i].push(1.0)
    }
}

fn position(window: &Window, x: usize, y: usize) -> Option<usize> {
    let (column, row) = (x.checked_sub(window.x)?, y.checked_sub(window.y)?);
    (column < window.width && row < window.height).then_some(row * window.width + column)
}

/// One pixel's depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Depth {
    /// Camera z of the surface along the pixel's ray, mm; NaN unless valid.
    pub z: f32,
    /// Its standard deviation from noise alone, mm; NaN unless valid.
    pub sigma: f32,
    /// Mean level of the finest set, DN.
    pub level: f32,
    /// Modulation of the finest set, DN.
    pub modulation: f32,
    /// A step of the finest set was saturated.
    pub saturated: bool,
    /// What the depth is worth.
    pub state: State,
}

/// The depths of one window, row by row, with their rays.
#[derive(Clone, Debug)]
pub struct DepthMap<'a> {
    /// Where each pixel looks.
    pub rays: &'a Rays,
    /// `window.width * window.height` depths.
    pub pixels: List<Depth>,
}

impl<'a> DepthMap<'a> {
    /// Triangulates every valid coordinate. Panics if `rays` and `coordinates` are of different windows.
    pub fn new(rig: &Rig, rays: &'a Rays, coordinates: &CoordinateMap) -> Self {
        assert_eq!(rays.window, coordinates.window, "rays and coordinates of different windows");
        let axis = coordinates.axis;
        let depth = |(i, c): (usize, &super::Coordinate)| {
            let invalid = Depth {
                z: f32::NAN,
                sigma: f32::NAN,
                level: c.level,
                modulation: c.modulation,
                saturated: c.saturated,
                state: c.state,
            };
            if c.state != State::Valid {
                return invalid;
            }
            match triangulate(rig, &rays.ray(i), axis, c.value) {
                Some((z, slope)) => Depth { z: z as f32, sigma: slope.abs() as f32 * c.variance.sqrt(), ..invalid },
                None => Depth { state: State::NoDepth, ..invalid },
            }
        };
        let depths = coordinates.pixels.par_iter().enumerate().with_min_len(1024).map(depth);
        Self { rays, pixels: List::of_parallel(depths) }
    }

    /// The depth at image pixel (x, y); `None` outside the window.
    pub fn at(&self, x: usize, y: usize) -> Option<&Depth> {
        position(&self.rays.window, x, y).map(|i| &self.pixels[i])
    }

    /// The surface point seen at image pixel (x, y), mm; `None` outside the window or where depth is invalid.
    pub fn point(&self, x: usize, y: usize) -> Option<Point3<frame::Camera>> {
        let depth = self.at(x, y).filter(|d| d.state == State::Valid)?;
        Some(Point3::new(self.rays.at(x, y) * f64::from(depth.z)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::Random;
    use super::*;
    use crate::Pose;
    use crate::fringe::Coordinate;
    use nalgebra::Rotation3;

    fn rig(projector_distortion: [f64; 5]) -> Rig {
        let lens = |width, height, f: f64, cx, cy, distortion| Lens {
            width,
            height,
            fx: f,
            fy: 1.001 * f,
            cx,
            cy,
            distortion,
        };
        Rig {
            camera: lens(1296, 972, 1351.8, 651.45, 481.1, [-0.0853, 0.1042, 0.00043, -0.00031, -0.0215]),
            projector: lens(1280, 800, 1052.0, 633.7, 791.4, projector_distortion),
            // Beside and above the camera, so that both axes tell depth.
            projector_from_camera: Pose::new(
                Rotation3::from_euler_angles(0.12, -0.28, 0.02),
                Vector3::new(213.0, 95.0, 78.0),
            ),
        }
    }

    #[test]
    fn triangulation_undoes_projection_with_and_without_projector_distortion_on_both_axes() {
        for distortion in [[0.0; 5], [-0.12, 0.08, 0.002, -0.003, 0.01]] {
            let rig = rig(distortion);
            arbtest::arbtest(|u| {
                let mut between = |lo: f64, hi: f64| Ok(lo + (hi - lo) * f64::from(u.arbitrary::<u16>()?) / 65535.0);
                let point =
                    Point3::new(Vector3::new(between(-250.0, 250.0)?, between(-180.0, 180.0)?, between(600.0, 900.0)?));
                let pixel = rig.camera.project(&point.xyz).expect("in front");
                let ray = rig.camera.ray(&pixel).expect("inside the image");
                for axis in [Axis::Column, Axis::Row] {
                    let at = projector_coordinate(&rig, axis, &point).expect("in front");
                    let (z, slope) = triangulate(&rig, &ray, axis, at).expect("it was projected from there");
                    assert!((ray * z - point.xyz).norm() < 1e-6, "{axis:?} {point:?} {z}");
                    let (further, _) = triangulate(&rig, &ray, axis, at + 1e-3).expect("nearby");
                    let (nearer, _) = triangulate(&rig, &ray, axis, at - 1e-3).expect("nearby");
                    assert!(((further - nearer) / 2e-3 / slope - 1.0).abs() < 1e-5, "{axis:?} {point:?} {slope}");
                }
                let [column, row] =
                    [Axis::Column, Axis::Row].map(|a| projector_coordinate(&rig, a, &point).expect("in front"));
                let off = epipolar_residual(&rig, &ray, column, row + 0.25).expect("it meets");
                assert!((off - 0.25).abs() < 1e-6, "{off}");
                Ok(())
            });
        }
    }

    #[test]
    fn the_closed_form_of_the_undistorted_projector_is_the_answer() {
        let rig = rig([0.0; 5]);
        let d = Vector3::new(0.1, -0.2, 1.0);
        let (r, t) = (rig.projector_from_camera.r.matrix(), rig.projector_from_camera.t);
        let x = (700.0 - rig.projector.cx) / rig.projector.fx;
        let (r1, r3) = (r.row(0).transpose().dot(&d), r.row(2).transpose().dot(&d));
        let (a, b) = (x * t.z - t.x, r1 - x * r3);
        let (z, slope) = triangulate(&rig, &d, Axis::Column, 700.0).expect("it meets");
        assert!((z - a / b).abs() < 1e-9);
        assert!((slope * rig.projector.fx / ((t.z * b + a * r3) / (b * b)) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn what_lies_behind_or_never_meets_has_no_depth() {
        let rig = rig([0.0; 5]);
        let ray = Vector3::new(0.0, 0.0, 1.0);
        let far = projector_coordinate(&rig, Axis::Column, &Point3::new(ray * 1e9)).expect("in front");
        let near = projector_coordinate(&rig, Axis::Column, &Point3::new(ray * 700.0)).expect("in front");
        let beyond = far + (far - near).signum() * 20.0;
        assert!(triangulate(&rig, &ray, Axis::Column, near).is_some());
        assert_eq!(triangulate(&rig, &ray, Axis::Column, beyond), None);
        let mut ahead = rig.clone(); // the projector stands beyond the surface and looks away from it
        ahead.projector_from_camera.t.z = -900.0;
        let p = ahead.projector_from_camera * Point3::new(ray * 700.0);
        let mirrored = ahead.projector.fx * p.xyz.x / p.xyz.z + ahead.projector.cx;
        assert_eq!(triangulate(&ahead, &ray, Axis::Column, mirrored), None);
        assert_eq!(triangulate(&rig, &ray, Axis::Column, f64::NAN), None);
        assert_eq!(triangulate(&rig, &Vector3::repeat(f64::NAN), Axis::Column, near), None);
    }

    #[test]
    fn stated_depth_sigma_is_what_noise_on_the_coordinate_makes() {
        let rig = rig([-0.05, 0.02, 0.0, 0.0, 0.0]);
        let window = Window { x: 900, y: 200, width: 100, height: 100 };
        let rays = Rays::new(&rig.camera, window);
        let mut random = Random(21);
        let pixels = (0..10_000).map(|i| {
            let point = Point3::new(rays.ray(i) * 750.0);
            let at = projector_coordinate(&rig, Axis::Column, &point).expect("in front");
            Coordinate {
                value: at + 0.08 * random.normal(),
                variance: 0.0064,
                level: 80.0,
                modulation: 60.0,
                saturated: false,
                state: State::Valid,
            }
        });
        let (axis, pixels) = (Axis::Column, List::of(pixels));
        let coordinates = CoordinateMap { axis, pitch: 20.0, window, pixels, extent: 1280 };
        let map = DepthMap::new(&rig, &rays, &coordinates);
        let square = |d: &Depth| ((f64::from(d.z) - 750.0) / f64::from(d.sigma)).powi(2);
        let ratio = (map.pixels.iter().map(square).sum::<f64>() / 1e4).sqrt();
        assert!((ratio - 1.0).abs() < 0.05, "{ratio} of the stated sigma"); // 0.7 % by chance
        let point = map.point(950, 250).expect("valid");
        assert!((rig.camera.project(&point.xyz).expect("in front") - Pixel::new(950.0, 250.0)).norm() < 1e-3);
        assert!(map.point(899, 250).is_none() && map.point(950, 300).is_none());
    }

    #[test]
    fn rays_of_a_window_are_the_lens_s() {
        let rig = rig([0.0; 5]);
        let rays = Rays::new(&rig.camera, Window { x: 5, y: 700, width: 1200, height: 3 });
        for x in (5..1205).step_by(7) {
            let one = rig.camera.ray(&Pixel::new(x as f64, 701.0)).expect("inside the image");
            assert!((rays.at(x, 701) - one).norm() < 1e-12);
        }
    }
}
