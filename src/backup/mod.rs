//! Everything that makes this station this station, in one file, and back.
//! In:  a station's configuration and what it names. Out: a [`Backup`]; a station made from one, with what it replaces kept
//! aside; a station as it left the factory.
//! Not here: records, which are what a station did and not what it is.

mod belongings;
mod file;
mod reset;
mod restore;

pub use belongings::{IDENTITY, belongings, unusable_jobs};
pub use file::Backup;
pub use reset::{Reset, reset};
pub use restore::{Change, Restore};
