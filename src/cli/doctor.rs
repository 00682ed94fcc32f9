//! `datum doctor`: every device tested, as a table. In: a configuration. Out: a line per finding, with what to do; exit status 3
//! where something is wrong.

use super::{Status, print};
use crate::station::{Health, StationFile, examine};
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration; none: the built-in simulated station
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let config = a.config.as_deref().map_or_else(|| Ok(StationFile::default()), StationFile::read)?;
    if let Some(key) = config.not_built() {
        anyhow::bail!("{}: {}", config.file.display(), super::run::not_built(&key));
    }
    let mut worst = Health::Good;
    let mut printed = Ok(());
    examine(&config, &mut |finding| {
        worst = worst.max(finding.health);
        let mark = match finding.health {
            Health::Good => "ok",
            Health::Doubtful => "?",
            Health::Bad => "WRONG",
        };
        let mut line = format!("{mark:5}  {:28}  {}\n", finding.about, finding.said);
        if !finding.hint.is_empty() {
            line += &format!("{:37}-> {}\n", "", finding.hint);
        }
        if printed.is_ok() {
            printed = print(&line); // as it is found: some take seconds
        }
    });
    printed?;
    Ok(if worst == Health::Bad { Status::Device } else { Status::Done })
}
