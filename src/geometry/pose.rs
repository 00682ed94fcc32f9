//! Points and poses tagged by the coordinate frame they belong to, so that a product which means
//! nothing does not compile.

use nalgebra::{Matrix3, Rotation3, Vector3};
use std::marker::PhantomData;

/// Frame markers: right-handed, millimetres.
pub mod frame {
    /// Origin at the optical centre; x right, y down, z out of the lens.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Camera;
    /// As `Camera`, of the projector seen as an inverse camera.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Projector;
    /// ISO 8855: x forward, y left, z up; the vehicle model names its origin.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Vehicle;
    /// A calibration board: x along a row of its points, y from row to row, z away from whoever looks at its face.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Board;
    /// The calibration cell; until a datum survey exists, the vehicle frame of the taught capture.
    #[derive(Clone, Copy, Debug, PartialEq)]
    pub struct Station;
}

/// A point in frame `F`, mm.
#[derive(Debug)]
pub struct Point3<F> {
    /// Coordinates, mm.
    pub xyz: Vector3<f64>,
    frame: PhantomData<F>,
}

/// `a_from_b: Pose<A, B>` re-expresses a point given in `B` in `A`: `a = r·b + t`.
#[derive(Debug)]
pub struct Pose<To, From> {
    /// Rotation.
    pub r: Rotation3<f64>,
    /// Translation, mm: the origin of `From` in `To`.
    pub t: Vector3<f64>,
    frames: PhantomData<(To, From)>,
}

// Derives would ask the markers for traits that the data do not need.
impl<F> Clone for Point3<F> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<F> Copy for Point3<F> {}
impl<F> PartialEq for Point3<F> {
    fn eq(&self, other: &Self) -> bool {
        self.xyz == other.xyz
    }
}
impl<A, B> Clone for Pose<A, B> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<A, B> Copy for Pose<A, B> {}
impl<A, B> PartialEq for Pose<A, B> {
    fn eq(&self, other: &Self) -> bool {
        self.r == other.r && self.t == other.t
    }
}

impl<F> Point3<F> {
    /// The point at `xyz`, mm.
    pub const fn new(xyz: Vector3<f64>) -> Self {
        Self { xyz, frame: PhantomData }
    }
}

/// The vector from `b` to `a`, mm: all that the difference of two points of one frame can mean.
impl<F> std::ops::Sub for Point3<F> {
    type Output = Vector3<f64>;
    fn sub(self, b: Self) -> Vector3<f64> {
        self.xyz - b.xyz
    }
}

impl<A, B> Pose<A, B> {
    /// From rotation and translation (mm).
    pub const fn new(r: Rotation3<f64>, t: Vector3<f64>) -> Self {
        Self { r, t, frames: PhantomData }
    }

    /// The two frames coincide.
    pub fn identity() -> Self {
        Self::new(Rotation3::identity(), Vector3::zeros())
    }

    /// `b_from_a`.
    pub fn inverse(&self) -> Pose<B, A> {
        let r = self.r.inverse();
        Pose::new(r, -(r * self.t))
    }
}

impl<A, B> std::ops::Mul<Point3<B>> for Pose<A, B> {
    type Output = Point3<A>;
    fn mul(self, p: Point3<B>) -> Point3<A> {
        Point3::new(self.r * p.xyz + self.t)
    }
}

impl<A, B, C> std::ops::Mul<Pose<B, C>> for Pose<A, B> {
    type Output = Pose<A, C>;
    fn mul(self, q: Pose<B, C>) -> Pose<A, C> {
        Pose::new(self.r * q.r, self.r * q.t + self.t)
    }
}

/// The rotation whose rows are `rows`, re-orthonormalised; `None` where they are no right-handed rotation
/// to within 1e-4 (a mirror, a scaled or sheared matrix, a number that is not finite).
pub fn rotation_from_rows(rows: [[f64; 3]; 3]) -> Option<Rotation3<f64>> {
    let m = Matrix3::from_fn(|i, j| rows[i][j]);
    let orthonormal = (m * m.transpose() - Matrix3::identity()).iter().all(|v| v.abs() <= 1e-4);
    (orthonormal && m.determinant() > 0.0)
        .then(|| Rotation3::from_matrix_eps(&m, 1e-15, 100, Rotation3::from_matrix_unchecked(m)))
}

/// The matrix `[v]×` with `[v]×·w = v × w`.
pub fn skew(v: &Vector3<f64>) -> Matrix3<f64> {
    v.cross_matrix()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_cancel_and_inverses_undo() {
        let a = Pose::<frame::Camera, frame::Vehicle>::new(
            Rotation3::from_euler_angles(0.1, -0.2, 3.0),
            Vector3::new(1.0, -2.0, 700.0),
        );
        let p = Point3::<frame::Vehicle>::new(Vector3::new(-2600.0, 870.0, 740.0));
        let back = a.inverse() * (a * p);
        assert!((back - p).norm() < 1e-9);
        let same = a.inverse() * a;
        assert!((same.r.matrix() - Matrix3::identity()).amax() < 1e-9 && same.t.norm() < 1e-9);
    }

    #[test]
    fn a_mirror_and_a_scaled_matrix_are_no_rotations() {
        assert!(rotation_from_rows([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]).is_none());
        assert!(rotation_from_rows([[1.001, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_none());
        assert!(rotation_from_rows([[f64::NAN, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_none());
        assert!(rotation_from_rows([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]).is_some());
    }
}
