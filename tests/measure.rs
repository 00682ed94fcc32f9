//! From a taught capture to the pose of a moved vehicle, on a small pair of captures whose truth is known
//! (tests/data/README.md).

mod common;

use common::{Set, here, over_sigma};
use datum::VehicleFile;
use datum::measure::Verdict;
use serde_json::Value;

// At 1.1 mm per pixel; about twice what was found. A feature off by a quarter of a pixel fails.
const TRANSLATION_MM: f64 = 0.10;
const ROTATION_DEG: f64 = 0.015;
const FEATURE_MM: f64 = 0.25;
/// Six axes of one pose: by chance the largest is beyond this once in 2600 captures.
const SIGMAS: f64 = 4.0;

fn set() -> (Set, VehicleFile) {
    let set = Set::open(here("station"));
    let features = VehicleFile::read(&set.folder.join("features.toml")).expect("features");
    (set, features)
}

#[test]
fn a_moved_vehicle_is_where_it_is_said_to_be() {
    let (set, features) = set();
    let taught = set.teach("taught", &features);
    assert_eq!(taught.check.verdict, Verdict::Ok, "{}", taught.check.detail);
    let measurer = set.measurer(&taught, "moved");
    for name in ["moved", "taught"] {
        let (m, drawing) = set.measure(&measurer, name);
        assert_eq!((m.verdict, m.code), (Verdict::Ok, None), "{name}: {}", m.detail);
        let truth = set.truth(name);
        let error = truth.error(&m).expect("ok has a pose");
        let (t, r) = (error.fixed_rows::<3>(0).into_owned(), error.fixed_rows::<3>(3).map(f64::to_degrees));
        assert!(t.amax() < TRANSLATION_MM, "{name}: {t:?} mm");
        assert!(r.amax() < ROTATION_DEG, "{name}: {r:?}°");
        let over = over_sigma(&error, &m);
        assert!(over.amax() < SIGMAS, "{name}: {over:?} sigma");
        let features = truth.feature_errors(&m, &taught.model);
        assert_eq!(features.len(), 4, "{name}: {:?}", m.features);
        for (feature, e) in features {
            assert!(e.amax() < FEATURE_MM, "{name}: {feature} {e:?} mm");
        }
        assert!(drawing.contours.len() > 200 && drawing.regions.len() == 4, "{name}: little to draw");
    }
}

/// A result as text: every bit of every number, unlike `==`, which takes -0 for 0 and no NaN for itself.
#[test]
fn the_number_of_threads_and_a_replay_change_no_bit() {
    let (set, features) = set();
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let taught = set.teach("taught", &features);
            let measurer = set.measurer(&taught, &format!("threads-{threads}"));
            let templates: Vec<_> = taught.templates.iter().map(|t| t.to_bytes()).collect();
            let moved = || format!("{:?}", set.measure(&measurer, "moved"));
            (templates, moved(), moved())
        })
    };
    let (one, three) = (run(1), run(3));
    assert!(one.1 == one.2, "a replay differs");
    assert!(one.0 == three.0, "templates depend on the number of threads");
    assert!(one.1 == three.1, "results depend on the number of threads");
}

/// What the program prints for a capture, measured with the tracked model, has the keys of the frozen example, no more
/// and no fewer, and every number of it is known.
#[test]
fn the_program_prints_every_key_of_the_contract() {
    let folder = here("station");
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_datum"))
        .args(["measure", "--json", "--calibration"])
        .arg(folder.join("calibration.toml"))
        .arg("--vehicle")
        .arg(folder.join("vehicle/suv-a.toml"))
        .arg(folder.join("moved"))
        .output()
        .expect("the program runs");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let printed: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let frozen = std::fs::read_to_string(here("measure.json")).expect("the file is tracked");
    let frozen: Value = serde_json::from_str(&frozen).expect("JSON");
    let paths = |v: &Value| {
        let mut found = std::collections::BTreeSet::new();
        walk(v, String::new(), &mut found);
        found
    };
    let known = paths(&printed[0]);
    assert!(known.len() > 50, "{known:?}");
    assert_eq!(known, paths(&frozen[0]));
    let nulls = |v: &Value| serde_json::to_string(v).expect("JSON").matches("null").count();
    assert_eq!(nulls(&printed[0]), 1, "only points_minus_dense_mm is unknown: {printed}");
}

/// Every key below `v`, with the keys above it; the items of a list share theirs.
fn walk(v: &Value, path: String, found: &mut std::collections::BTreeSet<String>) {
    match v {
        Value::Object(map) => {
            for (key, value) in map {
                let path = format!("{path}.{key}");
                found.insert(path.clone());
                walk(value, path, found);
            }
        }
        Value::Array(items) => items.iter().for_each(|item| walk(item, path.clone(), found)),
        _ => {}
    }
}
