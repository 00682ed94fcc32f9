//! `datum run`: the appliance. In: a configuration or none. Out: one line per vehicle, until it is told to end.

use super::{Status, print};
use crate::Calibration;
use crate::geometry::{Point3, Pose, frame};
use crate::measure::Measurement;
use crate::plc::{Report, ResultCode, State};
use crate::station::{
    Finished, Hardware, Machine, NoStore, Pace, Parts, Simulated, StationFile, Traffic, load, load_all, teach_missing,
    teach_one,
};
use anyhow::Context;
use nalgebra::{Matrix3, Rotation3, Vector3};
use signal_hook::consts::{SIGINT, SIGTERM};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration; none: the built-in simulated station
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Ends after so many vehicles
    #[arg(long, value_name = "N")]
    vehicles: Option<u64>,
}

/// Why a station of such devices cannot run.
pub(super) fn not_built(key: &str) -> String {
    format!("{key}: this datum is built without that driver; it comes with the drivers. Allowed so far: \"simulated\"")
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let config = a.config.as_deref().map_or_else(|| Ok(StationFile::default()), StationFile::read)?;
    if let Some(key) = config.not_built() {
        anyhow::bail!("{}: {}", config.file.display(), not_built(&key));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("signals")?;
    }
    let simulated = Simulated::new(config.simulation.scale, config.simulation.seed);
    let calibration = match &config.calibration {
        Some(file) => Calibration::read(&config.beside(file))?,
        None => simulated.calibration(),
    };
    let folder = config.beside(&config.jobs.folder);
    let more_jobs = models(&simulated, &config, &calibration, &stop)?;
    let jobs = load_all(&folder, &calibration);
    for broken in jobs.unusable() {
        eprintln!("{}", broken.said);
    }
    eprintln!("{}: {} jobs", folder.display(), jobs.usable().count());
    let (_nobody, orders) = mpsc::channel();
    let hardware: Hardware = simulated.hardware();
    let (mut last, limit, mut count) = (State::Boot, a.vehicles, 0);
    let (done, allowed_ms) = (Arc::clone(&stop), config.cycle.acquire_ms);
    let parts = Parts {
        hardware,
        clock: simulated.clock(),
        world: Some(Box::new(Traffic::new(&simulated.station, config.simulation.seed))),
        calibration,
        jobs,
        more_jobs: Some(more_jobs),
        orders,
        report: Box::new(move |report| {
            match report {
                Report::Status(status) if status.state != last => {
                    last = status.state;
                    if matches!(last, State::Ready | State::Fault | State::WarmUp) && status.counters.results == 0 {
                        let _ = print(&format!("{}\n", words(last))); // nobody reads on
                    }
                }
                Report::Error(code, _) => {
                    let _ = print(&format!("fault: {code}: {} {}\n", code.entry().sentence, code.entry().remedy));
                }
                _ => {}
            };
        }),
        told: Box::new(move |finished| {
            let _ = print(&line(finished));
            count += 1;
            if count == 1 {
                let _ = print(&budget(finished, allowed_ms));
            }
            if limit.is_some_and(|n| count >= n) {
                done.store(true, Ordering::Relaxed);
            }
        }),
        store: Box::new(NoStore),
        pulse: Arc::new(AtomicU64::new(0)),
        stop,
        pace: Pace::Wall,
        config,
    };
    let station = std::thread::Builder::new().name("station".into()).spawn(move || Machine::new(parts).run());
    let ended = station.context("the station's thread")?.join();
    anyhow::ensure!(ended.is_ok(), "the station's thread panicked; bars and projector are off");
    Ok(Status::Done)
}

/// On a simulated station without models the ten named ones are taught: the first at once, the others beside its work.
fn models(
    simulated: &Simulated,
    config: &StationFile,
    calibration: &Calibration,
    stop: &Arc<AtomicBool>,
) -> anyhow::Result<mpsc::Receiver<crate::station::Entry>> {
    let (add, more) = mpsc::channel();
    let folder = config.beside(&config.jobs.folder);
    let missing = teach_missing(&folder);
    // a folder with other models is somebody's own
    if missing.len() < 10 && !folder.join(".simulated").exists() {
        return Ok(more);
    }
    std::fs::create_dir_all(&folder).with_context(|| format!("{}: cannot be made", folder.display()))?;
    std::fs::write(folder.join(".simulated"), "The models in this folder are taught by `datum run` itself.\n")?;
    let setup = Arc::clone(&simulated.setup);
    let teach = move |job: u16| -> anyhow::Result<PathBuf> {
        let began = Instant::now();
        let file = teach_one(&setup, job, &folder)?;
        eprintln!("{}: taught and released in {:.1} s", file.display(), began.elapsed().as_secs_f64());
        Ok(file)
    };
    if missing.first() == Some(&1) {
        teach(1)?;
    }
    let rest: Vec<u16> = missing.into_iter().filter(|job| *job > 1).collect();
    let (calibration, stop) = (calibration.clone(), Arc::clone(stop));
    let thread = std::thread::Builder::new().name("teaching".into());
    thread.spawn(move || {
        for job in rest {
            if stop.load(Ordering::Relaxed) {
                break;
            }
            match teach(job) {
                Ok(file) => {
                    let _ = add.send(load(job, &file, &calibration)); // the station has ended
                }
                Err(e) => eprintln!("job {job}: {e:#}"),
            }
        }
    })?;
    Ok(more)
}

fn words(state: State) -> &'static str {
    match state {
        State::Ready => "ready",
        State::WarmUp => "warming up",
        State::Fault => "fault",
        _ => "busy",
    }
}

/// The acquisition's budget on the reference hardware, in a line.
fn budget(f: &Finished, allowed_ms: u64) -> String {
    let b = &f.budget;
    format!(
        "acquisition on the reference hardware: {} images for the red light, {} for the bars, {} for the projector, {} \
         fringes and the repeat: {} at 30/s are {:.2} s, allowed {:.2} s\n",
        b.red,
        b.bars,
        b.projector,
        b.fringes,
        b.images(),
        b.at_30_per_s().as_secs_f64(),
        allowed_ms as f64 / 1e3
    )
}

/// One vehicle in a line.
fn line(f: &Finished) -> String {
    let o = &f.outcome;
    let verdict = match o.result {
        ResultCode::Ok => "ok",
        ResultCode::OutOfLimits => "out of limits",
        ResultCode::TooUncertain => "too uncertain",
        ResultCode::NotMeasurable => "not measurable",
        ResultCode::Aborted => "aborted",
    };
    let ms = |d: Option<std::time::Duration>| d.map_or("–".into(), |d| format!("{:.0}", d.as_secs_f64() * 1e3));
    let mut out = format!("job {:03} {:16} {verdict:14}", o.job, f.name);
    if let Some(p) = &o.pose {
        let ([x, y, z], [roll, pitch, yaw]) = (p.position_mm, p.angles_deg);
        out += &format!(" {x:+8.2} {y:+8.2} {z:+8.2} mm {roll:+7.3} {pitch:+7.3} {yaw:+7.3}°");
        let off = f.measurement.as_ref().zip(f.truth).and_then(|(m, truth)| error(m, &truth));
        if let Some((mm, deg)) = off {
            out += &format!(" off {mm:.3} mm {deg:.4}°");
        }
    }
    let l = o.light.unwrap_or_default();
    out += &format!(
        " acquired {} ms ({} images, computed {:.0} ms) total {} ms bars {:.2} {:.2}",
        ms(o.acquisition),
        f.budget.images(),
        f.computed.as_secs_f64() * 1e3,
        ms(o.total),
        l[0],
        l[1]
    );
    if f.tries > 1 {
        out += &format!(" second try after {}", f.first.map_or("–".into(), |c| c.to_string()));
    }
    if !f.said.is_empty() {
        out += &format!(" {}", f.said);
    }
    out + "\n"
}

/// How far a measured pose is off: the features' centroid, mm; the rotation, degrees.
fn error(m: &Measurement, truth: &Pose<frame::Camera, frame::Vehicle>) -> Option<(f64, f64)> {
    let p = m.camera_from_vehicle.as_ref()?;
    let r = Rotation3::from_matrix_unchecked(Matrix3::from_fn(|i, j| p.rotation[i][j]));
    let measured = Pose::<frame::Camera, frame::Vehicle>::new(r, p.translation_mm.into());
    let motion: Pose<frame::Vehicle, frame::Vehicle> = truth.inverse() * measured;
    let at = Point3::new(Vector3::from(m.covariance_at_mm?));
    Some((((motion * at) - at).norm(), motion.r.angle().to_degrees()))
}
