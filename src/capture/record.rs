//! Recording: devices in, a capture's folder out.
//! In:  camera, projector and bars, and what to show. Out: the images and their description, as [`Capture`] reads them.
//! Not here: when to record; how brightly to light (the caller gives the drives); what is done with the images.

use super::shoot::{self, Described, FRINGE_LEVEL, RED_LEVEL, SETS, ShootError, Shooting, Shots};
use super::{Capture, Conditions, Devices, check_order};
use crate::document;
use crate::fringe::Axis;
use crate::hal::Pool;
use crate::image::{Image, PngError, write_png, write_png_16};
use rayon::prelude::*;
use std::path::Path;
use std::time::Duration;

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
    /// The devices, or an image that is not its picture's.
    #[error(transparent)]
    Shoot(#[from] ShootError),
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

/// No exposure is longer, and no image takes longer than that and this.
const LONGEST: Duration = Duration::from_millis(100);
const TIMEOUT: Duration = Duration::from_millis(400);
/// Where the search for the right exposure starts, s.
const START: f64 = 4e-3;
/// And where it ends: the level is right within this share of it.
const METERED: f64 = 0.05;

/// Records what stands there into `folder`, which is made: red, ambient, all fringes. Leaves the lights off.
pub fn record(devices: &mut Devices<'_>, plan: &Plan, folder: &Path) -> Result<Capture, RecordError> {
    record_while(devices, plan, folder, &mut || true)
}

/// As [`record`], as long as `go_on` says so before each image.
pub fn record_while(
    devices: &mut Devices<'_>,
    plan: &Plan,
    folder: &Path,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<Capture, RecordError> {
    let (shots, mut capture) = take_while(devices, plan, go_on)?;
    capture.folder = folder.into();
    write(&shots, &capture, devices.camera.sensor().bits)?;
    Ok(capture)
}

/// As [`record`], without writing anything: the images, and their description, whose folder is not named.
pub fn take(devices: &mut Devices<'_>, plan: &Plan) -> Result<(Shots, Capture), RecordError> {
    take_while(devices, plan, &mut || true)
}

fn take_while(
    devices: &mut Devices<'_>,
    plan: &Plan,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<(Shots, Capture), RecordError> {
    let taken = taken(devices, plan, go_on);
    // what went wrong first is told; a light that cannot be turned off would go wrong here, too
    let dark = devices.bars.set([0.0; 2]).map_err(ShootError::Lights).map(|_| ());
    let dark = dark.and(devices.projector.show(None).map_err(ShootError::Projector));
    let taken = taken?;
    dark?;
    Ok(taken)
}

fn taken(
    devices: &mut Devices<'_>,
    plan: &Plan,
    go_on: &mut dyn FnMut() -> bool,
) -> Result<(Shots, Capture), RecordError> {
    let projector = devices.projector.size();
    let pictures = shoot::pictures(&plan.sets, projector.0, projector.1)?;
    let fringes = pictures.len() - 1;
    devices.projector.load(&pictures).map_err(ShootError::Projector)?;
    let pool = Pool::new(devices.camera.sensor(), fringes + 4);
    let mut shooting = Shooting::new(devices, &pool, (LONGEST, TIMEOUT), 0, go_on);
    let drive = shooting.bars(plan.bars)?;
    let (red_light, _) = shooting.meter(RED_LEVEL, START, METERED)?;
    let red = shooting.grab()?;
    shooting.bars([0.0; 2])?;
    // exposed as the red image, which it is taken off from
    let ambient = shooting.grab()?;
    shooting.show(Some(fringes))?;
    let (fringe_light, _) = shooting.meter(FRINGE_LEVEL, START, METERED)?;
    shooting.show(None)?;
    let fringes = shooting.fringes(fringes, &mut |_, _| ())?;
    let shots: Vec<&Image<u16>> = fringes.iter().map(|f| -> &Image<u16> { f }).collect();
    let everywhere: Vec<usize> = (0..shots[0].pixels.len()).step_by(37).collect();
    check_order(&plan.sets, &shots, &everywhere, &shooting.sensor, fringe_light.gain).map_err(ShootError::Order)?;
    let repeat = if plan.repeat {
        shooting.show(Some(0))?;
        Some(shooting.grab()?)
    } else {
        None
    };
    let described = Described {
        sensor: &shooting.sensor,
        projector,
        sets: &plan.sets,
        repeat: plan.repeat,
        red: red_light,
        fringes: fringe_light,
        conditions: Conditions { bar_left: Some(drive[0]), bar_right: Some(drive[1]), ..Conditions::default() },
        taken_at: plan.taken_at.clone(),
    };
    Ok((Shots { red, ambient, fringes, repeat }, described.capture()))
}

/// Writes `shots` of a sensor with so many bits, and last their description, into the folder that `capture` names.
pub fn write(shots: &Shots, capture: &Capture, bits: u8) -> Result<(), RecordError> {
    let folder = &capture.folder;
    let file_error = |source| document::Error::Write { file: folder.clone(), source };
    std::fs::create_dir_all(folder).map_err(|e| super::Error::Document(file_error(e)))?;
    png(&folder.join(shoot::RED), &shots.red, bits)?;
    let n = shots.fringes.len();
    let images: Vec<_> = std::iter::once(&shots.ambient).chain(&shots.fringes).chain(&shots.repeat).collect();
    images.par_iter().enumerate().try_for_each(|(k, image)| png(&folder.join(shoot::file(k, n)), image, bits))?;
    Ok(capture.write()?)
}

fn png(file: &Path, image: &Image<u16>, bits: u8) -> Result<(), PngError> {
    if bits > 8 {
        return write_png_16(file, image);
    }
    let pixels = image.pixels.iter().map(|v| u8::try_from(*v).unwrap_or(u8::MAX)).collect();
    write_png(file, &Image { width: image.width, height: image.height, pixels })
}
