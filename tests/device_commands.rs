//! What doctor, safe and capture say on a machine that has none of the devices, and on the simulated station.

use std::path::{Path, PathBuf};
use std::process::Command;

fn datum(arguments: &[&str]) -> (Option<i32>, String, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_datum")).args(arguments).output().expect("runs");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (out.status.code(), text(&out.stdout), text(&out.stderr))
}

fn file(name: &str, content: &str) -> PathBuf {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}.toml", std::process::id()));
    std::fs::write(&file, content).expect("writable");
    file
}

/// Of devices that no machine has.
fn absent(camera: &str) -> String {
    format!(
        r#"
format = 1
camera = {{ kind = "v4l2", device = "{camera}" }}
projector = {{ kind = "v4l2-output", device = "no such projector" }}
[lights]
kind = "gpio"
left = "no-such-chip/left"
right = "no-such-chip/right"
left_pwm = "no-such.pwm/0"
right_pwm = "no-such.pwm/1"
[presence]
kind = "gpio"
line = "no-such-chip/vehicle"
"#
    )
}

#[test]
fn doctor_names_every_device_that_is_not_there_and_says_what_to_do() {
    let config = file("absent", &absent("/dev/no-such-camera"));
    let (status, said, _) = datum(&["doctor", "--config", config.to_str().expect("UTF-8")]);
    assert_eq!(status, Some(3), "{said}");
    for (about, hint) in [
        ("WRONG  camera ", "There is no such node"),
        ("WRONG  projector ", "Check cable and power, and the key `device`"),
        ("WRONG  light bars ", "The PWM is absent"),
        ("WRONG  presence sensor ", "Check the key that names the line"),
        ("?      light ", "Put right what is wrong above"),
    ] {
        let line = said.lines().position(|l| l.starts_with(about)).unwrap_or_else(|| panic!("{about}: {said}"));
        let next = said.lines().nth(line + 1).unwrap_or_default();
        assert!(next.trim_start().starts_with(&format!("-> {hint}")), "{about}: {said}");
    }
    assert!(said.lines().any(|l| l.starts_with("ok     clock ")), "{said}");
    std::fs::remove_file(config).expect("just written");
}

#[test]
fn doctor_names_a_node_that_is_no_camera() {
    let config = file("null", &absent("/dev/null"));
    let (status, said, _) = datum(&["doctor", "--config", config.to_str().expect("UTF-8")]);
    assert!(status == Some(3) && said.contains("-> This is the wrong node"), "{said}");
    std::fs::remove_file(config).expect("just written");
}

#[test]
fn doctor_finds_the_simulated_station_well() {
    let config = file("well", "format = 1\n[simulation]\nscale = 0.25\n[records]\ncaptures_mib = 0\n");
    let (status, said, _) = datum(&["doctor", "--config", config.to_str().expect("UTF-8")]);
    assert!(status == Some(0) && !said.contains("->"), "{said}");
    assert!(said.contains("light of the bars") && said.contains("projector's light"), "{said}");
    std::fs::remove_file(config).expect("just written");
}

#[test]
fn doctor_names_a_size_that_was_not_calibrated() {
    let calibration = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station/calibration.toml");
    let text = absent("/dev/null").replacen("format = 1", &format!("format = 1\ncalibration = {calibration:?}"), 1);
    let config = file("size", &text);
    let (status, said, _) = datum(&["doctor", "--config", config.to_str().expect("UTF-8")]);
    let says = "WRONG  calibration                   camera.width and camera.height = 2592×1944, allowed: 648×486";
    assert!(status == Some(3) && said.contains(says) && said.contains("-> The size is wrong"), "{said}");
    std::fs::remove_file(config).expect("just written");
}

#[test]
fn safe_tries_every_output_and_tells_of_each_that_it_did_not_reach() {
    let config = file("unsafe", &absent("/dev/no-such-camera"));
    let (status, _, said) = datum(&["safe", "--config", config.to_str().expect("UTF-8")]);
    assert_eq!(status, Some(3), "{said}");
    for name in ["\"no-such-chip\"", "\"no-such.pwm\"", "\"no such projector\""] {
        assert!(said.contains(name), "{name}: {said}");
    }
    std::fs::remove_file(config).expect("just written");
    let config = file("simulated", "format = 1\n");
    let (status, said, _) = datum(&["safe", "--config", config.to_str().expect("UTF-8")]);
    assert!(status == Some(0) && said.starts_with("Nothing to turn off"), "{said}");
    std::fs::remove_file(config).expect("just written");
}

#[test]
fn run_on_devices_that_are_not_there_ends_with_a_device_fault() {
    let calibration = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station/calibration.toml");
    let records = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("run-records-{}", std::process::id()));
    let text = absent("/dev/no-such-camera").replacen(
        "format = 1\n",
        &format!("format = 1\ncalibration = {calibration:?}\nrecords = {{ folder = {records:?} }}\n"),
        1,
    );
    let config = file("run", &text);
    let (status, _, said) = datum(&["run", "--config", config.to_str().expect("UTF-8")]);
    assert!(status == Some(3) && said.contains("`datum doctor` says more"), "{said}");
    std::fs::remove_file(config).expect("just written");
    std::fs::remove_dir_all(records).expect("the lock, at least");
}

#[test]
fn capture_records_what_stands_before_the_station() {
    let config = file("capture", "format = 1\n[simulation]\nscale = 0.25\n");
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("captured-{}", std::process::id()));
    let folder = out.to_str().expect("UTF-8");
    let (status, said, _) = datum(&["capture", "--config", config.to_str().expect("UTF-8"), "--out", folder]);
    assert!(status == Some(0) && said.contains("16 fringe images"), "{said}");
    let capture = datum::Capture::open(&out).expect("whole");
    assert_eq!((capture.camera.width, capture.fringes.len()), (648, 3));
    std::fs::remove_file(config).expect("just written");
    std::fs::remove_dir_all(out).expect("just written");
}
