//! Bundle adjustment: the lenses of one or two devices, how they stand to each other, and every board's pose at once.
//! In:  where each device saw the points of flat boards, a start. Out: the state of least squares, its covariance, the
//! residuals. Not here: starts, which terms are worth keeping, which observations are bad.
//!
//! Levenberg–Marquardt with analytic derivatives; the boards' poses are eliminated from the normal equations (Schur
//! complement), since no two boards share an observation: Triggs, McLauchlan, Hartley, Fitzgibbon, "Bundle adjustment —
//! a modern synthesis", Vision Algorithms, LNCS 1883 (2000) 298.

use crate::geometry::{Point3, Pose, frame, skew as cross};
use crate::optics::{Lens, Pixel};
use nalgebra::{Matrix2, Matrix2x3, Matrix6, Rotation3, SMatrix, SVector, Vector2, Vector3, Vector6};
use rayon::prelude::*;

/// Parameters of one device: fx, fy, cx, cy, k1, k2, p1, p2, k3, skew.
pub(super) const OF_DEVICE: usize = 10;
/// Of camera, projector, and the motion between them (left rotation vector, translation).
pub(super) const SHARED: usize = 2 * OF_DEVICE + 6;
const RIG: usize = 2 * OF_DEVICE;

/// One point of a board as one device sees it: its index, and where, raw px.
pub type Seen = (usize, Pixel);

/// A lens and the skew of its pixels: u = fx·x + skew·y + cx of distorted x, y. Real sensors have none.
#[derive(Clone, Debug, PartialEq)]
pub struct Device {
    /// The lens.
    pub lens: Lens,
    /// px.
    pub skew: f64,
}

/// All that is adjusted.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct State {
    /// The camera; then the projector, if there is one.
    pub(super) devices: Vec<Device>,
    /// Where the projector stands; identity without one.
    pub(super) projector_from_camera: Pose<frame::Projector, frame::Camera>,
    /// One per view.
    pub(super) camera_from_board: Vec<Pose<frame::Camera, frame::Board>>,
}

/// What is adjusted to.
#[derive(Clone, Debug)]
pub(super) struct Problem<'a> {
    /// The boards' points, mm.
    pub(super) board: &'a [Vector2<f64>],
    /// Per view, what camera and projector see of it; a view may be empty.
    pub(super) views: &'a [[Vec<Seen>; 2]],
    /// Which shared parameters are free.
    pub(super) free: [bool; SHARED],
    /// Standard deviation of one coordinate, px, per device.
    pub(super) sigma: [f64; 2],
}

type Shared = SMatrix<f64, SHARED, SHARED>;

/// One view's part of the normal equations.
struct Normal {
    shared: Shared,
    mixed: SMatrix<f64, SHARED, 6>,
    pose: Matrix6<f64>,
    right_shared: SVector<f64, SHARED>,
    right_pose: Vector6<f64>,
    cost: f64,
}

/// Σ w·jᵀ·j (its upper triangle), Σ w·jᵀ·r and Σ w·r² over the points that one device sees of one board. The derivatives j
/// are by the device's own shared parameters, then by the board's pose.
struct Sums<const N: usize> {
    weight: f64,
    left: [[f64; N]; N],
    right: [f64; N],
    cost: f64,
}

impl<const N: usize> Sums<N> {
    fn new(sigma: f64) -> Self {
        Self { weight: sigma.powi(-2), left: [[0.0; N]; N], right: [0.0; N], cost: 0.0 }
    }

    fn add(&mut self, j: &SMatrix<f64, 2, N>, residual: Vector2<f64>) {
        let [x, y]: [[f64; N]; 2] = std::array::from_fn(|row| std::array::from_fn(|k| j[(row, k)]));
        for i in 0..N {
            let (wx, wy) = (self.weight * x[i], self.weight * y[i]);
            self.right[i] += wx * residual.x + wy * residual.y;
            for k in i..N {
                self.left[i][k] += wx * x[k] + wy * y[k];
            }
        }
        self.cost += self.weight * residual.norm_squared();
    }
}

impl Normal {
    /// Adds `sums`, of which parameter k, before the last six, is the shared parameter `at(k)`.
    fn take<const N: usize>(&mut self, sums: &Sums<N>, at: impl Fn(usize) -> usize) {
        let left = |i: usize, k: usize| sums.left[i.min(k)][i.max(k)];
        let own = N - 6;
        for i in 0..own {
            (0..own).for_each(|k| self.shared[(at(i), at(k))] += left(i, k));
            (0..6).for_each(|k| self.mixed[(at(i), k)] += left(i, own + k));
            self.right_shared[at(i)] += sums.right[i];
        }
        for i in 0..6 {
            (0..6).for_each(|k| self.pose[(i, k)] += left(own + i, own + k));
            self.right_pose[i] += sums.right[own + i];
        }
        self.cost += sums.cost;
    }
}

/// Iterations after which what still moves does not converge.
const MAX_STEPS: usize = 100;
/// A step that would lower the cost by less than this share is not worth taking: of 10⁴ residuals, a thousandth of a sigma.
const ARRIVED: f64 = 1e-10;
/// The same for answers without one view, which are only compared with each other: a tenth of a sigma.
const COMPARED: f64 = 1e-6;

impl Problem<'_> {
    /// Adjusts from `start`. `None` where the observations do not determine what is free, or a board lies behind a
    /// device.
    pub(super) fn adjust(&self, start: State) -> Option<State> {
        self.adjust_until(start, ARRIVED)
    }

    /// The same, to where no step would lower the cost by more than the share `arrived`.
    fn adjust_until(&self, start: State, arrived: f64) -> Option<State> {
        let mut state = start;
        let mut normals = self.normals(&state)?;
        let mut cost: f64 = normals.iter().map(|n| n.cost).sum();
        let mut damping = 1e-6;
        for _ in 0..MAX_STEPS {
            let Some((shared, poses)) = self.step(&normals, damping, None) else {
                damping *= 10.0;
                if damping > 1e8 {
                    return None;
                }
                continue;
            };
            // what the step would gain if the projection were linear
            let of_pose = |(n, p): (&Normal, &Vector6<f64>)| n.right_shared.dot(&shared) + n.right_pose.dot(p);
            if normals.iter().zip(&poses).map(of_pose).sum::<f64>() <= arrived * cost {
                break;
            }
            let next = state.moved(&shared, &poses);
            match self.normals(&next).map(|n| (n.iter().map(|n| n.cost).sum::<f64>(), n)) {
                Some((lower, n)) if lower < cost => {
                    (state, normals, cost) = (next, n, lower);
                    damping = (damping * 0.1).max(1e-12);
                }
                _ => damping *= 10.0,
            }
        }
        Some(state)
    }

    /// Covariance of the shared parameters at `state`, the answer of [`Self::adjust`], if the problem's sigmas are true. A
    /// parameter that was fixed is not known for that: `presumed` is the standard deviation of what it was fixed at, 0 where
    /// that is exact; what it leaves open, and how far the answer would move if it were free, are in the covariance of all.
    pub(super) fn covariance(&self, state: &State, presumed: &[f64; SHARED]) -> Option<SMatrix<f64, SHARED, SHARED>> {
        let open: [bool; SHARED] = std::array::from_fn(|k| self.free[k] || presumed[k] > 0.0);
        let opened = Problem { free: open, ..self.clone() };
        let (mut left, right, _) = opened.reduced(&opened.normals(state)?, 0.0, None)?;
        for k in (0..SHARED).filter(|&k| open[k] && !self.free[k]) {
            left[(k, k)] += presumed[k].powi(-2);
        }
        let inverse = left.cholesky()?.inverse();
        let step = inverse * right;
        let whole = inverse + step * step.transpose();
        Some(Shared::from_fn(|i, j| if open[i] && open[j] { whole[(i, j)] } else { 0.0 }))
    }

    /// The problem about `state`, its answer: all that is needed to ask for answers without one view.
    pub(super) fn linearised<'p>(&'p self, state: &'p State) -> Option<Linearised<'p>> {
        Some(Linearised { problem: self, state, normals: self.normals(state)? })
    }

    /// Seen less projected, px, per view and device, in the order given; `None` where a point lies behind a device.
    pub(super) fn residuals(&self, state: &State) -> Option<Vec<[Vec<Vector2<f64>>; 2]>> {
        let of = |view: usize, device: usize| -> Option<Vec<Vector2<f64>>> {
            let project = |&(point, at): &Seen| {
                let p = state.in_device(view, device, &self.board[point]);
                Some(at - state.devices[device].project(&p)?)
            };
            self.views[view][device].iter().map(project).collect()
        };
        (0..self.views.len()).map(|v| Some([of(v, 0)?, of(v, 1)?])).collect()
    }

    fn normals(&self, state: &State) -> Option<Vec<Normal>> {
        (0..self.views.len()).into_par_iter().map(|v| self.normal(state, v)).collect()
    }

    fn normal(&self, state: &State, view: usize) -> Option<Normal> {
        let mut n = Normal {
            shared: Shared::zeros(),
            mixed: SMatrix::zeros(),
            pose: Matrix6::zeros(),
            right_shared: SVector::zeros(),
            right_pose: Vector6::zeros(),
            cost: 0.0,
        };
        let rig = &state.projector_from_camera;
        let board = &state.camera_from_board[view];
        let [camera, projector] = &self.views[view];
        let turn_then_shift = |turned: Vector3<f64>, by_point: &Matrix2x3<f64>| {
            let mut j = SMatrix::<f64, 2, 6>::zeros();
            j.fixed_columns_mut::<3>(0).copy_from(&(by_point * -cross(&turned)));
            j.fixed_columns_mut::<3>(3).copy_from(by_point);
            j
        };
        let mut sums = Sums::<{ OF_DEVICE + 6 }>::new(self.sigma[0]);
        for &(point, at) in camera {
            let turned = board.r * self.board[point].push(0.0);
            let (pixel, by_device, by_point) = state.devices[0].derivatives(&(turned + board.t))?;
            let mut j = SMatrix::<f64, 2, { OF_DEVICE + 6 }>::zeros();
            j.fixed_columns_mut::<OF_DEVICE>(0).copy_from(&by_device);
            j.fixed_columns_mut::<6>(OF_DEVICE).copy_from(&turn_then_shift(turned, &by_point));
            sums.add(&j, at - pixel);
        }
        n.take(&sums, |k| k);
        let mut sums = Sums::<{ OF_DEVICE + 12 }>::new(self.sigma[1]);
        for &(point, at) in projector {
            let turned = board.r * self.board[point].push(0.0);
            let in_projector = rig.r * (turned + board.t);
            let (pixel, by_device, by_point) = state.devices[1].derivatives(&(in_projector + rig.t))?;
            let mut j = SMatrix::<f64, 2, { OF_DEVICE + 12 }>::zeros();
            j.fixed_columns_mut::<OF_DEVICE>(0).copy_from(&by_device);
            j.fixed_columns_mut::<6>(OF_DEVICE).copy_from(&turn_then_shift(in_projector, &by_point));
            j.fixed_columns_mut::<6>(OF_DEVICE + 6).copy_from(&turn_then_shift(turned, &(by_point * rig.r.matrix())));
            sums.add(&j, at - pixel);
        }
        n.take(&sums, |k| OF_DEVICE + k); // the rig's parameters follow the projector's
        Some(n)
    }

    /// The normal equations of the free shared parameters, the boards eliminated; identity where fixed. A view may be left
    /// out.
    fn reduced(
        &self,
        normals: &[Normal],
        damping: f64,
        left_out: Option<usize>,
    ) -> Option<(Shared, SVector<f64, SHARED>, Vec<Matrix6<f64>>)> {
        let (mut left, mut right) = (Shared::zeros(), SVector::<f64, SHARED>::zeros());
        let mut inverses = Vec::with_capacity(normals.len());
        for (v, (n, seen)) in normals.iter().zip(self.views).enumerate() {
            if left_out == Some(v) {
                inverses.push(Matrix6::zeros()); // its board stays where it is
                continue;
            }
            left += n.shared;
            right += n.right_shared;
            if seen.iter().all(Vec::is_empty) {
                inverses.push(Matrix6::zeros()); // a board nobody sees stays where it is
                continue;
            }
            let mut pose = n.pose;
            (0..6).for_each(|k| pose[(k, k)] *= 1.0 + damping);
            let inverse = pose.cholesky()?.inverse();
            let through = n.mixed * inverse;
            left -= through * n.mixed.transpose();
            right -= through * n.right_pose;
            inverses.push(inverse);
        }
        for k in 0..SHARED {
            left[(k, k)] += damping * normals.iter().map(|n| n.shared[(k, k)]).sum::<f64>();
        }
        for k in (0..SHARED).filter(|&k| !self.free[k]) {
            left.row_mut(k).fill(0.0);
            left.column_mut(k).fill(0.0);
            left[(k, k)] = 1.0;
            right[k] = 0.0;
        }
        Some((left, right, inverses))
    }

    fn step(
        &self,
        normals: &[Normal],
        damping: f64,
        left_out: Option<usize>,
    ) -> Option<(SVector<f64, SHARED>, Vec<Vector6<f64>>)> {
        let (left, right, inverses) = self.reduced(normals, damping, left_out)?;
        let shared = left.cholesky()?.solve(&right);
        let pose = |(n, inverse): (&Normal, Matrix6<f64>)| inverse * (n.right_pose - n.mixed.transpose() * shared);
        let poses = normals.iter().zip(inverses).map(pose).collect();
        Some((shared, poses))
    }
}

/// A problem's normal equations at its answer.
pub(super) struct Linearised<'p> {
    problem: &'p Problem<'p>,
    state: &'p State,
    normals: Vec<Normal>,
}

impl Linearised<'_> {
    /// The answer without `view`: one step from here, and more where that is not enough. `None` where the others determine
    /// nothing.
    pub(super) fn without(&self, view: usize) -> Option<State> {
        let (shared, poses) = self.problem.step(&self.normals, 0.0, Some(view))?;
        let mut others = self.problem.views.to_vec();
        others[view] = Default::default();
        Problem { views: &others, ..self.problem.clone() }.adjust_until(self.state.moved(&shared, &poses), COMPARED)
    }

    /// How far the answers `without` one view each (by index) lie from this one, in sigmas squared, summed; and how far they
    /// would be expected to lie if all residuals were independent.
    pub(super) fn shifts(&self, without: &[(usize, &State)]) -> Option<(f64, f64)> {
        let reduced = |left_out| Some(self.problem.reduced(&self.normals, 0.0, left_out)?.0);
        let information = reduced(None)?;
        let free: Vec<usize> = (0..SHARED).filter(|&k| self.problem.free[k]).collect();
        let (mut found, mut expected) = (0.0, 0.0);
        for (view, other) in without {
            let way = other.less(self.state);
            found += (way.transpose() * information * way)[0];
            // the difference of two nested least-squares answers has the difference of their covariances
            let covariance = reduced(Some(*view))?.cholesky()?.inverse();
            let trace: f64 = free.iter().map(|&k| (information.row(k) * covariance.column(k))[0]).sum();
            expected += trace - free.len() as f64;
        }
        Some((found, expected))
    }
}

impl State {
    /// A board's point in the coordinates of a device, mm.
    fn in_device(&self, view: usize, device: usize, point: &Vector2<f64>) -> Vector3<f64> {
        let in_camera = self.camera_from_board[view] * Point3::new(point.push(0.0));
        if device == 0 { in_camera.xyz } else { (self.projector_from_camera * in_camera).xyz }
    }

    /// The step of the shared parameters that leads from `start` to here.
    fn less(&self, start: &Self) -> SVector<f64, SHARED> {
        let mut way = SVector::<f64, SHARED>::zeros();
        for (d, (a, b)) in self.devices.iter().zip(&start.devices).enumerate() {
            let of = |d: &Device| {
                let (l, [k1, k2, p1, p2, k3]) = (&d.lens, d.lens.distortion);
                SVector::<f64, OF_DEVICE>::from([l.fx, l.fy, l.cx, l.cy, k1, k2, p1, p2, k3, d.skew])
            };
            way.fixed_rows_mut::<OF_DEVICE>(d * OF_DEVICE).copy_from(&(of(a) - of(b)));
        }
        let (a, b) = (&self.projector_from_camera, &start.projector_from_camera);
        way.fixed_rows_mut::<3>(RIG).copy_from(&(a.r * b.r.inverse()).scaled_axis());
        way.fixed_rows_mut::<3>(RIG + 3).copy_from(&(a.t - b.t));
        way
    }

    fn moved(&self, shared: &SVector<f64, SHARED>, poses: &[Vector6<f64>]) -> Self {
        let mut next = self.clone();
        for (k, device) in next.devices.iter_mut().enumerate() {
            let d = shared.fixed_rows::<OF_DEVICE>(k * OF_DEVICE);
            let lens = &mut device.lens;
            for (value, step) in [&mut lens.fx, &mut lens.fy, &mut lens.cx, &mut lens.cy].into_iter().zip(&d) {
                *value += step;
            }
            for (value, step) in lens.distortion.iter_mut().zip(d.iter().skip(4)) {
                *value += step;
            }
            device.skew += d[9];
        }
        next.projector_from_camera = turned(&self.projector_from_camera, &shared.fixed_rows::<6>(RIG).into_owned());
        for (pose, step) in next.camera_from_board.iter_mut().zip(poses) {
            *pose = turned(pose, step);
        }
        next
    }
}

/// `pose` with its rotation turned from the left by the first three, its translation moved by the last three.
fn turned<A, B>(pose: &Pose<A, B>, step: &Vector6<f64>) -> Pose<A, B> {
    let turn = Rotation3::new(step.fixed_rows::<3>(0).into_owned());
    Pose::new(turn * pose.r, pose.t + step.fixed_rows::<3>(3))
}

impl Device {
    /// The raw pixel of a point in the device's coordinates; `None` at or behind it.
    pub(super) fn project(&self, p: &Vector3<f64>) -> Option<Pixel> {
        if p.z <= 0.0 {
            return None;
        }
        let (lens, d) = (&self.lens, self.lens.distort(&(p.xy() / p.z)).0);
        Some(Pixel::new(lens.fx * d.x + self.skew * d.y + lens.cx, lens.fy * d.y + lens.cy))
    }

    /// The pixel, and its derivatives by the device's parameters and by the point.
    fn derivatives(&self, p: &Vector3<f64>) -> Option<(Pixel, SMatrix<f64, 2, OF_DEVICE>, Matrix2x3<f64>)> {
        if p.z <= 0.0 {
            return None;
        }
        let lens = &self.lens;
        let n = p.xy() / p.z;
        let (d, by_normalised) = lens.distort(&n);
        let focal = Matrix2::new(lens.fx, self.skew, 0.0, lens.fy);
        let r2 = n.norm_squared();
        let by_distortion = [
            n * r2,
            n * (r2 * r2),
            Vector2::new(2.0 * n.x * n.y, r2 + 2.0 * n.y * n.y),
            Vector2::new(r2 + 2.0 * n.x * n.x, 2.0 * n.x * n.y),
            n * (r2 * r2 * r2),
        ];
        let mut by_device = SMatrix::<f64, 2, OF_DEVICE>::zeros();
        by_device[(0, 0)] = d.x;
        by_device[(1, 1)] = d.y;
        by_device[(0, 2)] = 1.0;
        by_device[(1, 3)] = 1.0;
        for (k, v) in by_distortion.iter().enumerate() {
            by_device.set_column(4 + k, &(focal * v));
        }
        by_device[(0, 9)] = d.y;
        let by_z = Matrix2x3::new(1.0, 0.0, -n.x, 0.0, 1.0, -n.y) / p.z;
        let pixel = focal * d + Vector2::new(lens.cx, lens.cy);
        Some((pixel, by_device, focal * by_normalised * by_z))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_the_projection() {
        let lens = Lens {
            width: 1296,
            height: 972,
            fx: 1351.8,
            fy: 1340.0,
            cx: 651.0,
            cy: 481.0,
            distortion: [-0.3, 0.2, 0.01, -0.02, 0.05],
        };
        let device = Device { lens, skew: 3.0 };
        let p = Vector3::new(210.0, -160.0, 700.0);
        let (_, by_device, by_point) = device.derivatives(&p).expect("in front");
        for k in 0..OF_DEVICE {
            let h = if k < 4 || k == 9 { 1e-3 } else { 1e-6 };
            let at = |sign: f64| {
                let mut d = device.clone();
                let Device { lens: Lens { fx, fy, cx, cy, distortion: [k1, k2, p1, p2, k3], .. }, skew } = &mut d;
                *[fx, fy, cx, cy, k1, k2, p1, p2, k3, skew][k] += sign * h;
                d.project(&p).expect("in front")
            };
            let slope = (at(1.0) - at(-1.0)) / (2.0 * h);
            assert!((slope - by_device.column(k)).amax() < 1e-6 * (1.0 + slope.amax()), "{k}: {slope}");
        }
        for k in 0..3 {
            let step = Vector3::ith(k, 1e-4);
            let slope =
                (device.project(&(p + step)).expect("near") - device.project(&(p - step)).expect("near")) / 2e-4;
            assert!((slope - by_point.column(k)).amax() < 1e-7, "{k}: {slope}");
        }
    }

    #[test]
    fn the_way_to_a_moved_state_is_its_step() {
        let lens = Lens {
            width: 100,
            height: 80,
            fx: 90.0,
            fy: 91.0,
            cx: 50.0,
            cy: 40.0,
            distortion: [0.1, 0.0, 0.0, 0.0, 0.0],
        };
        let state = State {
            devices: vec![Device { lens: lens.clone(), skew: 0.0 }, Device { lens, skew: 0.0 }],
            projector_from_camera: Pose::new(
                Rotation3::from_euler_angles(0.1, -0.3, 0.2),
                Vector3::new(200.0, 1.0, 80.0),
            ),
            camera_from_board: Vec::new(),
        };
        let step = SVector::<f64, SHARED>::from_fn(|k, _| 1e-3 * (k as f64 + 1.0));
        assert!((state.moved(&step, &[]).less(&state) - step).amax() < 1e-12);
    }
}
