//! Recording: devices in, a capture's folder out.
//! In:  camera, projector and bars, and what to show. Out: the images and their description, as [`Capture`] reads them.
//! Not here: when to record; how brightly to light (the caller gives the drives); what is done with the images.

use super::{Camera, Capture, Conditions, FringeSet, Images};
use crate::document;
use crate::fringe::{Axis, PatternSet};
use crate::hal::{self, Buffer, Exposure, Pool};
use crate::image::{Image, PngError, write_png, write_png_16};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
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

/// What is recorded.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Drives of the bars in the red image.
    pub bars: [f64; 2],
    /// Fringe sets: along which axis, how many periods, how many steps.
    pub sets: Vec<(Axis, u32, u32)>,
    /// Whether the first fringe image is taken once more at the end, to see whether anything moved.
    pub repeat: bool,
    /// Date and time of the recording, RFC 3339.
    pub taken_at: String,
}

impl Default for Plan {
    /// Bars at 0.6, the usual sets, the first image repeated; of no date.
    fn default() -> Self {
        Self { bars: [0.6; 2], sets: SETS.to_vec(), repeat: true, taken_at: "2000-01-01T00:00:00Z".into() }
    }
}

/// Why nothing was recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// A device.
    #[error(transparent)]
    Device(#[from] hal::Error),
    /// An image lost, or the same one twice.
    #[error("camera: image {found} after image {before}, allowed: the next")]
    Sequence {
        /// The image before.
        before: u64,
        /// The one that came.
        found: u64,
    },
    /// Fringes that cannot be.
    #[error(transparent)]
    Fringes(#[from] crate::fringe::Error),
    /// The folder or its description.
    #[error(transparent)]
    Capture(#[from] super::Error),
    /// An image that cannot be written.
    #[error(transparent)]
    Png(#[from] PngError),
}

/// The station's usual sets: unwrapped in ratios of 8, the finest with steps enough to be free of gamma.
pub const SETS: [(Axis, u32, u32); 3] = [(Axis::Column, 1, 4), (Axis::Column, 8, 4), (Axis::Column, 64, 8)];
/// No image takes longer.
const TIMEOUT: Duration = Duration::from_millis(500);
/// Exposures tried until the light is right.
const TRIALS: usize = 5;
/// Where the images' upper quartile is to lie, as a share of white: the body's level in the red image, and halfway
/// between a fringe's light and dark.
const RED_LEVEL: f64 = 0.40;
const FRINGE_LEVEL: f64 = 0.36;

/// How images are exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Light {
    time: Duration,
    gain: f64,
}

/// Records what stands there into `folder`, which is made: red, ambient, all fringes.
pub fn record(devices: &mut Devices<'_>, plan: &Plan, folder: &Path) -> Result<Capture, RecordError> {
    let sensor = devices.camera.sensor().clone();
    let (width, height) = devices.projector.size();
    let mut pictures = Vec::new();
    for &(axis, count, steps) in &plan.sets {
        let set = PatternSet::new(axis, count, steps)?;
        pictures.extend((0..steps).map(|step| set.render(step, width, height)));
    }
    let fringes = pictures.len();
    pictures.push(Image::filled(width, height, 128));
    let pool = Pool::new(&sensor, fringes + 3);
    let buffer = || pool.take().expect("one for every image");

    devices.projector.load(&pictures)?;
    let drive = devices.bars.set(plan.bars)?;
    let mut red = buffer();
    let red_light = meter(devices.camera, RED_LEVEL, &mut red)?;
    let mut last = devices.camera.grab(TIMEOUT, &mut red)?;
    devices.bars.set([0.0; 2])?;
    // exposed as the red image is, to be taken off it
    let mut ambient = buffer();
    last = {
        let next = devices.camera.grab(TIMEOUT, &mut ambient)?;
        follows(&last, &next)?;
        next
    };
    devices.projector.show(Some(fringes))?;
    let mut trial = buffer();
    let fringe_light = meter(devices.camera, FRINGE_LEVEL, &mut trial)?;
    drop(trial);
    let mut shots = vec![ambient];
    let order = (0..fringes).map(Some).chain(plan.repeat.then_some(Some(0)));
    for (k, picture) in order.enumerate() {
        devices.projector.show(picture)?;
        let mut image = buffer();
        let next = devices.camera.grab(TIMEOUT, &mut image)?;
        if k > 0 {
            follows(&last, &next)?;
        }
        last = next;
        shots.push(image);
    }
    devices.projector.show(None)?;

    let name = |k: usize| match k {
        0 => "ambient.png".into(),
        k if k <= fringes => PathBuf::from(format!("fringe-{:02}.png", k - 1)),
        _ => "repeat.png".into(),
    };
    let file_error = |source| document::Error::Write { file: folder.into(), source };
    std::fs::create_dir_all(folder).map_err(|e| super::Error::Document(file_error(e)))?;
    write(&folder.join("red.png"), &red, sensor.bits)?;
    shots.par_iter().enumerate().try_for_each(|(k, image)| write(&folder.join(name(k)), image, sensor.bits))?;

    let gain = |light: Light| Some(sensor.dn_per_electron * light.gain);
    let mut names = (1..=fringes).map(name);
    let sets = plan.sets.iter().map(|&(axis, count, steps)| FringeSet {
        axis,
        count,
        steps,
        gain_dn_per_e: gain(fringe_light),
        exposure_ms: Some(fringe_light.time.as_secs_f64() * 1e3),
        images: names.by_ref().take(steps as usize).collect(),
    });
    let capture = Capture {
        folder: folder.into(),
        format: document::FORMAT,
        taken_at: plan.taken_at.clone(),
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
            red: Some("red.png".into()),
            ambient: Some(name(0)),
            repeat: plan.repeat.then(|| name(fringes + 1)),
            red_gain_dn_per_e: gain(red_light),
        },
        projector: super::Projector { width, height },
        fringes: sets.collect(),
        conditions: Conditions { bar_left: Some(drive[0]), bar_right: Some(drive[1]), ..Conditions::default() },
    };
    capture.write()?;
    Ok(capture)
}

/// Finds exposure and gain with which the image's upper quartile lies at `level` (share of white), and sets them.
fn meter(camera: &mut dyn hal::Camera, level: f64, image: &mut Buffer) -> Result<Light, hal::Error> {
    let sensor = camera.sensor().clone();
    let span = f64::from(sensor.white_level) - sensor.black_level;
    let mut light = Light { time: camera.set_exposure(Duration::from_millis(4))?, gain: camera.set_gain(1.0)? };
    for _ in 0..TRIALS {
        camera.grab(TIMEOUT, image)?;
        let mut levels: Vec<u16> = image.pixels.iter().step_by(37).copied().collect();
        let upper = levels.len() * 3 / 4;
        let found = (f64::from(*levels.select_nth_unstable(upper).1) - sensor.black_level) / span;
        if (found / level - 1.0).abs() < 0.05 {
            break;
        }
        // what is saturated is brighter than it looks; what is black gives no measure
        let by = if found > 0.9 { 0.25 } else { (level / found.max(0.002)).min(30.0) };
        let wanted = light.time.mul_f64(light.gain * by);
        light.time = camera.set_exposure(wanted)?;
        light.gain = camera.set_gain(wanted.as_secs_f64() / light.time.as_secs_f64())?;
    }
    Ok(light)
}

fn follows(before: &Exposure, next: &Exposure) -> Result<(), RecordError> {
    if next.sequence == before.sequence + 1 {
        return Ok(());
    }
    Err(RecordError::Sequence { before: before.sequence, found: next.sequence })
}

fn write(file: &Path, image: &Image<u16>, bits: u8) -> Result<(), PngError> {
    if bits > 8 {
        return write_png_16(file, image);
    }
    let pixels = image.pixels.iter().map(|v| u8::try_from(*v).unwrap_or(u8::MAX)).collect();
    write_png(file, &Image { width: image.width, height: image.height, pixels })
}
