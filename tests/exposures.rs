//! High-dynamic-range stacks: paint that mirrors the projector into a feature's region is measured where fringes were also
//! taken with a shorter exposure.

#![expect(clippy::print_stdout, reason = "a table to read is half of what this is for")]

mod common;

use common::pose;
use datum::capture::{self, Devices, Plan, SETS, pictures, record};
use datum::fringe::Axis;
use datum::hal::{Camera, Pool, Projector};
use datum::image::write_png;
use datum::measure::{Measurement, Measurer, Verdict, measure, teach};
use datum::sim::{self, Body, Deviation, Paint, Scene, Script, Setup, Station};
use datum::{Capture, Image, Point3, Pose, frame};
use nalgebra::{Vector3, Vector6};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("exposures").join(name)
}

fn recorded(station: &Station, folder: &Path) -> Capture {
    let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
    let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
    record(&mut devices, &Plan { repeat: false, ..Plan::default() }, folder).expect("devices work")
}

/// The capture with all its sets once more, exposed `share` times as long.
fn with_exposure(station: &Station, capture: &Capture, share: f64) -> Capture {
    let (mut camera, mut projector) = (station.camera(), station.projector());
    let (width, height) = projector.size();
    projector.load(&pictures(&SETS, width, height).expect("the usual sets")).expect("they fit");
    let mut out = capture.clone();
    let mut shown = 0;
    for set in &capture.fringes {
        let ms = set.exposure_ms.expect("it was recorded");
        let taken = camera.set_exposure(Duration::from_secs_f64(ms * share / 1e3)).expect("in range");
        camera.set_gain(1.0).expect("the least");
        let mut again = set.clone();
        again.exposure_ms = Some(taken.as_secs_f64() * 1e3);
        for file in &mut again.images {
            projector.show(Some(shown)).expect("loaded");
            shown += 1;
            let mut image = Pool::new(camera.sensor(), 1).take().expect("one");
            camera.grab(Duration::from_secs(1), &mut image).expect("an image");
            let pixels = image.pixels.iter().map(|v| u8::try_from(*v).expect("eight bits")).collect();
            *file = format!("short-{}", file.display()).into();
            let image = Image { width: image.width, height: image.height, pixels };
            write_png(&capture.folder.join(&*file), &image).expect("writable");
        }
        out.fringes.push(again);
    }
    projector.show(None).expect("off");
    out.write().expect("a capture");
    Capture::open(&capture.folder).expect("just written")
}

fn error(m: &Measurement, truth: &Pose<frame::Camera, frame::Vehicle>) -> Option<Vector6<f64>> {
    let motion: Pose<frame::Vehicle, frame::Vehicle> = truth.inverse() * pose(m)?;
    let at = Point3::new(Vector3::from(m.covariance_at_mm?));
    let (t, r) = ((motion * at) - at, motion.r.scaled_axis());
    Some(Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z))
}

#[test]
fn glare_in_a_region_is_measured_with_a_second_exposure() {
    let setup = Arc::new(Setup::new(0.25, 8));
    let body = Body::named("suv-a").expect("listed");
    let calibration = sim::calibration(&setup);
    let white = Paint::named("white").expect("listed");
    let features = sim::features(&Scene::new(body.clone(), white, &Deviation::default()), &setup).expect("in view");
    let stands = (body.clone(), white, Deviation::default());
    let station = Station::with_vehicle(Arc::clone(&setup), 1, stands, Script::default());
    let taught = teach(&recorded(&station, &folder("taught")), &calibration, &features, "model").expect("teaches");
    for (feature, template) in taught.model.features.iter().zip(&taught.templates) {
        let file = folder("taught").join(feature.template.as_ref().expect("taught"));
        std::fs::write(file, template.to_bytes()).expect("writable");
    }
    let file = folder("taught").join("model.toml");
    taught.model.write(&file).expect("writable");
    let measurer = Measurer::new(calibration, datum::VehicleFile::read(&file).expect("just written")).expect("good");
    let probe: Vec<(String, f64)> = match std::env::var("PROBE") {
        Ok(list) => list
            .split(',')
            .map(|p| {
                let (a, b) = p.split_once(':').unwrap();
                (a.to_string(), b.parse().unwrap())
            })
            .collect(),
        Err(_) => vec![("silver".into(), 2.0), ("black".into(), 2.0)],
    };
    for (name, yaw_deg) in probe {
        let paint = Paint::named(&name).expect("listed");
        let deviation = Deviation { yaw_deg, ..Deviation::default() };
        let station = Station::with_vehicle(Arc::clone(&setup), 2, (body.clone(), paint, deviation), Script::default());
        let truth = station.truth().expect("it stands there");
        let once = recorded(&station, &folder(&name));
        let single = measure(&measurer, &once, &mut |_| ()).expect("readable").0;
        let both = with_exposure(&station, &once, 0.125);
        let stack = measure(&measurer, &both, &mut |_| ()).expect("readable").0;
        for (what, m) in [("one exposure", &single), ("two", &stack)] {
            println!(
                "{name:6} yaw {yaw_deg:+.1} {what:12} {:14} coverage {:?} {:.3?} U {:.3?} {}",
                m.verdict.name(),
                m.depth_coverage,
                error(m, &truth).map(|e| [e[0], e[1], e[2], e[3].to_degrees(), e[4].to_degrees(), e[5].to_degrees()]),
                m.uncertainty_k2.as_ref().map(|u| (u.x_mm, u.yaw_deg)),
                m.detail
            );
        }
    }
    let _ = (Verdict::Ok, Axis::Column, capture::FILE);
}
