//! The simulated station as experiments use it: teach a model, let vehicles stand before it, measure them.
//! In:  a scale, a seed; bodies, paints, how they stand. Out: measurements with the true poses. All in memory.
//! Not here: what is made of them.

use super::error::{self, CameraFromVehicle};
use super::{Error, Seen};
use crate::calibrate::Calibration;
use crate::capture::{self, Capture, Devices, Plan, Shots, take};
use crate::detect::{DEFAULT, Detector};
use crate::image::Image;
use crate::measure::{Drawing, Measurement, Measurer, Shared, Taught, Verdict, measure_from, teach_from};
use crate::sim::{self, Body, Build, Deviation, Paint, Random, Scene, Script, Setup, Station};
use crate::vehicle::VehicleFile;
use nalgebra::Vector6;
use std::path::Path;
use std::sync::Arc;

/// A simulated station for experiments.
pub struct Bench {
    /// How it is built.
    pub setup: Arc<Setup>,
    /// Its calibration, exact.
    pub calibration: Calibration,
    /// What its measurers share: the detector that comes with the program.
    pub shared: Shared,
    seed: u64,
}

/// A capture in memory, and where the vehicle stood.
pub struct Shot {
    /// What the images are.
    pub capture: Capture,
    /// The images.
    pub shots: Shots,
    /// The true pose.
    pub truth: CameraFromVehicle,
}

/// A measurement and the truth.
#[derive(Clone, Debug)]
pub struct Measured {
    /// What was measured.
    pub measurement: Measurement,
    /// What was seen.
    pub drawing: Drawing,
    /// The true pose.
    pub truth: CameraFromVehicle,
}

impl Measured {
    /// See [`error::error`]; none unless the verdict is ok.
    pub fn error(&self) -> Option<Vector6<f64>> {
        self.ok().then(|| error::error(&self.measurement, &self.truth))?
    }

    /// The measured pose; none unless the verdict is ok.
    pub fn pose(&self) -> Option<CameraFromVehicle> {
        self.ok().then(|| error::pose(&self.measurement))?
    }

    /// Whether it was measured and called ok.
    pub fn ok(&self) -> bool {
        self.measurement.verdict == Verdict::Ok
    }
}

impl Shot {
    fn load(&self) -> impl Fn(&Path) -> Result<Image<u16>, capture::Error> {
        |name| Ok(self.shots.named(name).expect("named by its own description").clone())
    }

    /// Measures it.
    pub fn measure(&self, measurer: &Measurer) -> Measured {
        let (measurement, drawing) =
            measure_from(measurer, &self.capture, &self.load(), &mut |_| ()).expect("images in memory are readable");
        Measured { measurement, drawing, truth: self.truth }
    }

    /// It and what came of it, to be drawn.
    pub fn seen(&self, caption: impl Into<String>, measured: &Measured) -> Seen {
        Seen {
            caption: caption.into(),
            red: (**self.shots.red).clone(),
            white: self.capture.camera.white_level(),
            measurement: measured.measurement.clone(),
            drawing: measured.drawing.clone(),
        }
    }
}

impl Bench {
    /// Of an image scale (1, 0.5, 0.25).
    pub fn new(scale: f64, seed: u64) -> Result<Self, Error> {
        Ok(Self::with(Setup::new(scale, 8), Detector::named(Path::new(DEFAULT))?, seed))
    }

    /// With a setup and a detector of one's own.
    pub fn with(setup: Setup, detector: Option<Arc<Detector>>, seed: u64) -> Self {
        let calibration = sim::calibration(&setup);
        Self { setup: Arc::new(setup), calibration, shared: Shared { detector, ..Shared::default() }, seed }
    }

    /// A stream of random numbers that belongs to `place` of the experiment.
    pub fn random(&self, place: &[u64]) -> Random {
        Random::new(self.seed, place)
    }

    /// Whether every feature of a body that stands so is in the image.
    pub fn in_view(&self, body: &Body, deviation: &Deviation) -> bool {
        sim::features(&Scene::new(body.clone(), sim::PAINTS[0], deviation), &self.setup).is_some()
    }

    /// A station before which one vehicle stands; its sensor's noise belongs to `place` of the experiment.
    pub fn station(&self, body: &Body, paint: Paint, deviation: &Deviation, place: &[u64]) -> Station {
        let stands = (body.clone(), paint, *deviation);
        Station::with_vehicle(Arc::clone(&self.setup), self.random(place).bits(), stands, Script::default())
    }

    /// Takes one capture, as a station does.
    pub fn shoot(&self, station: &Station) -> Result<Shot, Error> {
        let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
        let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
        let (shots, capture) = take(&mut devices, &Plan::default())?;
        let truth = station.truth().ok_or(Error::Nothing { what: "no vehicle stands there".into() })?;
        Ok(Shot { capture, shots, truth })
    }

    /// The model of `body`, exactly as drawn, taught where it stands `deviation` off, clicked exactly; ready to measure. Its
    /// limits are as wide as an experiment may need.
    pub fn teach(&self, body: &Body, paint: Paint, deviation: &Deviation) -> Result<Measurer, Error> {
        let (shot, features) = self.to_teach(body, paint, deviation)?;
        Ok(self.measurer(&self.calibration, self.taught(&shot, &features, &self.calibration)?))
    }

    /// A capture of `body`, exactly as drawn, and the features file that belongs to it.
    pub fn to_teach(&self, body: &Body, paint: Paint, deviation: &Deviation) -> Result<(Shot, VehicleFile), Error> {
        let body = body.clone().built(Build::default());
        let scene = Scene::new(body.clone(), paint, deviation);
        let out = || Error::OutOfView { body: body.name.clone() };
        let mut features = sim::features(&scene, &self.setup).ok_or_else(out)?;
        features.limits.x_mm = 400.0;
        features.limits.yaw_deg = 30.0;
        let shot = self.shoot(&self.station(&body, paint, deviation, &[0, u64::from(body.job)]))?;
        Ok((shot, features))
    }

    /// A model of `features`, clicked in `shot`, by a calibration.
    pub fn taught(&self, shot: &Shot, features: &VehicleFile, calibration: &Calibration) -> Result<Taught, Error> {
        teach_from(&shot.capture, &shot.load(), calibration, features, "taught")
            .map_err(|e| Error::Teach { body: features.name.clone(), source: Box::new(e) })
    }

    /// Measures by a taught model and a calibration.
    pub fn measurer(&self, calibration: &Calibration, taught: Taught) -> Measurer {
        Measurer::with_templates(calibration.clone(), taught.model, taught.templates).sharing(&self.shared)
    }
}
