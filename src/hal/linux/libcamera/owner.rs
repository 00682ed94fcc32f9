//! The thread that owns everything of libcamera: manager, camera, requests and their buffers, which borrow each other. In:
//! settings and questions, by a channel. Out: answers. All requests are in flight all the time, whether anybody asks or not:
//! an image that nobody takes goes back at once. The thread ends when nobody is left to ask or the camera is gone; libcamera
//! allows one manager at a time, so the next thread begins when this one has ended.
//! Not here: which image is the one (`follow`), what samples look like (`samples`).

use super::super::Sys;
use super::super::arrivals::Arrival;
use super::super::clock::{boot, monotonic};
use super::follow::{Came, Follow, Verdict};
use super::samples::{Layout, choose, names};
use super::settings::{Listed, exposure_us, gain, intervals_us, pick};
use super::when::complete;
use super::{DEVICE, LibcameraSettings, parts};
use crate::hal::{Error, Exposure};
use crate::image::Image;
use ::libcamera::camera::{ActiveCamera, Camera, CameraConfigurationStatus};
use ::libcamera::camera_manager::CameraManager;
use ::libcamera::control::ControlList;
use ::libcamera::control_value::ControlValue;
use ::libcamera::controls::{AeEnable, AnalogueGain, ControlId, ExposureTime, FrameDurationLimits, SensorTimestamp};
use ::libcamera::framebuffer::{AsFrameBuffer, FrameMetadataStatus};
use ::libcamera::framebuffer_allocator::{FrameBuffer, FrameBufferAllocator};
use ::libcamera::framebuffer_map::MemoryMappedFrameBuffer;
use ::libcamera::geometry::Size;
use ::libcamera::logging::{LoggingLevel, set_category_level};
use ::libcamera::pixel_format::PixelFormat;
use ::libcamera::properties::{Model, SystemDevices};
use ::libcamera::request::{Request, RequestStatus, ReuseFlag};
use ::libcamera::stream::{Stream, StreamRole};
use std::io;
use std::ops::RangeInclusive;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender};
use std::time::Duration;

type Buffer = MemoryMappedFrameBuffer<FrameBuffer>;

/// One is being filled, one waits to be, the others bridge the time until we look.
const BUFFERS: u32 = 4;
/// A camera that exposes by itself and sends nothing for so long is gone, whatever the system says of it.
const SILENT: Duration = Duration::from_secs(2);
/// Until udev's word of a camera that is gone has reached libcamera.
const WORD: Duration = Duration::from_secs(1);
/// Where a sensor's own samples are looked for first, and then what an image processor makes of them.
const ROLES: [StreamRole; 4] =
    [StreamRole::Raw, StreamRole::VideoRecording, StreamRole::ViewFinder, StreamRole::StillCapture];

/// What the thread is told.
pub(super) enum Event {
    /// A request that is complete.
    Done(Request),
    /// The camera is unplugged.
    Unplugged,
    /// Expose so from now on; what was taken comes back.
    Set { exposure: Duration, gain: f64, taken: Sender<(Duration, f64)> },
    /// An image.
    Ask(Ask),
    /// End.
    End,
}

/// A question for an image; the answer comes by `deadline`.
pub(super) struct Ask {
    /// To be filled; none: it is enough to know of it.
    pub(super) image: Option<Image<u16>>,
    /// No exposure that began before.
    pub(super) asked_at: Duration,
    pub(super) deadline: Duration,
    pub(super) answer: SyncSender<Answer>,
}

/// What came.
pub(super) struct Answer {
    /// As it was handed over, filled where `outcome` says so.
    pub(super) image: Option<Image<u16>>,
    pub(super) outcome: Outcome,
    pub(super) counted: Counted,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Outcome {
    Taken(Exposure),
    /// A triggered camera exposed one that will not do, and exposes no other by itself.
    Again {
        damaged: bool,
    },
    Nothing,
}

/// The stream so far.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Counted {
    pub(super) number: u64,
    pub(super) lost: u64,
    pub(super) doubled: u64,
    pub(super) damaged: u64,
}

/// What the camera can do, and which devices it is made of.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Able {
    pub(super) exposure: bool,
    pub(super) gain: bool,
    pub(super) devices: Vec<i64>,
}

/// Runs until [`Event::End`], or until the camera is gone. `opened` hears whether it works. `events` are what `tell` sends.
pub(super) fn own(
    settings: &LibcameraSettings,
    first: (Duration, f64),
    tell: &Sender<Event>,
    events: &Receiver<Event>,
    opened: &SyncSender<Result<Able, Error>>,
) {
    set_category_level("Camera", LoggingLevel::Warn); // it greets at every start
    let manager = match CameraManager::new() {
        Ok(manager) => manager,
        Err(e) => return drop(opened.send(Err(call("starting libcamera", e)))),
    };
    let cameras = manager.cameras();
    let mut there: Vec<Camera> = cameras.iter().collect();
    let listed: Vec<Listed> = there.iter().map(listed).collect();
    let camera = match pick(DEVICE, &settings.device, &listed) {
        Ok(at) => there.swap_remove(at),
        Err(e) => return drop(opened.send(Err(e))),
    };
    drop(there);
    let mut active: ActiveCamera = match camera.acquire() {
        Ok(active) => active,
        Err(e) if e.kind() == io::ErrorKind::ResourceBusy => {
            let held = Error::Held { device: DEVICE.into(), by: "another program".into() };
            return drop(opened.send(Err(held)));
        }
        Err(e) => return drop(opened.send(Err(call("acquiring the camera", e)))),
    };
    match Running::start(settings, first, &mut active, tell) {
        Ok(mut running) => {
            let able = running.able();
            let devices = able.devices.clone();
            let known = opened.send(Ok(able)).is_ok() && running.follow(events);
            drop(running); // nobody waits for an answer that does not come
            // libcamera 0.4 ends the whole program where it is to stop a camera that is gone without its knowing: its
            // pipelines for system-on-chip cameras never know, that for USB does
            if parts::missing(&Sys::default(), &devices) && !known && !told(events) {
                return std::mem::forget((active, camera));
            }
            let _ = active.stop(); // one that libcamera knows to be gone refuses, which is as good
        }
        Err(e) => drop(opened.send(Err(e))),
    }
    drop(active);
    // requests that came back meanwhile; they must not outlive the camera
    events.try_iter().for_each(drop);
}

/// Whether word comes, within a moment, that libcamera knows of a camera that is gone.
fn told(events: &Receiver<Event>) -> bool {
    let until = monotonic() + WORD;
    while let Ok(event) = events.recv_timeout(until.saturating_sub(monotonic())) {
        if matches!(event, Event::Unplugged) {
            return true;
        }
    }
    false
}

fn listed(camera: &Camera) -> Listed {
    Listed { id: camera.id().into(), model: camera.properties().get::<Model>().ok().map(|m| m.0) }
}

fn call(call: &'static str, source: io::Error) -> Error {
    super::super::node::refused(DEVICE, call, source)
}

/// A stream that runs.
struct Running<'a, 'd> {
    settings: &'a LibcameraSettings,
    active: &'a mut ActiveCamera<'d>,
    stream: Stream,
    layout: Layout,
    follow: Follow,
    exposure_range: Option<RangeInclusive<i32>>,
    gain_range: Option<RangeInclusive<f32>>,
    /// What the next requests carry.
    carried: (i32, f32),
    /// The settings that each request carries, by its cookie.
    carries: Vec<u64>,
    asked: Option<Ask>,
    /// Images handed out, where their numbers mean nothing.
    handed: u64,
    last_came: Duration,
}

impl<'a, 'd> Running<'a, 'd> {
    fn start(
        settings: &'a LibcameraSettings,
        (exposure, wanted_gain): (Duration, f64),
        active: &'a mut ActiveCamera<'d>,
        tell: &Sender<Event>,
    ) -> Result<Self, Error> {
        let (stream, layout) = configure(settings, active)?;
        let buffers = FrameBufferAllocator::new(active).alloc(&stream).map_err(|e| call("allocating buffers", e))?;
        let came = tell.clone();
        active.on_request_completed(move |request| drop(came.send(Event::Done(request))));
        let gone = tell.clone();
        active.on_disconnected(move || drop(gone.send(Event::Unplugged)));
        let mut running = Self {
            settings,
            stream,
            layout,
            follow: Follow::default(),
            exposure_range: range(active, ControlId::ExposureTime),
            gain_range: range(active, ControlId::AnalogueGain),
            carried: (1, 1.0),
            carries: vec![0; buffers.len()],
            asked: None,
            handed: 0,
            last_came: monotonic(),
            active,
        };
        running.set(exposure, wanted_gain);
        running.active.start(None).map_err(|e| call("starting the camera", e))?;
        for (cookie, buffer) in (0..).zip(buffers) {
            let buffer = Buffer::new(buffer).map_err(|e| call("mapping a buffer", io::Error::other(e)))?;
            let found = buffer.data().first().map_or(0, |plane| plane.len());
            if found < running.layout.bytes() {
                let rows = found * running.layout.height / running.layout.bytes();
                return Err(Error::HalfImage { device: DEVICE.into(), rows, of: running.layout.height });
            }
            let refused = || call("creating a request", io::ErrorKind::OutOfMemory.into());
            let mut request = running.active.create_request(Some(cookie)).ok_or_else(refused)?;
            request.add_buffer(&running.stream, buffer).map_err(|e| call("adding a buffer", e))?;
            running.queue(request)?;
        }
        Ok(running)
    }

    fn able(&self) -> Able {
        let devices = self.active.properties().get::<SystemDevices>().map(|d| d.0).unwrap_or_default();
        Able { exposure: self.exposure_range.is_some(), gain: self.gain_range.is_some(), devices }
    }

    fn interval(&self) -> Duration {
        Duration::from_secs_f64(1.0 / self.settings.rate)
    }

    /// What the next requests carry, and what that will be. Without a control an image is exposed for its whole interval, as
    /// far as anybody knows.
    fn set(&mut self, exposure: Duration, wanted_gain: f64) -> (Duration, f64) {
        self.carried = (exposure_us(exposure, self.exposure_range.clone()), gain(wanted_gain, self.gain_range.clone()));
        let us = u64::from(self.carried.0.unsigned_abs());
        let exposure = if self.exposure_range.is_some() { Duration::from_micros(us) } else { self.interval() };
        let gain = if self.gain_range.is_some() { f64::from(self.carried.1) } else { 1.0 };
        self.follow.set(exposure, gain, self.settings.lag);
        (exposure, gain)
    }

    /// Sends a request on its way, with what is to be set.
    fn queue(&mut self, mut request: Request) -> Result<(), Error> {
        let failed = |e: ::libcamera::control::ControlError| call("setting a control", io::Error::other(e));
        let offers = |id: ControlId| self.active.controls().find(id.id()).is_ok();
        let controls = request.controls_mut();
        if offers(ControlId::AeEnable) {
            controls.set(AeEnable(false)).map_err(failed)?;
        }
        if offers(ControlId::FrameDurationLimits) {
            controls.set(FrameDurationLimits(intervals_us(self.settings.rate, self.carried.0))).map_err(failed)?;
        }
        if self.exposure_range.is_some() {
            controls.set(ExposureTime(self.carried.0)).map_err(failed)?;
        }
        if self.gain_range.is_some() {
            controls.set(AnalogueGain(self.carried.1)).map_err(failed)?;
        }
        for (name, value) in &self.settings.controls {
            further(self.active, controls, name, *value)?;
        }
        self.carries[request.cookie() as usize] = self.follow.settings();
        self.active.queue_request(request).map_err(|(_, e)| call("queueing a request", e))
    }

    /// Until it is told to end, or the camera is gone; whether libcamera knows that it is.
    fn follow(&mut self, events: &Receiver<Event>) -> bool {
        loop {
            let now = monotonic();
            let silent = self.last_came + SILENT + 4 * self.interval();
            let waits = if self.settings.triggered() { now + SILENT } else { silent };
            let deadline = self.asked.as_ref().map_or(waits, |a| a.deadline.min(waits));
            match events.recv_timeout(deadline.saturating_sub(now)) {
                Ok(Event::Done(request)) => {
                    if !self.came(request) {
                        return false;
                    }
                }
                Ok(Event::Set { exposure, gain, taken }) => {
                    let _ = taken.send(self.set(exposure, gain)); // whoever asked waits, or does not care any more
                }
                Ok(Event::Ask(ask)) => {
                    self.follow.arrivals.ask(self.carries.len());
                    self.asked = Some(ask);
                }
                Err(RecvTimeoutError::Timeout) => {}
                Ok(Event::Unplugged) => return true,
                Ok(Event::End) | Err(RecvTimeoutError::Disconnected) => return false,
            }
            let now = monotonic();
            if self.asked.as_ref().is_some_and(|a| now >= a.deadline) {
                self.answer(Outcome::Nothing);
            }
            if !self.settings.triggered() && now >= self.last_came + SILENT + 4 * self.interval() {
                return false;
            }
        }
    }

    /// Looks at an image and sends its request on its way again; whether the camera is still there.
    fn came(&mut self, mut request: Request) -> bool {
        let cookie = request.cookie() as usize;
        let Some(buffer) = request.buffer::<Buffer>(&self.stream) else { return false };
        let Some(told) = buffer.metadata() else { return false };
        let cancelled = told.status() == FrameMetadataStatus::Cancelled;
        if cancelled || request.status() == RequestStatus::Cancelled {
            return false;
        }
        let used = told.planes().get(0).map_or(0, |p| p.bytes_used as usize);
        let now = monotonic();
        self.last_came = now;
        let metadata = request.metadata();
        let exposed = metadata.get::<SensorTimestamp>().map_or(0, |t| u64::try_from(t.0).unwrap_or(0));
        let stamp = if exposed > 0 { exposed } else { told.timestamp() };
        let damaged = told.status() == FrameMetadataStatus::Error || used < self.layout.bytes();
        let boot = boot(); // before the other: what passes between must not look like sleep
        let came = Came {
            arrival: Arrival { sequence: told.sequence(), stamp: complete(stamp, monotonic(), boot), damaged },
            settings: self.carries[cookie],
            exposure: metadata
                .get::<ExposureTime>()
                .ok()
                .map(|t| Duration::from_micros(t.0.max(0).unsigned_abs().into())),
            gain: metadata.get::<AnalogueGain>().ok().map(|g| f64::from(g.0)),
        };
        let asked_at = self.asked.as_ref().map_or(Duration::MAX, |a| a.asked_at);
        let readout = if self.settings.triggered() { Duration::ZERO } else { self.interval() };
        match self.follow.judge(&came, asked_at, now, readout) {
            Verdict::Take(begun_at, time, gain) => {
                if let Some(image) = self.asked.as_mut().and_then(|a| a.image.as_mut()) {
                    self.layout.copy(buffer.data()[0], image);
                }
                self.handed += 1;
                // where every image is one of our triggers a gap tells; else the stamp has told all
                let triggered = self.settings.triggered();
                let sequence = if triggered { self.follow.arrivals.number } else { self.handed };
                self.answer(Outcome::Taken(Exposure { sequence, begun_at, time, gain }));
            }
            Verdict::Again { damaged } if self.settings.triggered() => self.answer(Outcome::Again { damaged }),
            _ => {}
        }
        request.reuse(ReuseFlag::REUSE_BUFFERS);
        self.queue(request).is_ok()
    }

    fn answer(&mut self, outcome: Outcome) {
        let Some(Ask { image, answer, .. }) = self.asked.take() else { return };
        let a = &self.follow.arrivals;
        let counted = Counted { number: a.number, lost: a.lost, doubled: a.doubled, damaged: a.damaged };
        let _ = answer.send(Answer { image, outcome, counted }); // whoever asked waits, or has given up
    }
}

/// Sets format and size; an error says what the camera would do instead.
fn configure(settings: &LibcameraSettings, active: &mut ActiveCamera) -> Result<(Stream, Layout), Error> {
    let device = || format!("{DEVICE} ({})", active.id());
    let sensor = &settings.sensor;
    let mut offered = Vec::new();
    let mut chosen = None;
    for role in ROLES {
        let Some(configuration) = active.generate_configuration(&[role]) else { continue };
        let Some(first) = configuration.get(0) else { continue };
        let formats = first.formats();
        let formats: Vec<PixelFormat> = formats.pixel_formats().into_iter().collect();
        let raw: Vec<_> = formats.iter().map(|f| (f.fourcc(), f.modifier())).collect();
        drop(first);
        if let Some(format) = choose(sensor.bits, &raw) {
            chosen = Some((configuration, format));
            break;
        }
        for format in formats.iter().map(|f| format!("{f:?}")) {
            if !offered.contains(&format) {
                offered.push(format);
            }
        }
    }
    let Some((mut configuration, ((fourcc, modifier), packing))) = chosen else {
        return Err(Error::NotOffered {
            device: device(),
            what: "the format",
            wanted: names(sensor.bits).into(),
            offered,
        });
    };
    let side = |px: usize| u32::try_from(px).expect("checked to be an image's");
    let format = PixelFormat::new(fourcc, modifier);
    if let Some(mut first) = configuration.get_mut(0) {
        first.set_pixel_format(format);
        first.set_size(Size { width: side(sensor.width), height: side(sensor.height) });
        first.set_buffer_count(BUFFERS);
    }
    let status = configuration.validate();
    let (taken, size) =
        configuration.get(0).map_or((format, Size { width: 0, height: 0 }), |c| (c.get_pixel_format(), c.get_size()));
    if matches!(status, CameraConfigurationStatus::Invalid) || taken != format {
        let (wanted, offered) = (format!("{format:?}"), vec![format!("{taken:?}")]);
        return Err(Error::NotOffered { device: device(), what: "the format", wanted, offered });
    }
    let (found, allowed) = ((sensor.width, sensor.height), (size.width as usize, size.height as usize));
    if found != allowed {
        return Err(Error::Size { device: device(), what: "image", found, allowed });
    }
    active.configure(&mut configuration).map_err(|e| call("configuring the camera", e))?;
    let set = configuration.get(0).and_then(|c| c.stream().map(|stream| (stream, c.get_stride() as usize)));
    let (stream, stride) = set.ok_or_else(|| call("configuring the camera", io::ErrorKind::NotFound.into()))?;
    Ok((stream, Layout::new(found, packing, stride)))
}

/// The range of a control, if the camera has it.
fn range<T: TryFrom<ControlValue>>(camera: &Camera, id: ControlId) -> Option<RangeInclusive<T>> {
    let info = camera.controls().find(id.id()).ok()?;
    Some(T::try_from(info.min()).ok()?..=T::try_from(info.max()).ok()?)
}

/// Sets a control by its name.
fn further(camera: &Camera, controls: &mut ControlList, name: &str, value: i64) -> Result<(), Error> {
    let named = |id: u32| ControlId::try_from(id).map(|id| id.name()).unwrap_or_default();
    let Some((id, info)) = camera.controls().into_iter().find(|(id, _)| named(*id) == name) else {
        let there = camera.controls().into_iter().map(|(id, _)| named(id)).filter(|n| !n.is_empty()).collect();
        return Err(Error::Absent { device: DEVICE.into(), what: "control", wanted: name.into(), there });
    };
    let small = i32::try_from(value).unwrap_or(if value < 0 { i32::MIN } else { i32::MAX });
    let value = match info.max() {
        ControlValue::Bool(_) => ControlValue::from(value != 0),
        ControlValue::Int64(_) => ControlValue::from(value),
        ControlValue::Float(_) => ControlValue::from(value as f32),
        _ => ControlValue::from(small),
    };
    controls.set_raw(id, value).map_err(|e| call("setting a control", io::Error::other(e)))
}
