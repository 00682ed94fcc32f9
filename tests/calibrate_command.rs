//! `datum calibrate` through the built program, on rendered captures of boards: what it finds, what it writes, and what it
//! says of bad input.

#[path = "common/calibrate.rs"]
mod common;

use common::board::{place, places, rig, write_capture};
use common::{CHESS, MARKED, calibrate, empty_folder, parsed, refused, text, write_captures};
use datum::image::{Image, write_png};
use datum::{Calibration, Pose};
use nalgebra::{Rotation3, Vector3};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

fn tmp(name: &str) -> PathBuf {
    empty_folder(&format!("calibrate/{name}"))
}

/// Eight captures of the chessboard, rendered once.
fn captures() -> &'static [PathBuf] {
    static CAPTURES: OnceLock<Vec<PathBuf>> = OnceLock::new();
    CAPTURES.get_or_init(|| write_captures(&tmp("captures"), 0, 8, 1))
}

/// The eight captures' calibration.
fn calibration() -> &'static (PathBuf, Value) {
    static CALIBRATION: OnceLock<(PathBuf, Value)> = OnceLock::new();
    CALIBRATION.get_or_init(|| {
        let file = tmp("calibration").join("calibration.toml");
        let run = calibrate(&["projector", "--board", CHESS, "--json", "--out", text(&file)], captures());
        assert_eq!(run.status, 0, "{}", run.err);
        (file, run.json())
    })
}

fn number(v: &Value) -> f64 {
    v.as_f64().unwrap_or_else(|| panic!("{v} is no number"))
}

/// The true rig with its camera turned by `deg` about y against the projector, and its baseline longer by a share.
fn write_other(file: &Path, deg: f64, longer: f64) {
    let mut c = Calibration { rig: rig(), ..Calibration::read(&calibration().0).expect("just written") };
    let turn = Rotation3::new(Vector3::new(0.0, deg.to_radians(), 0.0));
    let p = &mut c.rig.projector_from_camera;
    *p = Pose::new(p.r * turn, p.t * (1.0 + longer));
    c.write(file).expect("writable");
}

#[test]
fn eight_boards_give_the_rig_to_its_own_sigmas() {
    let (file, json) = calibration();
    let (truth, got) = (rig(), Calibration::read(file).expect("just written"));
    let t = &got.rig.projector_from_camera;
    let turn = (t.r * truth.projector_from_camera.r.inverse()).scaled_axis();
    let shift = t.t - truth.projector_from_camera.t;
    let v = got.covariance.as_ref().expect("written");
    let sigma = |k: usize| v[(k, k)].sqrt();
    let errors = [
        ("camera.fx", got.rig.camera.fx - truth.camera.fx, 0),
        ("camera.cy", got.rig.camera.cy - truth.camera.cy, 3),
        ("projector.fy", got.rig.projector.fy - truth.projector.fy, 10),
        ("projector.cy", got.rig.projector.cy - truth.projector.cy, 12),
        ("rx", turn.x, 18),
        ("ry", turn.y, 19),
        ("rz", turn.z, 20),
        ("tx", shift.x, 21),
        ("ty", shift.y, 22),
        ("tz", shift.z, 23),
    ];
    for (name, error, k) in errors {
        eprintln!("{name}: {error:+.5} ± {:.5}", sigma(k));
        assert!(error.abs() < 3.0 * sigma(k), "{name}: {error} of {}", sigma(k));
    }
    assert!(shift.norm() < 0.5 && turn.norm() < 1.5e-3, "{shift} {turn}"); // mm, rad: sigmas must not be large either
    let scale = got.quality.as_ref().and_then(|q| q.scale_sigma_percent).expect("written");
    assert!((0.02..0.03).contains(&scale), "{scale}: the pitch's 0.02 % and the fit's");
    let quality = got.quality.expect("written");
    assert_eq!((quality.views, quality.board.as_deref()), (Some(8), Some(CHESS)));
    assert_eq!(got.id.as_deref(), Some("2026-11-22T05:00:00Z/CAM1/-"));
    assert!(
        number(&json["rms_px"]["camera"]) < 0.05 && number(&json["rms_px"]["projector"]) < 0.1,
        "{}",
        json["rms_px"]
    );
    assert!(number(&json["leave_one_out_rms_px"]) < 0.05);
    let boards = json["kabsch"].as_array().expect("a list");
    assert_eq!(boards.len(), 8);
    assert!(
        boards.iter().all(|b| (number(&b["scale"]) - 1.0).abs() < 5e-4 && number(&b["rms_mm"]) < 0.1),
        "{boards:?}"
    );
    // but for the last digit, which JSON's reader may round otherwise
    assert!((number(&json["std"]["camera.fx"]) / sigma(0) - 1.0).abs() < 1e-12 && json["views"][0]["used"] == true);
}

#[test]
fn the_camera_alone_comes_from_captures_or_from_pictures() {
    let out = tmp("camera").join("camera.toml");
    let run = calibrate(&["camera", "--board", CHESS, "--json", "--out", text(&out)], captures());
    assert_eq!(run.status, 0, "{}", run.err);
    let json = run.json();
    let (f, sigma) = (number(&json["camera"]["fx"]), number(&json["std"]["camera.fx"]));
    assert!((f - rig().camera.fx).abs() < 5.0 * sigma && sigma < 2.0, "{f} ± {sigma}");
    assert!(
        json["projector"].is_null() && json["rms_px"]["joint"].is_null() && json["kabsch"] == serde_json::json!([])
    );
    let e = Calibration::read(&out).expect_err("no projector").to_string();
    assert!(e.contains("[projector] = (missing)") && e.contains("datum calibrate projector"), "{e}");
    // the same file may be replaced; a whole rig may not
    assert_eq!(calibrate(&["camera", "--board", CHESS, "--out", text(&out)], captures()).status, 0);
    assert!(out.with_extension("old-1.toml").exists());
    let e = refused(&["camera", "--board", CHESS, "--out", text(&calibration().0)], captures());
    assert!(e.contains("replaced only with --force"), "{e}");
}

#[test]
fn a_board_verifies_the_calibration_and_belies_a_bumped_one() {
    let folder = tmp("verify");
    let (board, capture) = (parsed(MARKED), folder.join("capture"));
    let pose = place(&board, [0.0, 0.0, 740.0], [6.0, -8.0, 2.0]);
    write_capture(&capture, &rig(), &board, &pose, true, 77);
    let verify = |file: &Path| {
        let run = calibrate(
            &["verify", "--board", MARKED, "--json", "--calibration", text(file)],
            std::slice::from_ref(&capture),
        );
        let json = run.json();
        (run.status, json["verification"].clone())
    };
    assert_eq!(verify(&calibration().0).0, 0);
    let other = folder.join("other.toml");
    write_other(&other, 0.0, 0.0);
    let (status, good) = verify(&other);
    assert_eq!((status, &good["ok"]), (0, &Value::Bool(true)), "{good}");
    let frames = good["frames_error_mm"].as_array().expect("three").iter().map(number);
    assert!(frames.into_iter().all(|e| e.abs() < 0.15), "{good}");
    // 0.03° of toe-in is 1.3 mm of depth at 740 mm, 0.18 % of scale
    write_other(&other, 0.03, 0.0);
    let (status, turned) = verify(&other);
    assert_eq!(status, 1, "{turned}");
    assert!(
        turned["detail"]
            .as_str()
            .expect("a sentence")
            .starts_with("The calibration does not hold: lengths come out 0.1")
    );
    write_other(&other, 0.0, 0.003);
    let (status, longer) = verify(&other);
    let more = number(&longer["scale_error_percent"]) - number(&good["scale_error_percent"]);
    assert!(status == 1 && (more - 0.3).abs() < 0.02, "{longer}");
    // another pitch than the board's
    let run = calibrate(
        &["verify", "--board", "marked:8x4:56:28", "--calibration", text(&calibration().0)],
        std::slice::from_ref(&capture),
    );
    assert_eq!(run.status, 1);
    assert!(run.out.contains("is --board's pitch right?"), "{}", run.out);
    let e =
        refused(&["verify", "--board", CHESS, "--calibration", text(&calibration().0)], std::slice::from_ref(&capture));
    assert!(e.contains("no chessboard of 9×6 inner corners"), "{e}");
}

#[test]
fn three_surveyed_circles_tie_the_camera_to_the_station() {
    let folder = tmp("station");
    let (board, capture) = (parsed(MARKED), folder.join("capture"));
    let pose = place(&board, [0.0, 0.0, 740.0], [6.0, -8.0, 2.0]);
    write_capture(&capture, &rig(), &board, &pose, false, 78);
    let station_from_board = Pose::<datum::frame::Station, datum::frame::Board>::new(
        Rotation3::from_euler_angles(1.5, 0.1, 3.0),
        Vector3::new(-2600.0, 900.0, 700.0),
    );
    let points = board.points();
    let circles = |spoil: f64| {
        let circle = |(n, &k): (usize, &usize)| {
            let at = datum::Point3::new(points[k].push(0.0));
            let s = (station_from_board * at).xyz;
            let px = rig().camera.project(&(pose * at).xyz).expect("in front");
            let x = s.x + if n == 1 { spoil } else { 0.0 };
            format!(
                "[[circle]]\nname = \"{n}\"\nstation_mm = [{x}, {}, {}]\npixel = [{}, {}]\n",
                s.y,
                s.z,
                px.x + 1.0,
                px.y - 1.0
            )
        };
        let text = [0, 7, 24, 31].iter().enumerate().map(circle).collect::<String>();
        let file = folder.join("circles.toml");
        std::fs::write(&file, format!("format = 1\n{text}")).expect("writable");
        file
    };
    let (file, out, exact) = (circles(0.0), folder.join("surveyed.toml"), folder.join("exact.toml"));
    write_other(&exact, 0.0, 0.0);
    let of = |circles: &Path, more: &[&str]| {
        let fixed = ["station", "--calibration", text(&exact), "--circles", text(circles), "--out", text(&out)];
        calibrate(&[&fixed[..], more].concat(), std::slice::from_ref(&capture))
    };
    let run = of(&file, &["--json"]);
    assert_eq!(run.status, 0, "{}", run.err);
    let json = run.json();
    let got = Calibration::read(&out).expect("written").station_from_camera.expect("surveyed");
    let truth = station_from_board * pose.inverse();
    let middle = datum::Point3::new(Vector3::new(0.0, 0.0, 740.0));
    let (shift, turn) = ((got * middle - truth * middle).norm(), (got.r * truth.r.inverse()).angle().to_degrees());
    eprintln!("survey: {shift:.3} mm, {turn:.4}°; {}", json["uncertainty_k2"]);
    assert!(shift < 0.25 && turn < 0.1, "{shift} mm, {turn}°");
    // most of the uncertainty is the calibration's, of eight boards on a small sensor
    let x = number(&json["uncertainty_k2"]["x_mm"]);
    assert!(number(&json["residual_rms_mm"]) < 0.1 && x > 0.2 && x < 2.0, "{json}");
    // a coordinate that was mistyped
    let run = of(&circles(20.0), &[]);
    assert_eq!(run.status, 2);
    assert!(run.err.contains("circle[") && run.err.contains("mm off, allowed: within 1 mm"), "{}", run.err);
    let run = of(&folder.join("none.toml"), &[]);
    assert!(run.status == 2 && run.err.contains("none.toml: cannot be read"), "{}", run.err);
}

#[test]
fn bad_input_is_told_with_what_to_do() {
    let few = refused(&["projector", "--board", CHESS], &captures()[..2]);
    assert!(few.contains("found in 2 of 2, at least 4 are needed"), "{few}");
    let run = calibrate(&["projector", "--board", "chessboard:8x6:45"], captures());
    assert_eq!(run.status, 2);
    assert!(
        run.err.contains("left out: no chessboard of 8×6 inner corners: the largest grid found has 9×6"),
        "{}",
        run.err
    );
    let unknown = refused(&["camera", "--board", "charuco:8x6:45"], captures());
    assert!(unknown.contains("--help"), "{unknown}");

    let folder = tmp("bad");
    let board = parsed(CHESS);
    let frontal: Vec<PathBuf> = (0..5)
        .map(|k| {
            let capture = folder.join(format!("frontal-{k}"));
            let at = [f64::from(k) * 20.0 - 30.0, f64::from(k % 2) * 30.0, 740.0];
            write_capture(&capture, &rig(), &board, &place(&board, at, [0.3, -0.2, f64::from(k)]), true, 90 + k as u64);
            capture
        })
        .collect();
    let e = refused(&["projector", "--board", CHESS], &frontal);
    assert!(e.contains("do not determine the focal length") && e.contains("tilted by 20° to 40°"), "{e}");

    let small = folder.join("small.png");
    write_png(&small, &Image::filled(300, 200, 90u8)).expect("writable");
    let e = refused(&["camera", "--board", CHESS], &[captures()[0].clone(), small]);
    assert!(e.contains("300×200 px, allowed: 432×324 as"), "{e}");

    let columns = folder.join("columns");
    write_capture(&columns, &rig(), &board, &places(&board)[1], false, 95);
    let e = refused(&["projector", "--board", CHESS], &[captures(), &[columns]].concat());
    assert!(e.contains("[[fringes]] = no row set of count 1, allowed: column and row fringes"), "{e}");

    let points = folder.join("points.txt");
    std::fs::write(&points, "1 2 3 four 5 6 7 8").expect("writable");
    let e = refused(&["camera", "--points", text(&points), text(&points)], &[]);
    assert!(e.contains("points.txt: line 1 = \"four\", allowed: numbers, x and y in turn"), "{e}");
}

#[test]
fn a_worse_calibration_never_replaces_a_better_one_unasked() {
    let file = tmp("keep").join("calibration.toml");
    std::fs::copy(&calibration().0, &file).expect("copied");
    let better = std::fs::read(&file).expect("there");
    let of = |captures: &[PathBuf], board: &str, more: &[&str]| {
        calibrate(&[&["projector", "--board", board, "--out", text(&file)], more].concat(), captures)
    };
    // five of the eight know less
    let run = of(&captures()[..5], CHESS, &[]);
    assert_eq!(run.status, 2, "{}", run.out);
    assert!(run.err.contains("calibration.toml: stays as it is: it has 8 views, the new one 5"), "{}", run.err);
    assert_eq!(std::fs::read(&file).expect("there"), better);
    assert!(file.with_extension("refused.toml").exists());
    // another pitch gives another baseline, also where it is hardly mistyped
    for pitch in ["chessboard:9x6:50", "chessboard:9x6:45.3"] {
        let run = of(captures(), pitch, &[]);
        assert!(run.status == 2 && run.err.contains("is --board's pitch right"), "{pitch}: {}", run.err);
        assert_eq!(std::fs::read(&file).expect("there"), better);
    }
    // one that does not say how good it is may be better
    let silent = file.with_file_name("silent.toml");
    let mut c = Calibration::read(&file).expect("a calibration");
    (c.quality, c.covariance) = (None, None);
    c.write(&silent).expect("writable");
    let run = calibrate(&["projector", "--board", CHESS, "--out", text(&silent)], captures());
    assert!(run.status == 2 && run.err.contains("it may be better"), "{}", run.err);
    // and what is no calibration is not touched, nor is work done for it
    let other = file.with_file_name("notes.toml");
    std::fs::write(&other, "shopping = 1\n").expect("writable");
    let e = refused(&["projector", "--board", CHESS, "--out", text(&other)], captures());
    assert!(e.contains("notes.toml: --out = a file that is no calibration"), "{e}");
    // asked to, it replaces, and the old one is kept
    let run = of(&captures()[..5], CHESS, &["--force"]);
    assert_eq!(run.status, 0, "{}", run.err);
    assert_eq!(std::fs::read(file.with_extension("old-1.toml")).expect("kept"), better);
    assert_ne!(std::fs::read(&file).expect("there"), better);
}
