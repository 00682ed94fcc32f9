//! What is as large as an image or its regions, made once and used by one vehicle after another.
//! In: buffers of vehicles that are done. Out: the same, for the next; nothing of what they held is read.
//! Not here: what they hold.

use crate::capture::Fringes;
use crate::fringe::{Coordinate, Depth, Rays};
use crate::image::Image;
use std::sync::{Arc, Mutex, PoisonError};

/// Buffers for as many vehicles as are measured at one time, whatever their models. Clones share them.
#[derive(Clone, Default)]
pub struct Workspace(Arc<Mutex<Vec<Buffers>>>);

/// What one vehicle needs.
pub(super) struct Buffers {
    pub(super) red: Image<f32>,
    /// Of the pixels that depth is looked for in.
    pub(super) rays: Rays,
    pub(super) wanted: Vec<bool>,
    pub(super) fringes: Fringes,
    pub(super) coordinates: Vec<Coordinate>,
    pub(super) depths: Vec<Depth>,
}

impl Workspace {
    /// Those of an earlier vehicle, or empty ones.
    pub(super) fn take(&self) -> Buffers {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default()
    }

    pub(super) fn give_back(&self, buffers: Buffers) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(buffers);
    }
}

impl Default for Buffers {
    fn default() -> Self {
        Self {
            red: Image::filled(0, 0, 0.0),
            rays: Rays::empty(),
            wanted: Vec::new(),
            fringes: Fringes::none(),
            coordinates: Vec::new(),
            depths: Vec::new(),
        }
    }
}
