//! Teaching refuses what cannot be right, and knows corners by more than a click.

mod common;

use common::{Set, here};
use datum::VehicleFile;
use datum::measure::{Verdict, teach};
use datum::vehicle::Definition;

fn set() -> (Set, VehicleFile) {
    let set = Set::open(here("station"));
    let features = VehicleFile::read(&set.folder.join("features.toml")).expect("features");
    (set, features)
}

/// The sentence with which teaching `features` is refused.
fn refusal(set: &Set, features: &VehicleFile) -> String {
    let capture = set.capture("taught");
    match teach(&capture, &set.calibration, features, "m") {
        Ok(taught) => panic!("taught, and measures itself: {:?}", taught.check.verdict),
        Err(e) => e.to_string(),
    }
}

#[test]
fn positions_in_inches_are_refused_by_name() {
    let (set, mut features) = set();
    for f in &mut features.features {
        f.position_mm = f.position_mm.map(|v| v / 25.4);
    }
    let text = refusal(&set, &features);
    assert!(text.contains("features.toml: feature[1].position_mm") && text.contains("inches"), "{text}");
}

#[test]
fn mirrored_positions_are_refused() {
    let (set, mut features) = set();
    for f in &mut features.features {
        f.position_mm[1] = -f.position_mm[1];
    }
    let text = refusal(&set, &features);
    assert!(text.contains("y is left"), "{text}");
}

#[test]
fn clicks_on_each_others_feature_are_refused() {
    let (set, mut features) = set();
    let clicks: Vec<_> = features.features.iter().map(|f| f.pixel).collect();
    (features.features[0].pixel, features.features[2].pixel) = (clicks[2], clicks[0]);
    let text = refusal(&set, &features);
    assert!(text.contains("feature"), "{text}");
}

#[test]
fn a_cap_clicked_beside_its_ring_is_refused() {
    let (set, mut features) = set();
    let cap = features.features.iter_mut().find(|f| f.name == "cap").expect("a cap");
    cap.pixel = cap.pixel.map(|[x, y]| [x + 110.0, y]);
    let text = refusal(&set, &features);
    assert!(text.contains("cap") || text.contains("position_mm"), "{text}");
}

/// Where two edges meet does not depend on how well the corner was clicked.
#[test]
fn an_edge_intersection_forgets_the_click() {
    let (set, mut features) = set();
    for f in features.features.iter_mut().take(2) {
        f.definition = Some(Definition::EdgeIntersection);
    }
    let exact = set.teach("taught", &features);
    for (k, f) in features.features.iter_mut().take(2).enumerate() {
        let off = if k == 0 { 2.0 } else { -2.0 };
        f.pixel = f.pixel.map(|[x, y]| [x + off, y - off]);
    }
    let sloppy = set.teach("taught", &features);
    for (a, b) in exact.check.features.iter().zip(&sloppy.check.features).take(2) {
        let (a, b) = (a.camera_mm.expect("measured"), b.camera_mm.expect("measured"));
        let off = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
        assert!(off < 0.15, "{off} mm apart after clicks 3 mm apart"); // at 1.1 mm per pixel
    }
    let measurer = set.measurer(&sloppy, "sloppy");
    let (m, _) = set.measure(&measurer, "moved");
    assert_eq!(m.verdict, Verdict::Ok, "{}", m.detail);
}
