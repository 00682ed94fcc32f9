//! What makes a camera expose. In: a GPIO line's name, or none. Out: a pulse for each image, where there is a line.

use super::gpio::{LineName, Output, Switch};
use crate::hal::Error;
use std::time::Duration;

/// How long the line is on: cameras ask for some microseconds behind their filter.
const PULSE: Duration = Duration::from_micros(200);

/// A camera's trigger; none: it exposes by itself.
pub(super) struct Trigger(Option<Output>);

impl Trigger {
    /// Takes the line, if there is one.
    pub(super) fn open(device: &'static str, line: Option<&LineName>) -> Result<Self, Error> {
        line.map(|line| Output::open(device, line, false)).transpose().map(Self)
    }

    /// Whether the camera exposes for pulses only.
    pub(super) fn is_wired(&self) -> bool {
        self.0.is_some()
    }

    pub(super) fn pulse(&mut self) -> Result<(), Error> {
        let Some(line) = &mut self.0 else { return Ok(()) };
        line.set(true)?;
        std::thread::sleep(PULSE);
        line.set(false)
    }
}
