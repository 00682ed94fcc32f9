//! `datum calibrate` through the built program: what it makes of circles that lie, limits that are none, views that show
//! no board and points that are none.

#[path = "common/calibrate.rs"]
mod common;

use common::board::{self, place, places, rig, write_capture};
use common::{CHESS, MARKED, Run, calibrate, empty_folder, parsed, refused, text, write_captures};
use datum::Calibration;
use datum::calibrate::Quality;
use datum::image::{Image, write_png};
use nalgebra::Vector3;
use serde_json::Value;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

fn tmp(name: &str) -> PathBuf {
    empty_folder(&format!("calibrate-input/{name}"))
}

/// Five captures of the chessboard, rendered once.
fn captures() -> &'static [PathBuf] {
    static CAPTURES: OnceLock<Vec<PathBuf>> = OnceLock::new();
    CAPTURES.get_or_init(|| write_captures(&tmp("captures"), 1, 5, 31))
}

/// The true rig, without a covariance, that says it knows lengths to `scale_sigma_percent`; its baseline longer by `longer`.
fn write_rig(file: &Path, longer: f64, scale_sigma_percent: f64) {
    let mut rig = rig();
    rig.projector_from_camera.t *= 1.0 + longer;
    let quality = Some(Quality { scale_sigma_percent: Some(scale_sigma_percent), ..Quality::default() });
    let c = Calibration { file: file.into(), id: None, rig, station_from_camera: None, covariance: None, quality };
    c.write(file).expect("writable");
}

/// A capture of the marked board, and discs of it as surveyed: in the board's own coordinates, moved by mm.
struct Station {
    folder: PathBuf,
    capture: PathBuf,
}

impl Station {
    fn new(name: &str) -> Self {
        let folder = tmp(name);
        let capture = folder.join("capture");
        write_capture(&capture, &rig(), &parsed(MARKED), &Self::pose(), false, 79);
        write_rig(&folder.join("rig.toml"), 0.0, 0.02);
        Self { folder, capture }
    }

    fn pose() -> board::CameraFromBoard {
        place(&parsed(MARKED), [0.0, 0.0, 740.0], [6.0, -8.0, 2.0])
    }

    fn circles(&self, discs: &[(usize, [f64; 3])]) -> PathBuf {
        let points = parsed(MARKED).points();
        let mut out = String::from("format = 1\n");
        for (n, (disc, moved)) in discs.iter().enumerate() {
            let at = datum::Point3::new(points[*disc].push(0.0));
            let px = rig().camera.project(&(Self::pose() * at).xyz).expect("in front");
            let [x, y, z] = <[f64; 3]>::from(at.xyz + Vector3::from(*moved));
            let _ = writeln!(
                out,
                "[[circle]]\nname = \"c{n}\"\nstation_mm = [{x}, {y}, {z}]\npixel = [{}, {}]",
                px.x, px.y
            );
        }
        let file = self.folder.join("circles.toml");
        std::fs::write(&file, out).expect("writable");
        file
    }

    fn run(&self, discs: &[(usize, [f64; 3])], more: &[&str]) -> Run {
        let (circles, rig) = (self.circles(discs), self.folder.join("rig.toml"));
        let fixed = ["station", "--calibration", text(&rig), "--circles", text(&circles)];
        calibrate(&[&fixed[..], more].concat(), std::slice::from_ref(&self.capture))
    }
}

const RIGHT: [f64; 3] = [0.0; 3];

#[test]
fn circles_that_lie_are_named() {
    let station = Station::new("circles");
    let three = station.run(&[(0, RIGHT), (7, RIGHT), (24, RIGHT)], &["--json"]);
    assert_eq!((three.status, &three.json()["checked"]), (0, &Value::Bool(false)), "{}", three.err);
    let table = station.run(&[(0, RIGHT), (7, RIGHT), (24, RIGHT)], &[]).out;
    assert!(table.contains("hardly checked") && table.contains("Survey a fourth"), "{table}");
    assert!(table.contains("without the calibration's share"), "{table}");

    // out of their plane three circles show little: the pose turns with it
    let wrong = [(0, RIGHT), (7, [0.0, 0.0, 20.0]), (24, RIGHT)];
    let e = station.run(&wrong, &[]);
    assert_eq!(e.status, 2, "{}", e.out);
    assert!(e.err.contains("the worst of three, of which any may be wrong; "), "{}", e.err);
    let mm = e.err.split(" sigmas, ").nth(2).and_then(|t| t.split(' ').next()?.parse::<f64>().ok());
    assert!(mm.expect("mm off") < 0.6 && e.err.contains("mm off, allowed: within 1 mm and 5 sigmas"), "{}", e.err);
    let forced = station.run(&wrong, &["--force"]);
    assert_eq!(forced.status, 0, "{}", forced.err);

    let five = |moved| [(0, RIGHT), (7, RIGHT), (24, RIGHT), (31, moved), (11, RIGHT)];
    let right = station.run(&five(RIGHT), &["--json"]);
    assert_eq!((right.status, &right.json()["checked"]), (0, &Value::Bool(true)), "{}", right.err);
    let e = station.run(&five([0.0, 4.0, 0.0]), &[]).err;
    assert!(e.contains("circle[3].station_mm") && e.contains("\"c3\": the others fit without it; "), "{e}");

    let twice = station.run(&[(0, RIGHT), (7, RIGHT), (24, RIGHT), (7, RIGHT)], &[]);
    assert_eq!(twice.status, 2, "{}", twice.out);
    assert!(
        twice.err.contains("circles.toml: circle[1] \"c1\" and circle[3] \"c3\" are the same disc"),
        "{}",
        twice.err
    );
}

#[test]
fn a_survey_replaces_its_own_calibration_and_no_better_one_of_another_rig() {
    let station = Station::new("out");
    let discs = [(0, RIGHT), (7, RIGHT), (24, RIGHT), (31, RIGHT)];
    let out = station.folder.join("out.toml");
    let run = |more: &[&str]| station.run(&discs, &[&["--out", text(&out)], more].concat());
    assert_eq!(run(&[]).status, 0);
    let itself = run(&[]);
    assert!(itself.status == 0 && itself.err.contains("out.old-1.toml: the one before"), "{}", itself.err);
    write_rig(&out, 0.001, 0.005);
    let better = std::fs::read(&out).expect("there");
    let other = run(&[]);
    assert!(other.status == 2 && other.err.contains("stays as it is: it does not say how good it is"), "{}", other.err);
    assert_eq!(std::fs::read(&out).expect("there"), better);
    assert_eq!(run(&["--force"]).status, 0);
    assert!(Calibration::read(&out).expect("written").station_from_camera.is_some());
    // what is no calibration is not overwritten either
    std::fs::write(&out, "precious = true\n").expect("writable");
    assert_eq!(run(&[]).status, 2);
    assert_eq!(std::fs::read_to_string(&out).expect("there"), "precious = true\n");
}

#[test]
fn limits_that_are_none_are_refused() {
    for limit in ["--max-scale-percent", "--max-flatness-mm", "--max-epipolar-px"] {
        for value in ["nan", "inf", "0", "-1", "much"] {
            let given = format!("{limit}={value}");
            let e = refused(&["verify", "none", "--board", CHESS, "--calibration", "none.toml", &given], &[]);
            assert!(e.contains("allowed: a finite number greater than 0") && e.contains(limit), "{e}");
        }
    }
}

#[test]
fn a_board_of_which_little_is_lit_is_no_verdict() {
    let folder = tmp("dark");
    let (board, capture, file) = (parsed(MARKED), folder.join("capture"), folder.join("rig.toml"));
    let mut turned = rig(); // its projector looks past most of the board
    turned.projector.cx -= 480.0;
    write_capture(&capture, &turned, &board, &place(&board, [0.0, 0.0, 740.0], [6.0, -8.0, 2.0]), true, 80);
    let c = Calibration {
        file: file.clone(),
        id: None,
        rig: turned,
        station_from_camera: None,
        covariance: None,
        quality: None,
    };
    c.write(&file).expect("writable");
    let e = refused(&["verify", "--board", MARKED, "--calibration", text(&file), text(&capture)], &[]);
    assert!(e.contains("of 32 points have valid fringes: too few to tell"), "{e}");
}

#[test]
fn views_that_count_for_nothing_or_twice_are_told() {
    let folder = tmp("views");
    let blank = folder.join("blank.png");
    write_png(&blank, &Image::filled(432, 324, 90u8)).expect("writable");
    let run = calibrate(&["camera", "--board", CHESS, "--json"], &[captures(), std::slice::from_ref(&blank)].concat());
    assert_eq!(run.status, 0, "{}", run.err);
    let json = run.json();
    let views = json["views"].as_array().expect("views");
    assert_eq!(views.len(), 6);
    let last = views[5].as_object().expect("a view");
    assert_eq!((&last["name"], &last["used"]), (&Value::from("blank.png"), &Value::Bool(false)));
    assert!(last["rms_px"].is_null() && last["rejected_points"].is_null(), "{last:?}");
    assert!(last["detail"].as_str().expect("a reason").starts_with("no chessboard of 9×6"), "{last:?}");
    assert!(views[0]["rms_px"].is_f64() && views[0]["projector_rms_px"].is_null(), "{}", views[0]);

    let again = captures()[0].join("../board-1");
    let e = refused(&["camera", "--board", CHESS], &[captures(), std::slice::from_ref(&again)].concat());
    assert!(e.contains(&format!("{}: given twice (as {})", again.display(), captures()[1].display())), "{e}");

    let broken = folder.join("broken.png");
    std::fs::write(&broken, "no PNG").expect("writable");
    for bad in [broken, folder.join("none.png")] {
        let e = refused(&["camera", "--board", CHESS], std::slice::from_ref(&bad));
        assert_eq!(e.matches(text(&bad)).count(), 1, "{e}");
    }
}

#[test]
fn the_table_tells_how_well_each_number_is_known() {
    let run = calibrate(&["projector", "--board", CHESS], captures());
    assert_eq!(run.status, 0, "{}", run.err);
    let json = calibrate(&["projector", "--board", CHESS, "--json"], captures()).json();
    let of_projector = &json["views"][0]["projector_rms_px"];
    let shown = format!("{:.3}", of_projector.as_f64().expect("a number"));
    let view = run.out.lines().find(|l| l.starts_with("board-0 ")).expect("a line per view");
    assert!(view.contains(&shown) && run.out.contains("rms px projector"), "{}", run.out);
    let lens = &json["camera"];
    let fixed = lens["cx"] == 215.5 && lens["cy"] == 161.5;
    let camera = run.out.lines().find(|l| l.starts_with("camera ")).expect("a line");
    assert_eq!(camera.contains("at the centre (fixed)"), fixed, "{}", run.out);
    for line in run.out.lines().filter(|l| l.contains("distortion: ") && !l.contains("none earns")) {
        let terms = line.split(": ").nth(1).expect("terms").split(", ");
        assert!(terms.clone().all(|t| t.contains(" ± ")), "{line}");
    }
}

#[test]
fn points_that_are_none_are_refused_and_an_assumed_size_is_told() {
    let folder = tmp("points");
    let board = parsed(CHESS);
    let write = |name: &str, points: &[datum::Pixel]| {
        let file = folder.join(name);
        let lines: String = points.iter().map(|p| format!("{} {}\n", p.x, p.y)).collect();
        std::fs::write(&file, lines).expect("writable");
        file
    };
    let camera = rig().camera;
    let model = write("model.txt", &board.points());
    let mut files = vec![model];
    for (k, pose) in places(&board).into_iter().skip(1).enumerate() {
        let place = |p: &nalgebra::Vector2<f64>| camera.project(&(pose * datum::Point3::new(p.push(0.0))).xyz);
        let pixels: Vec<_> = board.points().iter().map(|p| place(p).expect("in front")).collect();
        files.push(write(&format!("data{k}.txt"), &pixels));
    }
    let of = |more: &[&str], files: &[PathBuf]| {
        let files: Vec<&str> = files.iter().map(|f| text(f)).collect();
        calibrate(&[&["camera"], more, &["--points"], &files].concat(), &[])
    };
    let out = folder.join("camera.toml");
    let sized = of(&["--json", "--size", "432x324", "--out", text(&out)], &files);
    assert_eq!(sized.status, 0, "{}", sized.err);
    assert!(sized.json()["coverage"].is_f64() && !sized.err.contains("assumed"), "{}", sized.err);
    let skew = sized.json()["camera"]["skew"].as_f64().expect("a number");
    assert_eq!(sized.err.contains("camera.toml: without the skew of"), skew != 0.0, "{}", sized.err);
    let assumed = of(&["--json"], &files);
    assert_eq!(assumed.status, 0, "{}", assumed.err);
    assert!(assumed.err.contains("image size assumed from the points: ") && assumed.err.contains("--size sets it"));
    assert!(assumed.json()["coverage"].is_null() && assumed.json()["missing"].is_null(), "{}", assumed.out);
    assert!(!of(&[], &files).out.contains("coverage"));

    let spoilt = |value: f64| {
        let mut points = datum::calibrate::read_points(&files[1]).expect("written");
        points[4].y = value;
        [&[files[0].clone(), write("spoilt.txt", &points)], &files[2..]].concat()
    };
    let told = |more: &[&str], value: f64| {
        let run = of(more, &spoilt(value));
        assert_eq!(run.status, 2, "{}{}", run.out, run.err);
        run.err
    };
    let e = told(&[], 1e300);
    assert!(e.contains("spoilt.txt: point 5 = (") && e.contains("1e300), allowed: x -100000 to 100000"), "{e}");
    let e = told(&["--size", "432x324"], 500.0);
    assert!(e.contains("point 5 = (") && e.contains("500.0), allowed: x -216 to 648, y -162 to 486"), "{e}");
    let e = told(&[], 50_000.0);
    assert!(e.contains("--size is needed: from the points the image would be"), "{e}");
}
