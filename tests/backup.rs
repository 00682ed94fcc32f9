//! `datum backup`, `restore` and `reset`, as a person at the machine uses them.

use datum::backup::Backup;
use datum::records::{Boot, Event, Journal, Limits};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// An empty folder that no other test uses, removed at the end.
struct Room(PathBuf);

impl Room {
    fn new(name: &str) -> Self {
        let room = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("backup-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&room);
        fs::create_dir_all(&room).expect("the target folder is writable");
        Self(room)
    }

    /// Runs datum here; also what it says: standard output, standard error.
    fn run(&self, arguments: &[&str]) -> (Option<i32>, String, String) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_datum"));
        let Output { status, stdout, stderr } = command.args(arguments).current_dir(&self.0).output().expect("runs");
        let text = |bytes| String::from_utf8(bytes).expect("text");
        (status.code(), text(stdout), text(stderr))
    }

    fn write(&self, name: &str, content: impl AsRef<[u8]>) {
        let file = self.0.join(name);
        fs::create_dir_all(file.parent().expect("below the room")).expect("writable");
        fs::write(file, content).expect("writable");
    }

    fn read(&self, name: &str) -> Vec<u8> {
        fs::read(self.0.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
    }

    /// Every file below a folder with its content, by its path from there.
    fn files(&self, folder: &str) -> BTreeMap<String, Vec<u8>> {
        let (top, mut found) = (self.0.join(folder), BTreeMap::new());
        let mut folders = vec![top.clone()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(&folder).expect("a folder") {
                let path = entry.expect("readable").path();
                if path.is_dir() {
                    folders.push(path);
                } else {
                    let name = path.strip_prefix(&top).expect("below it").to_string_lossy().into_owned();
                    found.insert(name, fs::read(&path).expect("readable"));
                }
            }
        }
        found
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

const CONFIG: &str =
    "format = 1\nserial = \"LINE-3\"\ncalibration = \"calibration.toml\"\n[plc]\nlisten = \"127.0.0.1:5021\"\n";

/// A calibrated station with one taught job and an identity, in the folder `at`.
fn a_station(room: &Room, at: &str) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
    room.write(&format!("{at}/station.toml"), CONFIG);
    room.write(&format!("{at}/calibration.toml"), fs::read(data.join("calibration.toml")).expect("there"));
    for file in fs::read_dir(data.join("vehicle")).expect("there") {
        let path = file.expect("readable").path();
        let name = path.file_name().expect("a file").to_string_lossy().replace("suv-a.toml", "012-suv-a.toml");
        room.write(&format!("{at}/vehicles/{name}"), fs::read(&path).expect("readable"));
    }
    room.write(&format!("{at}/identity/hostname"), "datum-line-3\n");
}

#[test]
fn a_station_is_restored_on_a_fresh_device_bit_by_bit() {
    let room = Room::new("fresh");
    a_station(&room, "a");
    let (status, said, errors) = room.run(&["backup", "b.datum", "--config", "a/station.toml"]);
    assert_eq!((status, errors.as_str()), (Some(0), ""), "{said}");
    assert!(said.starts_with("b.datum: 8 files of station LINE-3, "), "{said}");

    let dry = ["restore", "b.datum", "--config", "new/station.toml", "--dry-run"];
    let (status, said, _) = room.run(&dry);
    assert_eq!(status, Some(0), "{said}");
    assert_eq!(said.lines().filter(|l| l.starts_with("  new ")).count(), 8, "{said}");
    assert!(said.contains("Nothing was changed.") && !room.0.join("new").exists(), "{said}");

    let (status, said, errors) = room.run(&dry[..4]);
    assert_eq!((status, errors.as_str()), (Some(0), ""), "{said}");
    assert!(said.ends_with("Restored.\n"), "nothing was there that would be kept aside: {said}");
    assert!(room.files("new") == room.files("a"), "{:?}", room.files("new").keys());
    let (status, said, _) = room.run(&dry[..4]);
    assert!(status == Some(0) && said.contains("Nothing to do"), "{said}");
    assert!(room.files("new") == room.files("a"), "{:?}", room.files("new").keys());
}

#[test]
fn what_is_replaced_is_kept_aside_and_records_stay() {
    let room = Room::new("replaced");
    a_station(&room, "a");
    room.run(&["backup", "b.datum", "--config", "a/station.toml"]);
    let backed_up = room.files("a");
    room.write("a/station.toml", CONFIG.replace("LINE-3", "LINE-4"));
    room.write("a/vehicles/013-other.toml", "format = 1 # a job that was taught since\n");
    fs::remove_file(room.0.join("a/identity/hostname")).expect("written above");
    room.write("a/records/journal-00000000000000000001", "what was measured");
    let before = room.files("a");

    let restore = ["restore", "b.datum", "--config", "a/station.toml"];
    let (status, said, _) = room.run(&[&restore[..], &["--dry-run"]].concat());
    assert_eq!(status, Some(0));
    for line in ["replaced  station.toml", "removed   vehicles/013-other.toml", "new       identity/hostname"] {
        assert!(said.lines().any(|l| l.trim() == line), "{line}: {said}");
    }
    assert!(said.contains("as it is  calibration.toml") && !said.contains("journal"), "{said}");
    assert!(room.files("a") == before, "a dry run changes nothing");

    let (status, said, errors) = room.run(&restore);
    assert_eq!((status, errors.as_str()), (Some(0), ""));
    assert!(said.ends_with("what was there before is in a/before-restore-1.\n"), "{said}");
    let mut after = room.files("a");
    assert_eq!(after.remove("records/journal-00000000000000000001"), Some(b"what was measured".to_vec()));
    let aside: Vec<_> = after.keys().filter(|n| n.starts_with("before-restore-1/")).cloned().collect();
    assert_eq!(aside, ["before-restore-1/station.toml", "before-restore-1/vehicles/013-other.toml"]);
    for name in aside {
        assert_eq!(after.remove(&name), before.get(&name["before-restore-1/".len()..]).cloned());
    }
    after.remove("records/lock");
    assert!(after == backed_up, "{:?}", after.keys());

    room.write("a/station.toml", CONFIG.replace("LINE-3", "LINE-5"));
    let (_, said, _) = room.run(&restore);
    assert!(said.contains("a/before-restore-2.") && room.files("a/before-restore-1").len() == 2, "{said}");
}

#[test]
fn a_backup_that_is_foreign_torn_damaged_or_of_another_major_version_is_refused_and_changes_nothing() {
    let room = Room::new("refused");
    a_station(&room, "a");
    room.run(&["backup", "b.datum", "--config", "a/station.toml"]);
    let good = room.read("b.datum");
    let whole = Backup::read(&room.0.join("b.datum")).expect("just written");
    let made = |name: &str, change: &dyn Fn(&mut Backup)| {
        let mut other = whole.clone();
        change(&mut other);
        other.write(&room.0.join(name)).expect("writable");
    };
    made("major.datum", &|b| b.software = "7.0.0".into());
    made("escape.datum", &|b| drop(b.files.insert("../evil".into(), Vec::new())));
    made("more.datum", &|b| drop(b.files.insert("authorized_keys".into(), Vec::new())));
    made("no-config.datum", &|b| drop(b.files.remove("station.toml")));
    made("bad-config.datum", &|b| drop(b.files.insert("station.toml".into(), b"format = 1\nserail = 3\n".to_vec())));
    made("no-calibration.datum", &|b| drop(b.files.remove("calibration.toml")));
    room.write("foreign.datum", b"PK\x03\x04 something else that is long enough to be read as a header");
    room.write("torn.datum", &good[..good.len() - 100]);
    room.write("stump.datum", &good[..14]);
    room.write("longer.datum", [&good[..], b"x"].concat());
    let flipped = |at: usize| {
        let mut bytes = good.clone();
        bytes[at] ^= 0x10;
        bytes
    };
    room.write("flipped.datum", flipped(good.len() / 2));
    room.write("checksum.datum", flipped(good.len() - 1));
    room.write("format.datum", flipped(12));
    let before = room.files("a");
    for (name, says) in [
        ("major.datum", "major.datum: version = 7.0.0, allowed: 0.x.y: this is datum "),
        ("escape.datum", "escape.datum: name = \"../evil\", allowed: a path below"),
        ("more.datum", "backup = \"authorized_keys\", allowed: files that the configuration in it names"),
        ("no-config.datum", "station.toml: cannot be read"),
        ("bad-config.datum", "unknown field `serail`"),
        ("no-calibration.datum", "calibration.toml: cannot be read"),
        ("foreign.datum", "no backup of datum"),
        ("torn.datum", "torn: "),
        ("stump.datum", "torn: 14 bytes"),
        ("longer.datum", "torn: "),
        ("flipped.datum", "damaged: its checksum"),
        ("checksum.datum", "damaged: its checksum"),
        ("format.datum", "format = 17, allowed: 1"),
        ("absent.datum", "cannot be read"),
    ] {
        for config in ["a/station.toml", "new/station.toml"] {
            let (status, _, said) = room.run(&["restore", name, "--config", config]);
            assert!(status == Some(2) && said.contains(name) && said.contains(says), "{name}: {said}");
        }
        assert!(room.files("a") == before && !room.0.join("new").exists(), "{name} changed something");
    }
    // every bit is under the checksum: none may be flipped unseen
    for at in (0..good.len()).step_by(good.len() / 97) {
        room.write("bit.datum", flipped(at));
        assert!(Backup::read(&room.0.join("bit.datum")).is_err(), "byte {at}");
    }
}

#[test]
fn a_backup_is_neither_overwritten_nor_made_of_what_cannot_be_restored() {
    let room = Room::new("made");
    a_station(&room, "a");
    let backup = ["backup", "b.datum", "--config", "a/station.toml"];
    room.run(&backup);
    let (status, _, said) = room.run(&backup);
    assert!(status == Some(2) && said.contains("no backup is overwritten"), "{said}");
    room.write("a/outside.toml", CONFIG.replace("calibration.toml", "../calibration.toml"));
    let (status, _, said) = room.run(&["backup", "c.datum", "--config", "a/outside.toml"]);
    assert!(status == Some(2) && said.contains("cannot be read"), "{said}");
    room.write("calibration.toml", room.read("a/calibration.toml"));
    let (status, _, said) = room.run(&["backup", "c.datum", "--config", "a/outside.toml"]);
    let says = "calibration = ../calibration.toml, allowed: a path below the configuration's folder";
    assert!(status == Some(2) && said.contains(says), "{said}");
    // a model that is of no use is told, and kept all the same
    room.write("a/vehicles/013-broken.toml", "format = 1\n");
    let (status, _, said) = room.run(&["backup", "c.datum", "--config", "a/station.toml"]);
    assert!(status == Some(0) && said.contains("warning: a/vehicles/013-broken.toml"), "{said}");
    assert!(Backup::read(&room.0.join("c.datum")).expect("whole").files.contains_key("vehicles/013-broken.toml"));
}

#[test]
fn nothing_is_restored_or_reset_while_the_service_runs() {
    let room = Room::new("held");
    a_station(&room, "a");
    room.run(&["backup", "b.datum", "--config", "a/station.toml"]);
    room.write("a/station.toml", CONFIG.replace("LINE-3", "LINE-4"));
    let mut journal = Journal::new(&room.0.join("a/records"), Limits::of_mib(1));
    journal.append(0, &Event::Boot(Boot::default())).expect("stored");
    for command in
        [&["restore", "b.datum", "--config", "a/station.toml"][..], &["reset", "--yes", "--config", "a/station.toml"]]
    {
        let before = room.files("a");
        let (status, _, said) = room.run(command);
        assert!(status == Some(3) && said.contains("systemctl stop datum"), "{said}");
        assert!(room.files("a") == before);
    }
    drop(journal);
    assert_eq!(room.run(&["restore", "b.datum", "--config", "a/station.toml"]).0, Some(0));
}

#[test]
fn a_factory_reset_keeps_calibration_and_hours_of_light_and_nothing_else() {
    let room = Room::new("reset");
    a_station(&room, "a");
    room.write("a/records/light.toml", "format = 1\nleft_h = 1.0\nright_h = 2.0\n");
    room.write("a/records/journal-00000000000000000001", "records");
    room.write("a/records/captures/0000000002/red.png", "an image");
    room.write("a/before-restore-1/station.toml", CONFIG);
    room.write("a/notes.txt", "not ours");
    let before = room.files("a");
    let (status, said, _) = room.run(&["reset", "--config", "a/station.toml"]);
    assert!(status == Some(0) && said.contains("Nothing was removed."), "{said}");
    assert!(
        said.contains("goes      a/vehicles/012-suv-a.toml") && said.contains("stays     a/calibration.toml"),
        "{said}"
    );
    assert!(room.files("a") == before);
    let (status, _, _) = room.run(&["reset", "--config", "a/station.toml", "--yes"]);
    assert_eq!(status, Some(0));
    let left: Vec<_> = room.files("a").into_iter().filter(|(name, _)| name != "records/lock").collect();
    let stays = ["calibration.toml", "notes.txt", "records/light.toml"];
    assert_eq!(left, stays.map(|name| (name.to_owned(), before[name].clone())));
}

#[test]
fn a_factory_reset_leaves_what_is_none_of_ours_in_the_folder_of_the_records() {
    let room = Room::new("shared");
    a_station(&room, "a");
    room.write("a/station.toml", format!("{CONFIG}[records]\nfolder = \".\"\n"));
    for (name, content) in [
        ("journal-00000000000000000001", "records"),
        ("captures/0000000002/red.png", "of a vehicle"),
        ("captures/mine/red.png", "put there by a person"),
        ("notes.txt", "not ours"),
    ] {
        room.write(&format!("a/{name}"), content);
    }
    let (status, said, errors) = room.run(&["reset", "--config", "a/station.toml", "--yes"]);
    assert_eq!(status, Some(0), "{said}{errors}");
    let left: Vec<String> = room.files("a").into_keys().filter(|name| name != "lock").collect();
    assert_eq!(left, ["calibration.toml", "captures/mine/red.png", "notes.txt"]);
}
