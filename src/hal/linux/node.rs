//! A V4L2 node, found and opened. In: its path or name, what it must do, a format. Out: the open node, set so; or what is
//! wrong with it, with what it offers instead. Not here: buffers.

use super::Sys;
use crate::hal::Error;
use std::fs;
use std::io;
use std::path::PathBuf;
use v4l::capability::Flags;
use v4l::video::{Capture, Output};
use v4l::{Device, Format, FourCC};

/// Which way images go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Way {
    Capture,
    Output,
}

/// How images lie in a node's buffers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) fourcc: [u8; 4],
    /// Bytes from one row to the next, as the driver took it.
    pub(super) stride: usize,
    /// Bytes of an image.
    pub(super) bytes: usize,
}

/// Opens the node `name`, which is a path or what the driver calls the node, and sets the format.
pub(super) fn open(
    device: &str,
    sys: &Sys,
    name: &str,
    way: Way,
    (width, height): (usize, usize),
    fourcc: [u8; 4],
) -> Result<(Device, Layout), Error> {
    let path = path(device, sys, name)?;
    let device = &format!("{device} ({})", path.display());
    let said = |call| move |source: io::Error| refused(device, call, source);
    let node = Device::with_path(&path).map_err(said("open"))?;
    let capabilities = node.query_caps().map_err(said("VIDIOC_QUERYCAP"))?;
    let (direction, wanted) = match way {
        Way::Capture => (Flags::VIDEO_CAPTURE, "single-planar capture with streaming"),
        Way::Output => (Flags::VIDEO_OUTPUT, "single-planar output with streaming"),
    };
    if !capabilities.capabilities.contains(direction | Flags::STREAMING) {
        let offered = vec![format!("{} ({:?})", capabilities.card, capabilities.capabilities)];
        return Err(Error::NotOffered { device: device.clone(), what: "the use", wanted: wanted.into(), offered });
    }
    let side = |px: usize| u32::try_from(px).expect("checked to be an image's");
    let format = Format::new(side(width), side(height), FourCC::new(&fourcc));
    let (formats, taken) = match way {
        Way::Capture => (Capture::enum_formats(&node), Capture::set_format(&node, &format)),
        Way::Output => (Output::enum_formats(&node), Output::set_format(&node, &format)),
    };
    let taken = taken.map_err(said("VIDIOC_S_FMT"))?;
    if taken.fourcc.repr != fourcc {
        let text = |repr: &[u8; 4]| String::from_utf8_lossy(repr).trim_end().to_owned();
        let offered = formats.unwrap_or_default().iter().map(|f| text(&f.fourcc.repr)).collect();
        return Err(Error::NotOffered { device: device.clone(), what: "the format", wanted: text(&fourcc), offered });
    }
    let found = (taken.width as usize, taken.height as usize);
    if found != (width, height) {
        return Err(Error::Size { device: device.clone(), what: "image", found: (width, height), allowed: found });
    }
    let sample = if fourcc == *b"GREY" { 1 } else { 2 };
    let stride = (taken.stride as usize).max(width * sample); // 0 where a driver does not say
    Ok((node, Layout { width, height, fourcc, stride, bytes: stride * (height - 1) + width * sample }))
}

/// An error of the system, and whether that means that the device is gone.
pub(super) fn refused(device: &str, call: &'static str, source: io::Error) -> Error {
    // no such device, no such device or address, input/output error: <asm-generic/errno-base.h>
    match source.raw_os_error() {
        Some(19 | 6 | 5) => Error::Gone { device: device.into() },
        _ => Error::Call { device: device.into(), call, source },
    }
}

fn path(device: &str, sys: &Sys, name: &str) -> Result<PathBuf, Error> {
    if name.starts_with('/') {
        return Ok(name.into());
    }
    let mut there = Vec::new();
    for node in fs::read_dir(sys.0.join("class/video4linux")).into_iter().flatten().flatten() {
        let called = fs::read_to_string(node.path().join("name")).unwrap_or_default().trim().to_owned();
        if called == name {
            return Ok(PathBuf::from("/dev").join(node.file_name()));
        }
        there.push(called);
    }
    there.sort();
    Err(Error::Absent { device: device.into(), what: "V4L2 node", wanted: name.into(), there })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_node_is_found_by_its_path_or_by_what_its_driver_calls_it() {
        let root = std::env::temp_dir().join(format!("datum-video-{}", std::process::id()));
        for (node, name) in [("video7", "head camera\n"), ("video9", "head projector\n")] {
            let folder = root.join("class/video4linux").join(node);
            fs::create_dir_all(&folder).expect("writable");
            fs::write(folder.join("name"), name).expect("writable");
        }
        let found = |name: &str| path("camera", &Sys(root.clone()), name);
        assert_eq!(found("/dev/video3").expect("a path"), PathBuf::from("/dev/video3"));
        assert_eq!(found("head projector").expect("there"), PathBuf::from("/dev/video9"));
        let says = "camera: no V4L2 node \"head\", there: head camera, head projector";
        assert_eq!(found("head").expect_err("absent").to_string(), says);
        fs::remove_dir_all(root).expect("just made");
    }
}
