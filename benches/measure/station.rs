//! A vehicle taught and another captured at full resolution, on the simulated station.

use datum::capture::{Devices, Plan, record};
use datum::detect::{DEFAULT, Detector};
use datum::measure::{Measurer, teach};
use datum::sim::{self, Body, Deviation, Paint, Scene, Script, Setup, Station};
use datum::{Capture, Image};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A vehicle taught where it should stand, and a capture of one that stands otherwise.
pub(crate) struct Bench {
    pub(crate) measurer: Measurer,
    /// The same, with the detector.
    pub(crate) detecting: Measurer,
    pub(crate) capture: Capture,
    pub(crate) red: Image<u16>,
    pub(crate) fringes: Vec<Vec<Image<u16>>>,
    /// Where its files are: `calibration.toml`, `bench.toml`, the capture in `moved`.
    pub(crate) folder: PathBuf,
}

impl Bench {
    pub(crate) fn new() -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-measure");
        let setup = Arc::new(Setup::new(1.0, 8));
        let (body, paint) = (Body::named("suv-a").expect("listed"), Paint::named("white").expect("listed"));
        let capture = |stands: Deviation, name: &str| {
            let station =
                Station::with_vehicle(Arc::clone(&setup), 1, (body.clone(), paint, stands), Script::default());
            let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
            let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
            record(&mut devices, &Plan::default(), &folder.join(name)).expect("recorded")
        };
        let good = capture(Deviation::default(), "taught");
        let scene = Scene::new(body.clone(), paint, &Deviation::default());
        let features = sim::features(&scene, &setup).expect("all in view");
        let mut taught = teach(&good, &sim::calibration(&setup), &features, "bench").expect("teaches");
        taught.write(&folder.join("bench.toml")).expect("writable");
        sim::calibration(&setup).write(&folder.join("calibration.toml")).expect("writable");
        taught.model.file = folder.join("bench.toml");
        let measurer = || Measurer::new(sim::calibration(&setup), taught.model.clone()).expect("templates");
        let detector = Detector::named(Path::new(DEFAULT)).expect("comes with the program");
        let detecting = measurer().with_detector(detector);
        let stands = Deviation { along_mm: -40.0, across_mm: 30.0, yaw_deg: 3.0, ..Deviation::default() };
        let capture = capture(stands, "moved");
        let load = |path: &PathBuf| capture.load(path).expect("just written");
        let red = load(capture.images.red.as_ref().expect("recorded"));
        let fringes = capture.fringes.iter().map(|set| set.images.iter().map(load).collect()).collect();
        Self { measurer: measurer(), detecting, red, fringes, capture, folder }
    }

    /// Every fringe image of the capture: its set, its step.
    pub(crate) fn images(&self) -> impl Iterator<Item = (usize, u32, &Image<u16>)> {
        self.fringes.iter().enumerate().flat_map(|(k, set)| (0u32..).zip(set).map(move |(step, i)| (k, step, i)))
    }
}
