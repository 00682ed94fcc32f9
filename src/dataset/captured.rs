//! Labels from a stored capture: where the measured pose has the vehicle model's features.
//! In:  a capture, what measures it. Out: its red image, made small, with boxes; or why it is of no use.
//! Not here: files.
//!
//! A capture is used only if its pose is ok and every feature was measured: what was not may be hidden or not, and either
//! label could be wrong.

use super::boxes::{Labelled, boxed};
use crate::capture::{Capture, Error};
use crate::detect::reduced;
use crate::geometry::{Pose, frame, rotation_from_rows};
use crate::image::Image;
use crate::measure::{Measurer, Verdict, measure};
use nalgebra::Vector3;

/// What a capture gave.
#[derive(Clone, Debug)]
pub enum Captured {
    /// An image and its boxes.
    Labelled {
        /// The red image, `width` wide.
        image: Image<u8>,
        /// One per feature, also those out of view.
        boxes: Vec<Labelled>,
    },
    /// Nothing, for this reason.
    LeftOut(String),
}

/// Measures `capture` and labels its red image, reduced to `width`.
pub fn captured(measurer: &Measurer, capture: &Capture, width: usize) -> Result<Captured, Error> {
    let (measurement, _) = measure(measurer, capture, &mut |_| ())?;
    let code = |code: Option<crate::Code>| code.map_or(0, crate::Code::number);
    let pose = measurement.camera_from_vehicle.as_ref().and_then(|p| {
        Some(Pose::<frame::Camera, frame::Vehicle>::new(
            rotation_from_rows(p.rotation)?,
            Vector3::from(p.translation_mm),
        ))
    });
    let Some(pose) = pose.filter(|_| measurement.verdict == Verdict::Ok) else {
        let said = format!("{} ({}) {}", measurement.verdict.name(), code(measurement.code), measurement.detail);
        return Ok(Captured::LeftOut(said));
    };
    if let Some(f) = measurement.features.iter().find(|f| f.code.is_some()) {
        return Ok(Captured::LeftOut(format!("{} was not measured ({})", f.name, code(f.code))));
    }
    let red = capture.load(capture.red()?)?;
    let image = reduced(&red, capture.camera.white_level(), width);
    let (camera, size) = (&measurer.rig().camera, (red.width, red.height));
    let scale = [image.width as f64 / red.width as f64, image.height as f64 / red.height as f64];
    let small = |v: f64, i: usize| (v + 0.5) * scale[i] - 0.5;
    let of = |(feature, template): (&crate::vehicle::Feature, &crate::vehicle::Template)| {
        let local = template.local(&pose);
        let seen = |[u, v]: [f64; 2]| camera.project(&local.point(&Vector3::new(u, v, 0.0)).xyz);
        boxed(feature.class, &template.box_outline(feature.class), size, seen, |_| false)
    };
    let boxes = measurer.features().filter_map(of).map(|b| {
        let [left, top, right, bottom] = b.sides;
        Labelled { sides: [small(left, 0), small(top, 1), small(right, 0), small(bottom, 1)], ..b }
    });
    Ok(Captured::Labelled { boxes: boxes.collect(), image })
}
