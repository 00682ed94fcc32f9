//! `datum records`: what became of vehicles: listed, exported, measured again.

use super::{Status, print};
use crate::detect::{self, Detector};
use crate::document;
use crate::records::{
    CAPTURES, Event, Filter, REPRODUCED, Record, Verdict, With, capture_name, csv, json, json_lines, parse_time,
    replay, replay_json, replay_table, select, table,
};
use crate::{Calibration, VehicleFile};
use std::fs;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    list: List,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Lists records; so does `datum records` alone
    List(List),
    /// Writes records to a file, and copies kept captures out
    Export(Export),
    /// Measures kept captures again with this program, and prints what differs
    Replay(Replay),
}

#[derive(Debug, clap::Args)]
struct Chosen {
    /// Where the records are: [records] folder in the station's configuration
    #[arg(long, value_name = "DIR", default_value = "records")]
    folder: PathBuf,
    /// From this time on, UTC, as 2026-11-22 or 2026-11-22T05:00
    #[arg(long, value_name = "TIME", value_parser = time)]
    since: Option<u64>,
    /// Before this time, UTC
    #[arg(long, value_name = "TIME", value_parser = time)]
    until: Option<u64>,
    /// Vehicles whose VIN contains this
    #[arg(long, value_name = "TEXT")]
    vin: Option<String>,
    /// Vehicles with this verdict, or one of several
    #[arg(long, value_name = "VERDICT", value_enum, value_delimiter = ',')]
    verdict: Vec<Verdict>,
    /// Vehicles of this job
    #[arg(long, value_name = "N")]
    job: Option<u16>,
    /// The record with this number, or several
    #[arg(long, value_name = "N", value_delimiter = ',')]
    record: Vec<u64>,
    /// Of all these the last so many
    #[arg(long, value_name = "N")]
    last: Option<usize>,
}

#[derive(Debug, clap::Args)]
struct List {
    #[command(flatten)]
    chosen: Chosen,
    /// Prints a JSON array, one object per record
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct Export {
    #[command(flatten)]
    chosen: Chosen,
    /// The file: .csv (vehicles only) or .jsonl (JSON Lines, everything)
    #[arg(long, value_name = "FILE", required_unless_present = "captures")]
    out: Option<PathBuf>,
    /// Copies the kept captures of these vehicles into this folder
    #[arg(long, value_name = "DIR")]
    captures: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct Replay {
    #[command(flatten)]
    chosen: Chosen,
    /// Another calibration than the one kept with each capture
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Another vehicle model than the one kept with each capture
    #[arg(long, value_name = "FILE")]
    vehicle: Option<PathBuf>,
    /// The detector's network; none: features are searched for by their templates alone
    #[arg(long, value_name = "FILE.onnx|none", default_value = detect::DEFAULT)]
    detector: PathBuf,
    /// Uses the calibration for captures that are binned by a common factor
    #[arg(long)]
    scale_calibration: bool,
    /// Of all these the last so many that are still kept
    #[arg(long, value_name = "N")]
    kept: Option<usize>,
    /// Asks that each is reproduced: the same verdict, and the pose within 5 µm and 0.001°; else exit status 1
    #[arg(long)]
    reproduce: bool,
    /// Prints a JSON array, one object per capture
    #[arg(long)]
    json: bool,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    match &a.command {
        None => list(&a.list),
        Some(Command::List(a)) => list(a),
        Some(Command::Export(a)) => export(a),
        Some(Command::Replay(a)) => replay_all(a),
    }
}

fn time(text: &str) -> Result<u64, String> {
    parse_time(text).ok_or_else(|| "allowed: a UTC time as 2026-11-22, 2026-11-22T05:00 or 2026-11-22T05:00:00Z".into())
}

/// The chosen records. What cannot be read is said on standard error.
fn chosen(c: &Chosen) -> anyhow::Result<Vec<Record>> {
    let filter = Filter {
        since: c.since,
        until: c.until,
        vin: c.vin.clone(),
        verdicts: c.verdict.clone(),
        job: c.job,
        ids: c.record.clone(),
        last: c.last,
    };
    let selection = select(&c.folder, &filter)?;
    for damage in &selection.damage {
        eprintln!("warning: {damage}");
    }
    if selection.later > 0 {
        eprintln!("warning: {} records are of a later version of datum and not shown", selection.later);
    }
    Ok(selection.records)
}

fn list(a: &List) -> anyhow::Result<Status> {
    let records = chosen(&a.chosen)?;
    let show = if a.json { json } else { table };
    print(&show(&a.chosen.folder, &records))?;
    Ok(Status::Done)
}

fn export(a: &Export) -> anyhow::Result<Status> {
    let format = |out: &PathBuf| match out.extension().and_then(|e| e.to_str()) {
        Some("csv") => Ok(csv as fn(&Path, &[Record]) -> String),
        Some("jsonl") => Ok(json_lines as fn(&Path, &[Record]) -> String),
        _ => Err(anyhow::anyhow!("--out {}: allowed: a name that ends in .csv or .jsonl", out.display())),
    };
    let format = a.out.as_ref().map(format).transpose()?;
    let records = chosen(&a.chosen)?;
    if let (Some(out), Some(format)) = (&a.out, format) {
        document::write_bytes(out, format(&a.chosen.folder, &records).as_bytes())?;
        eprintln!("{}: {} records", out.display(), records.len());
    }
    if let Some(out) = &a.captures {
        let kept = records.iter().filter(|r| matches!(&r.event, Event::Vehicle(v) if v.images));
        let (mut copied, mut gone) = (0, 0);
        for record in kept {
            let from = a.chosen.folder.join(CAPTURES).join(capture_name(record.id));
            if from.is_dir() {
                copy(&from, &out.join(capture_name(record.id)))?;
                copied += 1;
            } else {
                gone += 1;
            }
        }
        eprintln!("{}: {copied} captures, {gone} are no longer kept", out.display());
    }
    Ok(Status::Done)
}

/// Copies a folder; under another name until all of it is there.
fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    use anyhow::Context;
    anyhow::ensure!(!to.exists(), "{}: is there already, allowed: a folder without it", to.display());
    let part = to.with_extension("part");
    let copied = fs::create_dir_all(&part).and_then(|()| {
        for entry in fs::read_dir(from)? {
            let entry = entry?;
            fs::copy(entry.path(), part.join(entry.file_name()))?; // a kept capture has files only
        }
        fs::rename(&part, to)
    });
    copied.with_context(|| format!("{}: cannot be copied to {}", from.display(), to.display()))
}

fn replay_all(a: &Replay) -> anyhow::Result<Status> {
    let with = With {
        calibration: a.calibration.as_deref().map(Calibration::read).transpose()?,
        vehicle: a.vehicle.as_deref().map(VehicleFile::read).transpose()?,
        detector: Detector::named(&a.detector)?,
        scale_calibration: a.scale_calibration,
    };
    let records = chosen(&a.chosen)?;
    let (mut all, mut unreadable) = (Vec::new(), 0);
    for record in records.iter().rev() {
        if a.kept.is_some_and(|n| all.len() + unreadable >= n) {
            break;
        }
        match replay(&a.chosen.folder, record, &with) {
            Ok(replayed) => all.extend(replayed),
            Err(e) => {
                unreadable += 1;
                eprintln!("error: record {}: {e:#}", record.id);
            }
        }
    }
    all.reverse(); // the newest were wanted first
    let changed = all.iter().filter(|r| !r.same_verdict()).count();
    let differing = all.iter().filter(|r| a.reproduce && !r.reproduced()).count();
    if a.json {
        print(&replay_json(&all))?;
    } else {
        print(&replay_table(&all))?;
        let n = all.len();
        print(&format!("{n} captures measured again, {changed} with another verdict, {unreadable} not readable\n"))?;
        if a.reproduce {
            let (mm, deg) = REPRODUCED;
            let allowed = format!("{} µm and {deg}°", 1000.0 * mm);
            print(&format!("{} of {n} reproduced within {allowed}\n", n - differing))?;
        }
    }
    Ok(match (unreadable, changed + differing) {
        (0, 0) => Status::Done,
        (0, _) => Status::Refused,
        _ => Status::BadInput,
    })
}
