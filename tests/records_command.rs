//! `datum records`: listing, exporting and replaying, as a user runs it.

use datum::detect::{DEFAULT, Detector};
use datum::measure::{Measurer, json, measure};
use datum::records::*;
use datum::{Calibration, Capture, VehicleFile};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// An empty folder that no other test uses, removed at the end.
struct Room(PathBuf);

impl Room {
    fn new(name: &str) -> Self {
        let room = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("records-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&room);
        fs::create_dir_all(&room).expect("the target folder is writable");
        Self(room)
    }

    /// Runs `datum records` here; also what it says: standard output, standard error.
    fn run(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_datum"));
        let Output { status, stdout, stderr } =
            command.arg("records").args(arguments).current_dir(&self.0).output().expect("runs");
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (status.code(), text(stdout), text(stderr))
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn station(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station").join(path)
}

/// A day's records: a boot, the stored capture measured and kept, one refused, an alarm. Returns the measured one's id.
fn a_day(room: &Room) -> u64 {
    let calibration = Calibration::read(&station("calibration.toml")).expect("a calibration");
    let vehicle = VehicleFile::read(&station("vehicle/suv-a.toml")).expect("a model");
    let templates = vehicle.read_templates().expect("taught");
    let reference = Reference::new(calibration.clone(), vehicle.clone(), templates);
    // as the program does it: replay must find no difference
    let detector = Detector::named(Path::new(DEFAULT)).expect("it comes with the program");
    let measurer = Measurer::new(calibration, vehicle).expect("templates").with_detector(detector);
    let capture = Capture::open(&station("moved")).expect("a capture");
    let (measurement, _) = measure(&measurer, &capture, &mut |_| {}).expect("readable");

    let records = room.0.join("records");
    let mut journal = Journal::new(&records, Limits::of_mib(1));
    journal.append(1_795_564_800_000, &Event::Boot(Boot::default())).expect("stored");
    let array = json(std::slice::from_ref(&measurement));
    let object = array.trim_end().trim_start_matches('[').trim_end_matches(']');
    let measured = Vehicle {
        trigger_id: 42,
        vin: "WDATUM00000000042".into(),
        job: 1,
        job_fingerprint: 0,
        calibration_fingerprint: 0,
        verdict: Verdict::Ok,
        code: 0,
        detail: 0,
        sentence: String::new(),
        measurement: Some(object.into()),
        captures: 1,
        light: None,
        ambient: None,
        camera_celsius: None,
        projector_celsius: None,
        acquisition_ms: Some(1100),
        total_ms: Some(1200),
        images: true,
    };
    let mut refused = measured.clone();
    refused.vin = "WDATUM00000000043".into();
    (refused.verdict, refused.code) = (Verdict::NotMeasurable, 303);
    refused.sentence = "Light from outside is too strong or flickers.".into();
    refused.measurement = None;
    let id = journal.append(1_795_564_860_000, &Event::Vehicle(Box::new(measured))).expect("stored");
    journal.append(1_795_564_920_000, &Event::Vehicle(Box::new(refused))).expect("stored");
    let alarm = Alarm { code: 201, detail: 0, sentence: "The camera does not answer.".into() };
    journal.append(1_795_564_980_000, &Event::Alarm(alarm)).expect("stored");

    let captures = Captures::new(&records, 1 << 30, 0);
    let write = move |folder: &Path| {
        for file in fs::read_dir(station("moved"))? {
            let file = file?;
            fs::copy(file.path(), folder.join(file.file_name()))?;
        }
        Ok(reference.write(folder)?)
    };
    assert!(captures.keep(id, write));
    assert!(captures.finish().fault.is_none());
    id
}

#[test]
fn records_are_listed_by_what_is_asked_for() {
    let room = Room::new("list");
    let (status, _, said) = room.run(&[]);
    assert_eq!(
        (status, said.as_str()),
        (Some(2), "error: records: cannot be read: No such file or directory (os error 2)\n")
    );
    a_day(&room);
    let (status, table, said) = room.run(&[]);
    assert_eq!((status, table.lines().count(), said.as_str()), (Some(0), 5, ""));
    assert!(table.contains("WDATUM00000000042   1  ok ") && table.contains("303 Light from outside"), "{table}");
    for (arguments, lines) in [
        (&["--verdict", "ok,aborted"][..], 2),
        (&["list", "--vin", "wdatum"], 3),
        (&["--vin", "43", "--job", "1"], 2),
        (&["--job", "2"], 1),
        (&["--last", "1"], 2),
        (&["--record", "1,4"], 3),
        (&["--since", "2026-11-25T00:01", "--until", "2026-11-25T00:02:00Z"], 2),
    ] {
        let (status, table, _) = room.run(arguments);
        assert_eq!((status, table.lines().count()), (Some(0), lines), "{arguments:?}: {table}");
    }
    let (_, text, _) = room.run(&["--json", "--verdict", "ok"]);
    let all: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((all[0]["images"].as_str(), all[0]["record"].as_u64()), (Some("captures/0000000002"), Some(2)));
    assert_eq!(all[0]["measurement"]["verdict"], "ok");
    let (status, _, said) = room.run(&["--since", "yesterday"]);
    assert!(status == Some(2) && said.contains("allowed: a UTC time as 2026-11-22"), "{said}");
}

#[test]
fn damage_is_said_and_the_rest_is_listed() {
    let room = Room::new("damaged");
    a_day(&room);
    let segment = room.0.join("records/journal-00000000000000000001");
    let mut bytes = fs::read(&segment).expect("there");
    bytes[20] ^= 1; // in the first record
    fs::write(&segment, bytes).expect("writable");
    let (status, table, said) = room.run(&[]);
    assert_eq!((status, table.lines().count()), (Some(0), 4));
    assert!(said.starts_with("warning: records/journal-00000000000000000001: bytes 8 to "), "{said}");
}

#[test]
fn records_are_exported_and_kept_captures_copied_out() {
    let room = Room::new("export");
    a_day(&room);
    let (status, _, said) = room.run(&["export", "--out", "day.csv", "--captures", "out"]);
    assert_eq!((status, said.as_str()), (Some(0), "day.csv: 4 records\nout: 1 captures, 1 are no longer kept\n"));
    let text = fs::read_to_string(room.0.join("day.csv")).expect("written");
    assert_eq!(text.lines().count(), 3, "a heading and the vehicles: {text}");
    let copy = Capture::open(&room.0.join("out/0000000002")).expect("a whole capture");
    assert!(copy.images.red.is_some() && Reference::vehicle(&copy.folder).is_ok());
    let (status, _, said) = room.run(&["export", "--captures", "out"]);
    assert!(status == Some(2) && said.contains("out/0000000002: is there already"), "{said}");
    let (status, _, _) = room.run(&["export", "--out", "day.jsonl", "--last", "2"]);
    let text = fs::read_to_string(room.0.join("day.jsonl")).expect("written");
    assert_eq!((status, text.lines().count()), (Some(0), 2));
    let (status, _, said) = room.run(&["export", "--out", "day.xml"]);
    assert_eq!(said, "error: --out day.xml: allowed: a name that ends in .csv or .jsonl\n");
    assert_eq!(status, Some(2));
}

#[test]
fn a_kept_capture_measured_again_by_the_same_program_differs_by_nothing() {
    let room = Room::new("replay");
    let id = a_day(&room);
    let (status, table, said) = room.run(&["replay"]);
    assert_eq!((status, said.as_str()), (Some(0), ""), "{table}");
    let line: Vec<_> = table.lines().nth(1).expect("one capture").split_whitespace().collect();
    assert_eq!(line, ["2", "WDATUM00000000042", env!("CARGO_PKG_VERSION"), "ok", "+0", "+0", "+0", "+0", "+0", "+0"]);
    assert!(table.ends_with("1 captures measured again, 0 with another verdict, 0 not readable\n"));
    let (_, text, _) = room.run(&["replay", "--json"]);
    let all: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((all[0]["same_verdict"].as_bool(), all[0]["record"].as_u64()), (Some(true), Some(id)));

    let (status, said, _) = room.run(&["replay", "--reproduce", "--kept", "3"]);
    assert!(status == Some(0) && said.ends_with("1 of 1 reproduced within 5 µm and 0.001°\n"), "{said}");
    let (status, said, _) = room.run(&["replay", "--reproduce", "--kept", "0"]);
    assert!(status == Some(0) && said.ends_with("0 of 0 reproduced within 5 µm and 0.001°\n"), "{said}");

    // by a model whose limits it exceeds the verdict is another, and that is an exit status of 1
    let model = fs::read_to_string(station("vehicle/suv-a.toml")).expect("there");
    let stricter = room.0.join("vehicle");
    fs::create_dir(&stricter).expect("writable");
    for file in fs::read_dir(station("vehicle")).expect("there") {
        let file = file.expect("readable");
        fs::copy(file.path(), stricter.join(file.file_name())).expect("writable");
    }
    let strict = model.replace("yaw_deg = 15.0", "yaw_deg = 0.5");
    assert_ne!(model, strict);
    fs::write(stricter.join("suv-a.toml"), strict).expect("writable");
    let (status, table, _) = room.run(&["replay", "--vehicle", "vehicle/suv-a.toml"]);
    assert!(status == Some(1) && table.contains("ok → out-of-limits 605"), "{table}");

    // with the same verdict, but by a calibration whose baseline is 0.02 mm longer, the pose is another
    let kept = room.0.join("records/captures/0000000002/calibration.toml");
    let as_kept = fs::read_to_string(&kept).expect("kept with it");
    let longer = as_kept.replace("translation_mm = [213.000087", "translation_mm = [213.02");
    assert_ne!(as_kept, longer);
    fs::write(&kept, longer).expect("writable");
    assert_eq!(room.run(&["replay"]).0, Some(0));
    let (status, said, _) = room.run(&["replay", "--reproduce"]);
    assert!(status == Some(1) && said.ends_with("0 of 1 reproduced within 5 µm and 0.001°\n"), "{said}");

    fs::remove_file(room.0.join("records/captures/0000000002/vehicle.toml")).expect("kept with it");
    let (status, _, said) = room.run(&["replay"]);
    assert_eq!(status, Some(2));
    assert!(said.starts_with("error: record 2: records/captures/0000000002/vehicle.toml: cannot be read"), "{said}");
}
