//! The journal's writer: one process appends, and what it was told is stored stays stored.
//! In:  events. Out: their ids, when they are on the disk; after a power cut all of them up to the last whole one.
//! Not here: reading ([`super::Reader`]), what is in a record.
//!
//! A record is framed, appended and synced before its id is returned. Whatever fails on the way leaves the file as it
//! was, or, where that cannot be made sure, a file that is written no more: the next record begins a new segment.
//! A segment is named for the first id it may hold, so that ids go on even where records were lost.

use super::frame::{self, LEAST, MAX_PAYLOAD, Piece};
use super::reader::{Damage, Head, MAGIC, head, segment, segments};
use super::record::{decode, encode};
use super::{Event, Fault, Totals, space};
use std::fs::{self, File, TryLockError};
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

/// The lock's name.
const LOCK: &str = "lock";

/// How much the journal may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// All segments together, bytes; beyond it the oldest go, but never the newest.
    pub journal: u64,
    /// One segment, bytes; a record that would not fit begins the next.
    pub segment: u64,
    /// With less than this free, bytes, nothing is appended: the rest is for the configuration and the log.
    pub floor: u64,
}

impl Limits {
    /// For a journal of so many MiB: sixteen segments, of 16 MiB at most, read at every start.
    pub fn of_mib(journal: u32) -> Self {
        let journal = u64::from(journal.max(1)) << 20;
        Self { journal, segment: (journal / 16).min(16 << 20), floor: 16 << 20 }
    }
}

/// What was found when the journal was opened.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recovery {
    /// What is no whole record in the newest segment. What was at its end is cut off.
    pub damage: Vec<Damage>,
    /// The id of the last whole record; 0: none, or it is not in the newest segment.
    pub last: u64,
}

/// The one writer of a folder's journal. It does not need the storage to be there: what fails is tried anew with the
/// next record.
pub struct Journal {
    folder: PathBuf,
    limits: Limits,
    /// As they were in the last whole record.
    recovered: Totals,
    /// Counted since.
    since: Totals,
    open: Option<Open>,
}

/// The folder's lock. Given back by name: a program that another thread is starting shares the file for a moment, and
/// with it a lock that is merely closed.
#[derive(Debug)]
pub struct Lock(File);

impl Lock {
    /// Takes it, for as long as the value lives; the folder must exist. `Err(Fault::Held)`: a service runs.
    pub fn hold(folder: &Path) -> Result<Self, Fault> {
        let lock = folder.join(LOCK);
        let fault = |e| Fault::new(&lock, "the journal", e);
        let file = File::options().write(true).create(true).truncate(false).open(&lock).map_err(fault)?;
        match file.try_lock() {
            Ok(()) => Ok(Self(file)),
            Err(TryLockError::WouldBlock) => Err(Fault::Held { lock }),
            Err(TryLockError::Error(e)) => Err(fault(e)),
        }
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        let _ = self.0.unlock(); // what cannot be unlocked is unlocked when it is closed
    }
}

/// What is known once the folder was read.
struct Open {
    _lock: Lock,
    /// First ids and sizes, the oldest first; the last one is `file`'s, if that is some.
    segments: Vec<(u64, u64)>,
    /// The segment that is written; none: the next record begins one.
    file: Option<File>,
    next: u64,
    frame: Vec<u8>,
}

impl Journal {
    /// The journal of `folder`, which is made with the first record. Nothing is read or written yet.
    pub fn new(folder: &Path, limits: Limits) -> Self {
        Self { folder: folder.into(), limits, recovered: Totals::default(), since: Totals::default(), open: None }
    }

    /// Locks the folder and reads its newest segment, if that was not done before: totals and ids go on from there.
    /// [`Fault::Held`] if another process writes here.
    pub fn open(&mut self) -> Result<Recovery, Fault> {
        if self.open.is_some() {
            return Ok(Recovery::default());
        }
        fs::create_dir_all(&self.folder).map_err(|e| Fault::new(&self.folder, "the journal", e))?;
        let (mut open, recovery, totals) = Open::recover(&self.folder)?;
        for damage in &recovery.damage {
            tracing::warn!("{damage}");
        }
        for torn in recovery.damage.iter().filter(|d| d.tail) {
            // first the segment that keeps the ids of what may have been lost from being given again, then the cut
            if open.segments.last().is_some_and(|(first, _)| segment(&self.folder, *first) == torn.file) {
                open.next += 1 + (torn.bytes.len() / LEAST) as u64;
                open.begin_segment(&self.folder, self.limits)?;
            }
            cut(&torn.file, torn.bytes.start as u64).map_err(|e| Fault::new(&torn.file, "the journal", e))?;
        }
        self.recovered = totals;
        self.open = Some(open);
        Ok(recovery)
    }

    /// What the station has done so far, as far as this journal knows.
    pub fn totals(&self) -> Totals {
        let mut totals = self.recovered.clone();
        totals.add(&self.since);
        totals
    }

    /// The totals in the last whole record before this start.
    pub(super) fn recovered(&self) -> &Totals {
        &self.recovered
    }

    /// To count what is in no event: triggers, reconnections, light. Stored with the next record.
    pub fn count(&mut self) -> &mut Totals {
        &mut self.since
    }

    /// Stores what happened at `at_ms` (ms since 1970) and returns its id once it is on the disk. An event that could
    /// not be stored is counted in the totals all the same; nothing of it is ever read.
    pub fn append(&mut self, at_ms: u64, event: &Event) -> Result<u64, Fault> {
        self.since.count(event);
        self.append_counted(at_ms, event)
    }

    /// As [`Journal::append`], of an event that was counted: `since` is what was counted since the start.
    pub(super) fn append_since(&mut self, at_ms: u64, event: &Event, since: Totals) -> Result<u64, Fault> {
        self.since = since;
        self.append_counted(at_ms, event)
    }

    fn append_counted(&mut self, at_ms: u64, event: &Event) -> Result<u64, Fault> {
        self.open()?;
        let payload = encode(at_ms, event, &self.totals());
        if payload.len() > MAX_PAYLOAD {
            let (bytes, allowed) = (payload.len() as u64, MAX_PAYLOAD as u64);
            return Err(Fault::TooLarge { what: "a record", bytes, allowed });
        }
        let open = self.open.as_mut().expect("opened just now");
        // a storage that cannot tell its room is tried all the same
        if let Some(room) = space(&self.folder).ok().filter(|room| room.free < self.limits.floor) {
            return Err(Fault::Floor { folder: self.folder.clone(), free: room.free, floor: self.limits.floor });
        }
        open.append(&self.folder, self.limits, &payload)
    }
}

impl Open {
    fn recover(folder: &Path) -> Result<(Self, Recovery, Totals), Fault> {
        let fault = |file: &Path, e: io::Error| Fault::new(file, "the journal", e);
        let lock = Lock::hold(folder)?;
        let mut sizes = Vec::new();
        let mut newest = None;
        for (first, file) in segments(folder).map_err(|e| fault(folder, e))? {
            sizes.push((first, fs::metadata(&file).map_err(|e| fault(&file, e))?.len()));
            newest = Some((first, file));
        }
        let mut open = Self { _lock: lock, segments: sizes, file: None, next: 1, frame: Vec::new() };
        let (mut recovery, mut totals) = (Recovery::default(), Totals::default());
        if let Some((first, file)) = newest {
            open.next = first.max(1);
            let bytes = fs::read(&file).map_err(|e| fault(&file, e))?;
            let damage = |bytes: std::ops::Range<usize>, tail| Damage { file: file.clone(), bytes, tail };
            let mut at = match head(&bytes) {
                Head::Ours => MAGIC.len(),
                Head::Unfinished => bytes.len(),
                Head::Damaged => {
                    recovery.damage.push(damage(0..MAGIC.len().min(bytes.len()), bytes.len() <= MAGIC.len()));
                    MAGIC.len().min(bytes.len())
                }
            };
            let mut above = open.next - 1;
            while let Some(piece) = frame::next(&bytes, &mut at, &mut above) {
                match piece {
                    Piece::Lost(lost) => recovery.damage.push(damage(lost.clone(), lost.end == bytes.len())),
                    Piece::Whole { id, payload } => {
                        recovery.last = id;
                        totals = decode(id, payload).map_or(totals, |record| record.totals);
                    }
                }
            }
            open.next = open.next.max(recovery.last.saturating_add(1));
            if recovery.last == 0 {
                // an empty segment is begun before there is a record to put into it: the totals are one further back
                totals = earlier_totals(folder, first);
                // nor may the one before have been cut, if the power failed between the two
                if let Some((_, before)) =
                    segments(folder).map_err(|e| fault(folder, e))?.into_iter().rfind(|s| s.0 < first)
                {
                    let bytes = fs::read(&before).map_err(|e| fault(&before, e))?;
                    let (mut at, mut above) = (MAGIC.len().min(bytes.len()), 0);
                    while let Some(piece) = frame::next(&bytes, &mut at, &mut above) {
                        if let Piece::Lost(lost) = piece
                            && lost.end == bytes.len()
                        {
                            recovery.damage.push(Damage { file: before.clone(), bytes: lost, tail: true });
                        }
                    }
                }
            }
            if recovery.damage.iter().all(|d| d.file != file) && head(&bytes) == Head::Ours {
                open.file = Some(File::options().append(true).open(&file).map_err(|e| fault(&file, e))?);
            }
        }
        Ok((open, recovery, totals))
    }

    fn append(&mut self, folder: &Path, limits: Limits, payload: &[u8]) -> Result<u64, Fault> {
        let longer = (payload.len() + LEAST) as u64;
        let fits = self.segments.last().is_some_and(|(_, bytes)| {
            bytes + longer <= limits.segment || *bytes == MAGIC.len() as u64 // one of its own for a large one
        });
        // one that somebody has deleted would take records into nothing
        let there = self.file.as_ref().is_some_and(|f| f.metadata().is_ok_and(|m| m.nlink() > 0));
        if !fits || !there {
            self.begin_segment(folder, limits)?;
        }
        let id = self.next;
        self.next += 1; // also if it fails: what remains of it on the disk must not share its id
        self.frame.clear();
        frame::encode(id, payload, &mut self.frame);
        let (first, bytes) = self.segments.last_mut().expect("begun");
        let file = self.file.as_mut().expect("begun");
        let written = file.write_all(&self.frame);
        let partly = written.is_err();
        if let Err(e) = written.and_then(|()| file.sync_data()) {
            // after a failed sync nobody knows what is on the disk, and a later sync may say "done": begin a new file
            let undone = file.set_len(*bytes);
            let path = segment(folder, *first);
            if !partly || undone.is_err() {
                self.file = None;
            }
            return Err(Fault::new(&path, "a record", e));
        }
        *bytes += self.frame.len() as u64;
        Ok(id)
    }

    /// Makes room for a segment, and begins it.
    fn begin_segment(&mut self, folder: &Path, limits: Limits) -> Result<(), Fault> {
        self.file = None;
        let mut all: u64 = self.segments.iter().map(|(_, bytes)| bytes).sum();
        while all + limits.segment > limits.journal && self.segments.len() > 1 {
            let (first, bytes) = self.segments[0];
            let oldest = segment(folder, first);
            match fs::remove_file(&oldest) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => {
                    return Err(Fault::new(&oldest, "a new segment in its place", e));
                }
                _ => {}
            }
            all -= bytes;
            self.segments.remove(0);
        }
        fs::create_dir_all(folder).map_err(|e| Fault::new(folder, "the journal", e))?;
        let path = segment(folder, self.next);
        let begun = || {
            // a leftover of an attempt that failed holds nothing that was acknowledged: its ids are still to come
            let mut file = File::create(&path)?;
            file.write_all(&MAGIC)?;
            file.sync_all()?;
            drop(file);
            File::open(folder)?.sync_all()?;
            let parent = folder.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            File::open(parent)?.sync_all()?; // the folder may be new, too
            File::options().append(true).open(&path)
        };
        let file = begun().map_err(|e| {
            let _ = fs::remove_file(&path); // the cause is reported; what is left is overwritten
            Fault::new(&path, "a segment", e)
        })?;
        self.segments.retain(|(first, _)| *first != self.next);
        self.segments.push((self.next, MAGIC.len() as u64));
        self.file = Some(file);
        Ok(())
    }
}

/// The totals in the newest whole record before id `first`; zeros if there is none that can be read.
fn earlier_totals(folder: &Path, first: u64) -> Totals {
    let older = segments(folder).unwrap_or_default().into_iter().rev().filter(|(f, _)| *f < first);
    for (_, file) in older {
        let bytes = fs::read(&file).unwrap_or_default();
        let (mut at, mut above, mut totals) = (MAGIC.len(), 0, None);
        while let Some(piece) = frame::next(&bytes, &mut at, &mut above) {
            if let Piece::Whole { id, payload } = piece {
                totals = decode(id, payload).map(|record| record.totals).or(totals);
            }
        }
        if let Some(totals) = totals {
            return totals;
        }
    }
    Totals::default()
}

fn cut(file: &Path, length: u64) -> io::Result<()> {
    let f = File::options().write(true).open(file)?;
    f.set_len(length)?;
    f.sync_all()
}
