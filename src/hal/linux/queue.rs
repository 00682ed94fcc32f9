//! A V4L2 node's buffers, mapped, in either direction; and its controls' ranges. In: an open node. Out: buffers by index.
//! The only file with `unsafe`: what the kernel's interface needs and no crate offers safely. The v4l crate's own streams
//! keep one output buffer in flight, re-queue a buffer that the kernel holds after a time-out, and panic when dropped.
//! linux/Documentation/userspace-api/media/v4l/mmap.rst. Not here: what is in the buffers; when to queue.
#![expect(unsafe_code, reason = "ioctl and mmap")]

use std::ffi::c_void;
use std::io;
use std::mem::zeroed;
use std::sync::Arc;
use std::time::Duration;
use v4l::buffer::{Flags, Type};
use v4l::device::Handle;
use v4l::memory::Memory;
use v4l::v4l_sys::{V4L2_CTRL_FLAG_NEXT_CTRL, v4l2_buffer, v4l2_query_ext_ctrl, v4l2_requestbuffers};
use v4l::v4l2::vidioc;

/// An ioctl: its code, and in `T` the struct that the kernel pairs with it.
struct Ioctl<T>(vidioc::_IOC_TYPE, std::marker::PhantomData<T>);

impl<T> Ioctl<T> {
    fn call(&self, handle: &Handle, argument: &mut T) -> io::Result<()> {
        let argument: *mut T = argument;
        // SAFETY: the code and `T` are paired below; `argument` and `handle` outlive the call
        unsafe { v4l::v4l2::ioctl(handle.fd(), self.0, argument.cast::<c_void>()) }
    }
}

macro_rules! ioctls {
    ($($name:ident: $argument:ty;)*) => {
        $(const $name: Ioctl<$argument> = Ioctl(vidioc::$name, std::marker::PhantomData);)*
    };
}
ioctls! {
    VIDIOC_REQBUFS: v4l2_requestbuffers;
    VIDIOC_QUERYBUF: v4l2_buffer;
    VIDIOC_QBUF: v4l2_buffer;
    VIDIOC_DQBUF: v4l2_buffer;
    VIDIOC_STREAMON: std::ffi::c_int;
    VIDIOC_STREAMOFF: std::ffi::c_int;
    VIDIOC_QUERY_EXT_CTRL: v4l2_query_ext_ctrl;
}

/// A control's range.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Control {
    pub(super) id: u32,
    pub(super) name: String,
    pub(super) least: i64,
    pub(super) most: i64,
    pub(super) step: i64,
}

/// The node's controls that hold one number.
pub(super) fn controls(handle: &Handle) -> Vec<Control> {
    let mut found = Vec::new();
    let mut id = 0;
    loop {
        // SAFETY: a plain C struct, for which zeros are valid
        let mut query = unsafe { zeroed::<v4l2_query_ext_ctrl>() };
        query.id = id | V4L2_CTRL_FLAG_NEXT_CTRL;
        if VIDIOC_QUERY_EXT_CTRL.call(handle, &mut query).is_err() {
            return found; // the last one
        }
        id = query.id;
        let name = query.name.iter().take_while(|c| **c != 0).map(|c| char::from(c.to_ne_bytes()[0])).collect();
        let step = i64::try_from(query.step).unwrap_or(1).max(1);
        found.push(Control { id, name, least: query.minimum, most: query.maximum, step });
    }
}

/// A buffer that came back from the kernel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Done {
    pub(super) index: usize,
    /// Of it are used.
    pub(super) bytes: usize,
    pub(super) flags: Flags,
    pub(super) sequence: u32,
    pub(super) stamp: Duration,
}

struct Mapped {
    at: *mut u8,
    bytes: usize,
    /// The kernel's, until it is dequeued.
    queued: bool,
}

/// A node's buffers.
pub(super) struct Queue {
    handle: Arc<Handle>,
    kind: Type,
    buffers: Vec<Mapped>,
}

// SAFETY: the mappings belong to the queue alone, and a process's threads share its address space
unsafe impl Send for Queue {}

impl Queue {
    /// Asks for `count` buffers; the driver may give another number.
    pub(super) fn new(handle: Arc<Handle>, kind: Type, count: u32) -> io::Result<Self> {
        let mut queue = Self { handle, kind, buffers: Vec::new() };
        let count = queue.request(count)?;
        for index in 0..count {
            let mut buffer = queue.buffer(index);
            VIDIOC_QUERYBUF.call(&queue.handle, &mut buffer)?;
            let (read_write, shared) = (0x3, 0x1); // PROT_READ | PROT_WRITE, MAP_SHARED: <asm-generic/mman-common.h>
            let bytes = buffer.length as usize;
            // SAFETY: for mapped memory the kernel fills `offset`; a new mapping overlaps nothing of ours
            let at = unsafe {
                let offset = buffer.m.offset.into();
                v4l::v4l2::mmap(std::ptr::null_mut(), bytes, read_write, shared, queue.handle.fd(), offset)?
            };
            queue.buffers.push(Mapped { at: at.cast(), bytes, queued: false });
        }
        Ok(queue)
    }

    fn request(&self, count: u32) -> io::Result<u32> {
        // SAFETY: a plain C struct, for which zeros are valid
        let mut request = unsafe { zeroed::<v4l2_requestbuffers>() };
        (request.count, request.type_, request.memory) = (count, self.kind as u32, Memory::Mmap as u32);
        VIDIOC_REQBUFS.call(&self.handle, &mut request)?;
        Ok(request.count)
    }

    fn buffer(&self, index: u32) -> v4l2_buffer {
        // SAFETY: a plain C struct, for which zeros are valid
        let mut buffer = unsafe { zeroed::<v4l2_buffer>() };
        (buffer.index, buffer.type_, buffer.memory) = (index, self.kind as u32, Memory::Mmap as u32);
        buffer
    }

    /// How many there are.
    pub(super) fn len(&self) -> usize {
        self.buffers.len()
    }

    /// How many the kernel has.
    pub(super) fn queued(&self) -> usize {
        self.buffers.iter().filter(|b| b.queued).count()
    }

    /// Whether the kernel has it.
    pub(super) fn is_queued(&self, index: usize) -> bool {
        self.buffers[index].queued
    }

    /// A buffer's bytes. Panics if the kernel has it.
    pub(super) fn bytes(&mut self, index: usize) -> &mut [u8] {
        let buffer = &self.buffers[index];
        assert!(!buffer.queued, "buffer {index} is the kernel's");
        // SAFETY: mapped for as long as the queue lives, borrowed from it alone, and not written by the kernel meanwhile
        unsafe { std::slice::from_raw_parts_mut(buffer.at, buffer.bytes) }
    }

    /// Gives a buffer to the kernel, with so many bytes used: to be filled, or to be shown.
    pub(super) fn queue(&mut self, index: usize, bytes: usize) -> io::Result<()> {
        let mut buffer = self.buffer(u32::try_from(index).expect("few buffers"));
        buffer.bytesused = u32::try_from(bytes).expect("no image has 4 GiB");
        buffer.field = 1; // V4L2_FIELD_NONE: progressive
        VIDIOC_QBUF.call(&self.handle, &mut buffer)?;
        self.buffers[index].queued = true;
        Ok(())
    }

    /// A buffer that the kernel has finished with; `None`: there is none yet.
    pub(super) fn dequeue(&mut self) -> io::Result<Option<Done>> {
        let mut buffer = self.buffer(0);
        match VIDIOC_DQBUF.call(&self.handle, &mut buffer) {
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => return Ok(None),
            other => other?,
        }
        let index = buffer.index as usize;
        self.buffers[index].queued = false;
        let (seconds, micros) = (buffer.timestamp.tv_sec, buffer.timestamp.tv_usec);
        let stamp = Duration::from_secs(u64::try_from(seconds).unwrap_or(0))
            + Duration::from_micros(u64::try_from(micros).unwrap_or(0));
        let flags = Flags::from(buffer.flags);
        Ok(Some(Done { index, bytes: buffer.bytesused as usize, flags, sequence: buffer.sequence, stamp }))
    }

    /// Waits until a captured buffer may be there, for at most `timeout`.
    pub(super) fn wait(&self, timeout: Duration) -> io::Result<()> {
        let readable = 0x1; // POLLIN
        let ms = i32::try_from(timeout.as_millis()).unwrap_or(i32::MAX).max(1);
        match self.handle.poll(readable, ms) {
            Err(e) if e.kind() != io::ErrorKind::Interrupted => Err(e),
            _ => Ok(()),
        }
    }

    pub(super) fn start(&self) -> io::Result<()> {
        VIDIOC_STREAMON.call(&self.handle, &mut self.kind_number())
    }

    fn kind_number(&self) -> std::ffi::c_int {
        self.kind as std::ffi::c_int
    }
}

impl Drop for Queue {
    /// A node that is gone refuses all of this, which is as good.
    fn drop(&mut self) {
        let _ = VIDIOC_STREAMOFF.call(&self.handle, &mut self.kind_number());
        for buffer in &self.buffers {
            // SAFETY: mapped in `new`, and borrowed by nobody any more
            let _ = unsafe { v4l::v4l2::munmap(buffer.at.cast(), buffer.bytes) };
        }
        let _ = self.request(0);
    }
}
