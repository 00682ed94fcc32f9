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

/// What one board says of the calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// Whether all is within the limits.
    pub ok: bool,
    /// By how much lengths come out larger than they are, %.
    pub scale_error_percent: f64,
    /// Its standard deviation from the points' scatter, %.
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
    /// What was allowed.
    pub limits: VerifyLimits,
    /// All of it in a sentence.
    pub detail: String,
    /// The board as triangulated.
    #[serde(skip)]
    pub board: BoardFit,
}

/// Verifies `rig` by the points of `board` that `camera` and `projector` see; a projector row may be NaN. `None` where too
/// few are seen by both.
pub fn verify(
    rig: &Rig,
    board: &Board,
    camera: &[Seen],
    projector: &[Seen],
    limits: VerifyLimits,
) -> Option<Verification> {
    let nominal = board.points();
    let measured = points(rig, camera, projector);
    let whole = fit(&nominal, &measured)?;
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
    let mut out = Verification {
        ok: scale_error_percent.abs() <= limits.scale_percent
            && whole.flatness_mm <= limits.flatness_mm
            && epipolar_px.is_none_or(|e| e <= limits.epipolar_px),
        scale_error_percent,
        scale_sigma_percent: 100.0 * along / square.sqrt(),
        flatness_mm: whole.flatness_mm,
        epipolar_px,
        reprojection_rms_px: reprojection(rig, board, &whole, camera, projector),
        frames_error_mm: frames(board, &measured).map(Into::into),
        limits,
        detail: String::new(),
        board: whole,
    };
    out.detail = out.sentence();
    Some(out)
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

/// From the left half's frame to the right half's: measured less true, along the left one's axes, mm.
fn frames(board: &Board, measured: &[(usize, Point3<frame::Camera>)]) -> Option<Vector3<f64>> {
    let nominal = board.points();
    let half = |right: bool| -> Vec<_> {
        let of_half = |k: usize| (2 * (k % board.columns) >= board.columns) == right;
        measured.iter().copied().filter(|p| of_half(p.0)).collect()
    };
    let (left, right) = (half(false), half(true));
    let [a, b] = [fit(&nominal, &left)?, fit(&nominal, &right)?].map(|f| f.camera_from_board);
    let middle = right.iter().map(|p| nominal[p.0]).sum::<Vector2<f64>>() / right.len() as f64;
    let at = Point3::new(middle.push(0.0));
    Some(a.r.inverse() * (b * at - a * at))
}

impl Verification {
    fn sentence(&self) -> String {
        let Self { scale_error_percent: scale, limits, .. } = self;
        let verdict = if self.ok { "The calibration holds" } else { "The calibration does not hold" };
        let way = if *scale >= 0.0 { "long" } else { "short" };
        let epipolar = self.epipolar_px.map_or("no row fringes to check the rows".into(), |e| {
            format!("the fringes meet to {e:.3} px (allowed {} px)", limits.epipolar_px)
        });
        let advice = if scale.abs() > WRONG_BOARD_PERCENT {
            " So much is rather another board: is --board's pitch right?"
        } else if self.ok {
            ""
        } else {
            " Calibrate anew before measuring."
        };
        format!(
            "{verdict}: lengths come out {:.3} % ± {:.3} % too {way} (allowed {} %), the board is flat to {:.3} mm \
             (allowed {} mm), {epipolar}.{advice}",
            scale.abs(),
            self.scale_sigma_percent,
            limits.scale_percent,
            self.flatness_mm,
            limits.flatness_mm,
        )
    }
}
