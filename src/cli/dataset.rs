//! `datum dataset`: labelled images to train a detector with.

use super::{Status, print};
use crate::capture::Capture;
use crate::dataset::{Captured, Folder, Labelled, Row, Split, captured, view};
use crate::detect::{self, Detector};
use crate::document::Check;
use crate::measure::Measurer;
use crate::sim::Setup;
use crate::{Calibration, VehicleFile};
use anyhow::Context;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

#[derive(Debug, clap::Args)]
pub(super) struct Arguments {
    /// The folder to write into: train, val, test with images and labels; dataset.yaml, bodies.csv
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How many images
    #[arg(long, alias = "images", value_name = "N", default_value_t = 4000, conflicts_with = "from")]
    count: usize,
    /// What everything random is drawn from
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Size of the images, of the camera's shape
    #[arg(long, value_name = "WxH", default_value = "648x486")]
    size: String,
    /// Share of images without a vehicle
    #[arg(long, value_name = "SHARE", default_value_t = 0.1, conflicts_with = "from")]
    empty: f64,
    /// Share of hard images: features hidden by about half, halls with outlines like a flap's
    #[arg(long, value_name = "SHARE", default_value_t = 0.0, conflicts_with = "from")]
    hard: f64,
    /// Labels these captures, as far as they are measured ok, instead of drawing images
    #[arg(long, value_name = "CAPTURE", num_args = 1.., requires_all = ["calibration", "vehicle"])]
    from: Vec<PathBuf>,
    /// With --from: the calibration of camera and projector
    #[arg(long, value_name = "FILE", requires = "from")]
    calibration: Option<PathBuf>,
    /// With --from: the vehicle model
    #[arg(long, value_name = "FILE", requires = "from")]
    vehicle: Option<PathBuf>,
}

/// More would be a slip of the finger.
const MAX_IMAGES: usize = 1_000_000;
/// The camera's full width and height.
const FULL: [f64; 2] = [2592.0, 1944.0];

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let check = Check(Path::new("datum dataset"));
    check.within("--count", a.count, 1..=MAX_IMAGES)?;
    check.within("--empty", a.empty, 0.0..=1.0)?;
    check.within("--hard", a.hard, 0.0..=1.0)?;
    let scale = scale(&a.size, check)?;
    let folder = Folder::create(&a.out)?;
    let rows = if let (Some(calibration), Some(vehicle)) = (&a.calibration, &a.vehicle) {
        let (calibration, vehicle) = (Calibration::read(calibration)?, VehicleFile::read(vehicle)?);
        from_captures(a, &folder, &calibration, &vehicle, (scale * FULL[0]).round() as usize)?
    } else {
        drawn(a, &folder, scale)?
    };
    folder.finish(&rows)?;
    let of = |split| rows.iter().filter(|r| r.split == split).count();
    let [train, val, test] = Split::ALL.map(of);
    print(&format!("{}: {train} images to train with, {val} to validate, {test} to test\n", a.out.display()))?;
    Ok(if rows.is_empty() { Status::Refused } else { Status::Done })
}

/// Images of random bodies in the simulated station.
fn drawn(a: &Arguments, folder: &Folder, scale: f64) -> anyhow::Result<Vec<Row>> {
    let done = AtomicUsize::new(0);
    let one = |setup: &mut Setup, number: usize| -> anyhow::Result<Row> {
        let view = view(setup, a.seed, number as u64, a.empty, a.hard);
        let (name, split) = (format!("{number:05}"), Split::of(number as u64));
        folder.add(split, &name, &view.image, &view.boxes).with_context(|| format!("image {name}"))?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        if done.is_multiple_of(100) || done == a.count {
            eprintln!("{done} of {}", a.count);
        }
        let body = view.body.map_or_else(String::new, |seed| seed.to_string());
        let paint = view.paint.unwrap_or_default().into();
        Ok(Row { image: name, split, body, paint, features: shares(&view.boxes), kind: view.kind.name().into() })
    };
    (0..a.count).into_par_iter().map_init(|| Setup::new(scale, 8).red_only(), one).collect()
}

/// Stored captures, labelled by what was measured. Those of one vehicle, where its VIN is known, stay together.
fn from_captures(
    a: &Arguments,
    folder: &Folder,
    calibration: &Calibration,
    vehicle: &VehicleFile,
    width: usize,
) -> anyhow::Result<Vec<Row>> {
    let detector = Detector::named(Path::new(detect::DEFAULT))?;
    let mut measurer: Option<([(usize, usize); 2], Measurer)> = None;
    let mut rows = Vec::new();
    for (number, path) in a.from.iter().enumerate() {
        let capture = Capture::open(path)?;
        let (c, p) = (&capture.camera, &capture.projector);
        let sizes = [(c.width, c.height), (p.width, p.height)];
        if measurer.as_ref().is_none_or(|(of, _)| *of != sizes) {
            let fitting = calibration.for_sizes(sizes[0], sizes[1], false);
            let fitting = fitting.with_context(|| capture.file().display().to_string())?;
            measurer = Some((sizes, Measurer::new(fitting, vehicle.clone())?.with_detector(detector.clone())));
        }
        let Some((_, measurer)) = &measurer else { continue };
        match captured(measurer, &capture, width)? {
            Captured::LeftOut(why) => eprintln!("{}: left out: {why}", path.display()),
            Captured::Labelled { image, boxes } => {
                let body =
                    capture.conditions.vin.clone().filter(|vin| !vin.is_empty()).unwrap_or_else(|| capture.name());
                let (name, split) = (format!("{number:05}"), Split::of_name(&body));
                folder.add(split, &name, &image, &boxes)?;
                let (paint, kind) = (String::new(), "capture".into());
                rows.push(Row { image: name, split, body, paint, features: shares(&boxes), kind });
            }
        }
    }
    Ok(rows)
}

/// Of each box, its class and how much of it can be seen.
fn shares(boxes: &[Labelled]) -> Vec<(usize, f64)> {
    boxes.iter().map(|b| (b.class, b.visible)).collect()
}

/// Of the camera's image, from a size like 648x486.
fn scale(size: &str, check: Check) -> anyhow::Result<f64> {
    let sides = size.split_once('x').and_then(|(w, h)| Some([w.parse::<f64>().ok()?, h.parse::<f64>().ok()?]));
    let scale = sides.filter(|[w, h]| (0.1..=1.0).contains(&(w / FULL[0])) && (h - w * FULL[1] / FULL[0]).abs() < 0.6);
    check.that(scale.is_some(), "--size", size, "4:3, from 260x195 to 2592x1944")?;
    Ok(scale.map_or(1.0, |[w, _]| w / FULL[0]))
}
