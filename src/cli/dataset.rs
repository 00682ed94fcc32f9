//! `datum dataset`: labelled images to train a detector with.

use super::{Status, print};
use crate::dataset::{Folder, Row, Split, view};
use crate::document::Check;
use crate::sim::Setup;
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
    #[arg(long, alias = "images", value_name = "N", default_value_t = 4000)]
    count: usize,
    /// What everything random is drawn from
    #[arg(long, value_name = "SEED", default_value_t = 1)]
    seed: u64,
    /// Size of the images, of the camera's shape
    #[arg(long, value_name = "WxH", default_value = "648x486")]
    size: String,
    /// Share of images without a vehicle
    #[arg(long, value_name = "SHARE", default_value_t = 0.1)]
    empty: f64,
}

/// More would be a slip of the finger.
const MAX_IMAGES: usize = 1_000_000;
/// The camera's full width and height.
const FULL: [f64; 2] = [2592.0, 1944.0];

pub(super) fn run(a: &Arguments) -> anyhow::Result<Status> {
    let check = Check(Path::new("datum dataset"));
    check.within("--count", a.count, 1..=MAX_IMAGES)?;
    check.within("--empty", a.empty, 0.0..=1.0)?;
    let scale = scale(&a.size, check)?;
    let folder = Folder::create(&a.out)?;
    let done = AtomicUsize::new(0);
    let one = |setup: &mut Setup, number: usize| -> anyhow::Result<Row> {
        let view = view(setup, a.seed, number as u64, a.empty);
        let (name, split) = (format!("{number:05}"), Split::of(number as u64));
        folder.add(split, &name, &view.image, &view.boxes).with_context(|| format!("image {name}"))?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        if done.is_multiple_of(100) || done == a.count {
            eprintln!("{done} of {}", a.count);
        }
        let (body, needed) = view.body.map_or((String::new(), Vec::new()), |(seed, c)| (seed.to_string(), c));
        let paint = view.paint.unwrap_or_default().into();
        Ok(Row { image: name, split, body, paint, needed, kind: view.kind.name().into() })
    };
    let rows: anyhow::Result<Vec<Row>> =
        (0..a.count).into_par_iter().map_init(|| Setup::new(scale, 8).red_only(), one).collect();
    let rows = rows?;
    folder.finish(&rows)?;
    let of = |split| rows.iter().filter(|r| r.split == split).count();
    let [train, val, test] = Split::ALL.map(of);
    print(&format!("{}: {train} images to train with, {val} to validate, {test} to test\n", a.out.display()))?;
    Ok(Status::Done)
}

/// Of the camera's image, from a size like 648x486.
fn scale(size: &str, check: Check) -> anyhow::Result<f64> {
    let sides = size.split_once('x').and_then(|(w, h)| Some([w.parse::<f64>().ok()?, h.parse::<f64>().ok()?]));
    let scale = sides.filter(|[w, h]| (0.1..=1.0).contains(&(w / FULL[0])) && (h - w * FULL[1] / FULL[0]).abs() < 0.6);
    check.that(scale.is_some(), "--size", size, "4:3, from 260x195 to 2592x1944")?;
    Ok(scale.map_or(1.0, |[w, _]| w / FULL[0]))
}
