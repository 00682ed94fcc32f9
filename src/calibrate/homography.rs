//! The projective map between two planes. In: pairs of points. Out: the 3×3 matrix, scaled to h₃₃ = 1.
//! Start: the direct linear transform on normalised points, Hartley, PAMI 19 (1997) 580; then Gauss–Newton on the
//! distances in the target plane. Not here: lenses, outliers.

use nalgebra::{Matrix2x3, Matrix3, SMatrix, SVector, Vector2, Vector3};

/// A homography; points that it sends to infinity have no image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Homography(pub Matrix3<f64>);

impl Homography {
    /// The map that takes each pair's first point nearest to its second, by least squares in the second's plane.
    /// `None` for fewer than four pairs, or where points lie on one line.
    pub fn fit(pairs: &[(Vector2<f64>, Vector2<f64>)]) -> Option<Self> {
        if pairs.len() < 4 {
            return None;
        }
        let from = normaliser(pairs.iter().map(|p| p.0))?;
        let to = normaliser(pairs.iter().map(|p| p.1))?;
        let unit = |m: &Matrix3<f64>, p: &Vector2<f64>| p * m[(0, 0)] + Vector2::new(m[(0, 2)], m[(1, 2)]);
        let mut normal = SMatrix::<f64, 9, 9>::zeros();
        for (p, q) in pairs {
            let (p, q) = (unit(&from, p), unit(&to, q));
            let rows = [
                SVector::<f64, 9>::from([p.x, p.y, 1.0, 0.0, 0.0, 0.0, -q.x * p.x, -q.x * p.y, -q.x]),
                SVector::<f64, 9>::from([0.0, 0.0, 0.0, p.x, p.y, 1.0, -q.y * p.x, -q.y * p.y, -q.y]),
            ];
            rows.iter().for_each(|r| normal.ger(1.0, r, r, 1.0));
        }
        let eigen = normal.symmetric_eigen();
        let mut order: Vec<usize> = (0..9).collect();
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        // a second vanishing eigenvalue: the points fix no single map
        if eigen.eigenvalues[order[1]] < 1e-9 * eigen.eigenvalues[order[8]] {
            return None;
        }
        let h = eigen.eigenvectors.column(order[0]);
        let h = Matrix3::from_fn(|i, j| h[3 * i + j]);
        let mut h = Self(to.try_inverse()? * h * from).scaled()?;
        for _ in 0..10 {
            let step = h.step(pairs)?;
            let before = h.0;
            for k in 0..8 {
                h.0[(k / 3, k % 3)] += step[k];
            }
            if (h.0 - before).amax() <= 1e-12 * h.0.amax() {
                break;
            }
        }
        h.0.iter().all(|v| v.is_finite()).then_some(h)
    }

    /// Where `p` goes.
    pub fn apply(&self, p: &Vector2<f64>) -> Vector2<f64> {
        let q = self.0 * Vector3::new(p.x, p.y, 1.0);
        q.xy() / q.z
    }

    /// The map back; `None` where there is none.
    pub fn inverse(&self) -> Option<Self> {
        Self(self.0.try_inverse()?).scaled()
    }

    fn scaled(self) -> Option<Self> {
        let s = self.0[(2, 2)];
        (s != 0.0).then(|| Self(self.0 / s))
    }

    /// The Gauss–Newton step of the first eight entries.
    fn step(&self, pairs: &[(Vector2<f64>, Vector2<f64>)]) -> Option<SVector<f64, 8>> {
        let (mut normal, mut right) = (SMatrix::<f64, 8, 8>::zeros(), SVector::<f64, 8>::zeros());
        for (p, q) in pairs {
            let p = Vector3::new(p.x, p.y, 1.0);
            let image = self.0 * p;
            let at = image.xy() / image.z;
            let over = Matrix2x3::new(1.0, 0.0, -at.x, 0.0, 1.0, -at.y) / image.z; // ∂ at / ∂ image
            let j = SMatrix::<f64, 2, 8>::from_fn(|row, k| over[(row, k / 3)] * p[k % 3]);
            normal += j.transpose() * j;
            right += j.transpose() * (q - at);
        }
        // columns differ by many orders of magnitude: solve scaled
        let d = normal.diagonal().map(|v| 1.0 / v.sqrt().max(f64::MIN_POSITIVE));
        let scaled = SMatrix::<f64, 8, 8>::from_fn(|i, j| normal[(i, j)] * d[i] * d[j]);
        Some(scaled.cholesky()?.solve(&right.component_mul(&d)).component_mul(&d))
    }
}

/// Centroid to 0, mean distance from it to √2.
fn normaliser(points: impl Iterator<Item = Vector2<f64>> + Clone) -> Option<Matrix3<f64>> {
    let n = points.clone().count() as f64;
    let mean = points.clone().sum::<Vector2<f64>>() / n;
    let distance = points.map(|p| (p - mean).norm()).sum::<f64>() / n;
    let s = 2f64.sqrt() / distance;
    s.is_finite().then(|| Matrix3::new(s, 0.0, -s * mean.x, 0.0, s, -s * mean.y, 0.0, 0.0, 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    fn planted() -> Homography {
        Homography(Matrix3::new(2.1, -0.3, 320.0, 0.4, 1.9, 210.0, 3e-4, -5e-4, 1.0))
    }

    #[test]
    fn exact_pairs_give_the_exact_map() {
        let points = [(0.0, 0.0), (300.0, 10.0), (20.0, 200.0), (310.0, 220.0), (100.0, 90.0)];
        let pairs: Vec<_> = points.map(|(x, y)| Vector2::new(x, y)).map(|p| (p, planted().apply(&p))).to_vec();
        for n in [4, 5] {
            let h = Homography::fit(&pairs[..n]).expect("spread out");
            assert!((h.0 - planted().0).component_div(&planted().0).amax() < 1e-9, "{}", h.0);
            let back = h.inverse().expect("regular");
            assert!((back.apply(&pairs[3].1) - pairs[3].0).norm() < 1e-8);
        }
    }

    #[test]
    fn noise_is_averaged_as_least_squares_can() {
        let mut noise = Noise::new(2);
        let points: Vec<_> = (0..200).map(|k| Vector2::new(f64::from(k % 20), f64::from(k / 20)) * 15.0).collect();
        let noisy = |p: &Vector2<f64>, n: &mut Noise| planted().apply(p) + 0.1 * Vector2::new(n.gauss(), n.gauss());
        let mut square = 0.0;
        for _ in 0..50 {
            let pairs: Vec<_> = points.iter().map(|p| (*p, noisy(p, &mut noise))).collect();
            let h = Homography::fit(&pairs).expect("spread out");
            square += points.iter().map(|p| (h.apply(p) - planted().apply(p)).norm_squared()).sum::<f64>() / 50.0;
        }
        let rms = (square / 200.0).sqrt();
        let bound = 0.1 * (8.0f64 / 200.0).sqrt(); // σ√(parameters / points)
        assert!((0.9..1.1).contains(&(rms / bound)), "{rms} of {bound}");
    }

    #[test]
    fn points_on_a_line_give_no_map() {
        let line: Vec<_> = (0..9).map(|k| Vector2::new(f64::from(k), 2.0 * f64::from(k))).map(|p| (p, p)).collect();
        assert_eq!(Homography::fit(&line), None);
        assert_eq!(Homography::fit(&line[..3]), None);
    }
}
