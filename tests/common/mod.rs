//! What tests of whole measurements share: teaching, measuring, and the errors against a capture's truth.

#![allow(dead_code, reason = "each test file uses a part")]

use datum::detect::{DEFAULT, Detector};
use datum::measure::{Drawing, Measurement, Measurer, Taught, measure, teach};
pub(crate) use datum::study::error::CameraFromVehicle;
use datum::{Calibration, Capture, Pose, VehicleFile, frame};
use nalgebra::{Vector3, Vector6};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock};

/// A feature farther than this from a point of the truth is not that point, mm: files give five decimals.
const SAME_POINT_MM: f64 = 1e-3;

/// To teach from, in station/; every other capture of these is measured with that one model.
pub(crate) const TAUGHT: &str = "white-yawtt_05";
pub(crate) const MEASURABLE: [&str; 9] = [
    "white-yawtt_07",
    "white-tx_00",
    "white-tx_20",
    "white-ty_20",
    "white-rnd_00",
    "white-rnd_03",
    "rows-white-rnd_07",
    "black-yawtt_05",
    "black-rnd_01",
];
/// A path below tests/data.
pub(crate) fn here(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(path)
}

/// The folder `name` of the data that DATUM_DATA names; none, said on standard error: the test is skipped.
pub(crate) fn data(name: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("DATUM_DATA").map(|d| Path::new(&d).join(name));
    if folder.is_none() {
        eprintln!("skipped: DATUM_DATA not set");
    }
    folder
}

/// The detector that DATUM_DETECTOR names, else the one that comes with the program.
pub(crate) fn detector() -> Option<Arc<Detector>> {
    static NAMED: LazyLock<Option<Arc<Detector>>> = LazyLock::new(|| {
        let name = std::env::var_os("DATUM_DETECTOR").unwrap_or_else(|| DEFAULT.into());
        Detector::named(Path::new(&name)).expect("a detector")
    });
    NAMED.clone()
}

/// A set of captures that share a calibration.
pub(crate) struct Set {
    pub(crate) folder: PathBuf,
    pub(crate) calibration: Calibration,
}

impl Set {
    pub(crate) fn open(folder: PathBuf) -> Self {
        let calibration = Calibration::read(&folder.join("calibration.toml")).expect("a calibration");
        Self { folder, calibration }
    }

    pub(crate) fn capture(&self, name: &str) -> Capture {
        Capture::open(&self.folder.join(name)).expect("a capture")
    }

    pub(crate) fn teach(&self, name: &str, features: &VehicleFile) -> Taught {
        teach(&self.capture(name), &self.calibration, features, "taught").expect("teaches")
    }

    /// Ready to measure. The model and its templates go through their files, as they do at a station; `folder`, a
    /// name no other test uses, is where.
    pub(crate) fn measurer(&self, taught: &Taught, folder: &str) -> Measurer {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(folder);
        std::fs::create_dir_all(&folder).expect("the target folder is writable");
        for (feature, template) in taught.model.features.iter().zip(&taught.templates) {
            let name = feature.template.as_ref().expect("taught");
            std::fs::write(folder.join(name), template.to_bytes()).expect("writable");
        }
        let file = folder.join("taught.toml");
        taught.model.write(&file).expect("writable");
        let model = VehicleFile::read(&file).expect("what was written");
        Measurer::new(self.calibration.clone(), model).expect("templates").with_detector(detector())
    }

    pub(crate) fn measure(&self, measurer: &Measurer, name: &str) -> (Measurement, Drawing) {
        measure(measurer, &self.capture(name), &mut |_| {}).expect("images can be read")
    }

    /// Measured with a card in front of some regions: in every image a square about each pixel of `covers`, of so many px to
    /// each side, is evenly grey.
    pub(crate) fn measure_covered(&self, measurer: &Measurer, name: &str, covers: &[([f64; 2], f64)]) -> Measurement {
        let capture = self.capture(name);
        let load = |file: &Path| {
            let mut image = capture.load(file).expect("readable");
            for ([x, y], half) in covers {
                let range = |c: f64, n: usize| (c - half).max(0.0) as usize..((c + half).max(0.0) as usize).min(n);
                let (columns, rows) = (range(*x, image.width), range(*y, image.height));
                rows.for_each(|row| image.row_mut(row)[columns.clone()].fill(60));
            }
            image
        };
        let ambient = capture.images.ambient.as_ref().map(|file| load(file));
        let mut cycle = measurer.begin(&capture, &load(capture.red().expect("red")), ambient.as_ref());
        for (k, set) in capture.fringes.iter().enumerate() {
            for (step, file) in (0u32..).zip(&set.images) {
                cycle.add_fringe(k, step, &load(file)).expect("in order");
            }
        }
        cycle.finish(&mut |_| ()).0
    }

    pub(crate) fn truth(&self, name: &str) -> Truth {
        Truth::read(&self.folder.join(name).join("truth.json"))
    }
}

/// Where the vehicle and its points really are.
pub(crate) struct Truth {
    pub(crate) camera_from_vehicle: CameraFromVehicle,
    /// In the vehicle and in the camera frame, mm.
    points: Vec<(Vector3<f64>, Vector3<f64>)>,
    /// In the same order, raw px.
    pixels: Vec<[f64; 2]>,
}

impl Truth {
    fn read(file: &Path) -> Self {
        let text = std::fs::read_to_string(file).expect("truth.json is there");
        let value: Value = serde_json::from_str(&text).expect("JSON");
        let rows = &value["camera_from_object"];
        let r = std::array::from_fn(|i| std::array::from_fn(|j| number(&rows[i][j])));
        let r = datum::geometry::rotation_from_rows(r).expect("a rotation");
        let t = Vector3::from_fn(|i, _| number(&rows[i][3]));
        let point = |f: &Value| (vector(&f["object_mm"]), vector(&f["camera_mm"]));
        let points = value["features"].as_object().expect("features").values().map(point).collect();
        let pixel = |f: &Value| [0, 1].map(|i| number(&f["pixel"][i]));
        let pixels = value["features"].as_object().expect("features").values().map(pixel).collect();
        Self { camera_from_vehicle: Pose::new(r, t), points, pixels }
    }

    /// The motion inverse(true)·measured in vehicle axes, by which a measured pose is off. None: no pose.
    pub(crate) fn motion(&self, m: &Measurement) -> Option<Pose<frame::Vehicle, frame::Vehicle>> {
        datum::study::error::motion(m, &self.camera_from_vehicle)
    }

    /// Error of a measured pose, see there. None: no pose.
    pub(crate) fn error(&self, m: &Measurement) -> Option<Vector6<f64>> {
        datum::study::error::error(m, &self.camera_from_vehicle)
    }

    /// Where a feature of the model is in the image, raw px.
    pub(crate) fn pixel(&self, feature: &datum::vehicle::Feature) -> [f64; 2] {
        let same = |p: &(Vector3<f64>, Vector3<f64>)| (p.0 - feature.position().xyz).norm() < SAME_POINT_MM;
        self.pixels[self.points.iter().position(same).expect("the truth knows every feature")]
    }

    /// Errors of the features that were measured, mm, vehicle axes: their names and x, y, z.
    pub(crate) fn feature_errors(&self, m: &Measurement, model: &VehicleFile) -> Vec<(String, Vector3<f64>)> {
        let error = |name: &str, measured: [f64; 3]| {
            let nominal =
                model.features.iter().find(|f| f.name == name).expect("a feature of the model").position().xyz;
            let same = |(object, _): &&(Vector3<f64>, Vector3<f64>)| (object - nominal).norm() < SAME_POINT_MM;
            let (_, true_mm) = self.points.iter().find(same).expect("the truth knows every feature");
            self.camera_from_vehicle.r.inverse() * (Vector3::from(measured) - true_mm)
        };
        m.features.iter().filter_map(|f| Some((f.name.clone(), error(&f.name, f.camera_mm?)))).collect()
    }
}

/// Error over stated sigma, axis by axis.
pub(crate) fn over_sigma(error: &Vector6<f64>, m: &Measurement) -> Vector6<f64> {
    datum::study::error::over_sigma(error, m).expect("a pose has a covariance")
}

pub(crate) fn rms(values: impl IntoIterator<Item = f64>) -> f64 {
    let (sum, n) = values.into_iter().fold((0.0, 0.0), |(sum, n), v| (sum + v * v, n + 1.0));
    f64::sqrt(sum / n)
}

fn number(v: &Value) -> f64 {
    v.as_f64().expect("a number")
}

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| number(&v[i]))
}

/// Seeded noise, the same on every machine: xorshift64* (Vigna 2016) with Box–Muller.
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self((seed + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }

    /// Uniform in (0, 1).
    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        ((self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    /// Gaussian, mean 0, standard deviation 1.
    pub(crate) fn gauss(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}
