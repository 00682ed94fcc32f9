//! The vehicles that come, and what an in-process simulation of the same station measures of them.
//! In: how many. Out: a folder with all that datum needs in the guest, and the poses to compare with.

use anyhow::Context;
use datum::plc::{Order, Report, State, Trigger};
use datum::sim::{self, Body, Build, Deviation, PAINTS, Paint, Random, Scene, Setup, Visit};
use datum::station::{
    CycleKeys, Hours, Machine, NoStore, Pace, Parts, Simulated, SimulationKeys, StationFile, deviation, load_all,
    teach_one,
};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::{Arc, mpsc};
use std::time::Duration;

#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Where to
    #[arg(long)]
    out: PathBuf,
    /// How many vehicles
    #[arg(long, default_value_t = 3)]
    vehicles: usize,
    /// How many of the ten models they are of
    #[arg(long, default_value_t = 1)]
    jobs: u16,
}

/// Size of the camera's image, of 2592×1944.
pub(crate) const SCALE: f64 = 0.25;
/// What vehicles are drawn from, and the noise of the in-process simulations.
const SEED: u64 = 8;
const NOISE: [u64; 2] = [11, 12];

/// x, y, z in mm; roll, pitch, yaw in degrees.
pub(crate) type Six = [f64; 6];

/// One vehicle.
#[derive(Clone, Debug, Deserialize, Serialize)]
pub(crate) struct Expected {
    pub(crate) job: u16,
    /// As two in-process simulations measure it, which differ in their noise only.
    pub(crate) poses: [Six; 2],
    /// Stated of it, k = 2.
    pub(crate) uncertainty: Six,
}

/// The vehicle of that number.
fn vehicle(number: usize, jobs: u16) -> (u16, Body, Paint, Deviation) {
    let mut random = Random::new(SEED, &[number as u64]);
    let job = 1 + (number % usize::from(jobs)) as u16;
    let name = sim::names().nth(usize::from(job) - 1).expect("one of the ten");
    let paint = PAINTS[random.below(PAINTS.len())];
    let body = Body::named(name).expect("listed").built(Build::random(&mut random));
    (job, body, paint, deviation(&mut random))
}

/// The same as it stands before the station.
pub(crate) fn scene(number: usize, jobs: u16) -> Scene {
    let (_, body, paint, deviation) = vehicle(number, jobs);
    Scene::new(body, paint, &deviation)
}

pub(crate) fn run(a: &Arguments) -> anyhow::Result<ExitCode> {
    let setup = Arc::new(Setup::new(SCALE, 8));
    let jobs = a.out.join("vehicles");
    std::fs::create_dir_all(&jobs)?;
    sim::calibration(&setup).write(&a.out.join("calibration.toml"))?;
    for job in 1..=a.jobs {
        if datum::station::missing(&jobs).contains(&job) {
            teach_one(&setup, job, &jobs)?;
        }
    }
    let mut expected = Vec::new();
    let measured: Vec<Vec<_>> = NOISE.iter().map(|seed| measure(*seed, a, &jobs)).collect::<Result<_, _>>()?;
    for (number, (a, b)) in measured[0].iter().zip(&measured[1]).enumerate() {
        let (Some((job, first, uncertainty)), Some((_, second, _))) = (a, b) else {
            anyhow::bail!("vehicle {number} is not measured by the in-process simulation");
        };
        expected.push(Expected { job: *job, poses: [*first, *second], uncertainty: *uncertainty });
    }
    let text = serde_json::to_string_pretty(&expected)?;
    std::fs::write(a.out.join("expected.json"), text)?;
    Ok(ExitCode::SUCCESS)
}

/// What [`run`] wrote, and of how many models.
pub(crate) fn expected(folder: &Path) -> anyhow::Result<(Vec<Expected>, u16)> {
    let file = folder.join("expected.json");
    let text = std::fs::read_to_string(&file).with_context(|| file.display().to_string())?;
    let expected: Vec<Expected> = serde_json::from_str(&text)?;
    let jobs = expected.iter().map(|e| e.job).max().context("no vehicles")?;
    Ok((expected, jobs))
}

type Pose = Option<(u16, Six, Six)>;

/// All vehicles through a station on simulated devices.
fn measure(seed: u64, a: &Arguments, jobs: &Path) -> anyhow::Result<Vec<Pose>> {
    let simulated = Simulated::new(SCALE, seed);
    let station = simulated.station.clone();
    let (orders, taken) = mpsc::channel();
    let (report, reports) = mpsc::channel();
    let calibration = simulated.calibration();
    let mut machine = Machine::new(Parts {
        hardware: simulated.hardware(),
        clock: simulated.clock(),
        world: None,
        jobs: load_all(jobs, &calibration, &datum::measure::Shared::default()),
        calibration,
        more_jobs: None,
        orders: taken,
        report: Box::new(move |r| drop(report.send(r))),
        told: Box::new(|_| ()),
        store: Box::new(NoStore),
        pulse: Arc::default(),
        hours: Hours::default(),
        counters: datum::plc::Counters::default(),
        stop: Arc::default(),
        pace: Pace::Free,
        config: StationFile {
            simulation: SimulationKeys { scale: SCALE, seed },
            cycle: CycleKeys { acquire_ms: 10_000, second_by_ms: 20_000, ..CycleKeys::default() },
            ..StationFile::default()
        },
    });
    machine.turn();
    let ready = reports.try_iter().any(|r| matches!(r, Report::Status(s) if s.state == State::Ready));
    anyhow::ensure!(ready, "the in-process simulation is not ready");
    let mut poses = Vec::new();
    for number in 0..a.vehicles {
        let (job, body, paint, deviation) = vehicle(number, a.jobs);
        station.bring(Visit { body, paint, deviation, stops: station.now(), leaves: Duration::MAX });
        orders.send(Order::Measure(Trigger { id: 1 + number as u32, job, ..Trigger::default() }))?;
        machine.turn();
        let pose = reports.try_iter().find_map(|r| match r {
            Report::Finished(o) => o.pose,
            _ => None,
        });
        poses.push(pose.map(|p| {
            let join = |a: [f64; 3], b: [f64; 3]| [a[0], a[1], a[2], b[0], b[1], b[2]];
            (job, join(p.position_mm, p.angles_deg), join(p.u_position_mm, p.u_angles_deg))
        }));
        station.clear();
        machine.turn();
    }
    Ok(poses)
}
