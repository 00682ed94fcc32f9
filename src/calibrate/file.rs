//! calibration.toml: read, checked, written, and fitted to captures of another binning.

use super::{Board, Solution};
use crate::document::{self, Check, Error};
use crate::geometry::{Pose, frame, rotation_from_rows};
use crate::image::MAX_SIDE;
use crate::optics::{Lens, Rig};
use nalgebra::{SMatrix, Vector3};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// All calibrated parameters in the order of the covariance; r is the left rotation vector (rad) and t the
/// translation (mm) of `projector_from_camera`.
pub const PARAMETERS: [&str; 24] = [
    "camera.fx",
    "camera.fy",
    "camera.cx",
    "camera.cy",
    "camera.k1",
    "camera.k2",
    "camera.p1",
    "camera.p2",
    "camera.k3",
    "projector.fx",
    "projector.fy",
    "projector.cx",
    "projector.cy",
    "projector.k1",
    "projector.k2",
    "projector.p1",
    "projector.p2",
    "projector.k3",
    "rx",
    "ry",
    "rz",
    "tx",
    "ty",
    "tz",
];

/// Covariance of [`PARAMETERS`], in their units.
pub type ParameterCovariance = SMatrix<f64, 24, 24>;

/// How camera and projector see and how they stand to each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Calibration {
    /// Where it was read; names it in messages.
    pub file: PathBuf,
    /// Date and serial numbers, as `datum calibrate` wrote them.
    pub id: Option<String>,
    /// Lenses and their relation.
    pub rig: Rig,
    /// From the datum survey.
    pub station_from_camera: Option<Pose<frame::Station, frame::Camera>>,
    /// From `datum calibrate`; boxed, as it has 576 numbers.
    pub covariance: Option<Box<ParameterCovariance>>,
    /// How good it was.
    pub quality: Option<Quality>,
}

/// How good a calibration was when it was made.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Quality {
    /// Date.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// The board, as `datum calibrate --board` names it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub board: Option<String>,
    /// Views used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub views: Option<u32>,
    /// Standard deviation of lengths, %.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scale_sigma_percent: Option<f64>,
    /// Reprojection errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rms_px: Option<Rms>,
    /// Serial numbers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serials: Option<Serials>,
}

/// Root mean square reprojection errors, px.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Rms {
    /// Of the camera alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<f64>,
    /// Of the projector alone.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projector: Option<f64>,
    /// Of both, adjusted together.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub joint: Option<f64>,
}

/// Serial numbers.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct Serials {
    /// The camera's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// The projector's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projector: Option<String>,
}

/// The calibration of a camera alone, as `datum calibrate camera` writes it: a calibration file without the projector. No
/// capture can be measured with it.
#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct CameraFile {
    format: u32,
    camera: LensTable,
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<Quality>,
}

impl CameraFile {
    /// Of a solved calibration.
    pub fn new(solution: &Solution, board: Option<&Board>) -> Self {
        let rms_px = Some(Rms { camera: Some(solution.rms_px[0]), ..Rms::default() });
        let views = Some(solution.views.iter().filter(|v| v.used).count() as u32);
        let board = board.map(ToString::to_string);
        let quality = Some(Quality { board, views, rms_px, ..Quality::default() });
        Self { format: document::FORMAT, camera: lens_table(&solution.devices[0].lens), quality }
    }

    /// Reads and checks the file.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let camera: Self = document::read(file)?;
        lens(Check(file), "camera", &camera.camera)?;
        Ok(camera)
    }

    /// Writes `file`, whole or not at all.
    pub fn write(&self, file: &Path) -> Result<(), Error> {
        document::write(file, self)
    }

    /// Of the image, px.
    pub fn size(&self) -> (usize, usize) {
        (self.camera.width, self.camera.height)
    }

    /// The views it was made from and the reprojection error that they left, px.
    pub fn quality(&self) -> Option<(u32, f64)> {
        let q = self.quality.as_ref()?;
        Some((q.views?, q.rms_px.as_ref()?.camera?))
    }
}

/// The file as it is spelled.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Document {
    format: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<String>,
    camera: LensTable,
    projector: LensTable,
    projector_from_camera: PoseTable,
    #[serde(skip_serializing_if = "Option::is_none")]
    station_from_camera: Option<PoseTable>,
    #[serde(skip_serializing_if = "Option::is_none")]
    covariance: Option<CovarianceTable>,
    #[serde(skip_serializing_if = "Option::is_none")]
    quality: Option<Quality>,
}

#[derive(Debug, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct LensTable {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    distortion: [f64; 5],
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct PoseTable {
    rotation: [[f64; 3]; 3],
    translation_mm: [f64; 3],
}

#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct CovarianceTable {
    parameters: Vec<String>,
    values: Vec<Vec<f64>>,
}

impl Calibration {
    /// Reads and checks a calibration file.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let d: Document = document::read(file).or_else(|e| {
            let camera = CameraFile::read(file).is_ok();
            let allowed =
                "camera and projector: this is a file of `datum calibrate camera`, use `datum calibrate projector`";
            Check(file).that(!camera, "[projector]", "(missing)", allowed).and(Err(e))
        })?;
        let check = Check(file);
        let projector_from_camera = pose(check, "projector_from_camera", &d.projector_from_camera)?;
        let baseline = projector_from_camera.t.norm();
        check.that(
            (1.0..=1e5).contains(&baseline),
            "projector_from_camera.translation_mm",
            format!("{:?}", d.projector_from_camera.translation_mm),
            "a length of 1 to 100000 (are these millimetres?)",
        )?;
        let rig = Rig {
            camera: lens(check, "camera", &d.camera)?,
            projector: lens(check, "projector", &d.projector)?,
            projector_from_camera,
        };
        if let Some(q) = &d.quality {
            let rms = q.rms_px.clone().unwrap_or_default();
            for (key, value) in [
                ("quality.scale_sigma_percent", q.scale_sigma_percent),
                ("quality.rms_px.camera", rms.camera),
                ("quality.rms_px.projector", rms.projector),
                ("quality.rms_px.joint", rms.joint),
            ] {
                value.map_or(Ok(()), |v| check.not_negative(key, v))?;
            }
        }
        Ok(Self {
            file: file.into(),
            id: d.id,
            rig,
            station_from_camera: d.station_from_camera.map(|p| pose(check, "station_from_camera", &p)).transpose()?,
            covariance: d.covariance.map(|c| covariance(check, &c)).transpose()?,
            quality: d.quality,
        })
    }

    /// Writes the calibration to `file`, whole or not at all.
    pub fn write(&self, file: &Path) -> Result<(), Error> {
        let covariance = self.covariance.as_ref().map(|c| CovarianceTable {
            parameters: PARAMETERS.map(String::from).to_vec(),
            values: c.row_iter().map(|r| r.iter().copied().collect()).collect(),
        });
        let d = Document {
            format: document::FORMAT,
            id: self.id.clone(),
            camera: lens_table(&self.rig.camera),
            projector: lens_table(&self.rig.projector),
            projector_from_camera: table(&self.rig.projector_from_camera),
            station_from_camera: self.station_from_camera.as_ref().map(table),
            covariance,
            quality: self.quality.clone(),
        };
        document::write(file, &d)
    }

    /// Adds to the covariance that all lengths may be wrong by one share, 1 sigma: the pitch of the board they come from.
    /// Nothing where there is no covariance.
    pub fn add_scale_sigma(&mut self, share: f64) {
        let t = share * self.rig.projector_from_camera.t;
        if let Some(v) = &mut self.covariance {
            let mut shift = v.fixed_view_mut::<3, 3>(21, 21);
            shift += t * t.transpose();
        }
    }

    /// This calibration for captures whose camera and projector images have the given sizes (width, height).
    /// Equal sizes: as it is. A camera image smaller or larger by one common simple factor (binning): refused,
    /// unless `scale` allows it; then the camera's lens and its covariance are those of the binned sensor.
    pub fn for_sizes(&self, camera: (usize, usize), projector: (usize, usize), scale: bool) -> Result<Self, Error> {
        let check = Check(&self.file);
        let (c, p) = (&self.rig.camera, &self.rig.projector);
        check.that(
            (p.width, p.height) == projector,
            "projector.width × projector.height",
            format!("{}×{}", p.width, p.height),
            format!("the capture's, {}×{}", projector.0, projector.1),
        )?;
        if (c.width, c.height) == camera {
            return Ok(self.clone());
        }
        let factor = binning(c, camera);
        let mut allowed = format!("the capture's, {}×{}", camera.0, camera.1);
        if let Some(factor) = factor {
            allowed += &format!("; it is the same by a factor of {factor}: give --scale-calibration if it is binned");
        }
        let found = format!("{}×{}", c.width, c.height);
        check.that(scale && factor.is_some(), "camera.width × camera.height", found, allowed)?;
        let factor = factor.expect("checked just now");
        let mut scaled = self.clone();
        scaled.rig.camera = Lens { width: camera.0, height: camera.1, ..c.binned(factor) };
        if let Some(v) = &mut scaled.covariance {
            for i in 0..4 {
                v.row_mut(i).scale_mut(1.0 / factor); // fx, fy, cx, cy are in px
                v.column_mut(i).scale_mut(1.0 / factor);
            }
        }
        Ok(scaled)
    }
}

/// The factor p/q, p and q up to 8, by which `lens`'s sensor is larger than `size` both ways; what binning
/// leaves over at the border is less than a pixel.
fn binning(lens: &Lens, size: (usize, usize)) -> Option<f64> {
    let fits = |whole: usize, part: usize, f: f64| (whole as f64 / f - part as f64).abs() < 1.0;
    let factors = (1..=8).flat_map(|q| (1..=8).map(move |p| (f64::from(p), f64::from(q))));
    let factor = factors
        .map(|(p, q)| p / q)
        .filter(|&f| f != 1.0 && fits(lens.width, size.0, f) && fits(lens.height, size.1, f));
    let miss = |f: &f64| (lens.width as f64 / f - size.0 as f64).abs();
    factor.min_by(|a, b| miss(a).total_cmp(&miss(b)))
}

fn lens(check: Check, key: &str, t: &LensTable) -> Result<Lens, Error> {
    check.within(format!("{key}.width"), t.width, 1..=MAX_SIDE)?;
    check.within(format!("{key}.height"), t.height, 1..=MAX_SIDE)?;
    check.positive(format!("{key}.fx"), t.fx)?;
    check.positive(format!("{key}.fy"), t.fy)?;
    check.finite(format!("{key}.cx"), &[t.cx])?;
    check.finite(format!("{key}.cy"), &[t.cy])?;
    check.finite(format!("{key}.distortion"), &t.distortion)?;
    Ok(Lens { width: t.width, height: t.height, fx: t.fx, fy: t.fy, cx: t.cx, cy: t.cy, distortion: t.distortion })
}

fn lens_table(l: &Lens) -> LensTable {
    LensTable { width: l.width, height: l.height, fx: l.fx, fy: l.fy, cx: l.cx, cy: l.cy, distortion: l.distortion }
}

fn pose<A, B>(check: Check, key: &str, t: &PoseTable) -> Result<Pose<A, B>, Error> {
    let r = rotation_from_rows(t.rotation);
    let allowed = "a right-handed rotation matrix, row by row, to within 1e-4";
    check.that(r.is_some(), format!("{key}.rotation"), format!("{:?}", t.rotation), allowed)?;
    check.finite(format!("{key}.translation_mm"), &t.translation_mm)?;
    Ok(Pose::new(r.expect("checked just now"), Vector3::from(t.translation_mm)))
}

fn table<A, B>(p: &Pose<A, B>) -> PoseTable {
    let m = p.r.matrix();
    PoseTable { rotation: std::array::from_fn(|i| std::array::from_fn(|j| m[(i, j)])), translation_mm: p.t.into() }
}

fn covariance(check: Check, t: &CovarianceTable) -> Result<Box<ParameterCovariance>, Error> {
    let different = (0..t.parameters.len().max(PARAMETERS.len()))
        .find(|&i| t.parameters.get(i).map(String::as_str) != PARAMETERS.get(i).copied());
    if let Some(i) = different {
        let found = t.parameters.get(i).map_or("(missing)".into(), |p| format!("{p:?}"));
        let allowed = PARAMETERS.get(i).map_or("24 names, no more".into(), |p| format!("{p:?}"));
        check.that(false, format!("covariance.parameters[{i}]"), found, allowed)?;
    }
    check.that(
        t.values.len() == 24 && t.values.iter().all(|row| row.len() == 24),
        "covariance.values",
        format!("{} rows of {:?} numbers", t.values.len(), t.values.first().map_or(0, Vec::len)),
        "24 rows of 24 numbers",
    )?;
    let v = Box::new(ParameterCovariance::from_fn(|i, j| t.values[i][j]));
    for i in 0..24 {
        let key = |j: usize| format!("covariance.values[{i}][{j}]");
        check.not_negative(key(i), v[(i, i)])?;
        for j in 0..i {
            let (found, bound) = (v[(i, j)], (v[(i, i)] * v[(j, j)]).sqrt());
            let slack = 1e-6 * bound + f64::MIN_POSITIVE; // what rounding to a dozen digits leaves
            let symmetric = (found - v[(j, i)]).abs() <= slack;
            check.that(symmetric, key(j), found, format!("values[{j}][{i}] = {}: symmetric", v[(j, i)]))?;
            let ok = found.abs() <= bound + slack;
            check.that(ok, key(j), found, format!("at most {bound} either way: a correlation of ±1"))?;
        }
    }
    Ok(v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optics::Pixel;

    fn calibration() -> Calibration {
        let lens = |width, height, f| Lens {
            width,
            height,
            fx: f,
            fy: f + 1.0,
            cx: width as f64 / 2.0 + 3.0,
            cy: height as f64 / 2.0 - 4.0,
            distortion: [-0.08, 0.1, 0.0004, -0.0003, -0.02],
        };
        let r = nalgebra::Rotation3::from_euler_angles(0.01, -0.28, 0.02);
        Calibration {
            file: "calibration.toml".into(),
            id: Some("id".into()),
            rig: Rig {
                camera: lens(1297, 972, 1350.0),
                projector: lens(1280, 800, 1050.0),
                projector_from_camera: Pose::new(r, Vector3::new(213.0, -11.7, 77.8)),
            },
            station_from_camera: Some(Pose::new(r.inverse(), Vector3::new(1.0, 2.0, 3.0))),
            covariance: Some(Box::new(ParameterCovariance::from_fn(|i, j| {
                if i == j { 1.0 + i as f64 } else { 0.01 * ((i * j) as f64).sin() }
            }))),
            quality: Some(Quality {
                views: Some(10),
                rms_px: Some(Rms { joint: Some(0.03), ..Rms::default() }),
                serials: Some(Serials { camera: Some("C1".into()), projector: None }),
                ..Quality::default()
            }),
        }
    }

    fn in_file<T>(name: &str, test: impl FnOnce(&Path) -> T) -> T {
        let dir = std::env::temp_dir().join(format!("datum-calibration-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&dir).expect("temporary folder");
        let out = test(&dir.join("calibration.toml"));
        std::fs::remove_dir_all(&dir).expect("just made");
        out
    }

    #[test]
    fn what_is_written_reads_back_the_same() {
        let back = in_file("round", |file| {
            calibration().write(file).expect("writable");
            Calibration::read(file).expect("just written")
        });
        let truth = calibration();
        let close = |a: &nalgebra::Rotation3<f64>, b: &nalgebra::Rotation3<f64>| {
            (a.matrix() - b.matrix()).amax() < 1e-12 // reading orthonormalises once more
        };
        let (a, b) = (back.station_from_camera.expect("kept"), truth.station_from_camera.expect("planted"));
        assert!(close(&a.r, &b.r) && a.t == b.t);
        let (a, b) = (back.rig.projector_from_camera, truth.rig.projector_from_camera);
        assert!(close(&a.r, &b.r) && a.t == b.t);
        assert_eq!((back.rig.camera, back.rig.projector), (truth.rig.camera, truth.rig.projector));
        assert_eq!((back.id, back.covariance, back.quality), (truth.id, truth.covariance, truth.quality));
    }

    #[test]
    fn a_covariance_that_is_none_is_refused_at_its_place() {
        let spoilt = |from: &str, to: &str| {
            in_file("covariance", |file| {
                calibration().write(file).expect("writable");
                let text = std::fs::read_to_string(file).expect("just written");
                assert!(text.contains(from), "{from}");
                std::fs::write(file, text.replacen(from, to, 1)).expect("writable");
                Calibration::read(file).expect_err("spoilt").to_string()
            })
        };
        let e = spoilt("\"camera.k2\", ", "");
        assert!(e.contains("covariance.parameters[5] = \"camera.p1\", allowed: \"camera.k2\""), "{e}");
        let e = spoilt("values = [[1.0, ", "values = [[-1.0, ");
        assert!(e.contains("covariance.values[0][0] = -1"), "{e}");
        let e = spoilt("values = [[1.0, 0.0", "values = [[1.0, 0.5");
        assert!(e.contains("covariance.values[1][0] = 0, allowed: values[0][1] = 0.5: symmetric"), "{e}");
        let e = spoilt("values = [[1.0, ", "values = [[");
        assert!(e.contains("24 rows of 24 numbers"), "{e}");
    }

    #[test]
    fn another_size_is_refused_unless_binned_and_allowed() {
        let c = calibration();
        assert_eq!(c.for_sizes((1297, 972), (1280, 800), false).expect("the same"), c);
        let says = |camera, projector, scale| c.for_sizes(camera, projector, scale).expect_err("other").to_string();
        assert_eq!(
            says((648, 486), (1280, 800), false),
            "calibration.toml: camera.width × camera.height = 1297×972, allowed: the capture's, 648×486; \
             it is the same by a factor of 2: give --scale-calibration if it is binned"
        );
        assert!(!says((640, 972), (1280, 800), true).contains("--scale"));
        assert!(!says((1296, 971), (1280, 800), true).contains("--scale"));
        assert!(says((1297, 972), (1280, 720), true).contains("projector.width × projector.height = 1280×800"));
    }

    #[test]
    fn a_binned_calibration_sees_the_same_rays() {
        let c = calibration();
        for (size, factor) in [((648, 486), 2.0), ((1946, 1458), 2.0 / 3.0), ((2594, 1944), 0.5)] {
            let b = c.for_sizes(size, (1280, 800), true).expect("binned");
            assert_eq!((b.rig.camera.width, b.rig.camera.height), size);
            let at = Pixel::new(300.0, 200.0);
            let binned = (at.add_scalar(0.5) / factor).add_scalar(-0.5);
            let (a, b_ray) = (c.rig.camera.ray(&at).expect("inside"), b.rig.camera.ray(&binned).expect("inside"));
            assert!((a - b_ray).norm() < 1e-12, "{factor}");
            let (v, w) = (c.covariance.as_ref().expect("planted"), b.covariance.as_ref().expect("kept"));
            assert!((w[(0, 0)] * factor * factor - v[(0, 0)]).abs() < 1e-12);
            assert!((w[(3, 20)] * factor - v[(3, 20)]).abs() < 1e-12 && w[(5, 5)] == v[(5, 5)]);
        }
    }
}
