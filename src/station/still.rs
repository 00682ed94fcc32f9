//! A world before a simulated station that is driven turn by turn: the vehicle that was put there, and nothing by itself.
//! In: vehicles, one at a time. Out: a [`World`] that brings the last one when an order wants one.

use super::simulated::World;
use crate::geometry::{Pose, frame};
use crate::sim::{self, Body, Deviation, Paint, Visit};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Where what comes next is put. Clones are of the same place.
#[derive(Clone, Default)]
pub struct Next(Arc<Mutex<Option<(Body, Paint, Deviation)>>>);

impl Next {
    /// The next order brings this one, and no later order does.
    pub fn put(&self, body: Body, paint: Paint, deviation: Deviation) {
        *self.place() = Some((body, paint, deviation));
    }

    fn place(&self) -> MutexGuard<'_, Option<(Body, Paint, Deviation)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The world.
pub struct Still {
    /// Before which it is.
    pub station: sim::Station,
    /// What comes next, whichever job an order is for.
    pub next: Next,
}

impl World for Still {
    fn bring(&mut self, _: u16) {
        if let Some((body, paint, deviation)) = self.next.place().take() {
            let stops = self.station.now();
            self.station.bring(Visit { body, paint, deviation, stops, leaves: Duration::MAX });
        }
    }

    fn send_one(&mut self, _: &[u16]) -> Option<u16> {
        None
    }

    fn leave(&mut self) {
        self.station.clear();
    }

    fn truth(&self) -> Option<Pose<frame::Camera, frame::Vehicle>> {
        self.station.truth()
    }

    fn name(&self) -> String {
        String::new()
    }
}
