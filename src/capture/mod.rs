//! A recorded capture: a folder of grey images and the `capture.toml` that says what they show.
//! In:  the folder. Out: its checked description, and the images one at a time when asked for.
//! Not here: decoding. [`record`] makes captures.

mod fringes;
mod order;
mod record;
pub(crate) mod shoot;

pub use record::{Plan, RecordError, record, record_while, take, write};
pub use shoot::{Described, Devices, Light, SETS, ShootError, Shooting, Shots, pictures};

pub use order::check_order;

pub use fringes::{Fringes, TYPICAL_GAIN, coordinates};

use crate::document::{self, Check};
use crate::fringe::{self, Axis};
use crate::image::{Image, MAX_SIDE, PngError, PngHeader, read_png, read_png_header};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The description's file name.
pub const FILE: &str = "capture.toml";
/// Fewer columns or rows show nothing that can be measured.
const MIN_SIDE: usize = 16;

/// Why a capture cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Its description.
    #[error(transparent)]
    Document(#[from] document::Error),
    /// An image that is missing or no grey PNG.
    #[error("{}: {key} = {}", file.display(), image.display())]
    Image {
        /// The description that names it.
        file: PathBuf,
        /// The key that names it.
        key: String,
        /// The image, as named there.
        image: PathBuf,
        /// What is wrong with it.
        source: Box<PngError>,
    },
    /// An image of another size or depth than the description says.
    #[error("{}: {key} = {}: {}×{} at {} bits, allowed: camera.width × camera.height at camera.bits, {}×{} at {} bits",
        file.display(), image.display(), found.width, found.height, found.bits, allowed.width, allowed.height, allowed.bits)]
    Size {
        /// The description that names it.
        file: PathBuf,
        /// The key that names it.
        key: String,
        /// The image, as named there.
        image: PathBuf,
        /// Its header.
        found: PngHeader,
        /// What the description says.
        allowed: PngHeader,
    },
}

/// A capture, its description checked and its images seen to be there.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Capture {
    /// Where the images lie.
    #[serde(skip)]
    pub folder: PathBuf,
    /// 1.
    pub format: u32,
    /// Date and time of the first exposure, RFC 3339.
    pub taken_at: String,
    /// The sensor.
    pub camera: Camera,
    /// All images but the fringes.
    #[serde(default)]
    pub images: Images,
    /// The projector.
    pub projector: Projector,
    /// The fringe sets in the order shown; at least one.
    pub fringes: Vec<FringeSet>,
    /// What else was known.
    #[serde(default)]
    pub conditions: Conditions,
}

/// What the camera's grey levels mean.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
    /// Sample size of the PNG files: 8 or 16.
    pub bits: u8,
    /// Saturated from here on; [`Camera::white_level`] knows the default.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub white_level: Option<f64>,
    /// Grey level of no light.
    #[serde(default)]
    pub black_level: f64,
    /// Read noise, electrons.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// Serial number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
}

impl Camera {
    /// Saturated from this grey level on: as stated, else the largest sample.
    pub fn white_level(&self) -> f64 {
        self.white_level.unwrap_or(self.largest_sample())
    }

    fn largest_sample(&self) -> f64 {
        2f64.powi(i32::from(self.bits)) - 1.0
    }
}

/// The images that are no fringes; file names as in the description, for [`Capture::load`].
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Images {
    /// Bars on, projector off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub red: Option<PathBuf>,
    /// Everything off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ambient: Option<PathBuf>,
    /// The first fringe image once more, at the end.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub repeat: Option<PathBuf>,
    /// Grey levels per electron in `red`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub red_gain_dn_per_e: Option<f64>,
}

/// The projector's picture.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Projector {
    /// Columns, px.
    pub width: usize,
    /// Rows, px.
    pub height: usize,
}
/// One set of fringe images, each shifted by one `steps`-th of a period.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct FringeSet {
    /// Along which coordinate they vary.
    pub axis: Axis,
    /// Periods across the projector.
    pub count: u32,
    /// Phase steps: 3 to 16.
    pub steps: u32,
    /// Grey levels per electron.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gain_dn_per_e: Option<f64>,
    /// Exposure, ms; sets equal but for it form a high-dynamic-range stack.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub exposure_ms: Option<f64>,
    /// One file per step, in the order of the steps.
    pub images: Vec<PathBuf>,
}

/// What else was known when the capture was taken.
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Conditions {
    /// Drive of the left bar, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bar_left: Option<f64>,
    /// Drive of the right bar, 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub bar_right: Option<f64>,
    /// °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub camera_temperature_c: Option<f64>,
    /// °C.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub projector_temperature_c: Option<f64>,
    /// Vehicle identification number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub vin: Option<String>,
    /// The job that was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub job: Option<u16>,
}

impl Capture {
    /// Reads and checks `folder`'s description, and the header of every image it names; no pixels yet.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let mut capture: Self = document::read(&folder.join(FILE))?;
        capture.folder = folder.into();
        capture.check()?;
        for (key, image) in capture.image_files() {
            capture.check_header(&key, image)?;
        }
        Ok(capture)
    }

    /// The name reports use: the folder's.
    pub fn name(&self) -> String {
        name_of(&self.folder)
    }

    /// The description's path, for messages.
    pub fn file(&self) -> PathBuf {
        self.folder.join(FILE)
    }

    /// The pixels of one of the capture's images, named as in the description. Grey levels are as stored;
    /// none is refused for lying above the white level.
    pub fn load(&self, image: &Path) -> Result<Image<u16>, Error> {
        let key = self.image_files().find(|(_, i)| *i == image).map_or_else(|| "images".into(), |(key, _)| key);
        self.check_header(&key, image)?; // it may have changed since the capture was opened
        read_png(&self.folder.join(image)).map_err(|source| self.image_error(&key, image, source))
    }

    /// The red image's name, or an error for a capture without one.
    pub fn red(&self) -> Result<&Path, Error> {
        self.images.red.as_deref().ok_or_else(|| {
            Error::Document(document::Error::Value {
                file: self.file(),
                key: "images.red".into(),
                value: "(missing)".into(),
                allowed: "a grey PNG with bars on and projector off: measure and teach need it".into(),
            })
        })
    }

    /// Writes the description into the capture's folder, which is there.
    pub fn write(&self) -> Result<(), Error> {
        self.check()?;
        Ok(document::write(&self.file(), self)?)
    }

    /// Every image the description names, with its key.
    fn image_files(&self) -> impl Iterator<Item = (String, &PathBuf)> {
        let single = [("red", &self.images.red), ("ambient", &self.images.ambient), ("repeat", &self.images.repeat)];
        let single = single.into_iter().filter_map(|(key, image)| Some((format!("images.{key}"), image.as_ref()?)));
        let fringes = self.fringes.iter().enumerate();
        single.chain(fringes.flat_map(|(s, set)| {
            set.images.iter().enumerate().map(move |(k, image)| (format!("fringes[{s}].images[{k}]"), image))
        }))
    }

    fn check_header(&self, key: &str, image: &Path) -> Result<(), Error> {
        let found = read_png_header(&self.folder.join(image)).map_err(|source| self.image_error(key, image, source))?;
        let allowed = PngHeader { width: self.camera.width, height: self.camera.height, bits: self.camera.bits };
        if found != allowed {
            return Err(Error::Size { file: self.file(), key: key.into(), image: image.into(), found, allowed });
        }
        Ok(())
    }

    fn image_error(&self, key: &str, image: &Path, source: PngError) -> Error {
        Error::Image { file: self.file(), key: key.into(), image: image.into(), source: Box::new(source) }
    }

    fn check(&self) -> Result<(), document::Error> {
        let file = self.file();
        let check = Check(&file);
        let optional = |key: &str, value: Option<f64>| value.map_or(Ok(()), |v| check.positive(key, v));
        let full_date = self.taken_at.parse::<toml::value::Datetime>();
        check.that(
            full_date.is_ok_and(|d| d.date.is_some() && d.time.is_some() && d.offset.is_some()),
            "taken_at",
            format!("{:?}", self.taken_at),
            "date, time and offset as in \"2026-11-22T05:00:00Z\"",
        )?;
        let camera = &self.camera;
        check.within("camera.width", camera.width, MIN_SIDE..=MAX_SIDE)?;
        check.within("camera.height", camera.height, MIN_SIDE..=MAX_SIDE)?;
        check.that([8, 16].contains(&camera.bits), "camera.bits", camera.bits, "8 or 16")?;
        check.within("camera.white_level", camera.white_level(), 1.0..=camera.largest_sample())?;
        check.that(
            camera.black_level >= 0.0 && camera.black_level < camera.white_level(),
            "camera.black_level",
            camera.black_level,
            format!("0 or greater, less than the white level {}", camera.white_level()),
        )?;
        camera.read_noise_e.map_or(Ok(()), |v| check.not_negative("camera.read_noise_e", v))?;
        optional("images.red_gain_dn_per_e", self.images.red_gain_dn_per_e)?;
        check.within("projector.width", self.projector.width, MIN_SIDE..=MAX_SIDE)?;
        check.within("projector.height", self.projector.height, MIN_SIDE..=MAX_SIDE)?;
        check.within("number of [[fringes]]", self.fringes.len(), 1..=fringe::MAX_SETS)?;
        for (s, set) in self.fringes.iter().enumerate() {
            let key = |name: &str| format!("fringes[{s}].{name}");
            let across = match set.axis {
                Axis::Column => self.projector.width,
                Axis::Row => self.projector.height,
            };
            // finer than two pixels a period cannot be shown
            check.within(key("count"), set.count as usize, 1..=across / 2)?;
            check.within(key("steps"), set.steps, 3..=16)?;
            optional(&key("gain_dn_per_e"), set.gain_dn_per_e)?;
            optional(&key("exposure_ms"), set.exposure_ms)?;
            check.that(
                set.images.len() == set.steps as usize,
                key("images"),
                format!("{} files", set.images.len()),
                format!("one file per step, {}", set.steps),
            )?;
        }
        let c = &self.conditions;
        for (key, value, range) in [
            ("bar_left", c.bar_left, 0.0..=1.0),
            ("bar_right", c.bar_right, 0.0..=1.0),
            ("camera_temperature_c", c.camera_temperature_c, -60.0..=150.0),
            ("projector_temperature_c", c.projector_temperature_c, -60.0..=150.0),
        ] {
            value.map_or(Ok(()), |v| check.within(format!("conditions.{key}"), v, range))?;
        }
        let vin = c.vin.as_deref().unwrap_or_default();
        let ok = vin.len() <= 17 && vin.bytes().all(|b| b.is_ascii_graphic() || b == b' ');
        check.that(ok, "conditions.vin", format!("{vin:?}"), "up to 17 printable ASCII characters")?;
        c.job.map_or(Ok(()), |job| check.within("conditions.job", job, 1..=999))
    }
}

/// The name reports use for the capture in `folder`, also where it cannot be read.
pub fn name_of(folder: &Path) -> String {
    let named = |p: &Path| p.file_name().map(|n| n.to_string_lossy().into_owned());
    named(folder)
        .or_else(|| named(&folder.canonicalize().ok()?)) // "." and ".." have no name of their own
        .unwrap_or_else(|| folder.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn capture() -> Capture {
        let set = FringeSet {
            axis: Axis::Column,
            count: 8,
            steps: 4,
            gain_dn_per_e: Some(0.03),
            exposure_ms: None,
            images: (0..4).map(|k| format!("f{k}.png").into()).collect(),
        };
        Capture {
            folder: "c".into(),
            format: 1,
            taken_at: "2026-11-22T05:00:00Z".into(),
            camera: Camera {
                width: 64,
                height: 48,
                bits: 16,
                white_level: None,
                black_level: 2.0,
                read_noise_e: Some(6.0),
                serial: None,
            },
            images: Images::default(),
            projector: Projector { width: 128, height: 80 },
            fringes: vec![set],
            conditions: Conditions { job: Some(12), ..Conditions::default() },
        }
    }

    #[test]
    fn what_is_written_reads_back_the_same() {
        let text = toml::to_string(&capture()).expect("plain tables");
        let mut back: Capture = toml::from_str(&text).expect("just written");
        back.folder = "c".into();
        assert_eq!(back, capture());
    }

    #[test]
    fn the_default_white_level_is_the_largest_sample() {
        let mut camera = capture().camera;
        assert_eq!(camera.white_level(), 65535.0);
        camera.white_level = Some(4095.0);
        assert_eq!(camera.white_level(), 4095.0);
    }

    #[test]
    fn every_number_has_a_range_and_its_error_a_key() {
        type Spoil = fn(&mut Capture);
        let cases: [(&str, Spoil); 15] = [
            ("taken_at = \"yesterday\"", |c| c.taken_at = "yesterday".into()),
            ("taken_at = \"2026-11-22\"", |c| c.taken_at = "2026-11-22".into()),
            ("camera.width = 4000000000, allowed: 16 to 10000", |c| c.camera.width = 4_000_000_000),
            ("camera.bits = 12, allowed: 8 or 16", |c| c.camera.bits = 12),
            ("camera.white_level = NaN", |c| c.camera.white_level = Some(f64::NAN)),
            ("camera.white_level = 70000, allowed: 1 to 65535", |c| c.camera.white_level = Some(70_000.0)),
            ("camera.black_level = -1", |c| c.camera.black_level = -1.0),
            ("camera.read_noise_e = inf", |c| c.camera.read_noise_e = Some(f64::INFINITY)),
            ("number of [[fringes]] = 0", |c| c.fringes.clear()),
            ("fringes[0].count = 0, allowed: 1 to 64", |c| c.fringes[0].count = 0),
            ("fringes[0].count = 65, allowed: 1 to 64", |c| c.fringes[0].count = 65),
            ("fringes[0].steps = 0, allowed: 3 to 16", |c| c.fringes[0].steps = 0),
            ("fringes[0].gain_dn_per_e = 0,", |c| c.fringes[0].gain_dn_per_e = Some(0.0)),
            ("fringes[0].images = 3 files, allowed: one file per step, 4", |c| c.fringes[0].images.truncate(3)),
            ("conditions.job = 1000, allowed: 1 to 999", |c| c.conditions.job = Some(1000)),
        ];
        capture().check().expect("valid before it is spoiled");
        for (sentence, spoil) in cases {
            let mut c = capture();
            spoil(&mut c);
            let e = c.check().expect_err(sentence).to_string();
            assert!(e.starts_with("c/capture.toml: ") && e.contains(sentence), "{e} for {sentence}");
        }
    }
}
