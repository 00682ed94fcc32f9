//! Where an adjustment starts. In: what camera and projector see of flat boards. Out: lenses without distortion, poses.
//! The camera by Zhang's closed form, "A flexible new technique for camera calibration", PAMI 22 (2000) 1330, appendix B;
//! the projector by the direct linear transform from the boards as the camera places them: Hartley, Zisserman, "Multiple
//! view geometry", 2nd ed., §7.1, which leaves its principal point free, far off the image's centre if need be.

use super::Homography;
use super::adjust::Seen;
use crate::geometry::{Point3, Pose, frame};
use crate::optics::Lens;
use nalgebra::{DMatrix, Matrix3, Matrix3x4, Rotation3, SMatrix, Vector2, Vector3};

type Board = Pose<frame::Camera, frame::Board>;

/// The camera's lens from each board's homography, without skew and distortion. `None` where the boards do not tell:
/// fewer than two, or all parallel to the sensor.
pub(super) fn camera(homographies: &[Homography], (width, height): (usize, usize)) -> Option<Lens> {
    // to the image's centre and size, so that the system is well scaled
    let unit = width.max(height) as f64;
    let centre = Vector2::new(width as f64 - 1.0, height as f64 - 1.0) / 2.0;
    let to_unit = Matrix3::new(1.0 / unit, 0.0, -centre.x / unit, 0.0, 1.0 / unit, -centre.y / unit, 0.0, 0.0, 1.0);
    let maps: Vec<Matrix3<f64>> = homographies.iter().map(|h| to_unit * h.0).map(|h| h / h.norm()).collect();
    let plausible = |l: &Lens| {
        let inside = |c: f64, size: usize| (0.0..size as f64).contains(&c);
        inside(l.cx, width) && inside(l.cy, height) && (0.5..2.0).contains(&(l.fx / l.fy))
    };
    let lens = |fx: f64, fy: f64, c: Vector2<f64>| {
        let c = c * unit + centre;
        let (fx, fy) = (fx * unit, fy * unit);
        let lens = Lens { width, height, fx, fy, cx: c.x, cy: c.y, distortion: [0.0; 5] };
        (fx.is_finite() && fy.is_finite()).then_some(lens)
    };
    zhang(&maps)
        .and_then(|(fx, fy, c)| lens(fx, fy, c))
        .filter(plausible)
        .or_else(|| centred(&maps).and_then(|f| lens(f, f, Vector2::zeros())))
}

/// Focal lengths and principal point of the image of the absolute conic B with B₁₂ = 0: h₁ᵀ·B·h₂ = 0, h₁ᵀ·B·h₁ = h₂ᵀ·B·h₂.
fn zhang(maps: &[Matrix3<f64>]) -> Option<(f64, f64, Vector2<f64>)> {
    let mut normal = SMatrix::<f64, 5, 5>::zeros();
    for h in maps {
        // b = (B11, B22, B13, B23, B33)
        let v = |i: usize, j: usize| {
            let (a, b) = (h.column(i), h.column(j));
            let mixed = |k: usize| a[k] * b[2] + a[2] * b[k];
            SMatrix::<f64, 5, 1>::new(a[0] * b[0], a[1] * b[1], mixed(0), mixed(1), a[2] * b[2])
        };
        for row in [v(0, 1), v(0, 0) - v(1, 1)] {
            normal.ger(1.0, &row, &row, 1.0);
        }
    }
    let eigen = normal.symmetric_eigen();
    let b = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let c = Vector2::new(-b[2] / b[0], -b[3] / b[1]);
    let lambda = b[4] - b[2] * b[2] / b[0] - b[3] * b[3] / b[1];
    let (fx, fy) = (lambda / b[0], lambda / b[1]);
    (maps.len() >= 2 && fx > 0.0 && fy > 0.0).then(|| (fx.sqrt(), fy.sqrt(), c))
}

/// The focal length with square pixels and the principal point at the centre.
fn centred(maps: &[Matrix3<f64>]) -> Option<f64> {
    // (h₁x·h₂x + h₁y·h₂y)/f² + h₁z·h₂z = 0 and the same for the difference of squares
    let (mut left, mut right) = (0.0, 0.0);
    for h in maps {
        let (a, b) = (h.column(0), h.column(1));
        let rows = [
            (a[0] * b[0] + a[1] * b[1], -a[2] * b[2]),
            (a[0] * a[0] + a[1] * a[1] - b[0] * b[0] - b[1] * b[1], b[2] * b[2] - a[2] * a[2]),
        ];
        for (k, v) in rows {
            left += k * k;
            right += k * v;
        }
    }
    let inverse = right / left;
    (inverse > 0.0 && inverse.is_finite()).then(|| inverse.powf(-0.5))
}

/// The board's pose from its homography (board mm to raw px) through `lens`.
pub(super) fn pose(lens: &Lens, map: &Homography) -> Option<Board> {
    let inverse =
        Matrix3::new(1.0 / lens.fx, 0.0, -lens.cx / lens.fx, 0.0, 1.0 / lens.fy, -lens.cy / lens.fy, 0.0, 0.0, 1.0);
    let h = inverse * map.0;
    let scale = 2.0 / (h.column(0).norm() + h.column(1).norm());
    let h = h * if h[(2, 2)] < 0.0 { -scale } else { scale };
    let (a, b) = (h.column(0).into_owned(), h.column(1).into_owned());
    let r = nearest_rotation(&Matrix3::from_columns(&[a, b, a.cross(&b)]))?;
    Some(Pose::new(r, h.column(2).into_owned()))
}

fn nearest_rotation(m: &Matrix3<f64>) -> Option<Rotation3<f64>> {
    let svd = m.svd(true, true);
    let (u, v_t) = (svd.u?, svd.v_t?);
    let mut d = Matrix3::identity();
    d[(2, 2)] = (u * v_t).determinant().signum();
    Some(Rotation3::from_matrix_unchecked(u * d * v_t))
}

/// The projector's lens (without distortion) and place, from boards in the camera's coordinates and the projector
/// pixels of their points. `None` where the points do not tell: fewer than six, or all in one plane.
pub(super) fn projector(
    board: &[Vector2<f64>],
    boards: &[Board],
    seen: &[&[Seen]],
    (width, height): (usize, usize),
) -> Option<(Lens, Pose<frame::Projector, frame::Camera>)> {
    let pairs: Vec<(Vector3<f64>, Vector2<f64>)> = boards
        .iter()
        .zip(seen)
        .flat_map(|(pose, seen)| seen.iter().map(|&(k, at)| ((*pose * Point3::new(board[k].push(0.0))).xyz, at)))
        .collect();
    if pairs.len() < 6 {
        return None;
    }
    let n = pairs.len() as f64;
    let middle = pairs.iter().map(|p| p.0).sum::<Vector3<f64>>() / n;
    let reach = (pairs.iter().map(|p| (p.0 - middle).norm_squared()).sum::<f64>() / n).sqrt();
    let unit = width.max(height) as f64;
    let mut system = DMatrix::zeros(2 * pairs.len(), 12);
    for (i, (p, at)) in pairs.iter().enumerate() {
        let p = ((p - middle) / reach).push(1.0);
        for (row, at) in (at / unit).iter().enumerate() {
            for k in 0..4 {
                system[(2 * i + row, 4 * row + k)] = p[k];
                system[(2 * i + row, 8 + k)] = -at * p[k];
            }
        }
    }
    let eigen = (system.transpose() * &system).symmetric_eigen();
    let mut order: Vec<usize> = (0..12).collect();
    order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
    if eigen.eigenvalues[order[1]] < 1e-10 * eigen.eigenvalues[order[11]] {
        return None;
    }
    let v = eigen.eigenvectors.column(order[0]);
    let m = Matrix3x4::from_fn(|i, j| v[4 * i + j]);
    // K·[R | t] of the normalised points: K upper triangular from the QR of the inverse
    let left = m.fixed_columns::<3>(0).into_owned();
    let left_inverse = left.try_inverse()?;
    let qr = left_inverse.qr();
    let (mut r, mut k) = (qr.q().transpose(), qr.r().try_inverse()?);
    let signs = Matrix3::from_diagonal(&k.diagonal().map(f64::signum));
    (k, r) = (k * signs, signs * r);
    let scale = k[(2, 2)];
    let mut t = k.try_inverse()? * m.column(3);
    if r.determinant() < 0.0 {
        (r, t) = (-r, -t);
    }
    let k = k / scale * unit;
    let lens = Lens { width, height, fx: k[(0, 0)], fy: k[(1, 1)], cx: k[(0, 2)], cy: k[(1, 2)], distortion: [0.0; 5] };
    let r = nearest_rotation(&r)?;
    let t = t * reach - r * middle;
    let finite = [lens.fx, lens.fy, lens.cx, lens.cy].iter().chain(&t).all(|v| v.is_finite());
    finite.then(|| (lens, Pose::new(r, t)))
}
