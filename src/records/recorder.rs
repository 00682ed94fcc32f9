//! The journal on a thread of its own, so that a storage that no longer answers cannot hold the cycle up.
//! In:  events. Out: their ids, or after some patience a fault: the event waits then, and is stored if it can be.

use super::{Event, Fault, Journal, Limits, Recovery, Space, Totals, space};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

/// Events that may wait for a storage: some hours of vehicles. What comes then is counted, and not stored.
const WAITING: usize = 256;

/// An event on its way to the journal.
struct Waiting {
    at_ms: u64,
    event: Event,
    since: Totals,
    answer: SyncSender<Result<u64, Fault>>,
}

/// What the thread has last seen.
#[derive(Clone, Debug, Default)]
struct Seen {
    recovered: Totals,
    space: Option<Space>,
}

/// A [`Journal`] on a thread of its own. Dropped, it ends what waits, if that takes no longer than its patience.
pub struct Recorder {
    folder: PathBuf,
    patience: Duration,
    /// None once it ends.
    queue: Option<SyncSender<Waiting>>,
    /// Closed when the thread has ended, and the folder's lock is free.
    ended: Receiver<()>,
    seen: Arc<Mutex<Seen>>,
    since: Totals,
    /// The first event that was not answered in time.
    late: Option<Receiver<Result<u64, Fault>>>,
}

impl Recorder {
    /// How long a cycle may wait for its record: most of the time between its last image and its result's limit.
    pub const PATIENCE: Duration = Duration::from_millis(500);

    /// The journal of `folder`, and what was found there. [`Fault::Held`] means that another process writes there;
    /// all other faults are tried anew with each record.
    pub fn new(folder: &Path, limits: Limits, patience: Duration) -> (Self, Result<Recovery, Fault>) {
        let (queue, waiting) = sync_channel::<Waiting>(WAITING);
        let (opened, heard) = sync_channel(1);
        let (end, ended) = sync_channel(1);
        let seen = Arc::new(Mutex::new(Seen::default()));
        let (mut journal, shared, place) = (Journal::new(folder, limits), Arc::clone(&seen), folder.to_owned());
        let tell = move |journal: &Journal| {
            let now = Seen { recovered: journal.recovered().clone(), space: space(&place).ok() };
            *shared.lock().unwrap_or_else(PoisonError::into_inner) = now;
        };
        let run = move || {
            let recovery = journal.open();
            tell(&journal);
            let _ = opened.send(recovery); // nobody waits for it any more if it took long
            for Waiting { at_ms, event, since, answer } in waiting {
                let id = journal.append_since(at_ms, &event, since);
                tell(&journal);
                if let Err(fault) = &id {
                    tracing::warn!(code = fault.code().number(), "{fault}");
                }
                let _ = answer.send(id); // as above
            }
            drop(journal);
            drop(end);
        };
        // it is not joined: a storage that does not answer would keep the program from ending
        thread::Builder::new().name("journal".into()).spawn(run).expect("a thread at start-up");
        let (folder, since) = (folder.to_owned(), Totals::default());
        let recorder = Self { folder, patience, queue: Some(queue), ended, seen, since, late: None };
        let recovery = heard.recv_timeout(patience).unwrap_or_else(|_| Err(recorder.no_answer()));
        (recorder, recovery)
    }

    /// What the station has done so far: of earlier runs, as soon as the storage has answered, and of this one.
    pub fn totals(&self) -> Totals {
        let mut totals = self.seen().recovered;
        totals.add(&self.since);
        totals
    }

    /// The room on the storage, as it was after the last record; none if it was not to be had.
    pub fn space(&self) -> Option<Space> {
        self.seen().space
    }

    fn seen(&self) -> Seen {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// To count what is in no event: triggers, reconnections, light. Stored with the next record.
    pub fn count(&mut self) -> &mut Totals {
        &mut self.since
    }

    /// Stores what happened at `at_ms` (ms since 1970) and returns its id once it is on the disk; waits for that as
    /// long as its patience allows, and not at all while an earlier event has not been answered.
    pub fn append(&mut self, at_ms: u64, event: Event) -> Result<u64, Fault> {
        self.since.count(&event);
        let (answer, heard) = sync_channel(1);
        let queue = self.queue.as_ref().expect("there until it is dropped");
        let taken = queue.try_send(Waiting { at_ms, event, since: self.since.clone(), answer });
        if self.late.as_ref().is_some_and(|late| matches!(late.try_recv(), Err(TryRecvError::Empty))) {
            return Err(self.no_answer());
        }
        self.late = None;
        taken.map_err(|_| self.no_answer())?;
        match heard.recv_timeout(self.patience) {
            Ok(answer) => answer,
            Err(_) => {
                self.late = Some(heard);
                Err(self.no_answer())
            }
        }
    }

    fn no_answer(&self) -> Fault {
        Fault::Late { folder: self.folder.clone(), waited: self.patience }
    }
}

impl Drop for Recorder {
    fn drop(&mut self) {
        self.queue = None;
        let _ = self.ended.recv_timeout(self.patience); // closed, or it takes too long: the program ends all the same
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Boot, Found, Reader};
    use super::*;
    use crate::code::Code;
    use std::fs;

    fn boot() -> Event {
        Event::Boot(Boot::default())
    }

    #[test]
    fn a_storage_that_does_not_answer_is_902_and_what_waited_is_stored_when_it_does() {
        let folder = std::env::temp_dir().join(format!("datum-recorder-{}", std::process::id()));
        let _ = fs::remove_dir_all(&folder);
        fs::create_dir_all(&folder).expect("writable");
        // to open a pipe for writing waits until somebody reads: as a dead disk does, but not for ever
        let pipe = std::process::Command::new("mkfifo").arg(folder.join("lock")).status();
        if !pipe.is_ok_and(|s| s.success()) {
            eprintln!("skipped: no mkfifo here");
            return;
        }
        let limits = Limits { journal: 1 << 20, segment: 1 << 16, floor: 0 };
        let (mut recorder, opened) = Recorder::new(&folder, limits, Duration::from_millis(1));
        assert!(matches!(opened, Err(Fault::Late { .. })), "{opened:?}");
        for _ in 0..3 {
            let fault = recorder.append(0, boot()).expect_err("nobody reads the pipe");
            assert_eq!(
                (fault.code(), fault.to_string().ends_with(": no answer within 1ms")),
                (Code::StorageFault, true)
            );
        }
        assert_eq!(recorder.totals().boots, 3);
        let reading = fs::File::open(folder.join("lock")).expect("the journal's thread writes");
        recorder.patience = Duration::from_secs(60);
        recorder.late.take().expect("the first one").recv().expect("an answer").expect("stored");
        assert_eq!(recorder.append(0, boot()).expect("stored"), 4);
        assert_eq!(recorder.totals().boots, 4);
        let found: Vec<_> = Reader::open(&folder).expect("there").map(|f| f.expect("readable")).collect();
        let boots = found.iter().map(|f| if let Found::Record(r) = f { r.totals.boots } else { 0 });
        assert_eq!(boots.collect::<Vec<_>>(), [1, 2, 3, 4]);
        assert!(recorder.space().is_some_and(|s| s.of > 0));
        drop(recorder);
        let (again, opened) = Recorder::new(&folder, limits, Duration::from_secs(60));
        assert_eq!((opened.expect("the lock is free").last, again.totals().boots), (4, 4));
        drop(reading);
        fs::remove_dir_all(&folder).expect("there");
    }
}
