//! The published check of the depth camera (tables 4, 5): the way from a frame on the left half of a circle board to one on
//! its right half, ten repeats; at five distances and tilts, and how the one frame is turned against the other. Out: the
//! errors per place.

use super::outcome::{Cell, Figure, Must, Outcome, Plot, Series, Table};
use super::statistics::{largest, mean, standard_deviation};
use super::{Error, Given, Progress};
use crate::calibrate::target::find;
use crate::calibrate::{Board, Lit, VerifyLimits, mean as mean_image, verify};
use crate::capture::Capture;
use crate::document;
use crate::fringe::Axis;
use crate::image::{Image, write_png};
use crate::optics::Rig;
use crate::sim::{Random, Setup, board as printed};
use rayon::prelude::*;
use std::path::PathBuf;

const BOARD: &str = "marked:8x4:60:30";
/// Column fringes, as the station measures with.
const SETS: [(Axis, u32, u32); 3] = [(Axis::Column, 1, 4), (Axis::Column, 8, 4), (Axis::Column, 64, 4)];
/// How far away the board's middle is, mm.
const DISTANCES_MM: [f64; 5] = [700.0, 725.0, 750.0, 775.0, 800.0];
/// How it is tilted about its rows and about its columns, degrees.
const TILTS_DEG: [[f64; 2]; 5] = [[0.0, 0.0], [20.0, 0.0], [-20.0, 0.0], [0.0, 20.0], [0.0, -20.0]];
const REPEATS: usize = 10;

/// One place's errors: mm along and degrees about the left frame's axes, of each repeat.
struct Found {
    mm: Vec<[f64; 3]>,
    deg: Vec<[f64; 3]>,
}

pub(super) fn run(given: &Given, progress: &dyn Progress) -> Result<Outcome, Error> {
    let rig = Setup::new(given.scale, 8).rig;
    let board: Board = BOARD.parse().expect("a board");
    let repeats = given.of(REPEATS, 2);
    let places: Vec<(f64, [f64; 2])> = if given.quick {
        vec![(DISTANCES_MM[2], TILTS_DEG[0]), (DISTANCES_MM[4], TILTS_DEG[3])]
    } else {
        DISTANCES_MM.iter().flat_map(|mm| TILTS_DEG.map(|tilt| (*mm, tilt))).collect()
    };
    progress.begin("measuring", places.len() * repeats);
    let scratch = Scratch::new()?;
    let mut found = Vec::new();
    for (k, (distance, [a, b])) in places.iter().enumerate() {
        let pose = printed::place(&board, [0.0, 0.0, *distance], [*a, *b, 0.0]);
        let electrons = printed::fringes(&rig, &board, &pose, &SETS).expect("legal sets");
        let one = |repeat: usize| -> Result<([f64; 3], [f64; 3]), Error> {
            let mut random = Random::new(given.seed, &[20, k as u64, repeat as u64]);
            let off = measured(&rig, &board, &electrons, &scratch.0.join(format!("{k}-{repeat}")), &mut random);
            progress.step();
            off
        };
        let (mm, deg) = (0..repeats).into_par_iter().map(one).collect::<Result<Vec<_>, _>>()?.into_iter().unzip();
        found.push(Found { mm, deg });
    }
    Ok(outcome(given, &places, repeats, &found))
}

/// One repeat: the images are written and read, as those of a real board are.
fn measured(
    rig: &Rig,
    board: &Board,
    electrons: &[Image<f32>],
    folder: &std::path::Path,
    random: &mut Random,
) -> Result<([f64; 3], [f64; 3]), Error> {
    let mut capture: Capture = printed::described(rig, &SETS);
    capture.folder = folder.into();
    let made = std::fs::create_dir_all(folder);
    made.map_err(|source| document::Error::Write { file: folder.into(), source })?;
    for (image, name) in electrons.iter().zip(capture.fringes.iter().flat_map(|set| &set.images)) {
        write_png(&folder.join(name), &printed::exposed(image, || random.normal()))
            .map_err(crate::capture::RecordError::from)?;
    }
    let nothing = |what: String| Error::Nothing { what };
    let seen = || -> Result<_, Error> {
        let image = mean_image(&capture).map_err(|e| nothing(e.to_string()))?;
        let sighting = find(&image, board).map_err(|e| nothing(e.to_string()))?;
        let camera = sighting.through(board, &rig.camera).seen();
        let lit = Lit::read(&capture, board, &camera).map_err(|e| nothing(e.to_string()))?;
        let lit = lit.projector(&camera, &rig.camera);
        let found = verify(rig, board, &camera, &lit, VerifyLimits::default()).map_err(|e| nothing(e.to_string()))?;
        let frames = found.frames_error_mm.zip(found.frames_error_deg);
        frames.ok_or_else(|| nothing("a half of the board is not seen".into()))
    };
    let found = seen();
    let _ = std::fs::remove_dir_all(folder); // only litter
    found
}

fn outcome(given: &Given, places: &[(f64, [f64; 2])], repeats: usize, found: &[Found]) -> Outcome {
    let mut table = Table::new(
        "By place: mean and standard deviation over the repeats",
        &["distance mm", "tilts °", "x mm", "± mm", "y mm", "± mm", "z mm", "± mm", "turned °", "± °"],
    );
    for ((distance, [a, b]), f) in places.iter().zip(found) {
        let axis = |i: usize| f.mm.iter().map(|e| e[i]).collect::<Vec<_>>();
        let mut row = vec![Cell::number(*distance, 0), Cell::text(format!("{a}, {b}"))];
        for i in 0..3 {
            row.push(Cell::number(mean(&axis(i)), 4));
            row.push(Cell::number(standard_deviation(&axis(i)), 4));
        }
        let turned = turns(f);
        row.push(Cell::number(mean(&turned), 4));
        row.push(Cell::number(standard_deviation(&turned), 4));
        table.row(row);
    }
    let all = |i: usize| found.iter().flat_map(|f| f.mm.iter().map(move |e| e[i])).collect::<Vec<_>>();
    let far: Vec<f64> = found.iter().flat_map(|f| f.mm.iter().map(|e| e[0].hypot(e[1]).hypot(e[2]))).collect();
    let turned: Vec<f64> = found.iter().flat_map(turns).collect();
    let series = ["x", "y", "z"].into_iter().enumerate().map(|(i, name)| Series {
        name: name.into(),
        points: places.iter().zip(found).flat_map(|((d, _), f)| f.mm.iter().map(move |e| (*d, e[i]))).collect(),
        joined: false,
    });
    let must = Must::AtMost(0.05);
    Outcome {
        setting: format!(
            "A printed board ({BOARD}: 8 × 4 circles, pitch 60 mm, diameter 30 mm), flat, before camera and projector of the simulated \
             station at scale {}: {} places at {} to {} mm, tilted by up to 20°, {repeats} repeats with noise of their own; the \
             calibration is exact; column fringes 1, 8, 64; seed {}.",
            given.scale,
            places.len(),
            DISTANCES_MM[0],
            DISTANCES_MM[DISTANCES_MM.len() - 1],
            given.seed
        ),
        figures: vec![
            Figure::new("largest error along x", largest(&all(0)), "mm", 4).published("1.41").must(must),
            Figure::new("largest error along y", largest(&all(1)), "mm", 4).published("1.22").must(must),
            Figure::new("largest error along z", largest(&all(2)), "mm", 4).published("0.12").must(must),
            Figure::new("largest error of the way", largest(&far), "mm", 4).must(must),
            Figure::new("largest error of the turn", largest(&turned), "°", 4),
        ],
        tables: vec![table],
        plots: vec![Plot {
            title: "Error of the way from frame to frame".into(),
            x: "distance, mm".into(),
            y: "error, mm".into(),
            series: series.collect(),
            levels: vec![-0.05, 0.05],
        }],
        ..Outcome::default()
    }
}

fn turns(f: &Found) -> Vec<f64> {
    f.deg.iter().map(|e| e[0].hypot(e[1]).hypot(e[2])).collect()
}

/// A folder that is gone afterwards.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Result<Self, Error> {
        let folder = std::env::temp_dir().join(format!("datum-study-{}", std::process::id()));
        let made = std::fs::create_dir_all(&folder);
        made.map_err(|source| document::Error::Write { file: folder.clone(), source })?;
        Ok(Self(folder))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0); // only litter
    }
}
