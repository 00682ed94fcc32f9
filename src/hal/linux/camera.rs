//! The camera on a V4L2 node: grey samples, several mapped buffers, streaming all the time.
//! In:  settings. Out: images that were exposed after they were asked for. Unplugged, it is [`Error::Gone`] until it is
//! back; then it is opened anew, with the exposure, the gain and the controls that it had.
//! Not here: which image is the one (`arrivals`); buffers (`queue`).

use super::Sys;
use super::arrivals::{Arrival, Arrivals, Fate, Stamp, Wanted};
use super::clock::monotonic;
use super::gpio::LineName;
use super::node::{self, Layout, Way, refused};
use super::queue::{Control, Done, Queue, controls};
use super::trigger::Trigger;
use super::watch::{Stream, Watch};
use crate::hal::{self, Error, Exposure, Sensor};
use crate::image::Image;
use std::collections::BTreeMap;
use std::io;
use std::time::Duration;
use v4l::buffer::{Flags, Type};
use v4l::control::{Control as Set, Value};
use v4l::video::Capture;
use v4l::video::capture::Parameters;
use v4l::{Device, Fraction};

const DEVICE: &str = "camera";
/// One is being filled, one waits to be, the others bridge the time until we look.
const BUFFERS: u32 = 4;
/// Where a poll ends early with nothing to take.
const LOOK: Duration = Duration::from_millis(1);
// linux/v4l2-controls.h
const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
const EXPOSURE_AUTO: (u32, i64) = (0x009a_0901, 1); // manual
const EXPOSURE: u32 = 0x0098_0911;
const AUTOGAIN: (u32, i64) = (0x0098_0912, 0);
const GAIN: u32 = 0x0098_0913;
const ANALOGUE_GAIN: u32 = 0x009e_0903;

/// How a camera is reached and set.
#[derive(Clone, Debug)]
pub struct CameraSettings {
    /// A node's path, or what its driver calls it.
    pub device: String,
    /// What its images look like; the format's bits are 8, 10, 12 or 16.
    pub sensor: Sensor,
    /// As V4L2 names it, with its blanks: `Y10 `.
    pub fourcc: [u8; 4],
    /// Images per second.
    pub rate: f64,
    /// What triggers it; none: it exposes by itself.
    pub trigger: Option<LineName>,
    /// One unit of its exposure control.
    pub exposure_unit: Duration,
    /// What its gain control shows at gain 1; none: its least value.
    pub gain_one: Option<i64>,
    /// Images, after exposure or gain were changed, that are still exposed as before.
    pub lag: usize,
    /// Further controls by name.
    pub controls: BTreeMap<String, i64>,
}

/// A camera on a V4L2 node.
pub struct V4l2Camera {
    sys: Sys,
    settings: CameraSettings,
    trigger: Trigger,
    open: Option<Open>,
    /// As last asked for.
    exposure: Duration,
    gain: f64,
    /// Images to leave out before the next one shows what was set.
    lagging: usize,
    /// Images handed out, where their numbers mean nothing.
    handed: u64,
    arrivals: Arrivals,
}

struct Open {
    node: Device,
    queue: Queue,
    layout: Layout,
    exposure: Option<Control>,
    gain: Option<Control>,
    interval: Duration,
    /// As the device took them.
    taken: (Duration, f64),
}

impl V4l2Camera {
    /// A camera that is opened when it is first used: it may be plugged in later. The trigger's line is taken at once.
    pub fn new(sys: Sys, settings: CameraSettings) -> Result<Self, Error> {
        let trigger = Trigger::open(DEVICE, settings.trigger.as_ref())?;
        Ok(Self {
            sys,
            settings,
            trigger,
            open: None,
            exposure: Duration::from_millis(2),
            gain: 1.0,
            lagging: 0,
            handed: 0,
            arrivals: Arrivals::default(),
        })
    }

    /// Does it with the device open. After an error it is closed: the next call starts clean. So it is where a trigger's image
    /// did not come: it could be taken for the next one's.
    fn work<T>(&mut self, work: impl FnOnce(&mut Self) -> Result<T, Error>) -> Result<T, Error> {
        if self.open.is_none() {
            self.open = Some(self.opened()?);
            self.arrivals.restart();
        }
        let done = work(self);
        let late = self.trigger.is_wired() && matches!(done, Err(Error::NoImage { .. }));
        let close = late || matches!(done, Err(Error::Gone { .. } | Error::Call { .. }));
        if close {
            self.open = None;
        }
        done
    }

    fn opened(&self) -> Result<Open, Error> {
        let s = &self.settings;
        let size = (s.sensor.width, s.sensor.height);
        let (node, layout) = node::open(DEVICE, &self.sys, &s.device, Way::Capture, size, s.fourcc)?;
        let said = |call| move |e| refused(DEVICE, call, e);
        let interval = Duration::from_secs_f64(1.0 / s.rate);
        // a device without an interval, or with another, goes at its own pace: `watch` tells
        let micros = u32::try_from(interval.as_micros()).unwrap_or(u32::MAX);
        let taken = node.set_params(&Parameters::new(Fraction::new(micros, 1_000_000))).map(|p| p.interval);
        let interval = match taken {
            Ok(i) if i.numerator > 0 && i.denominator > 0 => {
                Duration::from_secs_f64(f64::from(i.numerator) / f64::from(i.denominator))
            }
            _ => interval,
        };
        let there = controls(&node.handle());
        let by_id = |id: u32| there.iter().find(|c| c.id == id).cloned();
        for (id, value) in [EXPOSURE_AUTO, AUTOGAIN] {
            if by_id(id).is_some() {
                put(&node, id, value).map_err(said("VIDIOC_S_EXT_CTRLS"))?;
            }
        }
        for (name, value) in &s.controls {
            let Some(control) = there.iter().find(|c| c.name == *name) else {
                let there = there.iter().map(|c| c.name.clone()).collect();
                return Err(Error::Absent { device: DEVICE.into(), what: "control", wanted: name.clone(), there });
            };
            put(&node, control.id, *value).map_err(said("VIDIOC_S_EXT_CTRLS"))?;
        }
        let mut queue = Queue::new(node.handle(), Type::VideoCapture, BUFFERS).map_err(said("VIDIOC_REQBUFS"))?;
        for index in 0..queue.len() {
            if queue.bytes(index).len() < layout.bytes {
                let found = (layout.width, queue.bytes(index).len() / layout.stride);
                let allowed = (layout.width, layout.height);
                return Err(Error::Size { device: DEVICE.into(), what: "buffer", found, allowed });
            }
            queue.queue(index, 0).map_err(said("VIDIOC_QBUF"))?;
        }
        let mut open = Open {
            queue,
            layout,
            exposure: by_id(EXPOSURE_ABSOLUTE).or_else(|| by_id(EXPOSURE)),
            gain: by_id(GAIN).or_else(|| by_id(ANALOGUE_GAIN)),
            interval,
            node,
            taken: (interval, 1.0),
        };
        open.set_exposure(self.exposure, s.exposure_unit)?;
        open.set_gain(self.gain, s.gain_one)?;
        open.queue.start().map_err(said("VIDIOC_STREAMON"))?;
        Ok(open)
    }

    /// An image later than this is missing.
    fn patience(&self) -> Duration {
        self.open.as_ref().map_or(Duration::ZERO, |o| 4 * o.interval + o.taken.0)
    }

    /// Images that nobody took.
    fn drain(&mut self) -> Result<(), Error> {
        for _ in 0..BUFFERS {
            let Some(done) = self.queue()?.dequeue().map_err(|e| refused(DEVICE, "VIDIOC_DQBUF", e))? else {
                break;
            };
            self.judge(&done, Duration::MAX);
            self.give_back(done.index)?;
        }
        // where every image is one of our triggers a gap says that one is lost; else all buffers may have been full
        if !self.trigger.is_wired() {
            self.arrivals.restart();
        }
        Ok(())
    }

    fn queue(&mut self) -> Result<&mut Queue, Error> {
        let gone = || Error::Gone { device: DEVICE.into() };
        self.open.as_mut().map(|o| &mut o.queue).ok_or_else(gone)
    }

    /// The next image by `deadline`; `None`: there was none.
    fn next(&mut self, deadline: Duration) -> Result<Option<Done>, Error> {
        loop {
            let queue = self.queue()?;
            if let Some(done) = queue.dequeue().map_err(|e| refused(DEVICE, "VIDIOC_DQBUF", e))? {
                return Ok(Some(done));
            }
            let left = deadline.saturating_sub(monotonic());
            if left.is_zero() {
                return Ok(None);
            }
            let began = monotonic();
            queue.wait(left).map_err(|e| refused(DEVICE, "poll", e))?;
            if monotonic() - began < LOOK {
                std::thread::sleep(LOOK);
            }
        }
    }

    fn judge(&mut self, done: &Done, asked_at: Duration) -> Fate {
        let Some(open) = &self.open else { return Fate::Impossible };
        let damaged = done.flags.contains(Flags::ERROR) || done.bytes < open.layout.bytes;
        let arrival = Arrival { sequence: done.sequence, stamp: stamp(done), damaged };
        let readout = if self.trigger.is_wired() { Duration::ZERO } else { open.interval };
        let wanted = Wanted { asked_at, now: monotonic(), exposure: open.taken.0, readout };
        self.arrivals.judge(&arrival, &wanted)
    }

    fn give_back(&mut self, index: usize) -> Result<(), Error> {
        self.queue()?.queue(index, 0).map_err(|e| refused(DEVICE, "VIDIOC_QBUF", e))
    }

    fn take(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        let began = monotonic();
        let deadline = began + timeout;
        self.drain()?;
        loop {
            let asked_at = monotonic();
            let queued = self.queue()?.queued();
            self.arrivals.ask(queued);
            self.trigger.pulse()?;
            let begun_at = loop {
                let Some(done) = self.next(deadline)? else {
                    return Err(Error::NoImage { device: DEVICE.into(), waited: timeout });
                };
                let fate = self.judge(&done, asked_at);
                match fate {
                    Fate::Wanted(at) => {
                        let open = self.open.as_mut().expect("it works");
                        copy(open.queue.bytes(done.index), &open.layout, image);
                        self.give_back(done.index)?;
                        break at;
                    }
                    _ => self.give_back(done.index)?,
                }
                // a triggered camera exposes no other one by itself
                if self.trigger.is_wired() && fate == Fate::Damaged(true) {
                    return Err(Error::Damaged { device: DEVICE.into() });
                }
            };
            if self.lagging > 0 {
                self.lagging -= 1;
                continue;
            }
            let open = self.open.as_ref().expect("it works");
            self.handed += 1;
            // where every image is one of our triggers a gap tells; else the stamp has told all
            let sequence = if self.trigger.is_wired() { self.arrivals.number } else { self.handed };
            return Ok(Exposure { sequence, begun_at, time: open.taken.0, gain: open.taken.1 });
        }
    }
}

impl Watch for V4l2Camera {
    fn watch(&mut self, images: usize, timeout: Duration) -> Result<Stream, Error> {
        self.work(|camera| {
            camera.drain()?;
            let before = camera.arrivals.clone();
            let (mut first, mut last, mut came) = (None, Duration::ZERO, 0);
            let deadline = monotonic() + timeout;
            let mut at_begin = false;
            while came < images && monotonic() < deadline {
                camera.trigger.pulse()?;
                let next = monotonic() + camera.patience();
                while let Some(done) = camera.next(next.min(deadline))? {
                    let fate = camera.judge(&done, Duration::ZERO);
                    camera.give_back(done.index)?;
                    at_begin = matches!(stamp(&done), Stamp::Begin(_));
                    if let Fate::Wanted(at) = fate {
                        first.get_or_insert(at);
                        last = at;
                        came += 1;
                    }
                    if camera.trigger.is_wired() || came == images {
                        break;
                    }
                }
            }
            let open = camera.open.as_ref().expect("it works");
            let time = last.saturating_sub(first.unwrap_or(last)).as_secs_f64();
            let now = &camera.arrivals;
            let exposed = (now.number - before.number).saturating_sub(1) as f64;
            Ok(Stream {
                rate: if time > 0.0 { exposed / time } else { 0.0 },
                came,
                lost: now.lost - before.lost,
                doubled: now.doubled - before.doubled,
                damaged: now.damaged - before.damaged,
                stamped_at_begin: at_begin,
                exposure: open.exposure.is_some(),
                gain: open.gain.is_some(),
            })
        })
    }
}

fn stamp(done: &Done) -> Stamp {
    if (done.flags & Flags::TIMESTAMP_MASK) != Flags::TIMESTAMP_MONOTONIC {
        return Stamp::Unknown;
    }
    let begin = (done.flags & Flags::TSTAMP_SRC_MASK) == Flags::TSTAMP_SRC_SOE;
    if begin { Stamp::Begin(done.stamp) } else { Stamp::End(done.stamp) }
}

/// A buffer's samples; of rows that are `stride` bytes apart.
fn copy(bytes: &[u8], layout: &Layout, image: &mut Image<u16>) {
    let rows = image.pixels.chunks_exact_mut(layout.width).zip(bytes.chunks(layout.stride));
    if layout.fourcc == *b"GREY" {
        rows.for_each(|(to, from)| to.iter_mut().zip(from).for_each(|(to, from)| *to = u16::from(*from)));
    } else {
        let sample = |(to, from): (&mut u16, &[u8])| *to = u16::from_le_bytes([from[0], from[1]]);
        rows.for_each(|(to, from)| to.iter_mut().zip(from.chunks_exact(2)).for_each(sample));
    }
}

fn put(node: &Device, id: u32, value: i64) -> io::Result<()> {
    node.set_control(Set { id, value: Value::Integer(value) })
}

fn get(node: &Device, id: u32) -> io::Result<i64> {
    match node.control(id)?.value {
        Value::Integer(value) => Ok(value),
        Value::Boolean(value) => Ok(i64::from(value)),
        _ => Err(io::Error::from(io::ErrorKind::InvalidData)),
    }
}

/// Asks a control for the value nearest to `wanted`; the one that it took.
fn ask(node: &Device, control: &Control, call: &'static str, wanted: f64) -> Result<i64, Error> {
    let failed = |e| refused(DEVICE, call, e);
    put(node, control.id, nearest(control, wanted)).map_err(failed)?;
    get(node, control.id).map_err(failed)
}

/// The value of a control nearest to `wanted`.
fn nearest(control: &Control, wanted: f64) -> i64 {
    let steps = ((wanted - control.least as f64) / control.step as f64).round() as i64;
    (control.least.saturating_add(steps.saturating_mul(control.step))).clamp(control.least, control.most)
}

impl Open {
    /// Without a control an image is exposed for its whole interval, as far as anybody knows.
    fn set_exposure(&mut self, wanted: Duration, unit: Duration) -> Result<Duration, Error> {
        if let Some(control) = &self.exposure {
            let taken = ask(&self.node, control, "exposure", wanted.as_secs_f64() / unit.as_secs_f64())?;
            self.taken.0 = Duration::from_secs_f64(taken.max(0) as f64 * unit.as_secs_f64());
        }
        Ok(self.taken.0)
    }

    fn set_gain(&mut self, wanted: f64, one: Option<i64>) -> Result<f64, Error> {
        if let Some(control) = &self.gain {
            let one = one.unwrap_or(control.least.max(1)) as f64;
            let taken = ask(&self.node, control, "gain", wanted * one)?;
            self.taken.1 = taken as f64 / one;
        }
        Ok(self.taken.1)
    }
}

impl hal::Camera for V4l2Camera {
    fn sensor(&self) -> &Sensor {
        &self.settings.sensor
    }

    fn set_exposure(&mut self, wanted: Duration) -> Result<Duration, Error> {
        self.work(|camera| {
            let open = camera.open.as_mut().expect("it works");
            let before = open.taken.0;
            let taken = open.set_exposure(wanted, camera.settings.exposure_unit)?;
            camera.exposure = wanted;
            if taken != before {
                camera.lagging = camera.settings.lag;
            }
            Ok(taken)
        })
    }

    fn set_gain(&mut self, wanted: f64) -> Result<f64, Error> {
        hal::at_least_1(DEVICE, wanted)?;
        self.work(|camera| {
            let open = camera.open.as_mut().expect("it works");
            let before = open.taken.1;
            let taken = open.set_gain(wanted, camera.settings.gain_one)?;
            camera.gain = wanted;
            if taken != before {
                camera.lagging = camera.settings.lag;
            }
            Ok(taken)
        })
    }

    fn grab(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        self.sensor().fits(DEVICE, image)?;
        self.work(|camera| camera.take(timeout, image))
    }

    fn check(&mut self) -> Result<(), Error> {
        self.work(|camera| {
            let open = camera.open.as_ref().expect("it works");
            open.node.query_caps().map(|_| ()).map_err(|e| refused(DEVICE, "VIDIOC_QUERYCAP", e))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layout(fourcc: &[u8; 4], stride: usize) -> Layout {
        Layout { width: 3, height: 2, fourcc: *fourcc, stride, bytes: 0 }
    }

    #[test]
    fn rows_are_taken_from_where_the_stride_puts_them() {
        let mut image = Image::filled(3, 2, 0);
        copy(&[1, 2, 3, 99, 4, 5, 6], &layout(b"GREY", 4), &mut image);
        assert_eq!(image.pixels, [1, 2, 3, 4, 5, 6]);
        copy(&[1, 0, 255, 3, 3, 0, 9, 9, 4, 0, 5, 0, 6, 1], &layout(b"Y10 ", 8), &mut image);
        assert_eq!(image.pixels, [1, 1023, 3, 4, 5, 262]);
    }

    #[test]
    fn a_control_takes_the_nearest_of_its_values() {
        let control = Control { id: 1, name: "x".into(), least: 3, most: 30, step: 3 };
        let taken = [0.0, 7.4, 7.6, 29.0, 1e9].map(|w| nearest(&control, w));
        assert_eq!(taken, [3, 6, 9, 30, 30]);
    }
}
