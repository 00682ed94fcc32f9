//! What is wrong with an input is said in a sentence that names file, key and value, with exit status 2; the
//! program never panics. Driven through the built program, over small files made here.

use datum::image::{Image, write_png, write_png_rgb};
use datum::{Calibration, Capture, VehicleFile};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const CAPTURE: &str = r#"format = 1
taken_at = "2026-11-22T05:00:00Z"
[camera]
width = 64
height = 48
bits = 8
black_level = 2.0
[images]
red = "red.png"
[projector]
width = 64
height = 40
[[fringes]]
axis = "column"
count = 8
steps = 4
images = ["f0.png", "f1.png", "f2.png", "f3.png"]
"#;

const CALIBRATION: &str = r#"format = 1
[camera]
width = 64
height = 48
fx = 67.0
fy = 67.0
cx = 32.0
cy = 24.0
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
[projector]
width = 64
height = 40
fx = 52.0
fy = 52.0
cx = 32.0
cy = 20.0
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
[projector_from_camera]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
translation_mm = [213.0, 0.0, 0.0]
"#;

const VEHICLE: &str = r#"format = 1
job = 12
name = "SUV A"
body = "suv"
origin = "centre of the front axle, on the ground"
[[feature]]
name = "corner-1"
class = "point1"
kind = "corner"
position_mm = [-2476.0, 870.0, 671.0]
pixel = [10.0, 20.0]
[[feature]]
name = "corner-2"
class = "point2"
kind = "corner"
position_mm = [-2780.0, 870.0, 671.0]
pixel = [50.0, 20.0]
[[feature]]
name = "cap"
class = "point3"
kind = "ellipse"
position_mm = [-2618.0, 870.0, 874.0]
pixel = [30.0, 10.0]
[limits]
yaw_deg = 15.0
"#;

/// A folder with one good capture `c`, `calibration.toml` and `vehicle.toml`, removed in the end.
struct Bench(PathBuf);

impl Bench {
    fn new(name: &str) -> Self {
        let dir = std::env::temp_dir().join(format!("datum-bad-input-{name}-{}", std::process::id()));
        let bench = Self(dir);
        bench.add_capture("c");
        fs::write(bench.0.join("calibration.toml"), CALIBRATION).expect("temporary file");
        fs::write(bench.0.join("vehicle.toml"), VEHICLE).expect("temporary file");
        bench
    }

    fn add_capture(&self, name: &str) {
        let folder = self.0.join(name);
        fs::create_dir_all(&folder).expect("temporary folder");
        fs::write(folder.join("capture.toml"), CAPTURE).expect("temporary file");
        for image in ["red", "f0", "f1", "f2", "f3"] {
            write_png(&folder.join(format!("{image}.png")), &Image::filled(64, 48, 100)).expect("temporary file");
        }
    }

    fn replace(&self, file: &str, from: &str, to: &str) {
        let path = self.0.join(file);
        let text = fs::read_to_string(&path).expect("made above");
        assert!(text.contains(from), "{from} is not in {file}");
        fs::write(path, text.replacen(from, to, 1)).expect("writable");
    }

    fn datum(&self, arguments: &[&str]) -> Output {
        let program = Command::new(env!("CARGO_BIN_EXE_datum")).current_dir(&self.0).args(arguments).output();
        let output = program.expect("built by cargo");
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(!error.contains("panicked") && output.status.code().is_some(), "{error}");
        output
    }

    fn measure(&self, captures: &[&str]) -> Output {
        let files = ["--calibration", "calibration.toml", "--vehicle", "vehicle.toml", "--json"];
        self.datum(&[&["measure"], captures, &files].concat())
    }

    fn path(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn error(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(2), "{output:?}");
    let text = String::from_utf8(output.stderr.clone()).expect("UTF-8");
    assert!(text.starts_with("error: "), "{text}");
    text
}

#[test]
fn the_files_are_good_before_they_are_spoilt() {
    let bench = Bench::new("good");
    let capture = Capture::open(&bench.path("c")).expect("good");
    assert_eq!(capture.load(capture.red().expect("named")).expect("there").pixels, vec![100; 64 * 48]);
    Calibration::read(&bench.path("calibration.toml")).expect("good");
    VehicleFile::read(&bench.path("vehicle.toml")).expect("good");
}

#[test]
fn a_spoilt_number_or_key_is_named_with_its_file() {
    let bench = Bench::new("keys");
    let rotation = "rotation = [[1.0, 0.0, 0.0], [0.0";
    let deep = format!("id = {}", "[".repeat(50_000));
    for (file, from, to, sentence) in [
        ("c/capture.toml", "format = 1", "format = 2", "format = 2, allowed: 1"),
        ("c/capture.toml", "format = 1", "", "format = (missing), allowed: 1"),
        ("c/capture.toml", "black_level", "blck_level", "line 7, `blck_level = 2.0`: unknown field `blck_level`"),
        ("c/capture.toml", "width = 64", "width = -64", "line 4, `width = -64`: invalid value"),
        ("c/capture.toml", "width = 64", "width = 6400000000", "camera.width = 6400000000, allowed: 16 to 10000"),
        ("c/capture.toml", "steps = 4", "steps = 0", "fringes[0].steps = 0, allowed: 3 to 16"),
        ("c/capture.toml", "steps = 4", "steps = 5", "fringes[0].images = 4 files, allowed: one file per step, 5"),
        ("c/capture.toml", "count = 8", "count = 0", "fringes[0].count = 0, allowed: 1 to 32"),
        ("c/capture.toml", "black_level = 2.0", "black_level = nan", "camera.black_level = NaN"),
        ("c/capture.toml", "bits = 8", "bits = 16", "64×48 at 8 bits, allowed: camera.width × camera.height at"),
        ("c/capture.toml", "height = 48", "height = 50", "images.red = red.png: 64×48 at 8 bits"),
        ("c/capture.toml", "red.png", "../red.png", "images.red = ../red.png: c/../red.png: No such file"),
        ("c/capture.toml", "red = \"red.png\"", "", "images.red = (missing)"),
        ("calibration.toml", "format = 1", "format = 2", "format = 2, allowed: 1"),
        ("calibration.toml", "fy = 67.0", "fz = 67.0", "line 6, `fz = 67.0`: unknown field `fz`, expected one of"),
        ("calibration.toml", "fx = 67.0", "fx = nan", "camera.fx = NaN, allowed: a finite number greater than 0"),
        ("calibration.toml", rotation, "rotation = [[1.1, 0.0, 0.0], [0.0", "projector_from_camera.rotation = [[1.1,"),
        (
            "calibration.toml",
            "width = 64",
            "width = 128",
            "camera.width × camera.height = 128×48, allowed: the capture's",
        ),
        ("calibration.toml", "[213.0, 0.0", "[0.213, 0.0", "(are these millimetres?)"),
        ("calibration.toml", "format = 1", &format!("format = 1\n{deep}"), "line 2"),
        ("vehicle.toml", "format = 1", "format = 2", "format = 2, allowed: 1"),
        ("vehicle.toml", "yaw_deg", "jaw_deg", "`jaw_deg = 15.0`: unknown field `jaw_deg`, expected one of `x_mm`"),
        ("vehicle.toml", "job = 12", "job = 1000", "job = 1000, allowed: 1 to 999"),
        ("vehicle.toml", "body = \"suv\"", "body = \"van\"", "unknown variant `van`, expected `suv` or `sedan`"),
        ("vehicle.toml", "corner-2", "corner-1", "feature[1].name = \"corner-1\", allowed: a name no other"),
        ("vehicle.toml", "870.0, 874.0", "870.0, 671.5", "= 0.500 mm, allowed: at least 10 mm"),
        ("vehicle.toml", "870.0, 874.0", "870.0, nan", "feature[2].position_mm = [-2618.0, 870.0, NaN]"),
    ] {
        let original = fs::read(bench.path(file)).expect("made above");
        bench.replace(file, from, to);
        let text = error(&bench.measure(&["c"]));
        assert!(text.contains(file) && text.contains(sentence), "{text} for {sentence}");
        fs::write(bench.path(file), original).expect("writable");
    }
}

#[test]
fn no_cut_and_no_changed_byte_makes_a_reader_panic() {
    let bench = Bench::new("bytes");
    type Read = fn(&Path) -> bool;
    let readers: [(&str, Read); 3] = [
        ("c/capture.toml", |f| Capture::open(f.parent().expect("in a folder")).is_ok()),
        ("calibration.toml", |f| Calibration::read(f).is_ok()),
        ("vehicle.toml", |f| VehicleFile::read(f).is_ok()),
    ];
    for (name, reads) in readers {
        let file = bench.path(name);
        let whole = fs::read(&file).expect("made above");
        let mut refused = 0;
        for n in 0..whole.len() {
            for byte in [b'9', b'['] {
                let mut changed = whole.clone();
                changed[n] = byte;
                fs::write(&file, &changed).expect("writable");
                refused += usize::from(!reads(&file));
            }
            fs::write(&file, &whole[..n]).expect("writable");
            refused += usize::from(!reads(&file));
        }
        assert!(refused > whole.len(), "{name}: {refused} of {} changes refused", 3 * whole.len());
    }
}

#[test]
fn a_spoilt_image_is_named_with_its_key() {
    let bench = Bench::new("images");
    let image = bench.path("c/f2.png");
    let whole = fs::read(&image).expect("made above");
    let says = |spoil: &dyn Fn(&Path)| {
        spoil(&image);
        let text = error(&bench.measure(&["c"]));
        fs::write(&image, &whole).expect("writable");
        assert!(text.contains("c/capture.toml: fringes[0].images[2] = f2.png"), "{text}");
        text
    };
    let removed = says(&|i| fs::remove_file(i).expect("made above"));
    assert!(removed.contains("No such file"), "{removed}");
    let cut = says(&|i| fs::write(i, &whole[..20]).expect("writable"));
    assert!(cut.contains("c/f2.png: not a whole PNG"), "{cut}");
    let other = says(&|i| write_png(i, &Image::filled(32, 24, 1)).expect("writable"));
    assert!(other.contains("32×24 at 8 bits, allowed"), "{other}");
    let colour = says(&|i| write_png_rgb(i, &Image::filled(64, 48, [1, 2, 3])).expect("writable"));
    assert!(colour.contains("RGB, 8 bits, 64×48, allowed: grey without alpha"), "{colour}");
}

#[test]
fn an_image_cut_after_its_header_is_found_when_it_is_loaded() {
    let bench = Bench::new("cut");
    let image = bench.path("c/f1.png");
    let whole = fs::read(&image).expect("made above");
    fs::write(&image, &whole[..whole.len() - 8]).expect("writable");
    let capture = Capture::open(&bench.path("c")).expect("the header is whole");
    let e = capture.load(Path::new("f1.png")).expect_err("cut");
    assert_eq!(e.to_string(), format!("{}: fringes[0].images[1] = f1.png", bench.path("c/capture.toml").display()));
    let source = std::error::Error::source(&e).expect("the PNG's").to_string();
    assert!(source.contains("f1.png: not a whole PNG"), "{source}");
}

#[test]
fn missing_files_and_folders_are_named() {
    let bench = Bench::new("missing");
    assert!(error(&bench.measure(&["nowhere"])).contains("nowhere/capture.toml: cannot be read: No such file"));
    assert!(error(&bench.measure(&["calibration.toml"])).contains("calibration.toml/capture.toml: cannot be read"));
    fs::remove_file(bench.path("vehicle.toml")).expect("made above");
    assert!(error(&bench.measure(&["c"])).contains("vehicle.toml: cannot be read: No such file"));
    fs::create_dir(bench.path("vehicle.toml")).expect("temporary folder");
    assert!(error(&bench.measure(&["c"])).contains("vehicle.toml: cannot be read"));
    fs::write(bench.path("calibration.toml"), [0xff, 0xfe, 0]).expect("writable");
    assert!(error(&bench.measure(&["c"])).contains("calibration.toml: cannot be read: invalid utf-8"));
}

#[test]
fn of_several_captures_each_unreadable_one_becomes_an_object() {
    let bench = Bench::new("several");
    bench.add_capture("d");
    bench.replace("c/capture.toml", "count = 8", "count = 99");
    bench.replace("d/capture.toml", "bits = 8", "bits = 12");
    let output = bench.measure(&["c", "nowhere", "d"]);
    assert_eq!(output.status.code(), Some(2));
    let value: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(value.as_array().map(Vec::len), Some(3));
    for (object, name, sentence) in [
        (&value[0], "c", "c/capture.toml: fringes[0].count = 99, allowed: 1 to 32"),
        (&value[1], "nowhere", "nowhere/capture.toml: cannot be read: No such file"),
        (&value[2], "d", "d/capture.toml: camera.bits = 12, allowed: 8 or 16"),
    ] {
        assert_eq!((object["capture"].as_str(), object["verdict"].as_str()), (Some(name), Some("error")));
        assert!(object["detail"].as_str().is_some_and(|d| d.contains(sentence)), "{object}");
        assert!(object["camera_from_vehicle"].is_null());
    }
}

#[test]
fn wrong_usage_is_status_2() {
    let bench = Bench::new("usage");
    let files = ["--calibration", "calibration.toml", "--vehicle", "vehicle.toml"];
    for (arguments, sentence) in [
        (&["measure", "c", "--method", "best"][..], "invalid value 'best'"),
        (&["measure", "c", "--detector", "no.onnx"], "no.onnx: cannot be read"),
        (&["measure"], "<CAPTURE>"),
    ] {
        let text = error(&bench.datum(&[arguments, &files].concat()));
        assert!(text.contains(sentence), "{text}");
    }
    assert_eq!(bench.datum(&["unheard-of"]).status.code(), Some(2));
    assert_eq!(bench.datum(&["--help"]).status.code(), Some(0));
}

#[test]
fn teaching_needs_a_click_inside_the_image() {
    let bench = Bench::new("teach");
    let arguments =
        ["teach", "c", "--calibration", "calibration.toml", "--features", "vehicle.toml", "--out", "out.toml"];
    bench.replace("vehicle.toml", "pixel = [50.0, 20.0]", "pixel = [64.0, 20.0]");
    let text = error(&bench.datum(&arguments));
    assert!(text.contains("vehicle.toml: feature[1].pixel = [64.0, 20.0], allowed: where it was clicked"), "{text}");
    bench.replace("vehicle.toml", "pixel = [64.0, 20.0]", "");
    let text = error(&bench.datum(&arguments));
    assert!(text.contains("vehicle.toml: feature[1].pixel = (missing)"), "{text}");
    assert!(!bench.path("out.toml").exists());
}

#[test]
fn a_release_needs_every_template_and_holds_until_one_changes() {
    let bench = Bench::new("release");
    let text = error(&bench.datum(&["release", "vehicle.toml"]));
    assert!(text.contains("vehicle.toml: feature[0].template = (missing), allowed: a file written by"), "{text}");
    for name in ["corner-1", "corner-2", "cap"] {
        let line = format!("name = \"{name}\"");
        bench.replace("vehicle.toml", &line, &format!("{line}\ntemplate = \"{name}.datum\""));
    }
    let text = error(&bench.datum(&["release", "vehicle.toml"]));
    assert!(text.contains("corner-1.datum: cannot be read: No such file"), "{text}");
    for name in ["corner-1", "corner-2", "cap"] {
        fs::write(bench.path(&format!("{name}.datum")), name).expect("writable");
    }
    let before = VehicleFile::read(&bench.path("vehicle.toml")).expect("good");
    assert_eq!(bench.datum(&["release", "vehicle.toml"]).status.code(), Some(0));
    let released = VehicleFile::read(&bench.path("vehicle.toml")).expect("written");
    assert_eq!(VehicleFile { release: None, ..released.clone() }, before, "nothing stored is lost");
    assert_eq!(released.unreleased(&released.read_templates().expect("there")), None);
    fs::write(bench.path("cap.datum"), "changed").expect("writable");
    let templates = released.read_templates().expect("there");
    assert_eq!(released.unreleased(&templates), Some(datum::Code::Fingerprint));
}

#[test]
fn patterns_are_written_with_their_list() {
    let bench = Bench::new("patterns");
    let output = bench.datum(&["patterns", "--out", "p"]);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    assert_eq!(fs::read_dir(bench.path("p")).expect("made").count(), 17);
    let image = datum::image::read_png(&bench.path("p/column-01-00.png")).expect("written");
    assert_eq!((image.width, image.height, image.at(0, 799), image.at(640, 0)), (1280, 800, 255, 0));
    let text = error(&bench.datum(&["patterns", "--out", "q", "--calibration", "calibration.toml"]));
    assert!(text.contains("64 fringes need a projector of 128 columns"), "{text}");
}
