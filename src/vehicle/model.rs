//! vehicle.toml, and the features file for teaching, which is the same without templates and with pixels.

use super::Template;
use crate::code::Code;
use crate::document::{self, Check, Error};
use crate::geometry::{Point3, frame};
use crate::optics::Pixel;
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Features nearer to each other than this say nothing about rotation; farther apart than the second, mm,
/// they do not fit one image, and the numbers are in another unit.
const DISTANCES_MM: std::ops::RangeInclusive<f64> = 20.0..=2000.0;
/// Of three points as good as on one line none fixes the rotation about it.
const MIN_FROM_LINE_MM: f64 = 10.0;
/// No coordinate of a car is larger.
const REACH_MM: f64 = 20_000.0;
/// A template has a few kB.
const MAX_TEMPLATE_BYTES: u64 = 16 << 20;
/// Of a model: one of each class.
pub const MAX_FEATURES: usize = 4;

/// One of each feature of a model, or of some of them.
pub(crate) type PerFeature<T> = heapless::Vec<T, MAX_FEATURES>;

/// One vehicle model (a job). Optional keys that have a default are written with it, so that two files which
/// mean the same are the same.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct VehicleFile {
    /// Where it was read; names it in messages and finds its templates.
    #[serde(skip)]
    pub file: PathBuf,
    /// 1.
    pub format: u32,
    /// 1 to 999.
    pub job: u16,
    /// What people call it.
    pub name: String,
    /// Its kind of body.
    pub body: Body,
    /// Where the vehicle frame's origin lies, in words.
    pub origin: String,
    /// The PLC's MODEL_CODE; 0: not checked.
    #[serde(default)]
    pub model_code: u16,
    /// The point whose position is reported, mm, vehicle frame.
    #[serde(default)]
    pub reference_mm: [f64; 3],
    /// Three or four, each class at most once.
    #[serde(rename = "feature")]
    pub features: Vec<Feature>,
    /// Points where uncertainty is stated.
    #[serde(default, rename = "target")]
    pub targets: Vec<Target>,
    /// Beyond these the verdict is not ok.
    #[serde(default)]
    pub limits: Limits,
    /// Written by `datum release`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub release: Option<Release>,
}

/// A kind of body, as the detector knows them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
#[expect(missing_docs, reason = "the names say it")]
pub enum Body {
    Suv,
    Sedan,
}

/// A class of the detector; the order is that of the PLC's FEATURE_MASK.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Class {
    /// Corner 1.
    Point1,
    /// Corner 2.
    Point2,
    /// The filler cap's opening.
    Point3,
    /// The top of the wheel arch.
    Point4,
}

impl Class {
    /// The feature's bit in FEATURE_MASK and its place among FEATURE 1–4, from 0.
    pub fn index(self) -> usize {
        self as usize
    }
}

/// How a feature is found.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Where two gaps meet.
    Corner,
    /// A round flap.
    Ellipse,
    /// A flap of any shape.
    Outline,
    /// The extremum of the arch's edge along the vehicle's z.
    ArchTop,
}

/// Which point of a corner is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Definition {
    /// Where the click's ray meets the surface, carried by what is detected.
    AsTaught,
    /// Where the two straight edges would meet.
    EdgeIntersection,
    /// The point of strongest curvature.
    Apex,
}

/// Which edge of a gap is the feature.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Edge {
    /// That of the panel's opening: the panel with the features.
    #[default]
    Opening,
    /// That of the flap.
    Flap,
}

/// One feature of the body.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Feature {
    /// Unique in the model.
    pub name: String,
    /// Its class.
    pub class: Class,
    /// How it is found.
    pub kind: Kind,
    /// The nominal position, mm, vehicle frame.
    pub position_mm: [f64; 3],
    /// Build tolerance of the body at this point, mm, 1 sigma per axis.
    #[serde(default)]
    pub position_sigma_mm: f64,
    /// Of corners only; none: as taught.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub definition: Option<Definition>,
    /// For teaching: where it was clicked in the red image, raw px.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel: Option<[f64; 2]>,
    /// Of that click, px.
    #[serde(default = "default_pixel_sigma")]
    pub pixel_sigma: f64,
    /// Which edge of the gap is meant.
    #[serde(default)]
    pub edge: Edge,
    /// How far below the surface the visible edge lies, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub edge_depth_mm: Option<f64>,
    /// The template's file beside the model's; none: not taught.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub template: Option<String>,
}

fn default_pixel_sigma() -> f64 {
    0.5
}

impl Feature {
    /// The nominal position.
    pub fn position(&self) -> Point3<frame::Vehicle> {
        Point3::new(self.position_mm.into())
    }

    /// Where it was clicked.
    pub fn click(&self) -> Option<Pixel> {
        self.pixel.map(Pixel::from)
    }

    /// Which point of a corner is meant.
    pub fn definition(&self) -> Definition {
        self.definition.unwrap_or(Definition::AsTaught)
    }
}

/// A point where uncertainty is stated.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Unique in the model.
    pub name: String,
    /// mm, vehicle frame.
    pub position_mm: [f64; 3],
}

/// Deviations from the taught pose, uncertainties and distances beyond which the verdict is not ok.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields, default)]
#[expect(missing_docs, reason = "the keys of the file, with their units in them")]
pub struct Limits {
    pub x_mm: f64,
    pub y_mm: f64,
    pub z_mm: f64,
    pub roll_deg: f64,
    pub pitch_deg: f64,
    pub yaw_deg: f64,
    /// At the features' centroid.
    pub uncertainty_k2_mm: f64,
    pub uncertainty_k2_deg: f64,
    /// Measured against nominal inter-point distance.
    pub distance_mm: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            x_mm: 150.0,
            y_mm: 150.0,
            z_mm: 80.0,
            roll_deg: 5.0,
            pitch_deg: 5.0,
            yaw_deg: 15.0,
            uncertainty_k2_mm: 2.0,
            uncertainty_k2_deg: 0.2,
            distance_mm: 1.5,
        }
    }
}

/// What `datum release` adds.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Release {
    /// [`fingerprint`] of the model and its templates.
    pub fingerprint: u32,
    /// The day, as "2026-11-22".
    pub date: String,
}

impl VehicleFile {
    /// Reads and checks a vehicle or features file; not its templates.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let mut model: Self = document::read(file)?;
        model.file = file.into();
        model.check()?;
        Ok(model)
    }

    /// Writes the model, checked, to `file`, whole or not at all.
    pub fn write(&self, file: &Path) -> Result<(), Error> {
        self.check()?;
        document::write(file, self)
    }

    /// The templates' bytes in the order of the features; an error names a feature that is not taught or a
    /// template that cannot be read.
    pub fn read_templates(&self) -> Result<Vec<Vec<u8>>, Error> {
        let template = |(i, f): (usize, &Feature)| {
            let allowed = "a file written by `datum teach`";
            let key = format!("feature[{i}].template");
            Check(&self.file).that(f.template.is_some(), key, "(missing)", allowed)?;
            let name = f.template.as_ref().expect("checked just now");
            document::read_bytes(&self.file.with_file_name(name), MAX_TEMPLATE_BYTES)
        };
        self.features.iter().enumerate().map(template).collect()
    }

    /// The checked templates in the order of the features; an error names the file and what is wrong with it.
    pub fn templates(&self) -> Result<Vec<Template>, Error> {
        let template = |(f, bytes): (&Feature, Vec<u8>)| {
            let file = self.file.with_file_name(f.template.as_deref().unwrap_or_default());
            let template = Template::from_bytes(&bytes)
                .map_err(|wrong| Error::Content { file: file.clone(), wrong: wrong.into() })?;
            let (feature, depth) =
                (template.feature == f.name, f.edge_depth_mm.is_none_or(|d| d == template.edge_depth_mm));
            let check = Check(&file);
            check.that(
                feature,
                "feature",
                format!("{:?}", template.feature),
                format!("{:?}, whose template it is to be", f.name),
            )?;
            check.that(
                depth,
                "edge_depth_mm",
                template.edge_depth_mm,
                format!("the {:?} of {}; teach again", f.edge_depth_mm, self.file.display()),
            )?;
            Ok(template)
        };
        self.features.iter().zip(self.read_templates()?).map(template).collect()
    }

    /// Where the features were clicked, px; an error names one that was not.
    pub fn clicks(&self) -> Result<Vec<Pixel>, Error> {
        let click = |(i, f): (usize, &Feature)| {
            let allowed = "where the feature was clicked in the red image";
            Check(&self.file).that(f.pixel.is_some(), format!("feature[{i}].pixel"), "(missing)", allowed)?;
            Ok(f.click().expect("checked just now"))
        };
        self.features.iter().enumerate().map(click).collect()
    }

    /// Why the model may not be used in production, if so: not released, or changed since.
    pub fn unreleased(&self, templates: &[Vec<u8>]) -> Option<Code> {
        match &self.release {
            None => Some(Code::NotReleased),
            Some(r) if r.fingerprint != fingerprint(self, templates) => Some(Code::Fingerprint),
            Some(_) => None,
        }
    }

    /// Releases the model for production as it and its templates are now: writes it with their fingerprint, which it gives.
    pub fn release(&mut self) -> Result<u32, Error> {
        let fingerprint = fingerprint(self, &self.read_templates()?);
        self.release = Some(Release { fingerprint, date: crate::time::date(crate::time::unix_ms() / 1000) });
        self.write(&self.file)?;
        Ok(fingerprint)
    }

    fn check(&self) -> Result<(), Error> {
        let check = Check(&self.file);
        let point = |key: &str, p: &[f64; 3]| {
            let ok = p.iter().all(|v| v.abs() <= REACH_MM); // NaN is not
            check.that(ok, key, format!("{p:?}"), format!("numbers from -{REACH_MM} to {REACH_MM} mm"))
        };
        check.within("job", self.job, 1..=999)?;
        check.name("name", &self.name)?;
        check.that(!self.origin.trim().is_empty(), "origin", "\"\"", "where the origin lies, in words")?;
        point("reference_mm", &self.reference_mm)?;
        check.within("number of [[feature]]", self.features.len(), 3..=MAX_FEATURES)?;
        for (i, f) in self.features.iter().enumerate() {
            let key = |name: &str| format!("feature[{i}].{name}");
            check.name(key("name"), &f.name)?;
            for earlier in &self.features[..i] {
                let (name, class) = (earlier.name != f.name, earlier.class != f.class);
                check.that(name, key("name"), format!("{:?}", f.name), "a name no other feature has")?;
                check.that(class, key("class"), spelled(f.class), "a class no other feature has")?;
            }
            let (fits, kinds) = match f.class {
                Class::Point1 | Class::Point2 => (f.kind == Kind::Corner, "\"corner\" for point1 and point2"),
                Class::Point3 => {
                    (matches!(f.kind, Kind::Ellipse | Kind::Outline), "\"ellipse\" or \"outline\" for point3")
                }
                Class::Point4 => (f.kind == Kind::ArchTop, "\"arch-top\" for point4"),
            };
            check.that(fits, key("kind"), spelled(f.kind), kinds)?;
            point(&key("position_mm"), &f.position_mm)?;
            check.within(key("position_sigma_mm"), f.position_sigma_mm, 0.0..=100.0)?;
            let ok = f.definition.is_none() || f.kind == Kind::Corner;
            check.that(ok, key("definition"), spelled(f.definition()), "no such key: only corners have it")?;
            let pixel = f.pixel.unwrap_or_default();
            let ok = pixel.iter().all(|v| (-0.5..=crate::image::MAX_SIDE as f64).contains(v));
            check.that(ok, key("pixel"), format!("{pixel:?}"), "a position in the red image, px")?;
            check.within(key("pixel_sigma"), f.pixel_sigma, 0.001..=100.0)?;
            check.within(key("edge_depth_mm"), f.edge_depth_mm.unwrap_or_default(), -20.0..=20.0)?;
            if let Some(t) = &f.template {
                let ok = Path::new(t).file_name().is_some_and(|n| n == t.as_str());
                check.that(
                    ok,
                    key("template"),
                    format!("{t:?}"),
                    "the name of a file beside this one, without a folder",
                )?;
            }
        }
        self.check_geometry()?;
        for (i, t) in self.targets.iter().enumerate() {
            let key = |name: &str| format!("target[{i}].{name}");
            check.name(key("name"), &t.name)?;
            let unique = self.targets[..i].iter().all(|earlier| earlier.name != t.name);
            check.that(unique, key("name"), format!("{:?}", t.name), "a name no other target has")?;
            point(&key("position_mm"), &t.position_mm)?;
        }
        let l = &self.limits;
        for (key, value, most) in [
            ("x_mm", l.x_mm, REACH_MM),
            ("y_mm", l.y_mm, REACH_MM),
            ("z_mm", l.z_mm, REACH_MM),
            ("roll_deg", l.roll_deg, 180.0),
            ("pitch_deg", l.pitch_deg, 90.0),
            ("yaw_deg", l.yaw_deg, 180.0),
            ("uncertainty_k2_mm", l.uncertainty_k2_mm, 1000.0),
            ("uncertainty_k2_deg", l.uncertainty_k2_deg, 90.0),
            ("distance_mm", l.distance_mm, 1000.0),
        ] {
            let ok = value > 0.0 && value <= most;
            check.that(ok, format!("limits.{key}"), value, format!("greater than 0, up to {most}"))?;
        }
        Ok(())
    }

    /// The features are near enough, far enough and not on one line.
    fn check_geometry(&self) -> Result<(), Error> {
        let check = Check(&self.file);
        let mut line = (0.0, &self.features[0], &self.features[0]);
        for (i, a) in self.features.iter().enumerate() {
            for b in &self.features[..i] {
                let distance = (a.position() - b.position()).norm();
                check.that(
                    DISTANCES_MM.contains(&distance),
                    format!("distance of {:?} from {:?}", a.name, b.name),
                    format!("{distance:.3} mm"),
                    format!("{} to {} mm (are the positions millimetres?)", DISTANCES_MM.start(), DISTANCES_MM.end()),
                )?;
                if distance > line.0 {
                    line = (distance, a, b);
                }
            }
        }
        let (length, a, b) = line;
        let along: Vector3<f64> = (b.position() - a.position()) / length;
        let off = self.features.iter().map(|f| (f.position() - a.position()).cross(&along).norm()).fold(0.0, f64::max);
        check.that(
            off >= MIN_FROM_LINE_MM,
            format!("distance of the other features from the line through {:?} and {:?}", a.name, b.name),
            format!("{off:.3} mm"),
            format!("at least {MIN_FROM_LINE_MM} mm for one of them: features on one line fix no rotation about it"),
        )
    }
}

/// A choice as the file spells it.
fn spelled(choice: impl Serialize) -> String {
    serde_json::to_string(&choice).expect("an enum without content is a string")
}

/// CRC-32 (ISO-HDLC) of what the model means, its release apart, and of its templates' bytes in the order of the
/// features. Comments, the order of keys and defaults left out do not change it; any number or name does.
pub fn fingerprint(model: &VehicleFile, templates: &[Vec<u8>]) -> u32 {
    let content = serde_json::to_vec(&VehicleFile { release: None, ..model.clone() });
    let content = content.expect("string keys and finite numbers");
    let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
    let mut digest = crc.digest();
    for part in std::iter::once(&content).chain(templates) {
        digest.update(&(part.len() as u64).to_le_bytes()); // so that parts do not run into each other
        digest.update(part);
    }
    digest.finalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"
format = 1
job = 12
name = "SUV A"
body = "suv"
origin = "centre of the front axle, on the ground"
[[feature]]
name = "corner-1"
class = "point1"
kind = "corner"
position_mm = [-2476.12, 873.86, 671.14]
definition = "as-taught"
pixel = [383.64, 688.88]
[[feature]]
name = "corner-2"
class = "point2"
kind = "corner"
position_mm = [-2780.71, 869.20, 681.79]
template = "suv-a.corner-2.datum"
[[feature]]
name = "cap"
class = "point3"
kind = "ellipse"
position_mm = [-2618, 866.67, 874]
edge = "flap"
edge_depth_mm = 0.6
[[target]]
name = "front-radar"
position_mm = [900.0, 0.0, 500.0]
[limits]
yaw_deg = 10.0
"#;

    fn model() -> VehicleFile {
        let mut m: VehicleFile = toml::from_str(TEXT).expect("valid");
        m.file = "v.toml".into();
        m
    }

    #[test]
    fn what_is_written_reads_back_the_same_with_readable_arrays() {
        let text = toml::to_string(&model()).expect("plain tables");
        assert!(text.contains("\nposition_mm = [-2476.12, 873.86, 671.14]\n"), "{text}");
        let mut back: VehicleFile = toml::from_str(&text).expect("just written");
        back.file = "v.toml".into();
        assert_eq!(back, model());
        assert_eq!((back.limits.yaw_deg, back.limits.x_mm, back.features[0].pixel_sigma), (10.0, 150.0, 0.5));
    }

    #[test]
    fn every_mistake_is_named() {
        type Spoil = fn(&mut VehicleFile);
        let cases: [(&str, Spoil); 18] = [
            ("job = 0, allowed: 1 to 999", |m| m.job = 0),
            ("name = \"a/b\"", |m| m.name = "a/b".into()),
            ("number of [[feature]] = 2, allowed: 3 to 4", |m| m.features.truncate(2)),
            ("feature[1].name = \"corner-1\", allowed: a name no other", |m| m.features[1].name = "corner-1".into()),
            ("feature[1].class = \"point1\", allowed: a class no other", |m| m.features[1].class = Class::Point1),
            ("feature[2].kind = \"corner\", allowed: \"ellipse\" or", |m| m.features[2].kind = Kind::Corner),
            ("feature[2].definition = \"apex\"", |m| m.features[2].definition = Some(Definition::Apex)),
            ("feature[0].position_mm = [NaN", |m| m.features[0].position_mm[0] = f64::NAN),
            ("feature[0].pixel = [-3.0,", |m| m.features[0].pixel = Some([-3.0, 5.0])),
            ("feature[0].pixel_sigma = 0,", |m| m.features[0].pixel_sigma = 0.0),
            ("feature[1].template = \"../x\"", |m| m.features[1].template = Some("../x".into())),
            ("distance of \"corner-2\" from \"corner-1\" = 2.000 mm, allowed: 20 to 2000 mm", |m| {
                m.features[1].position_mm = [-2478.12, 873.86, 671.14];
            }),
            ("(are the positions millimetres?)", |m| {
                m.features.iter_mut().for_each(|f| f.position_mm = f.position_mm.map(|v| v / 1000.0));
            }),
            ("through \"corner-2\" and \"corner-1\" = 3.000 mm, allowed: at least 10 mm", |m| {
                m.features[1].position_mm = [-2776.12, 873.86, 671.14];
                m.features[2].position_mm = [-2600.0, 873.86, 674.14];
            }),
            ("target[0].position_mm = [inf", |m| m.targets[0].position_mm[0] = f64::INFINITY),
            ("target[1].name = \"front-radar\"", |m| m.targets.push(m.targets[0].clone())),
            ("limits.yaw_deg = 0, allowed: greater than 0, up to 180", |m| m.limits.yaw_deg = 0.0),
            ("limits.x_mm = NaN", |m| m.limits.x_mm = f64::NAN),
        ];
        model().check().expect("valid before it is spoiled");
        for (sentence, spoil) in cases {
            let mut m = model();
            spoil(&mut m);
            let e = m.check().expect_err(sentence).to_string();
            assert!(e.starts_with("v.toml: ") && e.contains(sentence), "{e} for {sentence}");
        }
    }

    #[test]
    fn the_fingerprint_holds_for_the_meaning_and_changes_with_it() {
        let templates = vec![vec![1, 2], vec![], vec![3]];
        let frozen = fingerprint(&model(), &templates);
        assert_eq!(frozen, FROZEN, "released models in the field would all be refused with code 802");
        let mut m: VehicleFile =
            toml::from_str(&TEXT.replace("job = 12", "# a comment\nmodel_code = 0\njob = 12")).expect("valid");
        assert_eq!(fingerprint(&m, &templates), frozen);
        assert_eq!(m.unreleased(&templates), Some(Code::NotReleased));
        m.release = Some(Release { fingerprint: frozen, date: "2026-11-22".into() });
        assert_eq!((fingerprint(&m, &templates), m.unreleased(&templates)), (frozen, None));
        m.features[0].position_mm[1] += 1e-9;
        assert_eq!(m.unreleased(&templates), Some(Code::Fingerprint));
        assert_ne!(fingerprint(&model(), &[vec![1], vec![2], vec![3]]), frozen);
    }

    const FROZEN: u32 = 2_284_991_348;

    #[test]
    fn the_order_of_classes_is_that_of_the_plc() {
        assert_eq!([Class::Point1, Class::Point2, Class::Point3, Class::Point4].map(Class::index), [0, 1, 2, 3]);
    }
}
