//! Calibration health: whether camera and projector still stand to each other as calibrated, from one vehicle.
//! In:  epipolar residuals over everything that is lit, the features against their nominal places, the calibration.
//! Out: one index in sigmas, the plain numbers, a sentence. Not here: what is refused.
//!
//! Two witnesses. Fringes across the measuring axis see every motion of camera against projector but one: a baseline
//! that is longer leaves every ray and every plane of light where they cross. Known lengths see that one.
//!
//! - Fringes: the residuals' patterns under the five small motions that leave any. Let b = Jᵀ·W·residuals with the
//!   covariance C that noise, what no motion explains, the drift of healthy mounts and the calibration's own
//!   covariance give it; χ² = bᵀ·C⁻¹·b is 1 per direction for a healthy rig, in whatever units motions are counted, and
//!   weak directions weigh no more than strong ones. What no motion explains is taken from the scatter about the fit.
//! - Lengths: the features' size against nominal, with what is known of each.
//!
//! The index is the larger of √(χ²/directions) and |scale| over its sigma.

use super::file::{Calibration, ParameterCovariance};
use super::propagate::{PointJacobian, RELATION, Sensitivity};
use crate::fringe::{Axis, EpipolarCell};
use crate::geometry::robust::Weights;
use crate::geometry::{Pair, frame, motion_jacobian, register};
use crate::lent::List;
use crate::optics::Rig;
use nalgebra::{Matrix3, Matrix3x6, Matrix5, RowSVector, SMatrix, SVector, Vector3};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt::Write;

/// The index from which on a rig is unhealthy. Of the fringes' five directions noise alone gets there once in 10⁹
/// vehicles, of the lengths once in 400.
pub const MAX_INDEX: f64 = 3.0;
/// Rms of the cells' residuals beyond which a rig is unhealthy whatever explains it, projector px.
pub const MAX_EPIPOLAR_PX: f64 = 0.15;
/// What a cell's mean may be off without a motion, 1 sigma, projector px. Rendered captures with an exact calibration
/// show 0.0005 to 0.0015 px beyond noise, and their lenses and fringes are perfect.
const FLOOR_PX: f64 = 0.003;
/// Turns about each axis, and shifts in units of the baseline, by which a healthy rig's mount differs from when it was
/// calibrated, 1 sigma, rad: 0.001°, 4 µm over a baseline of 230 mm; aluminium grows by that in 0.8 K. An assumption: no
/// real rig was watched. Without it the index would grow to hundreds for turns that move no pose.
const DRIFT_RAD: f64 = 0.001 * std::f64::consts::PI / 180.0;
/// How much larger or smaller light and paint make the features' arrangement beyond what is stated for each feature,
/// 1 sigma, a share: lengths in 13 captures of two rendered bodies scatter by 0.013 %, of which features state 0.010 %.
const SIZE_BIAS: f64 = 8e-5;
/// Fewer cells say nothing.
const MIN_CELLS: usize = 20;
/// Bytes of a healthy calibration's sentence, and some.
const SENTENCE: usize = 128;
/// Highest correlation of neighbouring cells that is believed: from there on all cells are a handful.
const MAX_CORRELATION: f64 = 0.8;

/// A feature against its nominal place, with its response to the calibration's [`super::independent_errors`].
#[derive(Clone, Copy, Debug)]
pub struct Known {
    /// Measured and nominal, with the covariance of everything but the calibration.
    pub pair: Pair<frame::Camera, frame::Vehicle>,
    /// mm per sigma of each error, camera axes; zero without a covariance.
    pub spread: PointJacobian,
}

/// What one vehicle says of the calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Health {
    /// The larger of what fringes and lengths say, in sigmas: about 1 for a healthy rig, unhealthy above 3.
    pub index: f64,
    /// Rms of the cells' epipolar residuals, weighted by what each is known to, projector px.
    pub epipolar_px: f64,
    /// By how much the features' lengths come out larger than nominal, %; none with fewer than three features.
    pub scale_percent: Option<f64>,
    /// Its standard deviation, %.
    pub scale_sigma_percent: Option<f64>,
    /// The index is at most [`MAX_INDEX`] and the residual at most [`MAX_EPIPOLAR_PX`].
    pub healthy: bool,
    /// The same in a sentence.
    pub detail: String,
    /// What explains the residuals best, were it nothing else; none where that may be noise. A healthy mount's drift
    /// is a turn too.
    #[serde(skip)]
    pub turn: Option<Turn>,
    /// The share by which lengths come out too large; none where that may be noise.
    #[serde(skip)]
    pub size: Option<f64>,
}

/// A turn of the camera against the projector since the calibration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn {
    /// Rotation vector, camera axes, rad.
    pub vector: Vector3<f64>,
    /// Its covariance, rad².
    pub covariance: Matrix3<f64>,
}

impl Turn {
    /// By how much a point with the given response is measured wrongly because of it, per rad about each axis, mm,
    /// camera axes.
    pub fn shift(rig: &Rig, response: &PointJacobian) -> Matrix3<f64> {
        -(response.fixed_columns::<3>(RELATION) * rig.projector_from_camera.r.matrix())
    }

    fn is_sure(&self) -> bool {
        let inverse = self.covariance.try_inverse().unwrap_or_else(Matrix3::zeros);
        self.vector.dot(&(inverse * self.vector)) > 3.0 * MAX_INDEX * MAX_INDEX
    }
}

impl Health {
    /// The health of `calibration` by residuals of which the depth came from fringes along `axis`; `errors`: its
    /// [`super::independent_errors`], zero if it has no covariance. `None` with fewer than 20 cells.
    pub fn new(
        calibration: &Calibration,
        errors: &ParameterCovariance,
        axis: Axis,
        cells: &[EpipolarCell],
        known: &[Known],
    ) -> Option<Self> {
        let fringes = Fringes::new(calibration, errors, axis, cells)?;
        let scale = scale(known);
        let lengths = scale.map_or(0.0, |(s, sigma)| (s / sigma).abs());
        let index = fringes.index.max(lengths);
        let mut out = Self {
            index,
            epipolar_px: fringes.epipolar_px,
            scale_percent: scale.map(|s| 100.0 * s.0),
            scale_sigma_percent: scale.map(|s| 100.0 * s.1),
            healthy: index <= MAX_INDEX && fringes.epipolar_px <= MAX_EPIPOLAR_PX,
            detail: String::new(),
            turn: Some(fringes.turn).filter(Turn::is_sure),
            size: scale.filter(|_| lengths > MAX_INDEX).map(|s| s.0),
        };
        out.detail = out.sentence(fringes.index);
        Some(out)
    }

    fn sentence(&self, fringes: f64) -> String {
        let mut out = String::with_capacity(SENTENCE);
        let _ = write!(out, "calibration health: epipolar {:.3} px, scale ", self.epipolar_px);
        let _ = match (self.scale_percent, self.scale_sigma_percent) {
            (Some(s), Some(sigma)) => write!(out, "{s:+.3} % ± {sigma:.3} %"),
            _ => write!(out, "unknown"),
        };
        let _ = write!(out, ", index {:.1} of {MAX_INDEX}: ", self.index);
        let mut causes = Vec::new();
        if let Some(turn) = self.turn.filter(|_| fringes > MAX_INDEX) {
            let sigmas = turn.covariance.diagonal().map(f64::sqrt);
            let about = turn.vector.component_div(&sigmas).iamax();
            causes.push(format!(
                "the camera seems turned by {:+.4}° ± {:.4}° about {} against the projector",
                turn.vector[about].to_degrees(),
                f64::max(sigmas[about].to_degrees(), 1e-4),
                ["x", "y", "z"][about]
            ));
        }
        if self.size.is_some() {
            causes.push("lengths are not nominal: the baseline, or the body".into());
        }
        if causes.is_empty() && !self.healthy {
            causes.push("the fringes lie off the epipolar lines in no simple way".into());
        }
        let _ = if causes.is_empty() { write!(out, "healthy") } else { write!(out, "{}; verify", causes.join(", ")) };
        out
    }
}

/// A cell, and how its residual follows the calibrated parameters.
type Response = (EpipolarCell, RowSVector<f64, 24>);

/// What the residuals say.
struct Fringes {
    index: f64,
    epipolar_px: f64,
    turn: Turn,
}

impl Fringes {
    fn new(
        calibration: &Calibration,
        errors: &ParameterCovariance,
        axis: Axis,
        cells: &[EpipolarCell],
    ) -> Option<Self> {
        let rig = &calibration.rig;
        let response = |c: &EpipolarCell| Some((*c, Sensitivity::new(rig, axis, &c.point)?.across));
        let responses = List::of_parallel(cells.par_iter().map(response));
        let responses = List::of(responses.iter().flatten().copied());
        if responses.len() < MIN_CELLS {
            return None;
        }
        let motions = motions(calibration);
        let pattern = |row: &RowSVector<f64, 24>| row.fixed_columns::<6>(RELATION) * motions;
        let own = List::of(responses.iter().map(|(c, _)| c.sigma.hypot(FLOOR_PX)));
        let (squares, sum) = responses.iter().zip(&own).fold((0.0, 0.0), |(squares, sum), ((c, _), own)| {
            let weight = own.powi(-2);
            (squares + weight * c.residual.powi(2), sum + weight)
        });
        let mut weights = Weights::default();
        weights.weights.resize(own.len(), 1.0);
        let mut misfit = List::new();
        for _ in 0..5 {
            let (normal, right) = responses.iter().zip(&own).zip(&weights.weights).fold(
                (SMatrix::<f64, 5, 5>::zeros(), SVector::<f64, 5>::zeros()),
                |(normal, right), (((c, row), own), w)| {
                    let j = pattern(row).transpose() / *own;
                    (normal + j * j.transpose() * *w, right + j * (c.residual / own * w))
                },
            );
            let fitted = pseudo_inverse(&normal).0 * right;
            let off = |((c, row), own): (&Response, &f64)| (c.residual - (pattern(row) * fitted)[0]) / own;
            misfit.clear();
            misfit.extend(responses.iter().zip(&own).map(off));
            weights.weigh(misfit.iter().copied());
        }
        let variance = weights.scale * weights.scale * cells_per_independent(&responses, &misfit);

        let mut right = SVector::<f64, 24>::zeros();
        let mut normal = ParameterCovariance::zeros();
        for (((c, row), own), w) in responses.iter().zip(&own).zip(&weights.weights) {
            let weight = w / (own * own * variance);
            right += row.transpose() * (c.residual * weight);
            normal += row.transpose() * row * weight;
        }
        // only the relation is asked for; every parameter may be off by what the covariance says
        let relation = normal.fixed_rows::<6>(RELATION).into_owned();
        let asked = motions.transpose();
        let response = asked * relation * errors;
        let information = asked * relation.fixed_columns::<6>(RELATION) * motions;
        let b: SVector<f64, 5> = asked * right.fixed_rows::<6>(RELATION);
        // what a healthy mount does by itself
        let drift = information * DRIFT_RAD;
        let (inverse, directions) =
            pseudo_inverse(&(information + response * response.transpose() + drift * drift.transpose()));
        let chi2: f64 = b.dot(&(inverse * b));

        let mut of_turns = Matrix5::zeros();
        of_turns.fixed_view_mut::<3, 3>(0, 0).copy_from(&information.fixed_view::<3, 3>(0, 0));
        let inverse = pseudo_inverse(&of_turns).0.fixed_view::<3, 3>(0, 0).into_owned();
        let spread = inverse * response.fixed_rows::<3>(0);
        Some(Self {
            index: (chi2 / directions as f64).sqrt(),
            epipolar_px: (squares / sum).sqrt(),
            // residuals are those of the file: what the truth differs by has the other sign
            turn: Turn { vector: -(inverse * b.fixed_rows::<3>(0)), covariance: inverse + spread * spread.transpose() },
        })
    }
}

/// The motions that leave a residual, in terms of rx … tz: turns of the camera about its own axes (rad), and shifts
/// across the baseline (units of its length).
fn motions(calibration: &Calibration) -> SMatrix<f64, 6, 5> {
    let relation = &calibration.rig.projector_from_camera;
    let mut out = SMatrix::<f64, 6, 5>::zeros();
    out.fixed_view_mut::<3, 3>(0, 0).copy_from(relation.r.matrix());
    let along = relation.t.normalize();
    let across = along.cross(&Vector3::ith(along.iamin(), 1.0)).normalize();
    for (k, direction) in [across, along.cross(&across)].iter().enumerate() {
        out.fixed_view_mut::<3, 1>(3, 3 + k).copy_from(&(direction * relation.t.norm()));
    }
    out
}

/// How many cells hold what one independent one would: a misfit that is smooth over the image is the same in many.
/// With correlation ρ of neighbours falling off by the step along both axes, ((1 + ρ)/(1 − ρ))²; Bayley, Hammersley,
/// "The 'effective' number of independent observations in an autocorrelated time series", JRSS Suppl. 8 (1946) 184.
fn cells_per_independent(responses: &[Response], misfit: &[f64]) -> f64 {
    // a cell that is far off tells nothing of its neighbours
    let mut clipped = List::of(responses.iter().zip(misfit).map(|((c, _), m)| (c.index, m.clamp(-4.0, 4.0))));
    clipped.sort_unstable_by_key(|(index, _)| *index);
    let (mut products, mut pairs, mut squares) = (0.0, 0.0, 0.0);
    for &([i, j], m) in &clipped {
        squares += m * m;
        for neighbour in [[i + 1, j], [i, j + 1]] {
            if let Ok(k) = clipped.binary_search_by_key(&neighbour, |(index, _)| *index) {
                products += m * clipped[k].1;
                pairs += 1.0;
            }
        }
    }
    let pairs = f64::max(pairs, 1.0);
    let correlation = products / pairs * clipped.len() as f64 / squares.max(f64::MIN_POSITIVE);
    // less twice what independent cells show of it by chance
    let correlation = (correlation - 2.0 / pairs.sqrt()).clamp(0.0, MAX_CORRELATION);
    ((1.0 + correlation) / (1.0 - correlation)).powi(2)
}

/// By how much the known points come out larger than nominal, a share, with its sigma: a similarity fitted to them.
/// What moves all of them alike is the pose's. `None` where they make no pose.
fn scale(known: &[Known]) -> Option<(f64, f64)> {
    let pairs = List::of(known.iter().map(|k| k.pair));
    let fit = register(&pairs).ok()?;
    let to_vehicle = fit.a_from_b.r.inverse();
    let mut normal = SMatrix::<f64, 7, 7>::zeros();
    let mut right = SVector::<f64, 7>::zeros();
    let mut response = SMatrix::<f64, 7, 24>::zeros();
    for (k, residual) in known.iter().zip(&fit.residuals) {
        let weight = (to_vehicle * k.pair.covariance * fit.a_from_b.r).try_inverse()?;
        let motion: Matrix3x6<f64> = motion_jacobian(&k.pair.nominal.xyz, &fit.at.xyz);
        let mut j = SMatrix::<f64, 3, 7>::zeros();
        j.fixed_columns_mut::<6>(0).copy_from(&motion);
        j.set_column(6, &(k.pair.nominal - fit.at));
        let jw = j.transpose() * weight;
        normal += jw * j;
        right += jw * residual;
        response += jw * (to_vehicle * k.spread);
    }
    let inverse = normal.try_inverse()?;
    let of_calibration = (inverse * response).row(6).norm_squared();
    Some(((inverse * right)[6], (inverse[(6, 6)] + of_calibration + SIZE_BIAS * SIZE_BIAS).sqrt()))
}

/// The inverse on the directions that `m` determines, and their number. Rows are scaled first: units do not matter.
fn pseudo_inverse(m: &Matrix5<f64>) -> (Matrix5<f64>, usize) {
    let over = m.diagonal().map(|v| if v > 0.0 { 1.0 / v.sqrt() } else { 0.0 });
    let scaled = Matrix5::from_fn(|i, j| m[(i, j)] * over[i] * over[j]).symmetric_eigen();
    let known = |v: f64| v > 1e-9 * scaled.eigenvalues.max();
    let inverted = scaled.eigenvalues.map(|v| if known(v) { 1.0 / v } else { 0.0 });
    let inverse = scaled.eigenvectors * Matrix5::from_diagonal(&inverted) * scaled.eigenvectors.transpose();
    let out = Matrix5::from_fn(|i, j| inverse[(i, j)] * over[i] * over[j]);
    (out, scaled.eigenvalues.iter().filter(|v| known(**v)).count())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::independent_errors;
    use crate::calibrate::propagate::changed;
    use crate::calibrate::testing::{rig, stated};
    use crate::fringe::{epipolar_residual, projector_coordinate};
    use crate::geometry::{Point3, Pose};
    use crate::optics::Pixel;
    use crate::testing::Noise;
    use nalgebra::Rotation3;

    const NOISE_PX: f64 = 0.0025;
    const DRAWS: usize = 200;

    fn calibration() -> Calibration {
        Calibration {
            file: "calibration.toml".into(),
            id: None,
            rig: rig(),
            station_from_camera: None,
            covariance: None,
            quality: None,
        }
    }

    /// Cells of a curved body, 400 to 600 mm across, that `truth` lit and [`rig`] is held against; `smooth` (px) at
    /// the cell's place in the image, 0 to 1, and noise of what a cell is stated to have.
    fn cells(truth: &Rig, noise: &mut Noise, smooth: impl Fn(f64, f64) -> f64) -> Vec<EpipolarCell> {
        let (file, mut out) = (rig(), Vec::new());
        for j in 0..12 {
            for i in 0..16 {
                let (u, v) = (f64::from(i) / 15.0, f64::from(j) / 11.0);
                let pixel = Pixel::new(20.0 + 1256.0 * u, 20.0 + 932.0 * v);
                let ray = truth.camera.ray(&pixel).expect("inside");
                let lit = Point3::new(ray * (730.0 + 60.0 * (u - 0.4).powi(2) + 90.0 * v * v));
                let [column, row] =
                    [Axis::Column, Axis::Row].map(|a| projector_coordinate(truth, a, &lit).expect("lit"));
                let ray = file.camera.ray(&pixel).expect("inside");
                let off = epipolar_residual(&file, &ray, column, row).expect("they meet");
                let residual = off + smooth(u, v) + NOISE_PX.hypot(FLOOR_PX) * noise.gauss();
                out.push(EpipolarCell { index: [i, j], pixel, point: lit, residual, sigma: NOISE_PX });
            }
        }
        out
    }

    fn turned(vector: Vector3<f64>) -> Rig {
        let mut truth = rig();
        let relation = &mut truth.projector_from_camera;
        relation.r *= Rotation3::new(vector);
        truth
    }

    fn gauss3(noise: &mut Noise, sigma: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| sigma * noise.gauss())
    }

    fn fringes(errors: &ParameterCovariance, cells: &[EpipolarCell]) -> Fringes {
        Fringes::new(&calibration(), errors, Axis::Column, cells).expect("enough cells")
    }

    #[test]
    fn a_turn_is_found_and_its_sigma_is_that_of_a_monte_carlo_run() {
        let mut noise = Noise::new(1);
        let mut over = Vector3::zeros();
        for _ in 0..DRAWS {
            let truth = gauss3(&mut noise, f64::to_radians(0.02));
            let got = fringes(&ParameterCovariance::zeros(), &cells(&turned(truth), &mut noise, |_, _| 0.0)).turn;
            let z = (got.vector - truth).component_div(&got.covariance.diagonal().map(f64::sqrt));
            over += z.component_mul(&z) / DRAWS as f64;
        }
        // the mean square of 200 draws scatters by 0.1; biweights state 2 % too much, and 0.01° is not quite linear
        assert!(over.iter().all(|z| (0.65..1.35).contains(z)), "{over}");
    }

    /// A healthy rig differs from its file by what mounts do and by what the file's covariance says.
    #[test]
    fn the_index_of_healthy_rigs_is_one() {
        let errors = independent_errors(&stated());
        for errors in [ParameterCovariance::zeros(), errors] {
            let mut noise = Noise::new(2);
            let (mut mean, mut most) = (0.0, 0.0);
            for _ in 0..DRAWS {
                let off = errors * SVector::<f64, 24>::from_fn(|_, _| noise.gauss());
                let mut truth = (0..24).fold(turned(gauss3(&mut noise, DRIFT_RAD)), |rig, k| changed(&rig, k, off[k]));
                let t = truth.projector_from_camera.t;
                truth.projector_from_camera.t += gauss3(&mut noise, DRIFT_RAD) * t.norm();
                let index = fringes(&errors, &cells(&truth, &mut noise, |_, _| 0.0)).index;
                mean += index * index / DRAWS as f64;
                most = f64::max(most, index);
            }
            assert!((0.85..1.15).contains(&mean), "{mean}"); // 200 draws of five: 0.045
            assert!(most < MAX_INDEX, "{most}");
        }
    }

    #[test]
    fn a_bumped_camera_shows_about_every_axis() {
        for axis in 0..3 {
            for deg in [0.02, -0.02, 0.05, -0.05] {
                let truth = Vector3::ith(axis, f64::to_radians(deg));
                let cells = cells(&turned(truth), &mut Noise::new(3), |_, _| 0.0);
                let health = Health::new(&calibration(), &ParameterCovariance::zeros(), Axis::Column, &cells, &[]);
                let health = health.expect("enough cells");
                assert!(!health.healthy && health.index > 2.0 * MAX_INDEX, "{deg}° about {axis}: {}", health.detail);
                let about = format!("{deg:+.4}° ± ");
                let (found, named) = (health.turn.expect("unhealthy").vector, ["x", "y", "z"][axis]);
                assert!((found - truth).amax() < f64::to_radians(0.002), "{deg}° about {axis}: {found}");
                assert!(health.detail.contains(&format!("about {named} against")), "{about} {}", health.detail);
            }
        }
    }

    /// What lenses and fringes leave without a motion is found in the residuals themselves.
    #[test]
    fn a_smooth_misfit_makes_sigmas_larger_and_no_alarm() {
        let mut noise = Noise::new(4);
        let (mut alarms, mut over) = (0, 0.0);
        for _ in 0..DRAWS {
            let (a, b) = (6.3 * noise.uniform(), 6.3 * noise.uniform());
            let wave = |u: f64, v: f64| 0.02 * ((9.0 * u + a).sin() * (7.0 * v + b).cos());
            let got = fringes(&ParameterCovariance::zeros(), &cells(&rig(), &mut noise, wave));
            alarms += usize::from(got.index > MAX_INDEX);
            let z = got.turn.vector.component_div(&got.turn.covariance.diagonal().map(f64::sqrt));
            over += z.norm_squared() / 3.0 / DRAWS as f64;
        }
        assert!(alarms <= DRAWS / 50, "{alarms} of {DRAWS}");
        assert!(over < 2.0, "{over}");
    }

    fn known(size: f64, noise: &mut Noise, errors: &ParameterCovariance) -> Vec<Known> {
        let pose = Pose::<frame::Camera, frame::Vehicle>::new(
            Rotation3::from_euler_angles(1.6, 0.02, 3.1),
            Vector3::new(-2645.0, 777.0, 1656.0),
        );
        let seen = [[-140.3, 140.6, 745.2], [164.3, 139.1, 735.4], [7.6, -58.0, 739.8], [24.4, 106.8, 735.7]];
        let known = |p: [f64; 3]| {
            let (p, sigmas) = (Vector3::from(p), Vector3::new(0.03, 0.04, 0.01));
            let response = Sensitivity::new(&rig(), Axis::Column, &Point3::new(p)).expect("in front").point;
            Known {
                pair: Pair {
                    measured: Point3::new(p * (1.0 + size) + gauss3(noise, 1.0).component_mul(&sigmas)),
                    nominal: pose.inverse() * Point3::new(p),
                    covariance: Matrix3::from_diagonal(&sigmas.component_mul(&sigmas)),
                },
                spread: response * errors,
            }
        };
        seen.map(known).to_vec()
    }

    #[test]
    fn a_longer_baseline_shows_in_lengths_and_not_in_fringes() {
        let mut longer = rig();
        longer.projector_from_camera.t *= 1.001;
        let none = ParameterCovariance::zeros();
        let [healthy, long] =
            [rig(), longer].map(|truth| fringes(&none, &cells(&truth, &mut Noise::new(5), |_, _| 0.0)));
        assert!((healthy.index - long.index).abs() < 1e-3, "{} {}", healthy.index, long.index);
        let cells = cells(&rig(), &mut Noise::new(5), |_, _| 0.0);
        for size in [0.001, -0.001] {
            let known = known(size, &mut Noise::new(6), &none);
            let health = Health::new(&calibration(), &none, Axis::Column, &cells, &known).expect("enough cells");
            assert!(!health.healthy && health.turn.is_none() && health.index > MAX_INDEX, "{}", health.detail);
            assert!((health.size.expect("unhealthy") - size).abs() < 4e-4, "{}", health.detail);
            assert!(health.detail.contains("lengths"), "{}", health.detail);
            // a calibration that does not know its baseline to 0.1 % is not at fault
            let mut loose = ParameterCovariance::zeros();
            loose
                .fixed_view_mut::<3, 3>(21, 21)
                .copy_from(&(rig().projector_from_camera.t * rig().projector_from_camera.t.transpose() * 1e-6));
            let loose = independent_errors(&loose);
            let known = self::known(size, &mut Noise::new(6), &loose);
            let health = Health::new(&calibration(), &loose, Axis::Column, &cells, &known).expect("enough cells");
            assert!(health.healthy, "{}", health.detail);
        }
    }

    #[test]
    fn the_scale_and_its_sigma_are_those_of_a_monte_carlo_run() {
        let (mut noise, mut over) = (Noise::new(8), 0.0);
        for _ in 0..2000 {
            let (s, sigma) = scale(&known(0.001, &mut noise, &ParameterCovariance::zeros())).expect("four points");
            over += (s - 0.001).powi(2) / (sigma * sigma - SIZE_BIAS * SIZE_BIAS) / 2000.0;
        }
        assert!((0.9..1.1).contains(&over), "{over}"); // 2000 draws: 0.03
    }

    #[test]
    fn the_sentence_says_what_is_known() {
        let (none, cells) = (ParameterCovariance::zeros(), cells(&rig(), &mut Noise::new(5), |_, _| 0.0));
        let health = Health::new(&calibration(), &none, Axis::Column, &cells, &[]).expect("enough cells");
        let said = "calibration health: epipolar 0.004 px, scale unknown, index 0.2 of 3: healthy";
        assert_eq!((health.detail.as_str(), health.scale_percent, health.healthy), (said, None, true));
        assert_eq!(Health::new(&calibration(), &none, Axis::Column, &cells[..MIN_CELLS - 1], &[]), None);
        // noise of fringes that belong to nothing
        let mut noise = Noise::new(9);
        let wild: Vec<_> = cells.iter().map(|c| EpipolarCell { residual: 6.0 * noise.gauss(), ..*c }).collect();
        let health = Health::new(&calibration(), &none, Axis::Column, &wild, &[]).expect("enough cells");
        assert!(!health.healthy && health.detail.ends_with("verify"), "{}", health.detail);
    }
}
