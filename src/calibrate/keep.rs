//! Calibration files are replaced with care. In: a new calibration, where it is to be written. Out: the file, with the one
//! before beside it; or why the one before stays. Not here: making calibrations.

use super::file::{Calibration, CameraFile, ParameterCovariance};
use super::{Board, Solution};
use crate::document::{self, Check};
use std::path::{Path, PathBuf};

/// A new calibration may be so much less certain than the one it replaces.
const LESS_CERTAIN: f64 = 1.2;
/// And leave residuals so much larger.
const LARGER_RESIDUALS: f64 = 1.5;
/// A baseline that changed by more, as a share and in sigmas of both, is a board of another pitch, or another mount.
const OTHER_BASELINE: (f64, f64) = (1e-3, 5.0);

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
    let reason = match Calibration::read(file) {
        _ if force || !file.exists() => None,
        Ok(old) => worse(&old, new),
        Err(e) => CameraFile::read(file).map(|_| None).map_err(|_| e)?, // a whole rig is more than a camera
    };
    if let Some(reason) = reason {
        let refused = file.with_extension("refused.toml");
        new.write(&refused)?;
        return Err(NotKept::Worse { file: file.into(), reason, refused });
    }
    let old = set_aside(file)?;
    new.write(file)?;
    Ok(old)
}

/// The same for a camera alone. It never replaces a calibration of a whole rig, nor one of more views or of another sensor,
/// unless `force`.
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
        if let Some(reason) = worse_camera(&CameraFile::read(file)?, &camera) {
            let refused = file.with_extension("refused.toml");
            camera.write(&refused)?;
            return Err(NotKept::Worse { file: file.into(), reason, refused });
        }
    }
    let old = set_aside(file)?;
    camera.write(file)?;
    Ok(old)
}

/// What speaks against replacing `old` by `new`.
fn worse(old: &Calibration, new: &Calibration) -> Option<String> {
    let quality = |c: &Calibration| {
        let q = c.quality.clone().unwrap_or_default();
        Some((q.views?, q.scale_sigma_percent?, q.rms_px?.joint?, **c.covariance.as_ref()?))
    };
    let Some((views, scale, rms, covariance)) = quality(old) else {
        return Some("it does not say how good it is, so it may be better".into());
    };
    let (new_views, new_scale, new_rms, new_covariance) = quality(new).expect("`datum calibrate` states all of it");
    let (was, is) = (old.rig.projector_from_camera.t, new.rig.projector_from_camera.t);
    let along = was.normalize();
    let variance = |c: &ParameterCovariance| (along.transpose() * c.fixed_view::<3, 3>(21, 21) * along)[0];
    let sigma = (variance(&covariance) + variance(&new_covariance)).sqrt() / was.norm();
    let (change, allowed) = (is.norm() / was.norm() - 1.0, OTHER_BASELINE.0.max(OTHER_BASELINE.1 * sigma));
    if change.abs() > allowed {
        return Some(format!(
            "its baseline is {:.2} mm, the new one's {:.2} mm ({:+.2} %, allowed {:.2} % either way): is --board's pitch \
             right, and was camera or projector moved?",
            was.norm(),
            is.norm(),
            100.0 * change,
            100.0 * allowed
        ));
    }
    let focal = |c: &Calibration, v: &ParameterCovariance| 100.0 * v[(0, 0)].sqrt() / c.rig.camera.fx;
    let (known, new_known) = (focal(old, &covariance), focal(new, &new_covariance));
    if new_views < views && new_known > known {
        return Some(format!("it has {views} views, the new one {new_views}"));
    }
    if new_known > LESS_CERTAIN * known {
        return Some(format!("it knows the focal length to {known:.4} % (1 sigma), the new one to {new_known:.4} %"));
    }
    if new_scale > LESS_CERTAIN * scale {
        return Some(format!("it knows lengths to {scale:.4} % (1 sigma), the new one to {new_scale:.4} %"));
    }
    (new_rms > LARGER_RESIDUALS * rms).then(|| format!("it has {rms:.3} px rms, the new one {new_rms:.3} px"))
}

fn worse_camera(old: &CameraFile, new: &CameraFile) -> Option<String> {
    let ((was, is), (w, h)) = ((old.size(), new.size()), old.size());
    if was != is {
        return Some(format!("it is of a sensor of {w}×{h} px, the new one of {}×{} px", is.0, is.1));
    }
    let (Some((views, rms)), Some((new_views, new_rms))) = (old.quality(), new.quality()) else {
        return Some("it does not say how good it is, so it may be better".into());
    };
    if new_views < views {
        return Some(format!("it has {views} views, the new one {new_views}"));
    }
    (new_rms > LARGER_RESIDUALS * rms).then(|| format!("it has {rms:.3} px rms, the new one {new_rms:.3} px"))
}

/// That `file` may be written: free, or a calibration, or `force`. To be asked before the work is done.
pub fn check_replaceable(file: &Path, force: bool) -> Result<(), document::Error> {
    if force || !file.exists() || Calibration::read(file).is_ok() || CameraFile::read(file).is_ok() {
        return Ok(());
    }
    let allowed = "a new file, or a calibration to replace (--force replaces any file, which is kept beside)";
    Check(file).that(false, "--out", "a file that is no calibration", allowed)
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
