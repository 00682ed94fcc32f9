//! The light bars: a GPIO line switches each, a PWM channel dims it, and a line that must keep pulsing enables both.
//! In:  drives. Out: the drives taken. Off when dropped.
//!
//! The last line is the hardware's dead-man: the bars' supply is on only while a retriggerable monostable sees pulses, so
//! that a program that is killed, or a kernel that hangs, leaves them dark. Pulses end [`HOLD`] after the last request.

use super::Sys;
use super::gpio::{LineName, Output, Switch};
use super::pwm::{Channel, ChannelName, Dimmer};
use crate::hal::{Error, LightBars};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

const DEVICE: &str = "lights";
/// From one edge of the pulses to the next; the hardware waits for several.
const PULSE: Duration = Duration::from_millis(20);
/// No light is on for longer without being asked for again.
const HOLD: Duration = Duration::from_secs(10);

/// How the bars are wired.
#[derive(Clone, Debug)]
pub struct BarSettings {
    /// What switches the left and the right one, seen from the camera.
    pub lines: [LineName; 2],
    /// What dims them.
    pub dimmers: [ChannelName; 2],
    /// The dimmers' frequency, Hz.
    pub hz: f64,
    /// A bar is on where its line is low.
    pub active_low: bool,
    /// The dead-man's line; none: there is none.
    pub alive: Option<LineName>,
    /// Until the light is steady.
    pub settle: Duration,
}

/// Both bars.
pub struct Bars {
    bars: [Bar<Output, Channel>; 2],
    taken: [f64; 2],
    settle: Duration,
    /// Extends the pulses; dropping it ends them.
    alive: Option<Sender<Instant>>,
}

impl Bars {
    /// Takes lines and channels; the bars are off from then on.
    pub fn open(sys: &Sys, settings: &BarSettings) -> Result<Self, Error> {
        let bar = |k: usize| -> Result<_, Error> {
            let dimmer = Channel::open(DEVICE, sys, &settings.dimmers[k], settings.hz)?;
            Ok(Bar { line: Output::open(DEVICE, &settings.lines[k], settings.active_low)?, dimmer })
        };
        let bars = [bar(0)?, bar(1)?];
        let alive =
            settings.alive.as_ref().map(|name| Output::open(DEVICE, name, false).and_then(pulse)).transpose()?;
        Ok(Self { bars, taken: [0.0; 2], settle: settings.settle, alive })
    }
}

/// Every output dark, as far as each can be reached, whatever state its last program left it in; what could not be.
/// Where another program holds a line nothing is touched: the lights are in its hands.
pub fn dark(sys: &Sys, settings: &BarSettings) -> Vec<Error> {
    let line = |name, active_low| Output::open(DEVICE, name, active_low).map(|_| ());
    let lines = settings.lines.iter().map(|name| line(name, settings.active_low));
    let mut wrong: Vec<Error> =
        lines.chain(settings.alive.iter().map(|name| line(name, false))).filter_map(Result::err).collect();
    if !wrong.iter().any(|e| matches!(e, Error::Held { .. })) {
        let channels = settings.dimmers.iter().map(|name| Channel::open(DEVICE, sys, name, settings.hz).map(|_| ()));
        wrong.extend(channels.filter_map(Result::err));
    }
    wrong
}

impl LightBars for Bars {
    fn set(&mut self, drive: [f64; 2]) -> Result<[f64; 2], Error> {
        if let Some(value) = drive.into_iter().find(|d| !(0.0..=1.0).contains(d)) {
            return Err(Error::Setting { device: DEVICE.into(), setting: "drive", value, allowed: "0 to 1" });
        }
        if let Some(alive) = &self.alive
            && drive != [0.0; 2]
        {
            let _ = alive.send(Instant::now() + HOLD); // a thread that has ended lets the hardware turn the bars off
        }
        let before = self.taken;
        self.taken = set(&mut self.bars, drive)?;
        if self.taken != before {
            std::thread::sleep(self.settle);
        }
        Ok(self.taken)
    }
}

impl Drop for Bars {
    fn drop(&mut self) {
        let _ = set(&mut self.bars, [0.0; 2]); // there is nobody left to tell
    }
}

struct Bar<L, D> {
    line: L,
    dimmer: D,
}

/// Sets both, or turns both off as far as they can be.
fn set<L: Switch, D: Dimmer>(bars: &mut [Bar<L, D>; 2], drive: [f64; 2]) -> Result<[f64; 2], Error> {
    let mut taken = [0.0; 2];
    for (k, bar) in bars.iter_mut().enumerate() {
        match bar.set(drive[k]) {
            Ok(found) => taken[k] = found,
            Err(e) => {
                for bar in bars {
                    let _ = bar.set(0.0); // the first error is told
                }
                return Err(e);
            }
        }
    }
    Ok(taken)
}

impl<L: Switch, D: Dimmer> Bar<L, D> {
    fn set(&mut self, drive: f64) -> Result<f64, Error> {
        let taken = self.dimmer.set(drive);
        // a line is turned off even where its dimmer does not answer
        self.line.set(taken.as_ref().is_ok_and(|t| *t > 0.0))?;
        taken
    }
}

/// Pulses `line` until the latest time that it is told, or nobody is left to tell it.
fn pulse(mut line: Output) -> Result<Sender<Instant>, Error> {
    let (alive, told) = mpsc::channel::<Instant>();
    let pulsing = move || {
        let (mut until, mut high) = (Instant::now(), false);
        loop {
            let idle = Instant::now() >= until;
            // an error leaves the line where it is: without edges the bars go dark
            let _ = line.set(!idle && !high);
            high = !idle && !high;
            match if idle { told.recv().map_err(|_| RecvTimeoutError::Disconnected) } else { told.recv_timeout(PULSE) }
            {
                Ok(later) => until = until.max(later),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    let _ = line.set(false);
                    return;
                }
            }
        }
    };
    let thread = std::thread::Builder::new().name("alive".into()).spawn(pulsing);
    thread.map_err(|source| Error::Call { device: DEVICE.into(), call: "thread", source })?;
    Ok(alive)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, Mutex};

    /// What was done, in order; the n-th act may fail.
    #[derive(Clone, Default)]
    struct Log(Arc<Mutex<Vec<String>>>, Arc<Mutex<Option<&'static str>>>);

    impl Log {
        fn act(&self, what: String) -> Result<(), Error> {
            let fails = self.1.lock().expect("no panic").is_some_and(|w| what == w);
            self.0.lock().expect("no panic").push(what);
            if fails { Err(Error::Gone { device: DEVICE.into() }) } else { Ok(()) }
        }
    }

    struct Fake(&'static str, Log);

    impl Switch for Fake {
        fn set(&mut self, on: bool) -> Result<(), Error> {
            self.1.act(format!("{} {}", self.0, if on { "on" } else { "off" }))
        }
    }

    impl Dimmer for Fake {
        fn set(&mut self, duty: f64) -> Result<f64, Error> {
            let taken = (duty * 10.0).round() / 10.0;
            self.1.act(format!("{} {taken}", self.0)).map(|()| taken)
        }
    }

    fn bars(log: &Log) -> [Bar<Fake, Fake>; 2] {
        [("left", "left duty"), ("right", "right duty")]
            .map(|(line, dimmer)| Bar { line: Fake(line, log.clone()), dimmer: Fake(dimmer, log.clone()) })
    }

    #[test]
    fn a_bar_is_dimmed_before_it_is_on_and_off_where_its_duty_is_nothing() {
        let log = Log::default();
        assert_eq!(set(&mut bars(&log), [0.62, 0.04]).expect("works"), [0.6, 0.0]);
        let done = log.0.lock().expect("no panic").clone();
        assert_eq!(done, ["left duty 0.6", "left on", "right duty 0", "right off"]);
    }

    #[test]
    fn both_are_off_after_an_error_of_one() {
        for fails in ["left duty 0.5", "left on", "right duty 0.5", "right on"] {
            let log = Log::default();
            *log.1.lock().expect("no panic") = Some(fails);
            assert!(set(&mut bars(&log), [0.5, 0.5]).is_err(), "{fails}");
            let done = log.0.lock().expect("no panic").clone();
            assert_eq!(done[done.len() - 4..], ["left duty 0", "left off", "right duty 0", "right off"], "{fails}");
        }
    }
}
