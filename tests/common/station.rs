//! A station on simulated devices, driven turn by turn: no thread, no waiting.

use datum::Measurement;
use datum::measure::Shared;
use datum::plc::{Order, Outcome, Report, State, Status, Trigger};
use datum::sim::{self, Body, Build, Deviation, Paint, Random, Script, Setup};
use datum::station::{
    Finished, Hardware, Machine, Next, NoStore, Pace, Parts, Simulated, StationFile, Still, World, deviation, load_all,
    teach_one,
};
use datum::study::error::{self, WRONG_MM, WRONG_YAW_DEG};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{self, Receiver, Sender};
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// How the station is built; at a quarter of its size, unless DATUM_SCALE says otherwise.
fn setup() -> &'static Arc<Setup> {
    static SETUP: OnceLock<Arc<Setup>> = OnceLock::new();
    let scale = std::env::var("DATUM_SCALE").ok().and_then(|s| s.parse().ok()).unwrap_or(0.25);
    SETUP.get_or_init(|| Arc::new(Setup::new(scale, 8)))
}

/// Job 1, taught once for all tests of a program.
pub(crate) fn jobs() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let name = format!("station-jobs-{}", std::process::id());
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        std::fs::create_dir_all(&folder).expect("writable");
        teach_one(setup(), 1, &folder).expect("a good capture");
        folder
    })
}

/// What is before a station.
pub(crate) type Before<'a> = &'a dyn Fn(&Simulated) -> Box<dyn World>;

/// A station and what it told.
pub(crate) struct Bench {
    pub(crate) machine: Machine,
    pub(crate) world: sim::Station,
    pub(crate) orders: Sender<Order>,
    pub(crate) stop: Arc<AtomicBool>,
    reports: Receiver<Report>,
    finished: Receiver<Finished>,
    next: Next,
    pub(crate) status: Status,
    id: u32,
}

/// One vehicle through the station.
pub(crate) struct Cycle {
    pub(crate) finished: Finished,
    pub(crate) reports: Vec<Report>,
    /// In virtual time, from the order to the end.
    pub(crate) took: Duration,
}

impl Bench {
    /// Booted and ready, unless a fault of `script` keeps it from that.
    pub(crate) fn new(config: StationFile, script: Script, jobs: &Path) -> Self {
        Self::with(config, script, jobs, |_, _| (), None)
    }

    /// With other devices, or another world.
    pub(crate) fn with(
        config: StationFile,
        script: Script,
        jobs: &Path,
        change: impl FnOnce(&Simulated, &mut Hardware),
        world: Option<Before<'_>>,
    ) -> Self {
        let seed = config.simulation.seed;
        let station = sim::Station::new(Arc::clone(setup()), seed, Vec::new(), script);
        let simulated = Simulated { station, setup: Arc::clone(setup()) };
        let mut hardware = simulated.hardware();
        change(&simulated, &mut hardware);
        let (orders, taken) = mpsc::channel();
        let (report, reports) = mpsc::channel();
        let (told, finished) = mpsc::channel();
        let next = Next::default();
        let stop = Arc::new(AtomicBool::new(false));
        let calibration = simulated.calibration();
        let still = || -> Box<dyn World> { Box::new(Still { station: simulated.station.clone(), next: next.clone() }) };
        let machine = Machine::new(Parts {
            hardware,
            clock: simulated.clock(),
            world: Some(world.map_or_else(still, |world| world(&simulated))),
            jobs: load_all(jobs, &calibration, &Shared::default()),
            calibration,
            more_jobs: None,
            orders: taken,
            report: Box::new(move |r| report.send(r).expect("the test listens")),
            told: Box::new(move |f| told.send(f.clone()).expect("the test listens")),
            store: Box::new(NoStore),
            pulse: Arc::default(),
            counters: datum::plc::Counters::default(),
            hours: datum::station::Hours::default(),
            stop: Arc::clone(&stop),
            pace: Pace::Free,
            config,
        });
        let world = simulated.station;
        let mut bench =
            Self { machine, world, orders, stop, reports, finished, next, status: Status::default(), id: 0 };
        bench.turn();
        bench
    }

    /// One turn, and what was told in it.
    pub(crate) fn turn(&mut self) -> Vec<Report> {
        self.machine.turn();
        let told: Vec<Report> = self.reports.try_iter().collect();
        for report in &told {
            if let Report::Status(status) = report {
                self.status = (**status).clone();
            }
        }
        told
    }

    /// Turns until the station is in `state`; false: it is not within so many turns of 100 ms.
    pub(crate) fn until(&mut self, state: State, turns: usize) -> bool {
        (0..turns).any(|_| {
            self.turn();
            self.status.state == state
        })
    }

    /// Gives an order, and turns until it is answered.
    pub(crate) fn order(&mut self, order: Order) -> Vec<Report> {
        self.orders.send(order).expect("it lives");
        self.turn()
    }

    /// What the next trigger brings: a vehicle of job 1.
    pub(crate) fn put(&self, paint: Paint, deviation: Deviation, build: Build) {
        let name = sim::names().next().expect("ten");
        self.next.put(Body::named(name).expect("listed").built(build), paint, deviation);
    }

    /// A vehicle of job 1 as it may come, its cycle ordered and ended. `None`: the order was refused.
    pub(crate) fn measure(&mut self, paint: Paint, random: &mut Random) -> Option<Cycle> {
        self.put(paint, deviation(random), Build::random(random));
        let began = self.world.now();
        self.id += 1;
        let _ = self.finished.try_iter().count(); // of orders given otherwise
        let reports = self.order(Order::Measure(Trigger { id: self.id, job: 1, ..Trigger::default() }));
        let finished = self.finished.try_iter().last()?;
        Some(Cycle { finished, reports, took: self.world.now() - began })
    }

    /// Whether any light is on.
    pub(crate) fn lit(&self) -> bool {
        let (bars, projector) = self.world.lights();
        bars != [0.0; 2] || projector
    }
}

impl Cycle {
    pub(crate) fn outcome(&self) -> &Outcome {
        &self.finished.outcome
    }

    /// mm at the features' centroid, degrees about the vertical, and the largest distance at a target over its U (k = 2).
    pub(crate) fn error(&self) -> Option<(f64, f64, f64)> {
        let (m, truth): (&Measurement, _) = (self.finished.measurement.as_ref()?, self.finished.truth?);
        let motion = error::motion(m, &truth)?;
        let off = |at: [f64; 3]| error::at_target(m, &truth, at).expect("a pose").norm();
        let at = |name: &str| match name {
            "front-radar" => [900.0, 0.0, 500.0],
            "windscreen-camera" => [-600.0, 0.0, 1300.0],
            "rear-axle" => [-2640.0, 0.0, 340.0],
            other => panic!("no such target: {other}"),
        };
        let targets = &m.uncertainty_k2.as_ref()?.targets;
        let worst = targets.iter().map(|t| off(at(&t.name)) / t.mm).fold(0.0, f64::max);
        Some((off(m.covariance_at_mm?), motion.r.scaled_axis().z.abs().to_degrees(), worst))
    }

    /// A pose that was given out is wrong: by 0.5 mm at the centroid, 0.15° in yaw, or twice its U at a target.
    pub(crate) fn is_wrong(&self) -> bool {
        self.outcome().pose.is_some()
            && self.error().is_none_or(|(mm, deg, u)| mm > WRONG_MM || deg > WRONG_YAW_DEG || u > 2.0)
    }
}
