//! VERIFY: the reference artefact, a board that stands where it was put, against the calibration.
//! In: devices, what the configuration says of the artefact. Out: how far lengths and its place are off, or a code.
//! Not here: when it is due; what a board looks like (`calibrate`).

use super::config::ArtefactKeys;
use super::hardware::Hardware;
use crate::calibrate::target::find;
use crate::calibrate::{Board, Calibration, Lit, VerifyLimits, mean, verify};
use crate::capture::{Plan, RecordError, ShootError, record_while};
use crate::code::Code;
use crate::fringe::Axis;
use crate::geometry::{EulerDeg, Pose, frame};
use crate::plc::Verification;
use std::path::Path;

/// Both axes: a board tells the epipolar residual, too.
pub(super) const SETS: [(Axis, u32, u32); 6] = [
    (Axis::Column, 1, 4),
    (Axis::Column, 8, 4),
    (Axis::Column, 64, 4),
    (Axis::Row, 1, 4),
    (Axis::Row, 8, 4),
    (Axis::Row, 40, 4),
];

/// Why the artefact was not measured, or what it says against the calibration.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Failed {
    pub(super) code: Code,
    pub(super) said: String,
    pub(super) verification: Option<Verification>,
}

/// Measures the artefact, if `go_on` says so before each image; its images go through `folder`, which is emptied. Other pictures than the cycle's are loaded
/// afterwards.
pub(super) fn measure(
    hardware: &mut Hardware,
    artefact: &ArtefactKeys,
    calibration: &Calibration,
    folder: &Path,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Verification, Failed> {
    let failed = |code, said: String| Failed { code, said, verification: None };
    let board: Board =
        artefact.board.parse().map_err(|_| failed(Code::VerifyDatum, "no board is configured".into()))?;
    let plan = Plan { sets: SETS.to_vec(), repeat: false, ..Plan::default() };
    let recorded = record_while(&mut hardware.devices(), &plan, folder, go_on);
    let capture = recorded.map_err(|e| {
        let code = match &e {
            RecordError::Shoot(ShootError::Camera(_)) => Code::CameraLost,
            RecordError::Shoot(ShootError::Projector(_)) => Code::ProjectorSilent,
            RecordError::Shoot(ShootError::Lights(_)) => Code::LightFault,
            RecordError::Shoot(_) => Code::ImageMissing,
            _ => Code::StorageFault,
        };
        failed(code, e.to_string())
    })?;
    let seen = || -> Result<_, String> {
        let image = mean(&capture).map_err(|e| e.to_string())?;
        let sighting = find(&image, &board).map_err(|e| e.to_string())?;
        let camera = sighting.through(&board, &calibration.rig.camera).seen();
        let lit = Lit::read(&capture, &board, &camera).map_err(|e| e.to_string())?;
        let lit = lit.projector(&camera, &calibration.rig.camera);
        let limits = VerifyLimits { scale_percent: artefact.scale_percent, ..VerifyLimits::default() };
        verify(&calibration.rig, &board, &camera, &lit, limits).map_err(|e| e.to_string())
    };
    // an artefact that is not seen stands elsewhere
    let found = seen().map_err(|said| failed(Code::VerifyDatum, said));
    let _ = std::fs::remove_dir_all(folder); // only litter
    let found = found?;
    let place = calibration.station_from_camera.zip(artefact.position_mm).map(|(station_from_camera, position)| {
        let [roll, pitch, yaw] = artefact.angles_deg;
        let turn = EulerDeg { roll, pitch, yaw }.to_rotation();
        let should = Pose::<frame::Station, frame::Board>::new(turn, position.into());
        let is = station_from_camera * found.board.camera_from_board;
        let off: Pose<frame::Board, frame::Board> = should.inverse() * is;
        (off.t.norm(), off.r.angle().to_degrees())
    });
    let (shift_mm, tilt_deg) = place.unwrap_or_default();
    let verification = Verification { scale_error: found.scale_error_percent / 100.0, shift_mm, tilt_deg };
    let against = |code, said| Err(Failed { code, said, verification: Some(verification) });
    if !found.ok {
        return against(Code::VerifyScale, found.detail);
    }
    if shift_mm > artefact.shift_mm || tilt_deg > artefact.tilt_deg {
        let said = format!(
            "The artefact seems shifted by {shift_mm:.2} mm (allowed {}) and tilted by {tilt_deg:.3}° (allowed {}).",
            artefact.shift_mm, artefact.tilt_deg
        );
        return against(Code::VerifyDatum, said);
    }
    Ok(verification)
}
