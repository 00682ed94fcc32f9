//! The thread that acts: takes orders, sees vehicles come, measures, tells.
//! In:  devices, jobs, orders. Out: reports for the PLC, what was measured for records and people.
//! `plan` decides; here it is done. Not here: how a try at a vehicle goes (`acquire`).

use super::acquire::{self, Attempt, Bracket, Budget, Ended, Settings, Start, Watch};
use super::config::{StationFile, TriggerKind};
use super::counters::Durations;
use super::hardware::Hardware;
use super::hours::Hours;
use super::jobs::{Entry, Job, Jobs};
use super::light::Wrong;
use super::outcome;
use super::plan::{Action, ByItself, Cause, Event, State, plan, while_busy};
use super::simulated::World;
use super::{selftest, verify};
use crate::calibrate::Calibration;
use crate::capture::{RecordError, Shots, write};
use crate::code::Code;
use crate::geometry::{Pose, frame};
use crate::hal::{Clock, Pool, Reading};
use crate::measure::Measurement;
use crate::plc::{
    Counters, Order, OrderKind, Outcome, Pulse, Report, ResultCode, State as Mode, Status, Trigger, Verification,
};
use std::collections::{HashMap, VecDeque};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How often the station looks about when nobody asks for anything; it is seen alive at least so often.
const TICK: Duration = Duration::from_millis(100);
/// Between two tries of devices that do not work.
const RETRY: Duration = Duration::from_secs(1);
/// The status is told so often, changed or not.
const STATUS: Duration = Duration::from_secs(1);
/// Whether camera and projector are still there is asked so often while nothing goes on, and how warm it is.
const CHECK: Duration = Duration::from_secs(1);
/// Hours of light are kept so often: no more are lost when the power goes.
const KEEP_HOURS: Duration = Duration::from_secs(600);
/// Images of one capture, those of its light among them.
const POOL: usize = 26;
/// Where the first vehicle's light is looked for, s of gain 1.
const START: f64 = 4e-3;

/// How time passes on a simulated station while nothing goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pace {
    /// As on the wall.
    Wall,
    /// At once: for tests.
    Free,
}

/// Writes a capture's images into a folder.
pub type WriteImages = Box<dyn FnOnce(&Path) -> Result<(), RecordError> + Send>;

/// Where results and images are kept. What goes wrong with it never stops measuring.
pub trait Store: Send {
    /// Whether the images of such a result are to be kept.
    fn keeps(&self, outcome: &Outcome) -> bool;
    /// Keeps a result of `job`, whose images will be kept or not; its key. Comes back when it is safe.
    fn append(&mut self, finished: &Finished, job: &Job, images: bool) -> Result<u64, Code>;
    /// Keeps the images of the result `key`, which `job` measured; comes back at once.
    fn keep(&mut self, key: u64, job: &Job, images: WriteImages) -> Result<(), Code>;
    /// Keeps that something went wrong, or was put right; what cannot be kept is told with the next result.
    fn note(&mut self, note: Note);
    /// Share of the storage that is free, 0 to 1.
    fn free(&self) -> Option<f64>;
    /// Keeps how long the bars have been lit, hours.
    fn keep_hours(&mut self, hours: [f64; 2]);
}

/// What else is kept.
#[derive(Clone, Debug, PartialEq)]
pub enum Note {
    /// An error that latched.
    Alarm(Code),
    /// A verification: what it said, and what was wrong with it.
    Verification(Option<Verification>, Result<(), (Code, String)>),
}

/// Keeps nothing.
pub struct NoStore;

impl Store for NoStore {
    fn keeps(&self, _: &Outcome) -> bool {
        false
    }
    fn append(&mut self, _: &Finished, _: &Job, _: bool) -> Result<u64, Code> {
        Ok(0)
    }
    fn keep(&mut self, _: u64, _: &Job, _: WriteImages) -> Result<(), Code> {
        Ok(())
    }
    fn note(&mut self, _: Note) {}
    fn free(&self) -> Option<f64> {
        None
    }
    fn keep_hours(&mut self, _: [f64; 2]) {}
}

/// A cycle's end, for records and people.
#[derive(Clone, Debug)]
pub struct Finished {
    /// What the PLC gets.
    pub outcome: Outcome,
    /// What was measured, as far as it came to that.
    pub measurement: Option<Measurement>,
    /// Why there is no pose, in a sentence; empty if there is one.
    pub said: String,
    /// Where the vehicle really was when the red image was taken: the simulated station's.
    pub truth: Option<Pose<frame::Camera, frame::Vehicle>>,
    /// What stood there, in the simulated station's words.
    pub name: String,
    /// Tries, and what the first one came to if there were two.
    pub tries: usize,
    /// See there.
    pub first: Option<Code>,
    /// Images of the last try.
    pub budget: Budget,
    /// From the last image to the result.
    pub computed: Duration,
}

/// What a station is made of.
pub struct Parts {
    /// How it works.
    pub config: StationFile,
    /// Its devices.
    pub hardware: Hardware,
    /// Its time.
    pub clock: Box<dyn Clock + Send>,
    /// What is before it, if it is simulated.
    pub world: Option<Box<dyn World>>,
    /// Its calibration.
    pub calibration: Calibration,
    /// Vehicle models.
    pub jobs: Jobs,
    /// More of them, as they become ready.
    pub more_jobs: Option<Receiver<Entry>>,
    /// From the PLC.
    pub orders: Receiver<Order>,
    /// To the PLC.
    pub report: Box<dyn FnMut(Report) + Send>,
    /// To people.
    pub told: Box<dyn FnMut(&Finished) + Send>,
    /// Records.
    pub store: Box<dyn Store>,
    /// What was counted since the beginning of the records.
    pub counters: Counters,
    /// How long the bars have been lit.
    pub hours: Hours,
    /// Goes up while the station lives.
    pub pulse: Arc<Pulse>,
    /// True: end.
    pub stop: Arc<AtomicBool>,
    /// How it idles.
    pub pace: Pace,
}

/// A station at work.
pub struct Machine {
    parts: Parts,
    state: State,
    status: Status,
    sent: Option<(Status, Instant)>,
    pool: Pool,
    starts: HashMap<u16, Start>,
    active: Option<u16>,
    /// The vehicle that comes by itself, of this job.
    coming: Option<u16>,
    /// What the presence sensor says.
    presence: Reading,
    /// A vehicle that stands there has been measured, or need not be.
    seen: bool,
    durations: Durations,
    began: Duration,
    tested_at: Duration,
    checked_at: Duration,
    hours_kept_at: Duration,
    verified_at: Option<Duration>,
    /// Orders that came while something went on and are to be carried out after it.
    pending: VecDeque<Order>,
    booted: bool,
    /// The projector holds a cycle's pictures.
    loaded: bool,
    /// The camera has been lost and has not come back yet.
    lost: bool,
}

impl Machine {
    /// A station that has not begun yet.
    pub fn new(parts: Parts) -> Self {
        let by_itself = match parts.config.cycle.trigger {
            TriggerKind::Presence => ByItself::Always,
            TriggerKind::Plc if parts.world.is_some() => ByItself::Unowned,
            TriggerKind::Plc => ByItself::Never,
        };
        let warm = parts.config.cycle.warm_up_s == 0;
        let now = parts.clock.now();
        let pool = Pool::new(parts.hardware.camera.sensor(), POOL);
        let status = Status {
            simulated: parts.hardware.simulated,
            calibration_valid: true,
            // where vehicles come when they are asked for, none stands there before
            presence_fitted: parts.hardware.presence.is_some() && parts.world.is_none(),
            counters: parts.counters,
            ..Status::default()
        };
        Self {
            state: State { mode: Mode::Boot, stand_by: false, owned: false, warm, by_itself, fault: None },
            status,
            sent: None,
            pool,
            starts: HashMap::new(),
            active: None,
            coming: None,
            presence: Reading { present: false, since: now },
            seen: false,
            durations: Durations::default(),
            began: now,
            tested_at: now,
            checked_at: now,
            hours_kept_at: now,
            verified_at: None,
            pending: VecDeque::new(),
            booted: false,
            loaded: false,
            lost: false,
            parts,
        }
    }

    /// Lives until it is told to stop.
    pub fn run(mut self) {
        while self.turn() {}
    }

    /// Looks about once and does what is to be done. False: it is to end; the lights are off.
    pub fn turn(&mut self) -> bool {
        self.parts.pulse.beat();
        if self.parts.stop.load(Ordering::Relaxed) {
            let _ = self.parts.hardware.dark(); // dropping tries again
            self.parts.store.keep_hours(self.parts.hours.get());
            return false;
        }
        if !self.booted {
            self.booted = true;
            self.tell_status();
            self.happened(Event::Began);
        }
        self.take_jobs();
        self.timers();
        self.watch_vehicles();
        let order = self.pending.pop_front().or_else(|| self.next_order());
        if let Some(order) = order {
            self.happened(Event::Order(order));
        }
        self.tell_status();
        true
    }

    /// Waits for an order for a tick, in which a simulated station's time passes, too.
    fn next_order(&mut self) -> Option<Order> {
        let began = Instant::now();
        let order = match self.parts.pace {
            Pace::Free => self.parts.orders.try_recv().ok(),
            Pace::Wall => match self.parts.orders.recv_timeout(TICK) {
                Ok(order) => Some(order),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => {
                    std::thread::sleep(TICK); // nobody gives orders
                    None
                }
            },
        };
        if self.parts.hardware.simulated && order.is_none() {
            let passed = if self.parts.pace == Pace::Free { TICK } else { began.elapsed() };
            self.parts.clock.sleep(passed);
        }
        order
    }

    fn take_jobs(&mut self) {
        let Some(more) = &self.parts.more_jobs else { return };
        while let Ok(entry) = more.try_recv() {
            self.parts.jobs.add(entry);
        }
    }

    fn timers(&mut self) {
        let now = self.parts.clock.now();
        if !self.state.warm && now >= self.began + Duration::from_secs(self.parts.config.cycle.warm_up_s) {
            self.happened(Event::Warm);
        }
        if self.state.mode == Mode::Fault && now >= self.tested_at + RETRY {
            self.happened(Event::Retry);
        }
        if now >= self.checked_at + CHECK {
            self.checked_at = now;
            self.check_devices();
        }
        if now >= self.hours_kept_at + KEEP_HOURS {
            self.hours_kept_at = now;
            self.parts.store.keep_hours(self.parts.hours.get());
        }
    }

    /// A device that was unplugged is missed before the next vehicle does.
    fn check_devices(&mut self) {
        let hardware = &mut self.parts.hardware;
        let s = &mut self.status;
        let celsius = hardware.temperatures.read();
        [s.computer_celsius, s.camera_celsius, s.projector_celsius] = celsius;
        if !matches!(self.state.mode, Mode::Ready | Mode::WarmUp) {
            return;
        }
        if let Some(said) = hardware.temperatures.too_hot(celsius, false) {
            tracing::warn!(code = Code::OverTemperature.number(), "{said}");
            return self.happened(Event::Tested(Err(Code::OverTemperature)));
        }
        let camera = hardware.camera.check().map_err(|e| (Code::CameraLost, e));
        let gone = camera.and_then(|()| hardware.projector.check().map_err(|e| (Code::ProjectorSilent, e)));
        if let Err((code, e)) = gone {
            tracing::warn!(code = code.number(), "{e}");
            self.happened(Event::Tested(Err(code)));
        }
    }

    /// A vehicle counts as there, or gone, once the sensor has said so for a while.
    fn watch_vehicles(&mut self) {
        let Some(sensor) = &mut self.parts.hardware.presence else { return };
        let now = self.parts.clock.now();
        let Ok(reading) = sensor.wait(true, Duration::ZERO) else { return };
        self.presence = reading;
        let steady = reading.steady(now, Duration::from_millis(self.parts.config.presence.debounce_ms));
        self.status.vehicle_present = reading.present;
        if !reading.present && steady {
            self.seen = false;
        }
        if reading.present && steady && !self.seen {
            self.seen = true;
            self.happened(Event::Arrived);
        }
        self.send_one();
    }

    /// On the simulated station the next vehicle sets out when the last one is gone and nobody asks for others.
    fn send_one(&mut self) {
        let waits = self.state.mode == Mode::Ready && !self.state.stand_by;
        let wanted = match self.state.by_itself {
            ByItself::Never => false,
            ByItself::Unowned => !self.state.owned,
            ByItself::Always => true,
        };
        let none_comes = self.coming.is_none() && !self.presence.present;
        if waits
            && wanted
            && none_comes
            && let Some(world) = &mut self.parts.world
        {
            let jobs: Vec<u16> = self.parts.jobs.usable().map(|j| j.number).collect();
            self.coming = world.send_one(&jobs);
        }
    }

    fn happened(&mut self, event: Event) {
        let mut events = VecDeque::from([event]);
        while let Some(event) = events.pop_front() {
            if event == Event::Tested(Ok(())) && self.lost {
                self.lost = false;
                self.status.counters.camera_reconnects += 1;
            }
            for action in plan(&mut self.state, event) {
                events.extend(self.act(action));
            }
            self.lost |= self.state.fault == Some(Code::CameraLost);
        }
    }

    /// Does it; what that brought about.
    fn act(&mut self, action: Action) -> Option<Event> {
        match action {
            Action::Dark => {
                let _ = self.parts.hardware.dark(); // a light that stays on is found by the next test or image
                None
            }
            Action::Test => {
                self.tell_status();
                // a projector that was silent may have forgotten them
                self.loaded &= self.state.fault != Some(Code::ProjectorSilent);
                let before = self.state.fault == Some(Code::OverTemperature);
                let temperatures = &self.parts.hardware.temperatures;
                if temperatures.too_hot(temperatures.read(), before).is_some() {
                    self.tested_at = self.parts.clock.now();
                    return Some(Event::Tested(Err(Code::OverTemperature))); // no light while it is to cool
                }
                let mut tested = Ok(());
                if !self.loaded {
                    tested = selftest::load(&mut self.parts.hardware);
                    self.loaded = tested.is_ok();
                }
                if tested.is_ok() && (self.parts.config.cycle.self_test || self.state.fault.is_some()) {
                    let pulse = &self.parts.pulse;
                    tested = selftest::test(&mut self.parts.hardware, &self.pool, &|| pulse.beat());
                }
                self.tested_at = self.parts.clock.now();
                Some(Event::Tested(tested))
            }
            Action::Measure(trigger, cause) => Some(Event::Ended(self.measure(trigger, cause))),
            Action::Load { job, model_code } => {
                match self.parts.jobs.get(job, model_code) {
                    Ok(job) => {
                        self.active = Some(job.number);
                        self.tell(Report::Done(OrderKind::LoadJob));
                    }
                    Err(code) => self.tell(Report::Refused { order: OrderKind::LoadJob, code, detail: job }),
                }
                Some(Event::Ended(None))
            }
            Action::Verify => Some(Event::Ended(self.verify())),
            Action::Done(order) => {
                self.tell(Report::Done(order));
                None
            }
            Action::Refuse(order, code) => {
                self.tell(Report::Refused { order, code, detail: 0 });
                None
            }
            Action::Latch(code) => {
                self.parts.store.note(Note::Alarm(code));
                self.tell(Report::Error(code, 0));
                None
            }
        }
    }

    fn tell(&mut self, report: Report) {
        (self.parts.report)(report);
    }

    /// Tells how the station is, if that is news or has not been told for a while.
    fn tell_status(&mut self) {
        let state = &self.state;
        let fault = |codes: &[Code]| state.fault.is_some_and(|f| codes.contains(&f));
        let active = self.active.or_else(|| self.parts.jobs.usable().next().map(|j| j.number));
        let job = active.and_then(|n| self.parts.jobs.get(n, 0).ok());
        let now = self.parts.clock.now();
        let s = &mut self.status;
        s.state = state.mode;
        s.warm = state.warm;
        s.not_ready.not_warm = !state.warm;
        s.not_ready.camera = fault(&[Code::CameraLost]);
        s.not_ready.projector = fault(&[Code::ProjectorSilent]);
        s.not_ready.light = fault(&[Code::LightFault, Code::Ambient]);
        s.not_ready.temperature = fault(&[Code::OverTemperature]);
        s.not_ready.service = state.stand_by;
        s.not_ready.no_job = job.is_none();
        s.active_job = active.unwrap_or(0);
        s.job_fingerprint = job.map_or(0, |j| j.fingerprint);
        s.light_hours = self.parts.hours.get();
        s.bars_on = matches!(state.mode, Mode::Acquiring | Mode::Verify | Mode::SelfTest);
        s.projector_on = s.bars_on;
        s.disk_free = self.parts.store.free();
        s.verified_ago = self.verified_at.map(|at| now.saturating_sub(at));
        s.verify_due = self.parts.config.artefact.as_ref().is_some_and(|a| {
            a.every_h > 0.0 && s.verified_ago.is_none_or(|ago| ago.as_secs_f64() > 3600.0 * a.every_h)
        });
        s.counters.uptime_s = u32::try_from((now.saturating_sub(self.began)).as_secs()).unwrap_or(u32::MAX);
        let ms = |share| u32::try_from(self.durations.quantile(share).as_millis()).unwrap_or(u32::MAX);
        (s.counters.median_cycle_ms, s.counters.p95_cycle_ms) = (ms(0.5), ms(0.95));
        let old = self.sent.as_ref().is_none_or(|(sent, at)| sent != s || at.elapsed() >= STATUS);
        if old {
            let status = s.clone();
            self.sent = Some((status.clone(), Instant::now()));
            self.tell(Report::Status(Box::new(status)));
        }
    }

    fn verify(&mut self) -> Option<Code> {
        self.tell_status();
        let Some(artefact) = self.parts.config.artefact.clone() else {
            let refused = Report::Refused { order: OrderKind::Verify, code: Code::VerifyDatum, detail: 0 };
            self.tell(refused);
            return None;
        };
        // of this verification only: a process may hold several stations
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let folder = std::env::temp_dir().join(format!("datum-verify-{}-{number}", std::process::id()));
        let (pulse, stop) = (&self.parts.pulse, &self.parts.stop);
        let mut go_on = || {
            pulse.beat();
            !stop.load(Ordering::Relaxed)
        };
        let hardware = &mut self.parts.hardware;
        let said = verify::measure(hardware, &artefact, &self.parts.calibration, &folder, &mut go_on);
        let _ = self.parts.hardware.dark();
        // its pictures are others than a vehicle's
        let loaded = selftest::load(&mut self.parts.hardware);
        self.loaded = loaded.is_ok();
        let mut fault = loaded.err();
        match said {
            Ok(verification) => {
                self.verified_at = Some(self.parts.clock.now());
                self.status.verification = Some(verification);
                self.status.counters.verify_ok += 1;
                self.status.calibration_valid = true;
                self.status.not_ready.calibration = false;
                self.parts.store.note(Note::Verification(Some(verification), Ok(())));
                self.tell(Report::Done(OrderKind::Verify));
            }
            Err(failed) => {
                self.status.verification = failed.verification.or(self.status.verification);
                self.status.counters.verify_failed += 1;
                if failed.verification.is_some() {
                    self.status.calibration_valid = false;
                    self.status.not_ready.calibration = true;
                }
                if is_fault(failed.code) {
                    fault = Some(failed.code);
                }
                tracing::warn!(code = failed.code.number(), "verification: {}", failed.said);
                let wrong = Err((failed.code, failed.said));
                self.parts.store.note(Note::Verification(failed.verification, wrong));
                self.tell(Report::Refused { order: OrderKind::Verify, code: failed.code, detail: 0 });
            }
        }
        fault
    }

    /// One vehicle, from the trigger to its result. What is wrong with a device.
    fn measure(&mut self, mut trigger: Trigger, cause: Cause) -> Option<Code> {
        let coming = self.coming.take();
        let wanted = match (trigger.job, cause) {
            (0, Cause::Arrived) => coming.or(self.active),
            (0, Cause::Ordered) => self.active,
            (job, _) => Some(job),
        };
        let wanted = wanted.or_else(|| self.parts.jobs.usable().next().map(|j| j.number));
        let job = wanted.ok_or(Code::UnknownJob).and_then(|n| self.parts.jobs.get(n, trigger.model_code));
        let job = match (job, cause) {
            (Ok(job), _) => job,
            (Err(code), Cause::Ordered) => {
                let detail = wanted.unwrap_or(0);
                self.tell(Report::Refused { order: OrderKind::Measure, code, detail });
                return None;
            }
            (Err(code), Cause::Arrived) => {
                self.tell(Report::Error(code, wanted.unwrap_or(0)));
                return None;
            }
        };
        if cause == Cause::Ordered && self.status.presence_fitted && !self.presence.present {
            self.tell(Report::Refused { order: OrderKind::Measure, code: Code::NoVehicle, detail: 0 });
            return None;
        }
        trigger.job = job.number;
        self.active = Some(job.number);
        if cause == Cause::Arrived {
            self.tell(Report::Began(trigger.clone()));
        } else if let Some(world) = &mut self.parts.world {
            world.bring(job.number);
        }
        self.status.counters.triggers = self.status.counters.triggers.wrapping_add(1);
        self.tell_status();
        let (finished, images, fault) = self.cycle(&job, trigger);
        if let Some(world) = &mut self.parts.world {
            world.leave();
        }
        self.finish(finished, &job, images);
        fault
    }

    /// The tries at one vehicle.
    fn cycle(&mut self, job: &Arc<Job>, trigger: Trigger) -> (Finished, Option<Images>, Option<Code>) {
        let settings = Settings {
            longest: Duration::from_secs_f64(self.parts.config.camera.longest_ms / 1e3),
            ambient_limit: self.parts.config.cycle.ambient_limit,
            timeout: acquire::timeout(self.parts.config.camera.rate),
            celsius: [self.status.camera_celsius, self.status.projector_celsius],
        };
        let drive = self.parts.config.lights.drive;
        let mut start =
            *self.starts.get(&job.number).unwrap_or(&Start { red: START, fringes: START, drive: [drive; 2] });
        let triggered = self.parts.clock.now();
        let taken_at_ms = crate::time::unix_ms();
        let cycle = self.parts.config.cycle.clone();
        let acquired_by = triggered + Duration::from_millis(cycle.acquire_ms);
        let second_by = triggered + Duration::from_millis(cycle.second_by_ms);
        let mut bracket = Bracket::NONE;
        let (mut tries, mut first) = (0, None);
        let mut watcher = Watcher {
            orders: &self.parts.orders,
            pending: &mut self.pending,
            report: &mut *self.parts.report,
            clock: &*self.parts.clock,
            pulse: &self.parts.pulse,
            stop: &self.parts.stop,
            status: &mut self.status,
            world: self.parts.world.as_deref(),
            truth: None,
            simulated: self.parts.hardware.simulated,
            deadline: acquired_by,
            last_try: cycle.second_captures == 0,
            release_at: acquired_by,
            released: false,
            aborted: false,
            taken_at: None,
        };
        let attempt = loop {
            tries += 1;
            let began = watcher.clock.now();
            watcher.taken_at = None;
            let attempt =
                acquire::attempt(&mut self.parts.hardware, &self.pool, job, &settings, start, bracket, &mut watcher);
            let code = code_of(&attempt);
            let took = watcher.clock.now().saturating_sub(began);
            let again = tries <= usize::from(cycle.second_captures)
                && !watcher.released
                && !watcher.aborted
                && code.is_some_and(may_pass)
                && watcher.clock.now() + took.min(Duration::from_millis(cycle.acquire_ms)) <= second_by;
            if !again {
                break attempt;
            }
            first = code;
            bracket = bracketed(&attempt);
            start = attempt.start;
            watcher.deadline = second_by;
            watcher.last_try = true;
        };
        watcher.release();
        let (aborted, taken_at, truth) = (watcher.aborted, watcher.taken_at, watcher.truth);
        let name = self.parts.world.as_ref().map_or_else(String::new, |w| w.name());
        let late = !aborted && matches!(attempt.end, Err(Ended::Stopped));
        let (measurement, wrong) = match attempt.end {
            Ok(measurement) => (Some(measurement), None),
            Err(Ended::Failed(wrong)) => (None, Some(wrong)),
            Err(Ended::Stopped) if late => {
                let said = format!("Not all images were taken within {} ms.", cycle.acquire_ms);
                (None, Some(Wrong { code: Code::ImageMissing, detail: 0, said }))
            }
            Err(Ended::Stopped) => (None, None),
        };
        let fault = wrong.as_ref().map(|w| w.code).filter(|code| is_fault(*code));
        let mut outcome = match (&measurement, &wrong) {
            (Some(m), _) => outcome::outcome(m, &job.vehicle, trigger),
            (None, Some(wrong)) => {
                let result = if fault.is_some() { ResultCode::Aborted } else { ResultCode::NotMeasurable };
                outcome::empty(result, Some(wrong.code), wrong.detail, trigger, job.number)
            }
            (None, None) => outcome::empty(ResultCode::Aborted, None, 0, trigger, job.number),
        };
        let now = self.parts.clock.now();
        // on a simulated station time stands still while this thread computes
        let computed = if self.parts.hardware.simulated { attempt.computed } else { Duration::ZERO };
        outcome.light = Some(attempt.drive);
        outcome.ambient = attempt.ambient;
        [outcome.camera_celsius, outcome.projector_celsius] = settings.celsius;
        outcome.acquisition = taken_at.map(|at| at.saturating_sub(triggered));
        outcome.total = Some(now.saturating_sub(triggered) + computed);
        outcome.taken_at_ms = taken_at_ms;
        if outcome.pose.is_some() {
            self.starts.insert(job.number, attempt.start);
        }
        let said = match (&measurement, &wrong) {
            (Some(m), _) => m.detail.clone(),
            (None, Some(w)) => format!("{} {}", w.code.entry().sentence, w.said),
            (None, None) => "Ended by an order.".into(),
        };
        if let Some(warning) = measurement.as_ref().and_then(|m| m.warning.as_ref()) {
            tracing::warn!("{warning}");
        }
        let computed = attempt.computed;
        let finished =
            Finished { outcome, measurement, said, truth, name, tries, first, budget: attempt.budget, computed };
        (finished, attempt.images, fault)
    }

    /// Counts, keeps and tells a result.
    fn finish(&mut self, mut finished: Finished, job: &Job, images: Option<Images>) {
        let outcome = &mut finished.outcome;
        let c = &mut self.status.counters;
        c.results = c.results.wrapping_add(1);
        let count = match outcome.result {
            ResultCode::Ok => &mut c.ok,
            ResultCode::OutOfLimits => &mut c.out_of_limits,
            ResultCode::TooUncertain => &mut c.too_uncertain,
            ResultCode::NotMeasurable => &mut c.not_measurable,
            ResultCode::Aborted => &mut c.aborted,
        };
        *count = count.wrapping_add(1);
        if let Some(total) = outcome.total.filter(|_| outcome.result != ResultCode::Aborted) {
            self.durations.add(total);
        }
        let keep = images.is_some() && self.parts.store.keeps(&finished.outcome);
        let stored = self.parts.store.append(&finished, job, keep);
        finished.outcome.record = stored.unwrap_or(0);
        let kept = match (images, stored) {
            (Some((shots, mut capture)), Ok(key)) if keep => {
                capture.conditions.vin = Some(finished.outcome.trigger.vin.to_string()).filter(|v| !v.is_empty());
                let bits = self.parts.hardware.camera.sensor().bits;
                self.parts.store.keep(
                    key,
                    job,
                    Box::new(move |folder| {
                        capture.folder = folder.into();
                        write(&shots, &capture, bits)
                    }),
                )
            }
            _ => Ok(()),
        };
        let trouble = stored.err().or(kept.err());
        self.status.warning = trouble;
        self.status.not_ready.storage = false; // measuring goes on
        (self.parts.told)(&finished);
        self.tell(Report::Finished(Box::new(finished.outcome)));
    }
}

type Images = (Shots, crate::Capture);

/// A device is at fault, which the next vehicle would find as it is.
fn is_fault(code: Code) -> bool {
    matches!(code, Code::CameraLost | Code::ProjectorSilent | Code::LightFault)
}

/// Another try may do.
fn may_pass(code: Code) -> bool {
    match code {
        Code::ImageMissing | Code::Synchronisation => true,
        Code::TooDark | Code::Saturated | Code::Ambient | Code::Moved => true,
        Code::TooFewFeatures | Code::CoverageLow | Code::NotSmooth | Code::PhaseAmbiguity => true,
        code => (401..=406).contains(&code.number()),
    }
}

fn code_of(attempt: &Attempt) -> Option<Code> {
    match &attempt.end {
        Ok(measurement) => measurement.code.filter(|_| measurement.camera_from_vehicle.is_none()),
        Err(Ended::Failed(wrong)) => Some(wrong.code),
        Err(Ended::Stopped) => None,
    }
}

/// How the second try is lit, by what the first came to: darker where something was saturated or the panel brighter than
/// aimed at, brighter otherwise.
fn bracketed(attempt: &Attempt) -> Bracket {
    match code_of(attempt) {
        Some(Code::TooDark) => Bracket { red: 1.4, fringes: 1.0 },
        Some(Code::Saturated | Code::CoverageLow | Code::PhaseAmbiguity) => Bracket { red: 0.8, fringes: 0.65 },
        Some(code) if (401..=406).contains(&code.number()) || code == Code::TooFewFeatures => {
            let bright = attempt.level.is_some_and(|level| level > 0.4);
            Bracket { red: if bright { 0.7 } else { 1.4 }, fringes: 1.0 }
        }
        _ => Bracket::NONE,
    }
}

/// Looks at orders and time between images.
struct Watcher<'m> {
    orders: &'m Receiver<Order>,
    pending: &'m mut VecDeque<Order>,
    report: &'m mut (dyn FnMut(Report) + Send),
    clock: &'m dyn Clock,
    pulse: &'m Pulse,
    stop: &'m AtomicBool,
    status: &'m mut Status,
    world: Option<&'m dyn World>,
    truth: Option<Pose<frame::Camera, frame::Vehicle>>,
    simulated: bool,
    /// No image begins after.
    deadline: Duration,
    last_try: bool,
    /// The vehicle may move by then, whatever comes.
    release_at: Duration,
    released: bool,
    aborted: bool,
    taken_at: Option<Duration>,
}

impl Watcher<'_> {
    fn look(&mut self) {
        self.pulse.beat();
        if self.stop.load(Ordering::Relaxed) {
            self.aborted = true;
        }
        while let Ok(order) = self.orders.try_recv() {
            if let Some((order, code)) = while_busy(&order) {
                (self.report)(Report::Refused { order, code, detail: 0 });
                continue;
            }
            self.aborted |= matches!(order, Order::Abort | Order::StandBy(true));
            self.pending.push_back(order);
        }
    }

    /// The vehicle may move.
    fn release(&mut self) {
        if !self.released && self.taken_at.is_some() {
            self.released = true;
            (self.report)(Report::Acquired);
        }
    }
}

impl Watch for Watcher<'_> {
    fn go_on(&mut self) -> bool {
        self.look();
        !self.aborted && self.clock.now() < self.deadline
    }

    fn lit(&mut self) {
        self.truth = self.world.and_then(World::truth);
    }

    fn taken(&mut self) {
        self.taken_at = Some(self.clock.now());
        self.status.state = Mode::Processing;
        (self.status.bars_on, self.status.projector_on) = (false, false);
        (self.report)(Report::Status(Box::new(self.status.clone())));
        if self.last_try {
            self.release();
        }
    }

    fn wait_on(&mut self) -> bool {
        self.look();
        if !self.simulated && self.clock.now() >= self.release_at {
            self.release();
        }
        !self.aborted
    }
}
