//! The hardware boundary: what the station needs of a camera, a projector, two light bars, a presence sensor and a
//! clock, in the station's units and free of any driver's types.
//! In:  settings and requests. Out: what the devices really took, images, times; or an [`Error`] that names the device.
//! Not here: how a device is reached (`sim`, and the drivers); what is done with an image; when to measure.
//!
//! Every call blocks and ends: no call waits longer than its timeout, or than the device's own documented time. After
//! an error a device is as its docstring says, and a caller may go on or give up, but never has to guess.

mod error;
pub mod linux;
mod pool;

pub use error::Error;
pub use pool::{Buffer, Pool};

use crate::image::Image;
use std::time::Duration;

/// What a sensor's images look like and what its grey levels mean; it does not change while the camera lives.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensor {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Bits per sample, 8 to 16.
    pub bits: u8,
    /// Grey level of no light.
    pub black_level: f64,
    /// Grey level from which on a sample is saturated.
    pub white_level: u16,
    /// Grey levels per electron at gain 1.
    pub dn_per_electron: f64,
    /// Read noise, electrons.
    pub read_noise_e: f64,
    /// Serial number.
    pub serial: String,
}

impl Sensor {
    /// That `image` has its size; else [`Error::Size`] of `device`.
    pub(crate) fn fits(&self, device: &str, image: &Image<u16>) -> Result<(), Error> {
        let (found, allowed) = ((image.width, image.height), (self.width, self.height));
        if found == allowed {
            Ok(())
        } else {
            Err(Error::Size { device: device.into(), what: "buffer", found, allowed })
        }
    }
}

/// That `gain` is at least 1; else [`Error::Setting`] of `device`.
fn at_least_1(device: &str, gain: f64) -> Result<(), Error> {
    if gain >= 1.0 {
        return Ok(());
    }
    Err(Error::Setting { device: device.into(), setting: "gain", value: gain, allowed: "a number of at least 1" })
}

/// How an image was exposed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Exposure {
    /// Counts the sensor's exposures. A step of more than one: images were lost. The same number twice: the same image.
    pub sequence: u64,
    /// When the exposure began, on the station's [`Clock`].
    pub begun_at: Duration,
    /// How long it lasted.
    pub time: Duration,
    /// Factor on the sensor's grey levels per electron.
    pub gain: f64,
}

/// One grey camera with a global shutter, owned by the station.
pub trait Camera {
    /// The sensor.
    fn sensor(&self) -> &Sensor;

    /// Requests an exposure time for the images to come and returns the one taken: sensors expose whole lines, and
    /// not for as long as one likes. After an error the former one holds.
    fn set_exposure(&mut self, wanted: Duration) -> Result<Duration, Error>;

    /// Requests a gain, at least 1, for the images to come and returns the one taken. After an error the former one holds.
    fn set_gain(&mut self, wanted: f64) -> Result<f64, Error>;

    /// Blocks for an image whose exposure begins after this call, and copies it into `image`, which has the sensor's
    /// size. After an error the content of `image` is undefined and the camera is ready: the next call starts clean, and
    /// an image that comes too late is never taken for the next one.
    fn grab(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error>;

    /// Whether it is there, at once: what the station asks while it waits for a vehicle.
    fn check(&mut self) -> Result<(), Error>;
}

/// A projector that shows stored pictures. Its light is on only while a picture is shown.
pub trait Projector {
    /// Columns and rows, px.
    fn size(&self) -> (usize, usize);

    /// Replaces the stored pictures; grey levels from 0 to 255 are meant to be linear in light. Shows none afterwards.
    /// After an error nothing is stored.
    fn load(&mut self, pictures: &[Image<u8>]) -> Result<(), Error>;

    /// Shows a stored picture, by its place in [`Self::load`], or nothing, and returns when its light is on and steady.
    /// After an error it shows nothing, or what it showed before: ask for nothing to be sure.
    fn show(&mut self, picture: Option<usize>) -> Result<(), Error>;

    /// Whether it is there, at once, as far as that can be told without light.
    fn check(&mut self) -> Result<(), Error>;
}

/// The two dimmable red light bars.
pub trait LightBars {
    /// Sets the drive of the left and the right bar, seen from the camera, 0 to 1, and returns what was taken when the
    /// light is steady. After an error both are as before the call, or off.
    fn set(&mut self, drive: [f64; 2]) -> Result<[f64; 2], Error>;
}

/// What the presence sensor says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// A vehicle is there.
    pub present: bool,
    /// Since when the sensor has said so without a break, on the station's [`Clock`]: a contact that bounced meanwhile
    /// has not said so all the time.
    pub since: Duration,
}

impl Reading {
    /// Whether it has said so for `debounce`.
    pub fn steady(&self, now: Duration, debounce: Duration) -> bool {
        now.saturating_sub(self.since) >= debounce
    }
}

/// The sensor that says whether a vehicle stands where it can be measured.
pub trait Presence {
    /// Blocks until a vehicle is there (`true`) or gone (`false`), or `timeout` has passed. Returns what the sensor says.
    fn wait(&mut self, present: bool, timeout: Duration) -> Result<Reading, Error>;
}

/// The station's time: monotonic, from an origin of its own.
pub trait Clock {
    /// Time since the origin.
    fn now(&self) -> Duration;

    /// Returns when `time` has passed.
    fn sleep(&mut self, time: Duration);
}
