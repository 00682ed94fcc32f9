//! Stored captures as experiments use them. In: their folders, how to measure them. Out: the measurements, with the true
//! poses where a truth.json lies beside the capture. Not here: what is made of them.

use super::error::CameraFromVehicle;
use super::{Error, Progress, Stored};
use crate::capture::Capture;
use crate::detect::{DEFAULT, Detector};
use crate::document;
use crate::geometry::{Pose, rotation_from_rows};
use crate::measure::{Measurement, Measurer, measure};
use nalgebra::Vector3;
use std::path::Path;

/// A truth.json holds a matrix and some points.
const MAX_BYTES: u64 = 1 << 20;

/// A capture's name, where its vehicle stood, and what was measured in each of some ways.
pub(super) type Measured<const N: usize> = (String, Option<CameraFromVehicle>, [Measurement; N]);

/// Measures every capture by the model, `made` ready in each of some ways.
pub(super) fn measured<const N: usize>(
    stored: &Stored,
    made: [&dyn Fn(Measurer) -> Measurer; N],
    progress: &dyn Progress,
) -> Result<Vec<Measured<N>>, Error> {
    let detector = Detector::named(Path::new(DEFAULT))?;
    let one = |folder: &std::path::PathBuf| {
        let capture = Capture::open(folder)?;
        let (c, p) = (&capture.camera, &capture.projector);
        let calibration = stored.calibration.for_sizes((c.width, c.height), (p.width, p.height), false)?;
        let mut measurements = Vec::new();
        for made in made {
            let measurer = Measurer::new(calibration.clone(), stored.vehicle.clone())?;
            let measurer = made(measurer.with_detector(detector.clone()));
            measurements.push(measure(&measurer, &capture, &mut |_| ())?.0);
        }
        progress.step();
        let measurements = measurements.try_into().expect("one of each way");
        Ok((capture.name(), truth(folder)?, measurements))
    };
    stored.captures.iter().map(one).collect()
}

/// Where the vehicle of the capture in `folder` stood, if its truth.json says so.
fn truth(folder: &Path) -> Result<Option<CameraFromVehicle>, Error> {
    let file = folder.join("truth.json");
    if !file.exists() {
        return Ok(None);
    }
    let wrong =
        |wrong: Box<dyn std::error::Error + Send + Sync>| document::Error::Content { file: file.clone(), wrong };
    let value: serde_json::Value =
        serde_json::from_slice(&document::read_bytes(&file, MAX_BYTES)?).map_err(|e| wrong(e.into()))?;
    let number = |i: usize, j: usize| value["camera_from_object"][i][j].as_f64();
    let mut rows = [[f64::NAN; 4]; 3];
    for (i, row) in rows.iter_mut().enumerate() {
        for (j, v) in row.iter_mut().enumerate() {
            *v = number(i, j).unwrap_or(f64::NAN);
        }
    }
    let rotation = rotation_from_rows(rows.map(|[a, b, c, _]| [a, b, c]));
    let (Some(r), true) = (rotation, rows.iter().all(|row| row[3].is_finite())) else {
        return Err(
            wrong("camera_from_object is no pose, allowed: a rotation and a translation in mm, 4 × 4".into()).into()
        );
    };
    Ok(Some(Pose::new(r, Vector3::from(rows.map(|row| row[3])))))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_truth_is_read_is_none_or_is_refused_by_name() {
        let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
        let stands = truth(&station.join("moved")).expect("test data").expect("there");
        assert!((stands.t.norm() - 3000.0).abs() < 1500.0, "{stands:?}");
        assert!(truth(&station).expect("none is no error").is_none());
        let folder = std::env::temp_dir().join(format!("datum-truth-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("writable");
        std::fs::write(folder.join("truth.json"), r#"{"camera_from_object": [[1, 0, 0, 5]]}"#).expect("writable");
        let e = truth(&folder).expect_err("two rows are missing").to_string();
        std::fs::remove_dir_all(&folder).expect("writable");
        assert!(e.contains("truth.json: camera_from_object is no pose"), "{e}");
    }
}
