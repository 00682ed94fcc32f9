//! What `measure` prints is frozen: others read it. `REGENERATE=1 cargo test --release` rewrites the files in
//! tests/data; read the difference.

use datum::calibrate::Health;
use datum::measure::*;
use datum::{Code, Pose, frame};

fn results() -> [Measurement; 3] {
    let pose = Pose::<frame::Camera, frame::Vehicle>::new(
        nalgebra::Rotation3::from_matrix_unchecked(nalgebra::Matrix3::new(
            0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0,
        )),
        nalgebra::Vector3::new(1.5, -2.0, 700.0),
    );
    let mut covariance = [[0.0; 6]; 6];
    for (i, row) in covariance.iter_mut().enumerate() {
        row[i] = if i < 3 { 0.01 } else { 1e-8 };
    }
    let found = |name: &str, score| FeatureResult {
        pixel: Some([383.64, 688.88]),
        camera_mm: Some([-100.25, 50.5, 710.0]),
        covariance_mm2: Some([[0.01, 0.0, 0.0], [0.0, 0.01, 0.0], [0.0, 0.0, 0.02]]),
        residual_mm: Some(0.05),
        score: Some(score),
        region: Some("detector"),
        ..FeatureResult::unknown(name)
    };
    let ok = Measurement {
        camera_from_vehicle: Some((&pose).into()),
        station_from_vehicle: Some((&Pose::<frame::Station, frame::Vehicle>::identity()).into()),
        reference_mm: Some(Xyz { x: -50.25, y: 0.125, z: 0.0 }),
        euler_deg: Some(Euler { roll: 0.01, pitch: -0.02, yaw: 12.5 }),
        covariance: Some(covariance),
        covariance_at_mm: Some([-2625.0, 870.0, 742.0]),
        uncertainty_k2: Some(Uncertainty {
            x_mm: 0.2,
            y_mm: 0.25,
            z_mm: 0.3,
            roll_deg: 0.01,
            pitch_deg: 0.02,
            yaw_deg: 0.03,
            targets: vec![TargetUncertainty { name: "front-radar".into(), mm: 0.9 }],
        }),
        features: vec![found("corner-1", 0.97), found("corner-2", 0.9375), found("cap", 0.99)],
        residual_rms_mm: Some(0.06),
        distance_deviation_mm: Some(0.08),
        depth_coverage: Some(0.985),
        timing_ms: Timing { read: Some(12.5), total: Some(140.0), ..Timing::default() },
        ..Measurement::without_pose("white-tx_00".into(), Verdict::Ok, None, String::new(), Method::Points)
    };
    let refused = Measurement {
        features: vec![
            found("corner-1", 0.97),
            FeatureResult { code: Some(Code::NotFound), ..FeatureResult::unknown("corner-2") },
            FeatureResult { score: Some(f64::NAN), ..FeatureResult::unknown("cap") },
        ],
        calibration_health: Some(Health {
            index: 8.5,
            epipolar_px: 0.0125,
            scale_percent: Some(-0.0625),
            scale_sigma_percent: None,
            healthy: false,
            detail: "calibration health: the camera seems turned".into(),
            turn: None,
            size: None,
        }),
        ..Measurement::without_pose(
            "b".into(),
            Verdict::NotMeasurable,
            Some(Code::TooFewFeatures),
            Code::TooFewFeatures.entry().sentence.into(),
            Method::Points,
        )
    };
    let detail = "c/capture.toml: cannot be read: \"no\" such file".into();
    [ok, refused, Measurement::without_pose("c".into(), Verdict::Error, None, detail, Method::Dense)]
}

fn frozen(name: &str, now: &str) {
    let path = format!("{}/tests/data/{name}", env!("CARGO_MANIFEST_DIR"));
    if std::env::var_os("REGENERATE").is_some() {
        std::fs::write(&path, now).expect("tests/data is writable");
    }
    let before = std::fs::read_to_string(&path).expect("the file is tracked");
    assert!(before.lines().count() >= 3, "{path} is all but empty");
    assert_eq!(now, before, "REGENERATE=1 cargo test --release, then read the diff");
}

#[test]
fn the_json_is_frozen() {
    frozen("measure.json", &json(&results()));
}

#[test]
fn the_table_is_frozen() {
    frozen("measure.txt", &table(&results()));
}

#[test]
fn the_keys_and_their_order_are_those_of_the_contract() {
    let text = json(&results()[..1]);
    let mut rest = text.as_str();
    for key in [
        "capture",
        "verdict",
        "code",
        "detail",
        "method",
        "station",
        "camera_from_vehicle",
        "rotation",
        "translation_mm",
        "station_from_vehicle",
        "rotation",
        "translation_mm",
        "reference_mm",
        "x",
        "y",
        "z",
        "euler_deg",
        "roll",
        "pitch",
        "yaw",
        "covariance",
        "covariance_at_mm",
        "uncertainty_k2",
        "x_mm",
        "y_mm",
        "z_mm",
        "roll_deg",
        "pitch_deg",
        "yaw_deg",
        "targets",
        "name",
        "mm",
        "features",
        "name",
        "code",
        "pixel",
        "camera_mm",
        "covariance_mm2",
        "residual_mm",
        "score",
        "region",
        "residual_rms_mm",
        "distance_deviation_mm",
        "depth_coverage",
        "points_minus_dense_mm",
        "calibration_health",
        "timing_ms",
        "read",
        "detect",
        "decode",
        "surface",
        "contour",
        "pose",
        "total",
    ] {
        let at = rest.find(&format!("\"{key}\":")).unwrap_or_else(|| panic!("{key} missing, or out of order"));
        rest = &rest[at + 1..];
    }
}

#[test]
fn what_is_unknown_is_null_and_never_zero() {
    let value: serde_json::Value = serde_json::from_str(&json(&results())).expect("JSON");
    assert!(value[1]["calibration_health"]["scale_sigma_percent"].is_null());
    for refused in [&value[1], &value[2]] {
        for key in ["camera_from_vehicle", "station_from_vehicle", "covariance", "uncertainty_k2", "residual_rms_mm"] {
            assert!(refused.get(key).is_some_and(serde_json::Value::is_null), "{key} of {refused}");
        }
    }
    assert!(value[1]["features"][2]["score"].is_null(), "NaN is unknown");
    assert_eq!((&value[1]["code"], &value[1]["features"][1]["code"]), (&601.into(), &401.into()));
    assert_eq!((&value[0]["code"], value[2]["verdict"].as_str()), (&0.into(), Some("error")));
}
