//! The camera as the station sees it: asks the thread that holds libcamera, and begins another where that one has ended.

use super::super::Sys;
use super::super::clock::monotonic;
use super::super::gpio::LineName;
use super::super::trigger::Trigger;
use super::super::watch::{Stream, Watch};
use super::owner::{self, Able, Answer, Ask, Counted, Event, Outcome};
use super::parts;
use crate::hal::{self, Error, Exposure, Sensor};
use crate::image::Image;
use std::collections::BTreeMap;
use std::io;
use std::sync::mpsc::{self, Receiver, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

pub(super) const DEVICE: &str = "camera";
/// Until a camera is opened; libcamera loads its parts then.
const OPENS: Duration = Duration::from_secs(10);
/// Until a thread that was told to has ended: it stops the camera, perhaps after a moment's wait for word of it.
const ENDS: Duration = Duration::from_secs(3);
/// Until an answer comes that takes no image: the thread may be copying one.
const ANSWERS: Duration = Duration::from_secs(1);

/// How a camera is reached and set.
#[derive(Clone, Debug)]
pub struct LibcameraSettings {
    /// libcamera's id of it, or its model.
    pub device: String,
    /// What its images look like; its bits are 8, 10, 12 or 16.
    pub sensor: Sensor,
    /// Images per second.
    pub rate: f64,
    /// What triggers it; none: it exposes by itself.
    pub trigger: Option<LineName>,
    /// Images, after exposure or gain reached it, that are still exposed as before.
    pub lag: usize,
    /// Further controls by libcamera's names.
    pub controls: BTreeMap<String, i64>,
}

impl LibcameraSettings {
    pub(super) fn triggered(&self) -> bool {
        self.trigger.is_some()
    }
}

/// A camera behind libcamera.
pub struct LibcameraCamera {
    settings: LibcameraSettings,
    trigger: Trigger,
    holder: Option<Holder>,
    /// One that was told to end, and had not yet: there may be no other meanwhile.
    ending: Option<JoinHandle<()>>,
    /// Whether it was ever there: what is absent later is gone.
    seen: bool,
    /// As last asked for.
    exposure: Duration,
    gain: f64,
    /// What images are written into, and then exchanged for the caller's.
    spare: Option<Image<u16>>,
}

/// The thread that holds libcamera.
struct Holder {
    thread: JoinHandle<()>,
    tell: Sender<Event>,
    able: Able,
}

fn gone() -> Error {
    Error::Gone { device: DEVICE.into() }
}

impl LibcameraCamera {
    /// A camera that is opened when it is first used: it may be plugged in later. The trigger's line is taken at once.
    pub fn new(settings: LibcameraSettings) -> Result<Self, Error> {
        let trigger = Trigger::open(DEVICE, settings.trigger.as_ref())?;
        let spare = Some(Image::filled(settings.sensor.width, settings.sensor.height, 0));
        let (exposure, gain) = (Duration::from_millis(2), 1.0);
        Ok(Self { settings, trigger, holder: None, ending: None, seen: false, exposure, gain, spare })
    }

    /// Does it with the camera open. After an error that ends the stream it is closed: the next call starts clean. So it is
    /// where a trigger's image did not come: it could be taken for the next one's.
    fn work<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T, Error>) -> Result<T, Error> {
        if self.holder.as_ref().is_some_and(|h| h.thread.is_finished()) {
            self.close();
            return Err(gone());
        }
        if self.holder.is_none() {
            self.holder = Some(self.opened()?);
            self.seen = true;
        }
        let done = work(self);
        let late = self.trigger.is_wired() && matches!(done, Err(Error::NoImage { .. }));
        if late || matches!(done, Err(Error::Gone { .. } | Error::Call { .. })) {
            self.close();
        }
        done
    }

    fn opened(&mut self) -> Result<Holder, Error> {
        if !self.ended() {
            return Err(gone()); // libcamera itself hangs
        }
        let (tell, events) = mpsc::channel();
        let (opened, hear) = mpsc::sync_channel(1);
        let (settings, first, told) = (self.settings.clone(), (self.exposure, self.gain), tell.clone());
        let owns = move || owner::own(&settings, first, &told, &events, &opened);
        let refused = |source| Error::Call { device: DEVICE.into(), call: "starting a thread", source };
        let thread = thread::Builder::new().name("libcamera".into()).spawn(owns).map_err(refused)?;
        match hear.recv_timeout(OPENS) {
            Ok(Ok(able)) => Ok(Holder { thread, tell, able }),
            Ok(Err(e)) => {
                self.ending = Some(thread);
                Err(if self.seen && matches!(e, Error::Absent { what: "libcamera camera", .. }) { gone() } else { e })
            }
            Err(_) => {
                self.ending = Some(thread);
                let source = io::ErrorKind::TimedOut.into();
                Err(Error::Call { device: DEVICE.into(), call: "opening the camera", source })
            }
        }
    }

    /// Ends the thread.
    fn close(&mut self) {
        let Some(Holder { thread, tell, .. }) = self.holder.take() else { return };
        let _ = tell.send(Event::End); // it may have ended already
        self.ending = Some(thread);
        self.ended();
    }

    /// Waits until the thread has ended, as far as it is worth while; whether it has.
    fn ended(&mut self) -> bool {
        let began = Instant::now();
        while self.ending.as_ref().is_some_and(|thread| !thread.is_finished()) {
            if began.elapsed() > ENDS {
                return false;
            }
            thread::sleep(Duration::from_millis(1));
        }
        self.ending = None;
        true
    }

    fn tell(&self, event: Event) -> Result<(), Error> {
        self.holder.as_ref().and_then(|h| h.tell.send(event).ok()).ok_or_else(gone)
    }

    /// An image by `deadline` that was exposed after `asked_at`, with a trigger if it has one.
    fn ask(&mut self, image: Option<Image<u16>>, asked_at: Duration, deadline: Duration) -> Result<Answer, Error> {
        let (answer, hear): (_, Receiver<Answer>) = mpsc::sync_channel(1);
        self.tell(Event::Ask(Ask { image, asked_at, deadline, answer }))?;
        self.trigger.pulse()?;
        // one that ends instead of answering lets go of its end
        hear.recv_timeout(deadline.saturating_sub(monotonic()) + ANSWERS).map_err(|_| gone())
    }

    fn set(&mut self, exposure: Duration, gain: f64) -> Result<(Duration, f64), Error> {
        let (taken, hear) = mpsc::channel();
        self.tell(Event::Set { exposure, gain, taken })?;
        let found = hear.recv_timeout(ANSWERS).map_err(|_| gone())?;
        (self.exposure, self.gain) = (exposure, gain);
        Ok(found)
    }

    fn take(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        let deadline = monotonic() + timeout;
        loop {
            let sensor = &self.settings.sensor;
            let spare = self.spare.take().unwrap_or_else(|| Image::filled(sensor.width, sensor.height, 0));
            let answer = self.ask(Some(spare), monotonic(), deadline)?;
            self.spare = answer.image;
            match answer.outcome {
                Outcome::Taken(exposure) => {
                    if let Some(spare) = &mut self.spare {
                        std::mem::swap(&mut spare.pixels, &mut image.pixels);
                    }
                    return Ok(exposure);
                }
                Outcome::Again { damaged: true } => return Err(Error::Damaged { device: DEVICE.into() }),
                Outcome::Again { damaged: false } => {} // exposure or gain have not reached it yet
                Outcome::Nothing => return Err(Error::NoImage { device: DEVICE.into(), waited: timeout }),
            }
        }
    }
}

impl Watch for LibcameraCamera {
    fn watch(&mut self, images: usize, timeout: Duration) -> Result<Stream, Error> {
        self.work(|camera| {
            let interval = Duration::from_secs_f64(1.0 / camera.settings.rate);
            let deadline = monotonic() + timeout;
            let (mut first, mut last, mut came) = (None, (Duration::ZERO, Counted::default()), 0);
            let mut patience = ANSWERS; // the first one waits for the stream
            while came < images && monotonic() < deadline {
                let by = deadline.min(monotonic() + patience);
                let answer = camera.ask(None, Duration::ZERO, by)?;
                patience = 4 * interval + camera.exposure;
                last.1 = answer.counted;
                if let Outcome::Taken(exposure) = answer.outcome {
                    first.get_or_insert((exposure.begun_at, answer.counted));
                    last.0 = exposure.begun_at;
                    came += 1;
                }
            }
            let (began, before) = first.unwrap_or(last);
            let time = last.0.saturating_sub(began).as_secs_f64();
            let exposed = last.1.number.saturating_sub(before.number) as f64;
            let able = camera.holder.as_ref().map(|h| &h.able);
            Ok(Stream {
                rate: if time > 0.0 { exposed / time } else { 0.0 },
                came,
                lost: last.1.lost - before.lost,
                doubled: last.1.doubled - before.doubled,
                damaged: last.1.damaged - before.damaged,
                stamped_at_begin: false,
                exposure: able.is_some_and(|a| a.exposure),
                gain: able.is_some_and(|a| a.gain),
            })
        })
    }
}

impl hal::Camera for LibcameraCamera {
    fn sensor(&self) -> &Sensor {
        &self.settings.sensor
    }

    /// What the camera's range and libcamera's microseconds make of it. Sensors round to lines: each image comes with what
    /// its own exposure was, where the camera tells.
    fn set_exposure(&mut self, wanted: Duration) -> Result<Duration, Error> {
        self.work(|camera| camera.set(wanted, camera.gain).map(|taken| taken.0))
    }

    fn set_gain(&mut self, wanted: f64) -> Result<f64, Error> {
        hal::at_least_1(DEVICE, wanted)?;
        self.work(|camera| camera.set(camera.exposure, wanted).map(|taken| taken.1))
    }

    fn grab(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        self.sensor().fits(DEVICE, image)?;
        self.work(|camera| camera.take(timeout, image))
    }

    fn check(&mut self) -> Result<(), Error> {
        // the thread ends when the camera is gone, but not at once
        self.work(|camera| {
            let devices = camera.holder.as_ref().map_or(&[][..], |h| &h.able.devices);
            if parts::missing(&Sys::default(), devices) { Err(gone()) } else { Ok(()) }
        })
    }
}

impl Drop for LibcameraCamera {
    fn drop(&mut self) {
        self.close();
    }
}
