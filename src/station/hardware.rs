//! The station's devices in one hand, which turns the lights off, and how warm they may be.
//! In: devices. Out: the same; darkness, also when the thread that holds them panics or ends.

use crate::capture::Devices;
use crate::code::Code;
use crate::hal;
use crate::hal::linux::Thermometer;

/// Who was too hot counts as cool again so much below what is allowed, °C: it must not come and go.
const COOL: f64 = 5.0;

/// What tells how warm it is; none: nobody knows.
#[derive(Clone, Debug)]
pub struct Temperatures {
    /// The computer.
    pub computer: Option<Thermometer>,
    /// The camera.
    pub camera: Option<Thermometer>,
    /// The projector.
    pub projector: Option<Thermometer>,
    /// How warm computer, camera and projector may be, °C.
    pub most: [f64; 3],
}

impl Default for Temperatures {
    fn default() -> Self {
        Self { computer: None, camera: None, projector: None, most: [f64::INFINITY; 3] }
    }
}

impl Temperatures {
    /// °C of computer, camera, projector; a sensor that does not answer is not known.
    pub fn read(&self) -> [Option<f64>; 3] {
        [&self.computer, &self.camera, &self.projector].map(|t| t.as_ref().and_then(|t| t.read().ok()))
    }

    /// What is too hot, in a sentence; `before`: something was.
    pub fn too_hot(&self, celsius: [Option<f64>; 3], before: bool) -> Option<String> {
        let names = ["computer", "camera", "projector"];
        names.into_iter().zip(celsius).zip(self.most).find_map(|((name, celsius), most)| {
            let allowed = if before { most - COOL } else { most };
            let celsius = celsius.filter(|c| *c > allowed)?;
            Some(format!("The {name} is {celsius:.1} °C warm, allowed {allowed:.0} °C."))
        })
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_too_hot_must_cool_down_before_it_counts_as_cool() {
        let temperatures = Temperatures { most: [90.0, 80.0, 70.0], ..Temperatures::default() };
        let hot = |celsius, before| temperatures.too_hot(celsius, before);
        assert_eq!(hot([Some(90.0), Some(80.0), Some(70.0)], false), None);
        assert_eq!(hot([None; 3], true), None, "nobody knows");
        let says = "The projector is 70.4 °C warm, allowed 70 °C.";
        assert_eq!(hot([Some(50.0), None, Some(70.4)], false).as_deref(), Some(says));
        let says = "The camera is 75.5 °C warm, allowed 75 °C.";
        assert_eq!(hot([Some(50.0), Some(75.5), None], true).as_deref(), Some(says));
        assert_eq!(hot([Some(50.0), Some(75.0), None], true), None);
    }
}
