//! datum's camera over libcamera, on a sensor that libcamera's simple pipeline finds in the guest (vimc, patched). In: nothing.
//! Out: a line for each thing seen; an error for the first that does not hold.

use crate::player::digest;
use crate::program::{CONFIG, PATH};
use crate::v4l2::{Node, Side};
use anyhow::{Context, ensure};
use datum::hal::linux::{CameraSettings, LibcameraCamera, LibcameraSettings, Sys, V4l2Camera, Watch};
use datum::hal::{Camera, Clock, Error, Sensor};
use datum::image::Image;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::thread::sleep;
use std::time::{Duration, Instant};

const SIZE: (usize, usize) = (648, 486);
/// What the sensor's driver and its capture node are called.
const SENSOR: &str = "Sensor A";
const NODE: &str = "Raw Capture 0";
/// vimc's test pattern.
const PATTERN: u32 = 0x00f0_f000;
/// Patterns that differ: bars, and a grey that rises.
const PATTERNS: [i32; 2] = [0, 13];
const DRIVER: &str = "/sys/bus/platform/drivers/vimc";
const TIMEOUT: Duration = Duration::from_secs(2);
const RETURNS: usize = 20;
/// Ready again after it has returned.
const READY_AGAIN: Duration = Duration::from_secs(5);

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Only that the camera goes and returns
    #[arg(long)]
    unplug: bool,
}

pub(crate) fn run(a: &Arguments) -> anyhow::Result<ExitCode> {
    let modprobe = Command::new("modprobe").arg("vimc").status()?;
    ensure!(modprobe.success(), "modprobe vimc: {modprobe}");
    udev()?;
    if a.unplug {
        unplug()?;
        return Ok(ExitCode::SUCCESS);
    }
    wrong()?;
    for (bits, fourcc) in [(8, *b"GREY"), (10, *b"Y10 ")] {
        stream(bits, fourcc).with_context(|| format!("{bits} bits"))?;
    }
    follows()?;
    programs()?;
    unplug()?;
    Ok(ExitCode::SUCCESS)
}

/// libcamera looks only at what udev has seen, and hears of what is gone from it.
fn udev() -> anyhow::Result<()> {
    for command in [
        &["/usr/lib/systemd/systemd-udevd", "--daemon"][..],
        &["/usr/bin/udevadm", "trigger", "--action=add"],
        &["/usr/bin/udevadm", "settle"],
    ] {
        let status = Command::new(command[0]).args(&command[1..]).status().context(command[0])?;
        ensure!(status.success(), "{}: {status}", command.join(" "));
    }
    Ok(())
}

fn sensor(bits: u8, (width, height): (usize, usize)) -> Sensor {
    Sensor {
        width,
        height,
        bits,
        black_level: 0.0,
        white_level: u16::MAX >> (16 - bits),
        dn_per_electron: 0.03,
        read_noise_e: 6.0,
        serial: String::new(),
    }
}

fn camera(device: &str, bits: u8, size: (usize, usize)) -> anyhow::Result<LibcameraCamera> {
    Ok(LibcameraCamera::new(LibcameraSettings {
        device: device.into(),
        sensor: sensor(bits, size),
        rate: 60.0,
        trigger: None,
        lag: 0,
        controls: BTreeMap::new(),
    })?)
}

fn direct(bits: u8, fourcc: [u8; 4]) -> anyhow::Result<V4l2Camera> {
    let settings = CameraSettings {
        device: NODE.into(),
        sensor: sensor(bits, SIZE),
        fourcc,
        rate: 60.0,
        trigger: None,
        exposure_unit: Duration::from_micros(100),
        gain_one: None,
        lag: 0,
        controls: BTreeMap::new(),
    };
    Ok(V4l2Camera::new(Sys::default(), settings)?)
}

fn hash(image: &Image<u16>) -> u64 {
    digest(&image.pixels.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>())
}

/// What is not there, or not so, is named.
fn wrong() -> anyhow::Result<()> {
    for (device, bits, size, says) in [
        ("imx296", 8, SIZE, "no libcamera camera \"imx296\", there: Sensor A"),
        (SENSOR, 12, SIZE, "the format R12 or R12_CSI2P is not offered, offered: R8, R10"),
        (SENSOR, 8, (640, 480), "image of 640×480 px, allowed: 648×486 px"),
    ] {
        let found = camera(device, bits, size)?.check().err().context("it is taken")?.to_string();
        println!("wrong: {found}");
        ensure!(found.contains(says), "it does not say: {says}");
    }
    Ok(())
}

/// Images one after the other, as the node itself gives them.
fn stream(bits: u8, fourcc: [u8; 4]) -> anyhow::Result<()> {
    let mut camera = camera(SENSOR, bits, SIZE)?;
    let stream = camera.watch(30, Duration::from_secs(5))?;
    println!("{bits} bits: {stream:?}");
    ensure!(stream.came == 30 && stream.lost + stream.doubled + stream.damaged == 0, "images do not come whole");
    let clock = datum::hal::linux::MonotonicClock;
    let mut image = Image::filled(SIZE.0, SIZE.1, 0);
    let (mut last, mut late) = (None, Duration::ZERO);
    let mut hashes = Vec::new();
    for _ in 0..30 {
        let asked_at = clock.now();
        let exposure = camera.grab(TIMEOUT, &mut image)?;
        let now = clock.now();
        ensure!(exposure.begun_at >= asked_at && exposure.begun_at <= now, "{exposure:?} from {asked_at:?} to {now:?}");
        ensure!(last.is_none_or(|n| exposure.sequence == n + 1), "{} after {last:?}", exposure.sequence);
        last = Some(exposure.sequence);
        late = late.max(now - asked_at);
        hashes.push(hash(&image));
    }
    drop(camera);
    let mut node = direct(bits, fourcc)?;
    node.grab(TIMEOUT, &mut image).context("the node itself")?;
    let wanted = hash(&image);
    let (least, most) = (image.pixels.iter().min(), image.pixels.iter().max());
    println!(
        "{bits} bits: 30 images {:016x}, of the node {wanted:016x}; levels {least:?} to {most:?}; each within {late:?}",
        hashes[0]
    );
    ensure!(least < most && hashes.iter().all(|h| *h == wanted), "the images are not the node's");
    Ok(())
}

/// An image that was asked for after a change shows it.
fn follows() -> anyhow::Result<()> {
    let subdev = node("v4l-subdev", SENSOR)?;
    let subdev = Node::open(&subdev, Side::Capture)?;
    let mut camera = camera(SENSOR, 8, SIZE)?;
    let mut image = Image::filled(SIZE.0, SIZE.1, 0);
    let mut shown = Vec::new();
    for pattern in PATTERNS {
        subdev.set_control(PATTERN, pattern)?;
        sleep(Duration::from_millis(500));
        camera.grab(TIMEOUT, &mut image)?;
        shown.push(hash(&image));
    }
    ensure!(shown[0] != shown[1], "the patterns look alike");
    for change in 0..40 {
        let which = change % 2;
        subdev.set_control(PATTERN, PATTERNS[which])?;
        camera.grab(TIMEOUT, &mut image)?;
        ensure!(hash(&image) == shown[which], "change {change}: the image shows what was before it");
    }
    subdev.set_control(PATTERN, PATTERNS[0])?;
    println!("40 changes of the picture, each seen in the next image");
    Ok(())
}

/// `datum doctor` and `datum capture` take images that way. The picture is the sensor's own: it answers to no light.
fn programs() -> anyhow::Result<()> {
    let text = CONFIG
        .replace("kind = \"v4l2\"", "kind = \"libcamera\"")
        .replace("/dev/datum/camera", SENSOR)
        .replace("rate = 8\n", "rate = 50\n")
        .replace("calibration = \"calibration.toml\"\n", "")
        .replace("TRIGGER", "plc");
    fs::write("sensor.toml", text)?;
    let out = Command::new(PATH).args(["doctor", "--config", "sensor.toml"]).output()?;
    let said = String::from_utf8_lossy(&out.stdout).into_owned();
    let of_camera = said.lines().find(|l| l.contains(" camera ")).unwrap_or_default();
    println!("doctor: {of_camera}");
    let whole = of_camera.contains("30 images") && of_camera.contains("0 lost, 0 doubled, 0 damaged");
    ensure!(whole, "doctor: {said}{}", String::from_utf8_lossy(&out.stderr));
    let out = Command::new(PATH).args(["capture", "--config", "sensor.toml", "--out", "captured"]).output()?;
    let said = String::from_utf8_lossy(&out.stdout);
    println!("capture: {}", said.trim_end());
    ensure!(out.status.success() && said.contains("16 fringe images"), "{}", String::from_utf8_lossy(&out.stderr));
    Ok(())
}

/// The driver lets go of it, and takes it again.
fn unplug() -> anyhow::Result<()> {
    let mut camera = camera(SENSOR, 8, SIZE)?;
    let mut image = Image::filled(SIZE.0, SIZE.1, 0);
    camera.grab(TIMEOUT, &mut image)?;
    let wanted = hash(&image);
    let (mut noticed, mut ready) = (Duration::ZERO, Duration::ZERO);
    for time in 1..=RETURNS {
        fs::write(format!("{DRIVER}/unbind"), "vimc.0")?;
        let gone_at = Instant::now();
        while camera.check().is_ok() {
            ensure!(gone_at.elapsed() < Duration::from_secs(10), "time {time}: it does not notice");
            sleep(Duration::from_millis(20));
        }
        noticed = noticed.max(gone_at.elapsed());
        let says = camera.grab(TIMEOUT, &mut image).err().context("an image of a camera that is gone")?;
        ensure!(matches!(says, Error::Gone { .. }), "time {time}: {says}");
        fs::write(format!("{DRIVER}/bind"), "vimc.0")?;
        let back_at = Instant::now();
        while let Err(e) = camera.grab(TIMEOUT, &mut image) {
            ensure!(back_at.elapsed() < READY_AGAIN, "time {time}: {e}");
            sleep(Duration::from_millis(20));
        }
        ready = ready.max(back_at.elapsed());
        println!("return {time}: an image after {:?}", back_at.elapsed());
        ensure!(hash(&image) == wanted, "time {time}: another image");
    }
    println!("gone and back {RETURNS} times: noticed within {noticed:?}, an image again within {ready:?}");
    Ok(())
}

/// The node of a class that is called so.
fn node(class: &str, name: &str) -> anyhow::Result<PathBuf> {
    for entry in fs::read_dir("/sys/class/video4linux")? {
        let entry = entry?;
        let file = entry.file_name();
        let called = fs::read_to_string(entry.path().join("name"))?;
        if file.to_string_lossy().starts_with(class) && called.trim() == name {
            return Ok(Path::new("/dev").join(file));
        }
    }
    anyhow::bail!("no {class} is called {name}")
}
