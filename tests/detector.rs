//! The detector on networks made by hand (tests/data/detector/make.py): what is found where, and what is refused how.

use datum::detect::{DetectError, Detector};
use datum::measure::{Measurer, Shared, measure};
use datum::{Calibration, Capture, Image, VehicleFile};
use std::path::{Path, PathBuf};
use std::sync::Arc;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/detector").join(name)
}

/// A dark image, ten times the network's input, with one bright square of a cell's size.
fn image((width, height): (usize, usize), (x, y): (usize, usize)) -> Image<u16> {
    let mut image = Image::filled(10 * width, 10 * height, 200u16);
    for row in 80 * y..80 * (y + 1) {
        image.row_mut(row)[80 * x..80 * (x + 1)].fill(3900);
    }
    image
}

#[test]
fn networks_with_the_usual_head_find_the_square_whether_or_not_the_head_is_cut() {
    for (name, size, cut) in [
        ("usual", (64, 64), true),
        ("apart", (64, 64), true),
        ("colour-wide", (96, 64), true),
        ("twisted", (64, 64), false),
    ] {
        let detector = Detector::read(&file(&format!("{name}.onnx"))).expect(name);
        assert_eq!(detector.shape().1, cut, "{name}");
        let found = detector.detect(&image(size, (3, 5)), 4095.0).expect(name);
        assert_eq!(found.len(), 1, "{name}: {found:?}");
        // a cell of 8 px from 24, 40; a stride to each side of its middle, two below, half as much again where twisted
        let by = if cut { 80.0 } else { 120.0 };
        let middle = [280.0, 440.0];
        let known = [middle[0] - by, middle[1] - by, middle[0] + by, middle[1] + 2.0 * by].map(|v| v - 0.5);
        let d = &found[0];
        assert!(d.sides.iter().zip(known).all(|(a, b)| (a - b).abs() < 0.05), "{name}: {d:?} for {known:?}");
        assert!(d.class == 0 && d.score > 0.99, "{name}: {d:?}");
        assert!(detector.detect(&Image::filled(300, 200, 50), 4095.0).expect(name).is_empty());
    }
}

#[test]
fn what_is_no_such_network_is_refused_with_its_name_and_what_is_allowed() {
    let not = std::env::temp_dir().join(format!("datum-detector-{}.onnx", std::process::id()));
    std::fs::write(&not, "no network").expect("temporary file");
    for (path, says) in [
        (not.clone(), "no ONNX file"),
        (file("no-such.onnx"), "cannot be read"),
        (file("three-classes.onnx"), "output = 1×7×84, allowed: 1×8×cells: 4 classes, point1 to point4"),
        (file("odd-size.onnx"), "input = 1×1×64×72, allowed: 1×channels×height×width: 1 or 3 channels, sides of 32 to"),
        (file("not-finite.onnx"), "a network whose output is not finite"),
        (file("any-size.onnx"), "input = 1×1×?×?, allowed: 1×channels×height×width"),
    ] {
        let Err(e) = Detector::read(&path) else { panic!("{} was read", path.display()) };
        let text = e.to_string();
        assert!(text.starts_with(&path.display().to_string()) && text.contains(says), "{text}\nfor {says}");
    }
    // no part of a network is one
    let whole = std::fs::read(file("usual.onnx")).expect("test data");
    for part in [0, 1, 100, whole.len() / 2, whole.len() - 20] {
        std::fs::write(&not, &whole[..part]).expect("temporary file");
        assert!(Detector::read(&not).is_err(), "{part} bytes of {}", whole.len());
    }
    std::fs::remove_file(&not).expect("just written");
}

#[test]
fn an_output_that_is_no_number_is_an_error() {
    let detector = Detector::read(&file("only-in-light.onnx")).expect("it works in light");
    assert!(detector.detect(&Image::filled(64, 64, 200), 255.0).is_ok());
    let e = detector.detect(&image((64, 64), (1, 1)), 4095.0).expect_err("no number");
    assert!(matches!(e, DetectError::NotFinite { .. }) && e.to_string().contains("only-in-light.onnx"), "{e}");
}

#[test]
fn a_detector_that_fails_or_finds_nothing_leaves_the_measurement_as_it_is_without_one() {
    let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
    let capture = Capture::open(&station.join("moved")).expect("test data");
    let result = |detector: Option<&str>| {
        let calibration = Calibration::read(&station.join("calibration.toml")).expect("test data");
        let vehicle = VehicleFile::read(&station.join("vehicle/suv-a.toml")).expect("test data");
        let detector = detector.map(|name| Arc::new(Detector::read(&file(name)).expect(name)));
        let measurer =
            Measurer::new(calibration, vehicle).expect("test data").sharing(&Shared { detector, ..Shared::default() });
        measure(&measurer, &capture, &mut |_| ()).expect("test data").0
    };
    let without = result(None);
    assert!(without.warning.is_none() && without.features.iter().all(|f| f.region.as_deref() == Some("search")));
    let failed = result(Some("only-in-light.onnx"));
    let warning = failed.warning.clone().expect("it failed");
    assert!(warning.contains("only-in-light.onnx: the network's output is not finite"), "{warning}");
    for with in [failed, result(Some("usual.onnx"))] {
        assert_eq!(datum::measure::json(&[with]), datum::measure::json(std::slice::from_ref(&without)));
    }
}
