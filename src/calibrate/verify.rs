//! Verification: one capture of a board against the calibration. In: what camera and projector see of it. Out: how much
//! too long lengths come out, how flat the board, how well fringes meet; and in a sentence whether that is good enough.
//! Not here: why a calibration is wrong.

use super::Board;
use super::adjust::Seen;
use super::triangulated::{BoardFit, fit, points};
use crate::fringe::epipolar_residual;
use crate::geometry::{Point3, frame};
use crate::optics::{Pixel, Rig};
use nalgebra::{Vector2, Vector3};
use serde::Serialize;

/// What is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct VerifyLimits {
    /// Of the scale error either way, %.
    pub scale_percent: f64,
    /// Of the flatness, mm.
    pub flatness_mm: f64,
    /// Of the epipolar residual, projector px.
    pub epipolar_px: f64,
}

impl Default for VerifyLimits {
    /// 0.1 % is 0.3 mm over the widest pair of features; the rest is three times what good boards and calibrations leave.
    fn default() -> Self {
        Self { scale_percent: 0.1, flatness_mm: 0.3, epipolar_px: 0.15 }
    }
}

/// A scale error so large is a wrong board rather than a wrong calibration, %.
const WRONG_BOARD_PERCENT: f64 = 2.0;
/// What the points of one board share, so that their number does not lessen it, 1 sigma, %: ten rendered boards under
/// their exact calibration scatter by so much, where the points' own scatter stated 0.0015 %.
const SCALE_FLOOR_PERCENT: f64 = 0.004;

/// Too little of the board has fringes for a verdict.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "only {points} of {of_points} points have valid fringes: too few to tell (half of them, from half of the board's \
     columns and rows, are needed)"
)]
pub struct TooFew {
    /// Points triangulated.
    pub points: usize,
    /// Points of the board.
    pub of_points: usize,
}

/// What one board says of the calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// Whether all is within the limits, and lengths are known well enough to say so.
    pub ok: bool,
    /// Points triangulated.
    pub points: usize,
    /// Points of the board.
    pub of_points: usize,
    /// By how much lengths come out larger than they are, %.
    pub scale_error_percent: f64,
    /// Its standard deviation, from the points' scatter and what they share, %.
    pub scale_sigma_percent: f64,
    /// Distance of points from the plane laid through them, root mean square, mm.
    pub flatness_mm: f64,
    /// Epipolar residual, root mean square, projector px; none without row fringes.
    pub epipolar_px: Option<f64>,
    /// Reprojection error of the board where it is triangulated, root mean square, px: camera, projector, both.
    pub reprojection_rms_px: [Option<f64>; 3],
    /// The published test: error of the way from a frame on the board's left half to one on its right half, along the
    /// axes of the left one, mm.
    pub frames_error_mm: Option<[f64; 3]>,
    /// The same of the turn from the one to the other, degrees about these axes.
    pub frames_error_deg: Option<[f64; 3]>,
    /// What was allowed.
    pub limits: VerifyLimits,
    /// All of it in a sentence.
    pub detail: String,
    /// The board as triangulated.
    #[serde(skip)]
    pub board: BoardFit,
}

/// Verifies `rig` by the points of `board` that `camera` and `projector` see; a projector row may be NaN. Errors where both
/// see less than half of the points, or of less than half of the columns or rows.
pub fn verify(
    rig: &Rig,
    board: &Board,
    camera: &[Seen],
    projector: &[Seen],
    limits: VerifyLimits,
) -> Result<Verification, TooFew> {
    let nominal = board.points();
    let measured = points(rig, camera, projector);
    let few = TooFew { points: measured.len(), of_points: nominal.len() };
    if 2 * few.points < few.of_points || !spans_half(board, &measured) {
        return Err(few);
    }
    let whole = fit(&nominal, &measured).ok_or(few)?;
    let n = measured.len() as f64;
    let middle = measured.iter().map(|p| nominal[p.0]).sum::<Vector2<f64>>() / n;
    let square: f64 = measured.iter().map(|p| (nominal[p.0] - middle).norm_squared()).sum();
    // of the scatter along the board, half of its two coordinates lies along each arm
    let along = ((whole.rms_mm.powi(2) - whole.flatness_mm.powi(2)) / 2.0).max(0.0).sqrt();
    let epipolar = |&(k, at): &Seen| {
        let lit = projector.iter().find(|p| p.0 == k)?.1;
        epipolar_residual(rig, &rig.camera.ray(&at)?, lit.x, lit.y).filter(|r| !r.is_nan())
    };
    let residuals: Vec<f64> = camera.iter().filter_map(epipolar).collect();
    let epipolar_px =
        (!residuals.is_empty()).then(|| (residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64).sqrt());
    let scale_error_percent = 100.0 * (whole.scale - 1.0);
    let frames = frames(board, &measured);
    let mut out = Verification {
        ok: false,
        points: few.points,
        of_points: few.of_points,
        scale_error_percent,
        scale_sigma_percent: (100.0 * along / square.sqrt()).hypot(SCALE_FLOOR_PERCENT),
        flatness_mm: whole.flatness_mm,
        epipolar_px,
        reprojection_rms_px: reprojection(rig, board, &whole, camera, projector),
        frames_error_mm: frames.map(|f| f.0.into()),
        frames_error_deg: frames.map(|f| f.1.map(f64::to_degrees).into()),
        limits,
        detail: String::new(),
        board: whole,
    };
    let verdict = out.verdict();
    out.ok = verdict == Verdict::Holds;
    out.detail = out.sentence(verdict);
    Ok(out)
}

/// Whether the points reach over half of the columns and half of the rows of `board`.
fn spans_half(board: &Board, measured: &[(usize, Point3<frame::Camera>)]) -> bool {
    let spans = |of: &dyn Fn(usize) -> usize, n: usize| {
        let reached = measured.iter().map(|p| of(p.0));
        reached.clone().max().zip(reached.min()).is_some_and(|(last, first)| 2 * (last - first + 1) >= n)
    };
    spans(&|k| k % board.columns, board.columns) && spans(&|k| k / board.columns, board.rows)
}

fn reprojection(rig: &Rig, board: &Board, fit: &BoardFit, camera: &[Seen], projector: &[Seen]) -> [Option<f64>; 3] {
    let nominal = board.points();
    let place = |k: usize| fit.camera_from_board * Point3::new(nominal[k].push(0.0));
    let off = |at: &Pixel, expected: Option<Pixel>| Some((at - expected?).norm_squared()).filter(|v| v.is_finite());
    let of_camera = camera.iter().filter_map(|(k, at)| off(at, rig.camera.project(&place(*k).xyz)));
    let lit = |k: usize| rig.projector.project(&(rig.projector_from_camera * place(k)).xyz);
    let of_projector = projector.iter().filter_map(|(k, at)| off(at, lit(*k)));
    let [a, b]: [Vec<f64>; 2] = [of_camera.collect(), of_projector.collect()];
    let both = [a.as_slice(), &b].concat();
    [a, b, both].map(|v| (!v.is_empty()).then(|| (v.iter().sum::<f64>() / v.len() as f64).sqrt()))
}

/// From the left half's frame to the right half's: measured less true, along the left one's axes, mm, and about them, rad.
fn frames(board: &Board, measured: &[(usize, Point3<frame::Camera>)]) -> Option<(Vector3<f64>, Vector3<f64>)> {
    let nominal = board.points();
    let half = |right: bool| -> Vec<_> {
        let of_half = |k: usize| (2 * (k % board.columns) >= board.columns) == right;
        measured.iter().copied().filter(|p| of_half(p.0)).collect()
    };
    let (left, right) = (half(false), half(true));
    let [a, b] = [fit(&nominal, &left)?, fit(&nominal, &right)?].map(|f| f.camera_from_board);
    let middle = right.iter().map(|p| nominal[p.0]).sum::<Vector2<f64>>() / right.len() as f64;
    let at = Point3::new(middle.push(0.0));
    Some((a.r.inverse() * (b * at - a * at), (a.r.inverse() * b.r).scaled_axis()))
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Verdict {
    Holds,
    Fails,
    /// Lengths are known too badly for their limit.
    CannotTell,
}

impl Verification {
    fn verdict(&self) -> Verdict {
        let (error, limits, doubt) = (self.scale_error_percent.abs(), &self.limits, 2.0 * self.scale_sigma_percent);
        let vague = doubt > limits.scale_percent;
        let beyond = error > limits.scale_percent + if vague { doubt } else { 0.0 };
        let uneven = self.flatness_mm > limits.flatness_mm;
        if beyond || uneven || self.epipolar_px.is_some_and(|e| e > limits.epipolar_px) {
            Verdict::Fails
        } else if vague {
            Verdict::CannotTell
        } else {
            Verdict::Holds
        }
    }

    fn sentence(&self, verdict: Verdict) -> String {
        let Self { scale_error_percent: scale, limits, .. } = self;
        let says = match verdict {
            Verdict::Holds => "The calibration holds",
            Verdict::Fails => "The calibration does not hold",
            Verdict::CannotTell => "Cannot tell whether the calibration holds",
        };
        let way = if *scale >= 0.0 { "long" } else { "short" };
        let epipolar = self.epipolar_px.map_or("the rows were not checked: no row fringes".into(), |e| {
            format!("the fringes meet to {e:.3} px (allowed {} px)", limits.epipolar_px)
        });
        let advice = match verdict {
            _ if scale.abs() > WRONG_BOARD_PERCENT => {
                " So much is rather another board: is --board's pitch right?".into()
            }
            Verdict::Holds => String::new(),
            Verdict::Fails => " Calibrate anew before measuring.".into(),
            Verdict::CannotTell => format!(
                " One board tells lengths to {:.3} % (2 sigma), which is more than is allowed.",
                2.0 * self.scale_sigma_percent
            ),
        };
        format!(
            "{says}: lengths come out {:.3} % ± {:.3} % too {way} (allowed {} %) over {} of {} points, the board is flat \
             to {:.3} mm (allowed {} mm), {epipolar}.{advice}",
            scale.abs(),
            self.scale_sigma_percent,
            limits.scale_percent,
            self.points,
            self.of_points,
            self.flatness_mm,
            limits.flatness_mm,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::testing::rig;
    use crate::geometry::Pose;
    use nalgebra::Rotation3;

    /// What an exact rig sees of a board 8 × 4, of which only the points `kept` are lit, with row fringes or without.
    fn verified(rows: bool, limits: VerifyLimits, kept: impl Fn(usize) -> bool) -> Result<Verification, TooFew> {
        let (rig, board): (Rig, Board) = (rig(), "marked:8x4:60:30".parse().expect("a board"));
        let r = Rotation3::from_euler_angles(0.1, -0.2, 0.02);
        let camera_from_board = Pose::<frame::Camera, frame::Board>::new(r, Vector3::new(-200.0, -90.0, 740.0));
        let places = board.points().into_iter().map(|p| camera_from_board * Point3::new(p.push(0.0))).enumerate();
        let of_projector = |p: Point3<frame::Camera>| {
            let lit = rig.projector.project(&(rig.projector_from_camera * p).xyz).expect("in front");
            if rows { lit } else { Pixel::new(lit.x, f64::NAN) }
        };
        let camera: Vec<Seen> =
            places.clone().map(|(k, p)| (k, rig.camera.project(&p.xyz).expect("in front"))).collect();
        let lit: Vec<Seen> = places.filter(|p| kept(p.0)).map(|(k, p)| (k, of_projector(p))).collect();
        verify(&rig, &board, &camera, &lit, limits)
    }

    #[test]
    fn a_verdict_states_its_points_and_the_sigma_its_floor() {
        let all = verified(true, VerifyLimits::default(), |k| k != 5).expect("enough");
        assert!(all.ok && all.detail.contains("31 of 32 points"), "{}", all.detail);
        assert!((all.scale_sigma_percent - SCALE_FLOOR_PERCENT).abs() < 1e-4, "{all:?}");
        let json = serde_json::to_value(&all).expect("plain");
        assert_eq!((json["points"].as_u64(), json["of_points"].as_u64()), (Some(31), Some(32)));
        let no_rows = verified(false, VerifyLimits::default(), |_| true).expect("enough");
        assert!(
            no_rows.ok && no_rows.detail.contains("the rows were not checked: no row fringes"),
            "{}",
            no_rows.detail
        );
    }

    #[test]
    fn a_limit_finer_than_one_board_tells_is_told() {
        let limits = VerifyLimits { scale_percent: 0.005, ..VerifyLimits::default() };
        let got = verified(true, limits, |_| true).expect("enough");
        assert!(!got.ok && got.detail.starts_with("Cannot tell whether the calibration holds"), "{}", got.detail);
        assert!(got.detail.contains("to 0.008 % (2 sigma), which is more than is allowed"), "{}", got.detail);
        // what fails anyhow does
        let limits = VerifyLimits { flatness_mm: 1e-15, ..limits };
        assert!(verified(true, limits, |_| true).expect("enough").detail.starts_with("The calibration does not hold"));
    }

    #[test]
    fn a_part_of_the_board_is_no_verdict() {
        let of = |kept: &dyn Fn(usize) -> bool| verified(true, VerifyLimits::default(), kept);
        let few = of(&|k| k < 15).expect_err("too few");
        assert_eq!(few, TooFew { points: 15, of_points: 32 });
        assert!(few.to_string().starts_with("only 15 of 32 points have valid fringes: too few to tell"), "{few}");
        assert!(of(&|k| k < 16).is_ok()); // two of four rows
        assert!(of(&|k| k % 8 < 4).is_ok()); // four of eight columns
    }

    #[test]
    fn half_of_the_columns_and_of_the_rows_are_needed() {
        let board: Board = "chessboard:9x6:45".parse().expect("a board");
        let reached = |kept: &dyn Fn(usize) -> bool| {
            let points: Vec<_> = (0..54).filter(|k| kept(*k)).map(|k| (k, Point3::new(Vector3::zeros()))).collect();
            spans_half(&board, &points)
        };
        assert!(reached(&|k| k % 9 < 5) && !reached(&|k| k % 9 < 4));
        assert!(reached(&|k| k / 9 > 2) && !reached(&|k| k / 9 > 3));
        assert!(!reached(&|_| false));
    }
}
