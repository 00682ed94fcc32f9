//! `datum check`: a configuration in, every key with its value and what it means out.

use super::{Status, print};
use crate::station::{KEYS, StationFile};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The station's configuration; none: the built-in simulated station
    #[arg(value_name = "FILE")]
    config: Option<PathBuf>,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let station = a.config.as_deref().map_or_else(|| Ok(StationFile::default()), StationFile::read)?;
    let written = match &a.config {
        Some(file) => std::fs::read_to_string(file)?.parse::<toml::Table>()?, // it was read just now
        None => toml::Table::new(),
    };
    let default = StationFile::default();
    let mut out = String::new();
    let name = a.config.as_ref().map_or("the built-in simulated station".into(), |f| f.display().to_string());
    writeln!(out, "{name}: valid")?;
    let mut table = "";
    for key in KEYS {
        if key.table != table {
            table = key.table;
            writeln!(out, "[{table}]")?;
        }
        let in_file = match table {
            "" => written.contains_key(key.name),
            table => written.get(table).and_then(|t| t.get(key.name)).is_some(),
        };
        let value = station.value(key).map_or_else(|| "(left out)".into(), |v| format!("= {v}"));
        let standard = match default.value(key) {
            _ if !in_file => "the default".into(),
            Some(default) => format!("default {default}"),
            None => "no default".into(),
        };
        writeln!(out, "{} {value}", key.name)?;
        writeln!(out, "    {}; {standard}; allowed: {}", key.meaning, key.allowed)?;
    }
    if let Some(missing) = station.not_built() {
        writeln!(out, "{}", super::run::not_built(&missing))?;
    }
    print(&out)?;
    Ok(Status::Done)
}
