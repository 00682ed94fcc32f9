//! What can be wrong with the storage. In: what the system said. Out: a fault that names the file, and its code.

use crate::code::Code;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Why something was not stored. None of them ends measuring: the next attempt may work again.
#[derive(Debug, thiserror::Error)]
pub enum Fault {
    /// No room, or less than the share that is left to others.
    #[error("{}: {free} bytes free, allowed: {floor} or more", folder.display())]
    Floor {
        /// On the storage that holds it.
        folder: PathBuf,
        /// What is free, bytes.
        free: u64,
        /// What is left to others, bytes.
        floor: u64,
    },
    /// The system had no room, or a quota was reached.
    #[error("{}: no room for {what}", file.display())]
    Full {
        /// Where it was to go.
        file: PathBuf,
        /// What was to be stored.
        what: &'static str,
        /// What the system said.
        source: io::Error,
    },
    /// The system refused.
    #[error("{}: {what} could not be stored", file.display())]
    Failed {
        /// Where it was to go.
        file: PathBuf,
        /// What was to be stored.
        what: &'static str,
        /// What the system, or the caller's writer, said.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A record larger than any that is believed when read, or a capture larger than the ring.
    #[error("{what} of {bytes} bytes, allowed: up to {allowed}")]
    TooLarge {
        /// What.
        what: &'static str,
        /// Its size.
        bytes: u64,
        /// The largest.
        allowed: u64,
    },
    /// Another process writes these records.
    #[error("{}: held by another process that writes records here; is the service running?", lock.display())]
    Held {
        /// The lock.
        lock: PathBuf,
    },
    /// The storage does not answer. What was to be stored waits, and is stored if it answers again.
    #[error("{}: no answer within {waited:?}", folder.display())]
    Late {
        /// On the storage that holds it.
        folder: PathBuf,
        /// How long was waited.
        waited: Duration,
    },
}

impl Fault {
    /// From the system's word about `file`; "no room" is told apart.
    pub(super) fn new(file: &Path, what: &'static str, source: io::Error) -> Self {
        let file = file.into();
        if no_room(&source) { Self::Full { file, what, source } } else { Self::failed(file, what, source.into()) }
    }

    /// From a writer's error, whose cause may be that there was no room.
    pub(super) fn from_writer(file: &Path, what: &'static str, e: Box<dyn std::error::Error + Send + Sync>) -> Self {
        let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(&*e);
        while let Some(c) = cause {
            if let Some(source) = c.downcast_ref::<io::Error>().filter(|source| no_room(source)) {
                return Self::Full { file: file.into(), what, source: source.kind().into() };
            }
            cause = c.source();
        }
        Self::failed(file.into(), what, e)
    }

    fn failed(file: PathBuf, what: &'static str, source: Box<dyn std::error::Error + Send + Sync>) -> Self {
        Self::Failed { file, what, source }
    }

    /// What the PLC and the log are told: 901 if there is no room, else 902.
    pub fn code(&self) -> Code {
        match self {
            Self::Floor { .. } | Self::Full { .. } => Code::StorageFull,
            Self::Failed { .. } | Self::TooLarge { .. } | Self::Held { .. } | Self::Late { .. } => Code::StorageFault,
        }
    }
}

/// Full, a quota's end, or a process's own limit on file sizes.
fn no_room(e: &io::Error) -> bool {
    matches!(e.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded | io::ErrorKind::FileTooLarge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::PngError;

    #[test]
    fn no_room_is_901_and_everything_else_902() {
        let at = Path::new("records/journal-1");
        let full = Fault::new(at, "a record", io::ErrorKind::StorageFull.into());
        assert_eq!(
            (full.code(), full.to_string().as_str()),
            (Code::StorageFull, "records/journal-1: no room for a record")
        );
        let failed = Fault::new(at, "a record", io::ErrorKind::PermissionDenied.into());
        assert_eq!(failed.code(), Code::StorageFault);
        assert_eq!(failed.to_string(), "records/journal-1: a record could not be stored");
    }

    #[test]
    fn a_writers_error_is_searched_for_its_cause() {
        let png = |kind: io::ErrorKind| Box::new(PngError::Io { file: "red.png".into(), source: kind.into() });
        let at = Path::new("captures/1");
        assert_eq!(Fault::from_writer(at, "a capture", png(io::ErrorKind::QuotaExceeded)).code(), Code::StorageFull);
        assert_eq!(Fault::from_writer(at, "a capture", png(io::ErrorKind::NotFound)).code(), Code::StorageFault);
    }
}
