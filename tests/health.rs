//! Whether a rig that no longer stands as calibrated shows on the very next vehicle: captures by a renderer, measured
//! with calibrations that were bumped in memory. Runs where DATUM_DATA names a folder with `station/` and
//! `station-boards/`: `DATUM_DATA=../shared/data cargo test --release --test health -- --nocapture`

#![expect(clippy::print_stdout, reason = "tables to read are half of what this is for")]

mod common;

use common::{Set, TAUGHT, data};
use datum::calibrate::{Health, MAX_INDEX, ParameterCovariance};
use datum::fringe::{
    Axis, DepthMap, Limits, NoiseLaw, PatternSet, PhaseMap, Rays, Stack, decode, epipolar_cells, unwrap,
};
use datum::image::Window;
use datum::measure::{Measurement, Verdict};
use datum::{Calibration, Capture, Point3, Rig, VehicleFile, frame};
use nalgebra::{Rotation3, Vector3};
use rayon::prelude::*;

const ROWS: &str = "rows-white-rnd_07";

/// The camera turned about one of its own axes.
fn turned(rig: &Rig, axis: usize, deg: f64) -> Rig {
    let mut out = rig.clone();
    out.projector_from_camera.r *= Rotation3::new(Vector3::ith(axis, deg.to_radians()));
    out
}

fn stretched(rig: &Rig, by: Vector3<f64>) -> Rig {
    let mut out = rig.clone();
    out.projector_from_camera.t.component_mul_assign(&by);
    out
}

/// What is wrong in the contract's sense with a pose, if anything.
fn wrong(m: &Measurement, set: &Set, model: &VehicleFile, at_targets: bool) -> Option<String> {
    let truth = set.truth(ROWS);
    let (error, motion) = (truth.error(m)?, truth.motion(m)?);
    let (mm, yaw) = (error.fixed_rows::<3>(0).norm(), error[5].to_degrees());
    if mm > 0.5 || yaw.abs() > 0.15 {
        return Some(format!("{mm:.2} mm, {yaw:.3}°"));
    }
    let stated = &m.uncertainty_k2.as_ref().expect("with the pose").targets;
    model.targets.iter().zip(stated).filter(|_| at_targets).find_map(|(t, u)| {
        let at = Point3::<frame::Vehicle>::new(t.position_mm.into());
        let off = ((motion * at) - at).norm();
        (off > 2.0 * u.mm).then(|| format!("{} {off:.2} mm, U {:.2} mm", t.name, u.mm))
    })
}

#[test]
fn a_bumped_rig_shows_on_the_next_vehicle() {
    let Some(folder) = data("station") else { return };
    let set = Set::open(folder);
    let features = VehicleFile::read(&set.folder.join(TAUGHT).join("features.toml")).expect("features");
    let taught = set.teach(TAUGHT, &features);
    let rig = &set.calibration.rig;
    let mut cases = vec![("as calibrated".to_string(), rig.clone(), false)];
    for deg in [0.02, -0.02, 0.05, -0.05, 0.01, -0.01, 0.005, -0.005, 0.002, -0.002] {
        for (axis, name) in ["x", "y", "z"].iter().enumerate() {
            cases.push((format!("camera {deg:+}° about {name}"), turned(rig, axis, deg), deg.abs() >= 0.02));
        }
    }
    for by in [1.001, 0.999, 1.0005, 0.9995] {
        let must = f64::abs(by - 1.0) > 0.0009;
        cases.push((format!("baseline × {by}"), stretched(rig, Vector3::repeat(by)), must));
        cases.push((format!("tx × {by}"), stretched(rig, Vector3::new(by, 1.0, 1.0)), must));
    }
    let measured: Vec<Measurement> = cases
        .par_iter()
        .enumerate()
        .map(|(k, (_, rig, _))| {
            let calibration = Calibration { rig: rig.clone(), ..set.calibration.clone() };
            let bumped = Set { folder: set.folder.clone(), calibration };
            bumped.measure(&bumped.measurer(&taught, &format!("health-{k}")), ROWS).0
        })
        .collect();
    let health = |m: &Measurement| m.calibration_health.clone().expect("there are row fringes");
    let healthy = health(&measured[0]);
    assert!(healthy.healthy && measured[0].verdict == Verdict::Ok, "{}", healthy.detail);
    println!("{:24} {:>6} {:>7} {:>17}  verdict", "", "index", "px", "scale %");
    let mut missed = Vec::new();
    for ((name, _, must), m) in cases.iter().zip(&measured) {
        let h = health(m);
        let scale = h.scale_percent.zip(h.scale_sigma_percent);
        let scale = scale.map_or("–".into(), |(s, sigma)| format!("{s:+.3} ± {sigma:.3}"));
        let (verdict, code) = (m.verdict.name(), m.code.map_or(0, |c| c.number()));
        println!("{name:24} {:6.1} {:7.3} {scale:>17}  {verdict} {code}", h.index, h.epipolar_px);
        if *must && (h.healthy || h.index - healthy.index < 3.0) {
            missed.push(format!("{name}: {}", h.detail));
        }
        // a baseline that is off by less than one vehicle shows is for the calibration's covariance to state
        let at_targets = *must || !h.healthy || name.starts_with("camera");
        if let Some(why) = wrong(m, &set, &taught.model, at_targets).filter(|_| m.verdict == Verdict::Ok) {
            missed.push(format!("{name}: a wrong pose called ok, {why}"));
        }
    }
    println!("{}", healthy.detail);
    println!("{}", health(&measured[3]).detail);
    assert!(missed.is_empty(), "{missed:#?}");
}

/// Any surface will do: boards, near and oblique, under their exact calibration.
#[test]
fn an_exact_calibration_is_healthy_on_boards() {
    let Some(folder) = data("station-boards/chess") else { return };
    let calibration = Calibration::read(&folder.join("calibration-truth.toml")).expect("a calibration");
    let board = |k: usize| {
        let capture = Capture::open(&folder.join(format!("board_chess_cal_{k:02}"))).expect("a capture");
        let bumped = [0, 1, 2].map(|axis| {
            let rig = turned(&calibration.rig, axis, 0.02);
            of_board(&Calibration { rig, ..calibration.clone() }, &capture).index
        });
        (capture.name(), of_board(&calibration, &capture), bumped)
    };
    let found: Vec<_> = (0..10).into_par_iter().map(board).collect();
    for (name, health, bumped) in &found {
        println!("{name}: {}; camera +0.02° about x, y, z: {bumped:.1?}", health.detail);
    }
    assert!(found.iter().all(|(_, health, _)| health.healthy));
    // a small or oblique board sees less of a turn about y than a body
    assert!(found.iter().all(|(_, _, bumped)| bumped[0] > MAX_INDEX && bumped[2] > MAX_INDEX && bumped[1] > 1.5));
}

fn of_board(calibration: &Calibration, capture: &Capture) -> Health {
    let window = Window::whole(capture.camera.width, capture.camera.height);
    let calibration = calibration
        .for_sizes((window.width, window.height), (capture.projector.width, capture.projector.height), true)
        .expect("one camera");
    let limits = Limits::default();
    let maps: Vec<PhaseMap> = capture
        .fringes
        .iter()
        .map(|set| {
            let noise = NoiseLaw::from_sensor(set.gain_dn_per_e.unwrap_or(0.032), 6.0, capture.camera.black_level);
            let pattern = PatternSet::new(set.axis, set.count, set.steps).expect("legal");
            let mut sums = Stack::new(pattern, 255, &[window]).expect("legal");
            for (step, image) in (0u32..).zip(&set.images) {
                sums.add(step, &capture.load(image).expect("an image")).expect("fits");
            }
            decode(&sums, &noise, &limits).expect("complete").remove(0)
        })
        .collect();
    let columns = unwrap(&maps, Axis::Column, capture.projector.width, &limits).expect("absolute");
    let rays = Rays::new(&calibration.rig.camera, window);
    let depth = DepthMap::new(&calibration.rig, &rays, &columns);
    let rows = maps.iter().filter(|m| m.set.axis == Axis::Row).max_by_key(|m| m.set.count).expect("row fringes");
    let cells = epipolar_cells(&calibration.rig, &depth, rows);
    Health::new(&calibration, &ParameterCovariance::zeros(), Axis::Column, &cells, &[]).expect("enough cells")
}
