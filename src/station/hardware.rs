//! The station's devices in one hand, which turns the lights off.
//! In: devices. Out: the same; darkness, also when the thread that holds them panics or ends.

use crate::capture::Devices;
use crate::code::Code;
use crate::hal;
use crate::hal::linux::Thermometer;

/// What tells how warm it is; none: nobody knows.
#[derive(Clone, Debug, Default)]
pub struct Temperatures {
    /// The computer.
    pub computer: Option<Thermometer>,
    /// The camera.
    pub camera: Option<Thermometer>,
    /// The projector.
    pub projector: Option<Thermometer>,
}

impl Temperatures {
    /// °C of computer, camera, projector; a sensor that does not answer is not known.
    pub fn read(&self) -> [Option<f64>; 3] {
        [&self.computer, &self.camera, &self.projector].map(|t| t.as_ref().and_then(|t| t.read().ok()))
    }
}

/// All devices of a station. When dropped, bars and projector are off.
pub struct Hardware {
    /// The camera.
    pub camera: Box<dyn hal::Camera + Send>,
    /// The projector.
    pub projector: Box<dyn hal::Projector + Send>,
    /// The light bars.
    pub bars: Box<dyn hal::LightBars + Send>,
    /// Whether a vehicle is there; none: nobody knows.
    pub presence: Option<Box<dyn hal::Presence + Send>>,
    /// How warm it is.
    pub temperatures: Temperatures,
    /// Whether the devices are simulated: time passes for their sake only.
    pub simulated: bool,
}

impl Hardware {
    /// Those that make a capture.
    pub fn devices(&mut self) -> Devices<'_> {
        Devices { camera: &mut *self.camera, projector: &mut *self.projector, bars: &mut *self.bars }
    }

    /// Turns bars and projector off, each tried twice; the code of what would not go off.
    pub fn dark(&mut self) -> Result<(), Code> {
        let bars = self.bars.set([0.0; 2]).or_else(|_| self.bars.set([0.0; 2]));
        let projector = self.projector.show(None).or_else(|_| self.projector.show(None));
        bars.map_err(|_| Code::LightFault)?;
        projector.map_err(|_| Code::ProjectorSilent)
    }
}

impl Drop for Hardware {
    fn drop(&mut self) {
        let _ = self.dark(); // there is nobody left to tell
    }
}
