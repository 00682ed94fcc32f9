//! Room for what vehicles are measured with, used by one after another: images, fringes, depths, lists.
//! In: the room of vehicles that are done. Out: the same, for the next. Not here: how it is lent.

use crate::lent::Spare;
use std::ops::Deref;
use std::sync::{Arc, Mutex, PoisonError};

/// Room for as many vehicles as are measured at one time, whatever their models. Clones share it.
#[derive(Clone, Default)]
pub struct Workspace(Arc<Mutex<Vec<Spare>>>);

/// That of one vehicle, until it is dropped.
pub(super) struct Room {
    spare: Spare,
    of: Workspace,
}

impl Workspace {
    /// That of an earlier vehicle, or new room.
    pub(super) fn room(&self) -> Room {
        let spare = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        Room { spare: spare.unwrap_or_default(), of: self.clone() }
    }
}

impl Deref for Room {
    type Target = Spare;

    fn deref(&self) -> &Spare {
        &self.spare
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        self.of.0.lock().unwrap_or_else(PoisonError::into_inner).push(self.spare.clone());
    }
}
