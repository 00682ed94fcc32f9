//! Reading the journal, also while the service writes it.
//! In:  the folder. Out: whole records in the order of their ids, and where there was damage. No lock is taken: a
//! record that is being written has no valid CRC yet, and is not seen.
//! Not here: repair; only the writer changes files.

use super::Record;
use super::frame::{self, Piece};
use super::record::decode;
use crate::document::{Error, read_bytes};
use std::collections::VecDeque;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::{fmt, io};

/// First bytes of a segment; the last one is the major version.
pub(super) const MAGIC: [u8; 8] = *b"datumjn\x01";
/// A segment's name is this and its first id.
const PREFIX: &str = "journal-";
/// The longest segment that is read; the writer's are shorter by far.
const MAX_SEGMENT: u64 = 1 << 30;

/// What comes out of a journal.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// A whole record.
    Record(Box<Record>),
    /// A whole record that a later version of the program wrote.
    Later {
        /// Its key.
        id: u64,
    },
    /// Bytes that are no whole record.
    Damage(Damage),
}

/// Bytes that are no whole record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// The segment.
    pub file: PathBuf,
    /// Where in it.
    pub bytes: Range<usize>,
    /// They are the journal's last: torn by a power cut, or a record that is being written now.
    pub tail: bool,
}

/// "records/journal-…1: bytes 312 to 811 are no whole record: damaged".
impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let why = if self.tail { "not acknowledged, or damaged at the end" } else { "damaged" };
        let Range { start, end } = self.bytes;
        write!(f, "{}: bytes {start} to {end} are no whole record: {why}", self.file.display())
    }
}

/// A journal being read, from the oldest record to the newest.
pub struct Reader {
    segments: VecDeque<(u64, PathBuf)>,
    file: PathBuf,
    bytes: Vec<u8>,
    at: usize,
    above: u64,
}

impl Reader {
    /// Finds the segments of `folder`; they are read one after the other.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let segments = segments(folder).map_err(|source| Error::Read { file: folder.into(), source })?;
        Ok(Self { segments: segments.into(), file: PathBuf::new(), bytes: Vec::new(), at: 0, above: 0 })
    }
}

impl Reader {
    /// No segment is left that holds anything: one may have been begun and the power have failed before the torn end of the
    /// one before it was cut.
    fn nothing_follows(&self) -> bool {
        let empty = |file: &Path| std::fs::metadata(file).is_ok_and(|m| m.len() <= MAGIC.len() as u64);
        self.segments.iter().all(|(_, file)| empty(file))
    }
}

impl Iterator for Reader {
    type Item = Result<Found, Error>;

    fn next(&mut self) -> Option<Self::Item> {
        while self.at >= self.bytes.len() {
            let (_, file) = self.segments.pop_front()?;
            match read_bytes(&file, MAX_SEGMENT) {
                Ok(bytes) => self.bytes = bytes,
                // the writer has removed it since it was found: it was the oldest
                Err(Error::Read { source, .. }) if source.kind() == io::ErrorKind::NotFound => continue,
                Err(e) => return Some(Err(e)),
            }
            self.file = file;
            self.at = MAGIC.len().min(self.bytes.len());
            if head(&self.bytes) == Head::Damaged {
                let tail = self.at == self.bytes.len() && self.nothing_follows();
                return Some(Ok(Found::Damage(Damage { file: self.file.clone(), bytes: 0..self.at, tail })));
            }
        }
        Some(Ok(match frame::next(&self.bytes, &mut self.at, &mut self.above)? {
            Piece::Whole { id, payload } => {
                decode(id, payload).map_or(Found::Later { id }, |record| Found::Record(Box::new(record)))
            }
            Piece::Lost(bytes) => {
                let tail = bytes.end == self.bytes.len() && self.nothing_follows();
                Found::Damage(Damage { file: self.file.clone(), bytes, tail })
            }
        }))
    }
}

/// How a segment begins.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Head {
    /// As this version writes it.
    Ours,
    /// Nothing, or a part of it: it was being begun, and holds nothing.
    Unfinished,
    /// Something else. What follows may be whole all the same.
    Damaged,
}

/// How the segment with these `bytes` begins.
pub(super) fn head(bytes: &[u8]) -> Head {
    if bytes.starts_with(&MAGIC) {
        Head::Ours
    } else if MAGIC.starts_with(bytes) {
        Head::Unfinished
    } else {
        Head::Damaged
    }
}

/// The segments of `folder` with their first ids, the oldest first.
pub(super) fn segments(folder: &Path) -> io::Result<Vec<(u64, PathBuf)>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        let first = path.file_name().and_then(|n| n.to_str()?.strip_prefix(PREFIX)?.parse().ok());
        found.extend(first.map(|first: u64| (first, path)));
    }
    found.sort();
    Ok(found)
}

/// The file of the segment whose first id is `first`.
pub(super) fn segment(folder: &Path, first: u64) -> PathBuf {
    folder.join(format!("{PREFIX}{first:020}"))
}
