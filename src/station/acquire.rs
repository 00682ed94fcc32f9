//! One try at one vehicle: light found, images taken, measured as they come.
//! In:  devices, a job, how bright it was the time before. Out: a measurement or a code, the images, how they were lit.
//! Every wait is bounded. Bars and projector are off when it ends, however it ends.
//! Not here: whether to try again; orders; what the PLC is told.
//!
//! Order of the images: red until its light is right; the left bar alone; none (each bar must answer); red once more where
//! the bars had to be balanced; an even grey until the fringes' exposure is right; none (the projector must follow); fringes,
//! while the regions are found in the red image; red once more where the panel about the features was too dark or too
//! bright after all; the first fringe image again.

use super::hardware::Hardware;
use super::jobs::Job;
use super::light::{self, Bars, Wrong};
use crate::capture::shoot::{FRINGE_LEVEL, RED_LEVEL, brighter, place, quartile};
use crate::capture::{Capture, Conditions, Described, Light, SETS, ShootError, Shooting, Shots, check_order};
use crate::code::Code;
use crate::fringe::Axis;
use crate::hal::{self, Buffer, Pool, Sensor};
use crate::image::Image;
use crate::measure::{Measurement, Measurer};
use std::cell::RefCell;
use std::ops::RangeInclusive;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

/// The usual sets, the finest first: its first image is the one that is repeated, and the finer a fringe the less a vehicle
/// must move until it shows.
pub(super) const SHOWN: [(Axis, u32, u32); 3] = [SETS[2], SETS[1], SETS[0]];
/// A try ends this long after its last image was due, whatever happens: a retried image, the lights' own time.
pub const LIMIT: Duration = Duration::from_millis(600);
/// An image that has not come this long after the longest exposure is missing, or so many of a camera's intervals.
const TIMEOUT: Duration = Duration::from_millis(150);
const INTERVALS: f64 = 4.0;
/// Images that may be asked for once more in one try.
const RETRIES: usize = 3;
/// The upper quartile is right within this share of what is aimed at.
const METERED: f64 = 0.15;
/// A fringe's brightest level, as a share of white, and from which factor on there is more room than is left unused.
const FRINGE_PEAK: f64 = 0.72;
const ROOM: f64 = 1.2;
/// The red light is right where the panel's level is within this, as a share of white.
const WINDOW: RangeInclusive<f64> = 0.22..=0.62;
/// Bars whose shares differ by no more are balanced.
const BALANCED: f64 = 0.06;
/// Light from outside, as a share of the red image's, from which on the bars are driven as high as they go.
const NOTICEABLE: f64 = 0.12;
/// How often orders are looked at while nothing but computing goes on.
const LOOK: Duration = Duration::from_millis(20);

/// What was right for the vehicle before: where the next one starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Start {
    /// Of red image and fringes, s of gain 1.
    pub(super) red: f64,
    pub(super) fringes: f64,
    pub(super) drive: [f64; 2],
}

/// How a second try differs from the first: factors on the levels aimed at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bracket {
    pub(super) red: f64,
    pub(super) fringes: f64,
}

impl Bracket {
    pub(super) const NONE: Self = Self { red: 1.0, fringes: 1.0 };
}

/// What does not change from one vehicle to the next.
pub(super) struct Settings {
    pub(super) longest: Duration,
    pub(super) ambient_limit: f64,
    /// See [`timeout`].
    pub(super) timeout: Duration,
    /// Of the camera and the projector, as far as known.
    pub(super) celsius: [Option<f64>; 2],
}

/// How long an image may take beside its exposure, from a camera of `rate` images per second.
pub(super) fn timeout(rate: f64) -> Duration {
    TIMEOUT.max(Duration::from_secs_f64(INTERVALS / rate))
}

/// What the acting thread must know between images.
pub(super) trait Watch {
    /// Called before each image: whether to go on.
    fn go_on(&mut self) -> bool;
    /// Called when the red image is there.
    fn lit(&mut self);
    /// Called when the last image is there and the lights are off.
    fn taken(&mut self);
    /// Called while computing goes on: whether to go on, and whether there is no time left to wait.
    fn wait_on(&mut self) -> bool;
}

/// Why nothing was measured.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Ended {
    /// A device or the light.
    Failed(Wrong),
    /// [`Watch::go_on`] said so.
    Stopped,
}

/// Images of one try, by what they were for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Budget {
    /// To find the red light, the red image itself among them.
    pub red: usize,
    /// To see each bar answer.
    pub bars: usize,
    /// To find the fringes' exposure, and to see the projector follow.
    pub projector: usize,
    /// Fringes and the repeated image.
    pub fringes: usize,
}

impl Budget {
    /// All of them.
    pub fn images(&self) -> usize {
        self.red + self.bars + self.projector + self.fringes
    }

    /// How long the reference hardware takes for them, at 30 images/s: exposures of up to 25 ms fit in between.
    pub fn at_30_per_s(&self) -> Duration {
        Duration::from_secs(self.images() as u64) / 30
    }
}

/// What a try came to.
pub(super) struct Attempt {
    pub(super) end: Result<Measurement, Ended>,
    /// As far as they were all taken.
    pub(super) images: Option<(Shots, Capture)>,
    pub(super) drive: [f64; 2],
    /// Mean grey of the ambient image in the regions, of 255.
    pub(super) ambient: Option<f64>,
    /// The red image's level on the panel, as a share of white.
    pub(super) level: Option<f64>,
    /// What was right this time.
    pub(super) start: Start,
    pub(super) budget: Budget,
    /// From the last image to the result, as computed.
    pub(super) computed: Duration,
}

/// One try. The pictures of [`SHOWN`] are loaded.
pub(super) fn attempt(
    hardware: &mut Hardware,
    pool: &Pool,
    job: &Job,
    settings: &Settings,
    start: Start,
    bracket: Bracket,
    watch: &mut dyn Watch,
) -> Attempt {
    let mut attempt = Attempt {
        end: Err(Ended::Stopped),
        images: None,
        drive: start.drive,
        ambient: None,
        level: None,
        start,
        budget: Budget::default(),
        computed: Duration::ZERO,
    };
    // a panic of ours or of a driver must not leave the lights on
    let ended = catch_unwind(AssertUnwindSafe(|| {
        let mut tried = Try { job, settings, bracket, attempt: &mut attempt };
        tried.run(hardware, pool, watch)
    }));
    let dark = hardware.dark();
    let ended = ended.unwrap_or_else(|panic| resume_unwind(panic));
    attempt.end = match (ended, dark) {
        (Ok(measurement), Ok(())) => Ok(measurement),
        (Ok(_), Err(code)) => Err(Ended::Failed(Wrong { code, detail: 0, said: "It does not go off.".into() })),
        (Err(ended), _) => Err(ended),
    };
    attempt
}

struct Try<'t> {
    job: &'t Job,
    settings: &'t Settings,
    bracket: Bracket,
    attempt: &'t mut Attempt,
}

impl From<ShootError> for Ended {
    fn from(e: ShootError) -> Self {
        let code = match &e {
            ShootError::Stopped => return Self::Stopped,
            ShootError::Camera(
                hal::Error::NoImage { .. } | hal::Error::HalfImage { .. } | hal::Error::Damaged { .. },
            ) => Code::ImageMissing,
            ShootError::Camera(_) => Code::CameraLost,
            ShootError::Projector(hal::Error::Pulses { .. }) | ShootError::Order(_) => Code::Synchronisation,
            ShootError::Projector(_) => Code::ProjectorSilent,
            ShootError::Lights(_) => Code::LightFault,
            ShootError::Sequence { before, found } if found > before => Code::ImageMissing,
            ShootError::Sequence { .. } => Code::Synchronisation,
        };
        Self::Failed(Wrong { code, detail: 0, said: e.to_string() })
    }
}

impl From<Wrong> for Ended {
    fn from(wrong: Wrong) -> Self {
        Self::Failed(wrong)
    }
}

/// To the thread that measures.
enum Feed {
    Fringe(usize, Arc<Buffer>),
    /// A better red image, with its ambient one: everything is summed up anew.
    Red([Arc<Buffer>; 2], Box<Capture>),
    /// The first fringe image, and it once more.
    Finish(Arc<Buffer>, Arc<Buffer>),
}

impl Try<'_> {
    fn run(&mut self, hardware: &mut Hardware, pool: &Pool, watch: &mut dyn Watch) -> Result<Measurement, Ended> {
        let n: usize = SHOWN.iter().map(|s| s.2 as usize).sum();
        let projector = hardware.projector.size();
        let watch = RefCell::new(watch);
        let mut go_on = || watch.borrow_mut().go_on();
        let mut devices = hardware.devices();
        let limits = (self.settings.longest, self.settings.timeout);
        let mut shooting = Shooting::new(&mut devices, pool, limits, RETRIES, &mut go_on);
        let s = &mut shooting;
        let sensor = s.sensor.clone();
        s.show(None)?;
        let level = RED_LEVEL * self.bracket.red;
        let red = self.red(s, level)?;
        watch.borrow_mut().lit();

        s.show(Some(n))?;
        let before = s.taken();
        let (tried, grey) = s.meter(FRINGE_LEVEL * self.bracket.fringes, self.attempt.start.fringes, METERED)?;
        s.show(None)?;
        let dark = s.grab()?;
        self.attempt.start.fringes = tried.strength();
        self.attempt.budget.projector = s.taken() - before;
        let followed = |pixels: &[usize]| {
            let Some([grey, dark]) = light::means([&grey, &dark], pixels.iter().copied(), &sensor) else {
                let said = "The body is saturated in the projector's grey.".into();
                return Err(Wrong { code: Code::Saturated, detail: 0, said });
            };
            let [off, lit] = light::means([&red.off, &red.both], pixels.iter().copied(), &sensor).unwrap_or([0.0; 2]);
            let by = tried.strength() / red.tried.strength();
            light::check_projector([grey, dark], off * by, (lit - off).max(0.0) * by)
        };
        let lit = body(&grey, &sensor);
        followed(&lit)?;
        // in a bright hall there is room above the even grey: a fringe's own light is all that counts
        let mut fringe_light = tried;
        let seen = light::means([&grey, &dark], lit.iter().copied(), &sensor);
        let more = seen.map_or(1.0, |[grey, dark]| FRINGE_PEAK * self.bracket.fringes / (2.0 * grey - dark));
        if more > ROOM {
            fringe_light = s.expose(tried.strength() * more)?;
        }

        let description = |light: Light| {
            let conditions = Conditions {
                bar_left: Some(red.drive[0]),
                bar_right: Some(red.drive[1]),
                camera_temperature_c: self.settings.celsius[0],
                projector_temperature_c: self.settings.celsius[1],
                job: Some(self.job.number),
                ..Conditions::default()
            };
            Described {
                sensor: &sensor,
                projector,
                sets: &SHOWN,
                repeat: true,
                red: light,
                fringes: fringe_light,
                conditions,
                taken_at: crate::time::moment(crate::time::unix_ms()),
            }
            .capture()
        };
        let (mut image, mut ambient, mut light) = (Arc::clone(&red.image), Arc::clone(&red.ambient), red.light);
        let mut capture = description(light);
        let attempt = &mut *self.attempt;
        let measurer = &self.job.measurer;
        std::thread::scope(|scope| {
            // made in here, so that leaving early ends the other thread
            let (feed, fed) = mpsc::channel();
            let (say, said) = mpsc::channel();
            let (finished, result) = mpsc::channel();
            let (first, first_capture) = ([&image, &ambient].map(Arc::clone), capture.clone());
            scope.spawn(move || {
                let measured = catch_unwind(AssertUnwindSafe(|| measure(measurer, first_capture, first, &fed, &say)));
                let _ = finished.send(measured.map_err(|panic| reason(&*panic)));
            });
            let fringes = s.fringes(n, &mut |k, shot| {
                let _ = feed.send(Feed::Fringe(k, Arc::clone(shot))); // where nobody takes it, the result says why
            })?;
            let shots: Vec<&Image<u16>> = fringes.iter().map(|f| -> &Image<u16> { f }).collect();
            let ordered = check_order(&SHOWN, &shots, &lit, &sensor, fringe_light.gain);
            let panel: Vec<usize> = said.recv().unwrap_or_default();
            attempt.budget.fringes = n + 1;
            if !panel.is_empty() {
                followed(&panel)?;
                let found = light::median(&image, &panel, &sensor).unwrap_or(0.0);
                attempt.level = Some(found);
                if !(WINDOW.start() * self.bracket.red..=WINDOW.end() * self.bracket.red.max(1.0)).contains(&found) {
                    s.show(None)?;
                    s.bars(red.drive)?;
                    light = s.expose(light.strength() * brighter(found, level))?;
                    image = s.grab()?;
                    watch.borrow_mut().lit();
                    s.bars([0.0; 2])?;
                    ambient = s.grab()?;
                    s.expose(fringe_light.strength())?;
                    attempt.budget.red += 2;
                    attempt.level = light::median(&image, &panel, &sensor);
                    attempt.start.red = light.strength();
                    capture = description(light);
                    let both = [&image, &ambient].map(Arc::clone);
                    let _ = feed.send(Feed::Red(both, Box::new(capture.clone())));
                }
                let off = light::means([&red.off], panel.iter().copied(), &sensor).map_or(0.0, |[off]| off.max(0.0));
                // as bright as it is in the red image
                attempt.ambient = Some(255.0 * off * light.strength() / red.tried.strength());
            }
            s.show(Some(0))?;
            let repeat = s.grab()?;
            s.show(None)?;
            let began = Instant::now();
            let _ = feed.send(Feed::Finish(Arc::clone(&fringes[0]), Arc::clone(&repeat)));
            attempt.images = Some((Shots { red: image, ambient, fringes, repeat: Some(repeat) }, capture));
            watch.borrow_mut().taken();
            let measured = loop {
                match result.recv_timeout(LOOK) {
                    Ok(measured) => break measured,
                    Err(RecvTimeoutError::Disconnected) => break Err("no result".into()),
                    Err(RecvTimeoutError::Timeout) if !watch.borrow_mut().wait_on() => return Err(Ended::Stopped),
                    Err(RecvTimeoutError::Timeout) => {}
                }
            };
            attempt.computed = began.elapsed();
            let failed = |said| Ended::Failed(Wrong { code: Code::Watchdog, detail: 0, said });
            let ended = || failed("Measuring ended without a result.".into());
            let measured = measured
                .map_err(|panic| failed(format!("Measuring failed: {panic}.")))
                .and_then(|m| m.ok_or_else(ended));
            // a vehicle that moved puts images off their sines, too, and that is what a person must be told
            match (measured, ordered) {
                (Ok(m), Err(said)) if m.code != Some(Code::Moved) => Err(ShootError::Order(said).into()),
                (measured, _) => measured,
            }
        })
    }

    /// The red image in its light, and what the bars say one by one.
    fn red(&mut self, s: &mut Shooting<'_, '_>, level: f64) -> Result<Red, Ended> {
        let sensor = s.sensor.clone();
        let start = self.attempt.start;
        let mut drive = s.bars(start.drive)?;
        let (mut tried, mut both) = s.meter(level, start.red, METERED)?;
        let most = drive[0].max(drive[1]);
        if tried.gain > 1.0 && most < 1.0 {
            // more light rather than more gain
            let by = tried.gain.min(1.0 / most);
            drive = s.bars(drive.map(|d| (d * by).min(1.0)))?;
            (tried, both) = s.meter(level, tried.strength() / by, METERED)?;
        }
        self.attempt.budget.red = s.taken();
        s.bars([drive[0], 0.0])?;
        let left = s.grab()?;
        s.bars([0.0; 2])?;
        let off = s.grab()?;
        self.attempt.budget.bars = 2;
        let Some(seen) = light::means([&both, &left, &off], body(&both, &sensor).into_iter(), &sensor) else {
            let said = "The body is saturated in the shortest exposure.".into();
            return Err(Wrong { code: Code::Ambient, detail: 0, said }.into());
        };
        let mut bars = Bars::new(seen);
        bars.check(f64::INFINITY)?;
        let mut wanted = drive;
        if (bars.left - 0.5).abs() > BALANCED {
            wanted = bars.balanced(drive);
        }
        if bars.ambient_share() > NOTICEABLE {
            let most = wanted[0].max(wanted[1]);
            wanted = wanted.map(|d| d / most);
        }
        let (mut light, mut image, mut ambient) = (tried, Arc::clone(&both), Arc::clone(&off));
        let changed = (0..2).any(|k| (wanted[k] - drive[k]).abs() > 0.02);
        if changed {
            let taken = s.bars(wanted)?;
            // light adds up, so what it will be is known
            let on = [bars.left / drive[0] * taken[0], (1.0 - bars.left) / drive[1] * taken[1]].map(|l| l * bars.both);
            let sum = on[0] + on[1];
            light = s.expose(tried.strength() * (bars.both + bars.ambient) / (sum + bars.ambient))?;
            image = s.grab()?;
            s.bars([0.0; 2])?;
            ambient = s.grab()?;
            self.attempt.budget.red += 2;
            bars = Bars { both: sum, left: on[0] / sum, ambient: bars.ambient };
            drive = taken;
        }
        self.attempt.ambient = Some(255.0 * bars.ambient.max(0.0) * light.strength() / tried.strength());
        bars.check(self.settings.ambient_limit)?;
        self.attempt.drive = drive;
        self.attempt.start.drive = drive.map(|d| d.max(0.05));
        self.attempt.start.red = light.strength();
        Ok(Red { image, ambient, light, tried, both, off, drive })
    }
}

/// The red image and how it came about.
struct Red {
    image: Arc<Buffer>,
    /// Everything off, exposed as `image`.
    ambient: Arc<Buffer>,
    light: Light,
    /// The light of the next two.
    tried: Light,
    both: Arc<Buffer>,
    off: Arc<Buffer>,
    drive: [f64; 2],
}

/// Pixels of what is bright in an image: the body, before anything of it is found.
fn body(image: &Image<u16>, sensor: &Sensor) -> Vec<usize> {
    let white = f64::from(sensor.white_level) - sensor.black_level;
    let least = sensor.black_level + 0.5 * quartile(image, sensor) * white;
    (0..image.pixels.len()).step_by(37).filter(|at| f64::from(image.pixels[*at]) > least).collect()
}

/// Measures as images come. Tells once where the panel about the features is seen. `None`: no more images came.
fn measure(
    measurer: &Measurer,
    mut capture: Capture,
    mut red: [Arc<Buffer>; 2],
    fed: &Receiver<Feed>,
    say: &Sender<Vec<usize>>,
) -> Option<Measurement> {
    let mut fringes: Vec<(usize, Arc<Buffer>)> = Vec::new();
    loop {
        let mut cycle = measurer.begin(&capture, &red[0], Some(&red[1]));
        let _ = say.send(cycle.panel_pixels().into_iter().flatten().collect());
        let add = |cycle: &mut crate::measure::Cycle<'_>, k: usize, image: &Image<u16>| {
            let (set, step) = place(&SHOWN, k);
            cycle.add_fringe(set, step, image).expect("the capture's sets are those that are shown");
        };
        fringes.iter().for_each(|(k, image)| add(&mut cycle, *k, image));
        let next = loop {
            match fed.recv().ok()? {
                Feed::Fringe(k, image) => {
                    add(&mut cycle, k, &image);
                    fringes.push((k, image));
                }
                Feed::Red(image, capture) => break (image, *capture),
                Feed::Finish(first, repeat) => {
                    cycle.add_repeat(&first, &repeat);
                    return Some(cycle.finish(&mut |_| ()).0);
                }
            }
        };
        drop(cycle); // it borrows the description that is replaced
        (red, capture) = next;
    }
}

/// What a panic said.
fn reason(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
    text.unwrap_or("no reason given").to_owned()
}
