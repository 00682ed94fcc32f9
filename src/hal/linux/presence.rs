//! The presence sensor on a GPIO line. In: edges, as the kernel stamps them. Out: what the sensor says and since when.
//! A bounce restarts that time, however short it is: whoever asks for a steady level never sees it as a vehicle.

use super::gpio::{Input, LineName};
use crate::hal::{Error, Presence, Reading};
use gpiod::EdgeDetect;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

const DEVICE: &str = "presence";

/// A presence sensor.
pub struct PresenceLine {
    seen: Arc<(Mutex<Seen>, Condvar)>,
}

struct Seen {
    reading: Reading,
    /// What ended the watching.
    lost: bool,
}

impl PresenceLine {
    /// The sensor on a line. `active_low`: a vehicle pulls it down.
    pub fn open(name: &LineName, active_low: bool) -> Result<Self, Error> {
        let mut line = Input::open(DEVICE, name, active_low, EdgeDetect::Both)?;
        let reading = Reading { present: line.level()?, since: super::clock::monotonic() };
        let seen = Arc::new((Mutex::new(Seen { reading, lost: false }), Condvar::new()));
        let watched = Arc::clone(&seen);
        // it ends with the process, or with the line: the kernel wakes a reader for nothing else
        let thread = std::thread::Builder::new().name(DEVICE.into()).spawn(move || {
            let (state, changed) = &*watched;
            loop {
                // the level is read after the edge: where edges were lost, the last one still tells the truth
                let edge = line.edge().and_then(|at| Ok((at, line.level()?)));
                let mut state = held(state);
                match edge {
                    Ok((at, present)) => state.reading = Reading { present, since: at },
                    Err(e) => {
                        tracing::warn!("{e}");
                        state.lost = true;
                    }
                }
                changed.notify_all();
                if state.lost {
                    return;
                }
            }
        });
        thread.map_err(|source| Error::Call { device: DEVICE.into(), call: "thread", source })?;
        Ok(Self { seen })
    }
}

fn held(seen: &Mutex<Seen>) -> MutexGuard<'_, Seen> {
    seen.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Presence for PresenceLine {
    fn wait(&mut self, present: bool, timeout: Duration) -> Result<Reading, Error> {
        let (state, changed) = &*self.seen;
        let deadline = Instant::now() + timeout;
        let mut seen = held(state);
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if seen.lost {
                return Err(Error::Gone { device: DEVICE.into() });
            }
            if seen.reading.present == present || left.is_zero() {
                return Ok(seen.reading);
            }
            seen = changed.wait_timeout(seen, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }
}
