//! Simulated devices: one world, five handles on it, virtual time.
//! In:  a setup, visits of vehicles, a script of faults. Out: devices of `hal`; for tests also the truth.
//! Time passes only while a device is asked for something that takes time. Whoever holds the handles cannot tell more
//! of the world than real devices would.

use super::fault::{Fault, Script};
use super::pose::camera_from_vehicle;
use super::projector::Picture;
use super::render::{Layers, Lit};
use super::scene::Scene;
use super::sensor::{Take, expose};
use super::setup::{MAX_GAIN, Setup};
use super::{Deviation, body::Body, paint::Paint};
use crate::geometry::{EulerDeg, Pose, frame};
use crate::hal::{self, Error, Exposure, Reading, Sensor};
use crate::image::Image;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// From the end of an exposure until the image is there.
const READOUT: Duration = Duration::from_millis(10);
/// Until a picture's light, or a bar's, is steady.
const SHOW: Duration = Duration::from_millis(6);
const DIM: Duration = Duration::from_millis(2);
/// The bars' drive has so many steps.
const DRIVE_STEPS: f64 = 1000.0;
/// A vehicle rolls in and out at this speed, mm/s, from and to a place where none of it is seen as present.
const SPEED: f64 = 400.0;
/// The presence sensor sees a vehicle this near to where it stops, mm.
const PRESENT_MM: f64 = 20.0;
/// Rocking, Hz, and the height about which a body rolls, mm above the ground.
const ROCKING_HZ: f64 = 1.7;
const ROLL_CENTRE_MM: f64 = 400.0;
/// The hall's lamps, Hz.
const FLICKER_HZ: f64 = 100.0;

/// One vehicle's stay: it rolls in, stops, stays, and rolls out.
#[derive(Clone, Debug, PartialEq)]
pub struct Visit {
    /// Its body, with how it differs from the drawing.
    pub body: Body,
    /// Its paint.
    pub paint: Paint,
    /// Where it stops.
    pub deviation: Deviation,
    /// When it stops, and when it starts to leave.
    pub stops: Duration,
    /// See there.
    pub leaves: Duration,
}

/// A simulated station.
#[derive(Clone, Debug)]
pub struct Station(Arc<Mutex<World>>);

#[derive(Debug)]
struct World {
    setup: Arc<Setup>,
    seed: u64,
    visits: Vec<Visit>,
    script: Script,
    now: Duration,
    // as the devices are set
    drive: [f64; 2],
    pictures: Vec<Picture>,
    shown: Option<usize>,
    asked: Option<usize>,
    exposure: Duration,
    gain: f64,
    /// Exposures so far.
    images: u64,
    last: Option<(Exposure, Image<u16>)>,
    /// The scene last looked at, how far the projector was turned then, and what was seen.
    seen: Option<(Option<Scene>, f64, Arc<Layers>)>,
}

impl Station {
    /// A station at time 0. Visits come in the order of their times.
    pub fn new(setup: Arc<Setup>, seed: u64, visits: Vec<Visit>, script: Script) -> Self {
        let exposure = setup.exposure(Duration::from_millis(2));
        let world = World {
            setup,
            seed,
            visits,
            script,
            now: Duration::ZERO,
            drive: [0.0; 2],
            pictures: Vec::new(),
            shown: None,
            asked: None,
            exposure,
            gain: 1.0,
            images: 0,
            last: None,
            seen: None,
        };
        Self(Arc::new(Mutex::new(world)))
    }

    /// One vehicle that stands there from the beginning to the end.
    pub fn with_vehicle(setup: Arc<Setup>, seed: u64, scene: (Body, Paint, Deviation), script: Script) -> Self {
        let (body, paint, deviation) = scene;
        let visit = Visit { body, paint, deviation, stops: Duration::ZERO, leaves: Duration::MAX };
        Self::new(setup, seed, vec![visit], script)
    }

    /// The camera.
    pub fn camera(&self) -> Camera {
        Camera { sensor: self.world().setup.sensor.clone(), world: self.clone() }
    }

    /// The projector.
    pub fn projector(&self) -> Projector {
        Projector(self.clone())
    }

    /// The light bars.
    pub fn bars(&self) -> Bars {
        Bars(self.clone())
    }

    /// The presence sensor.
    pub fn presence(&self) -> Presence {
        Presence { world: self.clone(), last: Reading { present: false, since: Duration::ZERO } }
    }

    /// The clock.
    pub fn clock(&self) -> Clock {
        Clock(self.clone())
    }

    /// A vehicle comes, and no other; the one that was there is gone. For whoever plays the world: no device shows it
    /// otherwise than as a vehicle.
    pub fn bring(&self, visit: Visit) {
        self.world().visits = vec![visit];
    }

    /// What stands there is gone, and nothing else comes.
    pub fn clear(&self) {
        self.world().visits.clear();
    }

    /// What is to go wrong from now on, instead of what was.
    pub fn set_script(&self, script: Script) {
        self.world().script = script;
    }

    /// Exposures so far: the number that [`super::When::Image`] counts.
    pub fn images(&self) -> u64 {
        self.world().images
    }

    /// The drives that the bars were asked for, and whether the projector was asked for a picture.
    pub fn lights(&self) -> ([f64; 2], bool) {
        let world = self.world();
        (world.drive, world.asked.is_some())
    }

    /// The time, as [`Clock`] tells it.
    pub fn now(&self) -> Duration {
        self.world().now
    }

    /// Where the vehicle really is just now; `None`: there is none.
    pub fn truth(&self) -> Option<Pose<frame::Camera, frame::Vehicle>> {
        let world = self.world();
        world.scene(world.now).map(|scene| scene.camera_from_vehicle)
    }

    fn world(&self) -> MutexGuard<'_, World> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl World {
    /// The visit at `now` and how far the vehicle is from where it stops, mm forward.
    fn visit(&self, now: Duration) -> Option<(&Visit, f64)> {
        // half the way from one visit to the next belongs to each
        let away = |v: &Visit| {
            if now < v.stops {
                -SPEED * (v.stops - now).as_secs_f64()
            } else {
                SPEED * now.saturating_sub(v.leaves).as_secs_f64()
            }
        };
        let nearest = self.visits.iter().map(|v| (v, away(v))).min_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        (nearest.1.abs() < 4000.0).then_some(nearest) // a car's length
    }

    fn present(&self, now: Duration) -> bool {
        self.visit(now).is_some_and(|(_, away)| away.abs() < PRESENT_MM)
    }

    /// What stands before the station at `now`.
    fn scene(&self, now: Duration) -> Option<Scene> {
        let (visit, away) = self.visit(now)?;
        let mut body = &visit.body;
        let (mut roll, mut cover) = (0.0, None);
        for fault in self.script.at(now, None) {
            match fault {
                Fault::WrongVehicle(other) => body = other,
                Fault::Rocking(deg) => roll = deg * (std::f64::consts::TAU * ROCKING_HZ * now.as_secs_f64()).sin(),
                Fault::Covered(c) => cover = Some(*c),
                _ => {}
            }
        }
        let deviation = Deviation { along_mm: visit.deviation.along_mm + away, ..visit.deviation };
        let mut pose = camera_from_vehicle(body, &deviation);
        if roll != 0.0 {
            let turn = EulerDeg { roll, pitch: 0.0, yaw: 0.0 }.to_rotation();
            let about = Vector3::new(0.0, 0.0, ROLL_CENTRE_MM);
            pose = pose * Pose::<frame::Vehicle, frame::Vehicle>::new(turn, about - turn * about);
        }
        Some(Scene { body: body.clone(), paint: visit.paint, camera_from_vehicle: pose, cover })
    }

    fn layers(&mut self, now: Duration) -> Arc<Layers> {
        let scene = self.scene(now);
        let bumped = self.script.at(now, None).find_map(|f| match f {
            Fault::Bumped(deg) => Some(*deg),
            _ => None,
        });
        let bumped = bumped.unwrap_or(0.0);
        if let Some((seen, by, layers)) = &self.seen
            && *seen == scene
            && *by == bumped
        {
            return Arc::clone(layers);
        }
        let layers = Arc::new(match &scene {
            Some(scene) => Layers::new(scene, &self.setup, bumped),
            None => Layers::empty(&self.setup),
        });
        self.seen = Some((scene, bumped, Arc::clone(&layers)));
        layers
    }

    /// Exposes an image now; time goes on to its end.
    fn expose(&mut self, image: &mut Image<u16>) -> Exposure {
        let begun_at = self.now;
        self.images += 1;
        let layers = self.layers(begun_at);
        let (mut bars, mut ambient, mut dirt, mut silent) = (self.drive, 1.0, None, false);
        for fault in self.script.at(begun_at, Some(self.images)) {
            match fault {
                Fault::BarDead(k) => bars[*k] = 0.0,
                Fault::BarStuck(k, drive) => bars[*k] = *drive,
                Fault::Ambient(factor) => ambient *= factor,
                Fault::Flicker(depth) => {
                    // the mean of 1 + depth·cos over the exposure
                    let turn = std::f64::consts::TAU * FLICKER_HZ;
                    let (from, time) = (begun_at.as_secs_f64(), self.exposure.as_secs_f64());
                    ambient *= 1.0 + depth * ((turn * (from + time)).sin() - (turn * from).sin()) / (turn * time);
                }
                Fault::DirtyLens(d) => dirt = Some(d),
                Fault::ProjectorSilent => silent = true,
                _ => {}
            }
        }
        let picture = self.shown.filter(|_| !silent).map(|k| &self.pictures[k]);
        let lit = Lit { bars, ambient, picture };
        let take = Take { exposure: self.exposure, gain: self.gain, seed: self.seed, number: self.images };
        expose(&self.setup, &layers, &lit, dirt, &take, image);
        self.now += self.exposure + READOUT;
        Exposure { sequence: self.images, begun_at, time: self.exposure, gain: self.gain }
    }
}

/// A handle on the simulated camera.
#[derive(Debug)]
pub struct Camera {
    sensor: Sensor,
    world: Station,
}

impl Camera {
    const NAME: &str = "camera";

    fn here(world: &World) -> Result<(), Error> {
        let gone = world.script.at(world.now, Some(world.images + 1)).any(|f| *f == Fault::CameraGone);
        if gone { Err(Error::Gone { device: Self::NAME.into() }) } else { Ok(()) }
    }
}

impl hal::Camera for Camera {
    fn sensor(&self) -> &Sensor {
        &self.sensor
    }

    fn set_exposure(&mut self, wanted: Duration) -> Result<Duration, Error> {
        let mut world = self.world.world();
        Self::here(&world)?;
        world.exposure = world.setup.exposure(wanted);
        Ok(world.exposure)
    }

    fn set_gain(&mut self, wanted: f64) -> Result<f64, Error> {
        let mut world = self.world.world();
        Self::here(&world)?;
        if wanted.is_nan() {
            let allowed = "a number of at least 1";
            return Err(Error::Setting { device: Self::NAME.into(), setting: "gain", value: wanted, allowed });
        }
        world.gain = (16.0 * wanted.clamp(1.0, MAX_GAIN)).round() / 16.0;
        Ok(world.gain)
    }

    fn check(&mut self) -> Result<(), Error> {
        let world = self.world.world();
        let gone = world.script.at(world.now, None).any(|f| *f == Fault::CameraGone);
        if gone { Err(Error::Gone { device: Self::NAME.into() }) } else { Ok(()) }
    }

    fn grab(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        let mut world = self.world.world();
        let world = &mut *world;
        let device = || Self::NAME.to_owned();
        self.sensor.fits(Self::NAME, image)?;
        Self::here(world)?;
        let asked_at = world.now;
        let deadline = asked_at.saturating_add(timeout);
        let too_late = |world: &mut World| {
            world.now = deadline; // nobody waits for it
            Err(Error::NoImage { device: device(), waited: timeout })
        };
        loop {
            if world.now + world.exposure + READOUT > deadline {
                return too_late(world);
            }
            let number = world.images + 1;
            let faults: Vec<Fault> = world.script.at(world.now, Some(number)).cloned().collect();
            let exposure = world.expose(image);
            if faults.contains(&Fault::ImageDropped) {
                continue;
            }
            if faults.contains(&Fault::ImageHalf) {
                let rows = self.sensor.height / 2;
                image.pixels[rows * self.sensor.width..].fill(0);
                return Err(Error::HalfImage { device: device(), rows, of: self.sensor.height });
            }
            for fault in &faults {
                if let Fault::ImageLate(by) = fault {
                    world.now += *by;
                    if world.now > deadline {
                        return too_late(world);
                    }
                }
            }
            if faults.contains(&Fault::ImageDoubled)
                && let Some((before, old)) = &world.last
            {
                image.pixels.copy_from_slice(&old.pixels);
                return Ok(*before);
            }
            // kept only where a later image may be doubled
            if world.script.0.iter().any(|cue| cue.fault == Fault::ImageDoubled) {
                world.last = Some((exposure, image.clone()));
            }
            return Ok(exposure);
        }
    }
}

/// A handle on the simulated projector.
#[derive(Debug)]
pub struct Projector(Station);

impl Projector {
    const NAME: &str = "projector";
}

impl hal::Projector for Projector {
    fn size(&self) -> (usize, usize) {
        let world = self.0.world();
        (world.setup.rig.projector.width, world.setup.rig.projector.height)
    }

    fn load(&mut self, pictures: &[Image<u8>]) -> Result<(), Error> {
        let allowed = hal::Projector::size(self);
        let mut world = self.0.world();
        (world.shown, world.asked) = (None, None);
        world.pictures.clear();
        if let Some(wrong) = pictures.iter().find(|p| (p.width, p.height) != allowed) {
            let found = (wrong.width, wrong.height);
            return Err(Error::Size { device: Self::NAME.into(), what: "picture", found, allowed });
        }
        // on the body at the usual distance, which the projector sees from about as far as the camera does
        let far = super::setup::DISTANCE_MM;
        let setup = Arc::clone(&world.setup);
        world.pictures = pictures.par_iter().map(|p| Picture::new(p, &setup, far)).collect();
        Ok(())
    }

    fn show(&mut self, picture: Option<usize>) -> Result<(), Error> {
        let mut world = self.0.world();
        let loaded = world.pictures.len();
        if let Some(picture) = picture.filter(|p| *p >= loaded) {
            return Err(Error::NotLoaded { device: Self::NAME.into(), picture, loaded });
        }
        let behind = world.script.at(world.now, Some(world.images + 1)).any(|f| *f == Fault::ProjectorBehind);
        world.shown = if behind { world.asked } else { picture };
        world.asked = picture;
        world.now += SHOW;
        Ok(())
    }

    /// It takes requests whatever it does with them.
    fn check(&mut self) -> Result<(), Error> {
        Ok(())
    }
}

/// A handle on the simulated light bars.
#[derive(Debug)]
pub struct Bars(Station);

impl hal::LightBars for Bars {
    fn set(&mut self, drive: [f64; 2]) -> Result<[f64; 2], Error> {
        if let Some(value) = drive.into_iter().find(|d| !(0.0..=1.0).contains(d)) {
            let allowed = "0 to 1";
            return Err(Error::Setting { device: "lights".into(), setting: "drive", value, allowed });
        }
        let mut world = self.0.world();
        world.drive = drive.map(|d| (d * DRIVE_STEPS).round() / DRIVE_STEPS);
        world.now += DIM;
        Ok(world.drive)
    }
}

/// A handle on the simulated presence sensor.
#[derive(Debug)]
pub struct Presence {
    world: Station,
    last: Reading,
}

/// The presence sensor is asked this often.
const POLL: Duration = Duration::from_millis(5);

impl hal::Presence for Presence {
    fn wait(&mut self, present: bool, timeout: Duration) -> Result<Reading, Error> {
        let mut world = self.world.world();
        let deadline = world.now.saturating_add(timeout);
        while world.present(world.now) != present && world.now < deadline {
            world.now = (world.now + POLL).min(deadline);
        }
        if world.present(world.now) != self.last.present {
            self.last = Reading { present: !self.last.present, since: world.now };
        }
        Ok(self.last)
    }
}

/// A handle on virtual time.
#[derive(Debug)]
pub struct Clock(Station);

impl hal::Clock for Clock {
    fn now(&self) -> Duration {
        self.0.world().now
    }

    fn sleep(&mut self, time: Duration) {
        let mut world = self.0.world();
        world.now = world.now.saturating_add(time);
    }
}
