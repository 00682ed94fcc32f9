//! A projector that stores its pictures (the pattern mode of DLP projectors): a pulse on one line shows the next one, a
//! pulse on another the first, which is black. What it shows it tells by a pulse of its own, which is counted.
//! In:  pictures to show, each of which must be among the stored ones. Out: light.
//! Not here: how the pictures come into the projector (its maker's tool); the camera.

use super::gpio::{Input, LineName, Output, Switch};
use crate::hal::{self, Error};
use crate::image::Image;
use gpiod::EdgeDetect;
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

const DEVICE: &str = "projector";
/// The projector's own pulse comes within.
const ANSWER: Duration = Duration::from_millis(100);

/// How a sequenced projector is wired, and what it stores.
#[derive(Clone, Debug)]
pub struct SequencedSettings {
    /// Shows the next picture.
    pub advance: LineName,
    /// Shows the first one.
    pub restart: LineName,
    /// Tells of each picture that is shown; none: it is trusted.
    pub trigger_out: Option<LineName>,
    /// How long a pulse, and the pause after it, is.
    pub pulse: Duration,
    /// From when it shows a picture until its light is steady.
    pub settle: Duration,
    /// Columns and rows.
    pub size: (usize, usize),
    /// The stored pictures in their order; the first is black.
    pub stored: Vec<Image<u8>>,
}

/// Counts the pictures that the projector says it has shown.
trait Count: Send {
    /// How many so far.
    fn count(&self) -> u64;
    /// Waits until there were so many, or for `timeout`; how many there were.
    fn reach(&self, count: u64, timeout: Duration) -> u64;
}

/// A projector with stored pictures.
pub struct SequencedProjector {
    sequence: Sequence<Output, Pulses>,
    size: (usize, usize),
    stored: Vec<Image<u8>>,
    /// Where each loaded picture is stored.
    loaded: Vec<usize>,
    settle: Duration,
}

impl SequencedProjector {
    /// Takes the lines and shows nothing.
    pub fn open(settings: SequencedSettings) -> Result<Self, Error> {
        let black = settings.stored.first().is_some_and(|p| p.pixels.iter().all(|v| *v == 0));
        if !black {
            let there = vec![format!("{} pictures", settings.stored.len())];
            return Err(Error::Absent {
                device: DEVICE.into(),
                what: "stored picture",
                wanted: "black, the first".into(),
                there,
            });
        }
        let mut sequence = Sequence {
            advance: Output::open(DEVICE, &settings.advance, false)?,
            restart: Output::open(DEVICE, &settings.restart, false)?,
            told: settings.trigger_out.as_ref().map(Pulses::open).transpose()?,
            pulse: settings.pulse,
            at: None,
        };
        sequence.go(0)?;
        let (size, settle) = (settings.size, settings.settle);
        Ok(Self { sequence, size, stored: settings.stored, loaded: Vec::new(), settle })
    }
}

impl hal::Projector for SequencedProjector {
    fn size(&self) -> (usize, usize) {
        self.size
    }

    fn load(&mut self, pictures: &[Image<u8>]) -> Result<(), Error> {
        self.loaded.clear();
        let place = |(k, picture): (usize, &Image<u8>)| {
            let (found, allowed) = ((picture.width, picture.height), self.size);
            if found != allowed {
                return Err(Error::Size { device: DEVICE.into(), what: "picture", found, allowed });
            }
            self.stored.iter().position(|s| s == picture).ok_or_else(|| {
                let there = vec![format!("{} others: write them anew by `datum patterns --stored`", self.stored.len())];
                let wanted = format!("picture {k} of those to be shown");
                Error::Absent { device: DEVICE.into(), what: "stored picture", wanted, there }
            })
        };
        let places: Result<Vec<usize>, Error> = pictures.iter().enumerate().map(place).collect();
        self.loaded = places?;
        self.show(None)
    }

    fn show(&mut self, picture: Option<usize>) -> Result<(), Error> {
        let loaded = self.loaded.len();
        let place = match picture {
            Some(picture) if picture >= loaded => {
                return Err(Error::NotLoaded { device: DEVICE.into(), picture, loaded });
            }
            Some(picture) => self.loaded[picture],
            None => 0,
        };
        self.sequence.go(place)?;
        std::thread::sleep(self.settle);
        Ok(())
    }

    /// Only light tells.
    fn check(&mut self) -> Result<(), Error> {
        Ok(())
    }
}

/// Shows nothing, whatever it shows now.
pub fn sequenced_dark(restart: &LineName, pulse: Duration) -> Result<(), Error> {
    pulse_on(&mut Output::open(DEVICE, restart, false)?, pulse)
}

struct Sequence<L, C> {
    advance: L,
    restart: L,
    told: Option<C>,
    pulse: Duration,
    /// The stored picture that is shown, as far as that is known.
    at: Option<usize>,
}

impl<L: Switch, C: Count> Sequence<L, C> {
    /// Shows the stored picture at `place`. After an error nobody knows what is shown: the next call starts at the first.
    fn go(&mut self, place: usize) -> Result<(), Error> {
        let (from, restart) = match self.at.take() {
            Some(at) if at <= place => (at, false),
            _ => (0, true),
        };
        if restart {
            self.one(true)?;
        }
        for _ in from..place {
            self.one(false)?;
        }
        self.at = Some(place);
        Ok(())
    }

    /// One pulse, and its answer: exactly one.
    fn one(&mut self, restart: bool) -> Result<(), Error> {
        let before = self.told.as_ref().map(Count::count);
        pulse_on(if restart { &mut self.restart } else { &mut self.advance }, self.pulse)?;
        if let (Some(told), Some(before)) = (&self.told, before) {
            let found = told.reach(before + 1, ANSWER) - before;
            if found != 1 {
                return Err(Error::Pulses { device: DEVICE.into(), found, allowed: 1 });
            }
        }
        Ok(())
    }
}

fn pulse_on(line: &mut impl Switch, pulse: Duration) -> Result<(), Error> {
    line.set(true)?;
    std::thread::sleep(pulse);
    line.set(false)?;
    std::thread::sleep(pulse);
    Ok(())
}

/// Rising edges of the trigger-out line, counted as they come.
struct Pulses(Arc<(Mutex<u64>, Condvar)>);

impl Pulses {
    fn open(name: &LineName) -> Result<Self, Error> {
        let mut line = Input::open(DEVICE, name, false, EdgeDetect::Rising)?;
        let counted = Arc::new((Mutex::new(0), Condvar::new()));
        let ours = Arc::downgrade(&counted);
        // it ends with the process or with the line: the kernel wakes a reader for nothing else
        let thread = std::thread::Builder::new().name("trigger-out".into()).spawn(move || {
            while line.edge().is_ok() {
                let Some(counted) = ours.upgrade() else { return };
                *counted.0.lock().unwrap_or_else(PoisonError::into_inner) += 1;
                counted.1.notify_all();
            }
        });
        thread.map_err(|source| Error::Call { device: DEVICE.into(), call: "thread", source })?;
        Ok(Self(counted))
    }
}

impl Count for Pulses {
    fn count(&self) -> u64 {
        *self.0.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn reach(&self, count: u64, timeout: Duration) -> u64 {
        let deadline = Instant::now() + timeout;
        let mut so_far = self.0.0.lock().unwrap_or_else(PoisonError::into_inner);
        while *so_far < count {
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            so_far = self.0.1.wait_timeout(so_far, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        *so_far
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A projector at the other end of the wires.
    #[derive(Default)]
    struct Far {
        shown: usize,
        told: u64,
        /// Pulses of ours that it does not see, and of its own that it adds, counted from the next one.
        misses: Option<u64>,
        adds: Option<u64>,
        pulses: u64,
    }

    struct Wire(Arc<Mutex<Far>>, bool);

    impl Switch for Wire {
        fn set(&mut self, on: bool) -> Result<(), Error> {
            let mut far = self.0.lock().expect("no panic");
            if on {
                far.pulses += 1;
                if far.misses != Some(far.pulses) {
                    far.shown = if self.1 { 0 } else { far.shown + 1 };
                    far.told += 1 + u64::from(far.adds == Some(far.pulses));
                }
            }
            Ok(())
        }
    }

    struct Told(Arc<Mutex<Far>>);

    impl Count for Told {
        fn count(&self) -> u64 {
            self.0.lock().expect("no panic").told
        }
        fn reach(&self, _: u64, _: Duration) -> u64 {
            self.count()
        }
    }

    fn sequence(far: &Arc<Mutex<Far>>) -> Sequence<Wire, Told> {
        let wire = |restart| Wire(Arc::clone(far), restart);
        let told = Some(Told(Arc::clone(far)));
        Sequence { advance: wire(false), restart: wire(true), told, pulse: Duration::ZERO, at: None }
    }

    #[test]
    fn pictures_are_reached_forwards_or_from_the_first() {
        let far = Arc::new(Mutex::new(Far { shown: 5, ..Far::default() }));
        let mut sequence = sequence(&far);
        for (place, pulses) in [(0, 1), (1, 2), (0, 3), (2, 5), (3, 6), (3, 6), (17, 20), (2, 23)] {
            sequence.go(place).expect("it answers");
            let far = far.lock().expect("no panic");
            assert_eq!((far.shown, far.pulses), (place, pulses));
        }
    }

    #[test]
    fn a_pulse_that_is_missed_or_one_too_many_is_an_error_and_the_next_call_starts_at_the_first() {
        for (misses, adds, found) in [(Some(3), None, 0), (None, Some(3), 2)] {
            let far = Arc::new(Mutex::new(Far { misses, adds, ..Far::default() }));
            let mut sequence = sequence(&far);
            let e = sequence.go(4).expect_err("the third pulse").to_string();
            assert_eq!(e, format!("projector: {found} pulses of its trigger-out, allowed: 1"));
            sequence.go(2).expect("it answers");
            assert_eq!(far.lock().expect("no panic").shown, 2);
        }
    }
}
