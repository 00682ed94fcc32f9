//! `datum run`: the appliance. In: a configuration or none. Out: poses to the PLC, records, what a person sees; until it
//! is told to end.

mod line;
mod models;
mod store;
mod view;

use super::{Status, sentence};
use crate::Calibration;
use crate::hal::linux::MonotonicClock;
use crate::heap;
use crate::measure::Shared;
use crate::plc::{self, Identity, ORDERS, Report, Server, State};
use crate::records::Fault;
use crate::station::{
    self, Hardware, Hours, Machine, Pace, Parts, Simulated, StationFile, Store, Traffic, TriggerKind, load_all,
};
use anyhow::Context;
use sd_notify::NotifyState;
use signal_hook::consts::{SIGINT, SIGTERM};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};
use tracing_subscriber::filter::LevelFilter;
use view::View;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration; none: the built-in simulated station
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Ends after so many vehicles
    #[arg(long, value_name = "N")]
    vehicles: Option<u64>,
    /// Tells more: -v what happens, -vv everything
    #[arg(short, long, action = clap::ArgAction::Count)]
    verbose: u8,
}

/// The main thread looks at the PLC's side, the station's life and the signals this often.
const LOOK: Duration = Duration::from_millis(200);
/// The station's thread gives a sign of life at least this often, or it hangs.
const PATIENCE: Duration = Duration::from_secs(5);

/// Why a station of such devices cannot run.
pub(super) fn not_built(key: &str) -> String {
    format!(
        "{key}: this datum is built without that driver; `cargo build --features libcamera` builds it with. Allowed: \
         \"v4l2\", \"simulated\""
    )
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    heap::steady();
    let config = a.config.as_deref().map_or_else(|| Ok(StationFile::default()), StationFile::read)?;
    if let Some(key) = config.not_built() {
        anyhow::bail!("{}: {}", config.file.display(), not_built(&key));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGTERM, SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("signals")?;
    }
    let view = View::new();
    log(a.verbose, &view);

    let simulated = config.is_simulated().then(|| Simulated::new(config.simulation.scale, config.simulation.seed));
    let calibration = match (&config.calibration, &simulated) {
        (Some(file), _) => Calibration::read(&config.beside(file))?,
        (None, Some(simulated)) => simulated.calibration(),
        (None, None) => {
            anyhow::bail!("{}: calibration = (missing), allowed: a calibration.toml", config.file.display())
        }
    };
    let records = config.beside(&config.records.folder);
    let kept = store::Kept::open(&records, &config.records, &calibration, fingerprint(&calibration));
    let kept = match kept {
        Ok(kept) => kept,
        Err(held @ Fault::Held { .. }) => {
            eprintln!("error: {held} End it first (on an appliance: systemctl stop datum).");
            return Ok(Status::Device);
        }
        Err(fault) => return Err(fault.into()),
    };
    let mut hardware = match &simulated {
        Some(simulated) => simulated.hardware(),
        None => match station::real(&config) {
            Ok(hardware) => hardware,
            Err(e) => {
                let _ = station::dark(&config); // as far as can be; the first error is told
                eprintln!("error: {} `datum doctor` says more.", sentence(&e));
                return Ok(Status::Device);
            }
        },
    };
    let (sensor, projector) = (hardware.camera.sensor(), hardware.projector.size());
    if let Err(said) = station::fits(&calibration, (sensor.width, sensor.height), projector) {
        anyhow::bail!("{}: {said}", config.file.display());
    }
    let hours = Hours::new(kept.hours());
    hours.count(&mut hardware.bars);
    let identity = identity(&config, &calibration, &hardware);
    let shared = Shared { detector: config.read_detector()?, ..Shared::default() };
    let more_jobs = match &simulated {
        Some(simulated) => Some(models::models(simulated, &config, &calibration, shared.clone(), &stop)?),
        None => None,
    };
    let (order, orders) = mpsc::sync_channel(ORDERS);
    let (reported, reports) = mpsc::channel();
    let pulse = Arc::new(plc::Pulse::default());
    let server = Server::start(server(&config)?, identity, order, reports, Arc::clone(&pulse))?;
    view.listens(server.local_addr());
    view.say(&format!("Modbus TCP on {}", server.local_addr()));

    let folder = config.beside(&config.jobs.folder);
    let jobs = load_all(&folder, &calibration, &shared);
    for broken in jobs.unusable() {
        tracing::warn!(code = broken.code.number(), "{}", broken.said);
    }
    view.say(&format!("{}: {} jobs ready", folder.display(), jobs.usable().count()));

    let allowed_ms = config.cycle.acquire_ms;
    let (mut count, limit) = (0, a.vehicles);
    let (done, seen, told) = (Arc::clone(&stop), view.clone(), view.clone());
    let mut ready = false;
    let parts = Parts {
        hardware,
        clock: simulated.as_ref().map_or_else(|| Box::new(MonotonicClock) as _, Simulated::clock),
        world: simulated.as_ref().map(|s| Box::new(Traffic::new(&s.station, config.simulation.seed)) as _),
        calibration,
        jobs,
        more_jobs,
        orders,
        report: Box::new(move |report| {
            match &report {
                Report::Status(status) => {
                    seen.status(status);
                    if status.state == State::Ready && !std::mem::replace(&mut ready, true) {
                        let _ = sd_notify::notify(&[NotifyState::Ready]); // no systemd, nobody to tell
                    }
                }
                Report::Error(code, _) => seen.fault(*code),
                _ => {}
            }
            let _ = reported.send(report); // the server has ended: so does the station
        }),
        told: Box::new(move |finished| {
            told.finished(finished);
            count += 1;
            if count == 1 {
                told.say(line::budget(finished, allowed_ms).trim_end());
            }
            if limit.is_some_and(|n| count >= n) {
                done.store(true, Ordering::Relaxed);
            }
        }),
        counters: kept.counters(),
        hours,
        store: Box::new(kept) as Box<dyn Store>,
        pulse: Arc::clone(&pulse),
        stop: Arc::clone(&stop),
        pace: Pace::Wall,
        config,
    };
    let thread = std::thread::Builder::new().name("station".into()).spawn(move || Machine::new(parts).run());
    let station = thread.context("the station's thread")?;
    let (mut beats, mut moved) = (pulse.count(), Instant::now());
    while !station.is_finished() {
        std::thread::sleep(LOOK);
        view.plc(&server.view());
        if pulse.count() != beats {
            (beats, moved) = (pulse.count(), Instant::now());
        }
        if moved.elapsed() < PATIENCE {
            let _ = sd_notify::notify(&[NotifyState::Watchdog]); // else systemd starts it anew
        }
    }
    let _ = sd_notify::notify(&[NotifyState::Stopping]);
    view.end();
    anyhow::ensure!(station.join().is_ok(), "the station's thread panicked; bars and projector are off");
    drop(server);
    Ok(Status::Done)
}

/// Warnings, and more if asked for, where the view shows them; without a page that is standard error, for journald.
fn log(verbose: u8, view: &View) {
    let level = match verbose {
        0 => LevelFilter::WARN,
        1 => LevelFilter::INFO,
        _ => LevelFilter::DEBUG,
    };
    let view = view.clone();
    let log = tracing_subscriber::fmt().with_max_level(level).with_target(false).without_time().with_ansi(false);
    // a second subscriber in one process: tests
    let _ = tracing::subscriber::set_global_default(log.with_writer(move || view.clone()).finish());
}

/// The server's side of the configuration, which has been checked.
fn server(config: &StationFile) -> anyhow::Result<plc::Config> {
    let keys = &config.plc;
    let listen = keys.listen.parse().with_context(|| format!("plc.listen = {:?}", keys.listen))?;
    let allow: Result<Vec<plc::Network>, _> = keys.allow.iter().map(|n| n.parse()).collect();
    Ok(plc::Config {
        listen,
        allow: allow.context("plc.allow")?,
        word_order: keys.word_order,
        heartbeat_timeout: Duration::from_secs_f64(keys.heartbeat_s),
        presence: config.cycle.trigger == TriggerKind::Presence,
        patience: PATIENCE,
    })
}

/// CRC-32 of the calibration's file; 0: it has none.
fn fingerprint(calibration: &Calibration) -> u32 {
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    std::fs::read(&calibration.file).map_or(0, |bytes| crc.checksum(&bytes))
}

fn identity(config: &StationFile, calibration: &Calibration, hardware: &Hardware) -> Identity {
    // the date that its id begins with
    let date = calibration.id.as_deref().and_then(|id| id.get(..10)).map(|d| d.replace('-', ""));
    let version = env!("CARGO_PKG_VERSION");
    Identity {
        serial: config.serial.clone(),
        version: version.into(),
        software_fingerprint: crc::Crc::<u16>::new(&crc::CRC_16_MODBUS).checksum(version.as_bytes()),
        camera_serial: hardware.camera.sensor().serial.clone(),
        projector_serial: String::new(),
        calibration_fingerprint: fingerprint(calibration),
        calibration_date: date.and_then(|d| d.parse().ok()).unwrap_or(0),
    }
}
