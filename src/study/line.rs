//! The whole simulated station, which finds its light by itself: one vehicle after the other is ordered and measured.
//! In:  a model, vehicles, how bright the hall is. Out: what the station made of each, and the truth.
//! No thread, no waiting: it is driven turn by turn, in virtual time.

use super::{Bench, Error};
use crate::measure::Taught;
use crate::plc::{Order, Report, State, Trigger};
use crate::sim::{self, Body, Cue, Deviation, Fault, Paint, Script, When};
use crate::station::{Finished, Hours, Job, Jobs, Machine, Next, NoStore, Pace, Parts, Simulated, StationFile, Still};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{self, Receiver, Sender};

/// A station that is not ready within so many turns, of 0.1 s, is not ready.
const TURNS: usize = 40;

/// A station at work.
pub(super) struct Line {
    machine: Machine,
    orders: Sender<Order>,
    reports: Receiver<Report>,
    finished: Receiver<Finished>,
    next: Next,
    state: State,
    ordered: u32,
}

impl Line {
    /// Booted, with one model, in a hall of so many lx; its sensor's noise belongs to `place` of the experiment.
    pub(super) fn new(bench: &Bench, taught: Taught, hall_lux: f64, place: &[u64]) -> Result<Self, Error> {
        let brighter = Cue { when: When::Always, fault: Fault::Ambient(hall_lux / bench.setup.hall_lux()) };
        let seed = bench.random(place).bits();
        let station = sim::Station::new(Arc::clone(&bench.setup), seed, Vec::new(), Script(vec![brighter]));
        let simulated = Simulated { station, setup: Arc::clone(&bench.setup) };
        let next = Next::default();
        let world = Still { station: simulated.station.clone(), next: next.clone() };
        let mut jobs = Jobs::default();
        let vehicle = taught.model.clone();
        let job = Job {
            number: 1,
            name: vehicle.name.clone(),
            model_code: 0,
            fingerprint: 0,
            templates: taught.templates.iter().map(crate::vehicle::Template::to_bytes).collect(),
            measurer: bench.measurer(&bench.calibration, taught),
            vehicle,
        };
        jobs.add((1, Ok(Arc::new(job))));
        let (orders, taken) = mpsc::channel();
        let (report, reports) = mpsc::channel();
        let (tell, finished) = mpsc::channel();
        let machine = Machine::new(Parts {
            config: StationFile::default(),
            hardware: simulated.hardware(),
            clock: simulated.clock(),
            world: Some(Box::new(world)),
            calibration: bench.calibration.clone(),
            jobs,
            more_jobs: None,
            orders: taken,
            // whoever no longer listens does not mind
            report: Box::new(move |r| drop(report.send(r))),
            told: Box::new(move |f| drop(tell.send(f.clone()))),
            store: Box::new(NoStore),
            counters: crate::plc::Counters::default(),
            hours: Hours::default(),
            pulse: Arc::default(),
            stop: Arc::new(AtomicBool::new(false)),
            pace: Pace::Free,
        });
        Ok(Self { machine, orders, reports, finished, next, state: State::Boot, ordered: 0 })
    }

    fn turn(&mut self) {
        self.machine.turn();
        for report in self.reports.try_iter() {
            if let Report::Status(status) = report {
                self.state = status.state;
            }
        }
    }

    /// What the station makes of one vehicle; none: it does not become ready.
    pub(super) fn measure(&mut self, body: &Body, paint: Paint, deviation: &Deviation) -> Option<Finished> {
        (0..TURNS).any(|_| {
            self.turn();
            self.state == State::Ready
        });
        self.next.put(body.clone(), paint, *deviation);
        self.ordered += 1;
        let _ = self.finished.try_iter().count(); // of what it did by itself
        let trigger = Trigger { id: self.ordered, job: 1, ..Trigger::default() };
        self.orders.send(Order::Measure(trigger)).ok()?;
        self.turn();
        self.finished.try_iter().last()
    }
}
