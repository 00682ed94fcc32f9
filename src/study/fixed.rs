//! Captures with the loop open: exposures and bars as they are told, whatever the light. In: a station, how to expose.
//! Out: shots. Not here: what is made of them; the station's own light control.

use super::{Bench, Error, Shot};
use crate::capture::shoot::{FRINGE_LEVEL, RED_LEVEL};
use crate::capture::{Conditions, Described, Devices, Light, RecordError, SETS, ShootError, Shooting, Shots, pictures};
use crate::hal::Pool;
use crate::sim::Station;
use std::time::Duration;

/// No exposure is longer, and no image takes longer than that and this.
const LONGEST: Duration = Duration::from_millis(39);
const TIMEOUT: Duration = Duration::from_millis(400);
/// Where the search for the right exposure starts, s, and within which share of the level it ends.
const START: f64 = 4e-3;
const METERED: f64 = 0.05;

/// How everything is lit and exposed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Fixed {
    pub(super) bars: [f64; 2],
    /// Exposures of red image and fringes, s of gain 1.
    pub(super) red: f64,
    pub(super) fringes: f64,
}

impl Fixed {
    /// What suits the vehicle that stands before `station` under these drives of the bars.
    pub(super) fn metered(station: &Station, bars: [f64; 2]) -> Result<Self, Error> {
        let found = shooting(station, |s, fringes| {
            s.bars(bars)?;
            let (red, _) = s.meter(RED_LEVEL, START, METERED)?;
            s.bars([0.0; 2])?;
            s.show(Some(fringes))?;
            let (light, _) = s.meter(FRINGE_LEVEL, START, METERED)?;
            s.show(None)?;
            Ok((red, light))
        })?;
        Ok(Self { bars, red: found.0.strength(), fringes: found.1.strength() })
    }

    /// A capture so exposed.
    pub(super) fn shoot(&self, station: &Station) -> Result<Shot, Error> {
        let truth = station.truth().ok_or(Error::Nothing { what: "no vehicle stands there".into() })?;
        let (shots, capture) = shooting(station, |s, fringes| {
            let drive = s.bars(self.bars)?;
            let red_light: Light = s.expose(self.red)?;
            let red = s.grab()?;
            s.bars([0.0; 2])?;
            let ambient = s.grab()?;
            let fringe_light = s.expose(self.fringes)?;
            let fringes = s.fringes(fringes, &mut |_, _| ())?;
            s.show(Some(0))?;
            let repeat = Some(s.grab()?);
            s.show(None)?;
            let described = Described {
                sensor: &s.sensor,
                projector: s.devices.projector.size(),
                sets: &SETS,
                repeat: true,
                red: red_light,
                fringes: fringe_light,
                conditions: Conditions { bar_left: Some(drive[0]), bar_right: Some(drive[1]), ..Conditions::default() },
                taken_at: "2000-01-01T00:00:00Z".into(),
            };
            Ok((Shots { red, ambient, fringes, repeat }, described.capture()))
        })?;
        Ok(Shot { capture, shots, truth })
    }
}

/// `shoot`s with the usual pictures loaded; it is told how many of them are fringes.
fn shooting<T>(
    station: &Station,
    shoot: impl FnOnce(&mut Shooting<'_, '_>, usize) -> Result<T, ShootError>,
) -> Result<T, Error> {
    let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
    let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
    let (width, height) = devices.projector.size();
    let pictures = pictures(&SETS, width, height).map_err(RecordError::from)?;
    devices.projector.load(&pictures).map_err(ShootError::Projector).map_err(RecordError::from)?;
    let pool = Pool::new(devices.camera.sensor(), pictures.len() + 3);
    let mut go_on = || true;
    let mut s = Shooting::new(&mut devices, &pool, (LONGEST, TIMEOUT), 0, &mut go_on);
    Ok(shoot(&mut s, pictures.len() - 1).map_err(RecordError::from)?)
}

impl Bench {
    /// What suits a vehicle in `paint` where it should stand, with the bars giving so many lx.
    pub(super) fn exposed_for(&self, station: &Station, lux: f64) -> Result<Fixed, Error> {
        let drive = lux / self.setup.lux([1.0; 2]);
        Fixed::metered(station, [drive; 2])
    }
}
