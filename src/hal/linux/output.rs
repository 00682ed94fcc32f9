//! A projector on a V4L2 output node: what is queued is shown until something else is.
//! In:  pictures. Out: light. A picture is shown when the node has given back every buffer of the one before: that is all
//! that drivers promise. Some give a buffer back only when one or two more are queued, so copies are queued until it comes.
//! Unplugged, it is [`Error::Gone`] until it is back; then it is opened anew with the pictures that it had.

use super::Sys;
use super::clock::monotonic;
use super::node::{self, Layout, Way, refused};
use super::queue::Queue;
use crate::hal::{self, Error};
use crate::image::Image;
use std::io;
use std::time::Duration;
use v4l::Device;
use v4l::buffer::Type;

const DEVICE: &str = "projector";
/// One is shown, one may be about to be, one more pushes it on, one is being filled.
const BUFFERS: u32 = 4;
/// Another copy is queued where nothing came back for so long: more than two refreshes at 60 Hz.
const PUSH: Duration = Duration::from_millis(40);
/// A picture that is not shown by then never will be.
const TIMEOUT: Duration = Duration::from_secs(1);
const LOOK: Duration = Duration::from_micros(500);

/// How a projector on an output node is reached.
#[derive(Clone, Debug)]
pub struct OutputSettings {
    /// A node's path, or what its driver calls it.
    pub device: String,
    /// Columns and rows.
    pub size: (usize, usize),
    /// From when the node has taken a picture until its light is steady.
    pub settle: Duration,
}

/// A projector on an output node.
pub struct OutputProjector {
    sys: Sys,
    settings: OutputSettings,
    pictures: Vec<Image<u8>>,
    open: Option<Open>,
}

struct Open {
    node: Device,
    screen: Screen<Queue>,
}

impl OutputProjector {
    /// A projector that is opened when it is first used: it may be plugged in later.
    pub fn new(sys: Sys, settings: OutputSettings) -> Self {
        Self { sys, settings, pictures: Vec::new(), open: None }
    }

    /// Does it with the device open. After an error it is closed: the next call starts clean.
    fn work<T>(&mut self, work: impl FnOnce(&mut Open, &[Image<u8>]) -> Result<T, Error>) -> Result<T, Error> {
        let mut open = match self.open.take() {
            Some(open) => open,
            None => Open::new(&self.sys, &self.settings)?,
        };
        let done = work(&mut open, &self.pictures);
        if done.is_ok() {
            self.open = Some(open);
        }
        done
    }
}

impl Open {
    /// Opens it and shows nothing.
    fn new(sys: &Sys, settings: &OutputSettings) -> Result<Self, Error> {
        let said = |call| move |e| refused(DEVICE, call, e);
        let (node, layout) = node::open(DEVICE, sys, &settings.device, Way::Output, settings.size, *b"GREY")?;
        let mut queue = Queue::new(node.handle(), Type::VideoOutput, BUFFERS).map_err(said("VIDIOC_REQBUFS"))?;
        for index in 0..queue.len() {
            if queue.bytes(index).len() < layout.bytes {
                let found = (layout.width, queue.bytes(index).len() / layout.stride);
                return Err(Error::Size { device: DEVICE.into(), what: "buffer", found, allowed: settings.size });
            }
        }
        let mut screen =
            Screen { shows: vec![0; queue.len()], queue, layout, showing: 0, push: PUSH, timeout: TIMEOUT };
        screen.put(None)?;
        screen.queue.start().map_err(said("VIDIOC_STREAMON"))?;
        Ok(Self { node, screen })
    }
}

/// Buffers that a driver shows in the order queued, and gives back when it likes.
trait Buffers {
    fn len(&self) -> usize;
    /// Whether the driver has it.
    fn is_queued(&self, index: usize) -> bool;
    /// A buffer's bytes, which the driver does not have.
    fn bytes(&mut self, index: usize) -> &mut [u8];
    fn queue(&mut self, index: usize, bytes: usize) -> io::Result<()>;
    /// Takes back one that the driver has finished with; whether there was one.
    fn take_back(&mut self) -> io::Result<bool>;
}

impl Buffers for Queue {
    fn len(&self) -> usize {
        self.len()
    }
    fn is_queued(&self, index: usize) -> bool {
        self.is_queued(index)
    }
    fn bytes(&mut self, index: usize) -> &mut [u8] {
        self.bytes(index)
    }
    fn queue(&mut self, index: usize, bytes: usize) -> io::Result<()> {
        self.queue(index, bytes)
    }
    fn take_back(&mut self) -> io::Result<bool> {
        self.dequeue().map(|done| done.is_some())
    }
}

/// What is shown.
struct Screen<B> {
    queue: B,
    layout: Layout,
    /// Per buffer, the showing that it was queued for.
    shows: Vec<u64>,
    /// The newest.
    showing: u64,
    push: Duration,
    timeout: Duration,
}

impl<B: Buffers> Screen<B> {
    /// Queues a picture once, if a buffer is free.
    fn put(&mut self, picture: Option<&Image<u8>>) -> Result<(), Error> {
        let Some(index) = (0..self.queue.len()).find(|k| !self.queue.is_queued(*k)) else { return Ok(()) };
        let Layout { stride, width, height, .. } = self.layout;
        let bytes = self.queue.bytes(index);
        let used = (stride * height).min(bytes.len());
        let rows = bytes.chunks_mut(stride).take(height);
        for (y, row) in rows.enumerate() {
            match picture {
                Some(picture) => row[..width].copy_from_slice(picture.row(y)),
                None => row[..width].fill(0),
            }
        }
        self.queue.queue(index, used).map_err(|e| refused(DEVICE, "VIDIOC_QBUF", e))?;
        self.shows[index] = self.showing;
        Ok(())
    }

    /// Shows a picture, or nothing; comes back when nothing that was queued before it is left.
    fn show(&mut self, picture: Option<&Image<u8>>) -> Result<(), Error> {
        self.take_back()?;
        self.showing += 1;
        self.put(picture)?;
        let began = monotonic();
        let mut pushed = began;
        while !self.is_shown() {
            let now = monotonic();
            if now - began >= self.timeout {
                let source = io::Error::from(io::ErrorKind::TimedOut);
                return Err(Error::Call { device: DEVICE.into(), call: "showing a picture", source });
            }
            if now - pushed >= self.push {
                self.put(picture)?;
                pushed = now;
            }
            std::thread::sleep(LOOK);
            self.take_back()?;
        }
        Ok(())
    }

    /// Whether the driver has buffers of the newest showing, and no other ones.
    fn is_shown(&self) -> bool {
        let mut queued = (0..self.queue.len()).filter(|k| self.queue.is_queued(*k)).map(|k| self.shows[k]).peekable();
        queued.peek().is_some() && queued.all(|showing| showing == self.showing)
    }

    fn take_back(&mut self) -> Result<(), Error> {
        while (0..self.queue.len()).any(|k| self.queue.is_queued(k)) {
            if !self.queue.take_back().map_err(|e| refused(DEVICE, "VIDIOC_DQBUF", e))? {
                break;
            }
        }
        Ok(())
    }
}

impl hal::Projector for OutputProjector {
    fn size(&self) -> (usize, usize) {
        self.settings.size
    }

    fn load(&mut self, pictures: &[Image<u8>]) -> Result<(), Error> {
        self.pictures.clear();
        let allowed = self.settings.size;
        if let Some(wrong) = pictures.iter().find(|p| (p.width, p.height) != allowed) {
            let found = (wrong.width, wrong.height);
            return Err(Error::Size { device: DEVICE.into(), what: "picture", found, allowed });
        }
        self.show(None)?;
        self.pictures = pictures.to_vec();
        Ok(())
    }

    fn show(&mut self, picture: Option<usize>) -> Result<(), Error> {
        let loaded = self.pictures.len();
        if let Some(picture) = picture.filter(|p| *p >= loaded) {
            return Err(Error::NotLoaded { device: DEVICE.into(), picture, loaded });
        }
        self.work(|open, pictures| open.screen.show(picture.map(|k| &pictures[k])))?;
        std::thread::sleep(self.settings.settle);
        Ok(())
    }

    fn check(&mut self) -> Result<(), Error> {
        self.work(|open, _| open.node.query_caps().map(|_| ()).map_err(|e| refused(DEVICE, "VIDIOC_QUERYCAP", e)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    /// A driver that gives a buffer back when so many newer ones are queued, and shows the oldest that it has.
    struct Driver {
        memory: Vec<[u8; 6]>,
        queued: VecDeque<usize>,
        newer: usize,
    }

    impl Buffers for Driver {
        fn len(&self) -> usize {
            self.memory.len()
        }
        fn is_queued(&self, index: usize) -> bool {
            self.queued.contains(&index)
        }
        fn bytes(&mut self, index: usize) -> &mut [u8] {
            assert!(!self.queued.contains(&index), "it is the driver's");
            &mut self.memory[index]
        }
        fn queue(&mut self, index: usize, bytes: usize) -> io::Result<()> {
            assert_eq!(bytes, 6);
            self.queued.push_back(index);
            Ok(())
        }
        fn take_back(&mut self) -> io::Result<bool> {
            let done = self.queued.len() > self.newer;
            if done {
                self.queued.pop_front();
            }
            Ok(done)
        }
    }

    fn screen(newer: usize) -> Screen<Driver> {
        let layout = Layout { width: 2, height: 2, fourcc: *b"GREY", stride: 3, bytes: 5 };
        let queue = Driver { memory: vec![[9; 6]; 4], queued: VecDeque::new(), newer };
        let (push, timeout) = (Duration::ZERO, Duration::from_millis(20));
        Screen { shows: vec![0; 4], queue, layout, showing: 0, push, timeout }
    }

    fn picture(level: u8) -> Image<u8> {
        Image { width: 2, height: 2, pixels: vec![level, 2, 3, 4] }
    }

    #[test]
    fn a_picture_is_shown_when_nothing_before_it_is_left_whatever_the_driver_holds_back() {
        for newer in 1..=3 {
            let mut screen = screen(newer);
            screen.put(None).expect("free");
            for level in [10, 20, 30, 20] {
                screen.show(Some(&picture(level))).expect("shown");
                let shown = &screen.queue.memory[screen.queue.queued[0]];
                assert_eq!(shown, &[level, 2, 9, 3, 4, 9], "rows are a stride apart; {newer}");
            }
            screen.show(None).expect("shown");
            assert_eq!(screen.queue.memory[screen.queue.queued[0]], [0, 0, 9, 0, 0, 9]);
        }
    }

    #[test]
    fn a_driver_that_gives_nothing_back_is_an_error_in_time() {
        let mut screen = screen(4);
        screen.put(None).expect("free");
        let e = screen.show(Some(&picture(10))).expect_err("never shown");
        assert_eq!(e.os().map(io::Error::kind), Some(io::ErrorKind::TimedOut));
    }
}
