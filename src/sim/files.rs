//! The files beside a simulated capture: its truth, in the words of the independent renderer's captures, what a person
//! would have clicked, and the calibration. In: a scene and a setup. Out: their contents.
//! Not here: the capture itself, which the devices make.

use super::scene::Scene;
use super::setup::Setup;
use super::{Deviation, Feature, Style};
use crate::Calibration;
use crate::document;
use crate::geometry::Point3;
use crate::optics::Pixel;
use crate::vehicle::{self, Class, Kind, VehicleFile};
use nalgebra::Vector3;
use serde_json::{Map, Value, json};
use std::path::PathBuf;

/// Where a feature is: in the camera frame, mm, and in the image, if it is before the lens.
pub fn seen(feature: &Feature, scene: &Scene, setup: &Setup) -> (Vector3<f64>, Option<Pixel>) {
    let p = (scene.camera_from_vehicle * Point3::new(Vector3::from(feature.at))).xyz;
    (p, setup.rig.camera.project(&p))
}

/// Whether a pixel is in the image.
pub fn in_image(pixel: &Pixel, setup: &Setup) -> bool {
    let (right, bottom) = (setup.sensor.width as f64 - 0.5, setup.sensor.height as f64 - 0.5);
    pixel.x >= -0.5 && pixel.y >= -0.5 && pixel.x <= right && pixel.y <= bottom
}

/// The truth of one capture; `pose_id` and `deviation` say how the vehicle stood.
pub fn truth(scene: &Scene, setup: &Setup, pose_id: &str, deviation: &Deviation) -> Value {
    let m = scene.camera_from_vehicle;
    let row = |i: usize| json!([m.r.matrix()[(i, 0)], m.r.matrix()[(i, 1)], m.r.matrix()[(i, 2)], m.t[i]]);
    let mut features = Map::new();
    for f in scene.body.features() {
        let (camera, pixel) = seen(&f, scene, setup);
        let inside = pixel.as_ref().is_some_and(|p| in_image(p, setup));
        let pixel = pixel.map(|p| [p.x, p.y]);
        features.insert(
            f.truth.into(),
            json!({"object_mm": f.at, "camera_mm": [camera.x, camera.y, camera.z], "pixel": pixel, "in_image": inside}),
        );
    }
    json!({
        "object": scene.body.name,
        "kind": if scene.body.style == Style::Suv { "suv" } else { "sedan" },
        "colour": scene.paint.name,
        "pose_id": pose_id,
        "pose_params": {
            "along_mm": deviation.along_mm, "across_mm": deviation.across_mm, "up_mm": deviation.up_mm,
            "roll_deg": deviation.roll_deg, "pitch_deg": deviation.pitch_deg, "yaw_deg": deviation.yaw_deg,
        },
        "camera_from_object": [row(0), row(1), row(2), json!([0.0, 0.0, 0.0, 1.0])],
        "features": features,
    })
}

/// The calibration of the setup, exact.
pub fn calibration(setup: &Setup) -> Calibration {
    Calibration {
        file: PathBuf::new(),
        id: Some("simulated".into()),
        rig: setup.rig.clone(),
        station_from_camera: None,
        covariance: None,
        quality: None,
    }
}

/// The features file for teaching on this scene, clicked exactly; none where a feature is out of the image.
pub fn features(scene: &Scene, setup: &Setup) -> Option<VehicleFile> {
    let body = &scene.body;
    let feature = |f: &Feature| {
        let pixel = seen(f, scene, setup).1.filter(|p| in_image(p, setup))?;
        let (name, class, kind) = match f.class {
            1 => ("corner-1", Class::Point1, Kind::Corner),
            2 => ("corner-2", Class::Point2, Kind::Corner),
            3 => ("cap", Class::Point3, if body.round_flap() { Kind::Ellipse } else { Kind::Outline }),
            _ => ("arch", Class::Point4, Kind::ArchTop),
        };
        Some(vehicle::Feature {
            name: name.into(),
            class,
            kind,
            position_mm: f.at,
            position_sigma_mm: 0.0,
            definition: None,
            pixel: Some([pixel.x, pixel.y]),
            pixel_sigma: 0.02,
            edge: vehicle::Edge::Opening,
            edge_depth_mm: None,
            template: None,
        })
    };
    let target = |name: &str, position_mm| vehicle::Target { name: name.into(), position_mm };
    Some(VehicleFile {
        file: PathBuf::new(),
        format: document::FORMAT,
        job: body.job,
        name: body.name.clone(),
        body: if body.style == Style::Suv { vehicle::Body::Suv } else { vehicle::Body::Sedan },
        origin: "centre of the front axle, on the ground".into(),
        model_code: 0,
        reference_mm: [0.0; 3],
        features: body.features().iter().map(feature).collect::<Option<Vec<_>>>()?,
        targets: vec![
            target("front-radar", [900.0, 0.0, 500.0]),
            target("windscreen-camera", [-600.0, 0.0, 1300.0]),
            target("rear-axle", [-2640.0, 0.0, 340.0]),
        ],
        limits: vehicle::Limits::default(),
        release: None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::{Body, Paint};

    #[test]
    fn truth_and_clicks_are_the_nominal_points_seen_by_the_lens() {
        let setup = Setup::new(0.5, 8);
        let body = Body::named("sedan-b").expect("listed");
        let deviation = Deviation { yaw_deg: 4.0, ..Deviation::default() };
        let scene = Scene::new(body, Paint::named("white").expect("listed"), &deviation);
        let clicked = features(&scene, &setup).expect("all in view");
        let truth = truth(&scene, &setup, "x", &deviation);
        assert_eq!((clicked.features.len(), truth["kind"].as_str()), (3, Some("sedan")));
        assert_eq!(clicked.features[1].kind, Kind::Outline, "its flap is no ellipse");
        let cap = &truth["features"]["cap_centre"];
        let pixel = clicked.features[1].pixel.expect("clicked");
        assert_eq!((cap["in_image"].as_bool(), cap["pixel"][0].as_f64()), (Some(true), Some(pixel[0])));
        let away = Deviation { along_mm: 900.0, ..Deviation::default() };
        let gone = Scene::new(scene.body.clone(), scene.paint, &away);
        assert!(features(&gone, &setup).is_none());
    }
}
