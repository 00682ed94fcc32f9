//! A station's real devices. In: its configuration, which has been checked. Out: devices of `hal`; all of them dark.
//! Not here: the simulated ones; what is done with devices.

use super::config::{CameraKind, CameraTrigger, PixelFormat, ProjectorKind, StationFile};
use super::hardware::{Hardware, Temperatures};
use crate::calibrate::Calibration;
use crate::capture::TYPICAL_GAIN;
use crate::hal::linux::{
    BarSettings, Bars, CameraSettings, LineName, OutputProjector, OutputSettings, PresenceLine, SequencedProjector,
    SequencedSettings, Sys, Thermometer, V4l2Camera, Watch, bars_dark, sequenced_dark,
};
#[cfg(feature = "libcamera")]
use crate::hal::linux::{LibcameraCamera, LibcameraSettings};
use crate::hal::{Error, Projector, Sensor};
use crate::image::{Image, read_png};
use std::io;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// The devices that `config` names. Camera and projector may be plugged in later; lines and channels must be there.
pub fn real(config: &StationFile) -> Result<Hardware, Error> {
    Ok(Hardware {
        bars: Box::new(bars(config)?),
        projector: projector(config)?,
        camera: camera(config)?,
        presence: presence(config)?.map(|p| Box::new(p) as _),
        temperatures: temperatures(config),
        simulated: false,
    })
}

/// The camera.
pub fn camera(config: &StationFile) -> Result<Box<dyn Watch + Send>, Error> {
    let keys = &config.camera;
    let (fourcc, bits) = match keys.format {
        PixelFormat::Grey => (*b"GREY", 8),
        PixelFormat::Y10 => (*b"Y10 ", 10),
        PixelFormat::Y12 => (*b"Y12 ", 12),
        PixelFormat::Y16 => (*b"Y16 ", 16),
    };
    let largest = u16::MAX >> (16 - bits);
    let sensor = Sensor {
        width: keys.width,
        height: keys.height,
        bits,
        black_level: keys.black_level,
        white_level: keys.white_level.unwrap_or(largest),
        dn_per_electron: keys.dn_per_electron.unwrap_or(TYPICAL_GAIN * f64::from(largest) / 255.0),
        read_noise_e: keys.read_noise_e,
        serial: keys.serial.clone(),
    };
    let trigger = (keys.trigger == CameraTrigger::Gpio).then(|| parsed(&keys.trigger_line));
    if keys.kind == CameraKind::Libcamera {
        return libcamera(config, sensor, trigger);
    }
    let settings = CameraSettings {
        device: named(&keys.device),
        sensor,
        fourcc,
        rate: keys.rate,
        trigger,
        exposure_unit: Duration::from_secs_f64(keys.exposure_unit_us / 1e6),
        gain_one: keys.gain_one,
        lag: keys.lag_images,
        controls: keys.controls.clone(),
    };
    Ok(Box::new(V4l2Camera::new(Sys::default(), settings)?))
}

#[cfg(feature = "libcamera")]
fn libcamera(config: &StationFile, sensor: Sensor, trigger: Option<LineName>) -> Result<Box<dyn Watch + Send>, Error> {
    let keys = &config.camera;
    let (device, rate, lag, controls) = (named(&keys.device), keys.rate, keys.lag_images, keys.controls.clone());
    let settings = LibcameraSettings { device, sensor, rate, trigger, lag, controls };
    Ok(Box::new(LibcameraCamera::new(settings)?))
}

/// [`StationFile::not_built`] has said so before.
#[cfg(not(feature = "libcamera"))]
fn libcamera(_: &StationFile, _: Sensor, _: Option<LineName>) -> Result<Box<dyn Watch + Send>, Error> {
    let (what, wanted) = ("the driver", "libcamera".into());
    Err(Error::NotOffered { device: "camera".into(), what, wanted, offered: vec!["v4l2".into()] })
}

/// The projector.
pub fn projector(config: &StationFile) -> Result<Box<dyn Projector + Send>, Error> {
    let keys = &config.projector;
    let (size, settle) = ((keys.width, keys.height), ms(keys.settle_ms));
    if keys.kind == ProjectorKind::Sequenced {
        let settings = SequencedSettings {
            advance: parsed(&keys.advance),
            restart: parsed(&keys.restart),
            trigger_out: keys.trigger_out.as_ref().map(|_| parsed(&keys.trigger_out)),
            pulse: Duration::from_micros(keys.pulse_us),
            settle,
            size,
            stored: stored(&config.beside(keys.patterns.as_deref().unwrap_or(Path::new(""))))?,
        };
        return Ok(Box::new(SequencedProjector::open(settings)?));
    }
    let settings = OutputSettings { device: named(&keys.device), size, settle };
    Ok(Box::new(OutputProjector::new(Sys::default(), settings)))
}

/// The light bars.
pub fn bars(config: &StationFile) -> Result<Bars, Error> {
    Bars::open(&Sys::default(), &bar_settings(config))
}

/// The presence sensor, if there is one.
pub fn presence(config: &StationFile) -> Result<Option<PresenceLine>, Error> {
    let keys = &config.presence;
    keys.line.as_ref().map(|_| PresenceLine::open(&parsed(&keys.line), keys.active_low)).transpose()
}

/// What tells how warm it is.
pub fn temperatures(config: &StationFile) -> Temperatures {
    let of = |name: &Option<String>| name.as_ref().map(|name| Thermometer::new(Sys::default(), name));
    let keys = &config.temperatures;
    Temperatures {
        computer: of(&keys.computer),
        camera: of(&keys.camera),
        projector: of(&keys.projector),
        most: [keys.computer_max_c, keys.camera_max_c, keys.projector_max_c],
    }
}

/// Every output in its safe state, whatever state its last program left it in; what could not be reached.
/// Nothing is touched while another program holds the bars.
pub fn dark(config: &StationFile) -> Vec<Error> {
    let mut wrong = bars_dark(&Sys::default(), &bar_settings(config));
    if wrong.iter().any(|e| matches!(e, Error::Held { .. })) {
        return wrong;
    }
    let keys = &config.projector;
    let projector = if keys.kind == ProjectorKind::Sequenced {
        // without its stored pictures, which may be missing
        sequenced_dark(&parsed(&keys.restart), Duration::from_micros(keys.pulse_us))
    } else {
        projector(config).and_then(|mut p| p.show(None))
    };
    wrong.extend(projector.err());
    wrong
}

/// Whether images and pictures have the sizes that were calibrated; an error says what has not.
pub fn fits(calibration: &Calibration, camera: (usize, usize), projector: (usize, usize)) -> Result<(), String> {
    let rig = &calibration.rig;
    for (key, found, allowed) in [
        ("camera.width and camera.height", camera, (rig.camera.width, rig.camera.height)),
        ("projector.width and projector.height", projector, (rig.projector.width, rig.projector.height)),
    ] {
        if found != allowed {
            let at = calibration.file.display();
            return Err(format!(
                "{key} = {}×{}, allowed: {}×{}, as {at} has it",
                found.0, found.1, allowed.0, allowed.1
            ));
        }
    }
    Ok(())
}

fn bar_settings(config: &StationFile) -> BarSettings {
    let keys = &config.lights;
    BarSettings {
        lines: [parsed(&keys.left), parsed(&keys.right)],
        dimmers: [parsed(&keys.left_pwm), parsed(&keys.right_pwm)],
        hz: keys.pwm_hz,
        active_low: keys.active_low,
        alive: keys.alive.as_ref().map(|_| parsed(&keys.alive)),
        settle: ms(keys.settle_ms),
    }
}

fn ms(ms: f64) -> Duration {
    Duration::from_secs_f64(ms / 1e3)
}

fn named(device: &Option<String>) -> String {
    device.clone().expect("checked when the configuration was read")
}

fn parsed<T: FromStr>(name: &Option<String>) -> T {
    let parsed = name.as_deref().and_then(|n| n.parse().ok());
    parsed.expect("checked when the configuration was read")
}

/// The pictures in `folder`, in the order of their names.
fn stored(folder: &Path) -> Result<Vec<Image<u8>>, Error> {
    let failed = |call| move |source| Error::Call { device: "projector".into(), call, source };
    let entries = std::fs::read_dir(folder).map_err(failed("reading the folder projector.patterns"))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|e| e.path()).collect();
    files.retain(|f| f.extension().is_some_and(|e| e == "png"));
    files.sort();
    let read = |file: &PathBuf| -> Result<Image<u8>, Error> {
        let wrong = |e: String| failed("reading a stored picture")(io::Error::other(e));
        let png = read_png(file).map_err(|e| wrong(e.to_string()))?;
        let pixels: Result<Vec<u8>, _> = png.pixels.iter().map(|v| u8::try_from(*v)).collect();
        let pixels = pixels.map_err(|_| wrong(format!("{}: more than 8 bits", file.display())))?;
        Ok(Image { width: png.width, height: png.height, pixels })
    };
    files.iter().map(read).collect()
}
