//! Calibration files are replaced with care. In: a new calibration, where it is to be written. Out: the file, with the one
//! before beside it; or why the one before stays. Not here: making calibrations.

use super::file::{Calibration, CameraFile};
use super::{Board, Solution};
use crate::document::{self, Check};
use std::path::{Path, PathBuf};

/// A new calibration may be so much less certain than the one it replaces.
const LESS_CERTAIN: f64 = 1.2;
/// And leave residuals so much larger.
const LARGER_RESIDUALS: f64 = 1.5;
/// A baseline that changed by more, as a share, is a board of another pitch rather than another mount.
const OTHER_BASELINE: f64 = 0.02;

/// Why a calibration was not written.
#[derive(Debug, thiserror::Error)]
pub enum NotKept {
    /// Its file.
    #[error(transparent)]
    Document(#[from] document::Error),
    /// What is there is better.
    #[error(
        "{}: stays as it is: {reason}; the new one is in {}; --force replaces it", file.display(), refused.display()
    )]
    Worse {
        /// The one that stays.
        file: PathBuf,
        /// What speaks against the new one.
        reason: String,
        /// Where the new one is.
        refused: PathBuf,
    },
}

/// Writes `new` to `file`. What was there is kept beside it, and its path given back; unless `force`, a calibration that is
/// worse than it goes to `….refused.toml` instead. A datum survey of the one before is not carried over: the new camera
/// coordinates are others.
pub fn keep(file: &Path, new: &Calibration, force: bool) -> Result<Option<PathBuf>, NotKept> {
    let reason = if force || !file.exists() { None } else { worse(&Calibration::read(file)?, new) };
    if let Some(reason) = reason {
        let refused = file.with_extension("refused.toml");
        new.write(&refused)?;
        return Err(NotKept::Worse { file: file.into(), reason, refused });
    }
    let old = set_aside(file)?;
    new.write(file)?;
    Ok(old)
}

/// The same for a camera alone. It never replaces a calibration of a whole rig, unless `force`.
pub fn keep_camera(
    file: &Path,
    new: &Solution,
    board: Option<&Board>,
    force: bool,
) -> Result<Option<PathBuf>, NotKept> {
    let camera = CameraFile::new(new, board);
    if !force && file.exists() {
        let whole = Calibration::read(file).is_ok();
        let allowed = "a file of `datum calibrate camera`: one of camera and projector is replaced only with --force";
        Check(file).that(!whole, "[projector]", "a calibrated one", allowed)?;
        let before = CameraFile::read(file)?;
        let larger = before.rms_px().zip(camera.rms_px()).filter(|(was, is)| *is > LARGER_RESIDUALS * *was);
        if let Some((was, is)) = larger {
            let refused = file.with_extension("refused.toml");
            camera.write(&refused)?;
            let reason = format!("it has {was:.3} px rms, the new one {is:.3} px");
            return Err(NotKept::Worse { file: file.into(), reason, refused });
        }
    }
    let old = set_aside(file)?;
    camera.write(file)?;
    Ok(old)
}

/// What speaks against replacing `old` by `new`.
fn worse(old: &Calibration, new: &Calibration) -> Option<String> {
    let [was, is] = [old, new].map(|c| c.rig.projector_from_camera.t.norm());
    if (is / was - 1.0).abs() > OTHER_BASELINE {
        return Some(format!(
            "its baseline is {was:.1} mm, the new one's {is:.1} mm: is --board's pitch right, and was camera or \
             projector moved?"
        ));
    }
    let of = |c: &Calibration| {
        let q = c.quality.clone().unwrap_or_default();
        (q.scale_sigma_percent, q.rms_px.and_then(|r| r.joint))
    };
    let (was, is) = (of(old), of(new));
    let exceeds = |was: Option<f64>, is: Option<f64>, by: f64| was.zip(is).filter(|(w, i)| *i > by * *w);
    if let Some((w, i)) = exceeds(was.0, is.0, LESS_CERTAIN) {
        return Some(format!("it knows lengths to {w:.4} % (1 sigma), the new one to {i:.4} %"));
    }
    exceeds(was.1, is.1, LARGER_RESIDUALS).map(|(w, i)| format!("it has {w:.3} px rms, the new one {i:.3} px"))
}

/// Copies `file`, if there is one, to the first free `….old-N.toml`.
fn set_aside(file: &Path) -> Result<Option<PathBuf>, document::Error> {
    if !file.exists() {
        return Ok(None);
    }
    let bytes = document::read_bytes(file, 16 << 20)?;
    let free = (1u32..).map(|n| file.with_extension(format!("old-{n}.toml"))).find(|f| !f.exists());
    let old = free.expect("numbers do not end");
    document::write_bytes(&old, &bytes)?;
    Ok(Some(old))
}
