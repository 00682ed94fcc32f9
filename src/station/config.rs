//! station.toml: what a station is made of and how it works. In: the file, or none. Out: its checked content.
//! Not here: what follows from it.

use crate::calibrate::{Board, VerifyLimits};
use crate::detect::{self, Detector};
use crate::document::{self, Check, Error};
use crate::hal::linux::{ChannelName, LineName};
use crate::plc::WordOrder;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
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
    /// What is how warm.
    pub temperatures: TemperatureKeys,
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

/// How samples lie in memory, as V4L2 names it: grey levels, the lowest bits of little-endian words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[expect(missing_docs, reason = "the names say it")]
pub enum PixelFormat {
    #[default]
    #[serde(rename = "GREY")]
    Grey,
    Y10,
    Y12,
    Y16,
}

/// What makes the camera expose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CameraTrigger {
    /// It exposes by itself, all the time.
    #[default]
    Free,
    /// A pulse on a GPIO line.
    Gpio,
}

/// `[camera]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct CameraKeys {
    /// How it is reached.
    pub kind: CameraKind,
    /// No exposure is longer.
    pub longest_ms: f64,
    /// Its node, or its name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Columns of its images.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// How samples lie in memory.
    pub format: PixelFormat,
    /// Images per second.
    pub rate: f64,
    /// What makes it expose.
    pub trigger: CameraTrigger,
    /// The line that does.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trigger_line: Option<String>,
    /// One unit of its exposure control.
    pub exposure_unit_us: f64,
    /// What its gain control shows at gain 1; none: its least value.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_one: Option<i64>,
    /// Images after a change of exposure or gain that still show the former.
    pub lag_images: usize,
    /// Further controls by their names, set whenever it is opened.
    pub controls: BTreeMap<String, i64>,
    /// Grey level of no light.
    pub black_level: f64,
    /// Grey level from which on a sample is saturated; none: the largest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_level: Option<u16>,
    /// Grey levels per electron at gain 1; none: those of a sensor of 8000 electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dn_per_electron: Option<f64>,
    /// Electrons.
    pub read_noise_e: f64,
    /// Its serial number.
    pub serial: String,
}

/// `[projector]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct ProjectorKeys {
    /// How it is reached.
    pub kind: ProjectorKind,
    /// Its node, or its name.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// From when it has taken a picture until its light is steady.
    pub settle_ms: f64,
    /// The line that shows the next stored picture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub advance: Option<String>,
    /// The line that shows the first one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub restart: Option<String>,
    /// The line on which it tells that it shows another one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub trigger_out: Option<String>,
    /// The pictures that it stores.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patterns: Option<PathBuf>,
    /// How long a pulse, and the pause after it, must be.
    pub pulse_us: u64,
}

/// `[lights]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct LightsKeys {
    /// How they are driven.
    pub kind: LightsKind,
    /// Where the search for the right drive starts, 0 to 1.
    pub drive: f64,
    /// The line that switches the left bar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left: Option<String>,
    /// And the right one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub right: Option<String>,
    /// The channel that dims the left bar.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub left_pwm: Option<String>,
    /// And the right one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub right_pwm: Option<String>,
    /// Of both channels.
    pub pwm_hz: f64,
    /// The bars are on where their lines are low.
    pub active_low: bool,
    /// The dead-man's line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub alive: Option<String>,
    /// Until the light is steady.
    pub settle_ms: f64,
}

/// `[presence]`
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct PresenceKeys {
    /// How it is read.
    pub kind: PresenceKind,
    /// A vehicle is there, or gone, when the sensor has said so for so long.
    pub debounce_ms: u64,
    /// Its line.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub line: Option<String>,
    /// A vehicle pulls the line down.
    pub active_low: bool,
}

/// `[temperatures]`: hwmon sensors; none: not known.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
pub struct TemperatureKeys {
    /// The computer's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub computer: Option<String>,
    /// The camera's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera: Option<String>,
    /// The projector's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projector: Option<String>,
    /// The computer may be so warm, °C.
    pub computer_max_c: f64,
    /// And the camera.
    pub camera_max_c: f64,
    /// And the projector.
    pub projector_max_c: f64,
}

impl Default for TemperatureKeys {
    fn default() -> Self {
        Self {
            computer: None,
            camera: None,
            projector: None,
            computer_max_c: 90.0,
            camera_max_c: 80.0,
            projector_max_c: 70.0,
        }
    }
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
            temperatures: TemperatureKeys::default(),
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
        Self {
            kind: CameraKind::default(),
            longest_ms: 25.0,
            device: None,
            width: 2592,
            height: 1944,
            format: PixelFormat::default(),
            rate: 30.0,
            trigger: CameraTrigger::default(),
            trigger_line: None,
            exposure_unit_us: 100.0,
            gain_one: None,
            lag_images: 2,
            controls: BTreeMap::new(),
            black_level: 2.0,
            white_level: None,
            dn_per_electron: None,
            read_noise_e: 6.0,
            serial: String::new(),
        }
    }
}

impl Default for ProjectorKeys {
    fn default() -> Self {
        Self {
            kind: ProjectorKind::default(),
            device: None,
            width: 1280,
            height: 800,
            settle_ms: 2.0,
            advance: None,
            restart: None,
            trigger_out: None,
            patterns: None,
            pulse_us: 500,
        }
    }
}

impl Default for LightsKeys {
    fn default() -> Self {
        Self {
            kind: LightsKind::default(),
            drive: 0.6,
            left: None,
            right: None,
            left_pwm: None,
            right_pwm: None,
            pwm_hz: 20_000.0,
            active_low: false,
            alive: None,
            settle_ms: 2.0,
        }
    }
}

impl Default for PresenceKeys {
    fn default() -> Self {
        Self { kind: PresenceKind::default(), debounce_ms: 300, line: None, active_low: false }
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
            ambient_limit: 5.0,
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
    "camera" "device": "its V4L2 node, or the name that the driver gives it (/sys/class/video4linux/*/name); of libcamera its id or model (`cam -l`)", "a path, a name";
    "camera" "width": "columns of its images, px", "16 to 10000";
    "camera" "height": "rows of its images, px", "16 to 10000";
    "camera" "format": "how it delivers samples: 8 bits, or the lowest 10, 12 or 16 bits of a word", "\"GREY\", \"Y10\", \"Y12\", \"Y16\"";
    "camera" "rate": "images per second that it is asked for", "1 to 1000";
    "camera" "trigger": "what makes it expose: nothing (all the time), or a pulse on a GPIO line", "\"free\", \"gpio\"";
    "camera" "trigger_line": "the GPIO line that triggers it", "a chip's label and a line's name, \"label/name\"";
    "camera" "exposure_unit_us": "one unit of its exposure control, us", "0.1 to 1000";
    "camera" "gain_one": "what its gain control shows at gain 1, from which gain grows in proportion; left out: its least value", "1 or greater";
    "camera" "lag_images": "images after a change of exposure or gain that are still exposed as before", "0 to 10";
    "camera" "controls": "further controls by name, V4L2's or libcamera's, set whenever it is opened, as in { \"Trigger Mode\" = 1 }", "whole numbers";
    "camera" "black_level": "grey level of no light", "0 to 4095";
    "camera" "white_level": "grey level from which on a sample is saturated; left out: the format's largest", "100 to 65535";
    "camera" "dn_per_electron": "grey levels per electron at gain 1; left out: those of a sensor that holds 8000", "greater than 0";
    "camera" "read_noise_e": "read noise, electrons", "0 to 1000";
    "camera" "serial": "its serial number, which captures and the PLC are told", "up to 16 printable characters";
    "projector" "kind": "how the projector is reached: pictures go to a node, or are stored in it and advanced by GPIO", "\"simulated\", \"v4l2-output\", \"sequenced\"";
    "projector" "device": "its V4L2 output node, or the name that the driver gives it", "a path, a name";
    "projector" "width": "its columns, px", "128 to 10000";
    "projector" "height": "its rows, px", "16 to 10000";
    "projector" "settle_ms": "from when it has taken a picture until its light is steady; `datum doctor` measures it", "0 to 1000";
    "projector" "advance": "the GPIO line whose pulse shows the next stored picture", "a chip's label and a line's name, \"label/name\"";
    "projector" "restart": "the GPIO line whose pulse shows the first stored picture, which is black", "a chip's label and a line's name, \"label/name\"";
    "projector" "trigger_out": "the GPIO line on which it tells each picture that it shows; left out: it is trusted", "a chip's label and a line's name, \"label/name\"";
    "projector" "patterns": "the folder of the pictures that it stores, in the order of their names, as `datum patterns --stored` writes them", "a path";
    "projector" "pulse_us": "how long a pulse, and the pause after it, must be", "1 to 100000";
    "lights" "kind": "how the light bars are driven", "\"simulated\", \"gpio\"";
    "lights" "drive": "where the search for the right drive of the bars starts", "0.05 to 1";
    "lights" "left": "the GPIO line that switches the left bar, seen from the camera", "a chip's label and a line's name, \"label/name\"";
    "lights" "right": "the GPIO line that switches the right bar", "a chip's label and a line's name, \"label/name\"";
    "lights" "left_pwm": "the PWM channel that dims the left bar", "a PWM chip's device and a channel, \"device/0\"";
    "lights" "right_pwm": "the PWM channel that dims the right bar", "a PWM chip's device and a channel, \"device/1\"";
    "lights" "pwm_hz": "frequency of both channels", "100 to 1000000";
    "lights" "active_low": "whether a bar is on where its line is low", "true, false";
    "lights" "alive": "the GPIO line that pulses while the bars may be on: the hardware's dead-man; left out: there is none", "a chip's label and a line's name, \"label/name\"";
    "lights" "settle_ms": "until a bar's light is steady", "0 to 1000";
    "presence" "kind": "how the presence sensor is read; with real devices \"simulated\" is none", "\"simulated\", \"gpio\"";
    "presence" "debounce_ms": "a vehicle is there, or gone, when the sensor has said so for so long", "0 to 10000";
    "presence" "line": "its GPIO line", "a chip's label and a line's name, \"label/name\"";
    "presence" "active_low": "whether a vehicle pulls the line down", "true, false";
    "temperatures" "computer": "the computer's hwmon sensor; left out: not known", "a chip's name, or \"name/label\"";
    "temperatures" "camera": "the camera's hwmon sensor; left out: not known", "a chip's name, or \"name/label\"";
    "temperatures" "projector": "the projector's hwmon sensor; left out: not known", "a chip's name, or \"name/label\"";
    "temperatures" "computer_max_c": "°C beyond which nothing is measured until the computer has cooled by 5 (211)", "30 to 120";
    "temperatures" "camera_max_c": "the same for the camera; its data sheet says how warm it may be", "30 to 120";
    "temperatures" "projector_max_c": "the same for the projector", "30 to 120";
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

    /// The device whose driver this program was built without, as its key and value.
    pub fn not_built(&self) -> Option<String> {
        let libcamera = self.camera.kind == CameraKind::Libcamera && !cfg!(feature = "libcamera");
        libcamera.then(|| "camera.kind = \"libcamera\"".into())
    }

    /// Whether the devices are simulated; a station's are all of them, or none.
    pub fn is_simulated(&self) -> bool {
        self.camera.kind == CameraKind::Simulated
    }

    fn check(&self) -> Result<(), Error> {
        let check = Check(&self.file);
        check.name("serial", &self.serial)?;
        let allowed = "1 to 16 printable ASCII characters";
        check.that(self.serial.len() <= 16 && self.serial.is_ascii(), "serial", &self.serial, allowed)?;
        self.check_devices(check)?;
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

    fn check_devices(&self, check: Check) -> Result<(), Error> {
        let (camera, projector, lights, presence) = (&self.camera, &self.projector, &self.lights, &self.presence);
        check.within("camera.longest_ms", camera.longest_ms, 1.0..=100.0)?;
        check.within("camera.width", camera.width, 16..=10_000)?;
        check.within("camera.height", camera.height, 16..=10_000)?;
        check.within("camera.rate", camera.rate, 1.0..=1000.0)?;
        check.within("camera.exposure_unit_us", camera.exposure_unit_us, 0.1..=1000.0)?;
        check.within("camera.lag_images", camera.lag_images, 0..=10)?;
        check.within("camera.gain_one", camera.gain_one.unwrap_or(1), 1..=i64::from(i32::MAX))?;
        check.within("camera.black_level", camera.black_level, 0.0..=4095.0)?;
        check.within("camera.white_level", camera.white_level.unwrap_or(100), 100..=u16::MAX)?;
        check.positive("camera.dn_per_electron", camera.dn_per_electron.unwrap_or(1.0))?;
        check.within("camera.read_noise_e", camera.read_noise_e, 0.0..=1000.0)?;
        let printable = camera.serial.len() <= 16 && camera.serial.bytes().all(|b| b.is_ascii_graphic() || b == b' ');
        check.that(printable, "camera.serial", &camera.serial, "up to 16 printable ASCII characters")?;
        check.within("projector.width", projector.width, 128..=10_000)?;
        check.within("projector.height", projector.height, 16..=10_000)?;
        check.within("projector.settle_ms", projector.settle_ms, 0.0..=1000.0)?;
        check.within("projector.pulse_us", projector.pulse_us, 1..=100_000)?;
        check.within("lights.drive", lights.drive, 0.05..=1.0)?;
        check.within("lights.pwm_hz", lights.pwm_hz, 100.0..=1e6)?;
        check.within("lights.settle_ms", lights.settle_ms, 0.0..=1000.0)?;
        check.within("presence.debounce_ms", presence.debounce_ms, 0..=10_000)?;
        let t = &self.temperatures;
        check.within("temperatures.computer_max_c", t.computer_max_c, 30.0..=120.0)?;
        check.within("temperatures.camera_max_c", t.camera_max_c, 30.0..=120.0)?;
        check.within("temperatures.projector_max_c", t.projector_max_c, 30.0..=120.0)?;

        // a world is simulated whole, or real
        for (key, simulated) in [
            ("projector.kind", projector.kind == ProjectorKind::Simulated),
            ("lights.kind", lights.kind == LightsKind::Simulated),
        ] {
            let (found, allowed) = if simulated {
                ("\"simulated\"", "a real one, as camera.kind is")
            } else {
                ("a real one", "\"simulated\", as camera.kind is")
            };
            check.that(simulated == self.is_simulated(), key, found, allowed)?;
        }
        let none = presence.kind == PresenceKind::Gpio && self.is_simulated();
        check.that(!none, "presence.kind", "\"gpio\"", "\"simulated\", as camera.kind is")?;
        let seen = self.is_simulated() || presence.kind == PresenceKind::Gpio;
        let by_presence = self.cycle.trigger == TriggerKind::Presence;
        check.that(
            seen || !by_presence,
            "cycle.trigger",
            "\"presence\"",
            "\"plc\" where presence.kind is not \"gpio\"",
        )?;

        let node = |key, device: &Option<String>| {
            let named = device.as_deref().is_some_and(|d| !d.is_empty());
            let found = device.as_ref().map_or_else(|| "(missing)".into(), |d| format!("{d:?}"));
            check.that(named, key, found, "a node as in \"/dev/video0\", or a device's name")
        };
        if camera.kind != CameraKind::Simulated {
            node("camera.device", &camera.device)?;
        }
        if camera.trigger == CameraTrigger::Gpio {
            line(check, "camera.trigger_line", camera.trigger_line.as_deref())?;
        }
        match projector.kind {
            ProjectorKind::Simulated => {}
            ProjectorKind::V4l2Output => node("projector.device", &projector.device)?,
            ProjectorKind::Sequenced => {
                line(check, "projector.advance", projector.advance.as_deref())?;
                line(check, "projector.restart", projector.restart.as_deref())?;
                if projector.trigger_out.is_some() {
                    line(check, "projector.trigger_out", projector.trigger_out.as_deref())?;
                }
                let allowed = "the folder of the stored pictures";
                check.that(projector.patterns.is_some(), "projector.patterns", "(missing)", allowed)?;
            }
        }
        if lights.kind == LightsKind::Gpio {
            for (key, name) in [("lights.left", &lights.left), ("lights.right", &lights.right)] {
                line(check, key, name.as_deref())?;
            }
            for (key, name) in [("lights.left_pwm", &lights.left_pwm), ("lights.right_pwm", &lights.right_pwm)] {
                parsed::<ChannelName>(check, key, name.as_deref())?;
            }
            if lights.alive.is_some() {
                line(check, "lights.alive", lights.alive.as_deref())?;
            }
        }
        if presence.kind == PresenceKind::Gpio {
            line(check, "presence.line", presence.line.as_deref())?;
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

fn line(check: Check, key: &str, text: Option<&str>) -> Result<(), Error> {
    parsed::<LineName>(check, key, text)
}

fn parsed<T: FromStr<Err = &'static str>>(check: Check, key: &str, text: Option<&str>) -> Result<(), Error> {
    let found = text.map_or_else(|| "(missing)".into(), |t| format!("{t:?}"));
    text.unwrap_or_default().parse::<T>().map_or_else(|allowed| check.that(false, key, found, allowed), |_| Ok(()))
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
            ("format = 1\n[camera]\nknd = 1", "s.toml: line 3, `knd = 1`: unknown field `knd`, expected one of `kind`"),
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
        let name = || Some("gpio/line".to_owned());
        let mut full =
            StationFile { calibration: Some("c.toml".into()), artefact: Some(artefact), ..StationFile::default() };
        let camera = CameraKeys { device: name(), trigger_line: name(), gain_one: Some(1), ..full.camera };
        full.camera = CameraKeys { white_level: Some(255), dn_per_electron: Some(0.03), ..camera };
        let projector = ProjectorKeys { device: name(), advance: name(), restart: name(), ..full.projector };
        full.projector = ProjectorKeys { trigger_out: name(), patterns: Some("p".into()), ..projector };
        let lights = LightsKeys { left: name(), right: name(), left_pwm: name(), right_pwm: name(), ..full.lights };
        full.lights = LightsKeys { alive: name(), ..lights };
        full.presence.line = name();
        full.temperatures =
            TemperatureKeys { computer: name(), camera: name(), projector: name(), ..full.temperatures };
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

    /// Of real devices.
    const REAL: &str = r#"
format = 1
[camera]
kind = "v4l2"
device = "/dev/video0"
[projector]
kind = "v4l2-output"
device = "projector"
[lights]
kind = "gpio"
left = "gpio/left"
right = "gpio/right"
left_pwm = "lamps.pwm/0"
right_pwm = "lamps.pwm/1"
[presence]
kind = "gpio"
line = "gpio/vehicle"
"#;

    #[test]
    fn a_station_of_real_devices_names_each_and_mixes_none_with_simulated_ones() {
        assert!(!reading(REAL).expect("valid").is_simulated());
        for (was, becomes, says) in [
            ("device = \"/dev/video0\"", "", "camera.device = (missing), allowed: a node"),
            (
                "left = \"gpio/left\"",
                "left = \"17\"",
                "lights.left = \"17\", allowed: a GPIO chip's label and a line's name",
            ),
            ("right_pwm = \"lamps.pwm/1\"", "", "lights.right_pwm = (missing), allowed: a PWM chip's device"),
            ("line = \"gpio/vehicle\"", "", "presence.line = (missing), allowed: a GPIO chip's label"),
            (
                "kind = \"v4l2\"",
                "kind = \"simulated\"",
                "projector.kind = a real one, allowed: \"simulated\", as camera.kind",
            ),
            ("kind = \"v4l2-output\"", "", "projector.kind = \"simulated\", allowed: a real one, as camera.kind is"),
            (
                "kind = \"v4l2-output\"",
                "kind = \"sequenced\"",
                "projector.advance = (missing), allowed: a GPIO chip's label",
            ),
            (
                "[presence]\nkind = \"gpio\"",
                "[cycle]\ntrigger = \"presence\"\n[presence]",
                "cycle.trigger = \"presence\", allowed: \"plc\" where presence.kind is not \"gpio\"",
            ),
        ] {
            assert!(REAL.contains(was), "{was}");
            let e = reading(&REAL.replacen(was, becomes, 1)).expect_err(says);
            assert!(e.contains(says), "{e}\nfor {says}");
        }
    }

    #[test]
    fn a_device_without_a_driver_is_named() {
        let read = reading(&REAL.replacen("v4l2", "libcamera", 1)).expect("parses");
        let missing = (!cfg!(feature = "libcamera")).then_some("camera.kind = \"libcamera\"");
        assert_eq!(read.not_built().as_deref(), missing);
        assert_eq!(StationFile::default().not_built(), None);
    }
}
