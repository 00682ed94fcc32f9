//! Drivers for Linux: GPIO lines, PWM channels, hwmon sensors, V4L2 nodes, cameras of libcamera, behind the traits of `hal`.
//! In:  names from the configuration. Out: devices. Chips are found by their label, lines by their name: numbers change
//! from one kernel to the next.
//! Not here: what is configured (`station`); logic that needs no kernel is pure and tested without one.

mod arrivals;
mod bars;
mod camera;
mod clock;
mod gpio;
mod hwmon;
#[cfg(any(test, feature = "libcamera"))]
mod libcamera;
mod node;
mod output;
mod presence;
mod pwm;
mod queue;
mod sequenced;
mod trigger;
mod watch;

pub use bars::{BarSettings, Bars, dark as bars_dark};
pub use camera::{CameraSettings, V4l2Camera};
pub use clock::MonotonicClock;
pub use gpio::LineName;
pub use hwmon::Thermometer;
#[cfg(feature = "libcamera")]
pub use libcamera::{LibcameraCamera, LibcameraSettings};
pub use output::{OutputProjector, OutputSettings};
pub use presence::PresenceLine;
pub use pwm::ChannelName;
pub use sequenced::{SequencedProjector, SequencedSettings, sequenced_dark};
pub use watch::{Stream, Watch};

use std::path::PathBuf;

/// Where the kernel shows its devices; another folder in tests.
#[derive(Clone, Debug)]
pub struct Sys(pub PathBuf);

impl Default for Sys {
    fn default() -> Self {
        Self("/sys".into())
    }
}
