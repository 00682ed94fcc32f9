//! What is wrong with a station's devices. In: a configuration, its devices. Out: findings, each with what to do.
//! Lights are used briefly, each device alone and then with the camera; all is dark afterwards.
//! Not here: how findings are shown; anything that `datum check` already refuses.

use super::config::{CameraTrigger, ProjectorKind, StationFile};
use super::devices;
use super::hardware::{Hardware, Temperatures};
use super::light::means;
use super::selftest;
use super::simulated::{Simulated, Traffic, World};
use crate::calibrate::Calibration;
use crate::hal::linux::{MonotonicClock, Stream};
use crate::hal::{Clock, Error, Pool, Sensor};
use crate::image::Image;
use crate::records::{Captures, Space, space};
use std::error::Error as _;
use std::io::ErrorKind;
use std::path::Path;
use std::time::Duration;

/// How well it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Health {
    /// As it should be.
    Good,
    /// Nobody can say, or it could be better.
    Doubtful,
    /// The station cannot work with it.
    Bad,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Finding {
    /// What was looked at.
    pub about: &'static str,
    /// How it is.
    pub health: Health,
    /// What was found.
    pub said: String,
    /// What to do; empty where there is nothing to do.
    pub hint: String,
}

fn good(about: &'static str, said: impl Into<String>) -> Finding {
    Finding { about, health: Health::Good, said: said.into(), hint: String::new() }
}

fn doubtful(about: &'static str, said: impl Into<String>, hint: &str) -> Finding {
    Finding { about, health: Health::Doubtful, said: said.into(), hint: hint.into() }
}

fn bad(about: &'static str, said: impl Into<String>, hint: impl Into<String>) -> Finding {
    Finding { about, health: Health::Bad, said: said.into(), hint: hint.into() }
}

/// 2026-01-01: no station is older.
const EARLIEST_MS: u64 = 1_767_225_600_000;
const CAMERA: &str = "camera";
const STORAGE: &str = "storage";
/// With less room than this the journal is soon not written any more, bytes.
const FULL: u64 = 64 << 20;
/// Images over which the stream is watched, and for how long at most.
const IMAGES: usize = 30;
const WATCHED: Duration = Duration::from_secs(3);
/// Tried from the longest on, until not everything is saturated.
const EXPOSURES: [Duration; 4] =
    [Duration::from_millis(20), Duration::from_millis(5), Duration::from_millis(1), Duration::from_micros(200)];
const TIMEOUT: Duration = Duration::from_secs(1);
/// An answer: so much brighter in the mean, as a share of white.
const ANSWER: f64 = 0.004;
/// Light of both bars from which on a body stands there, and below which none does.
const BODY: (f64, f64) = (0.05, 0.01);
/// A bar's light reaches further into its own side of the image than the other's by this share of it, or nobody can tell.
const SIDES: f64 = 0.01;
/// What half a drive makes of a bar's light.
const HALF: std::ops::RangeInclusive<f64> = 0.35..=0.65;
/// Flashes of the projector.
const FLASHES: usize = 5;
/// Lit, or dark: so much of the way from one to the other.
const LIT: f64 = 0.9;

/// Looks at everything that `config` names, and tells of each thing as it is found.
pub fn examine(config: &StationFile, tell: &mut dyn FnMut(Finding)) {
    tell(clock(crate::time::unix_ms()));
    tell(storage(config));
    if config.is_simulated() {
        let simulated = Simulated::new(config.simulation.scale, config.simulation.seed);
        Traffic::new(&simulated.station, config.simulation.seed).bring(1);
        let mut hardware = simulated.hardware();
        return with_light(&mut hardware, &*simulated.clock(), config, tell);
    }
    tell(calibration(config));
    let mut found = |about: &'static str, error: &Error| tell(wrong(about, error));
    let camera = devices::camera(config).map_err(|e| found(CAMERA, &e)).ok();
    // its light's own time is what is to be measured
    let mut quick = config.clone();
    quick.projector.settle_ms = 0.0;
    let projector = devices::projector(&quick).map_err(|e| found("projector", &e)).ok();
    let bars = devices::bars(config).map_err(|e| found("light bars", &e)).ok();
    let presence = devices::presence(config).map_err(|e| found("presence sensor", &e)).ok();
    if bars.is_some() {
        tell(good("light bars", "lines and channels are there"));
    }
    let camera = camera.and_then(|mut camera| {
        let stream = camera.watch(IMAGES, WATCHED);
        let finding = match &stream {
            Ok(stream) => judge_stream(stream, config),
            Err(e) => wrong(CAMERA, e),
        };
        let usable = stream.is_ok_and(|s| s.came > 0);
        tell(finding);
        usable.then_some(camera)
    });
    let projector = projector.and_then(|mut projector| match projector.check() {
        Ok(()) => {
            tell(good(
                "projector",
                if config.projector.kind == ProjectorKind::Sequenced {
                    "its lines are there"
                } else {
                    "its node is there"
                },
            ));
            Some(projector)
        }
        Err(e) => {
            tell(wrong("projector", &e));
            None
        }
    });
    warmth(&devices::temperatures(config), tell);
    let (Some(camera), Some(bars)) = (camera, bars) else {
        tell(doubtful("light", "not tested: camera and bars are needed for it", "Put right what is wrong above."));
        return;
    };
    let mut hardware = Hardware {
        camera,
        projector: projector.unwrap_or_else(|| Box::new(NoProjector)),
        bars: Box::new(bars),
        presence: presence.flatten().map(|p| Box::new(p) as _),
        temperatures: Temperatures::default(),
        simulated: false,
    };
    with_light(&mut hardware, &MonotonicClock, config, tell);
}

/// Stands in for a projector that is not there: it shows nothing, and says so when it is to show something.
struct NoProjector;

impl crate::hal::Projector for NoProjector {
    fn size(&self) -> (usize, usize) {
        (128, 16)
    }
    fn load(&mut self, _: &[Image<u8>]) -> Result<(), Error> {
        self.check()
    }
    fn show(&mut self, picture: Option<usize>) -> Result<(), Error> {
        picture.map_or(Ok(()), |_| self.check())
    }
    fn check(&mut self) -> Result<(), Error> {
        Err(Error::Gone { device: "projector".into() })
    }
}

fn clock(unix_ms: u64) -> Finding {
    let now = crate::time::moment(unix_ms);
    if unix_ms < EARLIEST_MS {
        let hint = "Set the clock, or let it be set: `timedatectl set-ntp true`; check the battery of the clock chip.";
        return bad("clock", format!("it is set to {now}, which is long past"), hint);
    }
    good("clock", now)
}

fn storage(config: &StationFile) -> Finding {
    let folder = config.beside(&config.records.folder);
    match space(&folder) {
        Ok(s) => judge_storage(&folder, s, config.records.captures_mib > 0),
        Err(e) => {
            let hint = "Check records.folder and that its disk is mounted.";
            bad(STORAGE, format!("{}: {e}", folder.display()), hint)
        }
    }
}

/// Full is what the service calls so (901): a large disk is not, because little of it is free.
fn judge_storage(folder: &Path, s: Space, captures: bool) -> Finding {
    let said = format!("{}: {} MiB free of {}", folder.display(), s.free >> 20, s.of >> 20);
    if s.free < if captures { Captures::FLOOR } else { FULL } {
        let hint = "The disk is full: export and delete old records, or make [records] smaller than the disk.";
        return bad(STORAGE, said, hint);
    }
    good(STORAGE, said)
}

/// Whether there is one, of images and pictures of these sizes.
fn calibration(config: &StationFile) -> Finding {
    const ABOUT: &str = "calibration";
    let Some(file) = &config.calibration else {
        return doubtful(
            ABOUT,
            "there is none yet",
            "Record boards by `datum capture --rows`, then `datum calibrate projector`.",
        );
    };
    let (camera, projector) = (&config.camera, &config.projector);
    let sizes = ((camera.width, camera.height), (projector.width, projector.height));
    match Calibration::read(&config.beside(file)) {
        Err(e) => bad(ABOUT, e.to_string(), "Restore the file, or calibrate anew."),
        Ok(read) => match devices::fits(&read, sizes.0, sizes.1) {
            Err(said) => bad(ABOUT, said, "The size is wrong: set the one that was calibrated, or calibrate anew."),
            Ok(()) => good(ABOUT, read.id.unwrap_or_else(|| "its sizes are those of camera and projector".into())),
        },
    }
}

fn warmth(temperatures: &Temperatures, tell: &mut dyn FnMut(Finding)) {
    for ((about, thermometer), most) in [
        ("temperature of the computer", &temperatures.computer),
        ("temperature of the camera", &temperatures.camera),
        ("temperature of the projector", &temperatures.projector),
    ]
    .into_iter()
    .zip(temperatures.most)
    {
        match thermometer.as_ref().map(|t| t.read()) {
            None => {}
            Some(Ok(celsius)) if celsius > most => {
                let hint = "It is too hot, so nothing is measured (211): check fans and filters, let it cool.";
                tell(bad(about, format!("{celsius:.1} °C, allowed {most:.0} °C"), hint));
            }
            Some(Ok(celsius)) => tell(good(about, format!("{celsius:.1} °C"))),
            Some(Err(e)) => tell(wrong(about, &e)),
        }
    }
}

const WRONG_NODE: &str = "This is the wrong node, of another device or another use: check the key `device`.";
/// ENOTTY, <asm-generic/errno-base.h>.
const NO_SUCH_IOCTL: i32 = 25;

/// What an error means, and what to do.
fn wrong(about: &'static str, error: &Error) -> Finding {
    let cause = error.source().map_or_else(String::new, |c| format!(": {c}"));
    let is = |kind| error.os().is_some_and(|e| e.kind() == kind);
    let hint = match error {
        Error::Call { .. } if is(ErrorKind::PermissionDenied) => {
            "No permission: run it as the service's user, or put this user into the groups `video` and `gpio`."
        }
        Error::Call { .. } if is(ErrorKind::NotFound) => {
            "There is no such node: check cable and power, and the key `device` (`v4l2-ctl --list-devices` lists all nodes)."
        }
        Error::Call { .. } if is(ErrorKind::ResourceBusy) => {
            "Another program uses it: end that first (the service: `systemctl stop datum`)."
        }
        Error::Held { .. } => "Another program uses it: end that first (the service: `systemctl stop datum`).",
        Error::Gone { .. } => "It does not answer: check cable and power.",
        Error::Absent { what: "PWM chip of device" | "PWM channel", .. } => {
            "The PWM is absent: check lights.left_pwm and right_pwm, and that the device tree enables the PWM."
        }
        Error::Absent { what: "GPIO chip" | "GPIO line", .. } => {
            "Check the key that names the line (`gpioinfo` lists all)."
        }
        Error::Absent { what: "stored picture", .. } => {
            "Write the pictures by `datum patterns --stored`, and into the projector by its maker's tool."
        }
        Error::Absent { what: "V4L2 node", .. } => {
            "Check cable and power, and the key `device`: there are those named."
        }
        Error::Absent { what: "libcamera camera", .. } => {
            "Check cable and power, camera.device and the device tree: libcamera knows those named (`cam -l`)."
        }
        Error::Absent { what: "control", .. } => "Check camera.controls: the camera has those named.",
        Error::Absent { .. } => "Check the key: there are those named.",
        Error::NotOffered { what: "the use", .. } => WRONG_NODE,
        Error::Call { source, .. } if source.raw_os_error() == Some(NO_SUCH_IOCTL) => WRONG_NODE,
        Error::NotOffered { what: "the format", .. } if about == CAMERA => {
            "Set camera.format to one that the camera offers (libcamera's R8 is GREY, its R10 is Y10)."
        }
        Error::NotOffered { what: "the format", .. } => "It takes no grey pictures: another node, or another device.",
        Error::NotOffered { .. } => "Set the key to one of those that it offers.",
        Error::Size { .. } => "Set width and height to a size that the device offers, and calibrate with that.",
        Error::NoImage { .. } => "It is there but sends no images: check its trigger and its cable.",
        Error::Pulses { found: 0, .. } => {
            "It does not tell that it shows pictures: check its power, advance and trigger-out."
        }
        Error::Pulses { .. } => "It shows more pictures than asked for: check its mode, and the lines for noise.",
        _ => "Check cable and power.",
    };
    bad(about, format!("{error}{cause}"), hint)
}

fn judge_stream(stream: &Stream, config: &StationFile) -> Finding {
    const ABOUT: &str = CAMERA;
    let Stream { rate, came, lost, doubled, damaged, .. } = *stream;
    let mut said = format!("{came} images, {rate:.1}/s, {lost} lost, {doubled} doubled, {damaged} damaged");
    if came == 0 {
        return bad(ABOUT, said, "It is there but sends no images: check its trigger and its cable.");
    }
    if lost + doubled + damaged > 0 {
        let hint = "Images do not come whole: check the cable, use a port of its own, lower camera.rate.";
        return bad(ABOUT, said, hint);
    }
    if !stream.stamped_at_begin {
        said += ", stamped when complete";
    }
    if config.camera.trigger == CameraTrigger::Free && rate < 0.8 * config.camera.rate {
        let hint = "Slower than camera.rate: a vehicle takes longer. Check the port's speed and the longest exposure.";
        return doubtful(ABOUT, said, hint);
    }
    if !stream.exposure || !stream.gain {
        let missing = if stream.exposure { "gain" } else { "exposure" };
        let hint = "Light can be matched by the bars only.";
        return doubtful(ABOUT, format!("{said}; there is no control for {missing}"), hint);
    }
    good(ABOUT, said)
}

/// What bars, projector and presence sensor do to the camera's images.
fn with_light(hardware: &mut Hardware, clock: &dyn Clock, config: &StationFile, tell: &mut dyn FnMut(Finding)) {
    let lit = answers(hardware, tell);
    let _ = hardware.dark();
    let lit = match lit {
        Ok(lit) => lit,
        Err(e) => return tell(wrong("light", &e)),
    };
    if let Some(light) = lit
        && let Some(presence) = hardware.presence.as_mut()
    {
        tell(match presence.wait(true, Duration::ZERO) {
            Ok(reading) => judge_presence(reading.present, light),
            Err(e) => wrong("presence sensor", &e),
        });
    } else if hardware.presence.is_none() {
        tell(doubtful("presence sensor", "there is none", "A trigger without a vehicle is not refused (116)."));
    }
    let found = flashes(hardware, clock, config);
    let _ = hardware.dark();
    tell(found.unwrap_or_else(|e| wrong("projector's light", &e)));
}

/// The bars' answers. How bright both are together; `None`: nobody can say.
fn answers(hardware: &mut Hardware, tell: &mut dyn FnMut(Finding)) -> Result<Option<f64>, Error> {
    const ABOUT: &str = "light of the bars";
    let sensor = hardware.camera.sensor().clone();
    let pool = Pool::new(&sensor, 6);
    let mut images: [_; 6] = std::array::from_fn(|_| pool.take().expect("six"));
    hardware.projector.show(None)?;
    hardware.camera.set_gain(1.0)?;
    for exposure in EXPOSURES {
        hardware.camera.set_exposure(exposure)?;
        let drives = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.5, 0.0], [0.0, 0.5], [0.0, 0.0]];
        for (drive, image) in drives.into_iter().zip(&mut images) {
            hardware.bars.set(drive)?;
            hardware.camera.grab(TIMEOUT, image)?;
        }
        let seen = images.each_ref().map(|i| -> &Image<u16> { i });
        let columns = |from: usize, to: usize| {
            let all = (0..seen[0].pixels.len()).step_by(37);
            let width = sensor.width;
            means(seen, all.filter(move |at| (from..to).contains(&(at % width))), &sensor)
        };
        let middle = sensor.width / 2;
        let (Some(all), Some(left), Some(right)) =
            (columns(0, sensor.width), columns(0, middle), columns(middle, sensor.width))
        else {
            continue; // all of it is saturated
        };
        let rest = |m: &[f64; 6]| 0.5 * (m[0] + m[5]);
        let on = |m: &[f64; 6], k: usize| m[k] - rest(m);
        let least = ANSWER.max(3.0 * (all[5] - all[0]).abs());
        let mut answered = true;
        for (bar, name) in [(1, "left"), (2, "right")] {
            let light = on(&all, bar);
            if light < least {
                answered = false;
                let said = format!("the {name} bar adds {:.1} % of white", 100.0 * light);
                let hint = "It stays dark, or nothing stands there to be lit: put a vehicle or a board there; check the \
                            bar's supply, lines and channels.";
                tell(bad(ABOUT, said, hint));
                continue;
            }
            let half = on(&all, bar + 2) / light;
            if !HALF.contains(&half) {
                answered = false;
                let said = format!("the {name} bar gives {:.0} % of its light at half its drive", 100.0 * half);
                tell(bad(
                    ABOUT,
                    said,
                    "It is not dimmed as it is driven: check its PWM channel and its supply's input.",
                ));
            }
        }
        if answered {
            let share = |bar: usize| on(&left, bar) / (on(&left, bar) + on(&right, bar));
            tell(judge_sides([share(1), share(2)], [on(&all, 1), on(&all, 2)]));
        }
        return Ok(Some(on(&all, 1) + on(&all, 2)));
    }
    tell(bad(
        ABOUT,
        "everything is saturated in the shortest exposure",
        "Shade the station; check the camera's exposure.",
    ));
    Ok(None)
}

/// `shares`: of the left and of the right bar's light, what falls into the image's left half.
fn judge_sides(shares: [f64; 2], light: [f64; 2]) -> Finding {
    const ABOUT: &str = "light of the bars";
    let [left, right] = light.map(|l| 100.0 * l);
    let said = format!("left {left:.1} %, right {right:.1} % of white");
    let leans = shares[0] - shares[1];
    if leans < -SIDES {
        let said = format!("{said}; the left bar lights the right side more");
        return bad(ABOUT, said, "The bars are swapped: exchange lights.left with right, and left_pwm with right_pwm.");
    }
    if leans < SIDES {
        let hint = "Nobody can tell which bar is which: put a vehicle or a flat board there.";
        return doubtful(ABOUT, format!("{said}; both light the same side"), hint);
    }
    good(ABOUT, said)
}

fn judge_presence(present: bool, light: f64) -> Finding {
    const ABOUT: &str = "presence sensor";
    let lit = format!("the bars light {:.1} % of white", 100.0 * light);
    let hint = "It is inverted (presence.active_low), or looks elsewhere than the camera.";
    match (present, light) {
        (false, l) if l > BODY.0 => bad(ABOUT, format!("it says that nothing stands there, but {lit}"), hint),
        (true, l) if l < BODY.1 => bad(ABOUT, format!("it says that a vehicle stands there, but {lit}"), hint),
        (true, _) => good(ABOUT, "a vehicle stands there"),
        (false, _) => good(ABOUT, "nothing stands there"),
    }
}

/// The mean of an image above black, as a share of white; `None` where some of it is saturated: of two images whose means
/// leave out what is saturated, each its own, the darker one may be the one that had more light.
fn level(image: &Image<u16>, sensor: &Sensor) -> Option<f64> {
    let all = || (0..image.pixels.len()).step_by(37);
    let saturated = all().filter(|at| image.pixels[*at] >= sensor.white_level).count();
    let [mean] = means([image], all(), sensor)?;
    (100 * saturated <= all().count()).then_some(mean)
}

/// Flashes grey and black: whether the camera sees it, and how long after it was shown.
fn flashes(hardware: &mut Hardware, clock: &dyn Clock, config: &StationFile) -> Result<Finding, Error> {
    const ABOUT: &str = "projector's light";
    let sensor = hardware.camera.sensor().clone();
    let mut image = Image::filled(sensor.width, sensor.height, 0);
    let (width, height) = hardware.projector.size();
    let pictures = selftest::cycle_pictures(width, height);
    let grey = pictures.len() - 1;
    hardware.projector.load(&pictures)?;
    let grab = |hardware: &mut Hardware, image: &mut Image<u16>| -> Result<(Option<f64>, Duration), Error> {
        let exposure = hardware.camera.grab(TIMEOUT, image)?;
        Ok((level(image, &sensor), exposure.begun_at))
    };
    for exposure in EXPOSURES {
        hardware.camera.set_exposure(exposure)?;
        let mut steady = [0.0; 2];
        let mut saturated = false;
        for (picture, steady) in [None, Some(grey)].into_iter().zip(&mut steady) {
            hardware.projector.show(picture)?;
            let mut last = None;
            for _ in 0..4 {
                last = grab(hardware, &mut image)?.0;
            }
            saturated |= last.is_none();
            *steady = last.unwrap_or(1.0);
        }
        if saturated {
            continue;
        }
        let [dark, lit] = steady;
        let adds = format!("grey adds {:.1} % of white", 100.0 * (lit - dark));
        if lit - dark < ANSWER {
            let hint =
                "No light of the projector is seen: check its lamp, its lens cap, its input and what it is pointed at.";
            return Ok(bad(ABOUT, adds, hint));
        }
        let follows = |level: f64, lights: bool| {
            let way = (level - dark) / (lit - dark);
            if lights { way >= LIT } else { way <= 1.0 - LIT }
        };
        // the latest image that did not show yet what was shown, and the earliest that did
        let (mut not_yet, mut by) = (Duration::ZERO, Duration::ZERO);
        for flash in 0..2 * FLASHES {
            let lights = flash % 2 == 0;
            hardware.projector.show(if lights { Some(grey) } else { None })?;
            let shown = clock.now();
            for _ in 0..20 {
                let (found, begun_at) = grab(hardware, &mut image)?;
                let after = begun_at.saturating_sub(shown);
                if follows(found.unwrap_or(1.0), lights) {
                    by = by.max(after);
                    break;
                }
                not_yet = not_yet.max(after + Duration::from_nanos(1));
            }
        }
        let ms = |d: Duration| 1e3 * d.as_secs_f64();
        let said = format!("{adds}; seen {:.1} ms after it is shown at the latest", ms(by));
        if ms(not_yet) > config.projector.settle_ms {
            let said = format!("{said}, not yet after {:.1} ms", ms(not_yet));
            let hint = format!("Set projector.settle_ms to {:.0}.", ms(by).ceil());
            return Ok(bad(ABOUT, said, hint));
        }
        return Ok(good(ABOUT, said));
    }
    Ok(bad(
        ABOUT,
        "everything is saturated in the shortest exposure",
        "Shade the station; check the camera's exposure.",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hal::LightBars;
    use crate::sim;

    fn told(config: &StationFile, change: impl FnOnce(&Simulated, &mut Hardware), vehicle: bool) -> Vec<Finding> {
        let simulated = Simulated::new(0.25, 1);
        if vehicle {
            Traffic::new(&simulated.station, 1).bring(1);
        }
        let mut hardware = simulated.hardware();
        change(&simulated, &mut hardware);
        let mut told = Vec::new();
        with_light(&mut hardware, &*simulated.clock(), config, &mut |f| told.push(f));
        told
    }

    fn worst(found: &[Finding]) -> Option<&Finding> {
        found.iter().max_by_key(|f| f.health).filter(|f| f.health != Health::Good)
    }

    #[test]
    fn a_sound_station_is_well() {
        let found = told(&StationFile::default(), |_, _| (), true);
        assert_eq!(worst(&found), None, "{found:?}");
        assert_eq!(found.len(), 3, "{found:?}");
    }

    /// Bars whose cables were exchanged.
    struct Swapped(sim::Bars);

    impl LightBars for Swapped {
        fn set(&mut self, [left, right]: [f64; 2]) -> Result<[f64; 2], Error> {
            self.0.set([right, left]).map(|[r, l]| [l, r])
        }
    }

    #[test]
    fn swapped_bars_are_named() {
        let swap = |s: &Simulated, h: &mut Hardware| h.bars = Box::new(Swapped(s.station.bars()));
        let found = told(&StationFile::default(), swap, true);
        let worst = worst(&found).expect("one");
        assert!(worst.health == Health::Bad && worst.hint.starts_with("The bars are swapped"), "{found:?}");
    }

    #[test]
    fn an_inverted_presence_sensor_is_named_with_and_without_a_vehicle() {
        assert_eq!(judge_presence(true, 0.4).health, Health::Good);
        assert_eq!(judge_presence(false, 0.001).health, Health::Good);
        for (present, light) in [(false, 0.4), (true, 0.001)] {
            let found = judge_presence(present, light);
            assert!(found.health == Health::Bad && found.hint.starts_with("It is inverted"), "{found:?}");
        }
    }

    #[test]
    fn a_disk_is_full_where_the_service_calls_it_full() {
        let health = |mib: u64, captures| {
            judge_storage(Path::new("records"), Space { free: mib << 20, of: 256 << 30 }, captures).health
        };
        assert_eq!([health(4163, true), health(511, true)], [Health::Good, Health::Bad]);
        assert_eq!([health(511, false), health(63, false)], [Health::Good, Health::Bad]);
    }

    #[test]
    fn a_dark_projector_and_a_dead_bar_are_named() {
        use sim::{Cue, Fault, Script, When};
        for (fault, about, says) in [
            (Fault::ProjectorSilent, "projector's light", "No light of the projector"),
            (Fault::BarDead(0), "light of the bars", "It stays dark"),
            (Fault::BarStuck(1, 0.8), "light of the bars", "It stays dark"),
        ] {
            let plant = |s: &Simulated, _: &mut Hardware| {
                s.station.set_script(Script(vec![Cue { when: When::Always, fault: fault.clone() }]));
            };
            let found = told(&StationFile::default(), plant, true);
            let named = found.iter().any(|f| f.health == Health::Bad && f.about == about && f.hint.starts_with(says));
            assert!(named, "{fault:?}: {found:?}");
        }
    }

    /// A near white panel on a dark wall: in the longest exposure the grey saturates the panel, and the wall hardly changes.
    #[test]
    fn an_image_that_is_partly_saturated_has_no_level() {
        let sensor = Simulated::new(0.25, 1).hardware().camera.sensor().clone();
        let mut image = Image::filled(sensor.width, sensor.height, 40);
        let dark = level(&image, &sensor).expect("nothing is saturated");
        assert!((dark - 38.0 / 253.0).abs() < 1e-9, "{dark}");
        let half = image.pixels.len() / 2;
        image.pixels[..half].fill(sensor.white_level);
        assert_eq!(level(&image, &sensor), None);
        image.pixels.fill(40);
        image.pixels[..37].fill(sensor.white_level); // a glint
        assert!(level(&image, &sensor).is_some());
    }

    #[test]
    fn a_clock_of_1970_is_named() {
        assert_eq!(clock(EARLIEST_MS).health, Health::Good);
        let found = clock(0);
        assert!(found.health == Health::Bad && found.said.contains("1970-01-01"), "{found:?}");
    }

    #[test]
    fn errors_of_devices_come_with_what_to_do() {
        let device = || "camera".to_owned();
        let call = |kind: ErrorKind| Error::Call { device: device(), call: "open", source: kind.into() };
        let absent = |what| Error::Absent { device: device(), what, wanted: "x".into(), there: vec![] };
        let offered =
            |what| Error::NotOffered { device: device(), what, wanted: "x".into(), offered: vec!["GREY".into()] };
        let found = wrong("projector", &offered("the format"));
        assert!(found.hint.starts_with("It takes no grey pictures"), "{found:?}");
        for (error, says) in [
            (call(ErrorKind::PermissionDenied), "No permission"),
            (call(ErrorKind::NotFound), "There is no such node"),
            (absent("PWM chip of device"), "The PWM is absent"),
            (offered("the use"), "This is the wrong node"),
            (offered("the format"), "Set camera.format"),
            (absent("libcamera camera"), "Check cable and power, camera.device"),
            (Error::Size { device: device(), what: "image", found: (1, 2), allowed: (3, 4) }, "Set width and height"),
        ] {
            let found = wrong("camera", &error);
            assert!(found.hint.starts_with(says) && found.health == Health::Bad, "{found:?}");
        }
    }
}
