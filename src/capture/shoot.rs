//! Shooting: the images of one capture from the devices, one after the other.
//! In:  devices, what to show, how bright it was the time before. Out: images as they come, how they were lit; every image
//! is the one of its picture, or there is an error.
//! Not here: what is made of the images; files; when to shoot; whether the light is as it should be.

use super::{Camera, Capture, Conditions, FringeSet, Images};
use crate::document;
use crate::fringe::{self, Axis, PatternSet};
use crate::hal::{self, Buffer, Pool, Sensor};
use crate::image::Image;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// The devices of a recording.
pub struct Devices<'a> {
    /// The camera.
    pub camera: &'a mut dyn hal::Camera,
    /// The projector.
    pub projector: &'a mut dyn hal::Projector,
    /// The bars.
    pub bars: &'a mut dyn hal::LightBars,
}

/// The station's usual sets: unwrapped in ratios of 8, the finest with steps enough to be free of gamma.
pub const SETS: [(Axis, u32, u32); 3] = [(Axis::Column, 1, 4), (Axis::Column, 8, 4), (Axis::Column, 64, 8)];
/// Exposures tried until the light is right.
pub(crate) const TRIALS: usize = 5;
/// Where the images' upper quartile is to lie, as a share of white: the body's level in the red image, and halfway
/// between a fringe's light and dark.
pub(crate) const RED_LEVEL: f64 = 0.40;
pub(crate) const FRINGE_LEVEL: f64 = 0.36;

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum ShootError {
    /// The camera.
    #[error(transparent)]
    Camera(hal::Error),
    /// The projector.
    #[error(transparent)]
    Projector(hal::Error),
    /// The light bars.
    #[error(transparent)]
    Lights(hal::Error),
    /// An image lost, or the same one twice.
    #[error("camera: image {found} after image {before}, allowed: the next")]
    Sequence {
        /// The image before.
        before: u64,
        /// The one that came.
        found: u64,
    },
    /// An image of another pattern than its own.
    #[error("{0}")]
    Order(String),
    /// Whoever asked for the images wants no more of them.
    #[error("stopped before the next image")]
    Stopped,
}

/// How an image is exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Light {
    /// How long.
    pub time: Duration,
    /// Factor on the sensor's grey levels per electron.
    pub gain: f64,
}

impl Light {
    /// Grey levels go with it: s of gain 1.
    pub fn strength(&self) -> f64 {
        self.time.as_secs_f64() * self.gain
    }
}

/// What the projector is to hold for `sets`: every step of every set, then an even grey.
pub fn pictures(sets: &[(Axis, u32, u32)], width: usize, height: usize) -> Result<Vec<Image<u8>>, fringe::Error> {
    let mut pictures = Vec::new();
    for &(axis, count, steps) in sets {
        let set = PatternSet::new(axis, count, steps)?;
        pictures.extend((0..steps).map(|step| set.render(step, width, height)));
    }
    pictures.push(Image::filled(width, height, 128));
    Ok(pictures)
}

/// The set and the step of the `k`-th fringe image.
pub(crate) fn place(sets: &[(Axis, u32, u32)], mut k: usize) -> (usize, u32) {
    for (s, &(_, _, steps)) in sets.iter().enumerate() {
        if k < steps as usize {
            return (s, u32::try_from(k).expect("fewer than the steps"));
        }
        k -= steps as usize;
    }
    panic!("{k} images more than the sets have")
}

/// A shooting in progress. Bars and projector are left as they were last set: whoever shoots turns them off.
pub struct Shooting<'a, 'd> {
    /// The devices.
    pub devices: &'a mut Devices<'d>,
    /// The camera's sensor.
    pub sensor: Sensor,
    pool: &'a Pool,
    /// No exposure is longer: the camera's gain makes up for it.
    longest: Duration,
    /// Beside the exposure itself.
    timeout: Duration,
    /// Images that may be asked for once more where they did not come.
    retries: usize,
    /// The newest image's number, and whether the next one must follow it.
    newest: Option<(u64, bool)>,
    taken: usize,
    go_on: &'a mut dyn FnMut() -> bool,
}

impl<'a, 'd> Shooting<'a, 'd> {
    /// With what `pool` lends. `go_on` is asked before each image. What does not come, or comes under a wrong number, is
    /// asked for once more, `retries` times in all.
    pub fn new(
        devices: &'a mut Devices<'d>,
        pool: &'a Pool,
        (longest, timeout): (Duration, Duration),
        retries: usize,
        go_on: &'a mut dyn FnMut() -> bool,
    ) -> Self {
        let sensor = devices.camera.sensor().clone();
        Self { devices, sensor, pool, longest, timeout, retries, newest: None, taken: 0, go_on }
    }

    /// Images asked for so far.
    pub fn taken(&self) -> usize {
        self.taken
    }

    /// The drives that were taken.
    pub fn bars(&mut self, drive: [f64; 2]) -> Result<[f64; 2], ShootError> {
        self.devices.bars.set(drive).map_err(ShootError::Lights)
    }

    /// Shows a picture or nothing.
    pub fn show(&mut self, picture: Option<usize>) -> Result<(), ShootError> {
        self.devices.projector.show(picture).map_err(ShootError::Projector)
    }

    /// Exposes as long as `strength` (s of gain 1) asks for, and takes gain for what is beyond the longest exposure.
    pub fn expose(&mut self, strength: f64) -> Result<Light, ShootError> {
        let camera = &mut self.devices.camera;
        let wanted = Duration::from_secs_f64(strength.clamp(0.0, 10.0));
        let time = camera.set_exposure(wanted.min(self.longest)).map_err(ShootError::Camera)?;
        let gain = camera.set_gain((strength / time.as_secs_f64()).max(1.0)).map_err(ShootError::Camera)?;
        Ok(Light { time, gain })
    }

    /// The next image, exposed after this call.
    pub fn grab(&mut self) -> Result<Arc<Buffer>, ShootError> {
        match self.once() {
            Err(ShootError::Camera(_) | ShootError::Sequence { .. }) if self.retries > 0 => {
                self.retries -= 1;
                self.newest = self.newest.map(|(number, _)| (number, false));
                self.once()
            }
            taken => taken,
        }
    }

    fn once(&mut self) -> Result<Arc<Buffer>, ShootError> {
        if !(self.go_on)() {
            return Err(ShootError::Stopped);
        }
        self.taken += 1;
        // one more than the pool has: an image that is still being written, say
        let image = self.pool.take().or_else(|| Pool::new(&self.sensor, 1).take());
        let mut image = image.expect("a new pool has one");
        let found = self.devices.camera.grab(self.longest + self.timeout, &mut image);
        let found = found.map_err(ShootError::Camera)?.sequence;
        let before = self.newest.replace((found, true));
        if let Some((before, follows)) = before
            && (found <= before || follows && found != before + 1)
        {
            self.newest = Some((found.max(before), true));
            return Err(ShootError::Sequence { before, found });
        }
        Ok(Arc::new(image))
    }

    /// Exposure and gain with which the image's upper quartile lies at `level` (share of white) within `tolerance` of it,
    /// found from `start` (s of gain 1) on, and the last image taken on the way.
    pub fn meter(&mut self, level: f64, start: f64, tolerance: f64) -> Result<(Light, Arc<Buffer>), ShootError> {
        let mut light = self.expose(start)?;
        let mut image = self.grab()?;
        for _ in 1..TRIALS {
            let found = quartile(&image, &self.sensor);
            if (found / level - 1.0).abs() < tolerance {
                break;
            }
            let next = self.expose(light.strength() * brighter(found, level))?;
            if next == light {
                break; // there is no more of it
            }
            light = next;
            image = self.grab()?;
        }
        Ok((light, image))
    }

    /// Every fringe image of `fringes` pictures, each handed to `took` as it comes.
    pub fn fringes(
        &mut self,
        fringes: usize,
        took: &mut dyn FnMut(usize, &Arc<Buffer>),
    ) -> Result<Vec<Arc<Buffer>>, ShootError> {
        let mut shots = Vec::with_capacity(fringes);
        for k in 0..fringes {
            self.show(Some(k))?;
            let image = self.grab()?;
            took(k, &image);
            shots.push(image);
        }
        Ok(shots)
    }
}

/// By how much more light an image's `found` level becomes `level`.
pub(crate) fn brighter(found: f64, level: f64) -> f64 {
    // what is saturated is brighter than it looks; what is black gives no measure
    if found > 0.9 { 0.25 } else { (level / found.max(0.002)).min(30.0) }
}

/// The image's upper quartile above black, as a share of white.
pub(crate) fn quartile(image: &Image<u16>, sensor: &Sensor) -> f64 {
    let mut levels: Vec<u16> = image.pixels.iter().step_by(37).copied().collect();
    let upper = levels.len() * 3 / 4;
    let found = f64::from(*levels.select_nth_unstable(upper).1);
    (found - sensor.black_level) / (f64::from(sensor.white_level) - sensor.black_level)
}

/// The images of one capture and how they were lit.
#[derive(Clone)]
pub struct Shots {
    /// Bars on, projector off.
    pub red: Arc<Buffer>,
    /// Everything off.
    pub ambient: Arc<Buffer>,
    /// In the order shown.
    pub fringes: Vec<Arc<Buffer>>,
    /// The first of them once more, at the end.
    pub repeat: Option<Arc<Buffer>>,
}

impl Shots {
    /// The image that a capture's description names `name`.
    pub fn named(&self, name: &Path) -> Option<&Image<u16>> {
        if name == Path::new(RED) {
            return Some(&self.red);
        }
        let further = std::iter::once(&self.ambient).chain(&self.fringes).chain(&self.repeat);
        further.enumerate().find(|(k, _)| file(*k, self.fringes.len()) == name).map(|(_, image)| &***image)
    }
}

/// What a capture's description says beside its images.
#[derive(Clone, Debug)]
pub struct Described<'a> {
    /// The sensor.
    pub sensor: &'a Sensor,
    /// Columns and rows of the projector.
    pub projector: (usize, usize),
    /// The fringe sets.
    pub sets: &'a [(Axis, u32, u32)],
    /// Whether there is a repeated image.
    pub repeat: bool,
    /// How the red image was exposed.
    pub red: Light,
    /// And the fringes.
    pub fringes: Light,
    /// What else is known, the bars' drives for one.
    pub conditions: Conditions,
    /// Date and time of the first exposure, RFC 3339.
    pub taken_at: String,
}

/// The red image's file.
pub(super) const RED: &str = "red.png";

/// The file of the `k`-th image after the red one.
pub(super) fn file(k: usize, fringes: usize) -> PathBuf {
    match k {
        0 => "ambient.png".into(),
        k if k <= fringes => PathBuf::from(format!("fringe-{:02}.png", k - 1)),
        _ => "repeat.png".into(),
    }
}

impl Described<'_> {
    /// The capture's description; its folder is still to be named.
    pub fn capture(self) -> Capture {
        let Self { sensor, sets, .. } = self;
        let gain = |light: Light| Some(sensor.dn_per_electron * light.gain);
        let fringes = sets.iter().map(|s| s.2 as usize).sum();
        let mut names = (1..=fringes).map(|k| file(k, fringes));
        let sets = sets.iter().map(|&(axis, count, steps)| FringeSet {
            axis,
            count,
            steps,
            gain_dn_per_e: gain(self.fringes),
            exposure_ms: Some(self.fringes.time.as_secs_f64() * 1e3),
            images: names.by_ref().take(steps as usize).collect(),
        });
        Capture {
            folder: PathBuf::new(),
            format: document::FORMAT,
            taken_at: self.taken_at,
            camera: Camera {
                width: sensor.width,
                height: sensor.height,
                bits: if sensor.bits > 8 { 16 } else { 8 },
                white_level: Some(f64::from(sensor.white_level)),
                black_level: sensor.black_level,
                read_noise_e: Some(sensor.read_noise_e),
                serial: Some(sensor.serial.clone()),
            },
            images: Images {
                red: Some(RED.into()),
                ambient: Some(file(0, fringes)),
                repeat: self.repeat.then(|| file(fringes + 1, fringes)),
                red_gain_dn_per_e: gain(self.red),
            },
            projector: super::Projector { width: self.projector.0, height: self.projector.1 },
            fringes: sets.collect(),
            conditions: self.conditions,
        }
    }
}
