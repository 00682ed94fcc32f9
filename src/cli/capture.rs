//! `datum capture`: one capture of what stands before the station's devices. In: a configuration. Out: a capture's folder.
//! Not here: measuring it.

use super::{Status, print, sentence};
use crate::capture::{Plan, RecordError, record};
use crate::station::{self, Simulated, StationFile, Traffic, World};
use crate::time;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration; none: the built-in simulated station, with a vehicle before it
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// The folder to write into
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Drive of both bars, 0 to 1
    #[arg(long, value_name = "DRIVE", default_value_t = 0.6)]
    bars: f64,
    /// Row fringes, too: for a board
    #[arg(long)]
    rows: bool,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    anyhow::ensure!((0.0..=1.0).contains(&a.bars), "--bars = {}, allowed: 0 to 1", a.bars);
    let config = a.config.as_deref().map_or_else(|| Ok(StationFile::default()), StationFile::read)?;
    if let Some(key) = config.not_built() {
        anyhow::bail!("{}: {}", config.file.display(), super::run::not_built(&key));
    }
    let opened = if config.is_simulated() {
        let simulated = Simulated::new(config.simulation.scale, config.simulation.seed);
        Traffic::new(&simulated.station, config.simulation.seed).bring(1);
        Ok(simulated.hardware())
    } else {
        station::real(&config)
    };
    let mut hardware = match opened {
        Ok(hardware) => hardware,
        Err(e) => {
            eprintln!("error: {} `datum doctor` says more.", sentence(&e));
            return Ok(Status::Device);
        }
    };
    let mut plan = Plan { bars: [a.bars; 2], taken_at: time::moment(time::unix_ms()), ..Plan::default() };
    if a.rows {
        plan.sets.extend(station::ROWS);
    }
    match record(&mut hardware.devices(), &plan, &a.out) {
        Ok(capture) => {
            let images: usize = capture.fringes.iter().map(|s| s.images.len()).sum();
            print(&format!("{}: {images} fringe images\n", a.out.display()))?;
            Ok(Status::Done)
        }
        Err(e @ RecordError::Shoot(_)) => {
            eprintln!("error: {}", sentence(&e));
            Ok(Status::Device)
        }
        Err(e) => Err(e.into()),
    }
}
