//! The experiments that hold something against the published method's own tables: their quick forms.

use datum::study::{Cell, Given, Outcome, STUDIES, Stored, Table};
use datum::{Calibration, VehicleFile};
use std::path::Path;

fn quick(name: &str, stored: Option<Stored>) -> Outcome {
    let study = STUDIES.iter().find(|s| s.name == name).expect("listed");
    let given = Given { scale: 0.25, quick: true, seed: 1, stored, vehicle: None, tolerance: (1.0, 0.3) };
    let outcome = (study.run)(&given, &()).unwrap_or_else(|e| panic!("{name}: {e}"));
    eprintln!("{name}: {outcome:#?}");
    assert!(outcome.passed(), "{name}: a figure misses its target: {:#?}", outcome.figures);
    assert!(outcome.tables.iter().all(|t| !t.rows.is_empty() && t.rows.iter().all(|r| r.len() == t.columns.len())));
    outcome
}

fn figure(outcome: &Outcome, name: &str) -> f64 {
    let found = outcome.figures.iter().find(|f| f.name == name).unwrap_or_else(|| panic!("no figure {name}"));
    found.value.unwrap_or_else(|| panic!("{name}: no value"))
}

fn number(cell: &Cell) -> f64 {
    let Cell::Number(Some(v), _) = cell else { panic!("no number: {cell:?}") };
    *v
}

/// The row whose first cells are these.
fn row<'t>(table: &'t Table, cells: &[&str]) -> &'t [Cell] {
    let begins = |r: &&Vec<Cell>| r.iter().zip(cells).all(|(c, text)| c.to_string() == *text);
    table.rows.iter().find(begins).unwrap_or_else(|| panic!("{}: no row {cells:?}", table.title))
}

fn times(outcome: &Outcome) -> [f64; 2] {
    ["position", "rotation"].map(|what| figure(outcome, &format!("published method over ours, rms {what}")))
}

#[test]
fn the_published_method_errs_as_published_on_what_ours_measures_far_better() {
    let simulated = quick("control", None);
    assert!(times(&simulated).iter().all(|t| *t > 5.0), "simulated: {:?}", times(&simulated));
    let rms = figure(&simulated, "published method: rms position error");
    assert!((0.2..3.0).contains(&rms), "neither a straw man nor kind captures: {rms} mm");
    assert_eq!(figure(&simulated, "ours: poses"), 100.0);

    let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
    let stored = Stored {
        captures: ["moved", "taught"].map(|name| station.join(name)).to_vec(),
        calibration: Calibration::read(&station.join("calibration.toml")).expect("test data"),
        vehicle: VehicleFile::read(&station.join("vehicle/suv-a.toml")).expect("test data"),
    };
    let stored = quick("control", Some(stored));
    assert!(times(&stored).iter().all(|t| *t > 5.0), "stored: {:?}", times(&stored));
    let moved = row(&stored.tables[0], &["moved"]);
    assert!(number(&moved[1]) > number(&moved[4]), "{moved:?}");
    assert!(moved[3].to_string().starts_with("too-uncertain") && moved[6].to_string() == "ok", "{moved:?}");
}

#[test]
fn a_corner_beside_its_place_moves_the_pose_as_its_covariance_says() {
    let outcome = quick("corner", None);
    let (mm, deg) = (figure(&outcome, "largest shift of the centroid"), figure(&outcome, "largest rotation"));
    assert!((0.05..1.56).contains(&mm) && (0.01..0.35).contains(&deg), "{mm} mm, {deg}°");
}

#[test]
fn fixed_exposures_have_a_window_and_the_closed_loop_has_none_below_500_lx() {
    let outcome = quick("light", None);
    assert_eq!(outcome.tables.len(), 3);
    let cell = |table: usize, lux: &str, paint: usize| row(&outcome.tables[table], &[lux])[paint].to_string();
    assert_eq!(cell(0, "200", 1), "ok", "white, as exposed for");
    assert_ne!(cell(0, "20", 1), "ok", "too dark with the loop open");
    assert_ne!(cell(1, "2000", 1), "ok", "too bright with the loop open");
    assert!(
        (1..=2).all(|paint| cell(2, "20", paint) == "ok" && cell(2, "500", paint) == "ok"),
        "white and red, closed"
    );
    assert_eq!(figure(&outcome, "wrong poses called ok"), 0.0);
}

#[test]
fn red_bars_light_red_paint_better_than_white_ones() {
    let outcome = quick("colour", None);
    let edge = |paint: &str, light: &str| number(&row(&outcome.tables[0], &[paint, light])[5]);
    assert!(edge("red", "red") > 1.5 * edge("red", "white"), "{} {}", edge("red", "red"), edge("red", "white"));
    let same = edge("white", "red") / edge("white", "white");
    assert!((0.95..1.05).contains(&same), "white paint knows no colour: {same}");
}
