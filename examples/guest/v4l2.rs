//! A V4L2 node, from the other side of the cable: what a projector shows is read, what a camera sees is written.
//! In:  a node's path. Out: its controls, timings and format; buffers that the kernel and we hand to each other.
//! Not here: what the images mean. The station's own drivers (`datum::hal::linux`) are not used: they are what is tested.

#![expect(unsafe_code, reason = "V4L2 is ioctls and shared memory")]

use rustix::event::{PollFd, PollFlags, poll};
use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::AsRawFd;
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::time::Duration;
use v4l::v4l_sys as sys;
use v4l::v4l2::{ioctl, mmap, munmap, vidioc};

const O_NONBLOCK: i32 = 0o4000;
const PROT_READ_WRITE: i32 = 3;
const MAP_SHARED: i32 = 1;
/// Not in the crate: `_IOWR('V', 87, struct v4l2_dv_timings)`.
const S_DV_TIMINGS: vidioc::_IOC_TYPE = (3 << 30)
    | ((size_of::<sys::v4l2_dv_timings>() as vidioc::_IOC_TYPE) << 16)
    | ((b'V' as vidioc::_IOC_TYPE) << 8)
    | 87;

/// Controls of the guest's devices.
pub(crate) mod control {
    pub(crate) const GAIN: u32 = 0x0098_0913;
    /// 100 µs.
    pub(crate) const EXPOSURE: u32 = 0x009a_0902;
    const VIVID: u32 = 0x00f0_f000;
    /// What is given where nothing comes in; 5: black.
    pub(crate) const TEST_PATTERN: u32 = VIVID;
    /// 2: no text.
    pub(crate) const TEXT: u32 = VIVID + 1;
    /// 1: time stamps are of the exposure's begin.
    pub(crate) const STAMP_AT_BEGIN: u32 = VIVID + 24;
    /// 1: the capture node gives what the output node gets.
    pub(crate) const LOOP: u32 = VIVID + 37;
    /// Percent of buffers that are dropped.
    pub(crate) const DROPPED: u32 = VIVID + 64;
    /// The nodes are gone until all who have them open have closed them.
    pub(crate) const DISCONNECT: u32 = VIVID + 65;
    /// The next buffer is marked as broken.
    pub(crate) const BROKEN: u32 = VIVID + 66;
}

/// Which way images go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Side {
    /// From the kernel.
    Capture,
    /// To the kernel.
    Output,
}

/// A buffer that the kernel has given back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Given {
    pub(crate) index: u32,
    pub(crate) stamp: Duration,
    /// Marked as broken.
    pub(crate) broken: bool,
}

/// An open node.
pub(crate) struct Node {
    file: File,
    side: Side,
    buffers: Vec<(*mut u8, usize)>,
}

// SAFETY: the mappings are shared memory that belongs to this node alone.
unsafe impl Send for Node {}

impl Node {
    pub(crate) fn open(path: &Path, side: Side) -> io::Result<Self> {
        let file = OpenOptions::new().read(true).write(true).custom_flags(O_NONBLOCK).open(path)?;
        Ok(Self { file, side, buffers: Vec::new() })
    }

    fn call<T>(&self, code: vidioc::_IOC_TYPE, argument: &mut T) -> io::Result<()> {
        // SAFETY: every caller pairs a code with the struct that the kernel's headers pair it with; it outlives the call.
        unsafe { ioctl(self.file.as_raw_fd(), code, std::ptr::from_mut(argument).cast()) }
    }

    fn kind(&self) -> u32 {
        match self.side {
            Side::Capture => sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_CAPTURE,
            Side::Output => sys::v4l2_buf_type_V4L2_BUF_TYPE_VIDEO_OUTPUT,
        }
    }

    pub(crate) fn control(&self, id: u32) -> io::Result<i32> {
        let mut c = sys::v4l2_control { id, value: 0 };
        self.call(vidioc::VIDIOC_G_CTRL, &mut c)?;
        Ok(c.value)
    }

    pub(crate) fn set_control(&self, id: u32, value: i32) -> io::Result<()> {
        self.call(vidioc::VIDIOC_S_CTRL, &mut sys::v4l2_control { id, value })
    }

    /// The cable's images are of that size, `fps` of them a second; no blanking between them.
    pub(crate) fn set_timings(&self, (width, height): (usize, usize), fps: u64) -> io::Result<()> {
        // SAFETY: plain numbers, for which 0 is a value
        let mut t: sys::v4l2_dv_timings = unsafe { std::mem::zeroed() };
        let bt = sys::v4l2_bt_timings {
            width: width as u32,
            height: height as u32,
            pixelclock: (width * height) as u64 * fps,
            standards: 4, // CVT
            // SAFETY: as above
            ..unsafe { std::mem::zeroed() }
        };
        t.__bindgen_anon_1.bt = bt;
        self.call(S_DV_TIMINGS, &mut t)
    }

    /// Images of that size and format.
    pub(crate) fn set_format(&self, (width, height): (usize, usize), format: [u8; 4]) -> io::Result<()> {
        // SAFETY: plain numbers, for which 0 is a value
        let mut f: sys::v4l2_format = unsafe { std::mem::zeroed() };
        f.type_ = self.kind();
        f.fmt.pix = sys::v4l2_pix_format {
            width: width as u32,
            height: height as u32,
            pixelformat: u32::from_le_bytes(format),
            field: sys::v4l2_field_V4L2_FIELD_NONE,
            // SAFETY: as above
            ..unsafe { std::mem::zeroed() }
        };
        self.call(vidioc::VIDIOC_S_FMT, &mut f)?;
        // SAFETY: both calls leave that member
        let got = unsafe { f.fmt.pix };
        if (got.width as usize, got.height as usize, got.pixelformat.to_le_bytes()) == (width, height, format) {
            return Ok(());
        }
        Err(io::Error::other(format!("{}×{} of another format instead of {width}×{height}", got.width, got.height)))
    }

    fn buffer(&self, index: u32) -> sys::v4l2_buffer {
        // SAFETY: plain numbers, for which 0 is a value
        let mut b: sys::v4l2_buffer = unsafe { std::mem::zeroed() };
        (b.index, b.type_, b.memory) = (index, self.kind(), sys::v4l2_memory_V4L2_MEMORY_MMAP);
        b
    }

    /// Streams with `count` buffers; those of a capture node are the kernel's from now on.
    pub(crate) fn start(&mut self, count: u32) -> io::Result<()> {
        // SAFETY: plain numbers, for which 0 is a value
        let mut r: sys::v4l2_requestbuffers = unsafe { std::mem::zeroed() };
        (r.count, r.type_, r.memory) = (count, self.kind(), sys::v4l2_memory_V4L2_MEMORY_MMAP);
        self.call(vidioc::VIDIOC_REQBUFS, &mut r)?;
        for index in 0..r.count {
            let mut b = self.buffer(index);
            self.call(vidioc::VIDIOC_QUERYBUF, &mut b)?;
            let length = b.length as usize;
            // SAFETY: a new mapping, as long as the kernel says the buffer is; unmapped once, when dropped
            let at = unsafe {
                mmap(
                    std::ptr::null_mut(),
                    length,
                    PROT_READ_WRITE,
                    MAP_SHARED,
                    self.file.as_raw_fd(),
                    i64::from(b.m.offset),
                )
            }?;
            self.buffers.push((at.cast(), length));
        }
        if self.side == Side::Capture {
            (0..r.count).try_for_each(|index| self.queue(index, Duration::ZERO))?;
        }
        self.call(vidioc::VIDIOC_STREAMON, &mut self.kind())
    }

    /// How many buffers there are.
    pub(crate) fn count(&self) -> u32 {
        self.buffers.len() as u32
    }

    /// A buffer's bytes. It must not be the kernel's just now, or it changes while it is looked at.
    pub(crate) fn bytes(&mut self, index: u32) -> &mut [u8] {
        let (at, length) = self.buffers[index as usize];
        // SAFETY: mapped in `start` with that length, and borrowed with the node
        unsafe { std::slice::from_raw_parts_mut(at, length) }
    }

    /// Hands a buffer to the kernel; an output's with the time that its image is of.
    pub(crate) fn queue(&self, index: u32, stamp: Duration) -> io::Result<()> {
        let mut b = self.buffer(index);
        if self.side == Side::Output {
            b.bytesused = self.buffers[index as usize].1 as u32;
            b.field = sys::v4l2_field_V4L2_FIELD_NONE;
            b.timestamp.tv_sec = stamp.as_secs().cast_signed() as _;
            b.timestamp.tv_usec = stamp.subsec_micros().into();
        }
        self.call(vidioc::VIDIOC_QBUF, &mut b)
    }

    /// A buffer that the kernel is done with, if there is one.
    pub(crate) fn dequeue(&self) -> io::Result<Option<Given>> {
        let mut b = self.buffer(0);
        match self.call(vidioc::VIDIOC_DQBUF, &mut b) {
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            done => done?,
        }
        let stamp = Duration::new(b.timestamp.tv_sec as u64, b.timestamp.tv_usec as u32 * 1000);
        let broken = b.flags & sys::V4L2_BUF_FLAG_ERROR != 0;
        Ok(Some(Given { index: b.index, stamp, broken }))
    }

    /// As [`Self::dequeue`], for so long; `None`: nothing came.
    pub(crate) fn next(&self, timeout: Duration) -> io::Result<Option<Given>> {
        if let Some(given) = self.dequeue()? {
            return Ok(Some(given));
        }
        let events = match self.side {
            Side::Capture => PollFlags::IN,
            Side::Output => PollFlags::OUT,
        };
        let timeout = timeout.try_into().map_err(|_| io::ErrorKind::InvalidInput)?;
        poll(&mut [PollFd::new(&self.file, events)], Some(&timeout))?;
        self.dequeue()
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        for (at, length) in self.buffers.drain(..) {
            // SAFETY: mapped in `start`, and nobody borrows it any more
            let _ = unsafe { munmap(at.cast(), length) };
        }
    }
}
