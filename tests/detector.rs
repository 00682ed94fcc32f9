//! The detector on networks made by hand (tests/data/detector/make.py): what is found where, and what is refused how; and
//! what the one that comes with the program makes of images that it was not trained on. Where DATUM_DATA names the folder of
//! the independent captures those are looked at, too:
//! `DATUM_DATA=../shared/data cargo test --release --test detector -- --nocapture`

#![expect(clippy::print_stdout, reason = "tables to read are half of what this is for")]

mod common;

use common::{data, detector};

use datum::dataset::view;
use datum::detect::{DEFAULT, DetectError, Detection, Detector};
use datum::image::{read_png, read_png_header};
use datum::measure::{Measurer, Verdict, measure};
use datum::sim::Setup;
use datum::station::StationFile;
use datum::{Calibration, Capture, Image, VehicleFile};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What the truth of the independent captures calls the classes' features.
const IN_TRUTH: [&str; 4] = ["corner1_virtual", "corner2_virtual", "cap_centre", "arch_top"];
/// A region's middle is beside the feature by so much of the image's width, at most: five of the network's pixels, a sixth of
/// a box about an arch's top, along which nothing ends.
const BESIDE: f64 = 5.0 / 320.0;
/// Known shortfall: a fringe pattern on one chessboard is taken for a corner (models/CARD.md). Measuring gives the detector no
/// fringe images.
const KNOWN: &str = "board_chess_cal_08/fringe-09.png";

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
fn the_network_that_comes_with_the_program_finds_a_vehicles_features_and_nothing_in_a_hall() {
    let detector = Detector::named(Path::new(DEFAULT)).expect("it comes with the program").expect("a network");
    assert!(detector.shape().1, "its head is cut");
    let mut setup = Setup::new(0.125, 8).red_only();
    for number in 0..5 {
        let hall = view(&mut setup, 1, number, 1.0, 0.0).image;
        let levels = hall.pixels.iter().map(|v| u16::from(*v)).collect();
        let hall = Image { width: hall.width, height: hall.height, pixels: levels };
        assert_eq!(detector.detect(&hall, 255.0).expect("it runs"), [], "hall {number}");
    }
    let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
    let calibration = Calibration::read(&station.join("calibration.toml")).expect("test data");
    let vehicle = VehicleFile::read(&station.join("vehicle/suv-a.toml")).expect("test data");
    let measurer = Measurer::new(calibration, vehicle).expect("test data").with_detector(Some(detector));
    let capture = Capture::open(&station.join("moved")).expect("test data");
    let measured = measure(&measurer, &capture, &mut |_| ()).expect("test data").0;
    let regions: Vec<_> = measured.features.iter().map(|f| f.region).collect();
    assert_eq!((measured.verdict, regions), (Verdict::Ok, vec![Some("detector"); 4]), "{}", measured.detail);
}

#[test]
fn a_station_takes_that_network_unless_its_file_names_another_or_none() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("detector-of-a-station");
    std::fs::create_dir_all(&folder).expect("the target folder is writable");
    std::fs::copy(file("usual.onnx"), folder.join("other.onnx")).expect("writable");
    let shape = |line: &str| {
        let config = folder.join("station.toml");
        std::fs::write(&config, format!("format = 1\n{line}\n")).expect("writable");
        let detector = StationFile::read(&config).expect("a configuration").read_detector();
        detector.map(|d| d.map(|d| d.shape().0)).map_err(|e| e.to_string())
    };
    assert_eq!(shape(""), Ok(Some([1, 256, 320])));
    assert_eq!(shape("detector = \"other.onnx\""), Ok(Some([1, 64, 64])));
    assert_eq!(shape("detector = \"none\""), Ok(None));
    let refused = shape("detector = \"no.onnx\"").expect_err("no such file");
    assert!(refused.starts_with(&folder.join("no.onnx").display().to_string()), "{refused}");
}

#[test]
fn a_detector_that_fails_or_finds_nothing_leaves_the_measurement_as_it_is_without_one() {
    let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
    let capture = Capture::open(&station.join("moved")).expect("test data");
    let result = |detector: Option<&str>| {
        let calibration = Calibration::read(&station.join("calibration.toml")).expect("test data");
        let vehicle = VehicleFile::read(&station.join("vehicle/suv-a.toml")).expect("test data");
        let detector = detector.map(|name| Arc::new(Detector::read(&file(name)).expect(name)));
        let measurer = Measurer::new(calibration, vehicle).expect("test data").with_detector(detector);
        measure(&measurer, &capture, &mut |_| ()).expect("test data").0
    };
    let without = result(None);
    assert!(without.warning.is_none() && without.features.iter().all(|f| f.region == Some("search")));
    let failed = result(Some("only-in-light.onnx"));
    let warning = failed.warning.clone().expect("it failed");
    assert!(warning.contains("only-in-light.onnx: the network's output is not finite"), "{warning}");
    for with in [failed, result(Some("usual.onnx"))] {
        assert_eq!(datum::measure::json(&[with]), datum::measure::json(std::slice::from_ref(&without)));
    }
}

#[test]
fn another_renderers_vehicles_have_all_their_regions() {
    let detector = detector().expect("a network");
    for folder in ["station", "station-sedan"].map(data).into_iter().flatten() {
        let mut captures = folders(&folder);
        captures.retain(|c| c.join("truth.json").exists());
        assert!(captures.len() >= 2, "{}", folder.display());
        for capture in captures {
            let text = std::fs::read_to_string(capture.join("truth.json")).expect("there");
            let truth: serde_json::Value = serde_json::from_str(&text).expect("JSON");
            let (image, white) = image_of(&capture.join("red.png"));
            let found = detector.detect(&image, white).expect("it runs");
            print!("{:18}", capture.file_name().unwrap_or_default().display());
            for (class, name) in IN_TRUTH.iter().enumerate() {
                let feature = &truth["features"][name];
                let of_class: Vec<_> = found.iter().filter(|d| d.class == class).collect();
                if feature["in_image"] != true {
                    assert!(of_class.is_empty(), "{}: {name} is not there: {of_class:?}", capture.display());
                    continue;
                }
                let at = [0, 1].map(|i| feature["pixel"][i].as_f64().expect("a number"));
                let off = |d: &Detection| {
                    let middle = [0, 1].map(|i| 0.5 * (d.sides[i] + d.sides[i + 2]));
                    (middle[0] - at[0]).hypot(middle[1] - at[1])
                };
                let [one] = of_class[..] else { panic!("{}: {name}: {of_class:?}", capture.display()) };
                print!("  {name} {:.2} {:4.1} px", one.score, off(one));
                assert!(off(one) < BESIDE * image.width as f64, "{}: {name}: {one:?}", capture.display());
            }
            println!();
        }
    }
}

#[test]
fn boards_and_a_bench_without_a_vehicle_have_no_region() {
    let detector = detector().expect("a network");
    for folder in ["station-boards", "slstudio"].map(data).into_iter().flatten() {
        let below = folders(&folder).into_iter().flat_map(|f| [folders(&f), vec![f]].concat());
        let images: Vec<PathBuf> = below
            .flat_map(|f| std::fs::read_dir(f).expect("a folder").flatten().map(|e| e.path()).collect::<Vec<_>>())
            .filter(|p| p.extension().is_some_and(|e| e == "png"))
            .collect();
        assert!(images.len() >= 50, "{} in {}", images.len(), folder.display());
        println!("{}: {} images", folder.display(), images.len());
        for file in images {
            let (image, white) = image_of(&file);
            let found = detector.detect(&image, white).expect("it runs");
            if file.ends_with(KNOWN) {
                println!("known: {KNOWN}: {found:?}");
                continue;
            }
            assert_eq!(found, [], "{}", file.display());
        }
    }
}

/// Folders in a folder, by name.
fn folders(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder").flatten().map(|e| e.path());
    let mut all: Vec<PathBuf> = entries.filter(|p| p.is_dir()).collect();
    all.sort();
    all
}

/// An image, and the level of white.
fn image_of(file: &Path) -> (Image<u16>, f64) {
    let bits = read_png_header(file).expect("a PNG").bits;
    (read_png(file).expect("a PNG"), if bits > 8 { 65535.0 } else { 255.0 })
}
