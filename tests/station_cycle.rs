//! What the station does with orders, at rest and in the middle of a vehicle.

#[allow(dead_code, reason = "each test uses its part")]
#[path = "common/station.rs"]
mod bench;

use bench::{Bench, jobs};
use datum::hal::linux::{Sys, Thermometer};
use datum::hal::{Camera, Clock, Error, Exposure, Presence, Reading, Sensor};
use datum::image::Image;
use datum::measure::Shared;
use datum::plc::{Order, OrderKind, Report, ResultCode, State, Trigger};
use datum::sim::{Build, Cue, Deviation, Fault, Paint, Random, Script, When};
use datum::station::{
    Hardware, Simulated, SimulationKeys, StationFile, Temperatures, Traffic, TriggerKind, World, load_all, missing,
    outdated,
};
use datum::{Code, VehicleFile};
use std::path::{Path, PathBuf};
use std::time::Duration;

fn config() -> StationFile {
    StationFile { simulation: SimulationKeys { scale: 0.25, seed: 9 }, ..StationFile::default() }
}

fn white() -> Paint {
    Paint::named("white").expect("listed")
}

fn trigger(id: u32) -> Order {
    Order::Measure(Trigger { id, job: 1, ..Trigger::default() })
}

fn refused(reports: &[Report]) -> Option<(OrderKind, Code)> {
    reports.iter().find_map(|r| match r {
        Report::Refused { order, code, .. } => Some((*order, *code)),
        _ => None,
    })
}

fn finished(reports: &[Report]) -> Option<(ResultCode, Option<Code>)> {
    reports.iter().find_map(|r| match r {
        Report::Finished(o) => Some((o.result, o.code)),
        _ => None,
    })
}

#[test]
fn a_vehicle_is_measured_from_the_order_to_its_result() {
    let mut bench = Bench::new(config(), Script::default(), jobs());
    assert_eq!(bench.status.state, State::Ready);
    assert!(bench.status.simulated && bench.status.warm && bench.status.active_job == 1);
    assert_ne!(bench.status.job_fingerprint, 0);
    bench.put(white(), Deviation { yaw_deg: 2.0, ..Deviation::default() }, Build::default());
    let vin = "WDB00000000000017".parse().expect("17 characters");
    let order = Trigger { id: 41, job: 1, vin, ..Trigger::default() };
    let told = bench.order(Order::Measure(order.clone()));
    let states: Vec<State> =
        told.iter().filter_map(|r| if let Report::Status(s) = r { Some(s.state) } else { None }).collect();
    assert_eq!(states, [State::Acquiring, State::Processing, State::Ready]);
    let places = |wanted: fn(&Report) -> bool| told.iter().position(wanted).expect("told");
    let (acquired, done) = (places(|r| *r == Report::Acquired), places(|r| matches!(r, Report::Finished(_))));
    assert!(acquired < done);
    let Report::Finished(o) = &told[done] else { unreachable!("it is one") };
    assert_eq!((o.result, o.code, &o.trigger, o.job), (ResultCode::Ok, None, &order, 1));
    let pose = o.pose.expect("it is ok");
    assert!((pose.angles_deg[2] - 2.0).abs() < 0.1, "{pose:?}");
    assert!(o.features.iter().flatten().all(|f| f.code.is_none() && f.position_mm.is_some() && f.score.is_some()));
    assert!(pose.u_target_mm.is_some_and(|u| u > 0.0 && u < 5.0));
    assert!(o.acquisition.is_some_and(|t| t <= Duration::from_millis(1200)), "{:?}", o.acquisition);
    assert!(o.light.is_some() && o.ambient.is_some_and(|a| a > 0.5) && o.taken_at_ms > 0);
    assert_eq!((bench.status.counters.triggers, bench.status.counters.ok), (1, 1));
    assert!(!bench.lit());
}

#[test]
fn an_abort_or_stand_by_ends_a_cycle_at_once() {
    let mut bench = Bench::new(config(), Script::default(), jobs());
    for order in [Order::Abort, Order::StandBy(true)] {
        bench.put(white(), Deviation::default(), Build::default());
        bench.orders.send(trigger(1)).expect("it lives");
        let images = bench.world.images();
        let mut told = bench.order(order.clone());
        assert_eq!(finished(&told), Some((ResultCode::Aborted, None)), "{order:?}");
        assert!(bench.world.images() <= images + 1 && !bench.lit());
        told.extend(bench.turn());
        assert_eq!(told.contains(&Report::Done(OrderKind::Abort)), order == Order::Abort);
    }
    assert!(bench.status.not_ready.service);
    bench.put(white(), Deviation::default(), Build::default());
    assert_eq!(refused(&bench.order(trigger(2))), Some((OrderKind::Measure, Code::TriggerInService)));
    bench.order(Order::StandBy(false));
    assert!(bench.measure(white(), &mut Random::new(1, &[])).is_some_and(|c| c.outcome().result == ResultCode::Ok));
}

#[test]
fn orders_that_come_while_a_vehicle_is_measured_are_refused_or_carried_out_after_it() {
    let mut bench = Bench::new(config(), Script::default(), jobs());
    bench.put(white(), Deviation::default(), Build::default());
    bench.orders.send(trigger(1)).expect("it lives");
    bench.orders.send(trigger(2)).expect("it lives");
    bench.orders.send(Order::LoadJob { job: 1, model_code: 0 }).expect("it lives");
    bench.orders.send(Order::Verify).expect("it lives");
    let mut told = bench.order(Order::Own(true));
    told.extend(bench.turn());
    let refusals: Vec<_> = told
        .iter()
        .filter_map(|r| if let Report::Refused { order, code, .. } = r { Some((*order, *code)) } else { None })
        .collect();
    let busy = Code::TriggerWhileBusy;
    assert_eq!(
        refusals,
        [(OrderKind::Measure, busy), (OrderKind::LoadJob, Code::JobWhileBusy), (OrderKind::Verify, busy)]
    );
    assert_eq!(finished(&told), Some((ResultCode::Ok, None)));
}

/// A copy of the jobs folder.
fn copied(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{name}-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("writable");
    for entry in std::fs::read_dir(jobs()).expect("taught") {
        let path = entry.expect("readable").path();
        if path.is_file() {
            std::fs::copy(&path, folder.join(path.file_name().expect("a file"))).expect("copied");
        }
    }
    folder
}

#[test]
fn a_model_whose_templates_are_of_another_version_is_outdated_and_its_message_says_so_once() {
    let folder = copied("outdated");
    assert_eq!((outdated(&folder), missing(&folder)), (vec![], (2..=10).collect()));
    let templates = std::fs::read_dir(&folder).expect("there").map(|entry| entry.expect("readable").path());
    let template = templates.into_iter().find(|p| p.extension().is_some_and(|e| e == "datum")).expect("taught");
    let mut bytes = std::fs::read(&template).expect("there");
    bytes[7] -= 1;
    std::fs::write(&template, bytes).expect("writable");
    assert_eq!(outdated(&folder), [1]);
    let vehicle = VehicleFile::read(&folder.join("001-suv-a.toml")).expect("as it was");
    let e = anyhow::Error::new(vehicle.templates().expect_err("of another version"));
    assert_eq!(format!("{e:#}").matches("teach again").count(), 1, "{e:#}");
    std::fs::remove_dir_all(&folder).expect("just made");
}

#[test]
fn jobs_are_loaded_by_number_if_they_are_released_and_as_they_were() {
    let folder = copied("jobs");
    let model = std::fs::read_to_string(folder.join("001-suv-a.toml")).expect("there");
    let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("writable");
    let numbered = |n: u16| model.replace("job = 1\n", &format!("job = {n}\n"));
    let release = model.find("[release]").expect("released");
    write("002-unreleased.toml", &numbered(2)[..release]);
    write("003-changed.toml", &numbered(3)); // the fingerprint holds the job, too
    write("004-later.toml", &numbered(4).replace("format = 1", "format = 2"));
    write("005-broken.toml", "format = 1\nname =");
    write("006-misnamed.toml", &numbered(7));
    write("notes.toml", "nobody reads this");
    let calibration = Simulated::new(0.25, 1).calibration();
    let found = load_all(&folder, &calibration, &Shared::default());
    assert_eq!(found.usable().map(|j| j.number).collect::<Vec<_>>(), [1]);
    for (job, code) in [
        (2, Code::NotReleased),
        (3, Code::Fingerprint),
        (4, Code::OtherVersion),
        (5, Code::Fingerprint),
        (6, Code::Fingerprint),
        (7, Code::UnknownJob),
        (999, Code::UnknownJob),
    ] {
        assert_eq!(found.get(job, 0).err(), Some(code), "{job}");
    }
    assert!(found.unusable().all(|u| u.said.contains(".toml") || u.said.contains("two files")));
    let mut bench = Bench::new(config(), Script::default(), &folder);
    assert!(bench.order(Order::LoadJob { job: 1, model_code: 0 }).contains(&Report::Done(OrderKind::LoadJob)));
    let told = bench.order(Order::LoadJob { job: 2, model_code: 0 });
    assert_eq!(refused(&told), Some((OrderKind::LoadJob, Code::NotReleased)));
    assert_eq!((bench.status.active_job, bench.status.state), (1, State::Ready));
    let told = bench.order(Order::Measure(Trigger { id: 1, job: 5, ..Trigger::default() }));
    assert_eq!(refused(&told), Some((OrderKind::Measure, Code::Fingerprint)));
    assert_eq!(bench.status.state, State::Ready);
    std::fs::remove_dir_all(&folder).expect("just made");
}

#[test]
fn without_a_job_the_station_says_so() {
    let mut bench = Bench::new(config(), Script::default(), Path::new("no-such-folder"));
    assert!(bench.status.not_ready.no_job && bench.status.state == State::Ready);
    assert_eq!(refused(&bench.order(trigger(1))), Some((OrderKind::Measure, Code::UnknownJob)));
}

#[test]
fn a_camera_that_is_missing_at_first_is_waited_for() {
    let gone = When::Between(Duration::ZERO, Duration::from_secs(3));
    let mut bench = Bench::new(config(), Script(vec![Cue { when: gone, fault: Fault::CameraGone }]), jobs());
    assert!(bench.status.state == State::Fault && bench.status.not_ready.camera);
    bench.put(white(), Deviation::default(), Build::default());
    assert_eq!(refused(&bench.order(trigger(1))), Some((OrderKind::Measure, Code::CameraLost)));
    assert!(
        bench.order(Order::ClearError).iter().any(|r| matches!(r, Report::Error(Code::CameraLost, _))),
        "still gone"
    );
    assert!(bench.until(State::Ready, 60));
    assert_eq!(bench.status.counters.camera_reconnects, 1);
}

#[test]
fn the_self_test_finds_a_dead_bar_and_a_silent_projector_in_an_empty_hall() {
    for (fault, code) in [(Fault::BarDead(0), Code::LightFault), (Fault::ProjectorSilent, Code::ProjectorSilent)] {
        let script = Script(vec![Cue { when: When::Always, fault }]);
        let mut bench = Bench::new(config(), script, Path::new("no-such-folder"));
        assert_eq!(bench.status.state, State::Fault);
        assert_eq!(
            (bench.status.not_ready.light, bench.status.not_ready.projector),
            (code == Code::LightFault, code != Code::LightFault)
        );
        assert!(!bench.lit());
        bench.world.set_script(Script::default());
        assert!(bench.until(State::Ready, 30));
    }
}

#[test]
fn a_cold_station_refuses_until_it_is_warm() {
    let mut config = config();
    config.cycle.warm_up_s = 2;
    let mut bench = Bench::new(config, Script::default(), jobs());
    assert!(bench.status.state == State::WarmUp && bench.status.not_ready.not_warm);
    assert_eq!(refused(&bench.order(trigger(1))), Some((OrderKind::Measure, Code::TriggerInWarmUp)));
    assert!(bench.until(State::Ready, 30));
}

#[test]
fn a_station_that_is_too_hot_says_so_stays_dark_and_measures_again_when_it_has_cooled() {
    let sys = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("hot-{}", std::process::id()));
    let chip = sys.join("class/hwmon/hwmon0");
    std::fs::create_dir_all(&chip).expect("writable");
    std::fs::write(chip.join("name"), "head\n").expect("writable");
    let is = |celsius: u32| std::fs::write(chip.join("temp1_input"), format!("{celsius}000\n")).expect("writable");
    is(65);
    let projector = Some(Thermometer::new(Sys(sys.clone()), "head"));
    let temperatures = Temperatures { projector, most: [90.0, 80.0, 70.0], ..Temperatures::default() };
    let fit = |_: &Simulated, h: &mut Hardware| h.temperatures = temperatures.clone();
    let mut bench = Bench::with(config(), Script::default(), jobs(), fit, None);
    assert!(bench.until(State::Ready, 20));
    let warm = |bench: &mut Bench| {
        bench.turn();
        bench.status.projector_celsius == Some(65.0)
    };
    assert!((0..50).any(|_| warm(&mut bench)), "{:?}", bench.status.projector_celsius);
    is(71);
    let mut told = Vec::new();
    while bench.status.state == State::Ready && told.len() < 100 {
        told.extend(bench.turn());
    }
    assert!(told.contains(&Report::Error(Code::OverTemperature, 0)), "{told:?}");
    assert!(bench.status.state == State::Fault && bench.status.not_ready.temperature && !bench.lit());
    bench.put(white(), Deviation::default(), Build::default());
    let hot = Some((OrderKind::Measure, Code::OverTemperature));
    assert_eq!(refused(&bench.order(trigger(1))), hot);
    // it is not tried with light, neither by itself nor because somebody cleared the error; told once, and after that
    let images = bench.world.images();
    let told: Vec<Report> = (0..50).flat_map(|_| bench.turn()).collect();
    assert!(!told.iter().any(|r| matches!(r, Report::Error(..))), "{told:?}");
    assert!(bench.order(Order::ClearError).contains(&Report::Error(Code::OverTemperature, 0)));
    is(67);
    assert!(!bench.until(State::Ready, 50), "it has hardly cooled");
    assert_eq!(bench.world.images(), images);
    is(64);
    assert!(bench.until(State::Ready, 50) && !bench.status.not_ready.temperature);
    assert!(bench.world.images() > images, "it was tested first");
    assert_eq!(finished(&bench.order(trigger(1))), Some((ResultCode::Ok, None)));
    std::fs::remove_dir_all(sys).expect("just made");
}

#[test]
fn verify_without_an_artefact_is_refused() {
    let mut bench = Bench::new(config(), Script::default(), jobs());
    assert_eq!(refused(&bench.order(Order::Verify)), Some((OrderKind::Verify, Code::VerifyDatum)));
    assert_eq!(bench.status.state, State::Ready);
}

#[test]
fn told_to_stop_the_station_ends_in_the_dark() {
    let mut bench = Bench::new(config(), Script::default(), jobs());
    bench.put(white(), Deviation::default(), Build::default());
    bench.orders.send(trigger(1)).expect("it lives");
    bench.stop.store(true, std::sync::atomic::Ordering::Relaxed);
    assert!(!bench.machine.turn() && !bench.lit());
}

/// A camera whose driver panics with lights on.
struct Panics {
    camera: datum::sim::Camera,
    left: usize,
}

impl Camera for Panics {
    fn sensor(&self) -> &Sensor {
        self.camera.sensor()
    }
    fn set_exposure(&mut self, wanted: Duration) -> Result<Duration, Error> {
        self.camera.set_exposure(wanted)
    }
    fn set_gain(&mut self, wanted: f64) -> Result<f64, Error> {
        self.camera.set_gain(wanted)
    }
    fn grab(&mut self, timeout: Duration, image: &mut Image<u16>) -> Result<Exposure, Error> {
        self.left = self.left.checked_sub(1).expect("it panics after so many images");
        self.camera.grab(timeout, image)
    }
    fn check(&mut self) -> Result<(), Error> {
        self.camera.check()
    }
}

#[test]
fn a_panic_leaves_no_light_on() {
    // the self-test's five images, then amid the red ones and amid the fringes
    for images in [6, 16] {
        let change = |simulated: &Simulated, hardware: &mut Hardware| {
            hardware.camera = Box::new(Panics { camera: simulated.station.camera(), left: images });
        };
        let mut bench = Bench::with(config(), Script::default(), jobs(), change, None);
        bench.put(white(), Deviation::default(), Build::default());
        bench.orders.send(trigger(1)).expect("it lives");
        let panicked = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| bench.machine.turn()));
        assert!(panicked.is_err() && !bench.lit(), "{images}");
    }
}

/// A sensor that chatters before it makes up its mind, once per look. Some of its bounces are over when it is asked.
struct Chatters {
    clock: datum::sim::Clock,
    says: Vec<(bool, bool)>,
    last: Reading,
}

impl Presence for Chatters {
    fn wait(&mut self, _: bool, _: Duration) -> Result<Reading, Error> {
        let (present, bounced) = if self.says.len() > 1 { self.says.remove(0) } else { self.says[0] };
        if bounced || present != self.last.present {
            self.last = Reading { present, since: self.clock.now() };
        }
        Ok(self.last)
    }
}

#[test]
fn a_sensor_that_chatters_begins_one_cycle() {
    let mut config = config();
    config.cycle.trigger = TriggerKind::Presence;
    let change = |simulated: &Simulated, hardware: &mut Hardware| {
        let mut says: Vec<_> = [false, true, false, true, false, true, true].map(|present| (present, false)).into();
        // bounces that are over by the next look, while it settles and long after
        says.extend([(true, true), (true, true), (true, false), (true, false), (true, false), (true, false)]);
        says.extend([(true, true), (true, false), (true, true), (true, false)]);
        let last = Reading { present: false, since: Duration::ZERO };
        hardware.presence = Some(Box::new(Chatters { clock: simulated.station.clock(), says, last }));
    };
    let world = |simulated: &Simulated| -> Box<dyn World> {
        let mut traffic = Traffic::new(&simulated.station, 3);
        traffic.bring(1);
        Box::new(traffic)
    };
    let mut bench = Bench::with(config, Script::default(), jobs(), change, Some(&world));
    let told: Vec<Report> = (0..24).flat_map(|_| bench.turn()).collect();
    let began = told.iter().filter(|r| matches!(r, Report::Began(_))).count();
    assert_eq!(began, 1);
    assert!(finished(&told).is_some());
}

#[test]
fn vehicles_come_by_themselves_until_a_plc_owns_the_station() {
    let world = |simulated: &Simulated| -> Box<dyn World> { Box::new(Traffic::new(&simulated.station, 3)) };
    let mut bench = Bench::with(config(), Script::default(), jobs(), |_, _| (), Some(&world));
    let mut told: Vec<Report> = Vec::new();
    for _ in 0..60 {
        told.extend(bench.turn());
        if finished(&told).is_some() {
            break;
        }
    }
    assert!(told.iter().any(|r| matches!(r, Report::Began(t) if t.id == 0)) && finished(&told).is_some());
    bench.order(Order::Own(true));
    let told: Vec<Report> = (0..40).flat_map(|_| bench.turn()).collect();
    assert!(!told.iter().any(|r| matches!(r, Report::Began(_))));
    let told = bench.order(trigger(5));
    assert!(finished(&told).is_some(), "the trigger brings one");
}

#[test]
fn check_explains_every_key_and_run_refuses_what_it_has_no_driver_for() {
    let datum = |arguments: &[&str]| {
        let out = std::process::Command::new(env!("CARGO_BIN_EXE_datum")).args(arguments).output().expect("runs");
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        (out.status.code(), text(&out.stdout), text(&out.stderr))
    };
    let (status, said, _) = datum(&["check"]);
    assert_eq!(status, Some(0));
    for key in datum::station::KEYS {
        assert!(said.contains(&format!("\n{} ", key.name)) && said.contains(key.meaning), "{}", key.name);
    }
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let file = folder.join(format!("station-libcamera-{}.toml", std::process::id()));
    let devices = r#"
format = 1
camera = { kind = "libcamera", device = "imx296" }
projector = { kind = "v4l2-output", device = "/dev/video0" }
[lights]
kind = "gpio"
left = "gpio/left"
right = "gpio/right"
left_pwm = "lamps.pwm/0"
right_pwm = "lamps.pwm/1"
"#;
    std::fs::write(&file, devices).expect("writable");
    let name = file.to_str().expect("UTF-8");
    let (status, said, _) = datum(&["check", name]);
    assert!(status == Some(0) && said.contains("kind = \"libcamera\"\n"), "{said}");
    let built = cfg!(feature = "libcamera");
    assert_eq!(said.contains("--features libcamera"), !built, "{said}");
    let (status, _, said) = datum(&["run", "--config", name]);
    let refused = status == Some(2) && said.contains("camera.kind = \"libcamera\": this datum is built without");
    assert_eq!(refused, !built, "{said}");

    std::fs::write(&file, "format = 1\n[cycle]\nspeed = 1\n").expect("writable");
    let (status, _, said) = datum(&["check", name]);
    assert!(status == Some(2) && said.contains("line 3, `speed = 1`: unknown field `speed`"), "{said}");
    std::fs::remove_file(&file).expect("just written");
}
