//! Rigid registration of many distances at once: contour points to a curve, surface points to a plane.
//! In:  distances along known directions, each with its variance, and the biases that several of them share, each with
//! its prior sigma. Out: the small motion that explains them, its covariance, the biases.
//! Not here: which point belongs to which place; what the biases are.
//!
//! Point-to-tangent distances: Chen, Medioni, Image and Vision Computing 10 (1992) 145; Tukey weights. Biases are
//! unknowns with a prior (mixed model), so that what they may have done is in the covariance. Neighbouring distances are
//! not independent: their sums over blocks scatter more than their own scatter explains, and by that much the information
//! of the whole group is less (batch means; Law, Kelton, "Simulation Modeling and Analysis", McGraw-Hill 2000, §9.5.3).

use super::Pose;
use super::robust::{mad_sigma, weigh};
use crate::lent::List;
use nalgebra::{DMatrix, DVector, Matrix3xX, Matrix6, Rotation3, SMatrix, Vector3, Vector6};

/// Biases that one distance may share.
pub const MAX_SHARED: usize = 10;

/// How far one point lies from where it should, along one direction.
#[derive(Clone, Debug)]
pub struct Distance {
    /// The point in the moving frame, mm.
    pub at: Vector3<f64>,
    /// Unit vector in that frame.
    pub direction: Vector3<f64>,
    /// As measured, less as it should be, along `direction`, mm.
    pub mm: f64,
    /// Of `mm` from noise, mm².
    pub variance: f64,
    /// Distances of one group are scattered alike.
    pub group: usize,
    /// Distances of one block, of no other group, may be correlated.
    pub block: u32,
    /// The part of the body that it belongs to.
    pub part: usize,
    /// Biases it shares, by index, and how much of each it has.
    pub shared: heapless::Vec<(usize, f64), MAX_SHARED>,
}

/// The motion that explains distances.
#[derive(Clone, Debug)]
pub struct Joint {
    /// Translation (mm) of the point about which was registered, rotation vector (rad).
    pub motion: Vector6<f64>,
    /// Of the motion's error: noise with its correlation, and the biases.
    pub covariance: Matrix6<f64>,
    /// As far as the distances tell them, mm.
    pub biases: DVector<f64>,
    /// Σ (bias over its prior sigma)².
    pub biases_chi2: f64,
    /// By how much more the mean of each group is uncertain (variance) than independent distances of the stated
    /// variance would leave it; at least 1.
    pub inflation: List<f64>,
    /// Distances that have weight, of each group.
    pub used: List<usize>,
    /// The motion that a shift (mm, moving frame) of all points of each part alone would make.
    pub gain: List<SMatrix<f64, 6, 3>>,
}

impl Joint {
    /// `pose` after the motion about `at`.
    pub fn applied<A, B>(&self, pose: &Pose<A, B>, at: &Vector3<f64>) -> Pose<A, B> {
        let m = &self.motion;
        let turn = Rotation3::new(m.fixed_rows::<3>(3).into_owned());
        *pose * Pose::<B, B>::new(turn, at + m.fixed_rows::<3>(0) - turn * at)
    }
}

/// Rounds of weighting; they have settled long before.
const ROUNDS: usize = 40;

/// Registers `distances` by a small motion about `at`; `priors`: the sigmas of the biases, mm. `None` where the distances
/// fix no motion. Groups and parts are counted from 0.
pub fn register_jointly(distances: &[Distance], priors: &[f64], at: &Vector3<f64>) -> Option<Joint> {
    let unknowns = 6 + priors.len();
    let groups = distances.iter().map(|d| d.group + 1).max()?;
    let parts = distances.iter().map(|d| d.part + 1).max()?;
    let rows = List::of(distances.iter().map(|d| motion_row(d, at)));
    let of_group = |g: usize| List::of((0..distances.len()).filter(|&k| distances[k].group == g));
    let members = List::of((0..groups).map(of_group));
    let mut x = DVector::<f64>::zeros(unknowns);
    let mut inflation = List::filled(1.0, groups);
    for round in 0..ROUNDS {
        let off = |(d, row): (&Distance, &Vector6<f64>)| (d.mm - expected(d, row, &x)) / d.variance.sqrt();
        let over = List::of(distances.iter().zip(&rows).map(off));
        let mut weights = List::filled(0.0, distances.len());
        let mut scatter = List::filled(0.0, groups);
        for (members, scatter) in members.iter().zip(&mut scatter) {
            let of_group = List::of(members.iter().map(|&k| over[k]));
            members.iter().zip(&weigh(&of_group).0).for_each(|(&k, w)| weights[k] = *w);
            *scatter = mad_sigma(of_group.iter().copied()); // which may be less than the stated sigmas promise
        }
        let mut of_group = vec![DMatrix::<f64>::zeros(unknowns, unknowns); groups];
        let mut right = DVector::zeros(unknowns);
        for ((d, row), weight) in distances.iter().zip(&rows).zip(&weights).filter(|(_, w)| **w > 0.0) {
            let precision = weight / d.variance;
            let terms = || (0..6).map(|i| (i, row[i])).chain(d.shared.iter().map(|(i, share)| (6 + i, *share)));
            for (i, a) in terms() {
                right[i] += a * d.mm * precision / inflation[d.group];
                for (j, b) in terms() {
                    of_group[d.group][(i, j)] += a * b * precision;
                }
            }
        }
        let mut normal = DMatrix::zeros(unknowns, unknowns);
        for (of_group, inflation) in of_group.iter().zip(&inflation) {
            normal += of_group / *inflation;
        }
        for (k, sigma) in priors.iter().enumerate() {
            normal[(6 + k, 6 + k)] += 1.0 / (sigma * sigma);
        }
        let inverse = normal.cholesky()?.inverse();
        let next = &inverse * right;
        let step = (&next - &x).amax();
        x = next;
        let before = inflation.clone();
        for g in 0..groups {
            // what of the scatter the fit has taken for motion and biases
            let taken = (&inverse * &of_group[g]).trace() / inflation[g];
            let over = |k: usize| {
                let d = &distances[k];
                weights[k] * (d.mm - expected(d, &rows[k], &x)) / d.variance.sqrt()
            };
            inflation[g] = (scatter[g].powi(2) * correlation(&members[g], distances, over, taken)).max(1.0);
        }
        let settled = step < 1e-7 && inflation.iter().zip(&before).all(|(a, b)| (a / b - 1.0).abs() < 1e-3);
        if settled || round + 1 == ROUNDS {
            let mut pull = vec![Matrix3xX::<f64>::zeros(unknowns); parts];
            for ((d, row), weight) in distances.iter().zip(&rows).zip(&weights).filter(|(_, w)| **w > 0.0) {
                let precision = weight / d.variance / inflation[d.group];
                let pull = &mut pull[d.part];
                for (i, a) in (0..6).map(|i| (i, row[i])).chain(d.shared.iter().map(|(i, share)| (6 + i, *share))) {
                    let mut column = pull.column_mut(i);
                    column += d.direction * (a * precision);
                }
            }
            let gain = |pull: &Matrix3xX<f64>| {
                (inverse.fixed_rows::<6>(0) * pull.transpose()).fixed_columns::<3>(0).into_owned()
            };
            let biases = x.rows(6, priors.len()).into_owned();
            return Some(Joint {
                motion: x.fixed_rows::<6>(0).into_owned(),
                covariance: inverse.fixed_view::<6, 6>(0, 0).into_owned(),
                biases_chi2: biases.iter().zip(priors).map(|(b, sigma)| (b / sigma).powi(2)).sum(),
                biases,
                inflation,
                used: List::of(members.iter().map(|m| m.iter().filter(|&&k| weights[k] > 0.0).count())),
                gain: List::of(pull.iter().map(gain)),
            });
        }
    }
    None
}

/// ∂ distance / ∂ motion about `at`.
fn motion_row(d: &Distance, at: &Vector3<f64>) -> Vector6<f64> {
    let turn = (d.at - at).cross(&d.direction);
    let n = &d.direction;
    Vector6::new(n.x, n.y, n.z, turn.x, turn.y, turn.z)
}

fn expected(d: &Distance, row: &Vector6<f64>, x: &DVector<f64>) -> f64 {
    row.dot(&x.fixed_rows::<6>(0)) + d.shared.iter().map(|(i, share)| share * x[6 + i]).sum::<f64>()
}

/// Variance of the blocks' sums over that of as many independent values: 1 where neighbours know nothing of each other.
/// `taken`: of how many degrees of freedom the fit has robbed the values.
fn correlation(members: &[usize], distances: &[Distance], value: impl Fn(usize) -> f64, taken: f64) -> f64 {
    let mut values = List::of(members.iter().map(|&k| (distances[k].block, value(k))));
    values.retain(|(_, v)| *v != 0.0);
    values.sort_by_key(|(block, _)| *block);
    let (mut blocks, mut of_sums, mut of_values) = (0.0, 0.0, 0.0);
    for block in values.chunk_by(|a, b| a.0 == b.0) {
        blocks += 1.0;
        of_sums += block.iter().map(|(_, v)| v).sum::<f64>().powi(2);
        of_values += block.iter().map(|(_, v)| v * v).sum::<f64>();
    }
    if of_values <= 0.0 {
        return 1.0;
    }
    let left = (blocks - taken).max(0.25 * blocks);
    of_sums / of_values * blocks / left
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Noise;

    /// Of the two biases of each part: its contour along the first axis, its surface in height.
    const PRIORS: [f64; 6] = [0.02, 0.004, 0.02, 0.004, 0.02, 0.004];
    const SIGMA: [f64; 2] = [0.03, 0.05];

    /// How values along a contour or over a surface go together.
    #[derive(Clone, Copy, Debug)]
    enum Scatter {
        None,
        Independent,
        /// Each is the mean of five neighbours, along a contour, or three by three, on a surface.
        Neighbours,
    }

    /// A ring and two angles on a curved panel, each with its surface about it, as they look after `motion` about `at`.
    fn scene(motion: &Vector6<f64>, at: &Vector3<f64>, scatter: Scatter, noise: &mut Noise) -> Vec<Distance> {
        let mut distances = Vec::new();
        let places = [[-150.0, 10.0, -70.0], [150.0, 14.0, -60.0], [0.0, 0.0, 120.0]];
        for (part, place) in places.into_iter().enumerate() {
            let biases = [PRIORS[2 * part] * noise.gauss(), PRIORS[2 * part + 1] * noise.gauss()];
            let mut push = |d: Distance, off: f64| {
                let own = d.shared.iter().map(|(k, share)| share * biases[*k % 2]).sum::<f64>();
                let own = if matches!(scatter, Scatter::None) { 0.0 } else { own };
                let mm = motion_row(&d, at).dot(motion) + own + off;
                distances.push(Distance { mm, ..d });
            };
            let place = Vector3::from(place);
            let n = 240;
            let white: Vec<f64> = (0..n + 4).map(|_| noise.gauss()).collect();
            for k in 0..n {
                let way = k as f64 / n as f64;
                let (along, normal) = if part == 2 {
                    let (sin, cos) = (way * std::f64::consts::TAU).sin_cos();
                    ([75.0 * cos, 75.0 * sin], [cos, sin])
                } else if way < 0.5 {
                    ([80.0 * way, 0.0], [0.0, 1.0])
                } else {
                    ([0.0, 80.0 * (way - 0.5)], [1.0, 0.0])
                };
                let off = match scatter {
                    Scatter::None => 0.0,
                    Scatter::Independent => white[k],
                    Scatter::Neighbours => white[k..k + 5].iter().sum::<f64>() / 5f64.sqrt(),
                };
                let d = Distance {
                    at: place + Vector3::new(along[0], 0.0, along[1]),
                    direction: Vector3::new(normal[0], 0.0, normal[1]),
                    mm: 0.0,
                    variance: SIGMA[0].powi(2),
                    group: 0,
                    block: (part * 1000 + k / 20) as u32,
                    part,
                    shared: [(2 * part, normal[0])].into_iter().collect(),
                };
                push(d, SIGMA[0] * off);
            }
            let side = 32;
            let white: Vec<f64> = (0..(side + 2) * (side + 2)).map(|_| noise.gauss()).collect();
            for k in 0..side * side {
                let (i, j) = (k % side, k / side);
                let off = match scatter {
                    Scatter::None => 0.0,
                    Scatter::Independent => white[j * (side + 2) + i],
                    Scatter::Neighbours => {
                        (0..9).map(|m| white[(j + m / 3) * (side + 2) + i + m % 3]).sum::<f64>() / 3.0
                    }
                };
                let local = [i, j].map(|v| 3.0 * (v as f64 - 15.5));
                let d = Distance {
                    at: place + Vector3::new(local[0], 0.0, local[1]),
                    direction: Vector3::new(local[0] / 900.0, 1.0, local[1] / 2000.0).normalize(),
                    mm: 0.0,
                    variance: SIGMA[1].powi(2),
                    group: 1,
                    block: (part * 1000 + 500 + j / 8 * 4 + i / 8) as u32,
                    part,
                    shared: [(2 * part + 1, 1.0)].into_iter().collect(),
                };
                push(d, SIGMA[1] * off);
            }
        }
        distances
    }

    const AT: Vector3<f64> = Vector3::new(0.0, 8.0, -3.0);
    const MOTION: [f64; 6] = [0.11, -0.06, 0.08, 4e-4, -3e-4, 5e-4];

    #[test]
    fn a_planted_motion_is_recovered_among_outliers() {
        let mut distances = scene(&MOTION.into(), &AT, Scatter::None, &mut Noise::new(1));
        let got = register_jointly(&distances, &PRIORS, &AT).expect("three parts");
        assert!((got.motion - Vector6::from(MOTION)).amax() < 1e-9 && got.biases.amax() < 1e-9, "{}", got.motion);
        assert_eq!(*got.inflation, [1.0, 1.0]);
        for d in distances.iter_mut().skip(2).step_by(7) {
            d.mm += 0.6;
        }
        let got = register_jointly(&distances, &PRIORS, &AT).expect("three parts");
        let off = got.motion - Vector6::from(MOTION);
        assert!(off.fixed_rows::<3>(0).amax() < 1e-3 && off.fixed_rows::<3>(3).amax() < 1e-5, "{off}");
        assert!(got.used.iter().zip([720, 3072]).all(|(used, of)| 7 * used <= 6 * of + 7), "{:?}", got.used);
    }

    #[test]
    fn the_covariance_is_that_of_a_monte_carlo_run_also_where_neighbours_go_together() {
        for scatter in [Scatter::Independent, Scatter::Neighbours] {
            let (mut noise, draws) = (Noise::new(3), 400);
            let (mut sampled, mut stated, mut inflation) = (Vector6::<f64>::zeros(), Vector6::zeros(), [0.0; 2]);
            for _ in 0..draws {
                let distances = scene(&MOTION.into(), &AT, scatter, &mut noise);
                let got = register_jointly(&distances, &PRIORS, &AT).expect("three parts");
                let off = got.motion - Vector6::from(MOTION);
                sampled += off.component_mul(&off) / f64::from(draws);
                stated += got.covariance.diagonal() / f64::from(draws);
                inflation.iter_mut().zip(&got.inflation).for_each(|(a, b)| *a += b / f64::from(draws));
            }
            let ratio = sampled.component_div(&stated).map(f64::sqrt);
            eprintln!("{scatter:?}: error over sigma {:.3?}, inflation {inflation:.2?}", ratio.as_slice());
            assert!(ratio.iter().all(|r| (0.87..1.13).contains(r)), "{scatter:?}: {ratio}"); // 400 draws: 3.5 %
            let expected = match scatter {
                Scatter::Independent => [1.0..1.3, 1.0..1.3],
                // five and nine in the limit of wide blocks
                _ => [3.5..5.5, 5.0..9.5],
            };
            assert!(inflation.iter().zip(&expected).all(|(i, e)| e.contains(i)), "{inflation:?}");
        }
    }

    #[test]
    fn what_shifts_all_parts_alike_shifts_the_pose() {
        let distances = scene(&MOTION.into(), &AT, Scatter::Independent, &mut Noise::new(4));
        let got = register_jointly(&distances, &PRIORS, &AT).expect("three parts");
        let response: SMatrix<f64, 6, 3> = got.gain.iter().sum();
        let expected = SMatrix::<f64, 6, 3>::identity();
        // what the biases may explain is left to them only where the whole is not
        assert!((response - expected).amax() < 0.06, "{response}");
    }

    #[test]
    fn a_plane_alone_fixes_no_motion() {
        let mut distances = scene(&MOTION.into(), &AT, Scatter::Independent, &mut Noise::new(5));
        distances.retain(|d| d.group == 1);
        distances.iter_mut().for_each(|d| d.direction = Vector3::y());
        assert!(register_jointly(&distances, &PRIORS, &AT).is_none());
        assert!(register_jointly(&[], &PRIORS, &AT).is_none());
    }
}
