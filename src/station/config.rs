//! station.toml: what a station is made of and how it works. In: the file, or none. Out: its checked content.
//! Not here: what follows from it.

use crate::calibrate::{Board, VerifyLimits};
use crate::detect::{self, Detector};
use crate::document::{self, Check, Error};
use crate::plc::WordOrder;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A station's configuration. Every key may be left out; what is then taken is the built-in simulated station.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct StationFile {
    /// Where it was read; names it in messages, and what it names lies beside it. Empty: nowhere.
    #[serde(skip)]
    pub file: PathBuf,
    /// 1.
    pub format: u32,
    /// What it is called: the serial number that the PLC reads.
    pub serial: String,
    /// calibration.toml; none: the simulated station's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calibration: Option<PathBuf>,
    /// The detector's network, "built-in" or "none".
    pub detector: PathBuf,
    /// The camera.
    pub camera: CameraKeys,
    /// The projector.
    pub projector: ProjectorKeys,
    /// The light bars.
    pub lights: LightsKeys,
    /// The presence sensor.
    pub presence: PresenceKeys,
    /// How a cycle goes.
    pub cycle: CycleKeys,
    /// The Modbus server.
    pub plc: PlcKeys,
    /// Vehicle models.
    pub jobs: JobsKeys,
    /// What is kept.
    pub records: RecordsKeys,
    /// The simulated station.
    pub simulation: SimulationKeys,
    /// What VERIFY measures; none: nothing.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub artefact: Option<ArtefactKeys>,
}

macro_rules! kinds {
    ($name:ident, $doc:literal, $($variant:ident = $text:literal),*) => {
        #[doc = $doc]
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
        #[expect(missing_docs, reason = "the names say it")]
        pub enum $name {
            #[default]
            #[serde(rename = "simulated")]
            Simulated,
            $(#[serde(rename = $text)] $variant,)*
        }
    };
}
kinds!(CameraKind, "How the camera is reached.", V4l2 = "v4l2", Libcamera = "libcamera");
kinds!(ProjectorKind, "How the projector is reached.", V4l2Output = "v4l2-output", Sequenced = "sequenced");
kinds!(LightsKind, "How the bars are driven.", Gpio = "gpio");
kinds!(PresenceKind, "How the presence sensor is read.", Gpio = "gpio");

/// `[camera]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraKeys {
    /// How it is reached.
    pub kind: CameraKind,
    /// No exposure is longer.
    pub longest_ms: f64,
}

/// `[projector]`
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProjectorKeys {
    /// How it is reached.
    pub kind: ProjectorKind,
}

/// `[lights]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightsKeys {
    /// How they are driven.
    pub kind: LightsKind,
    /// Where the search for the right drive starts, 0 to 1.
    pub drive: f64,
}

/// `[presence]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PresenceKeys {
    /// How it is read.
    pub kind: PresenceKind,
    /// A vehicle is there, or gone, when the sensor has said so for so long.
    pub debounce_ms: u64,
}

/// What begins a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TriggerKind {
    /// The PLC.
    #[default]
    Plc,
    /// The presence sensor.
    Presence,
}

/// `[cycle]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct CycleKeys {
    /// What begins it.
    pub trigger: TriggerKind,
    /// Whether the devices are tried before the station is ready.
    pub self_test: bool,
    /// From the start until camera and projector count as warm.
    pub warm_up_s: u64,
    /// All images of the first try are taken by then.
    pub acquire_ms: u64,
    /// All images of a second try are taken by then.
    pub second_by_ms: u64,
    /// Automatic further tries of a vehicle that was not measured: 0 or 1.
    pub second_captures: u8,
    /// Light from outside, as a share of the red image's, beyond which nothing is measured.
    pub ambient_limit: f64,
}

/// `[plc]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlcKeys {
    /// Address and port.
    pub listen: String,
    /// Networks that are answered.
    pub allow: Vec<String>,
    /// Which half of a 32-bit number comes first.
    pub word_order: WordOrder,
    /// PLC_HEARTBEAT changes within.
    pub heartbeat_s: f64,
}

/// `[jobs]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct JobsKeys {
    /// Files NNN-name.toml with their templates.
    pub folder: PathBuf,
}

/// `[records]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct RecordsKeys {
    /// Where they lie.
    pub folder: PathBuf,
    /// Of the journal.
    pub journal_mib: u64,
    /// Of kept images.
    pub captures_mib: u64,
    /// Images of every so many-th good vehicle are kept, beside those of every one that was not measured; 0: of none.
    pub keep_every: u32,
}

/// `[simulation]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct SimulationKeys {
    /// Of the camera's image: 1, 0.5 or 0.25.
    pub scale: f64,
    /// What everything random is drawn from.
    pub seed: u64,
}

/// `[artefact]`: what VERIFY measures.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct ArtefactKeys {
    /// As `datum calibrate` names boards.
    pub board: String,
    /// Where the board's first point stands, mm, station frame; with `angles_deg`. None: where it stands is not checked.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub position_mm: Option<[f64; 3]>,
    /// How it is turned: roll, pitch, yaw.
    #[serde(default)]
    pub angles_deg: [f64; 3],
    /// How far it may seem shifted.
    #[serde(default = "shift")]
    pub shift_mm: f64,
    /// And tilted.
    #[serde(default = "tilt")]
    pub tilt_deg: f64,
    /// Largest error of lengths.
    #[serde(default = "scale")]
    pub scale_percent: f64,
    /// Verification is due after so many hours; 0: never.
    #[serde(default = "every")]
    pub every_h: f64,
}

fn shift() -> f64 {
    0.5
}
fn tilt() -> f64 {
    0.1
}
fn scale() -> f64 {
    VerifyLimits::default().scale_percent
}
fn every() -> f64 {
    24.0
}

impl Default for StationFile {
    fn default() -> Self {
        Self {
            file: PathBuf::new(),
            format: document::FORMAT,
            serial: "SIMULATED".into(),
            calibration: None,
            detector: detect::DEFAULT.into(),
            camera: CameraKeys::default(),
            projector: ProjectorKeys::default(),
            lights: LightsKeys::default(),
            presence: PresenceKeys::default(),
            cycle: CycleKeys::default(),
            plc: PlcKeys::default(),
            jobs: JobsKeys::default(),
            records: RecordsKeys::default(),
            simulation: SimulationKeys::default(),
            artefact: None,
        }
    }
}

impl Default for CameraKeys {
    fn default() -> Self {
        Self { kind: CameraKind::default(), longest_ms: 25.0 }
    }
}

impl Default for LightsKeys {
    fn default() -> Self {
        Self { kind: LightsKind::default(), drive: 0.6 }
    }
}

impl Default for PresenceKeys {
    fn default() -> Self {
        Self { kind: PresenceKind::default(), debounce_ms: 300 }
    }
}

impl Default for CycleKeys {
    fn default() -> Self {
        Self {
            trigger: TriggerKind::default(),
            self_test: true,
            warm_up_s: 0,
            acquire_ms: 1200,
            second_by_ms: 2200,
            second_captures: 1,
            ambient_limit: 4.0,
        }
    }
}

impl Default for PlcKeys {
    fn default() -> Self {
        Self {
            listen: "127.0.0.1:5020".into(),
            allow: vec!["127.0.0.1/32".into()],
            word_order: WordOrder::default(),
            heartbeat_s: 3.0,
        }
    }
}

impl Default for JobsKeys {
    fn default() -> Self {
        Self { folder: "vehicles".into() }
    }
}

impl Default for RecordsKeys {
    fn default() -> Self {
        Self { folder: "records".into(), journal_mib: 256, captures_mib: 4096, keep_every: 20 }
    }
}

impl Default for SimulationKeys {
    fn default() -> Self {
        Self { scale: 0.5, seed: 1 }
    }
}

/// One key, explained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Key {
    /// Its table; empty: none.
    pub table: &'static str,
    /// Its name.
    pub name: &'static str,
    /// What it is for.
    pub meaning: &'static str,
    /// What may be written there.
    pub allowed: &'static str,
}

macro_rules! keys {
    ($($table:literal $name:literal: $meaning:literal, $allowed:literal;)*) => {
        /// Every key, in the order of the file.
        pub const KEYS: &[Key] = &[$(Key { table: $table, name: $name, meaning: $meaning, allowed: $allowed },)*];
    };
}

keys! {
    "" "format": "the format of this file", "1";
    "" "serial": "what the station is called: the serial number that the PLC reads", "1 to 16 printable characters";
    "" "calibration": "calibration.toml, beside this file; left out: the simulated station's own", "a path";
    "" "detector": "the network that proposes where features are, beside this file; left out: the one that comes with the program; \"none\": they are searched for", "a path, \"built-in\", \"none\"";
    "camera" "kind": "how the camera is reached", "\"simulated\", \"v4l2\", \"libcamera\"";
    "camera" "longest_ms": "no exposure is longer; gain makes up for it, so that all images are taken in time", "1 to 100";
    "projector" "kind": "how the projector is reached", "\"simulated\", \"v4l2-output\", \"sequenced\"";
    "lights" "kind": "how the light bars are driven", "\"simulated\", \"gpio\"";
    "lights" "drive": "where the search for the right drive of the bars starts", "0.05 to 1";
    "presence" "kind": "how the presence sensor is read", "\"simulated\", \"gpio\"";
    "presence" "debounce_ms": "a vehicle is there, or gone, when the sensor has said so for so long", "0 to 10000";
    "cycle" "trigger": "what begins a cycle; simulated vehicles come by themselves until a PLC takes ownership", "\"plc\", \"presence\"";
    "cycle" "self_test": "whether camera, projector and each bar are tried before the station is ready", "true, false";
    "cycle" "warm_up_s": "from the start until camera and projector count as warm", "0 to 7200";
    "cycle" "acquire_ms": "all images are taken by then, from the trigger; what is not is refused", "300 to 10000";
    "cycle" "second_by_ms": "a second capture of a vehicle that was not measured is taken only if it ends by then", "300 to 20000";
    "cycle" "second_captures": "automatic second captures of a vehicle", "0, 1";
    "cycle" "ambient_limit": "light from outside beyond this share of the red image's is refused with 303", "0.01 to 20";
    "plc" "listen": "address and port of the Modbus TCP server", "an address and a port, as in \"0.0.0.0:502\"";
    "plc" "allow": "networks whose connections are answered", "networks as in \"192.168.0.0/24\"";
    "plc" "word_order": "which half of a 32-bit number comes first", "\"high-first\", \"low-first\"";
    "plc" "heartbeat_s": "PLC_HEARTBEAT must change within this time", "0.5 to 30";
    "jobs" "folder": "vehicle models: files NNN-name.toml, released, with their templates", "a path";
    "records" "folder": "the journal and kept images", "a path";
    "records" "journal_mib": "the journal takes no more", "1 to 1048576";
    "records" "captures_mib": "kept images take no more", "0 to 1048576";
    "records" "keep_every": "images of every so many-th good vehicle are kept, and of every one not measured; 0: of none", "0 to 1000000";
    "simulation" "scale": "size of the simulated camera's image, of 2592×1944", "1, 0.5, 0.25";
    "simulation" "seed": "what everything random is drawn from", "0 or greater";
    "artefact" "board": "the board that VERIFY measures; without it there is no verification", "as for datum calibrate, chessboard:11x8:35";
    "artefact" "position_mm": "where its first point stands, station frame; left out: not checked", "x, y, z";
    "artefact" "angles_deg": "how it is turned: roll, pitch, yaw", "three numbers";
    "artefact" "shift_mm": "how far it may seem shifted (704)", "greater than 0";
    "artefact" "tilt_deg": "how far it may seem tilted (704)", "greater than 0";
    "artefact" "scale_percent": "how far lengths may be off (703)", "greater than 0";
    "artefact" "every_h": "verification is due after so many hours; 0: never", "0 or greater";
}

impl StationFile {
    /// Reads and checks a configuration.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let mut read: Self = document::read(file)?;
        read.file = file.into();
        read.check()?;
        Ok(read)
    }

    /// A path that the file names: beside it, unless it is absolute.
    pub fn beside(&self, path: &Path) -> PathBuf {
        self.file.parent().map_or_else(|| path.into(), |folder| folder.join(path))
    }

    /// The detector that the file names, ready to use.
    pub fn read_detector(&self) -> Result<Option<Arc<Detector>>, Error> {
        let named = [detect::DEFAULT, detect::NONE].iter().any(|name| self.detector == Path::new(name));
        Detector::named(&if named { self.detector.clone() } else { self.beside(&self.detector) })
    }

    /// The artefact's board, if there is one.
    pub fn board(&self) -> Option<Board> {
        self.artefact.as_ref().and_then(|a| a.board.parse().ok())
    }

    /// The first device whose driver is not part of this program, as its key and value.
    pub fn not_built(&self) -> Option<String> {
        let spelled = |key: &str, simulated: bool, kind: &dyn erased::Spelled| {
            (!simulated).then(|| format!("{key} = {}", kind.spelled()))
        };
        spelled("camera.kind", self.camera.kind == CameraKind::Simulated, &self.camera.kind)
            .or_else(|| {
                let kind = self.projector.kind;
                spelled("projector.kind", kind == ProjectorKind::Simulated, &kind)
            })
            .or_else(|| spelled("lights.kind", self.lights.kind == LightsKind::Simulated, &self.lights.kind))
            .or_else(|| spelled("presence.kind", self.presence.kind == PresenceKind::Simulated, &self.presence.kind))
    }

    fn check(&self) -> Result<(), Error> {
        let check = Check(&self.file);
        check.name("serial", &self.serial)?;
        let allowed = "1 to 16 printable ASCII characters";
        check.that(self.serial.len() <= 16 && self.serial.is_ascii(), "serial", &self.serial, allowed)?;
        check.within("camera.longest_ms", self.camera.longest_ms, 1.0..=100.0)?;
        check.within("lights.drive", self.lights.drive, 0.05..=1.0)?;
        check.within("presence.debounce_ms", self.presence.debounce_ms, 0..=10_000)?;
        let c = &self.cycle;
        check.within("cycle.warm_up_s", c.warm_up_s, 0..=7200)?;
        check.within("cycle.acquire_ms", c.acquire_ms, 300..=10_000)?;
        check.within("cycle.second_by_ms", c.second_by_ms, 300..=20_000)?;
        check.within("cycle.second_captures", c.second_captures, 0..=1)?;
        check.within("cycle.ambient_limit", c.ambient_limit, 0.01..=20.0)?;
        let listens = self.plc.listen.parse::<std::net::SocketAddr>().is_ok();
        let allowed = "an address and a port, as in \"0.0.0.0:502\"";
        check.that(listens, "plc.listen", format!("{:?}", self.plc.listen), allowed)?;
        for (k, network) in self.plc.allow.iter().enumerate() {
            let ok = is_network(network);
            let allowed = "a network as in \"192.168.0.0/24\", or an address";
            check.that(ok, format!("plc.allow[{k}]"), format!("{network:?}"), allowed)?;
        }
        check.within("plc.heartbeat_s", self.plc.heartbeat_s, 0.5..=30.0)?;
        check.within("records.journal_mib", self.records.journal_mib, 1..=1 << 20)?;
        check.within("records.captures_mib", self.records.captures_mib, 0..=1 << 20)?;
        check.within("records.keep_every", self.records.keep_every, 0..=1_000_000)?;
        let scale = self.simulation.scale;
        check.that([1.0, 0.5, 0.25].contains(&scale), "simulation.scale", scale, "1, 0.5 or 0.25")?;
        if let Some(a) = &self.artefact {
            let board = a.board.parse::<Board>();
            let allowed = "as for datum calibrate: chessboard:11x8:35, circles:8x4:60:30, marked:8x4:60:30";
            check.that(board.is_ok(), "artefact.board", format!("{:?}", a.board), allowed)?;
            check.finite("artefact.position_mm", &a.position_mm.unwrap_or_default())?;
            check.finite("artefact.angles_deg", &a.angles_deg)?;
            check.positive("artefact.shift_mm", a.shift_mm)?;
            check.positive("artefact.tilt_deg", a.tilt_deg)?;
            check.positive("artefact.scale_percent", a.scale_percent)?;
            check.not_negative("artefact.every_h", a.every_h)?;
        }
        Ok(())
    }

    /// A key's value as the file would spell it; `None`: it is left out and has no default.
    pub fn value(&self, key: &Key) -> Option<String> {
        let all = toml::Table::try_from(self).expect("plain tables");
        let table = if key.table.is_empty() { Some(&all) } else { all.get(key.table).and_then(toml::Value::as_table) };
        table.and_then(|t| t.get(key.name)).map(ToString::to_string)
    }
}

fn is_network(text: &str) -> bool {
    let (address, bits) = text.split_once('/').map_or((text, None), |(a, b)| (a, Some(b)));
    let most = match address.parse::<std::net::IpAddr>() {
        Ok(std::net::IpAddr::V4(_)) => 32,
        Ok(std::net::IpAddr::V6(_)) => 128,
        Err(_) => return false,
    };
    bits.is_none_or(|b| b.parse::<u8>().is_ok_and(|b| b <= most))
}

/// Any of the kinds, as the file spells it.
mod erased {
    pub(super) trait Spelled {
        fn spelled(&self) -> String;
    }

    impl<T: serde::Serialize> Spelled for T {
        fn spelled(&self) -> String {
            serde_json::to_string(self).expect("an enum without content is a string")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn reading(text: &str) -> Result<StationFile, String> {
        let name = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(text.as_bytes());
        let file = std::env::temp_dir().join(format!("datum-station-{}-{name:08x}.toml", std::process::id()));
        std::fs::write(&file, text).expect("temporary file");
        let read = StationFile::read(&file).map_err(|e| e.to_string().replace(&file.display().to_string(), "s.toml"));
        std::fs::remove_file(&file).expect("just written");
        read
    }

    #[test]
    fn the_file_of_the_formats_is_the_built_in_station() {
        let text = r#"
format = 1
[camera]
kind = "simulated"
[projector]
kind = "simulated"
[lights]
kind = "simulated"
[presence]
kind = "simulated"
[cycle]
trigger = "plc"
[plc]
listen = "127.0.0.1:5020"
allow = ["127.0.0.1/32"]
word_order = "high-first"
[jobs]
folder = "vehicles"
[records]
folder = "records"
journal_mib = 256
captures_mib = 4096
[simulation]
scale = 0.5
seed = 1
"#;
        let read = reading(text).expect("valid");
        assert_eq!(StationFile { file: PathBuf::new(), ..read }, StationFile::default());
        assert_eq!(reading("format = 1").expect("valid").cycle, CycleKeys::default());
    }

    #[test]
    fn an_error_names_file_key_value_and_what_is_allowed() {
        for (text, says) in [
            ("format = 1\n[camera]\nknd = 1", "s.toml: line 3, `knd = 1`: unknown field `knd`, expected `kind` or"),
            (
                "format = 1\n[camera]\nkind = \"usb\"",
                "unknown variant `usb`, expected one of `simulated`, `v4l2`, `libcamera`",
            ),
            ("format = 1\n[simulation]\nscale = 0.3", "s.toml: simulation.scale = 0.3, allowed: 1, 0.5 or 0.25"),
            ("format = 1\n[plc]\nlisten = \"here\"", "s.toml: plc.listen = \"here\", allowed: an address and a port"),
            (
                "format = 1\n[plc]\nallow = [\"10.0.0.0/33\"]",
                "s.toml: plc.allow[0] = \"10.0.0.0/33\", allowed: a network",
            ),
            ("format = 1\n[plc]\nheartbeat_s = 31", "s.toml: plc.heartbeat_s = 31, allowed: 0.5 to 30"),
            ("format = 1\n[artefact]\nboard = \"plank\"", "s.toml: artefact.board = \"plank\", allowed: as for datum"),
            ("format = 1\n[cycle]\nsecond_captures = 2", "s.toml: cycle.second_captures = 2, allowed: 0 to 1"),
        ] {
            let e = reading(text).expect_err(text);
            assert!(e.contains(says), "{e}\nfor {says}");
        }
    }

    #[test]
    fn every_key_is_explained_and_no_other() {
        let artefact = ArtefactKeys {
            board: "chessboard:11x8:35".into(),
            position_mm: Some([0.0; 3]),
            angles_deg: [0.0; 3],
            shift_mm: shift(),
            tilt_deg: tilt(),
            scale_percent: scale(),
            every_h: every(),
        };
        let full =
            StationFile { calibration: Some("c.toml".into()), artefact: Some(artefact), ..StationFile::default() };
        let mut found = Vec::new();
        for (name, value) in toml::Table::try_from(&full).expect("plain tables") {
            match value.as_table() {
                Some(table) => found.extend(table.keys().map(|k| (name.clone(), k.clone()))),
                None => found.push((String::new(), name)),
            }
        }
        let mut explained: Vec<_> = KEYS.iter().map(|k| (k.table.to_owned(), k.name.to_owned())).collect();
        found.sort();
        explained.sort();
        assert_eq!(found, explained);
        assert!(KEYS.iter().all(|k| full.value(k).is_some()));
    }

    #[test]
    fn a_device_without_a_driver_is_named() {
        let read = reading("format = 1\n[projector]\nkind = \"v4l2-output\"").expect("parses");
        assert_eq!(read.not_built().as_deref(), Some("projector.kind = \"v4l2-output\""));
        assert_eq!(StationFile::default().not_built(), None);
    }
}
