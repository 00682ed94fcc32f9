//! The station's devices in one hand, which turns the lights off.
//! In: devices. Out: the same; darkness, also when the thread that holds them panics or ends.

use crate::capture::Devices;
use crate::code::Code;
use crate::hal;

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
