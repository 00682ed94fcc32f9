//! Images through the camera's nodes, bit by bit.

use crate::player::digest;
use crate::v4l2::{Node, Side, control};
use anyhow::{Context, ensure};
use datum::sim::Random;
use std::path::Path;
use std::process::ExitCode;
use std::time::Duration;

const SIZE: (usize, usize) = (2592, 1944);
const IMAGES: u64 = 8;
const PATIENCE: Duration = Duration::from_secs(5);

pub(crate) fn run() -> anyhow::Result<ExitCode> {
    for (format, bytes) in [(*b"GREY", 1), (*b"Y16 ", 2)] {
        through(format, bytes).with_context(|| String::from_utf8_lossy(&format).into_owned())?;
    }
    Ok(ExitCode::SUCCESS)
}

fn through(format: [u8; 4], bytes: usize) -> anyhow::Result<()> {
    let mut out = Node::open(Path::new("/dev/datum/exposed"), Side::Output)?;
    let mut camera = Node::open(Path::new("/dev/datum/camera"), Side::Capture)?;
    camera.set_control(control::LOOP, 1)?;
    camera.set_control(control::TEXT, 2)?;
    camera.set_timings(SIZE, 60)?;
    camera.set_format(SIZE, format)?;
    out.set_timings(SIZE, 60)?;
    out.set_format(SIZE, format)?;
    out.start(4).context("output")?;
    camera.start(4).context("capture")?;
    let length = SIZE.0 * SIZE.1 * bytes;
    let mut queued = Vec::new();
    for k in 0..IMAGES {
        // the first ones fill the queue; later ones wait for a buffer
        let index = match k {
            0..4 => k as u32,
            _ => out.next(PATIENCE)?.context("no output buffer came back")?.index,
        };
        let mut random = Random::new(k, &[u64::from(u32::from_le_bytes(format))]);
        for chunk in out.bytes(index)[..length].chunks_mut(8) {
            chunk.copy_from_slice(&random.bits().to_le_bytes()[..chunk.len()]);
        }
        queued.push(digest(&out.bytes(index)[..length]));
        out.queue(index, stamp(k))?;
        // the kernel may wait for a second one before it begins
        if k == 0 {
            continue;
        }
        loop {
            let given = camera.next(PATIENCE)?.context("no image came")?;
            let captured = digest(&camera.bytes(given.index)[..length]);
            let of = (0..=k).find(|k| stamp(*k) == given.stamp).context("an image of another time")?;
            let wanted = queued[of as usize];
            println!("{} {of} queued {wanted:016x} captured {captured:016x}", String::from_utf8_lossy(&format));
            ensure!(captured == wanted && !given.broken, "image {of} is not what was queued");
            camera.queue(given.index, Duration::ZERO)?;
            if of == k {
                break;
            }
        }
    }
    Ok(())
}

/// The time that image `k` carries.
fn stamp(k: u64) -> Duration {
    Duration::from_micros(1_000_000 + k)
}
