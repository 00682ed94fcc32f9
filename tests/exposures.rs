//! High-dynamic-range stacks: paint that mirrors the projector into a feature's region is measured where fringes were also
//! taken with a shorter exposure.

#![expect(clippy::print_stdout, reason = "a table to read is half of what this is for")]

mod common;

use datum::capture::{Devices, FringeSet, Plan, SETS, pictures, record};
use datum::hal::{Camera, Pool, Projector};
use datum::image::write_png;
use datum::measure::{Measurement, Measurer, Verdict, measure, teach};
use datum::sim::{self, Body, Deviation, Paint, Scene, Script, Setup, Station};
use datum::study::error::pose;
use datum::{Capture, Image, Point3, Pose, frame};
use nalgebra::{Vector3, Vector6};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// At 1.2 mm per pixel and with another paint than the taught one, mm.
const OFF_MM: f64 = 0.2;

fn folder(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR")).join("exposures").join(name)
}

fn recorded(station: &Station, folder: &Path) -> Capture {
    let (mut camera, mut projector, mut bars) = (station.camera(), station.projector(), station.bars());
    let mut devices = Devices { camera: &mut camera, projector: &mut projector, bars: &mut bars };
    record(&mut devices, &Plan { repeat: false, ..Plan::default() }, folder).expect("devices work")
}

/// All sets of the capture once more, exposed `share` times as long; the files begin with `name`.
fn again(station: &Station, capture: &Capture, share: f64, name: &str) -> Vec<FringeSet> {
    let (mut camera, mut projector) = (station.camera(), station.projector());
    let (width, height) = projector.size();
    projector.load(&pictures(&SETS, width, height).expect("the usual sets")).expect("they fit");
    let mut sets = capture.fringes.clone();
    let mut shown = 0..;
    for set in &mut sets {
        let wanted = Duration::from_secs_f64(set.exposure_ms.expect("it was recorded") * share / 1e3);
        set.exposure_ms = Some(camera.set_exposure(wanted).expect("in range").as_secs_f64() * 1e3);
        for file in &mut set.images {
            projector.show(shown.next()).expect("loaded");
            let mut image = Pool::new(camera.sensor(), 1).take().expect("one");
            camera.grab(Duration::from_secs(1), &mut image).expect("an image");
            let pixels = image.pixels.iter().map(|v| u8::try_from(*v).expect("eight bits")).collect();
            *file = format!("{name}-{}", file.display()).into();
            let image = Image { width: image.width, height: image.height, pixels };
            write_png(&capture.folder.join(&*file), &image).expect("writable");
        }
    }
    projector.show(None).expect("off");
    sets
}

fn error(m: &Measurement, truth: &Pose<frame::Camera, frame::Vehicle>) -> Option<Vector6<f64>> {
    let motion: Pose<frame::Vehicle, frame::Vehicle> = truth.inverse() * pose(m)?;
    let at = Point3::new(Vector3::from(m.covariance_at_mm?));
    let (t, r) = ((motion * at) - at, motion.r.scaled_axis());
    Some(Vector6::new(t.x, t.y, t.z, r.x, r.y, r.z))
}

/// A capture's fringes as metered, with a shorter exposure beside them, and exposed far too long.
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
    for paint in ["silver", "black"] {
        // so that the projector's mirror image lies on a corner's region
        let deviation = Deviation { yaw_deg: -3.0, ..Deviation::default() };
        let stands = (body.clone(), Paint::named(paint).expect("listed"), deviation);
        let station = Station::with_vehicle(Arc::clone(&setup), 2, stands, Script::default());
        let truth = station.truth().expect("it stands there");
        let measured = |capture: &Capture, what: &str| {
            let m = measure(&measurer, capture, &mut |_| ()).expect("readable").0;
            let mm = error(&m, &truth).map(|e| e.fixed_rows::<3>(0).norm());
            println!(
                "{paint:6} {what:22} {:14} coverage {:?}, off {mm:.3?} mm {}",
                m.verdict.name(),
                m.depth_coverage,
                m.detail
            );
            (m, mm)
        };
        let once = recorded(&station, &folder(paint));
        let short = again(&station, &once, 0.125, "short");
        let long = again(&station, &once, 4.0, "long");
        let stack = |sets: &[&[FringeSet]]| Capture { fringes: sets.concat(), ..once.clone() };

        // as metered, some of the mirror image is saturated; a shorter exposure shows it, too
        let (single, _) = measured(&once, "as metered");
        let (both, mm) = measured(&stack(&[&once.fringes, &short]), "with a short one");
        assert_eq!(both.verdict, Verdict::Ok, "{paint}: {}", both.detail);
        assert!(both.depth_coverage > single.depth_coverage && mm.is_some_and(|mm| mm < OFF_MM), "{paint}: {mm:?} mm");

        // exposed for the dark, more of the panel is, or all of it
        let (dark, _) = measured(&stack(&[&long]), "four times as long");
        let (both, mm) = measured(&stack(&[&long, &short]), "that with a short one");
        assert!(dark.verdict == Verdict::NotMeasurable || dark.depth_coverage < both.depth_coverage, "{paint}");
        assert_eq!(both.verdict, Verdict::Ok, "{paint}: {}", both.detail);
        assert!(mm.is_some_and(|mm| mm < OFF_MM), "{paint}: {mm:?} mm");
    }
}
