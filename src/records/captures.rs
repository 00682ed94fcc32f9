//! The ring of kept captures: raw images in folders named for their record, the oldest removed for the newest.
//! In:  a record's id and a writer of its capture. Out: the folder, whole or not at all, after a while.
//! Not here: which vehicles are worth it ([`Policy`] proposes), what is in a capture.
//!
//! One thread of the ring's own writes, so that a cycle never waits for it. A folder is written under a temporary name,
//! synced and renamed; what a crash left under such a name is removed at the next start, and removing begins with
//! giving such a name.

use super::{Fault, Totals, Verdict, space};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard};
use std::thread::{self, JoinHandle};

/// The ring's folder in the records' one.
pub const CAPTURES: &str = "captures";
/// Ends the name of a folder that is being written or removed.
const PART: &str = "part";
/// Captures that may wait while one is written. Each holds its images in memory, 75 MB at full size, so it is one.
const WAITING: usize = 1;

/// What a writer's failing looks like: any error; "no room" is looked for among its causes.
pub type WriteError = Box<dyn std::error::Error + Send + Sync>;
type Write = Box<dyn FnOnce(&Path) -> Result<(), WriteError> + Send>;

/// The name of the capture that belongs to a record, in the ring's folder and for people.
pub fn capture_name(record: u64) -> String {
    format!("{record:010}")
}

/// Everything in `folder` that vehicles left: the journal's segments, the captures. Not the lock, the hours of light, or
/// what is none of ours.
pub fn of_vehicles(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<PathBuf> = super::reader::segments(folder).into_iter().flatten().map(|(_, file)| file).collect();
    let numbered = |path: &PathBuf| {
        let name = path.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        name.len() == capture_name(0).len() && name.bytes().all(|b| b.is_ascii_digit())
    };
    let captures = std::fs::read_dir(folder.join(CAPTURES)).into_iter().flatten().flatten();
    found.extend(captures.map(|e| e.path()).filter(numbered));
    found
}

/// Whose images are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Policy {
    /// Of the good vehicles every n-th, by this n; 0: none.
    pub nth_good: u32,
}

impl Policy {
    /// Whether the images of a vehicle are kept: every one that is not ok, every n-th that is, and whatever the PLC
    /// asks for. `totals`: as they are before this vehicle.
    pub fn keeps(self, verdict: Verdict, asked: bool, totals: &Totals) -> bool {
        let nth = self.nth_good != 0 && totals.ok.wrapping_add(1).is_multiple_of(self.nth_good);
        asked || verdict != Verdict::Ok || nth
    }
}

/// How the ring is.
#[derive(Clone, Debug, Default)]
pub struct Ring {
    /// Captures in it.
    pub captures: usize,
    /// Their size, bytes.
    pub bytes: u64,
    /// Written since the start.
    pub written: u64,
    /// Not taken since the start, as others waited.
    pub dropped: u64,
    /// Not written since the start, for a fault.
    pub failed: u64,
    /// What was wrong at the last attempt; none: it worked.
    pub fault: Option<Arc<Fault>>,
}

/// The ring. Dropped, it ends what waits to be written first.
pub struct Captures {
    queue: Option<SyncSender<(u64, Write)>>,
    ring: Arc<Mutex<Ring>>,
    thread: Option<JoinHandle<()>>,
}

impl Captures {
    /// The ring in the folder `records`, of `limit` bytes. With less than `floor` bytes free nothing is kept: the rest
    /// is the journal's. What a crash left half-written is removed, in the background as everything here.
    pub fn new(records: &Path, limit: u64, floor: u64) -> Self {
        let folder = records.join(CAPTURES);
        let ring = Arc::new(Mutex::new(Ring::default()));
        let (queue, waiting) = sync_channel(WAITING);
        let keeper = Keeper { folder, limit, floor, kept: None, ring: Arc::clone(&ring) };
        let thread = thread::Builder::new().name("captures".into()).spawn(move || keeper.run(waiting));
        let thread = Some(thread.expect("a thread at start-up"));
        Self { queue: Some(queue), ring, thread }
    }

    /// The usual floor, bytes: room for the journal to grow, and some.
    pub const FLOOR: u64 = 512 << 20;

    /// Has `write` write a capture into the folder it is given, for `record`. Returns at once: whether it was taken.
    /// Where one waits already the new one is not, and is counted: what was promised stays promised. Whether writing
    /// went well is said by [`Captures::ring`].
    #[must_use]
    pub fn keep(&self, record: u64, write: impl FnOnce(&Path) -> Result<(), WriteError> + Send + 'static) -> bool {
        let queue = self.queue.as_ref().expect("there until it is dropped");
        let taken = queue.try_send((record, Box::new(write))).is_ok(); // its thread ends after its queue only
        if !taken {
            tracing::warn!(record, "raw images not kept: the storage is behind, another capture waits");
            lock(&self.ring).dropped += 1;
        }
        taken
    }

    /// How the ring is, without waiting for the disk.
    pub fn ring(&self) -> Ring {
        lock(&self.ring).clone()
    }

    /// Waits for what is to be written, and says how the ring is then.
    pub fn finish(mut self) -> Ring {
        self.end();
        self.ring()
    }

    fn end(&mut self) {
        self.queue = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join(); // a panic of its own was reported by the runtime; there is nobody left to tell
        }
    }
}

impl Drop for Captures {
    fn drop(&mut self) {
        self.end();
    }
}

/// The thread's side.
struct Keeper {
    folder: PathBuf,
    limit: u64,
    floor: u64,
    /// Sizes by record, once the folder was read.
    kept: Option<BTreeMap<u64, u64>>,
    ring: Arc<Mutex<Ring>>,
}

impl Keeper {
    fn run(mut self, waiting: Receiver<(u64, Write)>) {
        let found = self.find();
        self.say(found.err());
        for (record, write) in waiting {
            let kept = self.find().and_then(|()| self.keep(record, write));
            match &kept {
                Ok(()) => lock(&self.ring).written += 1,
                Err(_) => lock(&self.ring).failed += 1,
            }
            self.say(kept.err());
        }
    }

    fn say(&self, fault: Option<Fault>) {
        if let Some(fault) = &fault {
            tracing::warn!(code = fault.code().number(), "{fault}");
        }
        let mut ring = lock(&self.ring);
        ring.fault = fault.map(Arc::new);
        ring.captures = self.kept.as_ref().map_or(0, BTreeMap::len);
        ring.bytes = self.bytes();
    }

    fn bytes(&self) -> u64 {
        self.kept.iter().flat_map(BTreeMap::values).sum()
    }

    /// Reads the folder, if that was not done before; removes what is half-written or half-removed.
    fn find(&mut self) -> Result<(), Fault> {
        if self.kept.is_some() {
            return Ok(());
        }
        let found = || {
            let mut kept = BTreeMap::new();
            let entries = match fs::read_dir(&self.folder) {
                Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(kept),
                entries => entries?,
            };
            for entry in entries {
                let path = entry?.path();
                let named = path.file_stem().and_then(|n| n.to_str()?.parse::<u64>().ok());
                match (named, path.extension()) {
                    (Some(_), Some(part)) if part == PART => fs::remove_dir_all(&path)?,
                    (Some(record), None) => drop(kept.insert(record, size(&path)?)),
                    _ => {} // none of ours
                }
            }
            Ok(kept)
        };
        self.kept = Some(found().map_err(|e| Fault::new(&self.folder, "captures", e))?);
        self.trim(0)
    }

    fn keep(&mut self, record: u64, write: Write) -> Result<(), Fault> {
        let fault = |file: &Path, e: io::Error| Fault::new(file, "a capture", e);
        fs::create_dir_all(&self.folder).map_err(|e| fault(&self.folder, e))?;
        if let Some(room) = space(&self.folder).ok().filter(|room| room.free < self.floor) {
            return Err(Fault::Floor { folder: self.folder.clone(), free: room.free, floor: self.floor });
        }
        // the next capture is about as large as the last one
        let expected = self.kept.iter().flat_map(BTreeMap::values).next_back().copied().unwrap_or(0);
        self.trim(expected.min(self.limit))?;
        let (whole, part) = self.names(record);
        let written = clear(&part).and_then(|()| fs::create_dir(&part)).map_err(|e| fault(&part, e)).and_then(|()| {
            let write = catch_unwind(AssertUnwindSafe(|| write(&part)));
            let write = write.unwrap_or_else(|_| Err("the capture's writer panicked".into()));
            write.map_err(|e| Fault::from_writer(&part, "a capture", e))?;
            sync(&part).map_err(|e| fault(&part, e))?;
            let bytes = size(&part).map_err(|e| fault(&part, e))?;
            if bytes > self.limit {
                return Err(Fault::TooLarge { what: "a capture", bytes, allowed: self.limit });
            }
            clear(&whole).and_then(|()| fs::rename(&part, &whole)).map_err(|e| fault(&whole, e))?;
            File::open(&self.folder).and_then(|f| f.sync_all()).map_err(|e| fault(&self.folder, e))?;
            Ok(bytes)
        });
        match written {
            Ok(bytes) => drop(self.kept.get_or_insert_default().insert(record, bytes)),
            Err(fault) => {
                let _ = clear(&part); // the cause is reported; what is left goes at the next start
                return Err(fault);
            }
        }
        self.trim(0)
    }

    /// Removes the oldest until there is room for `more` bytes.
    fn trim(&mut self, more: u64) -> Result<(), Fault> {
        while self.bytes() + more > self.limit {
            let Some(oldest) = self.kept.as_ref().and_then(|kept| Some(*kept.first_key_value()?.0)) else { break };
            let (whole, part) = self.names(oldest);
            let gone = clear(&part).and_then(|()| match fs::rename(&whole, &part) {
                Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()), // somebody was faster
                renamed => renamed.and_then(|()| fs::remove_dir_all(&part)),
            });
            gone.map_err(|e| Fault::new(&whole, "newer captures in its place", e))?;
            self.kept.as_mut().map(|kept| kept.remove(&oldest));
        }
        Ok(())
    }

    /// The folder of a whole capture, and of one that is written or removed.
    fn names(&self, record: u64) -> (PathBuf, PathBuf) {
        let whole = self.folder.join(capture_name(record));
        let part = whole.with_extension(PART);
        (whole, part)
    }
}

fn lock(ring: &Mutex<Ring>) -> MutexGuard<'_, Ring> {
    ring.lock().unwrap_or_else(std::sync::PoisonError::into_inner) // plain numbers: each state is a valid one
}

/// Removes a folder that may not be there.
fn clear(folder: &Path) -> io::Result<()> {
    match fs::remove_dir_all(folder) {
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        done => done,
    }
}

/// Bytes of all files below `folder`.
fn size(folder: &Path) -> io::Result<u64> {
    let mut bytes = 0;
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        let about = entry.metadata()?;
        bytes += if about.is_dir() { size(&entry.path())? } else { about.len() };
    }
    Ok(bytes)
}

/// Brings all below `folder` onto the disk, file by file: one large sync would make the journal's wait for all of it.
fn sync(folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_dir() { sync(&entry.path())? } else { File::open(entry.path())?.sync_all()? }
    }
    File::open(folder)?.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::code::Code;

    /// An empty folder for records, removed at the end.
    struct Room(PathBuf);

    impl Room {
        fn new(name: &str) -> Self {
            let room = std::env::temp_dir().join(format!("datum-captures-{name}-{}", std::process::id()));
            let _ = fs::remove_dir_all(&room);
            fs::create_dir_all(&room).expect("the temporary folder is writable");
            Self(room)
        }

        fn names(&self) -> Vec<String> {
            let Ok(entries) = fs::read_dir(self.0.join(CAPTURES)) else { return Vec::new() };
            let mut names: Vec<_> =
                entries.map(|e| e.expect("readable").file_name().to_string_lossy().into_owned()).collect();
            names.sort();
            names
        }
    }

    impl Drop for Room {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    /// A writer of `bytes` bytes in two files, one in a folder of its own.
    fn writes(bytes: usize) -> impl FnOnce(&Path) -> Result<(), WriteError> + Send + 'static {
        move |folder| {
            fs::write(folder.join("capture.toml"), vec![b'#'; bytes / 2])?;
            fs::create_dir(folder.join("vehicle"))?;
            Ok(fs::write(folder.join("vehicle/red.png"), vec![1; bytes - bytes / 2])?)
        }
    }

    /// Keeps one after the other, waiting for each: the queue is not what is tested.
    fn keep(room: &Room, limit: u64, record: u64, bytes: usize) -> Ring {
        let captures = Captures::new(&room.0, limit, 0);
        assert!(captures.keep(record, writes(bytes)));
        captures.finish()
    }

    #[test]
    fn the_oldest_go_first_and_the_limit_is_kept() {
        let room = Room::new("oldest");
        for record in [7, 8, 9, 10] {
            let ring = keep(&room, 2500, record, 1000);
            assert!(ring.fault.is_none() && ring.bytes <= 2500, "{ring:?}");
        }
        assert_eq!(room.names(), ["0000000009", "0000000010"]);
        let ring = keep(&room, 2500, 11, 2400);
        assert_eq!((ring.captures, ring.bytes, room.names()), (1, 2400, vec!["0000000011".into()]));
    }

    #[test]
    fn a_capture_larger_than_the_ring_is_refused_and_costs_no_other() {
        let room = Room::new("large");
        keep(&room, 2500, 1, 1000);
        let ring = keep(&room, 2500, 2, 3000);
        assert_eq!((ring.failed, room.names()), (1, vec!["0000000001".into()]));
        assert_eq!(ring.fault.expect("said").to_string(), "a capture of 3000 bytes, allowed: up to 2500");
    }

    #[test]
    fn what_a_crash_left_half_written_or_half_removed_goes_at_the_next_start() {
        let room = Room::new("crash");
        let captures = room.0.join(CAPTURES);
        for name in ["0000000003", "0000000004.part", "0000000001.part/vehicle", "by-hand"] {
            fs::create_dir_all(captures.join(name)).expect("writable");
        }
        fs::write(captures.join("0000000004.part/red.png"), "half").expect("writable");
        let ring = Captures::new(&room.0, 1000, 0).finish();
        assert!(ring.fault.is_none(), "{ring:?}");
        assert_eq!(room.names(), ["0000000003", "by-hand"]);
    }

    #[test]
    fn a_writer_that_fails_or_panics_leaves_nothing_and_the_next_one_works() {
        let room = Room::new("fails");
        let captures = Captures::new(&room.0, 10_000, 0);
        assert!(captures.keep(1, |folder| {
            writes(100)(folder)?;
            Err(io::Error::from(io::ErrorKind::StorageFull).into())
        }));
        let ring = captures.finish();
        assert_eq!((ring.failed, ring.fault.expect("said").code()), (1, Code::StorageFull));
        assert!(room.names().is_empty());
        let captures = Captures::new(&room.0, 10_000, 0);
        assert!(captures.keep(2, |_| panic!("a writer's bug, on purpose")));
        let ring = captures.finish();
        assert_eq!((ring.failed, ring.fault.expect("said").code()), (1, Code::StorageFault));
        let ring = keep(&room, 10_000, 3, 100);
        assert!(ring.fault.is_none() && room.names() == ["0000000003"], "{ring:?}");
    }

    #[test]
    fn when_others_wait_the_new_one_is_dropped_and_counted() {
        let room = Room::new("behind");
        let captures = Captures::new(&room.0, 10_000, 0);
        let (go, wait) = std::sync::mpsc::channel::<()>();
        let (told, heard) = std::sync::mpsc::channel();
        assert!(captures.keep(1, move |folder| {
            told.send(()).expect("the test waits");
            wait.recv().expect("the test lets it go");
            writes(10)(folder)
        }));
        heard.recv().expect("it has begun");
        assert!(captures.keep(2, writes(10)), "one may wait");
        assert!(!captures.keep(3, writes(10)));
        go.send(()).expect("it waits");
        let ring = captures.finish();
        assert_eq!((ring.written, ring.dropped, room.names().len()), (2, 1, 2));
    }

    #[test]
    fn below_the_floor_nothing_is_kept_and_that_is_901() {
        let room = Room::new("floor");
        let captures = Captures::new(&room.0, 1000, u64::MAX);
        assert!(captures.keep(1, writes(10)));
        let ring = captures.finish();
        assert_eq!((ring.failed, ring.fault.expect("said").code()), (1, Code::StorageFull));
        assert!(room.names().is_empty());
    }

    #[test]
    fn a_folder_that_cannot_be_is_said_and_works_once_it_can() {
        let room = Room::new("cannot");
        fs::write(room.0.join(CAPTURES), "a file in its place").expect("writable");
        let captures = Captures::new(&room.0, 1000, 0);
        assert!(captures.keep(1, writes(10)));
        let ring = captures.finish();
        assert_eq!((ring.failed, ring.fault.expect("said").code()), (1, Code::StorageFault));
        fs::remove_file(room.0.join(CAPTURES)).expect("there");
        assert!(keep(&room, 1000, 2, 10).fault.is_none());
    }

    #[test]
    fn every_vehicle_that_is_not_ok_and_every_nth_that_is_are_kept() {
        let keeps =
            |verdict, asked, ok| Policy { nth_good: 3 }.keeps(verdict, asked, &Totals { ok, ..Totals::default() });
        let kept: Vec<u32> = (1..=9).filter(|n| keeps(Verdict::Ok, false, n - 1)).collect();
        assert_eq!(kept, [3, 6, 9]);
        assert!(keeps(Verdict::Ok, true, 0) && keeps(Verdict::TooUncertain, false, 0));
        assert!(keeps(Verdict::OutOfLimits, false, 0) && keeps(Verdict::NotMeasurable, false, 0));
        assert!(!Policy { nth_good: 0 }.keeps(Verdict::Ok, false, &Totals::default()));
    }
}
