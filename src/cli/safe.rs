//! `datum safe`: every output in its safe state. In: a configuration. Out: darkness; exit status 3 where an output could not
//! be reached. For the start and the stop of a service, and after a kill: a GPIO line keeps its level and a PWM channel its
//! duty when the program that set them is gone.

use super::{Status, print, sentence};
use crate::station::{self, StationFile};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration
    #[arg(long, value_name = "FILE")]
    config: PathBuf,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let config = StationFile::read(&a.config)?;
    if config.is_simulated() {
        print("Nothing to turn off: the devices are simulated.\n")?;
        return Ok(Status::Done);
    }
    let wrong = station::dark(&config);
    for e in &wrong {
        eprintln!("error: {}", sentence(e));
    }
    if wrong.is_empty() {
        print("Bars and projector are off.\n")?;
    }
    Ok(if wrong.is_empty() { Status::Done } else { Status::Device })
}
