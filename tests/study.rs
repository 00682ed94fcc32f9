//! `datum study`, the quick forms: what each says is there, can be wrong, and is right where it is known.

mod common;

use common::here;
use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn datum(arguments: &[&str], threads: usize) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_datum"));
    command.arg("study").args(arguments).env("RAYON_NUM_THREADS", threads.to_string()).output().expect("runs")
}

/// The one study of a run that wrote JSON; whether its targets are reached goes into the exit status.
fn study(arguments: &[&str]) -> Value {
    let out = datum(&[arguments, &["--json"]].concat(), 2);
    let said = String::from_utf8_lossy(&out.stderr);
    let mut report: Value = serde_json::from_slice(&out.stdout).unwrap_or_else(|e| panic!("{e}: {said}"));
    assert!(report["seed"].is_u64() && report["scale"].is_f64() && report["software"].is_string());
    let study = report["studies"][0].take();
    assert_eq!(out.status.code(), Some(i32::from(study["pass"] != true)), "{said}");
    assert!(study["setting"].as_str().is_some_and(|s| s.len() > 40), "it says what was looked at: {study}");
    study
}

fn figure(study: &Value, name: &str) -> f64 {
    let figures = study["figures"].as_array().expect("figures");
    let figure = figures.iter().find(|f| f["name"] == name).unwrap_or_else(|| panic!("no {name} in {figures:?}"));
    figure["value"].as_f64().unwrap_or_else(|| panic!("{figure}"))
}

/// The rows of the table whose title begins so.
fn rows<'a>(study: &'a Value, title: &str) -> &'a Vec<Value> {
    let tables = study["tables"].as_array().expect("tables");
    let table = tables.iter().find(|t| t["title"].as_str().is_some_and(|t| t.starts_with(title))).expect("the table");
    let rows = table["rows"].as_array().expect("rows");
    let columns = table["columns"].as_array().expect("columns").len();
    assert!(!rows.is_empty() && rows.iter().all(|r| r.as_array().is_some_and(|r| r.len() == columns)), "{table}");
    rows
}

#[test]
fn a_turn_is_measured_as_finely_as_wanted_whatever_the_threads() {
    let out = |threads| datum(&["rotation", "--quick", "--json"], threads).stdout;
    let (one, three) = (out(1), out(3));
    assert!(one == three, "threads changed a figure");
    let mut report: Value = serde_json::from_slice(&one).expect("JSON");
    let s = report["studies"][0].take();
    assert_eq!(s["study"], "rotation");
    assert!(figure(&s, "mean step error") > 0.0, "an error of nothing is none that was measured");
    assert_eq!((figure(&s, "measured, of those in view"), &s["pass"]), (100.0, &Value::Bool(true)), "{s}");
    assert_eq!(rows(&s, "By run")[0][3].as_f64(), Some(4.0), "steps between five places");
    assert_eq!(s["plots"][0]["series"][0]["points"].as_array().map(Vec::len), Some(5));
}

#[test]
fn a_way_is_measured_along_across_and_up() {
    let s = study(&["translation", "--quick"]);
    for axis in ["along", "across", "up"] {
        // of 100 mm at 1.2 mm per pixel
        let (over, rail) = (
            figure(&s, &format!("{axis}: largest error over 100 mm")),
            figure(&s, &format!("{axis}: rail's direction off, largest")),
        );
        assert!((1e-6..0.08).contains(&over) && rail < 0.1, "{axis}: {over} mm, {rail}°");
        assert!(figure(&s, &format!("{axis}: scale, mean")).abs() < 0.07);
    }
    assert!(rows(&s, "By run").iter().all(|r| r[3] == 100.0), "from one end to the other");
}

#[test]
fn models_are_measured_in_paints_that_they_were_not_taught_on() {
    let s = study(&["models", "--quick"]);
    assert_eq!(figure(&s, "measured"), 100.0);
    assert!((1e-3..0.4).contains(&figure(&s, "largest position error")), "{s}");
    assert_eq!(rows(&s, "By paint").len(), 4, "four vehicles, each in a paint of its own");
}

#[test]
fn a_standing_vehicle_is_measured_alike_and_one_image_twice_exactly_alike() {
    let s = study(&["repeat", "--quick"]);
    for axis in ["x", "y", "z", "roll", "pitch", "yaw"] {
        let (cg, cgk) =
            (figure(&s, &format!("Cg, {axis}, worst vehicle")), figure(&s, &format!("Cgk, {axis}, worst vehicle")));
        assert!(cg > 1.33 && cgk < cg, "{axis}: {cg} {cgk}");
    }
    assert!(rows(&s, "Standard deviation")[0][2].as_f64().is_some_and(|v| v > 0.0), "fresh captures differ");

    let capture = here("station/taught");
    let capture = capture.to_str().expect("UTF-8");
    let (calibration, vehicle) = (here("station/calibration.toml"), here("station/vehicle/suv-a.toml"));
    let with = ["--calibration", calibration.to_str().expect("UTF-8"), "--vehicle", vehicle.to_str().expect("UTF-8")];
    let s = study(&[&["repeat", capture, capture], with.as_slice()].concat());
    let again = &rows(&s, "Standard deviation")[0];
    assert!((2..8).all(|axis| again[axis] == 0.0), "one image processed again: {again}");
    let figures = s["figures"].as_array().expect("figures");
    assert!(figures.iter().all(|f| f["value"].is_null()), "0.2·T over nothing is no capability: {figures:?}");
}

#[test]
fn parking_anew_is_a_small_part_of_what_varies() {
    let s = study(&["gauge", "--quick"]);
    for row in rows(&s, "Standard deviations") {
        let [repeat, reproduce, interact, gauge, parts] = [2, 3, 4, 5, 6].map(|k| row[k].as_f64().expect("a number"));
        let sum = (repeat.powi(2) + reproduce.powi(2) + interact.powi(2)).sqrt();
        assert!((gauge - sum).abs() < 1e-9 && repeat > 0.0 && parts > 30.0 * gauge, "{row}");
    }
    assert!(figure(&s, "yaw: ndc") >= 5.0 && figure(&s, "x: %GRR of the tolerance") < 30.0);
}

#[test]
fn frames_on_a_board_are_where_they_are() {
    let s = study(&["board", "--quick"]);
    let far = figure(&s, "largest error of the way");
    assert!((1e-4..0.05).contains(&far), "{far} mm at 1.2 mm per pixel; 1.41 mm were published");
    assert!(figure(&s, "largest error of the turn") < 0.05);
    assert_eq!(rows(&s, "By place").len(), 2);
}

#[test]
fn what_is_stated_covers_and_a_displaced_feature_is_refused() {
    let s = study(&["uncertainty", "--quick"]);
    let over = figure(&s, "pose: error over sigma, rms");
    assert!((0.2..2.0).contains(&over), "two draws of calibration and teaching: {over}");
    assert_eq!(figure(&s, "wrong poses called ok"), 0.0);
    assert_eq!(figure(&s, "4 features: one displaced by 1 mm or more refused"), 100.0);
    assert_eq!(rows(&s, "Error over stated sigma").len(), 6 + 3 * 3, "the pose's axes and those of three targets");
}

/// What is expected of a model is about what is stated for a capture on the taught paint, where the detector or the search
/// has found it all.
#[test]
fn what_is_expected_of_a_model_is_what_is_stated_when_it_is_measured() {
    let vehicle = here("station/vehicle/suv-a.toml");
    let vehicle = vehicle.to_str().expect("UTF-8");
    let s = study(&["advice", "--vehicle", vehicle]);
    let expected = &rows(&s, "Expected U")[0];
    let out = Command::new(env!("CARGO_BIN_EXE_datum"))
        .args(["measure", "--json", here("station/moved").to_str().expect("UTF-8"), "--vehicle", vehicle])
        .args(["--calibration", here("station/calibration.toml").to_str().expect("UTF-8")])
        .output()
        .expect("runs");
    let measured: Value = serde_json::from_slice(&out.stdout).expect("JSON");
    let u = &measured[0]["uncertainty_k2"];
    for (column, axis) in [(5, "roll_deg"), (6, "pitch_deg"), (7, "yaw_deg")] {
        let (e, m) = (expected[column].as_f64().expect("a number"), u[axis].as_f64().expect("measured"));
        assert!((0.6..1.4).contains(&(e / m)), "{axis}: {e} expected, {m} stated");
    }
    let midpoints = &rows(&s, "Worst target's U (k = 2), mm, with every midpoint")[0];
    let [without, believed, real, best] = [1, 2, 3, 4].map(|k| midpoints[k].as_f64().expect("a number"));
    assert!(believed < 0.9 * without && real >= without && (best / without - 1.0).abs() < 1e-3, "{midpoints}");
    let further = &rows(&s, "Worst target's U (k = 2), mm, with one corner more")[0];
    assert!(further[3].as_f64().expect("a number") < 0.8 * without, "{further}");
}

#[test]
fn a_page_needs_no_other_file() {
    let page = Path::new(env!("CARGO_TARGET_TMPDIR")).join("study.html");
    let _ = std::fs::remove_file(&page);
    let out = datum(&["models", "--quick", "--html", page.to_str().expect("UTF-8")], 2);
    let text = String::from_utf8(out.stdout).expect("UTF-8");
    assert!(text.contains("largest rotation error") && text.contains("published") && text.contains("≤ 0.02"), "{text}");
    let html = std::fs::read_to_string(page).expect("written");
    assert!(html.contains("<svg") && html.contains("src=\"data:image/png;base64,iVBOR"), "a plot and a picture");
    let elsewhere = ["src=\"http", "href=", "url(", "<script", "@import"];
    assert!(elsewhere.iter().all(|e| !html.contains(e)), "it looks elsewhere");
    assert!(html.contains("largest rotation error") && html.contains("quick form"));
}

#[test]
fn what_cannot_be_studied_is_said() {
    let refused = |arguments: &[&str]| {
        let out = datum(arguments, 1);
        assert_eq!(out.status.code(), Some(2), "{arguments:?}");
        String::from_utf8(out.stderr).expect("UTF-8")
    };
    assert!(refused(&["rotatoin"]).contains("STUDY = rotatoin, allowed: control, board, "));
    assert!(refused(&["models", "--scale", "0.3"]).contains("--scale = 0.3, allowed: 1, 0.5 or 0.25"));
    assert!(refused(&["repeat", "--tolerance-mm", "0"]).contains("--tolerance-mm = 0"));
    let vehicle = here("station/vehicle/suv-a.toml");
    let said = refused(&["rotation", "--vehicle", vehicle.to_str().expect("UTF-8")]);
    assert!(said.contains("STUDY with --vehicle alone = rotation, allowed: advice"), "{said}");
    assert!(refused(&["repeat", "somewhere"]).contains("--calibration"));
}
