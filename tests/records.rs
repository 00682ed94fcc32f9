//! The journal of records through its public face: order, limits, power cuts, full disks, kills.

#![expect(clippy::print_stdout, reason = "numbers for whoever runs it with --nocapture")]

use datum::Code;
use datum::records::*;
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Small segments, so that tests cross from one to the next; no floor.
const SMALL: Limits = Limits { journal: 1 << 40, segment: 4096, floor: 0 };

/// An empty folder that no other test uses, removed at the end.
struct Room(PathBuf);

impl Room {
    fn new(name: &str) -> Self {
        let room = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("records-{name}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&room);
        fs::create_dir_all(&room).expect("the target folder is writable");
        Self(room)
    }

    fn segments(&self) -> Vec<PathBuf> {
        segments(&self.0)
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn segments(folder: &Path) -> Vec<PathBuf> {
    let mut found: Vec<_> = fs::read_dir(folder).expect("there").map(|e| e.expect("readable").path()).collect();
    found.retain(|p| p.file_name().is_some_and(|n| n.to_string_lossy().starts_with("journal-")));
    found.sort();
    found
}

/// From this number on every other vehicle is so large that writing it takes a while, to be killed in.
const LARGE: u32 = 1_000_000;

/// The n-th vehicle: the same for the same n, and as long as none of its neighbours.
fn vehicle(n: u32) -> Event {
    let more = if n < LARGE || n.is_multiple_of(2) { n % 7 * 150 } else { 400_000 };
    let text: String = (0..40 + more).map(|k| char::from(b'a' + ((n + k) % 26) as u8)).collect();
    Event::Vehicle(Box::new(Vehicle {
        trigger_id: n,
        vin: format!("WDATUM{:011}", n),
        job: 12,
        job_fingerprint: 0xDEAD_BEEF,
        calibration_fingerprint: 1,
        verdict: if n.is_multiple_of(3) { Verdict::Ok } else { Verdict::NotMeasurable },
        code: 401,
        detail: 3,
        sentence: "A feature was not found.".into(),
        measurement: Some(format!("{{\"capture\":\"{text}\"}}")),
        captures: 1,
        light: Some([0.5, 0.625]),
        ambient: Some(3.5),
        camera_celsius: Some(41.5),
        projector_celsius: None,
        acquisition_ms: Some(1150),
        total_ms: Some(1290),
        images: false,
    }))
}

/// All that a reader finds: records by id, and damage.
fn read(folder: &Path) -> (BTreeMap<u64, Record>, Vec<Damage>) {
    let (mut records, mut damage) = (BTreeMap::new(), Vec::new());
    for found in Reader::open(folder).expect("there") {
        match found.expect("readable") {
            Found::Record(record) => {
                let above = records.last_key_value().is_none_or(|(last, _)| *last < record.id);
                assert!(above, "ids grow: {}", record.id);
                records.insert(record.id, *record);
            }
            Found::Damage(d) => damage.push(d),
            Found::Later { id } => panic!("{id}: no later version has written here"),
        }
    }
    (records, damage)
}

/// Whole means: what was written for its number, not just something that has a CRC.
fn assert_whole(record: &Record) {
    let Event::Vehicle(v) = &record.event else { panic!("{record:?}") };
    assert_eq!(record.event, vehicle(v.trigger_id), "record {}", record.id);
}

fn journal(room: &Room, limits: Limits) -> Journal {
    let mut journal = Journal::new(&room.0, limits);
    journal.open().expect("a good storage");
    journal
}

#[test]
fn records_read_back_in_order_and_ids_and_totals_go_on_after_reopening() {
    let room = Room::new("order");
    let mut ids = Vec::new();
    for run in 0..3 {
        let mut journal = journal(&room, SMALL);
        ids.push(journal.append(1, &Event::Boot(Boot::default())).expect("stored"));
        for n in 0..5 {
            journal.count().triggers += 1;
            ids.push(journal.append(1000, &vehicle(10 * run + n)).expect("stored"));
        }
        let t = journal.totals();
        assert_eq!((t.boots, t.triggers, t.results), (run + 1, 5 * (run + 1), 5 * (run + 1)));
    }
    assert_eq!(ids, (1..=18).collect::<Vec<_>>());
    let (records, damage) = read(&room.0);
    assert_eq!((records.keys().copied().collect::<Vec<_>>(), damage), (ids, vec![]));
    let last = &records[&18];
    assert_eq!((last.at_ms, last.software.as_str()), (1000, env!("CARGO_PKG_VERSION")));
    assert_eq!(last.totals.not_measurable + last.totals.ok, 15);
    assert!(room.segments().len() > 2, "the test is to cross segments");
}

#[test]
fn the_last_verification_survives_a_restart_and_a_new_segment() {
    let room = Room::new("verification");
    let verification = Verification { at_ms: 5, ok: true, scale_error: Some(1e-4), ..Verification::default() };
    let mut first = journal(&room, SMALL);
    first.append(5, &Event::Verification(verification.clone())).expect("stored");
    for n in 0..20 {
        first.append(6, &vehicle(n)).expect("stored");
    }
    drop(first);
    // a power cut after a segment was begun, before there was a record in it
    fs::write(room.0.join("journal-00000000000000000022"), b"datumjn\x01").expect("writable");
    let mut again = journal(&room, SMALL);
    assert_eq!((again.totals().verify_ok, again.totals().verified), (1, Some(verification)));
    assert_eq!(again.append(7, &vehicle(0)).expect("stored"), 22);
}

#[test]
fn the_oldest_segments_go_first_the_limit_is_kept_and_ids_go_on() {
    let room = Room::new("limit");
    let limits = Limits { journal: 20_000, ..SMALL };
    let mut writer = journal(&room, limits);
    for n in 0..200 {
        assert_eq!(writer.append(0, &vehicle(n)).expect("stored"), u64::from(n) + 1);
        let bytes: u64 = room.segments().iter().map(|s| fs::metadata(s).expect("there").len()).sum();
        assert!(bytes <= limits.journal, "{bytes}");
    }
    let (records, damage) = read(&room.0);
    let first = *records.first_key_value().expect("some").0;
    assert!(first > 150 && records.len() as u64 == 201 - first && damage.is_empty(), "the newest stay: from {first}");
    drop(writer);
    assert_eq!(journal(&room, limits).append(0, &vehicle(0)).expect("stored"), 201);
}

#[test]
fn a_second_writer_is_refused_and_readers_need_no_lock() {
    let room = Room::new("lock");
    let mut first = journal(&room, SMALL);
    first.append(0, &vehicle(1)).expect("stored");
    let mut second = Journal::new(&room.0, SMALL);
    let fault = second.append(0, &vehicle(2)).expect_err("locked");
    assert!(matches!(fault, Fault::Held { .. }), "{fault}");
    assert!(
        fault.to_string().ends_with("lock: held by another process that writes records here; is the service running?")
    );
    assert_eq!(read(&room.0).0.len(), 1);
    drop(first);
    assert_eq!(second.append(0, &vehicle(2)).expect("free now"), 2);
    assert_eq!(second.totals().results, 3, "the one that was not stored is counted once, too");
}

#[test]
fn a_reader_beside_the_writer_sees_whole_records_only() {
    let room = Room::new("beside");
    let mut writer = journal(&room, Limits { journal: 40_000, ..SMALL });
    writer.append(0, &vehicle(0)).expect("stored");
    std::thread::scope(|scope| {
        let writing = scope.spawn(move || {
            for n in 1..400 {
                writer.append(0, &vehicle(n)).expect("stored");
            }
        });
        while !writing.is_finished() {
            let (records, damage) = read(&room.0);
            records.values().for_each(assert_whole);
            assert!(damage.iter().all(|d| d.tail), "{damage:?}");
        }
    });
}

#[test]
fn a_deleted_folder_is_made_again() {
    let room = Room::new("deleted");
    let mut writer = journal(&room, SMALL);
    writer.append(0, &vehicle(1)).expect("stored");
    fs::remove_dir_all(&room.0).expect("there");
    assert_eq!(writer.append(0, &vehicle(2)).expect("stored"), 2);
    assert_eq!(read(&room.0).0.len(), 1);
}

#[test]
fn a_storage_that_is_not_there_is_902_and_tried_again_with_each_record() {
    let room = Room::new("absent");
    let folder = room.0.join("records");
    fs::write(&folder, "a file in its place").expect("writable");
    let mut writer = Journal::new(&folder, SMALL);
    for _ in 0..2 {
        assert_eq!(writer.append(0, &vehicle(1)).expect_err("no folder").code(), Code::StorageFault);
    }
    fs::remove_file(&folder).expect("there");
    assert_eq!(writer.append(0, &vehicle(2)).expect("stored"), 1);
    assert_eq!(read(&folder).0[&1].totals.results, 3, "what was not stored was counted");
}

#[test]
fn less_room_than_the_floor_is_901() {
    let room = Room::new("floor");
    let mut writer = journal(&room, Limits { floor: u64::MAX, ..SMALL });
    let fault = writer.append(0, &vehicle(1)).expect_err("no storage is that large");
    assert_eq!(fault.code(), Code::StorageFull);
    assert!(fault.to_string().contains("bytes free, allowed: 18446744073709551615 or more"), "{fault}");
}

/// A journal of 30 records, and where each of them lies.
fn planted(room: &Room) -> Vec<(PathBuf, Range<u64>)> {
    let mut writer = journal(room, SMALL);
    let mut places = Vec::new();
    for n in 1..=30 {
        writer.append(u64::from(n), &vehicle(n)).expect("stored");
        let file = room.segments().pop().expect("begun");
        let end = fs::metadata(&file).expect("there").len();
        let begin = places.last().filter(|(f, _)| *f == file).map_or(8, |(_, r): &(_, Range<u64>)| r.end);
        places.push((file, begin..end));
    }
    places
}

#[test]
fn of_a_damaged_journal_all_that_is_whole_is_read_and_nothing_else() {
    let room = Room::new("damage");
    let places = planted(&room);
    let files: BTreeMap<PathBuf, Vec<u8>> =
        room.segments().into_iter().map(|f| (f.clone(), fs::read(f).expect("there"))).collect();
    let newest = files.last_key_value().expect("some").0.clone();
    let mut cases = 0;
    arbtest::arbtest(|u| {
        for file in room.segments() {
            fs::remove_file(file).expect("there");
        }
        let mut damaged = files.clone();
        let mut hit: Vec<(PathBuf, Range<u64>)> = Vec::new();
        // a power cut: the newest segment ends anywhere, or in zeros from there on
        let (cut, zeros) = (u.ratio(1, 2)?, u.arbitrary::<bool>()?);
        if cut {
            let bytes = damaged.get_mut(&newest).expect("there");
            let at = u.choose_index(bytes.len() + 1)?;
            hit.push((newest.clone(), at as u64..bytes.len() as u64));
            if zeros { bytes[at..].fill(0) } else { bytes.truncate(at) }
        }
        // rotten bits, anywhere
        for _ in 0..u.int_in_range(0..=3)? {
            let file = u.choose_iter(files.keys())?.clone();
            let bytes = damaged.get_mut(&file).expect("there");
            if !bytes.is_empty() {
                let at = u.choose_index(bytes.len())?;
                bytes[at] ^= 1 << u.int_in_range(0..=7)?;
                hit.push((file, at as u64..at as u64 + 1));
            }
        }
        for (file, bytes) in &damaged {
            fs::write(file, bytes).expect("writable");
        }
        let spared = |file: &Path, place: &Range<u64>| {
            !hit.iter().any(|(f, h)| f == file && h.start < place.end && place.start < h.end)
        };
        let whole: Vec<u64> =
            (1..).zip(&places).filter(|(_, (file, place))| spared(file, place)).map(|(id, _)| id).collect();
        let check = |more: &[u64]| {
            let (records, damage) = read(&room.0);
            for record in records.values() {
                assert_whole(record);
            }
            // two hits may cancel out: then the record is as it was
            let missing: Vec<_> = whole.iter().filter(|id| !records.contains_key(id)).collect();
            assert!(missing.is_empty(), "{missing:?} of {hit:?}");
            assert!(records.keys().rev().take(more.len()).eq(more), "{more:?}");
            (records.len(), damage)
        };
        let (before, damage) = check(&[]);
        let seen = before == 30 || cut || !damage.is_empty();
        assert!(seen, "lost silently: {hit:?}");

        let mut writer = Journal::new(&room.0, SMALL);
        let recovery = writer.open().expect("a good storage");
        let id = writer.append(31, &vehicle(31)).expect("stored");
        let cut_off = cut && !zeros; // then nothing on the disk tells of the records that were there
        let known = if cut_off { whole.last().copied().unwrap_or(0) } else { 30 };
        assert!(id > known, "{id} after {known}: {hit:?}, {recovery:?}");
        let (after, damage) = check(&[id]);
        assert_eq!(after, before + 1);
        assert!(damage.iter().all(|d| !d.tail), "what was torn is cut off: {damage:?}");
        assert_eq!(writer.append(32, &vehicle(32)).expect("stored"), id + 1);
        cases += 1;
        Ok(())
    })
    .budget_ms(3000);
    println!("{cases} damaged journals");
}

/// Runs the test `name` of this program in a process of its own, by `wrapper`, which ends in the program.
fn child(wrapper: &[&str], name: &str, folder: &Path) -> Command {
    let this = std::env::current_exe().expect("this program");
    let mut words = wrapper.iter().map(std::ffi::OsStr::new).chain([this.as_os_str()]);
    let mut command = Command::new(words.next().expect("this program at least"));
    command.args(words).args(["--exact", name, "--nocapture", "--test-threads=1"]).env(CHILD, folder);
    command
}

/// Tells a test that it is the child, and its folder.
const CHILD: &str = "DATUM_RECORDS_CHILD";

#[test]
fn a_full_disk_is_901_and_appending_goes_on_when_there_is_room_again() {
    let room = Room::new("full");
    let script = "mount -t tmpfs -o size=300k datum-test \"$DATUM_RECORDS_CHILD\" || exit 77; exec \"$@\"";
    let wrapper = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh"];
    let run = child(&wrapper, "child_on_a_small_disk", &room.0).output();
    match run {
        Ok(run) if run.status.success() => print!("{}", String::from_utf8_lossy(&run.stdout)),
        Ok(run) if run.status.code() == Some(101) => {
            panic!("{}{}", String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr))
        }
        refused => eprintln!("skipped: a small disk cannot be mounted here: {refused:?}"),
    }
}

#[test]
fn child_on_a_small_disk() {
    let Some(disk) = std::env::var_os(CHILD).map(PathBuf::from) else { return };
    let (folder, filler) = (disk.join("records"), disk.join("filler"));
    let mut writer = Journal::new(&folder, SMALL);
    let (mut acknowledged, mut stored, mut refused, mut last) = (BTreeMap::new(), 0, 0, 0);
    let mut n = 0;
    for round in 0..40 {
        // leaves a few pages, another number each time, and a hole of an odd size in the last one
        let left = 4096 * (round % 5) as u64;
        let mut filling = fs::File::create(&filler).expect("a name takes no room");
        while filling.write_all(&[1; 512]).is_ok() {}
        drop(filling); // or its room stays taken when it is removed
        let length = fs::metadata(&filler).map_or(0, |m| m.len());
        let _ = fs::File::options().write(true).open(&filler).and_then(|f| f.set_len(length.saturating_sub(left)));
        let mut failed = 0;
        while failed < 3 {
            n += 1;
            match writer.append(0, &vehicle(n)) {
                Ok(id) => {
                    assert!(id > last, "{id} after {last}");
                    (last, failed) = (id, 0);
                    stored += 1;
                    acknowledged.insert(id, n);
                }
                Err(fault) => {
                    assert_eq!(fault.code(), Code::StorageFull, "{fault}: {:?}", std::error::Error::source(&fault));
                    failed += 1;
                    refused += 1;
                }
            }
        }
        let captures = Captures::new(&folder, 1 << 30, 0);
        let write = |folder: &Path| Ok(fs::write(folder.join("red.png"), vec![1; 400_000])?);
        assert!(captures.keep(last, write));
        assert_eq!(captures.finish().fault.expect("larger than the disk").code(), Code::StorageFull);
        fs::remove_file(&filler).expect("written");
        n += 1;
        let id = writer.append(0, &vehicle(n)).expect("there is room again");
        last = id;
        acknowledged.insert(id, n);
        if round % 8 == 7 {
            writer = Journal::new(&folder, SMALL); // the service starts anew
        }
        let (records, damage) = read(&folder);
        assert!(damage.iter().all(|d| d.tail), "{damage:?}");
        for (id, n) in &acknowledged {
            assert_eq!(records[id].event, vehicle(*n), "record {id}");
        }
        records.values().for_each(assert_whole);
        if round % 10 == 9 {
            for old in segments(&folder).iter().rev().skip(1) {
                fs::remove_file(old).expect("there");
            }
            let kept = read(&folder).0;
            acknowledged.retain(|id, _| kept.contains_key(id));
        }
    }
    assert!(refused >= 100 && fs::read_dir(folder.join(CAPTURES)).is_ok_and(|mut d| d.next().is_none()));
    println!("{stored} records stored, {refused} refused");
}

#[test]
fn a_limit_on_the_size_of_files_is_901_and_costs_no_record() {
    let room = Room::new("ulimit");
    // blocks of 512 bytes: 10 kB; the signal that would kill is ignored
    let wrapper = ["sh", "-c", "trap '' XFSZ; ulimit -f 20 || exit 77; exec \"$@\"", "sh"];
    let run = child(&wrapper, "child_with_a_limit", &room.0).output().expect("sh runs");
    if run.status.code() == Some(77) {
        eprintln!("skipped: ulimit -f is not possible here");
        return;
    }
    let said = format!("{}{}", String::from_utf8_lossy(&run.stdout), String::from_utf8_lossy(&run.stderr));
    assert!(run.status.success(), "{said}");
    let (records, damage) = read(&room.0);
    records.values().for_each(assert_whole);
    assert!(records.len() > 3 && damage.is_empty(), "{damage:?}");
    let mut writer = journal(&room, SMALL);
    let last = *records.last_key_value().expect("some").0;
    assert!(writer.append(0, &vehicle(0)).expect("no limit here") > last);
}

#[test]
fn child_with_a_limit() {
    let Some(folder) = std::env::var_os(CHILD).map(PathBuf::from) else { return };
    let mut writer = Journal::new(&folder, Limits { segment: 1 << 20, ..SMALL });
    let mut refused = 0;
    for n in 0..200 {
        match writer.append(0, &vehicle(n)) {
            Ok(_) => {}
            Err(fault) => {
                assert_eq!(fault.code(), Code::StorageFull, "{fault}");
                refused += 1;
            }
        }
    }
    assert!(refused > 0, "the limit was never reached");
}

/// Kills in the test below.
const KILLS: u64 = 300;

#[test]
fn killed_at_random_moments_nothing_acknowledged_is_lost_and_nothing_half_written_is_read() {
    let begun = Instant::now();
    let room = Room::new("kill");
    let mut state = 0x9E37_79B9_7F4A_7C15_u64; // xorshift64* (Vigna 2016)
    let mut random = |below: u64| {
        state ^= state >> 12;
        state ^= state << 25;
        state ^= state >> 27;
        state.wrapping_mul(0x2545_F491_4F6C_DD1D) % below
    };
    let mut acknowledged = BTreeMap::new();
    let (mut cut_off, mut unacknowledged, mut none_yet) = (0, 0, 0);
    for kill in 0..KILLS {
        let first = LARGE + 100_000 * u32::try_from(kill).expect("few");
        let mut writer = child(&[], "child_that_is_killed", &room.0)
            .env("DATUM_RECORDS_FIRST", first.to_string())
            .stdout(Stdio::piped())
            .spawn()
            .expect("this program runs again");
        let mut said = BufReader::new(writer.stdout.take().expect("piped"));
        let mut lines = String::new();
        // three of four after its first record; the others any time from its very start on, recovery included
        if kill % 4 != 0 {
            while !lines.contains("ack ") {
                assert!(said.read_line(&mut lines).expect("a pipe") > 0, "it ended by itself: {lines}");
            }
            std::thread::sleep(Duration::from_micros(random(4000)));
        } else {
            std::thread::sleep(Duration::from_micros(random(8000)));
        }
        writer.kill().expect("it runs");
        writer.wait().expect("killed");
        said.read_to_string(&mut lines).expect("text");
        let before = acknowledged.len();
        for ack in lines.split('\n').filter_map(|line| line.strip_prefix("ack ")?.strip_suffix(" .")) {
            let (id, n) = ack.split_once(' ').expect("two numbers");
            let (id, n): (u64, u32) = (id.parse().expect("an id"), n.parse().expect("a number"));
            let above = acknowledged.last_key_value().is_none_or(|(last, _)| *last < id);
            assert!(above, "kill {kill}: id {id} again");
            acknowledged.insert(id, n);
        }
        none_yet += usize::from(acknowledged.len() == before);
        if kill % 2 == 0 {
            // every other time it is the next child that finds what this one left
            let mut journal = Journal::new(&room.0, SMALL);
            let recovery = journal.open().expect("a good storage");
            cut_off += recovery.damage.len();
            let n = first + 99_999;
            let id = journal.append(0, &vehicle(n)).expect("stored");
            assert!(acknowledged.last_key_value().is_none_or(|(last, _)| *last < id), "kill {kill}: id {id} again");
            acknowledged.insert(id, n);
        }
        let (records, damage) = read(&room.0);
        assert!(damage.iter().all(|d| d.tail), "kill {kill}: {damage:?}");
        for (id, n) in &acknowledged {
            let record = records.get(id).unwrap_or_else(|| panic!("kill {kill}: record {id} is lost"));
            assert_eq!(record.event, vehicle(*n), "kill {kill}: record {id}");
        }
        records.values().for_each(assert_whole);
        unacknowledged = records.len() - acknowledged.len();
        if acknowledged.len() > 40 {
            // all of these were checked: go on in an empty folder, or reading them again would take most of the time
            let newest = room.segments().pop().expect("some");
            for old in room.segments().iter().filter(|s| **s != newest) {
                fs::remove_file(old).expect("there");
            }
            let kept = read(&room.0).0;
            acknowledged.retain(|id, _| kept.contains_key(id));
        }
    }
    println!(
        "{KILLS} kills in {:.1} s: {none_yet} before a first record, {cut_off} torn ends, \
         {unacknowledged} whole but not acknowledged in the end",
        begun.elapsed().as_secs_f64()
    );
}

#[test]
fn child_that_is_killed() {
    let (Some(folder), Ok(first)) = (std::env::var_os(CHILD), std::env::var("DATUM_RECORDS_FIRST")) else { return };
    let first: u32 = first.parse().expect("a number");
    let mut journal = Journal::new(Path::new(&folder), SMALL);
    let mut out = std::io::stdout();
    for n in first.. {
        let id = journal.append(0, &vehicle(n)).expect("a good storage");
        // one write: a line is there or it is not
        out.write_all(format!("\nack {id} {n} .\n").as_bytes()).and_then(|()| out.flush()).expect("a pipe");
    }
}

#[test]
fn how_long_a_record_takes() {
    let room = Room::new("time");
    let mut writer = journal(&room, Limits { segment: 1 << 20, ..SMALL });
    let mut times = |what: &str, captures: Option<&Captures>| {
        let one = |n| {
            if let Some(captures) = captures {
                let images = |folder: &Path| {
                    (0..14).try_for_each(|k| Ok(fs::write(folder.join(format!("{k}.png")), vec![k; 2_500_000])?))
                };
                let _ = captures.keep(n, images); // when it is behind it writes all the same
            }
            let begun = Instant::now();
            let Event::Vehicle(mut v) = vehicle(1) else { unreachable!("it is one") };
            v.measurement = Some("m".repeat(4000));
            writer.append(0, &Event::Vehicle(v)).expect("stored");
            begun.elapsed().as_secs_f64() * 1000.0
        };
        let mut ms: Vec<f64> = (0..300).map(one).collect();
        ms.sort_by(f64::total_cmp);
        println!("append and sync {what}: median {:.2} ms, 99 % {:.2} ms, longest {:.2} ms", ms[150], ms[297], ms[299]);
    };
    times("alone", None);
    let captures = Captures::new(&room.0, 200_000_000, 0);
    times("while captures of 35 MB are written", Some(&captures));
    println!("{} captures written meanwhile", captures.ring().written);
}
