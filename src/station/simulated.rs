//! The built-in simulated station: its devices, the traffic before it, its ten models taught and released.
//! In: scale and seed. Out: devices of `hal`; vehicles that come by themselves or when asked for; a jobs folder.
//! Not here: anything that a station with real devices would do otherwise.

use super::hardware::{Hardware, Temperatures};
use super::jobs::is_of_other_version;
use crate::calibrate::Calibration;
use crate::capture::{Devices, Plan, record};
use crate::geometry::{Pose, frame};
use crate::hal::Clock;
use crate::measure::teach;
use crate::sim::{self, Body, Build, Deviation, PAINTS, Paint, Random, Scene, Script, Setup, Visit};
use anyhow::Context;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Until a vehicle that comes by itself stands there.
const ROLLS_IN: Duration = Duration::from_millis(1500);
/// Models are taught on this.
const TAUGHT_ON: &str = "white";

/// The world before the station, which no device shows otherwise than as vehicles.
pub trait World: Send {
    /// A vehicle of `job` stands there.
    fn bring(&mut self, job: u16);
    /// A vehicle of one of `jobs` rolls in by itself; which one.
    fn send_one(&mut self, jobs: &[u16]) -> Option<u16>;
    /// What stands there leaves.
    fn leave(&mut self);
    /// Where the vehicle really is.
    fn truth(&self) -> Option<Pose<frame::Camera, frame::Vehicle>>;
    /// What stands there, in words.
    fn name(&self) -> String;
}

/// A simulated station with nothing before it.
pub struct Simulated {
    /// The devices' world.
    pub station: sim::Station,
    /// How it is built.
    pub setup: Arc<Setup>,
}

impl Simulated {
    /// Of an image scale (1, 0.5, 0.25).
    pub fn new(scale: f64, seed: u64) -> Self {
        let setup = Arc::new(Setup::new(scale, 8));
        let station = sim::Station::new(Arc::clone(&setup), seed, Vec::new(), Script::default());
        Self { station, setup }
    }

    /// Its devices.
    pub fn hardware(&self) -> Hardware {
        Hardware {
            camera: Box::new(self.station.camera()),
            projector: Box::new(self.station.projector()),
            bars: Box::new(self.station.bars()),
            presence: Some(Box::new(self.station.presence())),
            temperatures: Temperatures::default(),
            simulated: true,
        }
    }

    /// Its clock.
    pub fn clock(&self) -> Box<dyn Clock + Send> {
        Box::new(self.station.clock())
    }

    /// Its calibration, exact.
    pub fn calibration(&self) -> Calibration {
        sim::calibration(&self.setup)
    }
}

/// Vehicles as they are built and as they roll in, drawn from a seed.
pub struct Traffic {
    station: sim::Station,
    random: Random,
    name: String,
}

/// As a vehicle that rolls into a station with guides stands: half of what a station must bear with.
pub fn deviation(random: &mut Random) -> Deviation {
    Deviation {
        along_mm: random.between(-25.0, 25.0),
        across_mm: random.between(-25.0, 25.0),
        up_mm: random.between(-10.0, 10.0),
        roll_deg: random.between(-0.5, 0.5),
        pitch_deg: random.between(-0.5, 0.5),
        yaw_deg: random.between(-5.0, 5.0),
    }
}

impl Traffic {
    /// Before `station`.
    pub fn new(station: &sim::Station, seed: u64) -> Self {
        Self { station: station.clone(), random: Random::new(seed, &[0x7472_6166]), name: String::new() }
    }

    fn visit(&mut self, job: u16, stops: Duration) {
        // a job of one's own has no body here: one of the ten comes, and is refused or not
        let names: Vec<&str> = sim::names().collect();
        let name = names[usize::from(job.max(1) - 1) % names.len()];
        let paint = PAINTS[self.random.below(PAINTS.len())];
        let body = Body::named(name).expect("listed").built(Build::random(&mut self.random));
        self.name = format!("{} {name}", paint.name);
        let deviation = deviation(&mut self.random);
        self.station.bring(Visit { body, paint, deviation, stops, leaves: Duration::MAX });
    }
}

impl World for Traffic {
    fn bring(&mut self, job: u16) {
        self.visit(job, self.station.now());
    }

    fn send_one(&mut self, jobs: &[u16]) -> Option<u16> {
        let job = *jobs.get(self.random.below(jobs.len().max(1)))?;
        self.visit(job, self.station.now() + ROLLS_IN);
        Some(job)
    }

    fn leave(&mut self) {
        self.station.clear();
    }

    fn truth(&self) -> Option<Pose<frame::Camera, frame::Vehicle>> {
        self.station.truth()
    }

    fn name(&self) -> String {
        self.name.clone()
    }
}

/// The file of a named model in `folder`.
fn file(folder: &Path, job: u16, name: &str) -> PathBuf {
    folder.join(format!("{job:03}-{name}.toml"))
}

/// Teaches and releases the named model of number `job` (1 to 10) into `folder`, from a capture of it as drawn; its file.
pub fn teach_one(setup: &Arc<Setup>, job: u16, folder: &Path) -> anyhow::Result<PathBuf> {
    let name = sim::names().nth(usize::from(job) - 1).with_context(|| format!("job {job}, allowed: 1 to 10"))?;
    let body = Body::named(name).context("listed")?;
    let paint = Paint::named(TAUGHT_ON).context("listed")?;
    let features = sim::features(&Scene::new(body.clone(), paint, &Deviation::default()), setup)
        .with_context(|| format!("{name}: a feature is out of the image"))?;
    let stands = (body, paint, Deviation::default());
    let station = sim::Station::with_vehicle(Arc::clone(setup), u64::from(job), stands, Script::default());
    let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
    let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
    let images = folder.join(format!(".teaching-{job:03}"));
    let capture = record(&mut devices, &Plan::default(), &images)?;
    let out = file(folder, job, name);
    let stem = format!("{job:03}-{name}");
    let taught = teach(&capture, &sim::calibration(setup), &features, &stem);
    let _ = std::fs::remove_dir_all(&images); // only litter
    let mut taught = taught?;
    taught.write(&out)?;
    taught.model.file.clone_from(&out);
    taught.model.release()?;
    Ok(out)
}

/// The named models' numbers that `folder` has no file of.
pub fn missing(folder: &Path) -> Vec<u16> {
    numbers(folder, |file| !file.exists())
}

/// Those of which it has one that another version of datum taught.
pub fn outdated(folder: &Path) -> Vec<u16> {
    numbers(folder, is_of_other_version)
}

fn numbers(folder: &Path, of: impl Fn(&Path) -> bool) -> Vec<u16> {
    (1..).zip(sim::names()).filter(|(job, name)| of(&file(folder, *job, name))).map(|(job, _)| job).collect()
}
