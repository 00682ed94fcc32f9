//! `datum measure`: stored captures in, poses out.

use super::{Status, overlay, print};
use crate::detect::{self, Detector};
use crate::measure::{Measurement, Measurer, Method, Shared, Stage, Timing, Verdict, json, measure, table};
use crate::{Calibration, Capture, VehicleFile, capture};
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// Folders with a capture.toml
    #[arg(required = true, value_name = "CAPTURE")]
    captures: Vec<PathBuf>,
    /// The calibration of camera and projector
    #[arg(long, value_name = "FILE")]
    calibration: PathBuf,
    /// The vehicle model
    #[arg(long, value_name = "FILE")]
    vehicle: PathBuf,
    /// Prints a JSON array, one object per capture
    #[arg(long)]
    json: bool,
    /// How the pose is measured
    #[arg(long, value_enum, default_value_t)]
    method: Method,
    /// The detector's network; none: features are searched for by their templates alone
    #[arg(long, value_name = "FILE.onnx|none", default_value = detect::DEFAULT)]
    detector: PathBuf,
    /// Writes a picture of each result into this folder
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Uses the calibration for captures that are binned by a common factor
    #[arg(long)]
    scale_calibration: bool,
}

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let calibration = Calibration::read(&a.calibration)?;
    let vehicle = VehicleFile::read(&a.vehicle)?;
    let shared = Shared { detector: Detector::named(&a.detector)?, ..Shared::default() };
    let mut ready = None;
    let mut results = Vec::new();
    for (n, folder) in a.captures.iter().enumerate() {
        if a.captures.len() > 1 {
            eprintln!("{}/{} {}", n + 1, a.captures.len(), folder.display());
        }
        results.push(one(folder, (&calibration, &vehicle, &shared), &mut ready, a).unwrap_or_else(|e| {
            eprintln!("error: {e:#}");
            let name = capture::name_of(folder);
            Measurement::without_pose(name, Verdict::Error, None, format!("{e:#}"), a.method)
        }));
    }
    print(&if a.json { json(&results) } else { format!("{}{}", table(&results), times(&results)) })?;
    Ok(status(&results))
}

/// Made once for captures of one size: start-up work that no vehicle should wait for.
type Ready = Option<([(usize, usize); 2], Measurer)>;

fn one(
    folder: &Path,
    (calibration, vehicle, shared): (&Calibration, &VehicleFile, &Shared),
    ready: &mut Ready,
    a: &Arguments,
) -> anyhow::Result<Measurement> {
    let capture = Capture::open(folder)?;
    capture.red()?;
    let (c, p) = (&capture.camera, &capture.projector);
    let sizes = [(c.width, c.height), (p.width, p.height)];
    if ready.as_ref().is_none_or(|(of, _)| *of != sizes) {
        let calibration = calibration
            .for_sizes(sizes[0], sizes[1], a.scale_calibration)
            .map_err(|e| anyhow::Error::new(e).context(capture.file().display().to_string()))?;
        let measurer = Measurer::new(calibration, vehicle.clone())?.with_method(a.method).sharing(shared);
        *ready = Some((sizes, measurer));
    }
    let (_, measurer) = ready.as_ref().expect("made just now");
    let mut clock = Clock::new();
    let (mut measurement, drawing) = measure(measurer, &capture, &mut |stage| clock.ended(stage))?;
    measurement.timing_ms = clock.timing;
    if let Some(warning) = &measurement.warning {
        eprintln!("warning: {}: {warning}", folder.display());
    }
    if let Some(folder) = &a.overlay {
        overlay::write(folder, &capture, &measurement, &drawing)?;
    }
    Ok(measurement)
}

/// Median time of each stage over the captures, and the most memory that was ever held.
fn times(results: &[Measurement]) -> String {
    let median = |stage: fn(&Timing) -> Option<f64>| {
        let mut ms: Vec<f64> = results.iter().filter_map(|m| stage(&m.timing_ms)).collect();
        if ms.is_empty() { "–".into() } else { format!("{:.0}", crate::geometry::robust::median(&mut ms)) }
    };
    let memory = std::fs::read_to_string("/proc/self/status").ok().and_then(|status| {
        let peak = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
        Some(format!(", peak memory {:.0} MiB", peak.trim().strip_suffix("kB")?.trim().parse::<f64>().ok()? / 1024.0))
    });
    format!(
        "median ms: read {}, detect {}, decode {}, surface {}, contour {}, pose {}, total {}{}\n",
        median(|t| t.read),
        median(|t| t.detect),
        median(|t| t.decode),
        median(|t| t.surface),
        median(|t| t.contour),
        median(|t| t.pose),
        median(|t| t.total),
        memory.unwrap_or_default()
    )
}

/// Times the stages: the pipeline itself knows no clock.
struct Clock {
    started: Instant,
    last: Instant,
    timing: Timing,
}

impl Clock {
    fn new() -> Self {
        let now = Instant::now();
        Self { started: now, last: now, timing: Timing::default() }
    }

    fn ended(&mut self, stage: Stage) {
        let now = Instant::now();
        let ms = (now - self.last).as_secs_f64() * 1e3;
        self.last = now;
        let t = &mut self.timing;
        let field = match stage {
            Stage::Read => &mut t.read,
            Stage::Detect => &mut t.detect,
            Stage::Decode => &mut t.decode,
            Stage::Surface => &mut t.surface,
            Stage::Contour => &mut t.contour,
            Stage::Pose => &mut t.pose,
        };
        *field = Some(field.unwrap_or(0.0) + ms);
        t.total = Some((now - self.started).as_secs_f64() * 1e3);
    }
}

/// An unreadable capture outweighs a refused one.
fn status(results: &[Measurement]) -> Status {
    let any = |wanted: fn(Verdict) -> bool| results.iter().any(|m| wanted(m.verdict));
    if any(|v| v == Verdict::Error) {
        Status::BadInput
    } else if any(|v| v != Verdict::Ok) {
        Status::Refused
    } else {
        Status::Done
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_worst_verdict_gives_the_status() {
        let of = |verdicts: &[Verdict]| {
            let result = |&v: &Verdict| Measurement::without_pose("c".into(), v, None, String::new(), Method::Points);
            status(&verdicts.iter().map(result).collect::<Vec<_>>())
        };
        assert_eq!(of(&[Verdict::Ok, Verdict::Ok]), Status::Done);
        for v in [Verdict::OutOfLimits, Verdict::TooUncertain, Verdict::NotMeasurable] {
            assert_eq!(of(&[Verdict::Ok, v]), Status::Refused);
        }
        assert_eq!(of(&[Verdict::Error, Verdict::NotMeasurable]), Status::BadInput);
    }
}
