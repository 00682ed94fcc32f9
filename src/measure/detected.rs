//! The features' regions: by the detector where there is one, by the search for the taught shapes where that does not do.
//! In:  the red image, the vehicle model's layout. Out: a pixel per feature, and a pose good to a few mm.
//! Not here: how either of them finds things; depth.
//!
//! A network finds what looks like a feature, on any body. What it found is used only where it lies as the model's features
//! do: else the search decides, as without a detector.

use super::Measurer;
use super::regions::{self, CONSISTENT, Region, nearest_pose};
use crate::code::Code;
use crate::contour::Match;
use crate::detect::Detection;
use crate::geometry::{Pose, frame};
use crate::image::Image;
use crate::lent::List;
use crate::optics::{Lens, Pixel};
use crate::vehicle::{PerFeature, Template};
use nalgebra::{Vector2, Vector3};

type CameraFromVehicle = Pose<frame::Camera, frame::Vehicle>;

/// So many of the detector's regions must agree; the others' places follow from their pose.
const AGREEING: usize = 3;
/// Boxes of one class that are looked at.
const KEPT: usize = 3;
/// The detector looks for vehicles farther from the taught place than the search does: distances may differ by so much more.
const SLACK: f64 = 1.8;
/// A box that ends within this share of the image's width from its border may be cut off there.
const BORDER: f64 = 0.005;

/// Where the features are.
pub(super) struct Regions {
    /// One per template.
    pub(super) regions: PerFeature<Result<Region, Code>>,
    /// From them.
    pub(super) pose: Option<CameraFromVehicle>,
    /// Why the detector was of no use, other than that it found too little.
    pub(super) warning: Option<String>,
}

/// Finds them: `raw` is the red image as it was taken, whose white is `white`; `red` the same without outside light.
pub(super) fn regions(m: &Measurer, raw: &Image<u16>, white: f64, red: &Image<f32>) -> Regions {
    let camera = &m.calibration.rig.camera;
    let mut warning = None;
    match m.shared.detector.as_ref().map(|d| d.detect(raw, white)) {
        Some(Ok(found)) => {
            if let Some((regions, pose)) = fitting(&found, m) {
                return Regions { regions, pose: Some(pose), warning };
            }
        }
        Some(Err(e)) => {
            let cause = std::error::Error::source(&e).map_or_else(String::new, |s| format!(": {s}"));
            warning = Some(format!("{e}{cause}; features are searched for without it"));
        }
        None => {}
    }
    let mut regions = regions::find(red, camera, &m.templates);
    let pose = regions::first_pose(camera, &m.templates, &mut regions);
    Regions { regions, pose, warning }
}

/// The boxes that lie to each other as the model's features do, and the pose that makes them do so.
fn fitting(found: &[Detection], m: &Measurer) -> Option<(PerFeature<Result<Region, Code>>, CameraFromVehicle)> {
    let (camera, templates) = (&m.calibration.rig.camera, &m.templates);
    let candidates: PerFeature<List<Match>> = m
        .vehicle
        .features
        .iter()
        .map(|f| {
            let boxes = found.iter().filter(|d| d.class == f.class.index() && is_whole(d, camera));
            List::of(boxes.take(KEPT).map(|d| Match { at: middle(d.sides), score: d.score }))
        })
        .collect();
    let taught = templates.first()?.taught_pose();
    let mut regions = regions::arrange(&candidates, camera, templates, &taught, SLACK);
    let agree = |regions: &[Result<Region, Code>]| regions.iter().filter(|r| r.is_ok()).count() >= AGREEING;
    if !agree(&regions) {
        return None;
    }
    // a box's middle is beside the feature, by perspective and by what the box is about: as far as at about this pose
    let near = regions::first_pose(camera, templates, &mut regions)?;
    for ((region, template), feature) in regions.iter_mut().zip(templates).zip(&m.vehicle.features) {
        if let Ok(region) = region {
            region.pixel -= beside(template, &template.box_outline(feature.class), camera, &near)?;
            region.by_detector = true;
        }
    }
    let (pose, misfit) = nearest_pose(camera, templates, &regions)?;
    (agree(&regions) && misfit < CONSISTENT).then_some((regions, pose))
}

fn middle([left, top, right, bottom]: [f64; 4]) -> Pixel {
    Pixel::new(0.5 * (left + right), 0.5 * (top + bottom))
}

/// Whether the whole box is in the image.
fn is_whole(d: &Detection, camera: &Lens) -> bool {
    let margin = BORDER * camera.width as f64;
    let [left, top, right, bottom] = d.sides;
    left > margin && top > margin && right < camera.width as f64 - margin && bottom < camera.height as f64 - margin
}

/// How far the middle of the box about `outline` (mm on the panel) lies from the feature, px, on a vehicle at `pose`.
fn beside(template: &Template, outline: &[[f64; 2]], camera: &Lens, pose: &CameraFromVehicle) -> Option<Vector2<f64>> {
    let local = template.local(pose);
    let mut sides = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for [u, v] in outline {
        let p = camera.project(&local.point(&Vector3::new(*u, *v, 0.0)).xyz)?;
        sides = [sides[0].min(p.x), sides[1].min(p.y), sides[2].max(p.x), sides[3].max(p.y)];
    }
    Some(middle(sides) - camera.project(&local.origin.xyz)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::Calibration;
    use crate::geometry::{Point3, rotation_from_rows};
    use crate::vehicle::VehicleFile;
    use std::path::Path;

    fn measurer() -> Measurer {
        let station = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station");
        let calibration = Calibration::read(&station.join("calibration.toml")).expect("test data");
        let vehicle = VehicleFile::read(&station.join("vehicle/suv-a.toml")).expect("test data");
        Measurer::new(calibration, vehicle).expect("test data")
    }

    /// Where the vehicle of the capture `moved` stands.
    fn moved() -> CameraFromVehicle {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/station/moved/truth.json");
        let text = std::fs::read_to_string(file).expect("test data");
        let truth: serde_json::Value = serde_json::from_str(&text).expect("test data");
        let at = |i: usize, j: usize| truth["camera_from_object"][i][j].as_f64().expect("a matrix");
        let rows = std::array::from_fn(|i| std::array::from_fn(|j| at(i, j)));
        Pose::new(rotation_from_rows(rows).expect("a rotation"), Vector3::new(at(0, 3), at(1, 3), at(2, 3)))
    }

    /// What a perfect detector finds there.
    fn perfect(m: &Measurer, pose: &CameraFromVehicle) -> Vec<Detection> {
        let camera = &m.rig().camera;
        let of = |(feature, template): (&crate::vehicle::Feature, &Template)| {
            let local = template.local(pose);
            let outline = template.box_outline(feature.class);
            let seen =
                |p: &[f64; 2]| camera.project(&local.point(&Vector3::new(p[0], p[1], 0.0)).xyz).expect("in view");
            let pixels: Vec<Pixel> = outline.iter().map(seen).collect();
            let least = |i: usize| pixels.iter().map(|p| p[i]).fold(f64::INFINITY, f64::min);
            let most = |i: usize| pixels.iter().map(|p| p[i]).fold(f64::NEG_INFINITY, f64::max);
            Detection { class: feature.class.index(), score: 0.9, sides: [least(0), least(1), most(0), most(1)] }
        };
        m.features().map(of).collect()
    }

    #[test]
    fn boxes_give_the_features_and_a_pose_near_the_truth() {
        let (m, truth) = (measurer(), moved());
        let (regions, pose) = fitting(&perfect(&m, &truth), &m).expect("they are the model's");
        for (region, (_, template)) in regions.iter().zip(m.features()) {
            let at = (truth * Point3::new(Vector3::from(template.point_mm))).xyz;
            let known = m.rig().camera.project(&at).expect("in view");
            let region = region.expect("found");
            assert!((region.pixel - known).norm() < 1.0 && region.by_detector, "{region:?} {known:?}");
            assert!(((pose * Point3::new(Vector3::from(template.point_mm))).xyz - at).norm() < 15.0);
        }
    }

    #[test]
    fn what_does_not_lie_as_the_model_does_is_left_to_the_search() {
        let (m, truth) = (measurer(), moved());
        let perfect = perfect(&m, &truth);
        let moved = |k: usize, by: f64| {
            let mut boxes = perfect.clone();
            boxes[k].sides = boxes[k].sides.map(|v| v + by);
            boxes
        };
        let found = |boxes: &[Detection]| {
            fitting(boxes, &m).map(|(regions, _)| regions.iter().map(Result::is_ok).collect::<Vec<_>>())
        };
        assert_eq!(found(&moved(2, 120.0)), Some(vec![true, true, false, true]), "the other three agree");
        assert_eq!(found(&perfect[..2]), None, "too few");
        assert_eq!(found(&[]), None);
        // beside the right box a worse one of its class is no harm
        let more = [perfect.clone(), vec![Detection { score: 0.6, ..moved(2, 100.0)[2] }]].concat();
        assert_eq!(found(&more), Some(vec![true; 4]));
        let mut two = moved(2, 120.0);
        two[0].sides = two[0].sides.map(|v| v + 90.0);
        assert_eq!(found(&two), None, "two that agree are too few");
    }
}
